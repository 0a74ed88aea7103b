"""An arm whose model is wrong is not let float, or not fast, or not for long; and a hand feels nothing of that."""

import contextlib
import threading
import time

import numpy as np
import pytest

from lerobot_robot_yam.control.laws.gravity_balance import GravityBalance
from lerobot_robot_yam.control.laws.mit_laws import KD, FloatDamping
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import LifeCycleError, MotorError
from lerobot_robot_yam.face.operator_keys.auto_episodes import led_by_hand
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import STATE_DTYPE, channel_key, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock
from scripts import recorders
from tests.support.rigged import lockstep_rig, rig_of, session_on, sim_config, track
from tests.support.tiers import spread

LEADER, FOLLOWER = "leader_left", "follower_left"
FLOAT_RAD_S = 3.0  # default of `float_speed_rad_s`
MOST_RAD_S = 1.15 * FLOAT_RAD_S
POSE = [0.1, 1.0, 1.0, 0.0, 0.0, 0.0]
CLIP_NM = [20.0, 24.0, 20.0, 7.0, 7.0, 7.0]
VENDOR = [1.0, 1.1, 1.1, 1.2, 1.0, 1.0]


rig = lockstep_rig(LEADER, FOLLOWER)


@pytest.fixture
def started(rig):
    """Start sessions; they are thrown away at the end."""
    sessions = []

    def start(channel, **fields):
        sessions.append(session_on(rig, sim_config(rig, channel, **fields)))
        sessions[-1].start()
        return sessions[-1]

    yield start
    for session in sessions:
        session.discard()


def fastest(rig, channel):
    return max(recorders.watch(rig, channel)["max_speed_rad_s"][:6])


def energised(rig, channel):
    return any(motor["enabled"] for motor in rig.state()["arms"][channel]["motors"].values())


@pytest.mark.parametrize(
    "fields",
    [
        {"payload_mass_kg": 0.5},
        pytest.param({"payload_mass_kg": 1.0}, marks=pytest.mark.long),
        pytest.param({"payload_mass_kg": 3.0}, marks=pytest.mark.long),
        pytest.param({"gravity_factor": [1.5] * 6}, marks=pytest.mark.long),
        pytest.param({"base_tilt_rad": [1.57, 0.0]}, marks=pytest.mark.long),
    ],
    ids=str,
)
def test_a_leader_whose_weight_is_not_the_models_is_refused_and_landed(rig, started, fields):
    recorders.watch_start(rig, LEADER)
    with pytest.raises(MotorError, match=r"joint_\d is held with .* Nm where the model says .*check payload_mass_kg"):
        started(LEADER, **fields)
    assert fastest(rig, LEADER) < 2.5  # its weight comes at once; 0.3 … 1 kg: 0.7 rad/s
    assert not energised(rig, LEADER)


@pytest.mark.parametrize("fields", spread([{"payload_mass_kg": 0.3}, {"gravity_factor": [1.3] * 6}], 1), ids=str)
def test_what_passes_and_floats_away_all_the_same_is_slowed_down_and_held(rig, started, fields):
    recorders.watch_start(rig, LEADER)
    session = started(LEADER, **fields)
    session.clock.sleep(4.0)
    assert fastest(rig, LEADER) < MOST_RAD_S
    state = session[LEADER].published()
    assert state.mode is Mode.FAULT and state.trouble is Trouble.RUNAWAY
    with pytest.raises(MotorError, match="joint_3 goes on at .* rad/s.*check payload_mass_kg"):
        session[LEADER].observe()
    recorders.watch_start(rig, LEADER)
    session.clock.sleep(1.0)
    assert fastest(rig, LEADER) < 0.1
    session.stop()  # it lands
    assert not energised(rig, LEADER)


@pytest.mark.long
def test_what_runs_away_can_be_rearmed_once_it_is_balanced(rig, started):
    session = started(LEADER)
    rig.push(LEADER, "gripper", [0.0, 0.0, 12.0], 4.0)  # it has lost 1.2 kg
    session.clock.sleep(3.2)
    assert session[LEADER].published().trouble is Trouble.RUNAWAY
    with pytest.raises(LifeCycleError, match=r"does not float: joint_\d is held with"):
        session[LEADER].rearm()
    session.clock.sleep(2.0)
    session[LEADER].rearm()
    session.clock.sleep(1.0)
    assert session[LEADER].observe().mode is Mode.FLOAT


