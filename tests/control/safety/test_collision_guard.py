"""The guard in a closed loop with real set-points: approaches end at the limit, smoothly; everything else goes on."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.collision.parts import GuardedArm
from lerobot_robot_yam.arm.collision.workspace import KeepOut, WorkspaceConfig
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.control.laws.set_point import SetPoint
from lerobot_robot_yam.control.safety.collision_guard import WorkspaceGuard
from tests.support.tiers import spread

DT = 0.004
SPEED, ACCELERATION, END = 1.5, 30.0, 5.0
MARGIN = 0.02
HOME = np.array([0.0, 1.2, 1.2, -0.5, 0.0, 0.0])
TO_THE_RIGHT, TO_THE_LEFT = HOME + [-1.4, 0, 0, 0, 0, 0], HOME + [1.4, 0, 0, 0, 0, 0]
LOW = HOME + [0, 0.68, 0, 0, 0, 0]  # 3 cm below a floor at 5 cm
WRIST_IN_UPPER_ARM = np.array([0.0, 1.2, 0.5, -1.6, 0.0, 0.0])
MAST = KeepOut(name="camera mast", center_m=[0.35, 0.0, 0.4], size_m=[0.06, 0.06, 0.8])


class Rig:
    """Arms side by side, each with a set-point (six joints and a gripper), ticked like the control loop does it."""

    def __init__(self, names=("left", "right"), gap_m=0.5, speed=SPEED, start=HOME, **workspace):
        profile, gripper = resolve_profiles("yam", "linear_4310")
        offsets = np.linspace(gap_m / 2, -gap_m / 2, len(names)) if len(names) > 1 else [0.0]
        self.arms = [
            GuardedArm(name, profile, gripper, WorkspaceConfig(base_position_m=[0, y, 0], **workspace))
            for name, y in zip(names, offsets, strict=True)
        ]
        self.guard = WorkspaceGuard(self.arms)
        lower, upper = profile.joint_limits_rad.T
        self.setpoints = [
            SetPoint(
                np.append(np.full(6, speed), 2.5),
                np.append(np.full(6, ACCELERATION), 60.0),
                np.append(lower, 0.0),
                np.append(upper, 1.0),
                np.append(np.full(6, END), 60.0),
            )
            for _ in names
        ]
        self.speed = speed
        self.now = 0.0
        self.seed([start] * len(names))

    def seed(self, poses):
        for setpoint, q in zip(self.setpoints, poses, strict=True):
            setpoint.seed(np.append(q, 1.0))

    def run(self, seconds, targets, guarded=True, fps=30, measured=None):
        """Aim at `targets` (a list, or a function of time) and tick; rows q, dq (ticks, arms, 6), and the verdicts.

        The arms are where their set-points are, or at `measured`.
        """
        count = len(self.arms)
        guarded = [guarded] * count if isinstance(guarded, bool) else guarded
        q, dq, verdicts, aim_at = [], [], [], self.now
        for _ in range(round(seconds / DT)):
            if self.now >= aim_at:
                for setpoint, target in zip(
                    self.setpoints, targets(self.now) if callable(targets) else targets, strict=True
                ):
                    setpoint.set_target(np.append(target, 1.0), self.now)
                aim_at += 1 / fps
            if any(guarded):
                where = measured or [setpoint.q.copy() for setpoint in self.setpoints]
                verdicts.append(self.guard.advance(self.setpoints, where, guarded, self.now, DT))
            else:
                for setpoint in self.setpoints:
                    setpoint.step(self.now, DT)
            q.append([setpoint.q[:6].copy() for setpoint in self.setpoints])
            dq.append([setpoint.dq[:6].copy() for setpoint in self.setpoints])
            self.now += DT
        return np.array(q), np.array(dq), verdicts

    def slack(self, rows):
        """Smallest distance beyond the limit in every row, m; measured pair by pair, without the guard's search."""
        clearance, slack = self.guard._clearance, []
        for row in rows:
            clearance.parts.place(np.concatenate(row))
            slack.append(min(clearance.distance(pair) - pair.limit_m for pair in clearance.pairs))
        return np.array(slack)

    def assert_smooth(self, q, dq):
        assert np.abs(dq).max() <= self.speed + 1e-9
        assert np.abs(np.diff(dq, axis=0)).max() <= ACCELERATION * DT + 1e-9
        np.testing.assert_allclose(np.diff(q, axis=0), dq[1:] * DT, atol=1e-9)  # dq* is the slope of q*


