"""Positions in a state are those at its time stamp, whatever the adapter takes; where not, the state says so."""

import math

import numpy as np
import pytest

from scripts import recorders
from tests.support.rigged import lockstep_rig, session_on, sim_config, track
from tests.support.tiers import spread

CHANNEL = "follower_left"
POSE = np.array([0.1, 1.0, 1.0, -0.2, 0.1, 0.1])
STEP_RAD, MOST_RAD = 25.0 / 65535, 0.002  # of a motor's encoder; beyond it

rig = lockstep_rig(CHANNEL)


def follow_wave(rig, session, seconds):
    """States of an arm that moves all joints to and fro, and how far their positions are off the truth, rad."""
    recorders.truth_start(rig, CHANNEL)
    begin_s = session.clock.now()
    states = []
    while (passed_s := session.clock.now() - begin_s) < seconds:
        wave = np.full(6, 0.15 * math.sin(2 * math.pi * 1.5 * passed_s))
        session[CHANNEL].write_target(POSE + wave, 0.5)
        session.clock.sleep(0.012)
        states.append(session[CHANNEL].published())
    truth = recorders.truth(rig, CHANNEL, begin_s)
    known = [state for state in states if truth["stamp_s"][0] < state.stamp_s < truth["stamp_s"][-1]]
    off = [[np.interp(s.stamp_s, truth["stamp_s"], truth["q"][:, j]) - s.q[j] for j in range(6)] for s in known]
    return known, np.abs(off).max(axis=1)


@pytest.mark.parametrize(
    "latency_s, later_s, lost",
    spread([(0.001, 0.001, 0.0), (0.005, 0.005, 0.0), (0.001, 0.005, 0.0), (0.005, 0.005, 0.3)], 1, 2, 3),
)
def test_positions_are_those_at_the_stamp_or_the_state_says_how_far_off(rig, latency_s, later_s, lost):
    rig.fault(CHANNEL, None, "latency_s", latency_s)
    session = session_on(rig, sim_config(rig, CHANNEL))
    session.start()
    try:
        track(session, {CHANNEL: POSE}, 1.1)
        rig.fault(CHANNEL, None, "latency_s", later_s)
        rig.fault(CHANNEL, None, "loss_rate", lost)
        states, off = follow_wave(rig, session, 1.2)
        said = np.array([state.q_error_rad for state in states])
        assert (off <= STEP_RAD + np.maximum(said, MOST_RAD)).all()
        if not lost and latency_s == later_s:
            assert said.max() <= MOST_RAD
        assert max(np.abs(state.dq).max() for state in states) > 1.0
    finally:
        session.discard()
