"""Keys count as held for a short time; the emergency stop acts at once."""

import pytest

from lerobot_robot_yam.face.driving.base_drive import BaseDrive
from lerobot_robot_yam.face.driving.drive_options import DriveOptions
from lerobot_robot_yam.face.driving.held_keys import HeldKeys
from lerobot_robot_yam.state.emergency_stop import EmergencyStop


@pytest.fixture
def stop():
    stop = EmergencyStop()
    yield stop
    stop.release()


@pytest.fixture
def time():
    return [100.0]


@pytest.fixture
def keys(stop, time):
    return HeldKeys(0.2, stop, lambda: time[0])


def test_a_key_is_held_while_it_repeats(keys, time):
    for _ in range(10):
        keys.typed("i")
        assert keys.asked().deflection == (1.0, 0.0, 0.0, 0.0)
        time[0] += 0.09
        assert keys.asked().deflection == (1.0, 0.0, 0.0, 0.0)
    time[0] += 0.12
    assert keys.asked().deflection == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("typed", "deflection"),
    [
        ("k", (-1, 0, 0, 0)),
        ("j", (0, 1, 0, 0)),
        ("l", (0, -1, 0, 0)),
        ("u", (0, 0, 1, 0)),
        ("o", (0, 0, -1, 0)),
        ("t", (0, 0, 0, 1)),
        ("g", (0, 0, 0, -1)),
        ("I", (1, 0, 0, 0)),
        ("iu", (1, 0, 1, 0)),
        ("ik", (0, 0, 0, 0)),
        ("nrq", (0, 0, 0, 0)),
    ],
)
def test_each_key_has_its_way(keys, typed, deflection):
    for key in typed:
        keys.typed(key)
    assert keys.asked().deflection == deflection


def test_it_begins_slow_and_a_press_counts_once(keys):
    assert keys.asked().slow
    keys.typed("v")
    keys.typed("f")
    keys.typed("z")
    asked = keys.asked()
    assert not asked.slow and list(asked.presses) == ["frame", "reset"] and not keys.asked().presses


def test_a_press_that_nobody_asked_for_in_time_does_not_count(keys, time):
    """LeRobot asks for no action while it saves an episode."""
    keys.typed("z")
    time[0] += 0.4
    keys.typed("f")
    time[0] += 0.2
    assert list(keys.asked().presses) == ["frame"]
    keys.typed("z")
    time[0] += 0.6
    assert not keys.asked().presses


def test_a_stop_that_was_released_between_two_actions_brakes_until_the_key_is_let_go(keys, stop, time):
    drive = BaseDrive("yam_base_keys", DriveOptions(), stop)
    keys.typed("i")
    assert drive.action(keys.asked())["x.vel"] > 0.0
    stop.latch("somebody shouted")
    keys.typed("i")
    stop.release()
    for _ in range(3):  # the terminal repeats it
        keys.typed("i")
        assert not any(drive.action(keys.asked()).values())
    time[0] += 0.3
    assert not any(drive.action(keys.asked()).values())
    keys.typed("i")
    assert drive.action(keys.asked())["x.vel"] > 0.0


def test_the_emergency_stop(keys, stop):
    keys.typed("x")
    assert stop.latched and "key x of yam_base_keys" in stop.reason()
    keys.typed("x")
    assert stop.latched
