"""Short commands that move the set-point tick by tick: joint jogs, tool jogs, and motions to a target.

A new command replaces the current one, and starts at the arm's current speed.

A jog keeps its speed for a short time and then brakes; it also brakes at a limit and before an obstacle. A tool jog
integrates the tool's pose, and inverse kinematics gives the joints, so there is no drift. A tool jog continues only
while the pose at which it could come to rest is reachable and free. Near a singularity, where joints have to turn fast,
the jog slows down. At the limit of the arm's reach it stops.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.tool_pose import rotation_matrix
from lerobot_robot_yam.errors import PlanError
from lerobot_robot_yam.waldo.planning.motion_plan import (
    JOG_SHARE,
    LINE_ACCELERATION_M_S2,
    LINE_ACCELERATION_RAD_S2,
    LINE_SPEED_M_S,
    LINE_SPEED_RAD_S,
    STOP_FACTOR,
    Plan,
    shares,
)
from lerobot_robot_yam.waldo.planning.planner import Planner
from lerobot_robot_yam.waldo.poses import AXES, check_frame, number

JOG_S = 0.1
"""Default duration of a jog that is not renewed, s."""

_SPEEDS = np.array([LINE_SPEED_M_S] * 3 + [LINE_SPEED_RAD_S] * 3)
_RATES = (LINE_ACCELERATION_M_S2, LINE_ACCELERATION_RAD_S2)
_JOINT_SHARE = 0.8  # fraction of the joint speed limits available to a tool jog
_LEAST = 0.01  # minimum fraction of the tool's speed limits, used near a singularity
_TINY = 1e-9
_JUMP_RAD = 0.6  # joint distance beyond which the pose at rest belongs to another arm configuration, rad
_MOST_JOG_S = 10.0  # maximum duration of a jog, s; our choice

State = tuple[np.ndarray, np.ndarray]
"""Set-point (n,), rad, and its speed (n,), rad/s."""


class Stream(ABC):
    """Command that moves the set-point tick by tick until the set-point is at rest."""

    @abstractmethod
    def step(self, q: np.ndarray, dq: np.ndarray, now_s: float, dt_s: float) -> State:
        """Return the set-point (n,), rad, and its speed (n,), rad/s, one tick of dt_s later."""

    @abstractmethod
    def ended(self, now_s: float) -> bool:
        """Return whether the command ends as soon as the set-point is at rest."""

    def renewed_by(self, newer: "Stream") -> bool:
        """Adopt the end time of a newer command for the same motion. Return False if the motion differs."""
        return False


class Play(Stream):
    """Stream that plays a plan, starting with the first tick."""

    def __init__(self, plan: Plan):
        self._plan, self._t_s = plan, 0.0

    def step(self, q: np.ndarray, dq: np.ndarray, now_s: float, dt_s: float) -> State:
        self._t_s += dt_s
        if self._t_s >= self._plan.duration_s:
            return self._plan.q[-1], np.zeros(len(q))
        return self._plan.at(self._t_s)

    def ended(self, now_s: float) -> bool:
        return self._t_s >= self._plan.duration_s


class Jog(Stream):
    """Jog that lasts `duration_s` from `now_s` on. It is renewed while a button is held.

    Args:
        planner: planner of the arm.
        parts: signed fractions −1 … 1 of the speed of each joint (n,) or axis (6,).
        accel: fraction 0 … 1 of the acceleration limits for speeding up. Braking always uses the full limits.

    Raises:
        PlanError: an argument is malformed.
    """

    _in_tool = False

    def __init__(self, planner: Planner, parts: np.ndarray, now_s: float, duration_s: float, accel: float):
        self._planner, self._shares, self._blocked = planner, parts, False
        self._from_s, self._until_s = now_s, now_s + number("a jog's duration", duration_s, 0.0, _MOST_JOG_S)
        self._accel = shares(1.0, accel, 0.0)[1]

    def renewed_by(self, newer: Stream) -> bool:
        """Do `Stream.renewed_by`. A jog stopped by an obstacle stays stopped. A jog past its end is not renewed."""
        if not (isinstance(newer, Jog) and type(newer) is type(self) and newer._from_s <= self._until_s):
            return False
        if newer._in_tool != self._in_tool or not np.array_equal(newer._shares, self._shares):
            return False
        self._until_s, self._accel = newer._until_s, newer._accel
        return True

    def ended(self, now_s: float) -> bool:
        return now_s >= self._until_s


class JointJog(Jog):
    """Jog of joints. `speeds`: joint (from 0) → signed fraction −1 … 1 of the jog speed; others as for `Jog`."""

    def __init__(
        self,
        planner: Planner,
        speeds: Mapping[int, float],
        now_s: float,
        duration_s: float = JOG_S,
        accel: float = 1.0,
    ):
        joints = range(len(planner.lower))
        parts = _parts("joint", joints, f"joints are 0 to {joints[-1]}", speeds)
        super().__init__(planner, parts, now_s, duration_s, accel)

    def step(self, q: np.ndarray, dq: np.ndarray, now_s: float, dt_s: float) -> State:
        limits = self._planner.limits
        if now_s < self._until_s and not self._blocked:
            there = self._towards(JOG_SHARE * limits.speed * self._shares, q, dq, dt_s)
            stop = there[0] + there[1] * np.abs(there[1]) / (2.0 * limits.acceleration)
            if self._planner.conflict(np.array([q, stop])) is None:
                return there
            self._blocked = True
        return self._towards(np.zeros(len(q)), q, dq, dt_s)

    def _towards(self, wanted: np.ndarray, q: np.ndarray, dq: np.ndarray, dt: float) -> State:
        planner, most = self._planner, self._planner.limits.acceleration
        gains = (np.abs(wanted) > np.abs(dq)) & (wanted * dq >= 0.0)
        step = np.where(gains, self._accel, 1.0) * most * dt
        speed = dq + np.clip(wanted - dq, -step, step)
        down, up = (_speed_within(room, most, dt) for room in (q - planner.lower, planner.upper - q))
        speed = np.clip(speed, -down, up)
        return q + speed * dt, speed


class LineJog(Jog):
    """Jog of the tool. Arguments that are not listed are as for `Jog`.

    Args:
        frame: frame of the axes, base or tool.
        speeds: axis → signed fraction −1 … 1 of the tool's speed limit along or about this axis.
        start: current set-point and its speed.
    """

    def __init__(
        self,
        planner: Planner,
        frame: str,
        speeds: Mapping[str, float],
        start: State,
        now_s: float,
        duration_s: float = JOG_S,
        accel: float = 1.0,
    ):
        self._in_tool = check_frame(frame) == "TRF"
        super().__init__(planner, _parts("axis", AXES, f"axes are {', '.join(AXES)}", speeds), now_s, duration_s, accel)
        self._off_line = False
        self._begin(*start)

    def _begin(self, q: np.ndarray, dq: np.ndarray) -> None:
        self._pose, self._rest_q = self._planner.pose(q), q
        self._twist = self._planner.kinematics.twist(q, dq)
        self._brake_ease = 1.0  # last ease for which coming to rest was possible, for braking

    def step(self, q: np.ndarray, dq: np.ndarray, now_s: float, dt_s: float) -> State:
        if self._off_line:
            return self._brake(q, dq, dt_s)
        if now_s < self._until_s and not self._blocked:
            wanted = self._wanted()
            ease = min(self._ease(twist, place) for twist in (self._twist, wanted) for place in (q, self._rest_q))
            ease = max(ease, _LEAST)
            there = self._try(wanted * min(1.0, ease / max(_level(wanted), _TINY)), ease, q, dq, dt_s)
            if there is not None:
                self._brake_ease = ease
                return there
            self._blocked = True
        if not self._twist.any() and not dq.any():
            return q, dq
        there = self._try(np.zeros(6), self._brake_ease, q, dq, dt_s)
        return self._brake(q, dq, dt_s) if there is None else there

    def _wanted(self) -> np.ndarray:
        """Return the requested tool twist (6,) in base axes, m/s and rad/s."""
        wanted = _SPEEDS * self._shares
        if not self._in_tool:
            return wanted
        turn = self._pose[:3, :3]
        return np.concatenate([turn @ wanted[:3], turn @ wanted[3:]])

    def _ease(self, twist: np.ndarray, q: np.ndarray) -> float:
        """Return the fraction of the tool's speed limits, along a twist (6,), at which no joint is too fast at q."""
        rates = self._planner.kinematics.rates(q, twist / max(_level(twist), _TINY))
        return min(1.0, float((_JOINT_SHARE * self._planner.limits.speed / np.maximum(np.abs(rates), _TINY)).min()))

    def _try(self, wanted: np.ndarray, ease: float, q: np.ndarray, dq: np.ndarray, dt: float) -> State | None:
        """Return the set-point one tick later, or None if that set-point or the subsequent stop is not allowed.

        `ease`: fraction of the tool's acceleration limits that the joints can follow.
        """
        planner = self._planner
        speeds, spans = [], []
        for part, rate in zip((slice(0, 3), slice(3, 6)), _RATES, strict=True):
            before, after = self._twist[part], wanted[part]
            gains = float(np.linalg.norm(after)) > float(np.linalg.norm(before)) and float(before @ after) >= 0.0
            change, most = after - before, ease * rate * dt * (self._accel if gains else 1.0)
            speeds.append(before + change * min(1.0, most / max(float(np.linalg.norm(change)), _TINY)))
            spans.append(float(np.linalg.norm(speeds[-1])) / (ease * rate) / 2.0)
        there = np.concatenate(speeds)
        pose = _moved(self._pose, there, dt, dt)
        rest = _moved(pose, there, *spans)
        there_q, reached = planner.kinematics.follow(pose, q, q + dq * dt)
        rest_q, rest_reached = planner.kinematics.follow(rest, q, q + dq * (dt + max(spans)))
        speed = (there_q - q) / dt if there.any() else np.zeros(len(q))
        if (
            not (reached and rest_reached)
            or (np.abs(speed) > np.maximum(planner.limits.speed, np.abs(dq))).any()
            or (np.abs(speed - dq) > STOP_FACTOR * planner.limits.acceleration * dt).any()
            or np.abs(rest_q - there_q).max() > _JUMP_RAD
            or planner.conflict(np.array([q, rest_q])) is not None
        ):
            return None
        self._pose, self._twist, self._rest_q = pose, there, rest_q
        return there_q, speed

    def _brake(self, q: np.ndarray, dq: np.ndarray, dt: float) -> State:
        """Bring each joint to rest on its own, for the case that the tool cannot stay on its line."""
        step = STOP_FACTOR * self._planner.limits.acceleration * dt
        speed = dq - np.clip(dq, -step, step)
        lower, upper = np.minimum(self._planner.lower, q), np.maximum(self._planner.upper, q)
        there = np.clip(q + speed * dt, lower, upper)
        self._begin(there, speed)
        self._off_line = bool(speed.any())
        return there, speed


