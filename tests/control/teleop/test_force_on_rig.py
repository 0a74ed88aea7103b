"""The force at a leader in a hand on the virtual rig: how soon a push is felt, and how gently it begins."""

import numpy as np
import pytest

from lerobot_robot_yam.state.modes import Gate
from scripts import recorders
from tests.support.coupled import FOLLOWER, LEADER, POSE, Passing, coupled_session, started
from tests.support.rigged import lockstep_rig, rig_of
from tests.support.tiers import spread

rig = lockstep_rig(LEADER, FOLLOWER)
FELT_NM = 0.05
GENTLE_S, TICK_S = 0.5, 0.004


def force_on(session):
    """(6,) Nm at the leader's joints, zeros while there is none."""
    assist = session._runner._loop._controllers[0].lead.assist
    return np.zeros(6) if assist is None else assist[0].copy()


@pytest.mark.parametrize("push_n", spread([([5.0, 0.0, 0.0],), ([0.0, 5.0, 0.0],), ([0.0, 0.0, -5.0],)], 1))
def test_a_push_is_felt_within_two_ticks(rig, push_n):
    """Of each joint a tenth of what it will be, once it has moved by 1 mrad or, if that is more, by a tenth."""
    session, caller = started(rig, bilateral=0.2)
    caller.run(0.5)
    before = force_on(session)
    recorders.truth_start(rig, FOLLOWER, 5.0)
    rig.push(FOLLOWER, "tool", push_n, 3.0)
    felt = []
    caller.run(1.5, lambda: felt.append((session.clock.now(), force_on(session) - before)))
    truth = recorders.truth(rig, FOLLOWER)
    moved = np.abs(truth["q"] - truth["q"][0])
    times, taus = (np.array(column) for column in zip(*felt, strict=True))
    final = taus[-20:].mean(axis=0)
    joints = np.flatnonzero(np.abs(final) > FELT_NM)
    assert len(joints)
    for joint in joints:
        moves = moved[:, joint] > max(1e-3, 0.1 * moved[-1, joint])
        feels = taus[:, joint] / final[joint] > 0.1
        assert times[np.argmax(feels)] - truth["stamp_s"][np.argmax(moves)] < 2 * TICK_S, joint + 1
    session.discard()


@pytest.mark.long
@pytest.mark.parametrize("poses", [1, 3])
def test_engaging_from_any_pose_is_gentle(rig, poses):
    """What it adds by its end, at each joint: at most 1 Nm, or half of what the joint weighs, whatever pushes."""
    session = coupled_session(rig, gate="button", gate_button="top", bilateral=0.5)
    session.start()
    caller, rng = Passing(session), np.random.default_rng(5)
    leader = session._runner._loop._controllers[0].actuation
    taus, bounds = [], []

    def note():
        if session[LEADER].published().gate is not Gate.ENGAGED:
            assert not force_on(session).any()
        elif len(taus) * TICK_S < GENTLE_S:
            if not taus:
                rig.push(FOLLOWER, "link4", rng.choice([-40.0, 40.0], 3).tolist(), GENTLE_S)
            taus.append(np.abs(force_on(session)))
            bounds.append(np.maximum(1.0, 0.5 * np.abs(leader.impedance.weight_nm)))

    for _ in range(poses):
        taus.clear()
        bounds.clear()
        q = rng.uniform([-0.8, 0.3, 0.5, -0.8, -0.8, -1.0], [0.8, 1.6, 1.6, 0.8, 0.8, 1.0])
        rig.lift(LEADER, q.tolist(), 1.2)
        caller.run(1.4, note)
        rig.press(LEADER, "sync")
        caller.run(3.4, note)
        assert len(taus) * TICK_S >= GENTLE_S and (np.array(taus) <= bounds).all()
        assert np.max(taus) > 0.8  # it is the bound that holds it back
        rig.press(LEADER, "sync")
        caller.run(0.2, note)
    session.discard()


def test_a_slow_adapter_reduces_the_force_and_nothing_swings(caplog):
    with rig_of("lockstep", arms=[LEADER, FOLLOWER], latency_s=0.02) as slow:
        session, caller = started(slow, bilateral=0.5)
        caller.run(0.8)
        slow.push(LEADER, "tool", [8.0, 5.0, 0.0], 0.1)
        slow.release(LEADER)
        caller.run(1.2)
        recorders.truth_start(slow, LEADER, 1.0)
        caller.run(0.3)
        assert np.abs(recorders.truth(slow, LEADER)["dq"][:, :6]).max() < 0.1
        assert force_on(session).any(), "it is meant to pull"
        session.discard()
    told = [record.message for record in caplog.records if "force feedback" in record.message]
    assert len(told) == 1 and "leader_left: force feedback (bilateral) reduced from 0.50 to 0.07" in told[0]


@pytest.mark.long
def test_a_firm_hand_that_trembled_is_still_again(rig):
    session, caller = started(rig, bilateral=0.2)
    rng = np.random.default_rng(0)
    times = np.arange(0.02, 2.0, 0.02)
    trembling = POSE + rng.normal(0.0, 3e-3, (len(times), 6))
    rig.hand(LEADER, times.tolist(), trembling.tolist(), gives_way=False)
    caller.run(1.0)
    rig.hand(LEADER, [0.3], [POSE.tolist()], gives_way=False)
    caller.run(0.6)
    recorders.truth_start(rig, LEADER, 1.0)
    caller.run(0.3)
    assert np.abs(recorders.truth(rig, LEADER)["dq"]).max() < 0.01
    session.discard()
