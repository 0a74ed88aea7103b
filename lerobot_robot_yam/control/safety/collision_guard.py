"""Collision guard: keeps the set-points of all arms in a loop clear of each other, of keep-out boxes and of the floor.

A set-point cannot stop at once. The guard therefore checks where the set-point would come to rest if braking began
after the step, with all joints braking in proportion, so that the direction of motion stays the same:

    q_rest = q + dq T / 2        T = max |dq_j| / a_j

The step and its braking path are one straight line, which `clearance` checks as a whole. As long as every executed step
has a braking path without conflict, braking is always possible. In a conflict the guard tries these proposals in order,
with the same check for each:

    1. the step as planned
    2. joints that bring the parts together are slowed, only as much as the limit requires; other joints continue
    3. joints that bring the parts together brake
    4. the arms in conflict brake
    5. all arms brake
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.collision.clearance import Clearance, Conflict
from lerobot_robot_yam.arm.collision.parts import GuardedArm
from lerobot_robot_yam.control.laws.set_point import SetPoint

_RESERVE = 0.02  # share of the distance to the limit left by a slowed step, as a margin for rounding
_MOST_SLOWED = 4  # maximum number of pairs handled in one pass, to bound the time of a tick
_ROUNDS = 3  # maximum number of passes: slowing a joint for one pair may bring another pair together
_GAIN_M = 1e-7  # minimum effect of a joint on a distance, m
# Maximum deceleration that a stop of a joint faster than `_QUICK_RAD_S` is planned with, rad/s²: what the torque limits
# leave the shoulder of an outstretched YAM beside its weight. Planned with 60, it went 80 mm too far at 4 rad/s.
_BRAKES_RAD_S2, _QUICK_RAD_S = 12.0, 1.5
_STANDS = 1e-3  # share of a step that is rounded down to 0, so that an arm pressing on a limit stands still


class Nearness(NamedTuple):
    """Two parts and their distance, m; negative if the parts overlap.

    arms: indices of the arms that can change the distance.
    """

    first: str
    second: str
    distance_m: float
    arms: tuple[int, ...]

    def __str__(self) -> str:
        return f"{self.first} – {self.second}, {round(self.distance_m * 1000)} mm"


class Verdict(NamedTuple):
    """Permitted part of a step.

    Attributes:
        q, dq: per arm (joints,), permitted set-points, not yet clamped to the joint ranges: joints that brake in
            proportion may be too fast for the end of a range.
        blocked: per arm, whether the guard reduces the arm's step.
        because: pairs in conflict, with their distances before the step; empty if no arm is blocked.
    """

    q: list[np.ndarray]
    dq: list[np.ndarray]
    blocked: tuple[bool, ...]
    because: tuple[Nearness, ...]

    def message(self, arm: int) -> str:
        """Name the parts that block this arm: "left link4 – keep-out 'camera mast', 12 mm"; empty: not blocked."""
        return "; ".join(str(row) for row in self.because if arm in row.arms) if self.blocked[arm] else ""


class _Step(NamedTuple):
    """Step of `dt` s for all joints (N,): as planned (q, dq), and with all joints braking by `decel`."""

    start: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    q_brake: np.ndarray
    dq_brake: np.ndarray
    decel: np.ndarray
    dt: float

    @classmethod
    def plan(
        cls, start: np.ndarray, speed: np.ndarray, q: np.ndarray, dq: np.ndarray, decel: np.ndarray, dt: float
    ) -> "_Step":
        """Create a step from (start, speed) to (q, dq)."""
        to_rest_s = _braking_time(speed, decel)
        dq_brake = speed * max(1.0 - dt / to_rest_s, 0.0) if to_rest_s > 0.0 else np.zeros_like(speed)
        return cls(start, q, dq, start + dq_brake * dt, dq_brake, decel, dt)

    def take(self, share: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Return (q, dq) interpolated between braking (share 0) and the planned step (share 1)."""
        q = self.q_brake + share * (self.q - self.q_brake)
        return q, self.dq_brake + share * (self.dq - self.dq_brake)

    def way(self, share: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the straight path of a step and its braking: start, end, and the step's share of the path."""
        q, dq = self.take(share)
        braking_s = _braking_time(dq, self.decel)
        return self.start, q + dq * (braking_s / 2), self.dt / (self.dt + braking_s / 2) if self.dt > 0.0 else 1.0

    def rests(self, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rest positions (N,) twice: after the step, and of each joint if only that joint braked at once."""
        q, dq = self.take(share)
        braking_s = _braking_time(dq, self.decel)
        return q + dq * (braking_s / 2), self.q_brake + self.dq_brake * (braking_s / 2)


def _braking_time(dq: np.ndarray, decel: np.ndarray) -> float:
    return float((np.abs(dq) / decel).max(initial=0.0))


class WorkspaceGuard:
    """Guard for the set-points of all arms in one control loop.

    Grippers count as fully open until `open_grippers` is called.

    Args:
        arms: the guarded arms, in the order of all lists in this class.

    Raises:
        ConfigError: a workspace is invalid, or the mounting positions of arms overlap.
    """

    def __init__(self, arms: Sequence[GuardedArm]):
        self._clearance = Clearance(arms)
        self._joints = self._clearance.parts.joints
        ends = np.cumsum(self._joints).tolist()
        self._parts = [slice(end - n, end) for end, n in zip(ends, self._joints, strict=True)]
        self._arm_of = np.repeat(np.arange(len(arms)), self._joints)
        self._memory: tuple[np.ndarray, Verdict] | None = None

    def open_grippers(self, openings: Sequence[float]) -> None:
        """Set the gripper openings, 0 closed … 1 open, one per arm."""
        if self._clearance.parts.open_grippers(openings):
            self._memory = None

    def advance(
        self,
        setpoints: Sequence[SetPoint],
        measured: Sequence[np.ndarray],
        guarded: Sequence[bool],
        now: float,
        dt: float,
    ) -> Verdict:
        """Advance all set-points by one tick like `SetPoint.step`, with steps reduced where they cause a conflict.

        Reduced steps also respect the speed and acceleration limits.

        Args:
            setpoints: the arms' set-points; the joints are the first coordinates, other coordinates are not changed.
            measured: measured joints of every arm, (joints,) or more, rad; used for arms that are not guarded.
            guarded: whether each arm may be slowed. Other arms (floating, landing, off) are obstacles only.
            now, dt: monotonic time, and length of the tick, s.
        """
        start = self._row([s.q for s in setpoints], measured, guarded)
        still = [np.zeros(n) for n in self._joints]
        speed = self._row([s.dq for s in setpoints], still, guarded)
        for setpoint in setpoints:
            setpoint.step(now, dt)
        q = self._row([s.q for s in setpoints], measured, guarded)
        dq = self._row([s.dq for s in setpoints], still, guarded)
        inputs = np.concatenate([start, speed, q, dq, guarded])
        if self._memory is not None and np.array_equal(self._memory[0], inputs):
            verdict = self._memory[1]
        else:
            rows = list(zip(setpoints, self._joints, strict=True))
            decel = np.concatenate([s.acceleration_limit[:n] for s, n in rows])
            quick = np.concatenate([s.speed_limit[:n] for s, n in rows]) > _QUICK_RAD_S
            decel = np.where(quick, np.minimum(decel, _BRAKES_RAD_S2), decel)
            step = _Step.plan(start, speed, q, dq, decel, dt)
            verdict = self._settle(step, np.asarray(guarded)[self._arm_of])
            self._memory = (inputs, verdict)
        for setpoint, q_arm, dq_arm, blocked in zip(setpoints, verdict.q, verdict.dq, verdict.blocked, strict=True):
            if blocked:
                setpoint.replan(q_arm, dq_arm)
        return verdict

    def _row(self, ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray], guarded: Sequence[bool]) -> np.ndarray:
        """Concatenate all joints (N,): guarded arms from `ours`, other arms from `theirs`."""
        return np.concatenate(
            [(a if g else b)[:n] for a, b, g, n in zip(ours, theirs, guarded, self._joints, strict=True)]
        )

    def _settle(self, step: _Step, movable: np.ndarray) -> Verdict:
        """Return the first proposal, in the order of the module docstring, that causes no conflict."""
        first = conflicts = self._clearance.conflicts(*step.way(1.0))
        if not conflicts:
            return self._verdict(step.q, step.dq, np.zeros(len(self._joints), dtype=bool), [])
        share: np.ndarray = np.ones(len(step.q))
        approaching = np.zeros(len(share), dtype=bool)
        for _ in range(_ROUNDS):
            slower, bring_together = self._slow(step, share, conflicts, movable)
            share = share * slower
            approaching |= bring_together
            conflicts = self._clearance.conflicts(*step.way(share))
            if not conflicts:
                break
        if conflicts:
            share, conflicts = self._brake(step, approaching)
        if conflicts:
            arms = {arm for conflict in (*first, *conflicts) for arm in conflict.pair.arms}
            share, conflicts = self._brake(step, self._joints_of(arms) & movable)
        if conflicts:
            share = np.where(movable, 0.0, 1.0)
        q, dq = step.take(share)
        held = np.zeros(len(self._joints), dtype=bool)
        held[self._arm_of[share < 1.0]] = True
        return self._verdict(q, dq, held, first)

    def _brake(self, step: _Step, joints: np.ndarray) -> tuple[np.ndarray, list[Conflict]]:
        share = np.where(joints, 0.0, 1.0)
        return share, self._clearance.conflicts(*step.way(share))

    def _slow(
        self, step: _Step, share: np.ndarray, conflicts: Sequence[Conflict], movable: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute factors (N,) for `share` that keep every pair's distance, and which joints bring a pair together.

        factor_j = 1 - min(1, mu c_j), where c_j is the distance gained if joint j alone brakes. The joint that
        contributes most to the approach is slowed most; mu is chosen so that the gains sum to the missing distance.
        """
        factor = np.ones(len(share))
        approaching = np.zeros(len(share), dtype=bool)
        conflicts = conflicts[:_MOST_SLOWED]
        rests, brakes = step.rests(share)
        gains = np.zeros((len(conflicts), len(share)))
        concerned = [self._joints_of(conflict.pair.arms) & movable for conflict in conflicts]
        for j in np.flatnonzero(np.any(concerned, axis=0) & (rests != brakes)).tolist():
            changed = rests.copy()
            changed[j] = brakes[j]
            for i, conflict in enumerate(conflicts):
                self._clearance.parts.place(step.start + conflict.share * (changed - step.start))
                gains[i, j] = self._clearance.distance(conflict.pair) - conflict.there_m
        for conflict, gain, joints in zip(conflicts, gains, concerned, strict=True):
            closer = joints & (gain > _GAIN_M)
            if not closer.any():
                factor[joints] = 0.0
                approaching |= joints
                continue
            lacking = conflict.floor_m - conflict.there_m
            lacking += _RESERVE * max(gain[closer].sum() - lacking, 0.0)
            slowed = 1.0 - _fill(gain[closer], lacking)
            factor[closer] = np.minimum(factor[closer], np.where(slowed < _STANDS, 0.0, slowed))
            approaching |= closer
        return factor, approaching

    def _verdict(self, q: np.ndarray, dq: np.ndarray, blocked: np.ndarray, conflicts: Sequence[Conflict]) -> Verdict:
        because: dict[tuple[str, str], Nearness] = {}
        for conflict in conflicts if blocked.any() else ():
            pair, names = conflict.pair, self._clearance.parts.part_names
            first, second = names[pair.first], names[pair.second]
            because.setdefault((first, second), Nearness(first, second, conflict.before_m, pair.arms))
        q_by_arm, dq_by_arm = ([row[part] for part in self._parts] for row in (q, dq))
        return Verdict(q_by_arm, dq_by_arm, tuple(blocked.tolist()), tuple(because.values()))

    def _joints_of(self, arms: Collection[int]) -> np.ndarray:
        """Return (N,) bool: joints that belong to `arms`."""
        return np.any([self._arm_of == arm for arm in arms], axis=0)


def _fill(gains: np.ndarray, needed: float) -> np.ndarray:
    """Compute parts (n,), 0 … 1, proportional to `gains` and clamped to 1, such that sum(parts * gains) = needed.

    If sum(gains) is less than needed, all parts are 1.
    """
    full = np.zeros(len(gains), dtype=bool)
    while not full.all():
        free = gains[~full]
        parts = gains * ((needed - gains[full].sum()) / free.dot(free))
        over = (parts >= 1.0) & ~full
        if not over.any():
            return np.where(full, 1.0, np.maximum(parts, 0.0))
        full |= over
    return np.ones(len(gains))
