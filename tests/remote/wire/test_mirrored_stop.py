"""The stop of another computer is latched here, whatever was in the way at first, and ends with it."""

import pytest

from lerobot_robot_yam.remote.wire.mirrored_stop import MirroredStop
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.system.runtime_files import runtime_dir


@pytest.fixture
def stop():
    stop = EmergencyStop()
    yield stop
    stop.release()


def test_it_is_latched_and_released_as_there(stop):
    mirror = MirroredStop("host pi")
    mirror.follow(True, "a test")
    assert stop.reason().startswith("host pi: a test") and mirror.taken_over and not mirror.own
    mirror.follow(False, "")
    assert not stop.latched
    stop.latch("somebody here")
    mirror.follow(False, "")
    assert stop.latched and mirror.own


def test_a_stop_that_cannot_be_latched_is_told_once_and_tried_again(stop, caplog):
    in_the_way = runtime_dir() / "emergency-stop"
    in_the_way.symlink_to("/nowhere")
    mirror = MirroredStop("host pi")
    try:
        for _ in range(3):
            mirror.follow(True, "a test")
            assert mirror.unwritten and not stop.latched
    finally:
        in_the_way.unlink()
    (told,) = [record.getMessage() for record in caplog.records]
    assert told.startswith("host pi: its emergency stop cannot be latched here") and str(runtime_dir()) in told
    mirror.follow(True, "a test")
    assert not mirror.unwritten and stop.latched
    mirror.follow(False, "")
    assert not stop.latched
