"""The disk: said at the start, and left before it is full; and for how long it lasts."""

import shutil
from types import SimpleNamespace

import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.recorder.disk_guard import LEFT_FREE, DiskGuard, DiskLeft, disk_warning

FEATURES = {
    "action": {"dtype": "float32", "shape": (14,)},
    "observation.images.top": {"dtype": "video", "shape": (480, 640, 3)},
}
FRAME, STILL = 1_000 + 480 * 640 * 0.03, 480 * 640 * 1.5
EPISODE = 20 * 30 * FRAME  # about 6 MB
MB = 1_000_000


def options(seconds=20.0, video=True, streaming=True):
    return SimpleNamespace(episode_time_s=seconds, video=video, streaming_encoding=streaming)


@pytest.fixture
def free(monkeypatch):
    """Sets what is free on every disk."""
    state = {"free": 10**12}
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=state["free"]))
    return lambda count: state.update(free=int(count))


@pytest.fixture
def guard(tmp_path, free):
    return DiskGuard(tmp_path, FEATURES, options(), 30)


def test_room_for_all_is_not_talked_of(guard, caplog):
    guard.check(50)
    assert caplog.text == "" and guard.room_for_another


def test_room_for_some_is_told(guard, free, caplog):
    free(LEFT_FREE + 10.5 * EPISODE)
    guard.check(50)
    assert "room for about 10 of 50 episodes" in caplog.text


def test_no_room_for_some_seconds_is_refused(guard, free, tmp_path):
    free(LEFT_FREE + 9 * 30 * FRAME)
    with pytest.raises(ConfigError, match=f"the disk of {tmp_path} is full"):
        guard.check(1)


@pytest.mark.parametrize("seconds", [3600.0, float("inf")])
def test_a_time_that_nobody_waits_for_is_no_reason_to_refuse(tmp_path, free, seconds):
    """Episodes are ended by key then."""
    free(LEFT_FREE + 2e9)
    DiskGuard(tmp_path, FEATURES, options(seconds), 30).check(1)


def test_images_before_encoding_need_room_too(tmp_path, free):
    guard = DiskGuard(tmp_path, FEATURES, options(streaming=False), 30)
    free(LEFT_FREE + 9 * 30 * STILL)
    with pytest.raises(ConfigError, match="is full"):
        guard.check(1)
    guard.saved(600)
    free(LEFT_FREE + 600 * STILL)  # its videos took next to nothing, its images as much as this
    assert not guard.room_for_another
    free(LEFT_FREE + 2.0 * 600 * STILL)
    assert guard.room_for_another


def test_what_episodes_have_really_taken_counts(guard, free, tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "frame.png").write_bytes(bytes(90_000_000))  # about to be encoded, and removed
    (tmp_path / "video.mp4").write_bytes(bytes(40_000_000))
    guard.saved(600)
    free(LEFT_FREE + 50e6)  # eight of those that were expected, not one and a half of these
    assert not guard.room_for_another
    free(LEFT_FREE + 70e6)
    assert guard.room_for_another


def looked(disk, seconds, begin_s, free, rate, recording=True):
    """A look each half second; returns the last answer and what is free then."""
    left_s = None
    for half in range(2 * seconds):
        left_s = disk.left_s(begin_s + half / 2.0, free, recording)
        free -= int(rate / 2.0)
    return left_s, free


def test_time_left_is_what_may_be_filled_over_the_rate():
    left_s, free = looked(DiskLeft(), 60, 0.0, LEFT_FREE + 1_000 * MB, MB)
    assert left_s == pytest.approx((free - LEFT_FREE) / MB, rel=0.01)


def test_a_reset_takes_no_time_of_recording():
    disk = DiskLeft()
    _, free = looked(disk, 30, 0.0, LEFT_FREE + 1_000 * MB, MB)
    looked(disk, 600, 30.0, free, 0, recording=False)
    left_s, free = looked(disk, 30, 630.0, free, MB)
    assert left_s == pytest.approx((free - LEFT_FREE) / MB, rel=0.02)


def test_images_that_become_a_video_count_as_the_video():
    disk, free, left_s = DiskLeft(), LEFT_FREE + 20_000 * MB, None
    for episode in range(30):
        looked(disk, 30, 60.0 * episode, free, 40 * MB)
        free -= 30 * MB  # its images are encoded, and removed
        left_s, _ = looked(disk, 30, 60.0 * episode + 30.0, free, 0, recording=False)
    assert left_s == pytest.approx((free - LEFT_FREE) / MB, rel=0.1)


@pytest.mark.parametrize(("seconds", "rate"), [(4, MB), (60, 0), (60, -MB)], ids=["too early", "nothing", "gets free"])
def test_what_is_not_known_is_not_said(seconds, rate):
    left_s, _ = looked(DiskLeft(), seconds, 0.0, LEFT_FREE + 1_000 * MB, rate)
    assert left_s is None and disk_warning(left_s, 2 * LEFT_FREE) == ""


def test_the_warning_comes_in_time():
    assert disk_warning(3600.0, 2 * LEFT_FREE) == ""
    assert "is full in 4.5 min" in disk_warning(270.0, 2 * LEFT_FREE)
    assert "the recording ends" in disk_warning(None, LEFT_FREE - 1)
