"""A leader's side of a pair, tick by tick, beside a follower of which it sees what it publishes."""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.state.modes import Gate, Mode
from tests.support.published_follower import TICK_S, LedPairs


@pytest.fixture
def pairs():
    """Makes pairs with these options of their leaders."""
    with contextlib.ExitStack() as stack:

        def make(*args, **lead):
            return stack.enter_context(contextlib.closing(LedPairs(*args, **lead)))

        yield make


def engaged(pairs, *args, **lead):
    made = pairs(*args, **lead)
    made.run(0.1)
    assert all(lead.state is Gate.ENGAGED for lead in made.leads)
    return made


def test_a_follower_that_another_moves_does_not_pull_the_leader(pairs):
    pair = engaged(pairs, bilateral=0.4)
    lead = pair.leads[0]
    assert lead.assist is not None
    pair.coupled[0] = False
    for _ in range(100):
        pair.setpoints[0][:6] += 0.002
        pair.run()
        assert lead.state is Gate.ENGAGED
        assert lead.assist is None


def test_a_mirroring_leader_goes_along_softly_while_another_moves_the_follower(pairs):
    pair = engaged(pairs, mirror=True, bilateral=0.5)
    lead = pair.leads[0]
    pair.coupled[0] = False
    before = np.zeros(6)
    for _ in range(250):  # the leader is held by a hand
        pair.setpoints[0][:6] += 0.002
        pair.run()
        tau = lead.assist[0]
        assert np.abs(tau).max() < 2.0 + 1e-9 and np.abs(tau - before).max() < 0.4
        before = tau
    assert np.all(before > 0.5)
    pair.setpoints[0][6] = 0.4
    pair.run()
    pair.coupled[0] = True  # taken over: from here on it feels its follower's force alone, which begins at nothing
    pair.run()
    assert np.abs(lead.assist[0]).max() < 0.05
    assert lead.action[6] == pytest.approx(0.4)  # though the trigger is released
    pair.coupled[0], pair.follower_modes[0] = False, Mode.HOLD
    pair.run()
    assert lead.assist is None  # nobody moves the follower


def test_a_follower_that_is_coupled_again_pulls_gently(pairs):
    pair = engaged(pairs, bilateral=0.5)
    pair.behind[0][:6] = -0.08
    pair.run(3.0)
    assert np.abs(pair.leads[0].assist[0]).max() > 2.0
    pair.coupled[0], pair.follower_modes[0] = False, Mode.HOLD
    pair.run(0.2)
    assert pair.leads[0].state is Gate.ENGAGED
    pair.coupled[0] = True
    before = np.zeros(6)
    for _ in range(100):
        pair.run()
        tau = pair.leads[0].assist[0]
        assert np.abs(tau - before).max() < 0.05
        before = tau
    assert np.abs(before).max() > 0.1


def test_a_leader_is_led_home_only_while_its_follower_is_coupled(pairs):
    pair = pairs(gate="auto")
    lead = pair.leads[0]
    pair.q[0][:] = 0.4
    for coupled, mode in [(False, Mode.HOLD), (False, Mode.TRACK), (True, Mode.TRACK), (False, Mode.TRACK)]:
        pair.coupled[0], pair.follower_modes[0] = coupled, mode
        pair.run(0.2)
        assert lead.state is Gate.HOMING
        assert (lead.assist is not None) is coupled


def test_leading_home_goes_on_without_a_jolt_from_where_the_leader_is(pairs):
    pair = pairs(gate="auto")
    lead = pair.leads[0]
    pair.q[0][:] = 0.2
    pair.run(0.5)
    assert lead.assist is not None
    pair.coupled[0] = False
    pair.run(0.1)
    pair.q[0][:] = 0.45
    pair.run(0.5)
    pair.coupled[0] = True
    pair.run()
    assert np.abs(lead.assist[0]).max() < 0.1


@pytest.mark.parametrize("lost", [0, 1])
def test_a_gate_waits_while_one_of_its_leaders_cannot_lead(pairs, caplog, lost):
    caplog.set_level("INFO")
    both = engaged(pairs, ("left", "right"), together=True)
    caplog.clear()
    both.modes[lost] = Mode.FAULT
    for _ in range(50):
        both.run()
        assert both.leads[1 - lost].assist is None
    assert [record.message for record in caplog.records if "gate:" in record.message] == [
        "leader_left and leader_right: gate: engaged -> approach (cannot lead)"
    ]
    assert both.leads[lost].action is None
    both.modes[lost] = Mode.FLOAT
    both.run(0.1)
    assert all(lead.state is Gate.ENGAGED for lead in both.leads)


def test_a_press_of_a_leader_that_is_lost_then_counts_once_at_most(pairs):
    both = pairs(("left", "right"), together=True, gate="button", gate_button="top")
    both.run(0.1)
    both.handles[0] = 0.0, (True, False)
    both.run()
    states = []
    both.modes[0] = None  # held because of another arm
    for _ in range(50):
        both.run()
        states.append(both.leads[1].state)
    assert set(states) == {Gate.IDLE}
    assert both.leads[0].action is None