def test_the_emergency_stop_ends_it(rig, started):
    session = started(LEADER)
    stop = EmergencyStop()
    try:
        stop.latch("a test")
        session.clock.sleep(0.1)
        assert session[LEADER].mode() is Mode.STOPPED
        recorders.watch_start(rig, LEADER)
        rig.push(LEADER, "gripper", [0.0, 0.0, 12.0], 30.0)  # it has lost 1.2 kg
        session.clock.sleep(3.0)
        assert fastest(rig, LEADER) < 1.4 * FLOAT_RAD_S  # the light wrist, for some milliseconds
        recorders.watch_start(rig, LEADER)
        session.clock.sleep(1.0)
        assert fastest(rig, LEADER) < 0.1
        assert session[LEADER].published().trouble is Trouble.RUNAWAY
    finally:
        stop.release()


@pytest.mark.parametrize("mode", spread([Mode.HOLD, Mode.LAND], 1))
def test_the_emergency_stop_holds_a_leader_that_would_run_away(rig, started, mode):
    session = started(LEADER)
    session[LEADER].hold()
    rig.push(LEADER, "gripper", [0.0, 0.0, 10.0], 30.0)  # it has lost 1 kg
    session.clock.sleep(0.5)
    if mode is Mode.LAND:
        session[LEADER].land()
        session.clock.sleep(0.5)
    assert session[LEADER].mode() is mode
    stop = EmergencyStop()
    try:
        stop.latch("a test")
        session.clock.sleep(0.2)
        recorders.watch_start(rig, LEADER)
        session.clock.sleep(1.0)
        assert session[LEADER].mode() is Mode.STOPPED
        assert fastest(rig, LEADER) < 0.5
    finally:
        stop.release()
    session.clock.sleep(0.3)
    assert session[LEADER].mode() is mode


@pytest.mark.long
@pytest.mark.alone
def test_the_emergency_stop_holds_a_leader_that_was_refused_and_lands():
    with rig_of("live", arms=[LEADER]) as rig:
        session = session_on(rig, sim_config(rig, LEADER, payload_mass_kg=1.0))
        stop, refused = EmergencyStop(), threading.Event()

        def start():
            with contextlib.suppress(MotorError):
                session.start()
            refused.set()

        threading.Thread(target=start).start()
        try:
            deadline, path = time.monotonic() + 30.0, state_path(channel_key("yam_sim", LEADER, rig.name))
            while not path.exists():
                assert time.monotonic() < deadline
                time.sleep(0.01)
            with contextlib.closing(SharedBlock(path, STATE_DTYPE, create=False)) as block:
                while (record := block.read()) is None or record["mode"] != Mode.LAND:
                    assert time.monotonic() < deadline
                    time.sleep(0.002)
                stop.latch("a test")
                recorders.watch_start(rig, LEADER)
                time.sleep(1.0)
                assert block.read()["mode"] == Mode.STOPPED
            assert fastest(rig, LEADER) < 0.5
        finally:
            stop.release()
            assert refused.wait(60.0)
            session.stop()
        assert not energised(rig, LEADER)


def test_a_hand_feels_nothing_below_the_speed(rig, started):
    session = started(LEADER)
    controller = session._runner._loop._controllers[0]
    begin, goal = np.array(POSE), np.array([1.2, 1.8, 1.8, 0.8, 0.8, 1.0])
    session[LEADER].hold()
    track(session, {LEADER: begin}, 1.2)
    session[LEADER].float()
    session.clock.sleep(0.1)
    way = np.linspace(0.0, 1.0, 25)
    times = way * float(np.abs(goal - begin).max()) / 2.5 * np.pi / 2
    rig.hand(LEADER, times, begin + (goal - begin) * (1.0 - np.cos(np.pi * way[:, None])) / 2)
    fast, end = 0.0, session.clock.now() + times[-1] + 0.3
    while session.clock.now() < end:
        session.clock.sleep(0.004)
        fast = max(fast, np.abs(controller.actuation.estimate.dq).max())
        np.testing.assert_allclose(controller.interface.sent[:, KD], controller.actuation.hardware.idle_kd, atol=1e-12)
    assert 2.4 < fast < FLOAT_RAD_S
    assert session[LEADER].observe().mode is Mode.FLOAT


