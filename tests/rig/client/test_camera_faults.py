"""Cameras that stall or die, as lerobot's camera face reports them."""

import contextlib
import time

import pytest

from lerobot_robot_yam.config_yam_camera import YamSimCameraConfig
from lerobot_robot_yam.errors import ConfigError, RigError, StaleStateError
from lerobot_robot_yam.rig.client.rendered_camera import RigCamera
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.yam_camera import YamSimCamera

pytestmark = pytest.mark.alone


@pytest.fixture(scope="module")
def rig():
    with running_rig() as rig, RigCamera("overview", 32, 24, 1, rig=rig.name):  # its renderer stays up
        yield rig


@pytest.fixture(autouse=True)
def healthy(rig):
    yield
    for camera in ("top", "wrist_left"):
        rig.camera_fault(camera, None)


@contextlib.contextmanager
def connected(rig, name="top"):
    camera = YamSimCamera(YamSimCameraConfig(camera=name, width=64, height=48, fps=30, rig=rig.name))
    camera.connect()
    try:
        yield camera
    finally:
        camera.disconnect()


def read_until(camera, fails, timeout_s=20.0):
    """Read until a read fails, or until one does not."""
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            camera.async_read(400)
            failed = False
        except StaleStateError:
            failed = True
        if failed == fails:
            return
        assert time.monotonic() < deadline, "did not happen in time"


def test_a_stalled_camera_goes_stale_and_comes_back(rig):
    with connected(rig) as camera, connected(rig, "wrist_left") as other:
        rig.camera_fault("top", "stall", seconds=1.5)
        read_until(camera, fails=True)
        with pytest.raises(TimeoutError, match="camera top: newest frame is"):
            camera.read_latest(max_age_ms=300)
        other.async_read(5000)
        read_until(camera, fails=False)
        assert rig.wait_event("camera_fault", 1.0, camera="top", fault="stall")["seconds"] == 1.5


def test_a_stall_without_an_end_lasts_until_it_is_ended(rig):
    with connected(rig) as camera:
        rig.camera_fault("top", "stall")
        read_until(camera, fails=True)
        time.sleep(0.6)  # what it made until then is old now
        with pytest.raises(StaleStateError, match="camera top: no new frame"):
            camera.async_read(1000)
        rig.camera_fault("top", None)
        camera.async_read(5000)


def test_a_dead_camera_raises_each_time_and_opens_again_when_repaired(rig):
    with connected(rig) as camera:
        rig.camera_fault("top", "dead")
        with pytest.raises(RigError, match="camera top has died"):
            read_until(camera, fails=True)
            camera.async_read(100)
        for _ in range(2):
            with pytest.raises(RigError, match="camera top has died"):
                camera.read_latest(max_age_ms=0)
        with pytest.raises(RigError, match="camera top has died"):
            camera.read()
        with pytest.raises(RigError, match="camera top has died"), connected(rig):
            pass
        rig.camera_fault("top", None)
        with pytest.raises(RigError, match="camera top has died"):  # this connection stays dead
            camera.async_read(300)
        camera.disconnect()
        camera.connect()
        assert camera.read_latest(5000).shape == (48, 64, 3)


@pytest.mark.parametrize(
    ("camera", "kind", "seconds", "text"),
    [
        ("attic", "stall", None, "unknown camera 'attic'"),
        ("top", "blind", None, "not 'blind'"),
        ("top", "dead", 3.0, "'stall' .maybe with seconds"),
        ("top", "stall", -1.0, "from 0.0"),
    ],
)
def test_a_camera_fault_that_makes_no_sense_is_refused(rig, camera, kind, seconds, text):
    with pytest.raises(ConfigError, match=text):
        rig.camera_fault(camera, kind, seconds)


@pytest.mark.long
def test_a_stall_set_before_the_renderer_runs_holds():
    with running_rig() as rig:
        rig.camera_fault("top", "stall")
        with RigCamera("overview", 32, 24, 1, rig=rig.name):
            with pytest.raises(StaleStateError, match="camera top: no new frame"):
                RigCamera("top", 64, 48, 30, rig=rig.name).connect(timeout_s=5.0)
            rig.camera_fault("top", None)
            with RigCamera("top", 64, 48, 30, rig=rig.name) as camera:
                assert camera.latest(5.0)[0].any()
