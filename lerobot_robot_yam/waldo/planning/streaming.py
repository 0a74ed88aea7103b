"""Set-points that follow the newest of many short commands: jogging, and servoing to a target.

Pure: time is given, and nothing is waited for. A jog ends by itself when it is not renewed; a target is gone to and
held; a newer command takes the place of the one before, at the speed that the arm has.
"""

from collections.abc import Mapping
from numbers import Real

import numpy as np

from lerobot_robot_yam.errors import PlanError
from lerobot_robot_yam.waldo.kinematics.frames import AXES, check_frame
from lerobot_robot_yam.waldo.planning.jog import JointJog, LineJog
from lerobot_robot_yam.waldo.planning.motion_limits import shares
from lerobot_robot_yam.waldo.planning.motion_plan import Plan
from lerobot_robot_yam.waldo.planning.planner import Planner

JOG_S = 0.1
"""How long a jog lasts without being renewed, unless it says otherwise."""
MOST_JOG_S = 10.0  # ours: longer than this a motion is a move


class _Play:
    """A plan that is played from the first tick on."""

    def __init__(self, plan: Plan):
        self._plan, self._t_s = plan, 0.0

    def step(self, q: np.ndarray, dq: np.ndarray, now_s: float, dt_s: float) -> tuple[np.ndarray, np.ndarray]:
        self._t_s += dt_s
        if self._t_s >= self._plan.duration_s:
            return self._plan.q[-1], np.zeros(len(q))
        return self._plan.at(self._t_s)


class Streaming:
    """The set-point of one arm while it is jogged or servoed.

    Args:
        planner: of the arm; the tool and the surroundings that it has count from then on.
        q: (n,) rad, where it starts, at rest.

    Attributes:
        q, dq: (n,) rad and rad/s of the newest tick.
    """

    def __init__(self, planner: Planner, q: np.ndarray):
        self._planner = planner
        self.seed(q)

    def seed(self, q: np.ndarray, dq: np.ndarray | None = None) -> None:
        """Begin anew at q (n,) rad, at rest or moving with dq (n,) rad/s; without a command it comes to rest."""
        self.q: np.ndarray = np.array(q, dtype=float)
        self.dq: np.ndarray = np.zeros(len(self.q)) if dq is None else np.array(dq, dtype=float)
        self._command: JointJog | LineJog | _Play | None = None

    @property
    def still(self) -> bool:
        """The set-point rests."""
        return not self.dq.any()

    def jog_joints(
        self, speeds: Mapping[int, float], now_s: float, duration_s: float = JOG_S, accel: float = 1.0
    ) -> None:
        """Turn joints, by their numbers from 0, at signed shares −1 … 1 of the jog speed.

        Raises:
            PlanError: malformed; what went on goes on.
        """
        n = len(self.q)
        for joint in speeds:
            if not (isinstance(joint, Real) and joint in range(n)):
                raise PlanError(f"there is no joint {joint!r}; joints are 0 to {n - 1}")
        wanted = np.zeros(n)
        for joint, speed in speeds.items():
            wanted[int(joint)] = _signed_share(speed)
        jog = JointJog(self._planner, wanted, _accel(accel), now_s + _duration(duration_s))
        before = self._command
        self._command = before.renewed(jog) if isinstance(before, JointJog) and now_s <= before.until_s else jog

    def jog_line(
        self, frame: str, speeds: Mapping[str, float], now_s: float, duration_s: float = JOG_S, accel: float = 1.0
    ) -> None:
        """Move the tool along and about axes of a frame, by their names, at signed shares −1 … 1 of its speed limits.

        Raises:
            PlanError: malformed; what went on goes on.
        """
        for axis in speeds:
            if axis not in AXES:
                raise PlanError(f"there is no axis {axis!r}; axes are {', '.join(AXES)}")
        wanted = np.zeros(len(AXES))
        for axis, speed in speeds.items():
            wanted[AXES.index(axis)] = _signed_share(speed)
        in_tool, until_s = check_frame(frame) == "TRF", now_s + _duration(duration_s)
        jog = LineJog(self._planner, in_tool, wanted, _accel(accel), until_s, self.q, self.dq)
        before = self._command
        self._command = before.renewed(jog) if isinstance(before, LineJog) and now_s <= before.until_s else jog

    def servo(self, target_q: np.ndarray, *, speed: float = 1.0, accel: float = 1.0) -> None:
        """Go to joints (n,) rad and stay there, instead of what went on.

        Raises:
            PlanError: as for `Planner.joints`; what went on goes on.
        """
        self._command = _Play(self._planner.joints(self.q, target_q, speed=speed, accel=accel, start_dq=self.dq))

    def servo_pose(self, target: np.ndarray, *, speed: float = 1.0, accel: float = 1.0) -> None:
        """The same to a pose (4, 4) of the tool, m, without turning the arm over.

        Raises:
            PlanError: it cannot be reached from here; what went on goes on.
        """
        self.servo(self._planner.inverse(target, self.q, turn_over=False), speed=speed, accel=accel)

    def stop(self) -> None:
        """Come to rest as soon as the limits allow."""
        self._command = _Play(self._planner.stop(self.q, self.dq))

    def step(self, now_s: float, dt_s: float) -> tuple[np.ndarray, np.ndarray]:
        """The set-point (n,) rad and its speed (n,) rad/s one tick of `dt_s` later."""
        if self._command is None and not self.still:
            self.stop()
        if self._command is not None and dt_s > 0.0:
            self.q, self.dq = self._command.step(self.q, self.dq, now_s, dt_s)
        return self.q, self.dq


def _signed_share(speed: float) -> float:
    if not (isinstance(speed, Real) and -1.0 <= speed <= 1.0):
        raise PlanError(f"a jog's speed has to be a number from -1 to 1, not {speed!r}")
    return float(speed)


def _duration(duration_s: float) -> float:
    if not (isinstance(duration_s, Real) and 0.0 <= duration_s <= MOST_JOG_S):
        raise PlanError(f"a jog's duration has to be a number from 0 to {MOST_JOG_S:g} s, not {duration_s!r}")
    return float(duration_s)


def _accel(accel: float) -> float:
    return shares(1.0, accel, 0.0)[1]
