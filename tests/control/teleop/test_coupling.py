"""A follower that takes its targets from the leader's state at loop rate, in lock-step."""

import numpy as np
import pytest

from lerobot_robot_yam.commands.lib.feel_figures import likeness
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Gate, Mode
from lerobot_robot_yam.state.records import Limited
from scripts import recorders
from tests.support.coupled import FOLLOWER, LEADER, POSE, started, sweep
from tests.support.rigged import lockstep_rig
from tests.support.tiers import spread

rig = lockstep_rig(LEADER, FOLLOWER)
TICK_S = 0.004


@pytest.fixture
def pair(rig):
    session, caller = started(rig)
    yield session, caller
    session.discard()


def steps(speeds):
    """Largest change of a speed (k, n) within 10 ms of steps of 1 ms."""
    return np.abs(speeds[10:] - speeds[:-10]).max()


@pytest.mark.long
def test_it_follows_with_little_lag_and_jerk(rig, pair):
    session, caller = pair
    assert session[FOLLOWER].newest().coupled
    assert session[LEADER].newest().gate is Gate.ENGAGED
    sweep(rig, 8.0)
    caller.run(2.2)
    for channel in (LEADER, FOLLOWER):
        recorders.truth_start(rig, channel, 5.0)
    caller.run(4.0)
    leader, follower = recorders.truth(rig, LEADER), recorders.truth(rig, FOLLOWER)
    found = likeness(leader["stamp_s"], leader["q"][:, :6], follower["q"][:, :6])
    assert found.lag_s.max() < 0.014
    assert found.error_rad.max() < 0.004
    assert found.jerk_ratio < 1.5


@pytest.mark.parametrize(
    "teleop_speed, rad", spread([("fast", 0.2), ("fast", 0.3), ("fast", 0.1), ("normal", 0.2), ("calm", 0.1)], 0)
)
def test_a_quick_hand_is_followed_within_the_limits(rig, teleop_speed, rad):
    session, caller = started(rig, {"teleop_speed": teleop_speed})
    hardware = session.hardware(FOLLOWER)
    setpoint = session._runner._loop._controllers[1].actuation.setpoint
    sweep(rig, 6.0, frequency_hz=2.0, rad=rad)
    caller.run(1.7)
    for channel in (LEADER, FOLLOWER):
        recorders.truth_start(rig, channel, 2.0)
    asked = []
    caller.run(1.0, lambda: asked.append((setpoint.asked[1, :6], setpoint.asked_ddq[:6])))
    assert session[FOLLOWER].newest().coupled
    leader, follower = (recorders.truth(rig, channel) for channel in (LEADER, FOLLOWER))
    wave = np.exp(-4j * np.pi * leader["stamp_s"][:1000])  # two turns
    ratio = wave @ follower["q"][:1000, :6] / (wave @ leader["q"][:1000, :6])
    assert np.all((np.abs(ratio) > 0.95) & (np.abs(ratio) < 1.05)), np.abs(ratio)
    assert np.abs(np.angle(ratio)).max() / (4 * np.pi) < 0.01
    speeds, accelerations = np.abs(asked).max(axis=0)
    assert np.all(speeds <= hardware.speed_limit[:6] + 1e-9)
    assert np.all(accelerations <= hardware.acceleration_limit + 1e-6)
    assert np.abs(follower["dq"][:, :6]).max() < 1.1 * hardware.speed_limit[0]
    session.discard()


def test_what_the_caller_passes_on_is_what_the_follower_was_asked(rig, pair):
    """The caller takes the follower's target of its newest tick, and the set-point goes there."""
    session, caller = pair
    sweep(rig, 4.0)
    seen = {}

    def note():
        state = session[FOLLOWER].newest()
        seen[state.published_s] = (state.action, state.setpoint_q)

    before = len(caller.given)
    caller.run(3.0, note)
    actions = np.array([action for action, _ in seen.values()])
    for _, action in caller.given[before + 1 : -1]:
        assert np.abs(actions - action).max(axis=1).min() < 1e-6
    gaps = [np.abs(np.array(action[:6]) - setpoint).max() for action, setpoint in seen.values()]
    assert max(gaps) < 0.02


def test_a_caller_that_stalls_uncouples_nothing_below_the_time_out(rig, pair):
    session, caller = pair
    sweep(rig, 6.0, frequency_hz=2.0, rad=0.1)
    caller.run(1.5)
    recorders.truth_start(rig, FOLLOWER, 5.0)
    coupled = []
    for stall_s in (0.05, 0.45, 0.2, 0.4):
        caller.stall(stall_s, lambda: coupled.append(session[FOLLOWER].newest().coupled))
        caller.run(0.1)
    assert all(coupled)
    truth = recorders.truth(rig, FOLLOWER)
    assert np.abs(truth["q"][:, :6] - POSE).max() < 0.1 + 0.03
    assert steps(truth["dq"][:, :6]) < 0.4  # the hand's own are 0.16; 30 rad/s² are 0.3


