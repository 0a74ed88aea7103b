"""Joint paths from tool poses, for one arm that picks and places from above.

Positions are in the world frame, angles in radians. A tool pose is the position of `grasp_site` and a yaw about the
vertical. At yaw 0 the fingers open along the world's y axis. The tool points straight down, or is tilted back by a
constant angle about the axis along which its fingers open.
"""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.errors import RigError

_POSITION_TOLERANCE_M = 1e-4
_ANGLE_TOLERANCE_RAD = 1e-3
_SPEED_RAD_S, _ACCELERATION_RAD_S2 = 1.2, 7.0  # limits for each joint
_SAMPLES = 33
_EASE_S = 0.4
_TRANSFER_S = 0.4  # minimum duration of a transfer
# Phases in which the tool rises, travels and sinks, as fractions of a transfer. Their overlaps round the corners.
_RISE, _TRAVEL, _SINK = (0.0, 0.42), (0.16, 0.84), (0.58, 1.0)


def minimum_jerk(s: np.ndarray | float) -> np.ndarray:
    """Return Flash and Hogan's polynomial 10 s³ − 15 s⁴ + 6 s⁵, with s clamped to 0 … 1."""
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


@dataclass(frozen=True)
class Path:
    """A sampled joint path. times_s: (k,) seconds from the start, increasing from 0. q_rad: (k, n)."""

    times_s: np.ndarray
    q_rad: np.ndarray

    @property
    def duration_s(self) -> float:
        return float(self.times_s[-1])

    @property
    def end_rad(self) -> np.ndarray:
        return self.q_rad[-1]

    def at(self, t_s: float) -> np.ndarray:
        """Return the joints (n,) at t_s, interpolated linearly between samples."""
        return np.array([np.interp(t_s, self.times_s, column) for column in self.q_rad.T])

    def rest(self, t_s: float) -> "Path":
        """Return the path after t_s, starting from rest: its first `_EASE_S` take twice as long."""
        left = self.times_s[-1] - t_s
        if left <= 0.0:
            return Path(np.array([0.0, 0.1]), np.stack([self.end_rad, self.end_rad]))
        ease = min(_EASE_S, left)
        travelled = np.linspace(0.0, left, max(3, int(left / 0.03)))
        # Progress x(t) = t²/(4 e) until full speed at t = 2 e, where x = e.
        times = np.where(travelled < ease, 2.0 * np.sqrt(ease * travelled), travelled + ease)
        return Path(times, np.array([self.at(t_s + x) for x in travelled]))


