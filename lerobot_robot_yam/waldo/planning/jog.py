"""Jog commands: a speed of the joints, or of the tool along and about axes, that holds for a moment and then brakes.

Each brakes at its end, at a limit, or before a thing. The same command given on does not try again, any other does.

A jog of the tool moves the tool's pose on by the tool's speed, and the joints follow it by inverse kinematics, so that
nothing drifts. It goes on only as long as the place where it would come to rest is free. Near a singularity it slows
down with the joints that have to turn fast. At the end of the reach it stops.
"""

import numpy as np

from lerobot_robot_yam.waldo.kinematics.inverse import Bounds, descend
from lerobot_robot_yam.waldo.kinematics.rotation import cross, of_turn
from lerobot_robot_yam.waldo.planning.motion_limits import (
    JOG_SHARE,
    LINE_ACCELERATION_M_S2,
    LINE_ACCELERATION_RAD_S2,
    LINE_SPEED_M_S,
    LINE_SPEED_RAD_S,
    STOP_FACTOR,
)
from lerobot_robot_yam.waldo.planning.planner import Planner

_SPEEDS = np.array([LINE_SPEED_M_S] * 3 + [LINE_SPEED_RAD_S] * 3)
_RATES = (LINE_ACCELERATION_M_S2, LINE_ACCELERATION_RAD_S2)
_JOINT_SHARE = 0.8  # of the joints' speed limits that a jog may ask for
_LEAST = 0.01  # of the tool's speed limits: so slowly it may still go near a singularity
_TINY = 1e-9
_JUMP_RAD = 0.6  # to where it would come to rest: another way of holding the tool


