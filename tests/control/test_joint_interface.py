"""Commands of joints become the frames of their motors."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.joints.joint_interface import JointInterface
from lerobot_robot_yam.damiao.codec import decode_mit
from lerobot_robot_yam.errors import ActionError
from tests.support.desk_bus import DeskBus
from tests.support.rigged import STOPS

STEP_RAD = 25.0 / 65535  # one code of the position


@pytest.fixture
def drive():
    hardware = ResolvedArm(ArmConfig(name="arm", channel="desk", gripper_stops_rad=STOPS))
    with DeskBus(hardware.motors) as bus:
        drive = JointInterface(hardware, bus)
        drive.bus = bus
        yield drive


def commands(q):
    table = np.zeros((7, 5))
    table[:, 0] = q
    return table


def sent_q(drive):
    """Positions of the last tick that went out, in motor coordinates."""
    types = [motor.type for motor in drive.chain.motors]
    return [decode_mit(kind, bytes(m.data))[0] for kind, m in zip(types, drive.bus.sent[-7:], strict=True)]


def test_commands_go_out_in_motor_coordinates(drive):
    drive.send(commands(0.5))
    np.testing.assert_allclose(np.abs(sent_q(drive)), 0.5, atol=2 * STEP_RAD)


def test_a_joint_that_is_put_on_another_turn_is_sent_there(drive):
    before = 0.5 * drive._hardware.direction[-1]
    drive.shift_gripper(2.0)
    drive.send(commands(0.5))
    np.testing.assert_allclose(sent_q(drive)[-1], before + drive.offset_rad[-1], atol=2 * STEP_RAD)
    assert abs(drive.offset_rad[-1]) == 2.0


def test_commands_that_cannot_be_encoded_spoil_nothing(drive):
    drive.send(commands(0.5))
    bad = commands(0.1)
    bad[6, 4] = np.nan
    drive.bus.sent.clear()
    with pytest.raises(ActionError):
        drive.send(bad)
    assert not drive.bus.sent
    drive.send(commands(0.5))
    assert len(drive.bus.sent) == 7
    np.testing.assert_allclose(np.abs(sent_q(drive)), 0.5, atol=2 * STEP_RAD)
