"""A robot of an arm and a base in one loop: what one part suffers, the other is commanded through."""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from tests.support.rigged import session_on, sim_config

ARM = "follower_left"


@pytest.fixture
def robot():
    with contextlib.closing(LockstepRig("mobile_tables", arms=[ARM])) as rig:
        base = BaseConfig(channel="base", interface="yam_lockstep", can_options={"rig": rig.name})
        session = session_on(rig, sim_config(rig, ARM), base)
        session.start()
        yield rig, session
        session.discard()


def parts_of(session):
    return {part.name: part for part in session._runner._loop._controllers}


def raises(*_, **__):
    raise ValueError("a test")


def test_a_defect_in_the_plan_of_the_base_is_no_fault_of_the_arm(robot, monkeypatch):
    _, session = robot
    q = session[ARM].observe().q
    monkeypatch.setattr(parts_of(session)["base"].motion, "advance", raises)
    session.clock.sleep(0.5)
    assert session.base("base").published().trouble is Trouble.INTERNAL_ERROR
    assert session[ARM].published().trouble is None and session[ARM].mode() is Mode.HOLD
    assert session[ARM].observe().q == pytest.approx(q, abs=0.01)


def test_a_fault_of_the_arm_stops_the_base_until_both_are_re_armed(robot):
    rig, session = robot
    base = session.base("base")
    for _ in range(40):
        base.write_velocity([-0.3, 0.0, 0.0])
        session.clock.sleep(0.05)
    rig.fault(ARM, "joint_3", "silent", True)
    session.clock.sleep(0.1 + 0.3 / 0.25 + 0.3)
    assert np.abs(base.observe().twist).max() < 0.01
    with pytest.raises(MotorError, match="joint_3"):
        session[ARM].observe()
    base.write_velocity([-0.3, 0.0, 0.0])
    session.clock.sleep(0.3)
    assert base.observe().mode is Mode.HOLD
    rig.fault(ARM, "joint_3", "silent", False)
    session.rearm()
    for _ in range(40):
        base.write_velocity([-0.3, 0.0, 0.0])
        session.clock.sleep(0.05)
    assert base.observe().twist[0] == pytest.approx(-0.3, abs=0.03)


def test_the_base_keeps_its_torque_until_the_arm_has_landed(robot):
    rig, session = robot
    for _ in range(40):
        session[ARM].write_target([0.0, 1.2, 1.2, 0.0, 0.0, 0.0], 0.5)
        session.clock.sleep(0.05)
    session.begin_stop()
    off = {}
    while len(off) < 2:
        session.clock.sleep(0.02)
        modes = {"base": session.base("base").mode(), ARM: session[ARM].mode()}
        off |= {name: session.clock.now() for name, mode in modes.items() if mode is Mode.OFF and name not in off}
    assert off["base"] >= off[ARM] and list(off)[0] == ARM
