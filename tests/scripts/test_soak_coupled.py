"""The soak's judge of followers that follow at loop rate, and the hands that lift and return their leaders."""

import numpy as np
import pytest

from lerobot_robot_yam.state.modes import Gate, Mode
from tests.support.soak_records import CHANNEL, TICK_S, record

LEAVE = "a follower is led with its caller's leave"
LEADS = "a follower is led by a leader that leads"
ASKS = "a follower is asked what its leader asks"


def told(tick, action, mode=Mode.TRACK, leader=1, target=1):
    """A follower's record."""
    row = record(tick, np.zeros(7), mode)
    row["action"][:7], row["coupled_to"], row["target_sequence"] = action, leader, target
    return row


def asked(tick, action, mode=Mode.FLOAT, rate=0.0, gate=Gate.ENGAGED):
    """A leader's record."""
    row = record(tick, np.zeros(6), mode)
    row["action"][:7], row["action_dq"][:7], row["gate"] = action, rate, gate
    row["action_stamp_s"] = row["stamp_s"]
    return row


def findings(check, rows):
    return [finding.invariant for follower, leader in rows for finding in check.look(follower, leader)]


@pytest.mark.parametrize(("silent_ticks", "found"), [(120, []), (145, [LEAVE])])
def test_a_leader_is_followed_no_longer_than_its_caller_has_said(soak, silent_ticks, found):
    rows = [(told(tick, 0.0, target=tick), asked(tick, 0.0)) for tick in range(50)]
    rows += [(told(50 + tick, 0.0, target=49), asked(50 + tick, 0.0)) for tick in range(silent_ticks)]
    assert findings(soak.coupled.CouplingCheck(CHANNEL), rows) == found


@pytest.mark.parametrize(
    "lost", [{"mode": Mode.FAULT}, {"mode": Mode.LAND}, {"action": np.nan}, {"mode": Mode.FAULT, "action": np.nan}]
)
@pytest.mark.parametrize(("ticks", "found"), [(15, []), (60, [LEADS])])
def test_a_leader_that_cannot_lead_is_not_followed(soak, lost, ticks, found):
    rows = [(told(tick, 0.0, target=tick), asked(tick, 0.0)) for tick in range(50)]
    rows += [(told(tick, 0.0, target=tick), asked(tick, **{"action": 0.0} | lost)) for tick in range(50, 50 + ticks)]
    assert findings(soak.coupled.CouplingCheck(CHANNEL), rows) == found


def test_a_leader_may_have_led_while_the_judge_saw_no_records(soak):
    rows = [(told(tick, 0.0, target=tick), asked(tick, 0.0)) for tick in range(50)]
    rows += [(told(tick, 0.0, target=tick), asked(tick, np.nan)) for tick in range(100, 110)]
    assert findings(soak.coupled.CouplingCheck(CHANNEL), rows) == []
    rows += [(told(tick, 0.0, target=tick), asked(tick, np.nan)) for tick in range(110, 160)]
    assert findings(soak.coupled.CouplingCheck(CHANNEL), rows) == [LEADS]


@pytest.mark.parametrize(
    ("beside", "from_tick", "found"),
    [
        (0.3, 0, []),  # it has just joined, and comes
        (0.3, 1100, [ASKS]),
        (0.01, 1100, []),
    ],
)
def test_a_follower_that_has_caught_up_is_asked_what_its_leader_asks(soak, beside, from_tick, found):
    rows = []
    for tick in range(1200):
        goes = 1.5 * np.sin(tick * TICK_S)
        there = goes + (beside if from_tick <= tick < from_tick + 90 else 0.0)
        rate = 1.5 * np.cos(tick * TICK_S)
        leader = asked(tick, goes - rate * 2 * TICK_S, rate=rate)  # as it was two ticks ago
        leader["action_stamp_s"] -= 2 * TICK_S
        rows.append((told(tick, there, target=tick), leader))
    assert findings(soak.coupled.CouplingCheck(CHANNEL), rows) == found


def test_who_is_not_coupled_is_not_judged_and_gates_are_counted(soak):
    check = soak.coupled.CouplingCheck(CHANNEL)
    gates = [Gate.HOMING, Gate.IDLE, Gate.APPROACH, Gate.ENGAGED, Gate.HOMING]
    for tick in range(100):
        leader = asked(tick, 1.0, Mode.FAULT, gate=gates[tick // 20])
        assert not check.look(told(tick, 0.0, leader=0, target=1), leader)
    assert check.gates == {"idle": 1, "approach": 1, "engaged": 1, "homing": 1} and check.records == 0


def test_what_a_leader_asks_is_no_silence_of_the_caller(soak):
    check = soak.obedience.ObedienceCheck(CHANNEL)
    for tick in range(300):
        assert not check.look(told(tick, 0.0), None)
    found = [finding for tick in range(300, 500) for finding in check.look(told(tick, 0.0, leader=0), None)]
    assert [finding.invariant for finding in found] == ["a silent caller's arm holds"]
