"""The disk: said at the start, and left before it is full."""

import shutil
from types import SimpleNamespace

import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.recorder.disk_guard import DiskGuard

FEATURES = {
    "action": {"dtype": "float32", "shape": (14,)},
    "observation.images.top": {"dtype": "video", "shape": (480, 640, 3)},
}
FRAME, STILL = 1_000 + 480 * 640 * 0.03, 480 * 640 * 1.5
EPISODE = 20 * 30 * FRAME  # about 6 MB
LEFT = 1e8


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
    free(LEFT + 10.5 * EPISODE)
    guard.check(50)
    assert "room for about 10 of 50 episodes" in caplog.text


def test_no_room_for_some_seconds_is_refused(guard, free, tmp_path):
    free(LEFT + 9 * 30 * FRAME)
    with pytest.raises(ConfigError, match=f"the disk of {tmp_path} is full"):
        guard.check(1)


@pytest.mark.parametrize("seconds", [3600.0, float("inf")])
def test_a_time_that_nobody_waits_for_is_no_reason_to_refuse(tmp_path, free, seconds):
    """Episodes are ended by key then."""
    free(LEFT + 2e9)
    DiskGuard(tmp_path, FEATURES, options(seconds), 30).check(1)


def test_images_before_encoding_need_room_too(tmp_path, free):
    guard = DiskGuard(tmp_path, FEATURES, options(streaming=False), 30)
    free(LEFT + 9 * 30 * STILL)
    with pytest.raises(ConfigError, match="is full"):
        guard.check(1)
    guard.saved(600)
    free(LEFT + 600 * STILL)  # its videos took next to nothing, its images as much as this
    assert not guard.room_for_another
    free(LEFT + 2.0 * 600 * STILL)
    assert guard.room_for_another


def test_what_episodes_have_really_taken_counts(guard, free, tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "frame.png").write_bytes(bytes(90_000_000))  # about to be encoded, and removed
    (tmp_path / "video.mp4").write_bytes(bytes(40_000_000))
    guard.saved(600)
    free(LEFT + 50e6)  # eight of those that were expected, not one and a half of these
    assert not guard.room_for_another
    free(LEFT + 70e6)
    assert guard.room_for_another
