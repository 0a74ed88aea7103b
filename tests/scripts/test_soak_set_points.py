"""The soak's check of set-points: how fast they go, and where they may jump to."""

import numpy as np
import pytest

from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from tests.support.soak_records import CHANNEL, LIMITS, TICK_S, record


def ramp(speed, ticks, mode=Mode.TRACK, first=0):
    return [record(first + tick, np.full(7, speed * tick * TICK_S), mode) for tick in range(ticks)]


def findings(check, records):
    return [finding for row in records for finding in check.look(row)]


def test_a_set_point_at_its_limit_is_fine_and_a_faster_one_is_not(soak):
    check = soak.checks.SetPointCheck(CHANNEL, LIMITS)
    assert not findings(check, ramp(1.5, 200))
    assert 0.88 < check.largest_ratio <= 1.0
    found = findings(soak.checks.SetPointCheck(CHANNEL, LIMITS), ramp(1.8, 200))
    assert found and {finding.invariant for finding in found} == {"set-point speed"}


def test_a_landing_is_slower(soak):
    assert not findings(soak.checks.SetPointCheck(CHANNEL, LIMITS), ramp(0.6, 200, Mode.LAND))
    found = findings(soak.checks.SetPointCheck(CHANNEL, LIMITS), ramp(0.9, 200, Mode.LAND))
    assert {finding.invariant for finding in found} == {"landing speed"}


@pytest.mark.parametrize(
    "mode, target, q, jumps",
    [
        (Mode.TRACK, 0.5, 0.0, True),  # a jump in the middle of tracking
        (Mode.TRACK, 0.5, 0.5, True),  # not even onto the measured pose
        (Mode.HOLD, 0.5, 0.5, False),  # seeded where the mode changes
        (Mode.HOLD, 0.5, 0.3, True),  # seeded beside the measured pose
        (Mode.LAND, 0.5, 0.5, False),
    ],
)
def test_jumps(soak, mode, target, q, jumps):
    check = soak.checks.SetPointCheck(CHANNEL, LIMITS)
    rows = [*ramp(0.0, 50), record(50, np.full(7, target), mode, q=np.full(7, q))]
    found = findings(check, rows)
    assert bool(found) is jumps


@pytest.mark.parametrize("before, after, jumps", [(0xD, 0xD, False), (1, 0xD, True), (0xD, 1, True)])
def test_a_joint_without_torque_cannot_be_sent_anywhere(soak, before, after, jumps):
    rows = [*ramp(0.0, 50), record(50, np.full(7, 0.5))]
    for row, fault in zip(rows[-2:], (before, after), strict=True):
        row["fault"][:7] = fault
    found = findings(soak.checks.SetPointCheck(CHANNEL, LIMITS), rows)
    assert ["no set-point jump"] * jumps == [finding.invariant for finding in found]


@pytest.mark.parametrize("silent_s, q, jumps", [(0.5, 0.5, False), (0.5, 0.3, True), (0.3, 0.5, True)])
def test_a_silent_joint_that_fell_starts_again_from_where_it_is(soak, silent_s, q, jumps):
    rows = [*ramp(0.0, 50, Mode.FAULT), record(50, np.full(7, 0.5), Mode.FAULT, q=np.full(7, q))]
    rows[-2]["motor_stamp_s"] = rows[-2]["stamp_s"] - silent_s
    assert bool(findings(soak.checks.SetPointCheck(CHANNEL, LIMITS), rows)) is jumps


def test_the_set_point_of_a_floating_arm_follows_the_arm(soak):
    def moved(mode):
        return [*ramp(0.0, 50, mode), *(record(50 + tick, np.full(7, 0.5), mode) for tick in range(50))]

    assert not findings(soak.checks.SetPointCheck(CHANNEL, LIMITS), moved(Mode.FLOAT))
    stopped = moved(Mode.STOPPED)
    assert not findings(soak.checks.SetPointCheck(CHANNEL, LIMITS, floats=True), stopped)
    assert findings(soak.checks.SetPointCheck(CHANNEL, LIMITS), stopped)
    held = [*moved(Mode.FLOAT), record(100, np.full(7, 1.0), Mode.HOLD, q=np.full(7, 0.5))]
    assert findings(soak.checks.SetPointCheck(CHANNEL, LIMITS), held)  # beside the arm


