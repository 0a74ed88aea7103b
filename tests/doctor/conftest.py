"""A virtual rig for the doctor, well or sick."""

import can
import pytest

from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.rig.control import running_rig
from tests.support.doctor_desk import FOLLOWER, LEADER, MOTORS


@pytest.fixture(scope="module")
def rig():
    with running_rig(arms=[FOLLOWER, LEADER]) as rig:
        yield rig


@pytest.fixture
def sick(rig):
    """The rig, made well again after the test."""
    with can.Bus(interface="yam_sim", channel=FOLLOWER, rig=rig.name) as bus:
        chain = MotorChain(bus, MOTORS, channel=FOLLOWER)
        names = (Register.PMAX, Register.VMAX, Register.TMAX, Register.TIMEOUT, Register.CTRL_MODE, Register.GR)
        before = [(spec, r, chain.read_register(i, r)) for i, spec in enumerate(MOTORS) for r in names]
    yield rig
    for channel in (FOLLOWER, LEADER):
        rig.clear_faults(channel)
    rig.trigger(LEADER, 0.0)
    for spec, register, value in before:
        rig.fault(FOLLOWER, spec.name, "register", value, register=int(register))
        rig.fault(FOLLOWER, spec.name, "register", spec.can_id, register=int(Register.ESC_ID))
        rig.fault(FOLLOWER, spec.name, "register", spec.feedback_id, register=int(Register.MST_ID))
    for spec in MOTORS:
        rig.fault(FOLLOWER, spec.name, "nibble", int(Fault.OVERLOAD))
    with can.Bus(interface="yam_sim", channel=FOLLOWER, rig=rig.name) as bus:
        MotorChain(bus, MOTORS, channel=FOLLOWER).special(SpecialCommand.CLEAR)
