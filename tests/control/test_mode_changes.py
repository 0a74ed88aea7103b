"""Whatever ends a mode finds the arm where it is: no leap to a set-point that has been left behind."""

import can
import numpy as np
import pytest

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.arm_controller import ArmController
from lerobot_robot_yam.control.loop import ControlLoop
from lerobot_robot_yam.control.preflight.open_bus import open_bus
from lerobot_robot_yam.damiao.codec import encode_mit
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import ChannelInUseError, LifeCycleError, MotorError
from lerobot_robot_yam.session.arm_session import ArmSession
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Request
from scripts import recorders
from tests.support.rigged import carry, energise, lockstep_rig, running_arm, sim_config, track
from tests.support.tiers import spread

CHANNEL = "follower_left"
POSE = np.array([0.2, 1.0, 1.1, -0.3, 0.1, 0.1])
AWAY = POSE + [0.3, -0.4, -0.3, 0.0, 0.0, 0.0]  # a soft wrist is braked between two samples, and reads as still
GENTLE_RAD_S = 0.5  # a hold that takes over at rest moves an arm by its sag only


rig = lockstep_rig(CHANNEL)
session = running_arm(CHANNEL)


def config(rig):
    return sim_config(rig, CHANNEL, interface="yam_lockstep")


def controller_of(session):
    return session._runner._loop._controllers[0]


def go(session, q, seconds=1.1, **gains):
    track(session, {CHANNEL: q}, seconds, **gains)


def push_away(rig, session):
    """A hand takes a soft arm away from its targets, which go on."""

    class Targets:
        @staticmethod
        def sleep(seconds):
            session[CHANNEL].write_target(POSE, 0.5, kp=np.ones(6), kd=np.ones(6))
            session.clock.sleep(seconds)

    carry(rig, Targets, CHANNEL, AWAY)


def fastest(rig, session, act, seconds=0.4):
    """Greatest joint speed in rad/s while and after `act`."""
    recorders.watch_start(rig, CHANNEL)
    act()
    session.clock.sleep(seconds)
    return max(recorders.watch(rig, CHANNEL)["max_speed_rad_s"][:6])


def await_off(session, most_s=15.0):
    """Wait until the arm has landed."""
    begin = session.clock.now()
    while session[CHANNEL].mode() is not Mode.OFF:
        assert session.clock.now() < begin + most_s, "it does not land"
        session.clock.sleep(0.1)


def q_of(rig):
    return np.array(rig.state()["arms"][CHANNEL]["q"][:6])


@pytest.mark.parametrize("how", spread(["hold", "calibrate", "internal error", "emergency stop"], 2))
def test_what_ends_floating_keeps_the_arm_where_a_hand_has_left_it(rig, session, how):
    go(session, POSE)
    session[CHANNEL].float()
    session.clock.sleep(0.1)
    carry(rig, session.clock, CHANNEL, AWAY)
    session.clock.sleep(0.1)
    stop = EmergencyStop()
    act = {
        "hold": session[CHANNEL].hold,
        "calibrate": lambda: controller_of(session).request(Request.CALIBRATE_GRIPPER, session.clock.now()),
        "internal error": lambda: controller_of(session).faults.fail(RuntimeError("a test")),
        "emergency stop": lambda: stop.latch("a test"),
    }[how]
    try:
        before = q_of(rig)
        assert fastest(rig, session, act) < GENTLE_RAD_S
        assert np.abs(q_of(rig) - before).max() < 0.05
    finally:
        stop.release()


@pytest.mark.parametrize("how", spread(["no more targets", "hold", "emergency stop", "land"], 0, 2))
def test_soft_gains_end_with_their_targets(rig, session, how):
    go(session, POSE)
    go(session, POSE, 0.3, kp=np.ones(6), kd=np.ones(6))
    push_away(rig, session)
    go(session, POSE, 0.1, kp=np.ones(6), kd=np.ones(6))
    stop = EmergencyStop()
    act = {
        "no more targets": lambda: session.clock.sleep(1.0),
        "hold": session[CHANNEL].hold,
        "emergency stop": lambda: stop.latch("a test"),
        "land": session[CHANNEL].land,
    }[how]
    try:
        assert fastest(rig, session, act) < (GENTLE_RAD_S if how != "land" else 0.8)
        assert controller_of(session).actuation.impedance.own_gains
        if how != "land":
            assert np.abs(q_of(rig) - AWAY).max() < 0.15  # 1 Nm/rad pull for 0.5 s at most
    finally:
        stop.release()


