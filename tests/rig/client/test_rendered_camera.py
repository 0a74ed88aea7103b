"""Rendered cameras, through the processes that a user has: a rig, its renderer, a client."""

import contextlib
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from lerobot_robot_yam.errors import ConfigError, RigError, StaleStateError
from lerobot_robot_yam.rig.client.rendered_camera import RigCamera
from lerobot_robot_yam.rig.control import RigControl, running_rig, runs
from lerobot_robot_yam.system.runtime_files import runtime_dir
from tests.support.waiting import wait

pytestmark = pytest.mark.alone


@pytest.fixture(scope="module")
def rig():
    with running_rig() as rig, RigCamera("overview", 32, 24, 1, rig=rig.name):  # its renderer stays up
        yield rig


def renderer_pids(rig: RigControl) -> list[int]:
    """Children of the rig's server that draw."""
    found = []
    for child in Path(f"/proc/{rig.pid}/task/{rig.pid}/children").read_text().split():
        with contextlib.suppress(OSError):  # it has ended since
            if b"render.renderer" in Path(f"/proc/{child}/cmdline").read_bytes():
                found.append(int(child))
    return found


@pytest.mark.parametrize("name", ["wrist_left", "overview"])
def test_every_camera_shows_something(rig, name):
    with RigCamera(name, 160, 120, 30, rig=rig.name) as camera:
        frame, stamp_s = camera.latest(max_age_s=5.0)
    assert frame.shape == (120, 160, 3) and frame.dtype == np.uint8
    assert 0.0 <= time.monotonic() - stamp_s < 10.0
    assert len(np.unique(frame.reshape(-1, 3), axis=0)) > 30


def test_a_frame_that_was_read_is_not_copied_again(rig):
    with RigCamera("top", 32, 24, 1, rig=rig.name) as camera:
        frame, _ = camera.wait_new(5.0)
        assert camera.latest(5.0)[0] is frame
        assert camera.wait_new(5.0)[0] is not frame


def test_the_picture_follows_the_world(rig):
    def red(frame: np.ndarray) -> np.ndarray:
        r, g, b = np.moveaxis(frame.astype(int), 2, 0)
        return (r > 120) & (g < 80) & (b < 80)

    def centre(y_m: float) -> float:
        rig.place("cube", [0.45, y_m, 0.02])
        placed_s = time.monotonic()
        while True:
            frame, stamp_s = camera.wait_new(5.0)
            if stamp_s > placed_s + 0.05:
                return float(np.argwhere(red(frame))[:, 1].mean())

    with RigCamera("top", 160, 120, 30, rig=rig.name) as camera:
        # It looks down, away from the operator is up: the rig's left is on the picture's left.
        assert centre(0.15) < 80 - 10
        assert centre(-0.15) > 80 + 10


def test_frames_are_new_in_order_and_come_at_the_rate_asked_for(rig):
    with RigCamera("top", 64, 48, 10, rig=rig.name) as camera:
        stamps = [camera.wait_new(5.0)[1] for _ in range(8)]
    assert (np.diff(stamps) > 0).all()
    # A busy machine can only make frames later, never more frequent.
    assert np.median(np.diff(stamps)) > 0.07


def test_two_clients_share_a_camera_and_one_may_leave(rig):
    first, second = (RigCamera("top", 64, 48, 30, rig=rig.name) for _ in range(2))
    first.connect()
    second.connect()
    first.close()
    first.close()
    frames = [second.wait_new(5.0)[1] for _ in range(3)]
    assert len(set(frames)) == 3
    second.close()
    assert not first.is_connected and not second.is_connected


def test_unknown_camera_is_refused_with_the_list(rig):
    with pytest.raises(ConfigError, match="nowhere.*front, overview, top, wrist_left, wrist_right"):
        RigCamera("nowhere", rig=rig.name).connect()


@pytest.mark.parametrize("settings", [(8, 240, 30), (320, 5000, 30), (320, 240, 0), (320, 240, 1000), (320.0, 240, 30)])
def test_impossible_settings_are_refused(rig, settings):
    with pytest.raises(ConfigError, match="camera top"):
        RigCamera("top", *settings, rig=rig.name).connect()


def test_a_camera_that_is_not_connected_says_so(rig):
    with pytest.raises(RigError, match="connect"):
        RigCamera("top", rig=rig.name).latest()


def test_a_stopped_renderer_means_stale_a_dead_one_an_error_and_nothing_is_left_behind():
    with running_rig() as rig:
        _stop_and_kill(rig)
        pids = renderer_pids(rig)
        assert len(pids) == 1
    wait(lambda: not runs(pids[0]))
    assert not list(runtime_dir().glob(f"rig-{rig.name}.*"))


def _stop_and_kill(rig: RigControl) -> None:
    with RigCamera("top", 64, 48, 30, rig=rig.name) as camera:
        (pid,) = renderer_pids(rig)
        time.sleep(0.1)  # frames that nobody reads: afterwards they are old, not new
        os.kill(pid, signal.SIGSTOP)
        time.sleep(0.6)
        with pytest.raises(StaleStateError, match="camera top"):
            camera.latest(max_age_s=0.3)
        os.kill(pid, signal.SIGKILL)
        wait(lambda: pid not in renderer_pids(rig))
        with pytest.raises(RigError, match="SIGKILL"):
            camera.wait_new(0.5)
    with RigCamera("top", 64, 48, 30, rig=rig.name) as camera:  # a new one is started
        assert camera.latest(max_age_s=5.0)[0].any()


def test_no_opengl_is_a_clear_error_and_the_rig_lives_on(monkeypatch):
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_DIRS", "/nonexistent")
    with running_rig() as rig:
        with pytest.raises(RigError, match="OpenGL.*libegl1"):
            RigCamera("top", rig=rig.name).connect()
        assert rig.state()["sim_s"] > 0


def test_nothing_is_left_when_the_rig_is_killed():
    rig = RigControl.start()
    with RigCamera("top", 64, 48, 30, rig=rig.name) as camera:
        (pid,) = renderer_pids(rig)
        os.kill(rig.pid, signal.SIGKILL)
        wait(lambda: not runs(pid))
        with pytest.raises((RigError, StaleStateError)):
            while True:
                camera.wait_new(0.5)
        rig.close()
    assert not list(runtime_dir().glob(f"rig-{rig.name}.camera-*"))
    for path in runtime_dir().glob(f"rig-{rig.name}.*"):  # the server's own; a start sweeps when this process is gone
        path.unlink()


@pytest.mark.long
@pytest.mark.parametrize("closed", [False, True])
def test_nothing_is_left_of_a_renderer_that_hangs(closed):
    with running_rig() as rig, RigCamera("top", 64, 48, 30, rig=rig.name) as camera:
        (pid,) = renderer_pids(rig)
        os.kill(pid, signal.SIGSTOP)
        if closed:
            camera.close()
            time.sleep(0.2)
        rig.end()
        wait(lambda: not runs(rig.pid) and not runs(pid))
        assert not list(runtime_dir().glob(f"rig-{rig.name}.*"))