class ArmPlanner:
    """Planner for one arm that stands on the table. Raises RigError if a pose or path has a point out of reach.

    Args:
        model: the arm with its gripper, base at the origin, as returned by `arm.model.build_model`.
        base_m: position of the base in the world, (3,); also an attribute.
        yaw_rad: heading of the base.
        seed_rad: (n,) bent pose from which the inverse kinematics starts; None for the middle of the joint ranges.
        leads: joints that move first when the arm unfolds: those from the elbow on.
        tilt_rad: backward tilt of the tool from straight down.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        base_m: np.ndarray,
        yaw_rad: float,
        seed_rad: np.ndarray | None,
        leads: slice,
        tilt_rad: float = 0.0,
    ):
        self.base_m = np.asarray(base_m, float)
        self._yaw = yaw_rad
        self._kinematics = YamKinematics.of_model(model, "grasp_site")
        self._seed = self._kinematics.middle if seed_rad is None else seed_rad
        self._leads = leads
        self._tilt = tilt_rad

    def _to_base(self, position_m: np.ndarray) -> np.ndarray:
        c, s = np.cos(self._yaw), np.sin(self._yaw)
        x, y, z = np.asarray(position_m, float) - self.base_m
        return np.array([c * x + s * y, -s * x + c * y, z])

    def tool(self, q_rad: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the world position (3,) and yaw of `grasp_site` at q_rad (n,)."""
        pose = self._kinematics.fk(q_rad)
        rotation, (x, y, z) = pose[:3, :3], pose[:3, 3]
        c, s = np.cos(self._yaw), np.sin(self._yaw)
        position = self.base_m + np.array([c * x - s * y, s * x + c * y, z])
        return position, float(np.arctan2(-rotation[0, 1], rotation[1, 1])) + self._yaw

    def natural_yaw(self, position_m: np.ndarray) -> float:
        """Return the yaw at which the last joint is near zero, which is the direction from the base to the point."""
        x, y, _ = self._to_base(position_m)
        return float(np.arctan2(y, x)) + self._yaw

    def grasp_yaw(self, position_m: np.ndarray, prop_yaw_rad: float, turns: int = 4) -> float:
        """Return the yaw that aligns the fingers with two faces of the prop at the least turn of the last joint.

        turns: number of equivalent grasps in a full turn: 4 for a cube, 2 for a bar.
        """
        natural = self.natural_yaw(position_m)
        part = 2 * np.pi / turns
        return float(prop_yaw_rad + part * np.round((natural - prop_yaw_rad) / part))

    def solve(self, position_m: np.ndarray, yaw_rad: float, q_near_rad: np.ndarray) -> np.ndarray | None:
        """Return the joints (n,), near q_near_rad, that put `grasp_site` at a tool pose; None when out of reach."""
        yaw = yaw_rad - self._yaw
        c, s = np.cos(yaw), np.sin(yaw)
        down, ahead = np.cos(self._tilt), np.sin(self._tilt)
        pose = np.eye(4)
        # Columns: tool x, y (finger opening), z (approach).
        pose[:3, :3] = [[-c * down, -s, c * ahead], [-s * down, c, s * ahead], [-ahead, 0.0, -down]]
        pose[:3, 3] = self._to_base(position_m)
        found = self._kinematics.ik(pose, q_near_rad, attempts=1)
        near = found.position_error_m < _POSITION_TOLERANCE_M and found.orientation_error_rad < _ANGLE_TOLERANCE_RAD
        return found.q if near else None

    def reaches(self, position_m: np.ndarray, yaw_rad: float) -> bool:
        return self.solve(position_m, yaw_rad, self._facing(position_m)) is not None

    def _facing(self, position_m: np.ndarray) -> np.ndarray:
        seed = self._seed.copy()
        seed[0] = self.natural_yaw(position_m) - self._yaw
        return np.clip(seed, self._kinematics.lower, self._kinematics.upper)

    def pose(self, position_m: np.ndarray, yaw_rad: float | None = None) -> np.ndarray:
        """Return the joints (n,) for a tool pose; without a yaw, for the natural yaw."""
        yaw = self.natural_yaw(position_m) if yaw_rad is None else yaw_rad
        return self._solved(position_m, yaw, self._facing(position_m))

    def _solved(self, position_m: np.ndarray, yaw_rad: float, q_near_rad: np.ndarray) -> np.ndarray:
        q = self.solve(position_m, yaw_rad, q_near_rad)
        if q is None:
            raise RigError(f"the operator cannot reach {np.round(position_m, 3)} m; move the prop nearer to an arm")
        return q

    def straight(self, start_rad: np.ndarray, position_m: np.ndarray, yaw_rad: float, least_s: float = 0.2) -> Path:
        """Plan a straight line of the tool to a tool pose, with minimum jerk."""
        origin, _ = self.tool(start_rad)
        way = np.asarray(position_m, float) - origin
        return self._tool_path(start_rad, yaw_rad, lambda s: origin + way * _span(s), _span, least_s)

    def unfold(self, start_rad: np.ndarray, end_rad: np.ndarray, least_s: float = 0.2) -> Path:
        """Plan a joint path with minimum jerk; the elbow leads, so that a folded arm lifts its tool first."""
        start, end = np.asarray(start_rad, float), np.asarray(end_rad, float)
        first, last = np.full(len(start), 0.3), np.ones(len(start))
        first[self._leads], last[self._leads] = 0.0, 0.7

        def joints(s: float) -> np.ndarray:
            return start + (end - start) * minimum_jerk((s - first) / (last - first))

        return self._timed(joints, least_s)

    def transfer(self, start_rad: np.ndarray, position_m: np.ndarray, yaw_rad: float, height_m: float) -> Path:
        """Plan one smooth motion that rises to height_m, travels, and sinks to a tool pose."""
        origin, _ = self.tool(start_rad)
        target = np.asarray(position_m, float)
        top = max(height_m, origin[2], target[2])

        def point(s: float) -> np.ndarray:
            found = origin + (target - origin) * _span(s, *_TRAVEL)
            found[2] = origin[2] + (top - origin[2]) * _span(s, *_RISE) + (target[2] - top) * _span(s, *_SINK)
            return found

        return self._tool_path(start_rad, yaw_rad, point, lambda s: _span(s, *_TRAVEL), _TRANSFER_S)

    def _tool_path(
        self,
        start_rad: np.ndarray,
        yaw_rad: float,
        point: Callable[[float], np.ndarray],
        turned: Callable[[float], float],
        least_s: float,
    ) -> Path:
        """Plan a path with the tool at point(s) and the fraction turned(s) of its turn to yaw_rad done, s = 0 … 1."""
        _, yaw = self.tool(start_rad)
        turn = (yaw_rad - yaw + np.pi) % (2 * np.pi) - np.pi
        near = np.asarray(start_rad, float)

        def joints(s: float) -> np.ndarray:
            nonlocal near
            near = self._solved(point(s), yaw + turn * turned(s), near)
            return near

        return self._timed(joints, least_s)

    def _timed(self, joints: Callable[[float], np.ndarray], least_s: float) -> Path:
        """Sample joints(0 … 1), and stretch the time until speed and acceleration are within their limits."""
        s = np.linspace(0.0, 1.0, _SAMPLES)
        q = np.array([joints(x) for x in s])
        speed = np.abs(np.diff(q, axis=0)).max() * (_SAMPLES - 1)
        acceleration = np.abs(np.diff(q, 2, axis=0)).max() * (_SAMPLES - 1) ** 2
        duration = max(least_s, speed / _SPEED_RAD_S, float(np.sqrt(acceleration / _ACCELERATION_RAD_S2)))
        return Path(s * duration, q)


def _span(s: float, start: float = 0.0, end: float = 1.0) -> float:
    return float(minimum_jerk((s - start) / (end - start)))