CASES = {
    "two arms": (dict(collision_margin_m=MARGIN), [TO_THE_RIGHT, TO_THE_LEFT], ("left tip_right", "right tip_left")),
    "one arm into the other": (
        dict(collision_margin_m=MARGIN, gap_m=0.25),
        [TO_THE_RIGHT, HOME],
        ("left tip_right", "right"),
    ),
    "floor": (dict(names=("left",), floor_z_m=0.05), [LOW], ("left tip_left", "floor")),
    "box": (
        dict(names=("left",), keep_out=[MAST], start=HOME + [1.0, 0, 0, 0, 0, 0]),
        [HOME],
        ("left", "keep-out 'camera mast'"),
    ),
    "itself": (
        dict(names=("left",), collision_margin_m=MARGIN),
        [WRIST_IN_UPPER_ARM],
        ("left link2", "left gripper"),
    ),
}


@pytest.mark.parametrize("speed", spread([SPEED, 3.0], 1))
@pytest.mark.parametrize("case", CASES)
def test_an_approach_ends_at_the_limit_smoothly_and_can_be_taken_back(case, speed):
    options, targets, names = CASES[case]
    alone = Rig(speed=speed, **options)
    start = [setpoint.q[:6].copy() for setpoint in alone.setpoints]
    q, _, _ = alone.run(2.5, targets, guarded=False)
    assert alone.slack(q[::5]).min() < -0.02  # left alone, the same motion collides

    rig = Rig(speed=speed, **options)
    q, dq, verdicts = rig.run(2.5, targets)
    rig.assert_smooth(q, dq)
    slack = rig.slack(q[::-2])
    assert slack.min() > -0.002
    assert slack[0] < 0.003  # it went as far as it may
    assert np.abs(dq[-25:]).max() == 0.0
    assert verdicts[-1].blocked[0]
    assert all(name in verdicts[-1].message(0) for name in names), verdicts[-1].message(0)

    q, dq, verdicts = rig.run(2.5, start)  # away again
    rig.assert_smooth(q, dq)
    assert rig.slack(q[::4]).min() > -0.002
    np.testing.assert_allclose(q[-1], start, atol=1e-3)
    assert verdicts[-1].blocked == (False,) * len(start) and verdicts[-1].message(0) == ""


def test_pressed_onto_the_floor_the_other_joints_go_on():
    rig = Rig(names=("left",), floor_z_m=0.05)
    rig.run(1.5, [LOW])

    def swing(now):
        return [LOW + [0.5 * np.sin(2 * (now - 1.5)), 0, 0, 0, 0, 0]]

    q, dq, verdicts = rig.run(4.0, swing)
    times = 1.5 + DT * np.arange(len(q))
    assert all(verdict.blocked[0] for verdict in verdicts)
    assert np.sqrt(np.mean((q[:, 0, 0] - 0.5 * np.sin(2 * (times - 1.5 - 1 / 30))) ** 2)) < 0.01
    assert np.ptp(q[:, 0, 1]) < 1e-3  # joint 2 waits on the floor
    assert rig.slack(q[::10]).min() > -0.001
    rig.assert_smooth(q, dq)


def test_an_arm_that_is_not_concerned_goes_on_untouched():
    def wave(now):
        return HOME + 0.2 * np.sin(now) * np.array([-1, -1, 0.5, 1, 1, 1])

    limits = dict(names=("left", "right"), gap_m=1.2, collision_margin_m=MARGIN, floor_z_m=0.05)
    rig, free = Rig(**limits), Rig(**limits)
    q, _, verdicts = rig.run(3.0, lambda now: [LOW, wave(now)])
    expected, _, _ = free.run(3.0, lambda now: [HOME, wave(now)], guarded=False)
    assert verdicts[-1].blocked == (True, False) and not any(verdict.blocked[1] for verdict in verdicts)
    np.testing.assert_array_equal(q[:, 1], expected[:, 1])


def test_an_arm_that_retreats_is_not_blamed_for_the_one_that_follows_it():
    rig = Rig(collision_margin_m=MARGIN)
    rig.run(2.0, [TO_THE_RIGHT, TO_THE_LEFT])
    q, dq, verdicts = rig.run(2.0, [TO_THE_RIGHT, HOME])
    assert rig.slack(q[::5]).min() > -0.002
    assert not any(verdict.blocked[1] for verdict in verdicts)
    np.testing.assert_allclose(q[-1, 1], HOME, atol=1e-3)
    rig.assert_smooth(q, dq)


def test_an_arm_that_is_not_guarded_is_in_the_way_and_never_moved():
    rig, free = Rig(collision_margin_m=MARGIN), Rig(collision_margin_m=MARGIN)
    q, _, verdicts = rig.run(2.0, [TO_THE_RIGHT, TO_THE_LEFT], guarded=[False, True])
    expected, _, _ = free.run(2.0, [TO_THE_RIGHT, TO_THE_LEFT], guarded=False)
    np.testing.assert_array_equal(q[:, 0], expected[:, 0])
    assert verdicts[-1].blocked == (False, True)
    assert np.abs(q[-1, 1] - TO_THE_LEFT).max() > 0.1