@pytest.mark.long
def test_a_target_without_gains_after_one_with_soft_gains_is_followed_at_the_speed_limit(rig, session):
    go(session, POSE)
    go(session, POSE, 0.2, kp=np.ones(6), kd=np.ones(6))
    push_away(rig, session)
    go(session, POSE, 0.1, kp=np.ones(6), kd=np.ones(6))
    limit = float(controller_of(session).actuation.hardware.speed_limit[0])
    assert fastest(rig, session, lambda: go(session, POSE, 1.0)) < 1.1 * limit
    assert np.abs(q_of(rig) - POSE).max() < 0.03


@pytest.mark.long
def test_an_emergency_stop_does_not_pull_a_joint_loose_that_sticks(rig, session):
    go(session, POSE)
    rig.fault(CHANNEL, "joint_3", "friction_nm", 5.5)
    go(session, POSE + [0, 0, 0.055, 0, 0, 0], 0.3)
    stop = EmergencyStop()
    stop.latch("a test")
    try:
        session.clock.sleep(0.2)
        before = q_of(rig)
        assert abs(before[2] - POSE[2]) < 0.03, "it is meant to stick"
        session.clock.sleep(3.0)
        assert np.abs(q_of(rig) - before).max() < 0.005
    finally:
        stop.release()


@pytest.mark.parametrize("lost", spread([0, 4], 1))  # answers to ENABLE
def test_an_arm_that_was_moved_between_inspection_and_enabling_is_held_where_it_is(rig, monkeypatch, lost):
    energise = ControlLoop.start

    def late(loop):
        rig.sleep(1.0)
        rig.set_pose(CHANNEL, AWAY)
        if lost:
            rig.fault(CHANNEL, "joint_1", "drop_next", lost)
        energise(loop)

    monkeypatch.setattr(ControlLoop, "start", late)
    session = ArmSession([config(rig)], isolation="lockstep")
    rig.set_pose(CHANNEL, POSE)
    recorders.watch_start(rig, CHANNEL)
    session.start()
    session.clock.sleep(0.3)
    fastest_rad_s, q = recorders.watch(rig, CHANNEL)["max_speed_rad_s"], q_of(rig)
    session.discard()
    assert fastest_rad_s[0] < 0.3 and np.abs(q - AWAY)[0] < 0.02
    if not lost:
        assert max(fastest_rad_s[:6]) < 1.0  # it falls while its motors are enabled one by one
        assert np.abs(q - AWAY).max() < 0.1


def test_a_motor_of_which_nobody_knows_where_it_is_is_not_enabled(rig):
    with open_bus(config(rig)) as bus:
        controller = ArmController(ResolvedArm(config(rig)), bus)
        controller.inspect()
        rig.fault(CHANNEL, "joint_2", "silent")
        with pytest.raises(MotorError, match="cannot enable joint_2"):
            energise(controller)
    assert not any(motor["enabled"] for motor in rig.state()["arms"][CHANNEL]["motors"].values())


def test_a_hold_is_not_undone_by_the_target_before_it(session):
    go(session, POSE)
    session[CHANNEL].write_target(AWAY, 0.5)  # the loop has not looked at it yet
    session[CHANNEL].hold()
    session.clock.sleep(0.5)
    assert session[CHANNEL].mode() is Mode.HOLD
    assert np.abs(session[CHANNEL].observe().q - POSE).max() < 0.03


def test_an_arm_in_trouble_lands_before_another_of_its_motors_trips_for_heat(rig, session):
    go(session, POSE)
    rig.fault(CHANNEL, "joint_6", "nibble", int(Fault.OVERLOAD))
    session.clock.sleep(0.1)
    assert session[CHANNEL].mode() is Mode.FAULT
    rig.fault(CHANNEL, "joint_2", "temperatures_c", [60, 96])
    await_off(session)
    assert np.abs(q_of(rig) - controller_of(session).actuation.hardware.rest_q)[1:3].max() < 0.1


def test_a_bring_up_that_fails_late_lands_what_it_has_energised(rig):
    """Whoever has held the limp arm may have let go of it: it was energised."""
    rig.set_pose(CHANNEL, POSE)
    rig.fault(CHANNEL, "gripper", "stuck")
    unknown = sim_config(rig, CHANNEL, interface="yam_lockstep", gripper_stops_rad=None)
    session = ArmSession([unknown], isolation="lockstep")
    with pytest.raises(MotorError, match="gripper"):
        session.start()
    assert np.abs(q_of(rig) - ResolvedArm(unknown).rest_q)[1:3].max() < 0.15


