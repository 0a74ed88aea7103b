"""One arm of the scripted operator: reaching, aiming, holding, carrying and going home, by way of its leader."""

import logging
from collections.abc import Callable

import numpy as np

from lerobot_robot_yam.errors import RigError
from lerobot_robot_yam.rig.operator.guidance import Guide
from lerobot_robot_yam.rig.operator.plan import ArmPlanner, Path
from lerobot_robot_yam.rig.operator.sight import Sight

logger = logging.getLogger(__name__)

_AIM_M = 0.006
_AIMS = 3
_BIAS_M = 0.03
_AT_HOME_RAD = 1e-3

Off = Callable[[Sight], tuple[np.ndarray, float]]
"""How far the tool has to go yet: (3,) m in the world and a turn about the vertical, rad."""


class Worker:
    """The arm of one side. Every method may raise Interrupted, or RigError where a point is out of reach.

    planner: of the side's follower. home_m: (3,) where the tool waits; home_rad: (n,) the joints there.
    height_m: height of the tool on its way over the table.
    """

    def __init__(self, guide: Guide, side: str, planner: ArmPlanner, home_m: np.ndarray, height_m: float):
        self.side, self.planner = side, planner
        self._guide, self._home, self._height = guide, np.asarray(home_m, float), height_m
        self.home_rad = planner.pose(self._home)
        self._bias = np.zeros(3)  # from where the tool is to where it was sent

    @property
    def holds(self) -> bool:
        """Whether its trigger is squeezed."""
        return self._guide.trigger[self.side] > 0.0

    def unfold(self) -> None:
        """Start towards the waiting pose from any pose, folded ones too."""
        start = self._guide.see().leader_rad[self.side]
        self._guide.send(self.side, self.planner.unfold(start, self.home_rad))

    def wait(self) -> None:
        """Wait for the end of the path that it is on."""
        self._guide.follow_to_end(self.side)

    def reach(self, point_m: np.ndarray, yaw_rad: float) -> None:
        """Over the table and down to a point; then bring the follower's tool to the point itself.

        Friction and imperfect gravity compensation keep it a few millimetres off; the next time that is allowed for.
        """
        self._transfer(point_m + self._bias, yaw_rad)
        self.wait()
        start, _ = self.planner.tool(self._guide.q[self.side])
        self.approach(lambda sight: (point_m - self.planner.tool(sight.follower_rad[self.side])[0], 0.0))
        gone = self.planner.tool(self._guide.q[self.side])[0] - start
        self._bias = np.clip(self._bias + gone, -_BIAS_M, _BIAS_M)

    def approach(
        self, off: Off, within_m: float = _AIM_M, within_rad: float = np.inf, tries: int = _AIMS, above_m: float = 0.0
    ) -> bool:
        """Go by `off` until it is small; whether it is.

        above_m: come from so far above each time, so that friction always pulls the same way.
        """
        for _ in range(tries):
            self._guide.settle(self.side)
            way, turn = off(self._guide.see())
            if np.abs(way).max() < within_m and abs(turn) < within_rad:
                return True
            point, yaw = self.planner.tool(self._guide.q[self.side])
            if above_m > 0.0:
                self.go(point + way + [0.0, 0.0, above_m], yaw + turn)
            self.go(point + way, yaw + turn)
        return False

    def go(self, point_m: np.ndarray, yaw_rad: float, least_s: float = 0.2) -> None:
        """Straight to a tool pose."""
        self._guide.send(self.side, self.planner.straight(self._guide.q[self.side], point_m, yaw_rad, least_s))
        self.wait()

    def rise(self, height_m: float) -> None:
        """Straight up."""
        point, yaw = self.planner.tool(self._guide.q[self.side])
        self.go(point + [0.0, 0.0, height_m], yaw)

    def close(self) -> None:
        """Squeeze until the fingers stand still."""
        self._guide.squeeze(self.side, 1.0)

    def open(self) -> None:
        """Let go."""
        self._guide.squeeze(self.side, 0.0)

    def carry(self, point_m: np.ndarray, yaw_rad: float, lifted: Callable[[Sight], bool]) -> bool:
        """Bring a held thing to a tool pose. If `lifted` is False halfway, stop there and let go: returns False."""
        path = self._transfer(point_m + self._bias, yaw_rad)
        self._guide.follow(self.side, 0.5 * path.duration_s)
        if not lifted(self._guide.see()):
            logger.info("missed the prop with the %s hand; trying again", self.side)
            self._guide.stop(self.side)
            self.open()
            return False
        self.wait()
        self._guide.settle(self.side)
        return True

    def go_home(self) -> None:
        """Start towards the waiting pose, if it is not there."""
        if np.abs(self._guide.q[self.side] - self.home_rad).max() < _AT_HOME_RAD:
            return
        try:
            self._transfer(self._home, self.planner.natural_yaw(self._home))
        except RigError:
            self._guide.send(self.side, self.planner.joint_move(self._guide.q[self.side], self.home_rad))

    def _transfer(self, point_m: np.ndarray, yaw_rad: float) -> Path:
        path = self.planner.transfer(self._guide.q[self.side], point_m, yaw_rad, self._height)
        self._guide.send(self.side, path)
        return path