@pytest.mark.long
def test_without_its_caller_it_brakes_and_holds_after_the_usual_time(rig, pair):
    session, caller = pair
    sweep(rig, 8.0, frequency_hz=2.0, rad=0.1)
    caller.run(2.0)
    caller.pass_on()
    caller.stall(0.5 - 2 * TICK_S)
    state = session[FOLLOWER].newest()
    assert state.coupled and state.mode is Mode.TRACK
    caller.stall(4 * TICK_S)
    state = session[FOLLOWER].newest()
    assert state.mode is Mode.HOLD and Limited.COMMAND_TIMEOUT in state.limited
    assert not session._runner._loop._controllers[1].coupling.active
    before = state.setpoint_q
    caller.stall(0.1)
    assert np.abs(session[FOLLOWER].newest().setpoint_q - before).max() < 0.03
    caller.stall(0.2)
    at = np.array(rig.state()["arms"][FOLLOWER]["q"])[:6]
    caller.stall(0.3)
    assert np.abs(np.array(rig.state()["arms"][FOLLOWER]["q"])[:6] - at).max() < 0.005


@pytest.mark.long
def test_another_action_ends_it_in_the_same_tick(rig, pair):
    session, caller = pair
    sweep(rig, 8.0)
    caller.run(2.3)
    recorders.truth_start(rig, FOLLOWER, 5.0)
    before = session[FOLLOWER].newest().setpoint_q
    other = before + 0.2
    session[FOLLOWER].write_target(other, 0.5)
    session.clock.sleep(2 * TICK_S)
    state = session[FOLLOWER].newest()
    assert not state.coupled and state.action == pytest.approx([*other, 0.5])
    speed = np.array(recorders.truth(rig, FOLLOWER)["dq"][0, :6])
    for _ in range(30):
        session[FOLLOWER].write_target(other, 0.5)
        session.clock.sleep(1 / 30)
    assert np.abs(session[FOLLOWER].newest().setpoint_q - other).max() < 0.01
    truth = recorders.truth(rig, FOLLOWER)["dq"][:, :6]
    assert np.abs(truth).max() < 1.7 and np.abs(truth[:8] - speed).max() < 0.3  # 30 rad/s² for 8 ms


@pytest.mark.long
def test_the_other_limits_hold(rig):
    session, caller = started(rig, {"max_relative_target": 0.003})
    sweep(rig, 6.0)
    caller.run(2.0)
    held = False
    for _ in range(50):
        caller.run(TICK_S)
        state = session[FOLLOWER].newest()
        assert state.coupled
        held |= Limited.RELATIVE_TARGET in state.limited
        assert np.abs(np.array(state.action[:6]) - state.q).max() < 0.003 + 0.01  # it has moved on since
    assert held
    session.discard()


def test_an_emergency_stop_ends_it_and_it_goes_on_smoothly(rig, pair):
    session, caller = pair
    sweep(rig, 12.0)
    caller.run(2.0)
    stop = EmergencyStop()
    stop.latch("test")
    caller.run(0.2)
    follower, leader = session[FOLLOWER].newest(), session[LEADER].newest()
    assert follower.mode is leader.mode is Mode.STOPPED
    assert not follower.coupled and leader.action is None
    caller.run(1.0)
    stop.release()
    recorders.truth_start(rig, FOLLOWER, 5.0)
    caller.run(2.5)
    assert session[FOLLOWER].newest().coupled
    truth = recorders.truth(rig, FOLLOWER)
    assert np.abs(truth["dq"][:, :6]).max() < 1.65
    gap = session[FOLLOWER].newest().q - session[LEADER].newest().q
    assert np.abs(gap).max() < 0.05


@pytest.mark.long
def test_a_leader_that_pauses_is_followed_all_the_while(rig, pair):
    session, caller = pair
    rig.release(LEADER)
    caller.run(0.5)
    recorders.truth_start(rig, FOLLOWER, 4.0)
    rig.push(LEADER, "gripper", [25.0, 0.0, 0.0], 1.3)
    modes = set()

    def note():
        modes.add(session[LEADER].newest().mode)
        assert session[FOLLOWER].newest().coupled

    caller.run(3.5, note)
    assert modes == {Mode.FLOAT, Mode.HOLD}
    assert session[LEADER].newest().mode is Mode.FLOAT
    assert steps(recorders.truth(rig, FOLLOWER)["dq"][:, :6]) < 0.4