def test_a_quick_hand_leads_on_and_feels_no_blow(rig, started):
    """A wrist to and fro by 0.3 rad twice a second, then turned by 2 rad in a third of a second."""
    session = started(LEADER)
    controller = session._runner._loop._controllers[0]
    limit_nm, idle_kd = controller.actuation.hardware.torque_limit_nm, controller.actuation.hardware.idle_kd
    rig.hand(LEADER, [1.2], [POSE])
    session.clock.sleep(1.5)
    t = np.arange(0.0, 2.0, 0.01)
    swing, turn = 0.3 * np.sin(4.0 * np.pi * np.minimum(t, 1.5)), 1.0 - np.cos(np.pi * np.clip((t - 1.6) * 3, 0.0, 1.0))
    q = np.tile(POSE, (len(t), 1))
    q[:, 3:] += swing[:, None]
    q[:, 3] += turn
    rig.hand(LEADER, t + 0.1, q)
    fast, brakes_nm, end = 0.0, np.zeros(6), session.clock.now() + 2.5
    while session.clock.now() < end:
        session.clock.sleep(0.004)
        dq = np.abs(controller.actuation.estimate.dq)
        brakes_nm = np.maximum(brakes_nm, (controller.interface.sent[:, KD] - idle_kd) * dq)
        fast = max(fast, dq.max())
        assert session[LEADER].mode() is Mode.FLOAT
    assert fast > 8.0 and brakes_nm.max() > 2.0
    assert (brakes_nm < 0.6 * limit_nm).all()  # a quarter, and what the joint gains in a tick


def test_what_pushes_for_too_long_is_paused_and_the_second_time_until_it_is_touched(rig, started):
    session = started(LEADER)

    def after(seconds):
        session.clock.sleep(seconds)
        state = session[LEADER].published()
        assert state.trouble is None
        assert led_by_hand([state])  # else an automatic episode would be dropped
        return state.mode

    rig.push(LEADER, "gripper", [0.0, 0.0, 12.0], 1.3)
    assert after(1.3) is Mode.HOLD
    assert after(1.5) is Mode.FLOAT
    rig.push(LEADER, "gripper", [18.0, 0.0, 0.0], 1.3)
    assert after(1.3) is Mode.HOLD
    assert after(2.5) is Mode.HOLD
    rig.push(LEADER, "gripper", [0.0, 0.0, -20.0], 0.5)
    session.clock.sleep(0.5)
    assert after(1.0) is Mode.FLOAT


def test_a_pause_goes_on_after_the_other_arm_is_rearmed(rig):
    session = session_on(rig, sim_config(rig, LEADER), sim_config(rig, FOLLOWER))
    session.start()
    try:
        rig.push(LEADER, "gripper", [0.0, 0.0, 12.0], 1.3)
        session.clock.sleep(1.25)
        assert session[LEADER].mode() is Mode.HOLD
        rig.fault(FOLLOWER, "joint_6", "nibble", int(Fault.OVERLOAD))
        session.clock.sleep(2.0)
        assert session[LEADER].mode() is Mode.HOLD
        session.rearm()
        session.clock.sleep(0.5)
        assert session[LEADER].mode() is Mode.FLOAT
    finally:
        session.discard()


@pytest.mark.parametrize(("wrong_nm", "lasts_s"), [(9.0, 0.26), (1.0, 0.63)])
def test_a_quick_move_of_a_hand_is_no_runaway(wrong_nm, lasts_s):
    speed = FloatDamping(FLOAT_RAD_S, 6)

    def damping(dq):
        kd = speed.damping(np.array(dq), 0.004, np.full(6, 4.5), np.full(6, 7.0), np.full(6, wrong_nm))
        assert kd is None or np.abs(kd * dq).max() <= 7.0 + 1e-9
        return kd

    for way in (1.0, -1.0) * 5:  # strokes of 0.2 s at 4 rad/s, to and fro
        for tick in range(50):
            kd = damping([4.0 * way, 0, 0, 0, 0, 0])
            assert tick < 1 or kd[0] > 0.0
        assert speed.runs_away is None
    ticks = 0
    while speed.runs_away is None:
        damping([0, 0, -4.0, 0, 0, 0])
        ticks += 1
    assert speed.runs_away == 2 and abs(ticks * 0.004 - lasts_s) < 0.02
    speed.reset()
    assert speed.runs_away is None


@pytest.mark.long
def test_a_floating_speed_of_ones_own(rig, started):
    recorders.watch_start(rig, LEADER)
    session = started(LEADER, payload_mass_kg=0.3, float_speed_rad_s=1.0)
    session.clock.sleep(3.0)
    assert fastest(rig, LEADER) < 1.4
    assert session[LEADER].published().trouble is Trouble.RUNAWAY


