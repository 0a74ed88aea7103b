"""Every fault of the policy in every phase, through the shipped driver: the arm, its peer, the caller, the way back.

What is expected is read from `faults.RESPONSES`; a row that is changed there and not in the loop fails here.
"""

import numpy as np
import pytest

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.state.faults import FAULT_TROUBLE, RESPONSES, Response, Trouble, stale_overshoot_rad_s
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from scripts import recorders
from scripts.soak.injected_faults import ELSEWHERE, LEADER, LEFT, MATRIX, MOTOR, RIGHT
from tests.support.asked import KNOWN_S, beyond_nm, look_at
from tests.support.landed import MOST_M, moved_after_cut_m
from tests.support.paths import ROOT
from tests.support.rigged import isolation_of, pause, session_on, sim_config, track

AWAY = np.array([0.1, 0.9, 0.9, -0.3, 0.1, 0.1])
CLIP_NM = [14.0, 14.0, 14.0, 5.0, 5.0, 5.0]  # half of what the motors can do: their own saturation must not judge
SLACK_S = {"lockstep": 0.01, "process": 0.4}  # two ticks; on a live rig the machine's
CASES = [pytest.param(fault, phase, id=f"{name}-{phase}") for name, fault in MATRIX.items() for phase in fault.phases]
IN_LOCKSTEP = [
    pytest.param(row, row.lockstep, id=f"{name}-{row.lockstep}") for name, row in MATRIX.items() if row.lockstep
]


def test_the_matrix_is_wide_enough():
    assert len(CASES) >= 60 and len(IN_LOCKSTEP) >= 10
    assert len(IN_LOCKSTEP) == sum(bool(fault.lockstep) for fault in MATRIX.values())
    assert {fault.trouble for fault in MATRIX.values()} | set(ELSEWHERE) == set(RESPONSES)
    assert [path for path in ELSEWHERE.values() if not (ROOT / path).is_file()] == []


@pytest.fixture(scope="module")
def live_rig():
    with running_rig() as rig:
        yield rig


@pytest.fixture(scope="module")
def lockstep_rig():
    rig = LockstepRig(arms=[LEFT, RIGHT, LEADER])
    yield rig
    rig.close()


@pytest.fixture
def live(live_rig):
    yield live_rig
    clean(live_rig)


@pytest.fixture
def lockstep(lockstep_rig):
    yield lockstep_rig
    clean(lockstep_rig)


def config_of(rig, channel):
    return sim_config(rig, channel, torque_limit_nm=CLIP_NM)


def clean(rig):
    """Nothing is wrong any more, and every arm at rest."""
    for channel in (LEFT, RIGHT, LEADER):
        rig.clear_faults(channel)
        recorders.truth_stop(rig, channel)
    rest = session_on(rig, config_of(rig, LEFT)).hardware(LEFT).rest_q.tolist()
    for channel in (LEFT, RIGHT, LEADER):
        rig.set_pose(channel, rest)


def enabled(rig, channel):
    return {name for name, motor in rig.state()["arms"][channel]["motors"].items() if motor["enabled"]}


def wait_for(clock, what, condition, timeout_s):
    deadline = clock.now() + timeout_s
    while not condition():
        assert clock.now() < deadline, f"not within {timeout_s:.2f} s: {what}"
        clock.sleep(0.003)


def trouble_of(session, channel):
    return session[channel].published().trouble


@pytest.mark.long
@pytest.mark.alone
@pytest.mark.parametrize("fault, phase", CASES)
def test_fault(live, fault, phase):
    check(live, fault, phase)


@pytest.mark.parametrize("fault, phase", IN_LOCKSTEP)
def test_fault_in_lockstep(lockstep, fault, phase):
    check(lockstep, fault, phase)


@pytest.mark.long
@pytest.mark.alone
def test_fault_in_real_time(live):
    check(live, MATRIX["motor-silent"], "track")


def check(rig, fault, phase):
    if phase == "bring_up":
        check_bring_up(rig, fault)
        return
    peer = None if phase == "hold" or fault.channel == LEADER else RIGHT
    channels = [fault.channel, *([peer] if peer else [])]
    followers = [channel for channel in channels if channel != LEADER]
    session = session_on(rig, *(config_of(rig, channel) for channel in channels))
    session.start()
    try:
        track(session, dict.fromkeys(followers, AWAY), 1.3)
        for channel in followers if phase == "hold" else []:
            session[channel].hold()
        for channel in channels:
            look_at(rig, channel)
        if phase == "land":
            check_landing(rig, session, fault, channels)
        else:
            check_in_session(rig, session, fault, peer)
    finally:
        rig.clear_faults(fault.channel)
        session.stop()
    pause(rig, 0.5)
    for channel in channels:
        assert not enabled(rig, channel)
        if channel != fault.channel or RESPONSES[fault.trouble].arm is not Response.LOST:
            assert moved_after_cut_m(rig, channel) < MOST_M
        check_extremes(rig, channel)


