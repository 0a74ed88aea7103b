"""A joint that a landing lets sink while its motor is not heard gets no stiffness back where it has left its set-point.

Its motor obeys, but nobody knows where it is: a command with stiffness about the last set-point would throw it there.
"""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.control.arm_controller import ArmController
from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, channel_key, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock
from scripts import recorders
from tests.support.rigged import lockstep_rig, session_on, sim_config

CHANNEL = "follower_left"
REST = [0.0, 0.25, 2.9, 0.0, 0.0, 0.0]  # in the air: it sinks from there
MOVED_RAD = 0.5


rig = lockstep_rig(CHANNEL)


@pytest.fixture
def sunk(rig):
    """A session and its controller. Its joint_2 has sunk unheard in a landing, and is far from its set-point now."""
    rig.set_pose(CHANNEL, REST)
    session = session_on(rig, sim_config(rig, CHANNEL, rest_q_rad=REST))
    session.start()
    rig.fault(CHANNEL, "joint_2", "loss_rate", 1.0)
    session.clock.sleep(0.2)
    session[CHANNEL].land()
    (controller,) = session._runner._loop._controllers
    while controller.actuation.commands[1, 2] > 0.0:  # kp
        session.clock.sleep(0.02)
        assert controller.mode is Mode.LAND
    q = rig.state()["arms"][CHANNEL]["q"][:6]
    rig.set_pose(CHANNEL, [q[0], q[1] + MOVED_RAD, *q[2:]])
    yield session, controller
    EmergencyStop().release()
    session.discard()


def check_that_damping_is_all(rig, session):
    recorders.truth_start(rig, CHANNEL)
    session.clock.sleep(0.1)  # before it meets its stop
    truth = recorders.truth(rig, CHANNEL)
    assert np.abs(truth["torque_nm"] + 5.0 * truth["dq"])[20:, 1].max() < 1.0


def test_an_emergency_stop_does_not_pull_a_joint_to_where_it_was_sent(rig, sunk):
    session, controller = sunk
    EmergencyStop().latch("a test")
    check_that_damping_is_all(rig, session)
    EmergencyStop().release()
    session.clock.sleep(0.02)
    assert controller.mode is Mode.FAULT
    session[CHANNEL].land()
    check_that_damping_is_all(rig, session)


@pytest.mark.long
def test_a_defect_of_our_own_code_does_not_either(rig, sunk):
    session, controller = sunk
    controller.faults.fail(ValueError("a test"))
    check_that_damping_is_all(rig, session)


@pytest.mark.long
def test_a_joint_that_is_heard_again_is_held_where_it_is(rig, sunk):
    session, controller = sunk
    EmergencyStop().latch("a test")
    session.clock.sleep(0.1)
    rig.clear_faults(CHANNEL)
    session.clock.sleep(0.5)
    there = rig.state()["arms"][CHANNEL]["q"][1]
    assert controller.actuation.commands[1, 2] == 80.0
    assert controller.actuation.setpoint.q[1] == pytest.approx(there, abs=0.1)
    assert there > REST[1] + 0.15


@pytest.mark.parametrize("heard", [False, pytest.param(True, marks=pytest.mark.long)])
def test_who_takes_over_knows_of_it(rig, sunk, heard):
    session, controller = sunk
    block = SharedBlock(state_path(channel_key("yam_lockstep", CHANNEL, rig.name)), STATE_DTYPE, create=False)
    with contextlib.closing(block):
        record = block.read().copy()
    if heard:
        rig.clear_faults(CHANNEL)
        q = rig.state()["arms"][CHANNEL]["q"][:6]
        rig.set_pose(CHANNEL, [q[0], REST[1] - 0.15, *q[2:]])  # a reading that can be
    bus = open_bus(controller.config)
    try:
        heir = ArmController(controller.actuation.hardware, bus)
        heir.adopt(record, rig.now())
    finally:
        bus.shutdown()
    arm = heir.actuation
    if heard:
        assert arm.setpoint.q[1] == pytest.approx(REST[1] - 0.15, abs=0.02)
        assert arm.commands[1, 2] == 80.0
    else:
        assert arm.commands[1, 1:].tolist() == [0.0, 0.0, 5.0, 0.0]  # dq, kp, kd, tau