def test_an_arm_that_floats_is_where_it_is_measured_whatever_its_set_point_says():
    rig = Rig(collision_margin_m=MARGIN)
    pushed = HOME + [-0.6, 0, 0, 0, 0, 0]
    q, _, verdicts = rig.run(2.0, [HOME, TO_THE_LEFT], guarded=[False, True], measured=[pushed, HOME])
    assert verdicts[-1].blocked == (False, True)
    assert rig.slack([[pushed, row[1]] for row in q[::5]]).min() > -0.002


@pytest.mark.parametrize("inside", ["floor", "box", "itself"])
def test_who_starts_inside_a_limit_may_turn_and_leave_but_not_go_deeper(inside):
    options, (deep,), _ = CASES[inside]
    rig = Rig(**options)
    out = rig.setpoints[0].q[:6].copy()
    way = [out + share * (deep - out) for share in np.linspace(0, 1, 100)]
    shallow = way[int(np.argmax(rig.slack([[q] for q in way]) < -0.008))]
    rig.seed([shallow])
    before = rig.slack([[shallow]])[0]
    q, _, verdicts = rig.run(0.5, [shallow + 0.3 * (deep - shallow)])
    assert rig.slack(q[::4]).min() > before - 1e-5
    assert verdicts[-1].blocked[0]
    q, dq, _ = rig.run(2.0, [out])
    slack = rig.slack(q[::-8])
    assert slack.min() > before - 1e-5 and slack[0] > 0.0
    np.testing.assert_allclose(q[-1, 0], out, atol=1e-3)
    rig.assert_smooth(q, dq)


def random_rig(speed=SPEED):
    return Rig(gap_m=0.4, collision_margin_m=MARGIN, floor_z_m=-0.02, keep_out=[MAST], speed=speed)


def test_no_step_without_conflict_brings_a_pair_below_its_limit_and_nearer():
    rig = random_rig()
    clearance = rig.guard._clearance
    limits = np.array([pair.limit_m for pair in clearance.pairs])
    low, high = np.tile(rig.arms[0].arm.joint_limits_rad.T, 2)
    rng = np.random.default_rng(0)

    def distances(q):
        clearance.parts.place(q)
        return np.array([clearance.distance(pair) for pair in clearance.pairs])

    q = np.tile(HOME, 2)
    before, held = distances(q), 0
    for step in range(2000):
        if step % 40 == 0:
            drift = rng.normal(size=12) * 0.02
        wanted = np.clip(q + drift + rng.normal(size=12) * 0.01, low, high)
        barred = bool(clearance.conflicts(q, wanted, most_steps=1000))
        q = q if barred else wanted
        after = distances(q)
        assert not ((after < limits) & (after < before - 3e-5)).any()
        before = after
        held += barred
    assert held > 200


@pytest.mark.parametrize("speed", [SPEED, pytest.param(3.0, marks=pytest.mark.long)])
def test_random_targets_all_over_the_joint_range_never_lead_through_anything(speed):
    rig = random_rig(speed)
    low, high = rig.arms[0].arm.joint_limits_rad.T
    rng = np.random.default_rng(4)
    blocked = 0
    for _ in range(12):
        targets = rng.uniform(low + 0.1, high - 0.1, size=(2, 6))
        q, dq, verdicts = rig.run(0.8, targets)
        assert rig.slack(q[::4]).min() > -0.002 * (speed / SPEED)
        rig.assert_smooth(q, dq)
        blocked += sum(any(verdict.blocked) for verdict in verdicts)
    assert blocked > 200


@pytest.mark.parametrize("seed", spread([1, 2, 3], 0))  # without a limit of the guard's own, 1 … 13 mrad beyond
def test_joint_limits_hold_while_the_guard_brakes(seed):
    rig = random_rig()
    low, high = rig.arms[0].arm.joint_limits_rad.T
    rng = np.random.default_rng(seed)
    for hop in range(6):
        to_the_ends = np.where(rng.random((2, 6)) < 0.5, low, high) if hop % 2 else None
        q, _, _ = rig.run(0.5, rng.uniform(low, high, size=(2, 6)) if to_the_ends is None else to_the_ends)
        assert (q >= low).all() and (q <= high).all()


def test_a_closed_gripper_may_go_on_where_an_open_one_has_to_wait():
    rig = Rig(names=("left",), keep_out=[KeepOut(name="wall", center_m=[0.3, 0.35, 0.3], size_m=[1.0, 0.1, 1.0])])
    turned = [HOME + [1.5, 0, 0, 0, 0, 0]]
    wide, _, verdicts = rig.run(2.0, turned)
    assert verdicts[-1].blocked == (True,)
    rig.guard.open_grippers([0.0])
    narrow, _, verdicts = rig.run(2.0, turned)
    assert verdicts[-1].blocked == (True,)
    assert narrow[-1, 0, 0] > wide[-1, 0, 0] + 0.02
