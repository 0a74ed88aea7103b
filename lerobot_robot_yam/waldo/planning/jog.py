"""Short commands that move the set-point tick by tick: jogs of joints, jogs of the tool, or the way to a target.

A new command replaces the present command, and starts at the arm's present speed.

A jog keeps a speed for a short time, and then brakes; it also brakes at a limit and before an obstacle. A jog of the
tool advances the tool's pose by the tool's speed, and the joints follow by inverse kinematics, so nothing drifts. Such
a jog goes on only while the pose at which it would come to rest is free. Near a singularity, where joints have to turn
fast, the jog slows down. At the end of the reach it stops.
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
_JOINT_SHARE = 0.8  # share of the joints' speed limits for a jog of the tool
_LEAST = 0.01  # least share of the tool's speed limits, used near a singularity
_TINY = 1e-9
_JUMP_RAD = 0.6  # joint distance beyond which the pose at rest belongs to another configuration of the arm, rad
_MOST_JOG_S = 10.0  # longest jog, s; our choice

State = tuple[np.ndarray, np.ndarray]
"""A set-point (n,) rad and its speed (n,) rad/s."""


class Stream(ABC):
    """Command that moves the set-point tick by tick, until the set-point rests."""

    @abstractmethod
    def step(self, q: np.ndarray, dq: np.ndarray, now_s: float, dt_s: float) -> State:
        """Return the set-point (n,) rad and its speed (n,) rad/s one tick of dt_s later."""

    @abstractmethod
    def ended(self, now_s: float) -> bool:
        """Return whether the command is over as soon as the set-point rests."""

    def renewed_by(self, newer: "Stream") -> bool:
        """Adopt the end time of a newer command for the same motion; return False if the motion differs."""
        return False


class Play(Stream):
    """Stream that plays a plan from the first tick on."""

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
    """Jog for `duration_s` from `now_s` on, which is renewed while a button is held.

    Args:
        planner: planner of the arm.
        parts: signed shares −1 … 1 of the speed of each joint (n,) or axis (6,).
        accel: share 0 … 1 of the acceleration limits for speeding up; braking always uses the full limits.

    Raises:
        PlanError: an argument is malformed.
    """

    _in_tool = False

    def __init__(self, planner: Planner, parts: np.ndarray, now_s: float, duration_s: float, accel: float):
        self._planner, self._shares, self._blocked = planner, parts, False
        self._from_s, self._until_s = now_s, now_s + number("a jog's duration", duration_s, 0.0, _MOST_JOG_S)
        self._accel = shares(1.0, accel, 0.0)[1]

    def renewed_by(self, newer: Stream) -> bool:
        """Do `Stream.renewed_by`. A jog that has met an obstacle stays stopped; a jog that has ended is not renewed."""
        if not (isinstance(newer, Jog) and type(newer) is type(self) and newer._from_s <= self._until_s):
            return False
        if newer._in_tool != self._in_tool or not np.array_equal(newer._shares, self._shares):
            return False
        self._until_s, self._accel = newer._until_s, newer._accel
        return True

    def ended(self, now_s: float) -> bool:
        return now_s >= self._until_s


class JointJog(Jog):
    """Jog of joints. `speeds`: joint (from 0) → signed share −1 … 1 of the jog speed; others as for `Jog`."""

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
    """Jog of the tool. Arguments not listed are as for `Jog`.

    Args:
        frame: frame of the axes: the base's or the tool's.
        speeds: axis → signed share −1 … 1 of the tool's speed limit along or about this axis.
        start: the present set-point.
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
        self._brake_ease = 1.0  # last ease with which the pose at rest was free, used for braking

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
        """Return the tool's wanted speed (6,) in the axes of the base, m/s and rad/s."""
        wanted = _SPEEDS * self._shares
        if not self._in_tool:
            return wanted
        turn = self._pose[:3, :3]
        return np.concatenate([turn @ wanted[:3], turn @ wanted[3:]])

    def _ease(self, twist: np.ndarray, q: np.ndarray) -> float:
        """Return the share of the tool's speed limits, along a twist (6,), up to which no joint turns too fast at q."""
        rates = self._planner.kinematics.rates(q, twist / max(_level(twist), _TINY))
        return min(1.0, float((_JOINT_SHARE * self._planner.limits.speed / np.maximum(np.abs(rates), _TINY)).min()))

    def _try(self, wanted: np.ndarray, ease: float, q: np.ndarray, dq: np.ndarray, dt: float) -> State | None:
        """Return the set-point one tick later; None if this set-point or the pose at rest after it is not allowed.

        `ease`: share of the acceleration limits that the joints can follow.
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
        """Bring each joint to rest on its own, when the tool's line cannot be kept."""
        step = STOP_FACTOR * self._planner.limits.acceleration * dt
        speed = dq - np.clip(dq, -step, step)
        lower, upper = np.minimum(self._planner.lower, q), np.maximum(self._planner.upper, q)
        there = np.clip(q + speed * dt, lower, upper)
        self._begin(there, speed)
        self._off_line = bool(speed.any())
        return there, speed


def _parts(what: str, names: Sequence[Any], known: str, speeds: Mapping[Any, float]) -> np.ndarray:
    """Return the shares (k,) of all `names`, 0 without a speed. Raises PlanError: unknown name, or not a share."""
    parts = np.zeros(len(names))
    for name, speed in speeds.items():
        if name not in names:
            raise PlanError(f"there is no {what} {name!r}; {known}")
        parts[names.index(name)] = number("a jog's speed", speed, -1.0, 1.0)
    return parts


def _speed_within(room: np.ndarray, deceleration: np.ndarray, dt: float) -> np.ndarray:
    """Return the speed v with which one more tick leaves room to brake:  v dt + v² / 2a = room;  0 without room."""
    return deceleration * (np.sqrt(dt**2 + 2.0 * np.maximum(room, 0.0) / deceleration) - dt)


def _level(twist: np.ndarray) -> float:
    """Return the speed of a twist (6,) as a share of the tool's speed limits."""
    return max(float(np.linalg.norm(twist[:3])) / LINE_SPEED_M_S, float(np.linalg.norm(twist[3:])) / LINE_SPEED_RAD_S)


def _moved(pose: np.ndarray, twist: np.ndarray, linear_s: float, angular_s: float) -> np.ndarray:
    """Return a pose (4, 4) moved with a twist (6,), for separate times of shift and turn."""
    out = pose.copy()
    out[:3, 3] += twist[:3] * linear_s
    out[:3, :3] = rotation_matrix(twist[3:] * angular_s) @ pose[:3, :3]
    return out