def check_extremes(rig, channel):
    """No command asked for more torque than the clip. Nor was a motor faster than its limit and what a late command may
    add, unless a dead joint of its arm fell."""
    late_s = check_torque(rig, channel)
    seen, hardware = recorders.watch(rig, channel), ResolvedArm(config_of(rig, channel))
    n = hardware.joints
    dead = [e for e in rig.events() if e["kind"] == "motor_fault" and e["channel"] == channel]
    if not dead or dead[-1]["monotonic_s"] < seen["since_s"]:
        allowed = 1.3 * hardware.speed_limit[:n] + [stale_overshoot_rad_s(float(age_s)) for age_s in late_s]
        assert np.all(seen["max_speed_rad_s"][:n] < allowed), seen


def check_torque(rig, channel):
    """Returns how late the latest command of each joint was, s."""
    hardware = ResolvedArm(config_of(rig, channel))
    n = hardware.joints
    late_s = np.maximum(np.array(recorders.watch(rig, channel)["max_command_age_s"][:n]) - 0.008, 0.0)
    beyond = beyond_nm(rig, channel, hardware, KNOWN_S + late_s)
    assert not beyond.any(), beyond
    return late_s


def check_bring_up(rig, fault):
    """Refused, naming the part, with nothing energised; or no obstacle."""
    fault.inject(rig)
    session = session_on(rig, config_of(rig, fault.channel))
    if fault.refused is None:
        session.start()
        session[fault.channel].observe()
    else:
        with pytest.raises(YamError, match=f"(?s){fault.refused}") as refusal:
            session.start()
        assert fault.named in str(refusal.value)
        rig.clear_faults(fault.channel)
        pause(rig, 0.05)
        assert not enabled(rig, fault.channel)
    session.stop()


def check_in_session(rig, session, fault, peer):
    slack_s = SLACK_S[isolation_of(rig)]
    rule, port, clock = RESPONSES[fault.trouble], session[fault.channel], session.clock
    before = rig.state()["arms"][fault.channel]["q"]
    lost_before = port.observe().lost
    fault.inject(rig)
    if rule.arm is Response.GO_ON:
        mode = port.mode()
        begin = clock.now()
        while clock.now() < begin + 1.0:
            state = port.observe()  # never an error
            assert clock.now() - state.stamp_s < 0.25
            if mode is Mode.TRACK:
                port.write_target(AWAY, 0.5)
            assert port.mode() is mode
            clock.sleep(0.01)
        lost = np.subtract(state.lost, lost_before)[2]
        assert lost >= {Trouble.REPLY_LOST: 1, Trouble.REPLIES_LOST: 12}.get(fault.trouble, 0)
        if fault.trouble is Trouble.ENCODER_SILENT:
            assert state.trigger is None
        if fault.trouble is Trouble.WARM:
            assert Limited.HEAT in state.limited
        return
    # A motor that answers under a wrong id is, in a session, a silent one.
    expected = Trouble.MOTOR_SILENT if fault.trouble is Trouble.WRONG_ID else fault.trouble
    rule = RESPONSES[expected]

    def refused():
        try:
            port.observe()
        except YamError as error:
            assert fault.named in str(error), str(error)
            return True
        return False

    wait_for(clock, "the caller is told", refused, rule.within_s + slack_s)
    assert trouble_of(session, fault.channel) == expected
    if rule.arm is Response.LAND:
        wait_for(clock, "the arm is landed", lambda: port.mode() is Mode.OFF, 12.0)
        assert not enabled(rig, fault.channel)
    else:
        assert port.mode() is Mode.FAULT
    if peer is not None:
        assert rule.peer is Response.HOLD
        wait_for(clock, "the peer holds", lambda: session[peer].mode() is Mode.HOLD, slack_s)
        state = session[peer].observe()
        assert Limited.PEER in state.limited
        session[peer].write_target(-AWAY, 0.0)
        clock.sleep(0.3)
        assert session[peer].observe().setpoint_q == pytest.approx(state.setpoint_q, abs=0.05)
    if rule.arm is Response.HOLD:
        clock.sleep(0.2)
        lost = set(rig.state()["arms"][fault.channel]["motors"]) - enabled(rig, fault.channel)
        assert lost <= {MOTOR}  # a silent one lets go by itself, sooner or later
        assert lost or expected not in FAULT_TROUBLE.values()
        others = [0, 1, 3, 4, 5]  # hold on while joint 3 may sag
        after = rig.state()["arms"][fault.channel]["q"]
        assert np.abs(np.subtract(after, before))[others].max() < 0.25
    rig.clear_faults(fault.channel)
    if rule.in_place:
        clock.sleep(1.0)  # what falls has fallen
        check_torque(rig, fault.channel)
        look_at(rig, fault.channel)
        session.rearm()
        assert port.observe().mode is Mode.HOLD and not trouble_of(session, fault.channel)
        track(session, dict.fromkeys([fault.channel, *([peer] if peer else [])], AWAY), 0.3)
        assert port.observe().mode is Mode.TRACK
        if peer is not None:
            assert session[peer].observe().mode is Mode.TRACK
    elif rule.arm is not Response.LAND:
        with pytest.raises(YamError, match="connect again"):
            session.rearm()


def check_landing(rig, session, fault, channels):
    """A landing goes on with what is left, and ends."""
    for channel in channels:
        session[channel].land()
    clock = session.clock
    clock.sleep(0.5)
    fault.inject(rig)
    begin = clock.now()
    session.stop()
    assert clock.now() < begin + 20.0, "the landing does not end"
    rig.clear_faults(fault.channel)
    for channel in channels:
        assert not enabled(rig, channel)
