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


def test_of_two_arms_in_trouble_one_is_armed_again_first(soak):
    check = soak.checks.PolicyCheck({CHANNEL: PEER})
    both, one = {"mode": Mode.FAULT, "trouble": Trouble.IMPLAUSIBLE}, {"mode": Mode.FLOAT}
    for tick in range(100):
        row = record(tick, np.zeros(7), Mode.FAULT, trouble=Trouble.COMMUNICATION_LOST)
        peer = record(tick, np.zeros(7), **(both if tick < 60 else one))
        assert not check.look(CHANNEL, row, peer)[0]


def test_what_a_landing_arm_does_not_believe_is_told_when_its_landing_is_stopped(soak):
    check = soak.checks.PolicyCheck({CHANNEL: PEER})
    context = soak.context.Context([CHANNEL, PEER], [(CHANNEL, PEER)])
    told = []
    for tick, mode in enumerate([Mode.HOLD] + 2000 * [Mode.LAND] + [Mode.STOPPED, Mode.FAULT]):
        row = record(tick, np.zeros(7), mode, trouble=Trouble.IMPLAUSIBLE if mode is Mode.FAULT else "")
        if tick == 1:
            context.take(injected(0, "reading_lies", float(row["stamp_s"])))
            context.take(event("undone", float(row["stamp_s"]) + 0.2, injection=0))
        news = check.look(CHANNEL, row, None)[1]
        if news is not None:
            told.append((float(row["stamp_s"]), *news))
    ((at_s, trouble, since_s),) = told
    assert at_s - since_s > 7.0
    assert context.explained(CHANNEL, trouble, at_s, at_s - since_s)
    assert not context.explained(CHANNEL, trouble, at_s)


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


@pytest.mark.parametrize("switched_off", [True, False])
def test_a_motor_that_was_out_while_its_arm_was_switched_off_ends_by_its_watchdog(soak, switched_off):
    context = soak.context.Context([CHANNEL, PEER], [(CHANNEL, PEER)])
    for motor in ("joint_2", "joint_3"):
        context.take(event("motor_enabled", 9.0, channel=CHANNEL, motor=motor))
    context.take(injected(0, "motor_silent", 10.0, motor="joint_3"))
    if switched_off:
        context.take(event("motor_disabled", 10.01, channel=CHANNEL, motor="joint_2"))
    context.take(event("undone", 10.1, injection=0))
    lost = context.take(event("motor_fault", 10.4, channel=CHANNEL, motor="joint_3", fault=0xD))
    assert (not lost) is switched_off


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


@pytest.mark.parametrize("again", [True, False])  # heard again before the monitor has seen that it was not
@pytest.mark.parametrize(
    ("tick_s", "destroyed", "motor", "before_s", "explained"),
    [
        (0.010, 11, "joint_2", 0.0, True),  # 110 ms of answers, on a machine that is late
        (0.010, 8, "joint_2", 0.0, False),  # of 11 that were asked for
        (0.010, 11, "joint_3", 0.0, False),  # which has answered
        (0.010, 11, "joint_2", 1.0, False),  # they were over when the silence began
        (0.004, 11, "joint_2", 0.0, False),  # 44 ms of them, and it was not heard for more than 100
        (0.010, None, "joint_2", 0.0, False),
    ],
)
def test_destroyed_answers_explain_a_silence_that_is_no_longer_than_they_are(
    soak, tick_s, destroyed, motor, before_s, explained, again
):
    lost = range(10, 10 + round(0.112 / tick_s))
    records, heard_s = [], 100.0
    for tick in range(lost.stop + again):
        row = record(tick, np.zeros(7))
        row["stamp_s"] = now_s = 100.0 + tick * tick_s
        heard_s = heard_s if tick in lost else now_s
        row["motor_stamp_s"] = np.nan  # of slots without a motor
        row["motor_stamp_s"][:7] = now_s
        row["motor_stamp_s"][1] = heard_s
        records.append(row)
    silences = soak.arm.silences(records)
    assert [silence.motor for silence in silences] == ["joint_2"]
    context = soak.context.Context([CHANNEL, PEER], [(CHANNEL, PEER)])
    if destroyed is not None:
        begin_s = float(records[lost.start]["stamp_s"]) - before_s
        context.take(injected(0, "lost_replies", begin_s, motor, value=destroyed))
        context.take(event("undone", begin_s, injection=0))
    at_s = float(records[-1]["stamp_s"])
    assert context.explained(CHANNEL, Trouble.MOTOR_SILENT, at_s, silences=silences) is explained
    assert not context.explained(CHANNEL, Trouble.BUS_SILENT, at_s, silences=silences)
    assert not context.explained(CHANNEL, Trouble.MOTOR_SILENT, at_s)


