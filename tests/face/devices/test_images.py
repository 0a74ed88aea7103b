"""Images that are late are waited for, and those that do not come end the observation."""

import math
import time
from dataclasses import dataclass

import numpy as np
import pytest

from lerobot_robot_yam.config_yam_camera import YamSimCameraConfig
from lerobot_robot_yam.config_yam_follower import YamFollowerConfig
from lerobot_robot_yam.errors import StaleStateError
from lerobot_robot_yam.face.devices.images import LATE_S, PATIENCE_S, ImageReader, LateImages, newest_images
from lerobot_robot_yam.rig.client.rig_control import running_rig
from lerobot_robot_yam.rig.devices.thermometer import sample_age_s
from lerobot_robot_yam.yam_follower import YamFollower
from tests.support.rigged import STOPS

MOTORS = [*(f"joint_{i}" for i in range(1, 7)), "gripper"]


@pytest.fixture
def rig():
    with running_rig(stamp_temperatures=True) as rig:
        yield rig


@pytest.fixture
def robot(rig, tmp_path):
    camera = YamSimCameraConfig(camera="top", rig=rig.name, width=64, height=48, fps=30)
    robot = YamFollower(
        YamFollowerConfig(
            channel="follower_left",
            interface="yam_sim",
            can_options={"rig": rig.name},
            gripper_stops_rad=STOPS,
            cameras={"top": camera},
            observe_temperature=True,
            calibration_dir=tmp_path,
        )
    )
    robot.connect()
    yield robot
    robot.disconnect()


def sample_age(observation):
    """Age of the oldest motor sample, s: the rig stamps it into the temperatures."""
    now = time.monotonic()
    return max(
        sample_age_s(int(observation[f"{m}.temp_mos"]), int(observation[f"{m}.temp_rotor"]), now) for m in MOTORS
    )


class Camera:
    """A camera of LeRobot's kind whose image is of an age until a moment."""

    def __init__(self, fresh_after_s=0.0, age_ms=1000):
        self._fresh_at, self._age_ms = time.monotonic() + fresh_after_s, age_ms
        self.reads = 0

    def read_latest(self, max_age_ms=500):
        self.reads += 1
        if time.monotonic() < self._fresh_at and max_age_ms <= self._age_ms:
            raise TimeoutError("latest frame is too old")
        return self.reads

    read_latest_depth = read_latest


class StallingCamera(Camera):
    """A camera that is fine, and in whose calls the machine stands still for a time, at some moments."""

    def __init__(self, moments_s, stall_s):
        super().__init__()
        self._stalls_at = list(time.monotonic() + np.asarray(moments_s))
        self._stall_s = stall_s

    def read_latest(self, max_age_ms=500):
        if self._stalls_at and time.monotonic() >= self._stalls_at[0]:
            self._stalls_at.pop(0)
            time.sleep(self._stall_s)
        return super().read_latest(max_age_ms)


@dataclass
class CameraSettings:
    use_rgb: bool = True
    use_depth: bool = False
    fps: int | None = 30


def test_what_was_read_before_the_wait_is_read_again():
    cameras = {"top": Camera(), "wrist": Camera(fresh_after_s=0.1)}
    images, waited = newest_images(cameras, dict.fromkeys(cameras, CameraSettings()))
    assert waited and list(images) == ["top", "wrist"]
    assert images["top"] == cameras["top"].reads > 1


def test_colour_and_depth_are_of_one_time():
    cameras = {"top": Camera(fresh_after_s=0.1)}
    images, waited = newest_images(cameras, {"top": CameraSettings(use_depth=True)})
    assert waited and images["top_depth"] - images["top"] == 1


def test_images_that_are_fresh_are_read_once(caplog):
    cameras = {"top": Camera(), "wrist": Camera()}
    assert newest_images(cameras, dict.fromkeys(cameras, CameraSettings())) == ({"top": 1, "wrist": 1}, "")
    assert not caplog.text


def test_an_image_that_is_rather_old_is_waited_for_and_taken_in_the_end():
    cameras = {"top": Camera(fresh_after_s=60.0, age_ms=300)}
    begin = time.monotonic()
    images, waited = newest_images(cameras, {"top": CameraSettings()})
    assert waited and images["top"] > 2 and time.monotonic() - begin >= LATE_S


@pytest.mark.parametrize(
    "age_ms, fps, waits", [(190, 30, False), (210, 30, True), (210, None, True), (390, 5, False), (410, 5, True)]
)
def test_how_old_an_image_may_be_without_a_wait(age_ms, fps, waits):
    cameras = {"top": Camera(fresh_after_s=0.1, age_ms=age_ms)}
    assert newest_images(cameras, {"top": CameraSettings(fps=fps)})[1].startswith("waited") is waits


def test_late_images_are_said_at_once_and_then_seldom(monkeypatch, caplog):
    late = LateImages()
    for number in range(4):
        if number == 3:
            monkeypatch.setattr("lerobot_robot_yam.face.devices.images._TOLD_S", 0.0)
        late.tell(f"waited {number} ms")
    assert [record.getMessage() for record in caplog.records] == [
        "waited 0 ms",
        "waited 3 ms (and 2 times since this was said)",
    ]


class SlowCamera:
    """A camera that has a new image every so often, of an age when it comes."""

    def __init__(self, period_s, delay_s):
        self._period_s, self._delay_s = period_s, delay_s

    def read_latest(self, max_age_ms=500):
        age_s = self._delay_s + time.monotonic() % self._period_s
        if age_s * 1e3 > max_age_ms:
            raise TimeoutError(f"latest frame is too old: {age_s:.2f} s")
        return age_s


