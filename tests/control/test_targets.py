"""What becomes of a target that an arm cannot or must not take: said at once, never silently dropped."""

import numpy as np
import pytest

from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import ActionError, LifeCycleError, MotorError
from lerobot_robot_yam.session.yam_arm import YamArm
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from tests.support.rigged import lockstep_rig, running_arm, sim_config
from tests.support.tiers import spread

CHANNEL = "follower_left"
POSE = np.array([0.2, 1.0, 1.1, -0.3, 0.1, 0.1])


rig = lockstep_rig(CHANNEL)
session = running_arm(CHANNEL)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kd": [5, 50, 5, 1, 1, 1]}, r"kd of joint_2 is 50; it has to be within 1.6 … 5;"),
        ({"kp": [20000, 80, 80, 10, 10, 10]}, r"kp of joint_1 is 20000; it has to be within 1 … 500;"),
        ({"kp": [80, 80, -1, 10, 10, 10]}, r"kp of joint_3 is -1"),
        ({"dq": [0, 0, 0, 0, 0, -57]}, r"dq of joint_6 is -57; it has to be within -30 … 30;"),
        ({"kp": [500] * 6, "kd": [0] * 6}, r"kd of joint_1 is 0; it has to be within 10 … 5;"),
        ({"kp": [200] * 6}, r"kd of joint_4 is 1.5; it has to be within 4 … 5;"),  # its own, with another's stiffness
        ({"kd": [5, 5, 5, 0.1, 1, 1]}, r"kd of joint_4 is 0.1; it has to be within 0.2 … 5;"),
        ({"kp": [0] * 6, "kd": [1] * 6}, r"kp of joint_1 is 0; it has to be within 1 … 500;"),
    ],
)
def test_gains_and_speeds_that_no_configuration_may_have_are_refused(session, options, message):
    port = session[CHANNEL]
    before = port.observe().setpoint_q
    with pytest.raises(ActionError, match=message):
        port.write_target(POSE, 0.5, **options)
    session.clock.sleep(0.5)
    np.testing.assert_array_equal(port.observe().setpoint_q, before)


def test_a_target_for_an_arm_that_has_failed_is_no_success(rig, session):
    port = session[CHANNEL]
    rig.fault(CHANNEL, "joint_2", "nibble", int(Fault.OVERLOAD))
    session.clock.sleep(0.1)
    with pytest.raises(MotorError, match="joint_2"):
        port.write_target(POSE, 0.5)


def test_a_floating_arm_takes_no_target_and_says_so(session):
    port = session[CHANNEL]
    port.float()
    with pytest.raises(LifeCycleError, match="float.*hold"):
        port.write_target(POSE, 0.5)
    port.hold()
    port.write_target(POSE, 0.5)


def test_moving_to_a_pose_does_not_succeed_during_an_emergency_stop(rig):
    config = sim_config(rig, CHANNEL, interface="yam_lockstep")
    with YamArm(config, isolation="lockstep") as arm:
        stop = EmergencyStop()
        stop.latch("a test")
        try:
            arm._session.clock.sleep(0.1)
            with pytest.raises(LifeCycleError, match="not reached.*stopped"):
                arm.move_to(POSE)
        finally:
            stop.release()


@pytest.mark.parametrize("ask", spread(["float", "hold", "calibrate_gripper"], 0))
def test_only_re_arming_leads_out_of_a_fault(rig, session, ask):
    port = session[CHANNEL]
    session._runner._loop._controllers[0].faults.fail(RuntimeError("a test"))
    session.clock.sleep(0.1)
    with pytest.raises(LifeCycleError, match="internal error.*re-arm"):
        getattr(port, ask)()
    assert port.mode() is Mode.FAULT


def test_a_target_that_reaches_the_loop_too_late_moves_nothing(session):
    """As one that a network, or a caller that hung while writing, has kept."""
    port = session[CHANNEL]
    before = port.observe().setpoint_q
    port.write_target(before + 0.2, 0.5, given_s=session.clock.now() - 0.6)
    session.clock.sleep(0.1)
    assert np.array_equal(port.observe().setpoint_q, before)
    port.write_target(before + 0.2, 0.5, given_s=session.clock.now() - 0.1)
    session.clock.sleep(0.1)
    assert np.abs(port.observe().setpoint_q - before).max() > 0.01