@pytest.mark.parametrize("motor", spread([None, "joint_4"], 0))
@pytest.mark.parametrize("channel", [LEADER, FOLLOWER])
def test_a_dropout_of_a_tenth_of_a_second_is_a_pause(rig, pair, channel, motor):
    session, caller = pair
    sweep(rig, 4.0)
    caller.run(2.2)
    recorders.truth_start(rig, FOLLOWER, 2.0)
    rig.fault(channel, motor, "loss_rate", 1.0)
    caller.run(0.1)
    rig.fault(channel, motor, "loss_rate", 0.0)
    caller.run(0.15)
    assert session[LEADER].newest().mode is Mode.FLOAT and session[FOLLOWER].newest().coupled
    caller.run(0.75)
    assert steps(recorders.truth(rig, FOLLOWER)["dq"][:, :6]) < 0.4
    gap = np.array(session[LEADER].newest().action[:6]) - session[FOLLOWER].newest().setpoint_q
    assert np.abs(gap).max() < 0.03


@pytest.mark.long
def test_a_leader_with_a_lost_motor_moves_nothing(rig, pair):
    """In one control loop the follower's peer halts it, too; its own rule is that stale data end the motion."""
    session, caller = pair
    sweep(rig, 8.0)
    caller.run(2.0)
    rig.fault(LEADER, "joint_3", "silent")
    session.clock.sleep(0.06)  # not yet a fault, but no sample for seven ticks
    assert session[LEADER].published().action is None
    assert not session[FOLLOWER].published().coupled
    session.clock.sleep(0.5)
    at = np.array(rig.state()["arms"][FOLLOWER]["q"])[:6]
    session.clock.sleep(0.3)
    assert np.abs(np.array(rig.state()["arms"][FOLLOWER]["q"])[:6] - at).max() < 0.005
    assert np.abs(at - POSE).max() < 0.4


@pytest.mark.long
def test_without_its_handle_the_arm_goes_on_and_the_gripper_stays(rig, pair, caplog):
    session, caller = pair
    rig.trigger(LEADER, 0.6)
    caller.run(0.5)
    sweep(rig, 8.0)
    rig.trigger(LEADER, 0.6)
    caller.run(1.0)
    grip = session[FOLLOWER].newest().action[6]
    rig.fault(LEADER, None, "handle_silent")
    caller.run(1.5)
    state = session[FOLLOWER].newest()
    assert session[LEADER].newest().trigger is None
    assert state.coupled and state.action[6] == grip
    assert np.abs(state.q - session[LEADER].newest().q).max() < 0.05
    assert caplog.text.count("handle is silent") == 1


@pytest.mark.long
def test_force_is_there_once_the_follower_has_caught_up_and_not_before(rig):
    session, caller = started(rig, bilateral=0.4)
    lead = session._runner._loop._controllers[0].lead
    assert session[LEADER].newest().gate is Gate.ENGAGED
    caller.run(0.6)
    rig.push(FOLLOWER, "link6", [0.0, 0.0, -15.0], 1.0)
    caller.run(0.5)
    assert np.abs(lead.assist[0]).max() > 0.1
    caller.stall(0.8)  # the follower holds
    assert lead.assist is None
    session.discard()


def test_another_arm_than_the_configured_follower_is_not_led_at_loop_rate(rig, caplog):
    session, caller = started(rig, gripper="no_gripper", bilateral=0.2)
    leader, follower = session[LEADER].newest(), session[FOLLOWER].newest()
    assert not follower.coupled and len(leader.action) == 6
    assert leader.gate is Gate.APPROACH and session._runner._loop._controllers[0].lead.assist is None
    assert caplog.text.count("is another arm than its follower") == 1
    assert caller.given
    session.discard()


@pytest.mark.parametrize("tap_s", [0.01, 0.05])
def test_a_press_gives_a_policys_arm_to_the_person_within_30_ms(rig, tap_s):
    """The policy gives a target every 0.1 s; the leader mirrors, and the hand that presses pulls at it."""
    session, caller = started(rig, mirror=True)
    leader, follower, clock = session[LEADER], session[FOLLOWER], session.clock
    took_s = []
    for number in range(5):
        target = follower.newest().setpoint_q
        presses = leader.newest().presses[1]
        follower.write_target(target, 0.5, leader=session.key(LEADER), take_over=(2, presses))
        clock.sleep(0.05 + 0.0117 * number)
        assert not follower.newest().coupled
        pressed_s = clock.now()
        rig.press(LEADER, "record", tap_s)
        while not follower.newest().coupled:
            clock.sleep(0.001)
            assert clock.now() - pressed_s < 0.03
        took_s.append(clock.now() - pressed_s)
        clock.sleep(0.03)
        follower.write_target(target, 0.5, leader=session.key(LEADER), take_over=(2, presses))
        clock.sleep(2 * TICK_S)
        assert follower.newest().coupled  # a target that was computed before the press was known
        clock.sleep(0.05)
        follower.write_target(target, 0.5, leader=session.key(LEADER), take_over=(2, presses + 1))
        clock.sleep(2 * TICK_S)
        assert not follower.newest().coupled  # the caller has decided otherwise
    assert max(took_s) < 0.02
    session.discard()
