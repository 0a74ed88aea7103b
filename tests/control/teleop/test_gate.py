"""The gate's state machine: no clock, no arms."""

import itertools

import numpy as np
import pytest

from lerobot_robot_yam.arm.leaders.lead_config import LeadConfig
from lerobot_robot_yam.control.teleop.gate import LEFT_BEHIND_RAD, START, TABLE, GateMachine, Look, SharedGate
from lerobot_robot_yam.state.modes import Gate
from tests.support.tiers import spread

TICK_S = 0.004
NEAR = Look(away_rad=0.02, home=True, follows=True, approached=True)
FAR = Look(away_rad=1.0, follows=True, approached=True)


def machine(gate="auto", **options):
    button = {"gate_button": "top"} if gate == "button" else {}
    return GateMachine(LeadConfig(follower="any", gate=gate, **button, **options))


def run(gate, look, seconds=TICK_S, begin=0.0):
    """Looks at one arm for so long; returns when it ended."""
    now = begin
    while now < begin + seconds - 1e-9:
        gate.advance(now, [look])
        now += TICK_S
    return now


def in_state(state, gate="auto"):
    """A machine that has come to a state by its own ways."""
    ways = {
        Gate.HOMING: [],
        Gate.IDLE: [NEAR],
        Gate.APPROACH: [NEAR, Look(away_rad=1.0)],
        Gate.ENGAGED: [NEAR, Look(away_rad=1.0), FAR],
        Gate.FINE: [NEAR, Look(away_rad=1.0), FAR, Look(away_rad=1.0, follows=True, fine_pressed=True)],
    }
    ways[Gate.RECENTRE] = [*ways[Gate.FINE], Look(away_rad=1.0, follows=True, fine_pressed=True)]
    found = machine(gate)
    for number, look in enumerate(ways[state]):
        found.advance(number * TICK_S, [look])
    assert found.state is state
    return found


def test_lifting_engages_and_returning_releases():
    gate = machine()
    assert gate.state is Gate.HOMING
    now = run(gate, NEAR)
    assert gate.state is Gate.IDLE
    now = run(gate, Look(away_rad=0.6), begin=now)
    assert gate.state is Gate.APPROACH
    now = run(gate, FAR, begin=now)
    assert gate.state is Gate.ENGAGED
    now = run(gate, Look(away_rad=0.2, follows=True), 0.49, now)
    assert gate.state is Gate.ENGAGED
    run(gate, Look(away_rad=0.2, follows=True), 0.02, now)
    assert gate.state is Gate.HOMING


def test_a_short_dip_below_the_release_threshold_does_not_release():
    gate = in_state(Gate.ENGAGED)
    now = run(gate, Look(away_rad=0.2, follows=True), 0.4, 1.0)
    now = run(gate, Look(away_rad=0.35, follows=True), begin=now)
    run(gate, Look(away_rad=0.2, follows=True), 0.4, now)
    assert gate.state is Gate.ENGAGED


@pytest.mark.parametrize("state", [Gate.APPROACH, Gate.ENGAGED, Gate.FINE, Gate.RECENTRE])
def test_every_state_in_which_the_follower_moves_with_the_leader_releases(state):
    gate = in_state(state)
    run(gate, Look(away_rad=0.1, follows=True), 0.6, 1.0)
    assert gate.state in (Gate.HOMING, Gate.IDLE)


def test_lifting_breaks_the_homing_off_and_being_far_from_home_does_not():
    gate = machine()
    now = run(gate, Look(away_rad=1.0), 1.0)  # it is led home from there
    assert gate.state is Gate.HOMING
    now = run(gate, Look(away_rad=0.8), 1.0, now)
    run(gate, Look(away_rad=0.96), begin=now)
    assert gate.state is Gate.APPROACH


def test_two_leaders_engage_and_release_together():
    gate = machine()
    gate.advance(0.0, [NEAR, NEAR])
    gate.advance(0.1, [FAR, NEAR])
    assert gate.state is Gate.IDLE
    gate.advance(0.2, [FAR, FAR])
    gate.advance(0.3, [FAR, FAR])
    assert gate.state is Gate.ENGAGED
    for now in (1.0, 1.6, 2.2):
        gate.advance(now, [NEAR, FAR])
    assert gate.state is Gate.ENGAGED
    for now in (3.0, 3.51):
        gate.advance(now, [NEAR, NEAR])
    assert gate.state is Gate.HOMING