def test_arms_whose_motors_are_heard_have_no_silences(soak):
    records = [record(tick, np.zeros(7)) for tick in range(100)]
    for row in records:
        row["motor_stamp_s"][:7] = row["stamp_s"]
        row["motor_stamp_s"][6:] = np.nan  # a leader has no gripper
    assert soak.arm.silences(records) == soak.arm.silences([]) == []


def test_a_motor_that_was_heated_is_hot_for_whoever_comes_next(soak):
    context = soak.context.Context([CHANNEL, PEER], [(CHANNEL, PEER)])
    context.take(injected(0, "motor_hot", 10.0, "joint_2"))
    context.take(event("undone", 20.0, injection=0))
    assert context.explained(CHANNEL, Trouble.HOT, 80.0)
    assert not context.explained(CHANNEL, Trouble.OVERLOAD, 80.0)
    assert not context.explained(CHANNEL, Trouble.HOT, 200.0)
    assert not context.explained(PEER, Trouble.HOT, 30.0)


def test_answers_held_back_and_destroyed_at_once_explain_a_silence(soak):
    context = soak.context.Context([CHANNEL, PEER], [(CHANNEL, PEER)])
    context.take(injected(0, "held_back", 10.0))
    context.take(injected(1, "garbled", 10.5))
    assert context.explained(CHANNEL, Trouble.BUS_SILENT, 10.6)
    assert not context.explained(PEER, Trouble.BUS_SILENT, 10.6)


@pytest.mark.parametrize(
    ("mode", "stopped_s", "wrong"),
    [(Mode.STOPPED, 101.0, ""), (Mode.HOLD, 101.0, "stops"), (Mode.HOLD, None, ""), (Mode.TRACK, None, "silent")],
)
def test_arms_obey_an_emergency_stop_and_silence(soak, mode, stopped_s, wrong):
    check = soak.obedience.ObedienceCheck(CHANNEL)
    found = [f for tick in range(0, 500, 5) for f in check.look(record(tick, np.zeros(7), mode), stopped_s)]
    assert [wrong in finding.invariant for finding in found] == [True] * bool(wrong)  # said once
    assert check.stops > 0 if mode is Mode.STOPPED else check.stops == 0


def test_who_takes_a_stopped_arm_over_has_a_moment_to_look(soak):
    """The stand-by's first record, 48 ms after the last one of who has died."""
    check = soak.obedience.ObedienceCheck(CHANNEL)
    rows = [record(tick, np.zeros(7), Mode.STOPPED) for tick in range(300, 400)]
    rows += [
        record(412, np.zeros(7), Mode.LAND),
        *(record(tick, np.zeros(7), Mode.STOPPED) for tick in range(413, 450)),
    ]
    assert not [finding for row in rows for finding in check.look(row, 101.0)]
    rows = [record(tick, np.zeros(7), Mode.LAND) for tick in range(450, 460)]
    assert len([finding for row in rows for finding in check.look(row, 101.0)]) == 1


def test_lies_are_such_as_cannot_be(soak):
    lies = [i for i in soak.schedule.make_schedule(3600.0, 1) if i.kind in ("reading_glitch", "reading_lies")]
    assert len(lies) > 500
    assert min(abs(i.value["position_rad"]) for i in lies) >= 0.8
    assert any(abs(i.value["position_rad"]) == pytest.approx(2 * np.pi) for i in lies)
    assert max(i.value["answers"] for i in lies if i.kind == "reading_glitch") < 4  # from which on it is a fault


def test_the_schedule_depends_on_the_seed_only(soak):
    make = soak.schedule.make_schedule
    assert make(300.0, 1) == make(300.0, 1) != make(300.0, 2)
    long, short = make(600.0, 1), make(300.0, 1)
    assert [(i.at_s, i.kind, i.value) for i in long if i.at_s < 300.0] == [(i.at_s, i.kind, i.value) for i in short]
    faults = [i.at_s for i in long if i.kind == "motor_fault"]
    assert np.allclose(np.diff(faults), 30.0, atol=0.01)
    kinds, of_links = set(soak.schedule.KINDS), set(soak.schedule.LINK_KINDS)
    assert {i.kind for i in make(3600.0, 1)} == kinds
    assert {i.kind for i in make(3600.0, 1, kinds=[*kinds, *of_links])} == kinds | of_links
