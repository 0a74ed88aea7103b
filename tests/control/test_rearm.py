"""Re-arming: what failed is enabled again where it is by now, and nothing else is disturbed."""

import numpy as np
import pytest

from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Request
from scripts import recorders
from tests.support.rigged import lockstep_rig, pause, rig_of, running_arm, session_on, sim_config, track
from tests.support.tiers import spread

CHANNEL = "follower_left"
POSE = np.array([0.2, 1.0, 1.1, -0.3, 0.1, 0.1])

rig = lockstep_rig(CHANNEL)
session = running_arm(CHANNEL)


def go(session, q):
    track(session, {CHANNEL: q}, 1.2)


def q_of(rig):
    return np.array(rig.state()["arms"][CHANNEL]["q"][:6])


def test_a_refused_re_arm_does_not_throw_the_motors_that_came_back(rig, session):
    go(session, POSE)
    rig.fault(CHANNEL, "joint_2", "nibble", int(Fault.OVERLOAD))
    rig.fault(CHANNEL, "joint_4", "nibble", int(Fault.OVERLOAD), sticky=True)
    session.clock.sleep(1.5)
    assert np.abs(q_of(rig) - POSE).max() > 0.3  # it has sagged
    recorders.watch_start(rig, CHANNEL)
    with pytest.raises(LifeCycleError, match="cannot re-arm.*joint_4"):
        session[CHANNEL].rearm()
    session.clock.sleep(0.4)
    assert max(recorders.watch(rig, CHANNEL)["max_speed_rad_s"][:6]) < 1.0


def test_nothing_is_re_armed_while_the_emergency_stop_is_latched(rig, session):
    go(session, POSE)
    rig.fault(CHANNEL, "joint_6", "nibble", int(Fault.OVERLOAD))
    session.clock.sleep(0.1)
    stop = EmergencyStop()
    stop.latch("a hand in the way")
    try:
        session.clock.sleep(0.1)
        with pytest.raises(LifeCycleError, match="yam-estop release"):
            session[CHANNEL].rearm()
        assert not rig.state()["arms"][CHANNEL]["motors"]["joint_6"]["enabled"]
    finally:
        stop.release()
    session.clock.sleep(0.1)
    session[CHANNEL].rearm()
    assert session[CHANNEL].mode() is Mode.HOLD


def test_a_motor_that_came_back_holds_though_another_one_stays_silent(rig, session):
    go(session, POSE)
    rig.fault(CHANNEL, "joint_2", "nibble", int(Fault.OVERLOAD))
    rig.fault(CHANNEL, "joint_6", "silent")
    session.clock.sleep(0.3)
    rig.trace_start(CHANNEL)
    with pytest.raises(LifeCycleError, match="cannot re-arm.*joint_6"):
        session[CHANNEL].rearm()
    said = [first for _, _, ident, first in rig.trace(CHANNEL) if ident == 6]
    assert said and 0xFF not in said  # as special commands begin: whoever is silent may hold its joint
    session.clock.sleep(0.2)
    before = q_of(rig)
    session.clock.sleep(1.0)
    assert rig.state()["arms"][CHANNEL]["motors"]["joint_2"]["enabled"]
    assert abs(q_of(rig) - before)[1] < 0.02


def test_a_refused_re_arm_of_a_joint_that_swings_says_so(rig, session):
    """Its cable is well: a wrist without torque falls against its stop at 10 rad/s."""
    go(session, [0.2, 1.6, 1.1, -0.3, 0.1, 0.1])
    for joint in range(1, 7):
        rig.fault(CHANNEL, f"joint_{joint}", "nibble", int(Fault.OVERLOAD))
    session.clock.sleep(0.43)
    assert abs(rig.state()["arms"][CHANNEL]["dq"][5]) > 8.0
    with pytest.raises(LifeCycleError, match=r"joint_6 \(id 6\) still swings, at 1\d rad/s; wait until it hangs still"):
        session[CHANNEL].rearm()
    session.clock.sleep(2.0)
    session[CHANNEL].rearm()
    assert session[CHANNEL].mode() is Mode.HOLD


def test_motors_that_are_enabled_one_by_one_get_torque_all_at_once(rig, session):
    go(session, POSE)
    for joint in (2, 3):
        rig.fault(CHANNEL, f"joint_{joint}", "nibble", int(Fault.OVERLOAD))
    session.clock.sleep(0.1)
    recorders.truth_start(rig, CHANNEL)
    session[CHANNEL].rearm()
    truth = recorders.truth(rig, CHANNEL)
    begun = [int(np.flatnonzero(np.abs(truth["asked_nm"][:, i]) > 0.1)[0]) for i in (1, 2)]
    assert begun[0] > 0 and abs(begun[0] - begun[1]) <= 1  # steps of 1 ms