def test_a_button_engages_and_releases():
    gate = machine("button")
    assert gate.state is Gate.IDLE
    run(gate, FAR)
    assert gate.state is Gate.IDLE
    for expected in (Gate.APPROACH, Gate.ENGAGED):
        gate.advance(1.0, [Look(pressed=expected is Gate.APPROACH, follows=True, approached=True)])
        assert gate.state is expected
    gate.advance(2.0, [Look(pressed=True, follows=True)])
    assert gate.state is Gate.IDLE


def test_fine_mode_goes_on_and_off_with_its_button():
    gate = in_state(Gate.FINE)
    gate.advance(2.0, [Look(away_rad=1.0, follows=True, fine_pressed=True)])
    assert gate.state is Gate.RECENTRE
    gate.advance(2.1, [Look(away_rad=1.0, follows=True, recentred=True)])
    assert gate.state is Gate.APPROACH


def test_a_follower_that_was_left_behind_approaches_again():
    gate = in_state(Gate.ENGAGED)
    gate.advance(2.0, [Look(away_rad=1.0, follows=False, gap_rad=LEFT_BEHIND_RAD - 0.01)])
    assert gate.state is Gate.ENGAGED
    gate.advance(2.1, [Look(away_rad=1.0, follows=True, gap_rad=1.0)])  # held back by an obstacle
    assert gate.state is Gate.ENGAGED
    gate.advance(2.2, [Look(away_rad=1.0, follows=False, gap_rad=LEFT_BEHIND_RAD + 0.01)])
    assert gate.state is Gate.APPROACH


@pytest.mark.parametrize("gate", TABLE)
def test_the_table_leads_everywhere_and_back(gate):
    reached, found = {START[gate]}, True
    while found:
        found = {to for state, _, to in TABLE[gate] if state in reached} - reached
        reached |= found
    assert reached == {state for state, _, _ in TABLE[gate]} | {to for _, _, to in TABLE[gate]}
    for state in reached:
        assert any(origin is state for origin, _, _ in TABLE[gate])


def expected_transitions(away, config):
    """The same by its definition, from the whole distance (k,) in ticks: times at which it engages and releases."""
    times, engaged = [], False
    below = 0
    for index, distance in enumerate(away):
        below = below + 1 if distance < config.release_threshold_rad else 0
        if not engaged and distance > config.engage_threshold_rad:
            engaged = True
            times.append(index)
        elif engaged and (below - 1) * TICK_S >= config.release_s - 1e-9:
            engaged = False
            times.append(index)
    return times


def lift_and_return(rng):
    """Distance from home over some seconds: lifts, returns, hesitation at the thresholds, and noise."""
    knots = [0.02]
    for _ in range(rng.integers(3, 9)):
        knots += [rng.uniform(0.0, 1.2) for _ in range(rng.integers(1, 4))]
        knots += [rng.uniform(0.0, 0.29)] * int(rng.integers(0, 3))
    at = np.cumsum(rng.uniform(0.05, 0.9, len(knots)))
    t = np.arange(0.0, at[-1] + 1.0, TICK_S)
    return np.abs(np.interp(t, at, knots) + rng.normal(0.0, 0.004, len(t)))


@pytest.mark.parametrize("seed", spread(range(200), *range(40)))
def test_random_lifts_and_returns_miss_double_and_hurry_no_transition(seed):
    """The arms are home at once and caught up at once: what is left are lifts, also during homing."""
    away = lift_and_return(np.random.default_rng(seed))
    gate = machine()
    gate.advance(-1.0, [NEAR])
    seen, states = [], [gate.state]
    for index, distance in enumerate(away):
        look = Look(away_rad=float(distance), home=bool(distance < 0.1), follows=True, approached=True)
        if gate.advance(index * TICK_S, [look]):
            states.append(gate.state)
            if gate.state in (Gate.APPROACH, Gate.HOMING):
                seen.append(index)
    expected = expected_transitions(away, LeadConfig(follower="any"))
    assert seen == expected
    assert all(a is not b for a, b in itertools.pairwise(states))


def test_a_shared_gate_waits_for_both_and_says_each_transition_once(caplog):
    caplog.set_level("INFO")
    gate = SharedGate(machine(), ["left", "right"])
    for number, (left, right) in enumerate([(NEAR, NEAR), (FAR, NEAR), (FAR, FAR), (FAR, FAR)]):
        gate.advance(number * TICK_S, 0, left)
        gate.advance(number * TICK_S, 1, right)
    assert gate.machine.state is Gate.ENGAGED
    assert [record.message for record in caplog.records] == [
        "left and right: gate: homing -> idle (home)",
        "left and right: gate: idle -> approach (away)",
        "left and right: gate: approach -> engaged (caught up)",
    ]
