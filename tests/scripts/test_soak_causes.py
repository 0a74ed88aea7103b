"""The soak's schedule, the causes of trouble it knows, and what arms do in trouble, at a stop and in silence."""

import numpy as np
import pytest

from lerobot_robot_yam.state.faults import Trouble
from lerobot_robot_yam.state.modes import Mode
from tests.support.soak_records import CHANNEL, PEER, record


def test_an_arm_in_trouble_and_its_peer_do_as_the_policy_says(soak):
    def looked(mode, peer_mode, trouble=Trouble.OVER_CURRENT):
        check = soak.checks.PolicyCheck({CHANNEL: PEER})
        found = []
        for tick in range(100):
            row = record(tick, np.zeros(7), mode, trouble=trouble)
            found += check.look(CHANNEL, row, record(tick, np.zeros(7), peer_mode))[0]
        return {finding.invariant for finding in found}

    assert not looked(Mode.FAULT, Mode.HOLD)
    assert looked(Mode.FAULT, Mode.TRACK) == {"the other arm as the policy says"}
    assert looked(Mode.TRACK, Mode.HOLD) == {"the arm as the policy says"}
    assert not looked(Mode.LAND, Mode.HOLD, Trouble.HOT)
    assert looked(Mode.HOLD, Mode.HOLD, Trouble.HOT) == {"the arm as the policy says"}


def event(kind, at_s, **details):
    return {"kind": kind, "monotonic_s": at_s, **details}


def injected(number, what, at_s, motor="", **details):
    fields = {"channel": CHANNEL, "motor": motor, "value": None, "seconds": 0.0} | details
    return event("injected", at_s, injection=number, what=what, **fields)


@pytest.mark.parametrize(
    "what, cut_s, excused",
    [("cable_out", 0.5, True), ("cable_out", 0.2, False), ("push", 0.5, False), ("adapter_gone", 0.1, True)],
)
def test_communication_is_lost_only_where_the_schedule_has_cut_it(soak, what, cut_s, excused):
    context = soak.context.Context([CHANNEL, PEER], [(CHANNEL, PEER)])
    context.take(injected(0, what, 10.0))
    context.take(event("undone", 10.0 + cut_s, injection=0))
    lost = context.take(event("motor_fault", 10.0 + 0.45, channel=CHANNEL, motor="joint_3", fault=0xD))
    assert (not lost) is excused


def test_trouble_needs_a_cause(soak):
    context = soak.context.Context([CHANNEL, PEER], [(CHANNEL, PEER)])
    context.take(injected(0, "lost_replies", 10.0))
    assert not context.explained(CHANNEL, Trouble.OVERLOAD, 10.1)
    context.take(injected(1, "kill_control", 11.0))
    for channel in (CHANNEL, PEER):  # one process drives both
        assert context.explained(channel, Trouble.OVERLOAD, 11.1)
    context.take(event("undone", 11.0, injection=1))
    assert not context.explained(CHANNEL, Trouble.OVERLOAD, 15.0)
    context.take(event("motor_fault", 16.0, channel=CHANNEL, motor="joint_3", fault=0xE))
    assert context.explained(CHANNEL, Trouble.OVERLOAD, 60.0)  # it is in it still
    assert not context.explained(CHANNEL, Trouble.INTERNAL_ERROR, 60.0)


@pytest.mark.parametrize(
    ("what", "trouble", "explained"),
    [
        ("reading_glitch", Trouble.IMPLAUSIBLE, True),
        ("reading_lies", Trouble.IMPLAUSIBLE, True),
        ("garbled", Trouble.IMPLAUSIBLE, True),
        ("garbled", Trouble.OVER_CURRENT, False),  # a fault code in an answer that cannot be
        ("reading_lies", Trouble.OVERLOAD, False),
        ("second_arm", Trouble.DUPLICATE_ID, True),
        ("second_arm", Trouble.DISABLED, True),  # where it lies as ours does, only what it says of itself differs
        ("second_arm", Trouble.OVERLOAD, False),
        ("slow_adapter", Trouble.MOTOR_SILENT, False),
        ("held_back", Trouble.BUS_SILENT, False),
    ],
)
def test_what_lies_explains_only_that_it_is_not_believed(soak, what, trouble, explained):
    context = soak.context.Context([CHANNEL, PEER], [(CHANNEL, PEER)])
    context.take(injected(0, what, 10.0))
    assert context.explained(CHANNEL, trouble, 10.1) is explained


def test_a_motor_that_was_heated_is_hot_for_whoever_comes_next(soak):
    context = soak.context.Context([CHANNEL, PEER], [(CHANNEL, PEER)])
    context.take(injected(0, "motor_hot", 10.0, "joint_2"))
    context.take(event("undone", 20.0, injection=0))
    assert context.explained(CHANNEL, Trouble.HOT, 80.0)
    assert not context.explained(CHANNEL, Trouble.OVERLOAD, 80.0)
    assert not context.explained(CHANNEL, Trouble.HOT, 200.0)
    assert not context.explained(PEER, Trouble.HOT, 30.0)


@pytest.mark.parametrize(
    ("mode", "stopped_s", "wrong"),
    [(Mode.STOPPED, 101.0, ""), (Mode.HOLD, 101.0, "stops"), (Mode.HOLD, None, ""), (Mode.TRACK, None, "silent")],
)
def test_arms_obey_an_emergency_stop_and_silence(soak, mode, stopped_s, wrong):
    check = soak.obedience.ObedienceCheck(CHANNEL)
    found = [f for tick in range(0, 500, 5) for f in check.look(record(tick, np.zeros(7), mode), stopped_s)]
    assert [wrong in finding.invariant for finding in found] == [True] * bool(wrong)  # said once
    assert check.stops > 0 if mode is Mode.STOPPED else check.stops == 0


def test_the_schedule_depends_on_the_seed_only(soak):
    make = soak.schedule.make_schedule
    assert make(300.0, 1) == make(300.0, 1) != make(300.0, 2)
    long, short = make(600.0, 1), make(300.0, 1)
    assert [(i.at_s, i.kind, i.value) for i in long if i.at_s < 300.0] == [(i.at_s, i.kind, i.value) for i in short]
    faults = [i.at_s for i in long if i.kind == "motor_fault"]
    assert np.allclose(np.diff(faults), 30.0, atol=0.01)
    assert {i.kind for i in make(3600.0, 1)} == set(soak.injected_faults.RANDOM)
