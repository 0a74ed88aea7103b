"""One arm of the scripted operator: pulls the leader along paths, and checks that the follower follows."""

import logging
from collections.abc import Callable

import numpy as np

from lerobot_robot_yam.errors import RigError
from lerobot_robot_yam.rig.operator.hands import Hands, Sight, pause, see
from lerobot_robot_yam.rig.operator.plan import ArmPlanner, Path, minimum_jerk

logger = logging.getLogger(__name__)

_AIM_M = 0.006
_AIMS = 3
_BIAS_M = 0.03
_AT_HOME_RAD = 1e-3
_LOOK_S = 0.05
_LAG_RAD = 0.35  # lag that counts as not following if it lasts for _STALL_S
_STALL_S = 0.4
_ARRIVED_RAD = 0.05
_STILL_RAD = 0.004  # maximum motion between two looks at which the follower counts as at rest
_SETTLE_S = 0.8
_PATIENCE_S = 20.0
_TRIGGER_S = 0.3
_FINGERS_REST = 0.01  # maximum motion between two looks at which fingers count as at rest, share of the stroke

Off = Callable[[Sight], tuple[np.ndarray, float]]
"""Returns the tool's remaining motion: translation (3,), m, in the world, and rotation about the vertical, rad."""


class Worker:
    """Arm of one side. Each method may raise Interrupted, or RigError for a point out of reach.

    Args:
        planner: planner of the side's follower.
        home_m: (3,) waiting position of the tool.
        height_m: height at which the tool travels over the table.

    Attributes:
        q: (n,) joints of the hand at the end of its path.
        home_rad: (n,) joints of the waiting pose.
        holds: whether the trigger is squeezed.
    """

    def __init__(self, hands: Hands, side: str, planner: ArmPlanner, home_m: np.ndarray, height_m: float):
        self.side, self.planner = side, planner
        self._hands, self._home, self._height = hands, np.asarray(home_m, float), height_m
        self.q = self.home_rad = planner.pose(self._home)
        self.holds = False
        self._path: tuple[float, Path] | None = None  # start time and path
        self._bias = np.zeros(3)  # offset added to targets, which corrects the tool's position error

    def unfold(self) -> None:
        """Grip the leader, and start moving to the waiting pose from any pose, including folded ones."""
        self._path, self.holds = None, False
        start = see(self._hands).leader_rad[self.side]
        self._send(self.planner.unfold(start, self.home_rad))

    def reach(self, point_m: np.ndarray, yaw_rad: float) -> None:
        """Move over the table and down to a point, then correct the pose until the follower's tool is at the point.

        Friction and imperfect gravity compensation leave an error of a few millimetres; later moves include this bias.
        """
        self.set_off(point_m + self._bias, yaw_rad)
        self.wait()
        start, _ = self.planner.tool(self.q)
        self.approach(lambda sight: (point_m - self.planner.tool(sight.follower_rad[self.side])[0], 0.0))
        gone = self.planner.tool(self.q)[0] - start
        self._bias = np.clip(self._bias + gone, -_BIAS_M, _BIAS_M)

    def approach(
        self, off: Off, within_m: float = _AIM_M, within_rad: float = np.inf, tries: int = _AIMS, above_m: float = 0.0
    ) -> bool:
        """Move by the offset that `off` returns until this offset is small; return whether it became small.

        above_m: height above the target from which each approach starts, so that friction always acts the same way.
        """
        for _ in range(tries):
            self.settle()
            way, turn = off(see(self._hands))
            if np.abs(way).max() < within_m and abs(turn) < within_rad:
                return True
            point, yaw = self.planner.tool(self.q)
            if above_m > 0.0:
                self.go(point + way + [0.0, 0.0, above_m], yaw + turn)
            self.go(point + way, yaw + turn)
        return False

    def go(self, point_m: np.ndarray, yaw_rad: float, least_s: float = 0.2) -> None:
        """Move in a straight line to a tool pose."""
        self._send(self.planner.straight(self.q, point_m, yaw_rad, least_s))
        self.wait()

    def rise(self, height_m: float) -> None:
        point, yaw = self.planner.tool(self.q)
        self.go(point + [0.0, 0.0, height_m], yaw)

    def close(self) -> None:
        """Squeeze until the fingers stop, with or without an object between them."""
        self._squeeze(1.0)

    def open(self) -> None:
        self._squeeze(0.0)

    def carry(self, point_m: np.ndarray, yaw_rad: float, lifted: Callable[[Sight], bool]) -> bool:
        """Carry a held object to a tool pose, and settle there; return whether the object is still held."""
        self.set_off(point_m + self._bias, yaw_rad)
        if not self.holds_on(lifted):
            return False
        self.wait()
        self.settle()
        return True

    def holds_on(self, lifted: Callable[[Sight], bool]) -> bool:
        """Carry an object halfway along the path; if `lifted` then returns False, stop, open and return False."""
        assert self._path is not None
        self._follow(0.5 * self._path[1].duration_s)
        if lifted(see(self._hands)):
            return True
        logger.info("missed the prop with the %s hand; trying again", self.side)
        begun, path = self._path
        self._path, self.q = None, path.at(self._hands.now() - begun)
        self.open()
        return False

    def go_home(self) -> None:
        """Start moving to the waiting pose, unless the arm is already in that pose."""
        if np.abs(self.q - self.home_rad).max() < _AT_HOME_RAD:
            return
        try:
            self.set_off(self._home, self.planner.natural_yaw(self._home))
        except RigError:
            self._send(self.planner.unfold(self.q, self.home_rad))

    def wait(self, before_s: float = 0.0) -> None:
        """Wait for the end of the current path, or until `before_s` before its end."""
        if self._path is not None:
            self._follow(self._path[1].duration_s - before_s)

    def arrive(self) -> None:
        """Wait for the end of the path, and then for the follower to catch up."""
        self.wait()
        if _distance(see(self._hands).follower_rad[self.side], self.q) > 2 * _ARRIVED_RAD:
            self.settle()

    @property
    def moves(self) -> bool:
        return self._path is not None and self._hands.now() < self._path[0] + self._path[1].duration_s

    def settle(self) -> None:
        """Wait until the follower rests at the hand's joints; wait longer if it has fallen behind."""
        deadline = self._hands.now() + _SETTLE_S
        before = see(self._hands).follower_rad[self.side]
        while self._hands.now() < deadline:
            after = pause(self._hands, _LOOK_S).follower_rad[self.side]
            if _distance(after, self.q) < _ARRIVED_RAD and _distance(after, before) < _STILL_RAD:
                return
            before = after
        if _distance(before, self.q) > 2 * _ARRIVED_RAD:
            self._wait_for_follower(self.q)

    def set_off(self, point_m: np.ndarray, yaw_rad: float) -> None:
        """Start moving to a tool pose along a path that first rises clear of the table."""
        self._send(self.planner.transfer(self.q, point_m, yaw_rad, self._height))

    def stroll(self, point_m: np.ndarray, yaw_rad: float, least_s: float) -> None:
        """Start moving all joints at once to a tool pose; start and end must be high above the table."""
        self._send(self.planner.unfold(self.q, self.planner.pose(point_m, yaw_rad), least_s))

    def _send(self, path: Path) -> None:
        """Start a path after the end of the current path."""
        self.wait()
        self.q = path.end_rad
        self._start(path)

    def _start(self, path: Path) -> None:
        self._path = (self._hands.now(), path)
        self._hands.pull(self.side, path.times_s, path.q_rad, np.full(len(path.times_s), float(self.holds)))

    def _squeeze(self, trigger: float) -> None:
        """Move the trigger, and wait until the fingers are at rest."""
        start, self.holds = float(self.holds), trigger > 0.0
        times = np.linspace(0.0, _TRIGGER_S, 9)
        squeeze = start + (trigger - start) * minimum_jerk(times / _TRIGGER_S)
        self._hands.pull(self.side, times, np.stack([self.q] * len(times)), squeeze)
        opening = pause(self._hands, _TRIGGER_S).opening[self.side]
        deadline = self._hands.now() + _SETTLE_S
        while self._hands.now() < deadline:
            before, opening = opening, pause(self._hands, 2 * _LOOK_S).opening[self.side]
            if abs(opening - before) < _FINGERS_REST:
                return

    def _follow(self, until_s: float) -> None:
        """Wait until `until_s` into the path; while the follower is behind, stop the hand."""
        assert self._path is not None
        behind_since = None
        ending = self._path[1].duration_s - until_s
        while True:
            begun, path = self._path
            left = path.duration_s - ending - (self._hands.now() - begun)
            if left <= 1e-3:
                return
            sight = pause(self._hands, min(2 * _LOOK_S, left))
            elapsed = self._hands.now() - begun
            if _distance(sight.follower_rad[self.side], path.at(elapsed)) < _LAG_RAD:
                behind_since = None
                continue
            behind_since = self._hands.now() if behind_since is None else behind_since
            if self._hands.now() - behind_since > _STALL_S:
                self._wait_for_follower(path.at(elapsed))
                self._start(path.rest(elapsed))
                behind_since = None

    def _wait_for_follower(self, q_rad: np.ndarray) -> None:
        """Hold the hand until the follower, which is not driven or was stopped, has caught up."""
        logger.info("the %s follower does not follow; waiting for it", self.side)
        self._start(Path(np.array([0.0, 0.1]), np.stack([q_rad, q_rad])))
        deadline = self._hands.now() + _PATIENCE_S
        while _distance(pause(self._hands, _LOOK_S).follower_rad[self.side], q_rad) > 2 * _ARRIVED_RAD:
            if self._hands.now() > deadline:
                logger.info("the %s follower is stuck; going on", self.side)
                return


def _distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(np.asarray(a) - b).max())