def test_the_gripper_may_start_again_from_where_its_force_limiter_held_it(soak):
    there = np.array([0.0] * 6 + [0.2])
    rows = [*ramp(0.0, 50), record(50, there)]
    assert findings(soak.checks.SetPointCheck(CHANNEL, LIMITS), rows)
    rows[49]["limited"] = Limited.GRIPPER_FORCE
    assert not findings(soak.checks.SetPointCheck(CHANNEL, LIMITS), rows)


def test_a_joint_that_came_free_may_start_again_from_where_it_is(soak):
    there = record(50, np.full(7, 0.5), q=np.full(7, 0.54))
    there["dq"] = 3.0
    assert findings(soak.checks.SetPointCheck(CHANNEL, LIMITS), [*ramp(0.0, 50), there])
    there["limited"] = Limited.CAME_FREE
    assert not findings(soak.checks.SetPointCheck(CHANNEL, LIMITS), [*ramp(0.0, 50), there])
    there["dq"] = 0.0  # then it is beside the arm
    there["limited"], there["mode"] = 0, Mode.STOPPED
    assert not findings(soak.checks.SetPointCheck(CHANNEL, LIMITS, press_rad=0.04), [*ramp(0.0, 50), there])
    assert findings(soak.checks.SetPointCheck(CHANNEL, LIMITS, press_rad=0.01), [*ramp(0.0, 50), there])
    there["limited"], there["mode"] = Limited.CAME_FREE, Mode.TRACK
    assert findings(soak.checks.SetPointCheck(CHANNEL, LIMITS), [*ramp(0.0, 50), there])


def truth(q_rad, dq_rad_s):
    """True samples around the record that jumps: all joints at `q_rad`, and once as fast as `dq_rad_s`."""
    stamps = 100.0 + np.arange(0.0, 0.3, 0.001)
    dq = np.zeros((len(stamps), 7))
    dq[190] = dq_rad_s
    return {"stamp_s": stamps, "q": np.full((len(stamps), 7), q_rad), "dq": dq}


@pytest.mark.parametrize(
    ("q_rad", "dq_rad_s", "wrong"),
    [
        (0.5, 3.0, ""),  # it was there, and came free
        (0.5, 0.4, "said to have come free, and moved at 0.40 rad/s at most"),
        (0.0, 3.0, "sent to 0.500 rad, 0.500 from where it is"),
        (0.0, 0.0, "sent to 0.500 rad, 0.500 from where it is"),  # one reading lied, of position and speed
    ],
)
def test_a_joint_is_believed_to_have_come_free_only_where_the_rig_says_so(soak, q_rad, dq_rad_s, wrong):
    check = soak.checks.SetPointCheck(CHANNEL, LIMITS)
    there = record(50, np.full(7, 0.5))
    there["limited"], there["dq"] = Limited.CAME_FREE, 3.0
    there["motor_stamp_s"] = there["stamp_s"] - 0.002
    assert not findings(check, [*ramp(0.0, 50), there])  # by the records all is well
    (seed,) = check.take_seeds()
    assert seed.free and seed.joints.all() and not check.take_seeds()
    judged = soak.seeds.judge_seed(seed, truth(q_rad, dq_rad_s), 1.1 * LIMITS[:6])
    assert wrong in judged if wrong else not judged


def test_an_arm_that_is_armed_again_is_sent_to_where_it_is_and_not_to_where_a_reading_says(soak):
    check = soak.checks.SetPointCheck(CHANNEL, LIMITS)
    assert not findings(check, [*ramp(0.0, 50, Mode.FAULT), record(50, np.full(7, 0.5), Mode.HOLD)])
    (seed,) = check.take_seeds()
    assert not soak.seeds.judge_seed(seed, truth(0.5, 0.0), 1.1 * LIMITS[:6])
    assert "FAULT → HOLD" in soak.seeds.judge_seed(seed, truth(0.5 - 2 * np.pi, 0.0), 1.1 * LIMITS[:6])
    nothing = {key: value[:0] for key, value in truth(0.0, 0.0).items()}
    assert not soak.seeds.judge_seed(seed, nothing, 1.1 * LIMITS[:6])  # the rig itself stood still