class JointJog:
    """One command that turns joints; renewed as long as a button is held.

    Args:
        planner: of the arm.
        shares: (n,) signed, −1 … 1 of the jog speed.
        accel: share 0 … 1 of the acceleration limit, for speeding up; it always brakes with all of it.
        until_s: when it ends.

    Attributes:
        until_s: when it ends.
    """

    def __init__(self, planner: Planner, shares: np.ndarray, accel: float, until_s: float):
        self._planner, self._shares, self._accel, self.until_s = planner, shares, accel, until_s
        self._blocked = False

    def renewed(self, newer: "JointJog") -> "JointJog":
        """The newer command; what stood in the way of this one stands in the way of the same asked again."""
        newer._blocked = self._blocked and np.array_equal(newer._shares, self._shares)
        return newer

    def step(self, q: np.ndarray, dq: np.ndarray, now_s: float, dt_s: float) -> tuple[np.ndarray, np.ndarray]:
        """The set-point (n,) rad and its speed (n,) rad/s one tick after these."""
        limits = self._planner.limits
        if now_s < self.until_s and not self._blocked:
            there = self._towards(JOG_SHARE * limits.speed * self._shares, q, dq, dt_s)
            stop = there[0] + there[1] * np.abs(there[1]) / (2.0 * limits.acceleration)
            if self._planner.surroundings.first_conflict(np.array([q, stop])) is None:
                return there
            self._blocked = True
        return self._towards(np.zeros(len(q)), q, dq, dt_s)

    def _towards(self, wanted: np.ndarray, q: np.ndarray, dq: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        planner, most = self._planner, self._planner.limits.acceleration
        gains = (np.abs(wanted) > np.abs(dq)) & (wanted * dq >= 0.0)
        step = np.where(gains, self._accel, 1.0) * most * dt
        speed = dq + np.clip(wanted - dq, -step, step)
        down, up = (_speed_within(room, most, dt) for room in (q - planner.lower, planner.upper - q))
        speed = np.clip(speed, -down, up)
        return q + speed * dt, speed


class LineJog:
    """One command that moves the tool; renewed as long as a button is held.

    Args:
        planner: of the arm.
        in_tool: the axes are the tool's, not the base's.
        shares: (6,) signed, −1 … 1 of the speed limits along and about x, y, z.
        accel: share 0 … 1 of the acceleration limits, for speeding up; it always brakes with all of them.
        until_s: when it ends.
        q, dq: (n,) the set-point that it goes on from, rad and rad/s.

    Attributes:
        until_s: when it ends.
    """

    def __init__(
        self,
        planner: Planner,
        in_tool: bool,
        shares: np.ndarray,
        accel: float,
        until_s: float,
        q: np.ndarray,
        dq: np.ndarray,
    ):
        self._planner, self._in_tool, self._shares = planner, in_tool, shares
        self._accel, self.until_s = accel, until_s
        self._blocked = self._off_line = False
        self._begin(q, dq)

    def _begin(self, q: np.ndarray, dq: np.ndarray) -> None:
        self._pose, self._rest_q = self._planner.pose(q), q
        _, jacobian = self._planner.chain.place(q)
        speed = jacobian @ dq
        arm = self._pose[:3, 3] - self._planner.chain.pose(q)[:3, 3]
        self._twist = np.concatenate([speed[:3] + cross(speed[3:], arm), speed[3:]])
        self._brake_ease = 1.0  # with which the place where it would come to rest was found free

    def renewed(self, newer: "LineJog") -> "LineJog":
        """The newer command, from where this one is; see `JointJog.renewed`."""
        newer._pose, newer._twist = self._pose, self._twist
        newer._rest_q, newer._brake_ease, newer._off_line = self._rest_q, self._brake_ease, self._off_line
        same = newer._in_tool == self._in_tool and np.array_equal(newer._shares, self._shares)
        newer._blocked = self._blocked and same
        return newer

    def step(self, q: np.ndarray, dq: np.ndarray, now_s: float, dt_s: float) -> tuple[np.ndarray, np.ndarray]:
        """The set-point (n,) rad and its speed (n,) rad/s one tick after these."""
        if self._off_line:
            return self._brake(q, dq, dt_s)
        if now_s < self.until_s and not self._blocked:
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
        """(6,) the tool's speed that is asked for, m/s and rad/s in the axes of the base."""
        wanted = _SPEEDS * self._shares
        if not self._in_tool:
            return wanted
        turn = self._pose[:3, :3]
        return np.concatenate([turn @ wanted[:3], turn @ wanted[3:]])

    def _rates(self, twist: np.ndarray, q: np.ndarray) -> np.ndarray:
        """(n,) rad/s of the joints when the tool moves with a share 1 of its speed limits in a twist's direction."""
        pose, jacobian = self._planner.chain.place(q)
        arm = pose[:3, :3] @ self._planner.tool[:3, 3]
        flange = np.concatenate([twist[:3] - cross(twist[3:], arm), twist[3:]]) / max(_level(twist), _TINY)
        return np.linalg.lstsq(jacobian, flange, rcond=1e-6)[0]

    def _ease(self, twist: np.ndarray, q: np.ndarray) -> float:
        """Share of the tool's speed limits, in the direction of a twist (6,), at which no joint turns too fast at q."""
        most = _JOINT_SHARE * self._planner.limits.speed
        return min(1.0, float((most / np.maximum(np.abs(self._rates(twist, q)), _TINY)).min()))

    def _try(
        self, wanted: np.ndarray, ease: float, q: np.ndarray, dq: np.ndarray, dt: float
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """One tick on; None if that, or the place where it would come to rest afterwards, is out of the question.

        ease: share of the acceleration limits that the joints can follow.
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
        flange = np.linalg.inv(planner.tool)
        bounds = Bounds(np.minimum(planner.lower, q), np.maximum(planner.upper, q))
        seeds = np.array([q + dq * dt, q + dq * (dt + max(spans))])
        found = descend(planner.chain, np.array([pose @ flange, rest @ flange]), seeds, bounds)
        speed = (found.q[0] - q) / dt if there.any() else np.zeros(len(q))
        if (
            not found.reached.all()
            or (np.abs(speed) > np.maximum(planner.limits.speed, np.abs(dq))).any()
            or (np.abs(speed - dq) > STOP_FACTOR * planner.limits.acceleration * dt).any()
            or np.abs(found.q[1] - found.q[0]).max() > _JUMP_RAD
            or planner.surroundings.first_conflict(np.array([q, found.q[1]])) is not None
        ):
            return None
        self._pose, self._twist, self._rest_q = pose, there, found.q[1]
        return found.q[0], speed

    def _brake(self, q: np.ndarray, dq: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Where the tool's line cannot be kept any more, each joint comes to rest on its own."""
        step = STOP_FACTOR * self._planner.limits.acceleration * dt
        speed = dq - np.clip(dq, -step, step)
        lower, upper = np.minimum(self._planner.lower, q), np.maximum(self._planner.upper, q)
        there = np.clip(q + speed * dt, lower, upper)
        self._begin(there, speed)
        self._off_line = bool(speed.any())
        return there, speed


def _speed_within(room: np.ndarray, deceleration: np.ndarray, dt: float) -> np.ndarray:
    """The speed at which one more tick still leaves room to brake:  v dt + v² / 2a = room;  0 without any room."""
    return deceleration * (np.sqrt(dt**2 + 2.0 * np.maximum(room, 0.0) / deceleration) - dt)


def _level(twist: np.ndarray) -> float:
    """The share of the tool's speed limits that a twist (6,) is."""
    return max(float(np.linalg.norm(twist[:3])) / LINE_SPEED_M_S, float(np.linalg.norm(twist[3:])) / LINE_SPEED_RAD_S)


def _moved(pose: np.ndarray, twist: np.ndarray, linear_s: float, angular_s: float) -> np.ndarray:
    """A pose (4, 4) after a time at a speed (6,), shifts and turns for a time of their own."""
    out = pose.copy()
    out[:3, 3] += twist[:3] * linear_s
    out[:3, :3] = of_turn(twist[3:] * angular_s) @ pose[:3, :3]
    return out
