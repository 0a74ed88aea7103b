"""Trajectory: joint and gripper positions of some arms over time; and soft paths between two poses."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_robot_yam.arm.joint_map import RANGE_TOLERANCE_RAD
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ActionError

_ROW_S = 0.02  # time between two rows of a soft path, s: the period at which callers stream targets
_GRIPPER_BEYOND = 0.1  # tolerance for measured gripper positions beyond the stops, strokes
_LEAST_ROWS = 2


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Positions of n joints and grippers at k times.

    Args:
        times_s: (k,) increasing times, s; shifted so that the first is 0.
        positions: (k, n) joints, rad, and grippers, 0 closed … 1 open; for each arm its joints, then its gripper if the
            gripper has a motor.
        columns: names of the n columns, see `columns_of`; empty: unknown.
        source: name for messages.

    Raises:
        ActionError: the shapes do not match, a number is not finite, or the times do not increase.
    """

    times_s: np.ndarray
    positions: np.ndarray
    columns: tuple[str, ...] = ()
    source: str = "trajectory"

    def __post_init__(self) -> None:
        times, rows = np.array(self.times_s, dtype=float), np.array(self.positions, dtype=float)
        if times.ndim != 1 or rows.ndim != 2 or len(times) != len(rows) or len(times) < _LEAST_ROWS:
            raise ActionError(
                f"{self.source}: a trajectory has {_LEAST_ROWS} or more times and as many rows of positions; this has "
                f"shapes {times.shape} and {rows.shape}"
            )
        if self.columns and len(self.columns) != rows.shape[1]:
            raise ActionError(f"{self.source}: {len(self.columns)} names for {rows.shape[1]} columns of positions")
        if not np.isfinite(times).all():
            raise ActionError(f"{self.source}: time {int(np.argmin(np.isfinite(times)))} is no number")
        if not np.isfinite(rows).all():
            row, column = np.argwhere(~np.isfinite(rows))[0].tolist()
            raise ActionError(f"{self.source}: row {row} has {rows[row, column]} for {self._name(column)}")
        stuck = np.flatnonzero(np.diff(times) <= 0.0)
        if len(stuck):
            row = int(stuck[0]) + 1
            raise ActionError(
                f"{self.source}: time goes back or stands still at row {row} ({times[row - 1]:.4f} s, then "
                f"{times[row]:.4f} s)"
            )
        object.__setattr__(self, "times_s", times - times[0])
        object.__setattr__(self, "positions", rows)

    def _name(self, column: int) -> str:
        return self.columns[column] if self.columns else f"column {column}"

    @property
    def seconds(self) -> float:
        return float(self.times_s[-1])

    def at(self, t: float) -> np.ndarray:
        """Interpolate the positions (n,) at time `t`, s: linear between rows, constant outside the first and last."""
        after = min(max(int(np.searchsorted(self.times_s, t)), 1), len(self.times_s) - 1)
        begin, end = self.times_s[after - 1], self.times_s[after]
        share = min(max((t - begin) / (end - begin), 0.0), 1.0)
        position: np.ndarray = self.positions[after - 1] + share * (self.positions[after] - self.positions[after - 1])
        return position

    def then(self, other: "Trajectory") -> "Trajectory":
        times = np.concatenate([self.times_s, self.seconds + other.times_s[1:]])
        return dataclasses.replace(
            other, times_s=times, positions=np.concatenate([self.positions, other.positions[1:]])
        )

    def slowed(self, speed: np.ndarray) -> "Trajectory":
        """Stretch the time where the trajectory is faster than `speed` (n,), unit/s."""
        steps = np.maximum(np.diff(self.times_s), (np.abs(np.diff(self.positions, axis=0)) / speed).max(axis=1))
        return dataclasses.replace(self, times_s=np.concatenate([[0.0], np.cumsum(steps)]))

    def check(self, arms: Sequence[ResolvedArm]) -> None:
        """Check that these arms can follow the trajectory, with a tolerance for measured poses.

        Raises:
            ActionError: the columns differ from the arms' joints, or exceed a limit; the message names the column.
        """
        names = columns_of(arms)
        have, want = self.positions.shape[1], len(names)
        if have != want or (self.columns and self.columns != names):
            told = f" ({', '.join(self.columns)})" if self.columns else ""
            raise ActionError(
                f"{self.source} is of other joints: it has {have} columns{told}, and {_and(arms)} {want} "
                f"({', '.join(names)}); nothing moves"
            )
        beyond = np.concatenate(
            [[RANGE_TOLERANCE_RAD] * arm.joints + [_GRIPPER_BEYOND] * arm.has_gripper for arm in arms]
        )
        lower, upper = (np.concatenate([getattr(arm, end) for arm in arms]) for end in ("lower", "upper"))
        outside = np.argwhere((self.positions < lower - beyond) | (self.positions > upper + beyond))
        if len(outside):
            row, column = outside[0].tolist()
            raise ActionError(
                f"{self.source}: {names[column]} is at {self.positions[row, column]:.3f} in row {row}, and takes "
                f"{lower[column]:.2f} … {upper[column]:.2f}; nothing moves"
            )


def columns_of(arms: Sequence[ResolvedArm]) -> tuple[str, ...]:
    """Return the column names of these arms' positions: for each arm its joints, then `gripper` if that has a motor."""
    return tuple(name for arm in arms for name in (*arm.joint_names, *(["gripper"] * arm.has_gripper)))


def _and(arms: Sequence[ResolvedArm]) -> str:
    return " and ".join(arm.name for arm in arms) + (" have" if len(arms) > 1 else " has")


def soft_way(start: np.ndarray, goal: np.ndarray, seconds: float) -> Trajectory:
    """Create a straight joint-space path between two poses (n,) with half-cosine position profile.

    q(t) = start + (1 − cos(π t / T)) / 2 · (goal − start); the peak speed is π/2 · |goal − start| / T.
    """
    share = np.linspace(0.0, 1.0, max(round(seconds / _ROW_S), 1) + 1)
    return Trajectory(share * seconds, start + (0.5 - 0.5 * np.cos(np.pi * share))[:, None] * (goal - start))


def soft_way_s(way: np.ndarray, speed: np.ndarray, acceleration: np.ndarray | float = math.inf) -> float:
    """Return the minimum duration of a soft path over the distances `way` (n,), s.

    T = max(π/2 · |way| / speed, π · sqrt(|way| / (2 · acceleration))).

    Args:
        way: (n,) distances, rad; grippers in strokes.
        speed: (n,) maximum speed, unit/s.
        acceleration: (n,) maximum acceleration, unit/s²; its peaks are at both ends of the path.
    """
    far = np.abs(way)
    times = np.maximum(math.pi / 2 * far / speed, math.pi * np.sqrt(far / (2.0 * np.asarray(acceleration))))
    return float(times.max(initial=0.0))