def test_a_policys_grip_stays_at_a_take_over(pairs):
    pair = engaged(pairs)
    assert pair.setpoints[0][6] == pytest.approx(1.0)
    pair.coupled[0] = False
    pair.setpoints[0][6] = 0.3
    pair.run(2.0)
    pair.coupled[0] = True
    pair.run(0.5)
    assert pair.setpoints[0][6] == pytest.approx(0.3)
    for trigger, opening in [(0.5, 0.3), (0.72, 0.28), (0.2, 0.8)]:
        pair.handles[0] = trigger, (False, False)
        pair.run(0.1)
        assert pair.setpoints[0][6] == pytest.approx(opening)


def test_a_trigger_squeezed_before_a_policys_grip_does_not_open_it(pairs):
    pair = engaged(pairs)
    pair.handles[0] = 0.9, (False, False)
    pair.run(0.1)
    pair.coupled[0] = False
    pair.setpoints[0][6] = 0.3
    pair.handles[0] = 0.0, (False, False)
    pair.run(2.0)
    pair.coupled[0] = True
    pair.run(0.2)
    assert pair.setpoints[0][6] == pytest.approx(0.3)


def test_a_caller_that_changes_actions_moves_the_gripper(pairs):
    pair = engaged(pairs)
    pair.coupled[0] = False
    for tick in range(200):
        pair.handles[0] = min(tick / 50, 0.9), (False, False)
        if tick % 8 == 0:
            pair.setpoints[0][6] = pair.leads[0].action[6]
        pair.run()
    assert pair.setpoints[0][6] == pytest.approx(0.1)


def test_a_force_that_misses_data_fades_and_returns_without_a_step(pairs):
    pair = engaged(pairs, bilateral=0.2)
    lead = pair.leads[0]
    pair.behind[0][:6] = -0.08
    pair.run(2.0)
    full = before = lead.assist[0]
    taus = []
    for tick in range(600):
        pair.publishes[0] = tick % 60 > 15
        pair.run()
        tau = np.zeros(6) if lead.assist is None else lead.assist[0]
        assert (np.abs(tau - before) <= 0.21 * np.abs(full).max()).all()
        before = tau
        taus.append(abs(tau[0]))
    assert min(taus[100:]) < 0.1 and max(taus[100:]) > 0.3  # it goes, and it comes back
    pair.modes[0] = None  # another arm is in fault
    pair.run()
    assert lead.assist is None


LOST = {
    "its process is gone, and its block": lambda pair: pair.remove_follower(0),
    "its loop hangs": lambda pair: pair.publishes.__setitem__(0, False),
    "it has failed": lambda pair: pair.follower_modes.__setitem__(0, Mode.FAULT),
    "a stand-by lands it": lambda pair: pair.follower_modes.__setitem__(0, Mode.LAND),
}


@pytest.mark.parametrize("how", LOST)
def test_a_leader_whose_follower_is_lost_floats_without_force_and_its_gate_waits(pairs, caplog, how):
    pair = engaged(pairs, bilateral=0.4)
    lead = pair.leads[0]
    pair.behind[0][:6] = -0.08
    pair.run(1.0)
    assert np.abs(lead.assist[0]).max() > 1.0
    LOST[how](pair)
    pair.coupled[0] = False
    for tick in range(250):
        pair.q[0] += 0.002  # in mid-motion
        pair.run()
        assert lead.state is Gate.ENGAGED and lead.action[:6] == pytest.approx(pair.q[0], abs=0.02)
        assert tick < 28 or lead.assist is None  # 30 ms old, then it has faded
    said = [record.message for record in caplog.records if record.levelname == "WARNING"]
    what = "is silent, or neither holds nor tracks; it floats without force"
    assert said == [f"leader_left: its follower {pair.name}.follower_left {what}"]


def test_a_follower_that_is_armed_again_elsewhere_is_approached_by_no_leap(pairs):
    pair = pairs(gate="button", gate_button="top", bilateral=0.4)
    lead = pair.leads[0]
    pair.run(0.1)
    pair.handles[0] = 0.0, (True, False)
    pair.run(0.7)
    assert lead.state is Gate.ENGAGED
    pair.follower_modes[0], pair.coupled[0] = Mode.FAULT, False
    pair.q[0][:] = 0.6
    pair.run(0.5)
    pair.follower_modes[0] = Mode.HOLD
    pair.run()
    assert lead.state is Gate.APPROACH and np.abs(lead.action[:6]).max() < 0.01
    pair.follower_modes[0], pair.coupled[0] = Mode.TRACK, True
    before = lead.action
    while lead.state is Gate.APPROACH:
        pair.run()
        assert lead.assist is None or lead.state is Gate.ENGAGED
        assert np.abs(lead.action - before)[:6].max() <= 1.01 * TICK_S  # approach_speed_rad_s is 1.0
        before = lead.action
    assert lead.state is Gate.ENGAGED and np.abs(lead.assist[0]).max() < 0.05