@pytest.mark.long
def test_an_end_that_trouble_interrupts_is_reached_all_the_same(rig, session):
    """Emergency stop, the caller leaves, a motor fails, the stop is released: nobody is there to ask again."""
    go(session, POSE)
    stop = EmergencyStop()
    stop.latch("a test")
    try:
        session.clock.sleep(0.1)
        session._runner._landing = True
        session.clock.sleep(0.2)
        rig.fault(CHANNEL, "joint_6", "nibble", int(Fault.OVERLOAD))
        session.clock.sleep(0.3)
        assert controller_of(session).mode is Mode.FAULT
    finally:
        stop.release()
    await_off(session)
    assert not any(motor["enabled"] for motor in rig.state()["arms"][CHANNEL]["motors"].values())


def test_a_stop_that_cannot_be_written_down_holds_nevertheless(tmp_path):
    stop = EmergencyStop(tmp_path / "gone")
    with pytest.raises(OSError):  # who asked has to know
        stop.latch("a test")
    assert stop.latched


def test_a_stop_whose_file_a_log_out_removes_stays(tmp_path):
    directory = tmp_path / "run"
    directory.mkdir()
    loops, other = EmergencyStop(directory), EmergencyStop(directory)
    other.latch("a test")
    assert loops.latched
    other.release()
    assert not loops.latched
    other.latch("a test")
    assert loops.latched
    directory.rename(tmp_path / "removed")
    directory.mkdir()
    assert loops.latched and other.latched and "log-out" in other.reason()
    other.release()
    assert not loops.latched


def test_commands_that_cannot_be_sent_are_replaced_by_the_last_good_ones(rig, session):
    """Motors that hear nothing for 0.4 s let go."""
    go(session, POSE)
    controller_of(session).actuation.setpoint.q[1] = np.nan
    session.clock.sleep(1.5)
    assert controller_of(session).mode is Mode.FAULT
    assert all(motor["enabled"] for motor in rig.state()["arms"][CHANNEL]["motors"].values())
    assert np.abs(q_of(rig) - POSE).max() < 0.05
    session[CHANNEL].land()
    await_off(session)
    assert np.abs(q_of(rig) - session[CHANNEL].hardware.rest_q)[1:3].max() < 0.15


@pytest.mark.parametrize("stopped", spread([False, True], 1))
def test_an_arm_that_has_to_land_is_not_talked_out_of_it(session, stopped):
    go(session, POSE)
    stop = EmergencyStop()
    try:
        if stopped:
            stop.latch("a test")
            session.clock.sleep(0.1)
        controller_of(session).landing.land(session.clock.now(), Trouble.HOT, "joint_2 is hot")
        with pytest.raises(LifeCycleError, match="joint_2 is hot; let it land"):
            session[CHANNEL].rearm()
    finally:
        stop.release()
    await_off(session)


def test_landing_is_refused_where_it_would_be_forgotten(rig, session):
    go(session, POSE)
    stop = EmergencyStop()
    rig.fault(CHANNEL, "joint_6", "nibble", int(Fault.OVERLOAD))
    session.clock.sleep(0.1)
    try:
        stop.latch("a test")
        session.clock.sleep(0.1)
        with pytest.raises(LifeCycleError, match="yam-estop release"):
            session.land()
    finally:
        stop.release()
    session.clock.sleep(0.1)
    session[CHANNEL].land()
    assert session[CHANNEL].mode() is Mode.LAND


@pytest.mark.long
def test_heat_during_an_emergency_stop_is_said_once(rig, session, caplog):
    go(session, POSE)
    stop = EmergencyStop()
    stop.latch("a test")
    try:
        rig.fault(CHANNEL, "joint_2", "temperatures_c", [60, 118])
        session.clock.sleep(2.0)
    finally:
        stop.release()
    assert caplog.text.count("motor about to trip") == 1


@pytest.mark.parametrize("meanwhile, error", [(False, ChannelInUseError), (True, MotorError)])
def test_nothing_is_enabled_against_somebody_else(rig, meanwhile, error):
    mine, other = open_bus(config(rig)), open_bus(config(rig))
    controller = ArmController(ResolvedArm(config(rig)), mine)
    controller.inspect()

    def speak():
        for _ in range(5):
            other.send(can.Message(arbitration_id=1, data=encode_mit("DM4340", 0, 0, 0, 0, 0), is_extended_id=False))
        rig.sleep(0.01)

    if not meanwhile:
        speak()
    with pytest.raises(error, match="another driver commands"):
        energise(controller, speak if meanwhile else None)
    assert not any(motor["enabled"] for motor in rig.state()["arms"][CHANNEL]["motors"].values())
    for bus in (mine, other):
        bus.shutdown()