def test_a_landing_waits_for_a_re_arm_that_has_begun(rig, session):
    """Else it would move joints that are being enabled."""
    go(session, POSE)
    rig.fault(CHANNEL, "joint_2", "nibble", int(Fault.OVERLOAD))
    session.clock.sleep(0.1)
    number = session[CHANNEL].ask(Request.REARM)
    session.clock.sleep(0.012)
    session._runner.land()  # as where the caller is gone
    while session[CHANNEL].published().answered != number:
        assert session[CHANNEL].mode() is Mode.FAULT
        session.clock.sleep(0.004)
    assert session[CHANNEL].published().refusal is None
    session.clock.sleep(0.012)
    assert session[CHANNEL].mode() is Mode.LAND


def test_a_re_arm_survives_answers_that_get_lost(rig, session):
    go(session, POSE)
    rig.fault(CHANNEL, "joint_4", "nibble", int(Fault.OVERLOAD))
    session.clock.sleep(0.1)
    rig.fault(CHANNEL, "joint_4", "drop_next", 8)  # three to CLEAR, one to ENABLE, and more
    session[CHANNEL].rearm()
    assert session[CHANNEL].mode() is Mode.HOLD


def test_the_state_after_a_re_arm_is_dated_after_the_answers_that_it_waited_for(rig, session):
    go(session, POSE)
    rig.fault(CHANNEL, "joint_2", "nibble", int(Fault.OVERLOAD))
    session.clock.sleep(0.1)
    session[CHANNEL].rearm()
    state = session[CHANNEL].published()
    assert state.mode is Mode.HOLD
    assert state.motor_stamps_s.max() <= state.published_s <= session.clock.now()


def test_a_re_arm_ends_when_the_gripper_knows_where_it_is(rig, session):
    track(session, {CHANNEL: POSE}, 1.5, gripper=0.01)  # there the motor could be on either of two turns
    rig.fault(CHANNEL, "gripper", "nibble", int(Fault.OVERLOAD))
    session.clock.sleep(0.1)
    session.rearm()
    state = session[CHANNEL].observe()
    assert state.mode is Mode.HOLD
    assert state.gripper == pytest.approx(rig.state()["arms"][CHANNEL]["opening"], abs=0.02)


def test_while_a_whole_arm_is_re_armed_its_peer_goes_on_being_commanded(tmp_path):
    channels = (CHANNEL, "follower_right")
    with rig_of("lockstep", arms=list(channels)) as rig:
        session = session_on(rig, *(sim_config(rig, channel) for channel in channels))
        session.start()
        for motor in rig.state()["arms"][CHANNEL]["motors"]:
            rig.fault(CHANNEL, motor, "nibble", int(Fault.UNDER_VOLTAGE))
        session.clock.sleep(0.1)
        recorders.watch_start(rig, channels[1])
        session.rearm()
        assert max(recorders.watch(rig, channels[1])["max_command_age_s"]) < 0.01  # at each tick
        session.discard()


@pytest.mark.parametrize("starts", spread([20, 60], 0))
def test_an_arm_comes_up_and_comes_back_on_a_wire_that_loses_frames_either_way(rig, session, starts):
    for kind in ("loss_rate", "command_loss_rate"):
        rig.fault(CHANNEL, None, kind, 0.01)
    for _ in range(5):
        for joint in ("joint_1", "joint_5"):
            rig.fault(CHANNEL, joint, "nibble", int(Fault.OVERLOAD))
        session.clock.sleep(0.2)
        session.rearm()
        assert all(motor["enabled"] for motor in rig.state()["arms"][CHANNEL]["motors"].values())
    session.discard()
    for _ in range(starts):
        pause(rig, 0.5)  # until the motors have noticed
        session.start()
        session.discard()


def test_what_a_landing_has_set_ends_with_it(rig):
    """The emergency stop interrupts a landing, and trouble ends it. What its load weighs there is nothing elsewhere."""
    rest = [0.0, 1.9, 1.9, 0.0, 0.0, 0.0]  # far out, where a load weighs most
    session = session_on(rig, sim_config(rig, CHANNEL, rest_q_rad=rest, hold_integral=False))
    session.start()
    stop = EmergencyStop()
    try:
        go(session, [0.0, 1.5, 1.5, 0.0, 0.0, 0.0])
        rig.fault(CHANNEL, None, "payload_kg", 1.5)
        session.clock.sleep(0.5)
        session[CHANNEL].land()
        arm = session._runner._loop._controllers[0].actuation
        while np.abs(arm.impedance.sag_nm).max() < 2.0:
            session.clock.sleep(0.02)
            assert session[CHANNEL].mode() is Mode.LAND
        stop.latch("a test")
        session.clock.sleep(0.1)
        assert np.abs(arm.impedance.sag_nm).max() > 2.0  # the load is still there
        rig.fault(CHANNEL, "joint_6", "nibble", int(Fault.OVERLOAD))
        session.clock.sleep(0.1)
        stop.release()
        session.clock.sleep(0.1)
        assert np.abs(arm.impedance.sag_nm).max() > 2.0
        session[CHANNEL].rearm()
        session.clock.sleep(2.0)
        assert session[CHANNEL].mode() is Mode.HOLD
        assert arm.setpoint.acceleration_limit[:6].tolist() == [30.0] * 6
        assert np.abs(arm.impedance.sag_nm).max() < 0.1
    finally:
        stop.release()
        session.discard()
