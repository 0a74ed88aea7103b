"""Sticks to velocities: shape, speeds, slow, troubles, the emergency stop, and requests without a base."""

import pytest

from lerobot_robot_yam.face.driving.base_drive import Asked, BaseDrive, shaped
from lerobot_robot_yam.face.driving.drive_options import DriveOptions
from lerobot_robot_yam.state.emergency_stop import EmergencyStop

REST = {"x.vel": 0.0, "y.vel": 0.0, "theta.vel": 0.0, "height.vel": 0.0}
FULL = {"x.vel": 0.5, "y.vel": 0.5, "theta.vel": 90.0, "height.vel": 0.4}
PUSHED = Asked((1.0, 1.0, 1.0, 1.0))


@pytest.fixture
def stop():
    stop = EmergencyStop()
    yield stop
    stop.release()


@pytest.fixture
def drive(stop):
    return BaseDrive("yam_gamepad", DriveOptions(rail=True, rail_speed=0.4), stop)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stick_is_shaped(sign):
    assert shaped(0.05 * sign, 0.05, 0.3) == 0.0 and shaped(sign, 0.05, 0.3) == pytest.approx(sign)
    assert shaped(0.51 * sign, 0.02, 0.0) == pytest.approx(0.5 * sign)
    assert shaped(0.51 * sign, 0.02, 1.0) == pytest.approx(0.125 * sign)
    assert shaped(0.0501 * sign, 0.05, 0.3) * sign < 1e-4  # no jump at the edge of the dead zone


def test_full_sticks_are_full_speed_and_slow_is_a_share(drive):
    assert drive.action(PUSHED) == pytest.approx(FULL)
    assert drive.action(Asked((-1.0, 0.5, 0.0, 0.0), slow=True)) == pytest.approx(
        {"x.vel": -0.15, "y.vel": 0.075, "theta.vel": 0.0, "height.vel": 0.0}
    )


def test_a_base_without_a_rail_has_no_such_key(stop):
    action = BaseDrive("yam_gamepad", DriveOptions(), stop).action(PUSHED)
    assert action == pytest.approx({"x.vel": 0.5, "y.vel": 0.5, "theta.vel": 90.0})


def test_trouble_brakes_once_said_until_the_sticks_are_let_go(drive, caplog):
    drive.action(PUSHED)
    for _ in range(3):
        assert drive.action(Asked(trouble="the gamepad Pad is unplugged")) == REST
    errors = [record.message for record in caplog.records if record.levelname == "ERROR"]
    assert len(errors) == 1 and "Pad is unplugged; the base brakes" in errors[0]
    assert drive.action(PUSHED) == REST  # it came back with a pushed stick
    assert drive.action(Asked()) == REST
    assert drive.action(PUSHED) == pytest.approx(FULL)


def test_the_emergency_stop_ends_only_by_its_release_and_then_at_rest(drive, stop):
    stop.latch("somebody shouted")
    assert drive.action(PUSHED) == REST and drive.action(Asked()) == REST and drive.action(PUSHED) == REST
    stop.release()
    assert drive.action(PUSHED) == REST  # a stick that is still pushed moves nothing
    drive.action(Asked())
    assert drive.action(PUSHED) == pytest.approx(FULL)


@pytest.mark.parametrize(
    ("press", "why"), [("frame", "stays in the local frame"), ("reset", "the odometry is not reset")]
)
def test_without_a_base_there_is_no_heading(drive, caplog, press, why):
    drive.action(Asked(presses=[press]))
    assert f"{why}: only a base that is connected in this process" in caplog.text
    assert drive.action(PUSHED) == pytest.approx(FULL)


@pytest.mark.parametrize("press", ["frame", "reset"])
def test_frame_and_odometry_change_at_rest_only(drive, caplog, press):
    drive.action(Asked((0.2, 0.0, 0.0, 0.0), presses=[press]))
    assert "let go of all sticks before" in caplog.text