@pytest.mark.parametrize("fields, floats", [({"payload_mass_kg": 1.0}, False), ({"gravity_factor": VENDOR}, True)])
def test_a_follower_floats_if_its_model_is_right_within_a_fifth(started, fields, floats):
    session = started(FOLLOWER, **fields)
    track(session, {FOLLOWER: POSE}, 1.5)
    session.clock.sleep(0.5)
    if floats:
        session[FOLLOWER].float()
        assert session[FOLLOWER].mode() is Mode.FLOAT
        return
    held = session[FOLLOWER].observe().q
    with pytest.raises(
        LifeCycleError, match="does not float: joint_2 is held .* joint_3 is held with .* Nm where the model says"
    ):
        session[FOLLOWER].float()
    session.clock.sleep(0.3)
    state = session[FOLLOWER].observe()
    assert state.mode is Mode.HOLD
    assert np.abs(state.q - held).max() < 0.05


def test_a_hand_that_pulls_has_a_second_to_let_go(rig, started):
    session = started(FOLLOWER)
    track(session, {FOLLOWER: POSE}, 1.5)
    rig.push(FOLLOWER, "gripper", [0.0, 0.0, -15.0], 0.8)
    session.clock.sleep(0.4)
    session[FOLLOWER].float()
    assert session[FOLLOWER].mode() is Mode.FLOAT


def test_a_joint_on_its_stop_is_not_weighed():
    balance = GravityBalance(["joint_1", "joint_2"], np.array([28.0, 28.0]))
    for tick in range(100):
        balance.advance(tick * 0.004, np.array([0.0, -4.0]), np.array([0.0, 5.0]), np.zeros(2))
    assert "joint_2 is held with -4.0 Nm where the model says 5.0" in balance.verdict(0.4)
    assert balance.verdict(0.4, np.array([0.0, -1.0])) == ""  # it presses on its lower stop
    assert balance.verdict(0.4, np.array([0.0, 1.0])) != ""
    balance.reset()
    assert balance.verdict(0.5) is None


def test_a_joint_that_slips_for_a_moment_is_judged_by_what_held_it_before():
    balance = GravityBalance(["joint_1"], np.array([28.0]))
    for tick in range(100):
        balance.advance(tick * 0.004, np.array([5.0]), np.array([1.0]), np.zeros(1))
    balance.advance(0.4, np.array([5.0]), np.array([1.0]), np.array([0.2]))
    assert balance.verdict(0.4) is None
    assert "joint_1 is held with 5.0 Nm where the model says 1.0" in balance.verdict(0.4, memory_s=1.0)
    assert balance.verdict(1.5, memory_s=1.0) is None  # a hand that moves the arm all the time holds it


def test_a_joint_that_a_hand_moves_unheard_is_not_torn_back(rig, started):
    """It floated, so nobody knows where it is: held stiffly where it was heard last, it would be torn back."""
    session = started(LEADER, torque_limit_nm=CLIP_NM)
    t = np.linspace(0.0, 0.3, 31)
    path = np.repeat(np.array(rig.state()["arms"][LEADER]["q"])[None], len(t), axis=0)
    path[:, 2] += 1.4 * (3.0 * (t / 0.3) ** 2 - 2.0 * (t / 0.3) ** 3)
    rig.hand(LEADER, t + 0.1, path, gives_way=False)
    session.clock.sleep(0.16)
    recorders.truth_start(rig, LEADER, 4.0)
    begun_s = session.clock.now()
    rig.fault(LEADER, "joint_3", "silent", True)
    session.clock.sleep(0.13)
    rig.fault(LEADER, "joint_3", "silent", False)
    session.clock.sleep(0.5)
    rig.release(LEADER)
    session.clock.sleep(1.5)
    assert session[LEADER].published().trouble is Trouble.IMPLAUSIBLE
    truth = recorders.truth(rig, LEADER, begun_s)
    asked, released = np.abs(truth["asked_nm"][1:, :6]).max(axis=0), truth["stamp_s"] > begun_s + 0.7
    assert (asked <= CLIP_NM).all(), asked
    assert np.abs(truth["dq"][released]).max() < 1.5
    session[LEADER].rearm()
    session.clock.sleep(0.2)
    assert session[LEADER].mode() is Mode.FLOAT
