"""Images that are late are waited for, and those that do not come end the observation."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from lerobot_robot_yam.config_yam_follower import YamFollowerConfig
from lerobot_robot_yam.errors import StaleStateError
from lerobot_robot_yam.face.devices import images
from lerobot_robot_yam.face.devices.images import LATE_S, PATIENCE_S, ImageReader, newest_images
from lerobot_robot_yam.yam_follower import YamFollower
from tests.support.rigged import STOPS, rig_of


@pytest.fixture
def clock(monkeypatch):
    """Time that passes only while somebody sleeps."""
    now = [100.0]

    def sleep(seconds):
        now[0] += seconds

    clock = SimpleNamespace(monotonic=lambda: now[0], sleep=sleep)
    monkeypatch.setattr(images, "time", clock)
    return clock


class Camera:
    """A camera of LeRobot's kind whose image is of an age until a moment; the machine may stand still in its calls.

    Args:
        clock: of the test.
        fresh_after_s: from then on the image is new.
        age_ms: before.
        stalls_s, stall_s: when the machine stands still, and for how long each time.
    """

    def __init__(self, clock, fresh_after_s=0.0, age_ms=1000, stalls_s=(), stall_s=0.0):
        self._clock, self._fresh_at, self._age_ms = clock, clock.monotonic() + fresh_after_s, age_ms
        self._stalls_at, self._stall_s = list(clock.monotonic() + np.asarray(stalls_s)), stall_s
        self.reads = 0

    def read_latest(self, max_age_ms=500):
        if self._stalls_at and self._clock.monotonic() >= self._stalls_at[0]:
            self._stalls_at.pop(0)
            self._clock.sleep(self._stall_s)
        self.reads += 1
        if self._clock.monotonic() < self._fresh_at and max_age_ms <= self._age_ms:
            raise TimeoutError("latest frame is too old")
        return self.reads

    read_latest_depth = read_latest


@dataclass
class CameraSettings:
    use_rgb: bool = True
    use_depth: bool = False
    fps: int | None = 30


def read(cameras, **settings):
    """Images of cameras, and what is said of a wait."""
    return newest_images(cameras, dict.fromkeys(cameras, CameraSettings(**settings)))


def test_what_was_read_before_the_wait_is_read_again(clock):
    cameras = {"top": Camera(clock), "wrist": Camera(clock, fresh_after_s=0.1)}
    seen, waited = read(cameras)
    assert waited and list(seen) == ["top", "wrist"]
    assert seen["top"] == cameras["top"].reads > 1


def test_colour_and_depth_are_of_one_time(clock):
    seen, waited = read({"top": Camera(clock, fresh_after_s=0.1)}, use_depth=True)
    assert waited and seen["top_depth"] - seen["top"] == 1


def test_images_that_are_fresh_are_read_once(clock, caplog):
    assert read({"top": Camera(clock), "wrist": Camera(clock)}) == ({"top": 1, "wrist": 1}, "")
    assert not caplog.text


@pytest.mark.parametrize(
    "age_ms, fps, waits", [(190, 30, False), (210, 30, True), (210, None, True), (390, 5, False), (410, 5, True)]
)
def test_how_old_an_image_may_be_without_a_wait(clock, age_ms, fps, waits):
    cameras = {"top": Camera(clock, fresh_after_s=0.1, age_ms=age_ms)}
    assert read(cameras, fps=fps)[1].startswith("waited") is waits


def test_late_images_are_said_at_once_and_then_seldom(clock, caplog):
    camera = Camera(clock)
    number_of = camera.read_latest
    camera.read_latest = lambda **limit: np.full((16, 16, 3), number_of(**limit) % 256, np.uint8)
    reader = ImageReader({"top": camera}, {"top": CameraSettings(fps=None)})
    for number in range(4):
        clock.sleep(31.0 if number == 3 else 1.0)
        camera._fresh_at = clock.monotonic() + 0.1
        reader.read()
    said = [record.getMessage() for record in caplog.records]
    assert len(said) == 2 and all(text.startswith("waited 10") for text in said)
    assert said[1].endswith("(and 2 times since this was said)") and "since" not in said[0]


class SlowCamera:
    """A camera that has a new image every so often, of an age when it comes."""

    def __init__(self, clock, period_s, delay_s):
        self._clock, self._period_s, self._delay_s = clock, period_s, delay_s

    def read_latest(self, max_age_ms=500):
        age_s = self._delay_s + self._clock.monotonic() % self._period_s
        if age_s * 1e3 > max_age_ms:
            raise TimeoutError(f"latest frame is too old: {age_s:.2f} s")
        return age_s


def test_cameras_that_are_slow_are_waited_for_while_they_show_something_new(clock):
    begin = clock.monotonic()
    seen, waited = read({"top": SlowCamera(clock, 0.3, 0.45), "wrist": SlowCamera(clock, 0.07, 0.3)})
    assert waited and seen["top"] < 0.5 and clock.monotonic() - begin > LATE_S
    begin = clock.monotonic()
    with pytest.raises(StaleStateError, match="camera top has no image: latest frame is too old"):
        read({"top": SlowCamera(clock, 0.1, 0.51)})
    assert clock.monotonic() - begin > PATIENCE_S


def test_a_dead_camera_is_told_of_however_slow_another_is(clock):
    begin = clock.monotonic()
    with pytest.raises(StaleStateError, match="camera dead"):
        read({"slow": SlowCamera(clock, 0.1, 0.51), "dead": Camera(clock, fresh_after_s=60.0)})
    assert clock.monotonic() - begin < LATE_S + 0.2


@pytest.mark.parametrize("stall_s", [0.4, PATIENCE_S + 0.2])
def test_a_machine_that_stood_still_makes_no_camera_dead(clock, stall_s):
    begin = clock.monotonic()
    late = Camera(clock, fresh_after_s=0.7 + stall_s)
    assert read({"fine": Camera(clock, stalls_s=[0.3], stall_s=stall_s), "late": late})[1]
    assert clock.monotonic() - begin >= 0.7 + stall_s


def test_a_machine_that_stumbles_again_and_again_takes_what_lerobot_takes(clock):
    begin = clock.monotonic()
    fine = Camera(clock, stalls_s=np.arange(0.1, 60.0, 0.5), stall_s=0.12)
    assert read({"fine": fine, "old": Camera(clock, fresh_after_s=60.0, age_ms=300)})[1]
    assert LATE_S <= clock.monotonic() - begin < PATIENCE_S


def test_a_camera_that_is_gone_is_told_of_at_once(clock):
    camera, begin = Camera(clock), clock.monotonic()
    camera.read_latest = lambda **limit: [][0]
    with pytest.raises(StaleStateError, match="camera top has no image: list index"):
        read({"top": camera})
    assert clock.monotonic() == begin


class TickingCamera:
    """A camera whose image changes at some moments, s from its making; before that it shows another."""

    def __init__(self, clock, *moments_s):
        self._clock, self._moments_s = clock, clock.monotonic() + np.asarray(moments_s)

    def read_latest(self, max_age_ms=500):
        return np.full((16, 16, 3), (self._clock.monotonic() >= self._moments_s).sum(), np.uint8)


def read_twice(clock, camera, pause_s, fps=30):
    """Two images of a camera, whether the second one was waited for, and how long, s."""
    reader = ImageReader({"top": camera}, {"top": CameraSettings(fps=fps)})
    first, _ = reader.read()
    clock.sleep(pause_s)
    begin = clock.monotonic()
    second, waited = reader.read()
    return first["top"].max(), second["top"].max(), waited, clock.monotonic() - begin


def test_an_image_that_is_due_is_waited_for_and_not_read_twice(clock):
    assert read_twice(clock, TickingCamera(clock, 0.036), 0.03)[:3] == (0, 1, True)


@pytest.mark.parametrize(
    "pause_s, fps, waits", [(0.03, 30, True), (0.01, 30, False), (0.03, 5, False), (0.03, None, False)]
)
def test_an_image_that_does_not_come_is_read_again_after_a_third_of_a_frame(clock, pause_s, fps, waits):
    *seen, waited, took_s = read_twice(clock, TickingCamera(clock, 60.0), pause_s, fps)
    assert seen == [0, 0] and waited is waits
    assert 0.010 < took_s < 0.013 if waits else took_s == 0.0


def test_a_camera_that_fails_while_its_image_is_due_keeps_the_last_one(clock):
    camera = TickingCamera(clock, 60.0)
    reader = ImageReader({"top": camera}, {"top": CameraSettings()})
    reader.read()
    clock.sleep(0.03)
    calls = iter([camera.read_latest()])
    camera.read_latest = lambda **limit: next(calls)
    assert reader.read()[0]["top"].max() == 0


def test_the_arm_is_read_after_an_image_that_was_late(tmp_path, monkeypatch, caplog):
    with rig_of("lockstep", arms=["follower_left"]) as rig:
        options = {"interface": "yam_lockstep", "can_options": {"rig": rig.name}, "gripper_stops_rad": STOPS}
        robot = YamFollower(
            YamFollowerConfig(channel="follower_left", calibration_dir=tmp_path, isolation="lockstep", **options)
        )
        robot.connect()
        clock = SimpleNamespace(monotonic=robot.clock.now, sleep=robot.clock.sleep)
        monkeypatch.setattr(images, "time", clock)
        robot._images = ImageReader({"top": Camera(clock, fresh_after_s=0.3)}, {"top": CameraSettings()})
        robot.send_action(dict(zip(robot.action_features, robot.joints() + 0.4, strict=True)))
        observation = robot.get_observation()
        q = rig.state()["arms"]["follower_left"]["q"]
        robot.discard()
    assert "ms for images: latest frame is too old" in caplog.text
    assert q[0] > 0.1 and observation["joint_1.pos"] == pytest.approx(q[0], abs=0.02)