def test_cameras_that_are_slow_are_waited_for_while_they_show_something_new():
    slow = {"top": SlowCamera(0.3, 0.45), "wrist": SlowCamera(0.07, 0.3)}  # the former is seldom young enough
    begin = time.monotonic()
    images, waited = newest_images(slow, dict.fromkeys(slow, CameraSettings()))
    assert waited and images["top"] < 0.5 and time.monotonic() - begin > LATE_S
    always_late = {"top": SlowCamera(0.1, 0.51)}
    begin = time.monotonic()
    with pytest.raises(StaleStateError, match="camera top has no image: latest frame is too old"):
        newest_images(always_late, {"top": CameraSettings()})
    assert time.monotonic() - begin > PATIENCE_S


def test_a_dead_camera_is_told_of_however_slow_another_is(monkeypatch):
    monkeypatch.setattr("lerobot_robot_yam.face.devices.images._ASLEEP_S", math.inf)
    cameras = {"slow": SlowCamera(0.1, 0.51), "dead": Camera(fresh_after_s=60.0)}
    begin = time.monotonic()
    with pytest.raises(StaleStateError, match="camera dead"):
        newest_images(cameras, dict.fromkeys(cameras, CameraSettings()))
    assert time.monotonic() - begin < LATE_S + 0.2


def test_a_machine_that_stood_still_makes_no_camera_dead():
    for stall_s in (0.4, PATIENCE_S + 0.2):
        begin = time.monotonic()
        cameras = {"fine": StallingCamera([0.3], stall_s), "late": Camera(fresh_after_s=0.7 + stall_s)}
        assert newest_images(cameras, dict.fromkeys(cameras, CameraSettings()))[1]
        assert time.monotonic() - begin >= 0.7 + stall_s


def test_a_machine_that_stumbles_again_and_again_takes_what_lerobot_takes():
    cameras = {"fine": StallingCamera(np.arange(0.1, 60.0, 0.5), 0.12), "old": Camera(fresh_after_s=60.0, age_ms=300)}
    begin = time.monotonic()
    assert newest_images(cameras, dict.fromkeys(cameras, CameraSettings()))[1]
    assert LATE_S <= time.monotonic() - begin < PATIENCE_S


def test_a_camera_that_is_gone_is_told_of_at_once():
    camera = Camera()
    camera.read_latest = lambda **limit: [][0]
    begin = time.monotonic()
    with pytest.raises(StaleStateError, match="camera top has no image: list index"):
        newest_images({"top": camera}, {"top": CameraSettings()})
    assert time.monotonic() - begin < LATE_S


class TickingCamera:
    """A camera whose image changes at some moments, s from its making; before that it shows another."""

    def __init__(self, *moments_s):
        self._moments_s = time.monotonic() + np.asarray(moments_s)

    def read_latest(self, max_age_ms=500):
        return np.full((16, 16, 3), (time.monotonic() >= self._moments_s).sum(), np.uint8)


def read_twice(camera, pause_s, fps=30):
    """Two images of a camera, and whether the second one was waited for."""
    reader = ImageReader({"top": camera}, {"top": CameraSettings(fps=fps)})
    first, _ = reader.read()
    time.sleep(pause_s)
    second, waited = reader.read()
    return first["top"].max(), second["top"].max(), waited


def test_an_image_that_is_due_is_waited_for_and_not_read_twice():
    assert read_twice(TickingCamera(0.036), 0.03) == (0, 1, True)


def test_an_image_that_does_not_come_is_read_again_after_a_third_of_a_frame():
    begin = time.monotonic()
    assert read_twice(TickingCamera(60.0), 0.03) == (0, 0, True)
    assert 0.04 < time.monotonic() - begin < 0.06


@pytest.mark.parametrize("pause_s, fps", [(0.01, 30), (0.03, 5), (0.03, None)])
def test_an_image_that_is_not_due_is_not_waited_for(pause_s, fps):
    assert read_twice(TickingCamera(60.0), pause_s, fps) == (0, 0, False)


def test_a_camera_that_fails_while_its_image_is_due_keeps_the_last_one():
    camera = TickingCamera(60.0)
    reader = ImageReader({"top": camera}, {"top": CameraSettings()})
    reader.read()
    time.sleep(0.03)
    calls = iter([camera.read_latest()])
    camera.read_latest = lambda **limit: next(calls)
    assert reader.read()[0]["top"].max() == 0


@pytest.mark.alone
def test_a_late_image_is_waited_for_and_the_arm_is_read_after_it(rig, robot, caplog):
    robot.get_observation()
    rig.camera_fault("top", "stall", seconds=0.65)
    end = time.monotonic() + 3.0
    while "waited" not in caplog.text and time.monotonic() < end:
        observation = robot.get_observation()
        age_s = sample_age(observation)
        time.sleep(1 / 30)
    assert "ms for images: camera top: newest frame is" in caplog.text
    assert age_s < 0.05 and observation["top"].shape == (48, 64, 3)


@pytest.mark.alone
def test_an_image_that_does_not_come_is_told_of_within_a_second(rig, robot):
    robot.get_observation()
    rig.camera_fault("top", "stall")
    begin = time.monotonic()
    with pytest.raises(StaleStateError, match="camera top has no image.*the arms hold"):
        while time.monotonic() < begin + 5.0:
            robot.get_observation()
    assert 0.7 < time.monotonic() - begin < 1.0