def _parts(what: str, names: Sequence[Any], known: str, speeds: Mapping[Any, float]) -> np.ndarray:
    """Return the fractions (k,) for all `names`, 0 if not given. Raises PlanError: unknown name or bad value."""
    parts = np.zeros(len(names))
    for name, speed in speeds.items():
        if name not in names:
            raise PlanError(f"there is no {what} {name!r}; {known}")
        parts[names.index(name)] = number("a jog's speed", speed, -1.0, 1.0)
    return parts


def _speed_within(room: np.ndarray, deceleration: np.ndarray, dt: float) -> np.ndarray:
    """Return the speed v at which one more tick leaves room to brake:  v dt + v² / 2a = room;  0 without room."""
    return deceleration * (np.sqrt(dt**2 + 2.0 * np.maximum(room, 0.0) / deceleration) - dt)


def _level(twist: np.ndarray) -> float:
    """Return the magnitude of a twist (6,) as a fraction of the tool's speed limits."""
    return max(float(np.linalg.norm(twist[:3])) / LINE_SPEED_M_S, float(np.linalg.norm(twist[3:])) / LINE_SPEED_RAD_S)


def _moved(pose: np.ndarray, twist: np.ndarray, linear_s: float, angular_s: float) -> np.ndarray:
    """Return a pose (4, 4) moved by a twist (6,), for linear_s of translation and angular_s of rotation."""
    out = pose.copy()
    out[:3, 3] += twist[:3] * linear_s
    out[:3, :3] = rotation_matrix(twist[3:] * angular_s) @ pose[:3, :3]
    return out
