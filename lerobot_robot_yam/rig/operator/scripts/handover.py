"""Hand a bar from one arm to the other in the air, and lay it where it belongs."""

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.operator.hands import Hands, pause
from lerobot_robot_yam.rig.operator.scripts.script import PUT_DOWN_M, Script, Setup, lifted
from lerobot_robot_yam.rig.operator.worker import Worker
from lerobot_robot_yam.rig.scene.props import Grip

_MIDDLE = "middle"
_AWAY_M = 0.04
_CLEAR_S = 0.5  # the giver's lead before the bar is moved


class Handover(Script):
    """The bar is the prop of the last stage of success, with a grip for each hand. Both arms hold it at the place
    `middle`. The arm nearest to the goal takes it over.
    """

    height_m = 0.18

    def __init__(self, hands: Hands, setup: Setup):
        super().__init__(hands, setup)
        if len(self.workers) < 2 or _MIDDLE not in setup.places_m:
            raise ConfigError(f"task {setup.task.name}: needs two arms, and a place called {_MIDDLE}")
        self._bar = setup.last.prop

    def work(self) -> bool:
        taker_side = self.setup.nearest(self.goal().position_m)
        (giver_side,) = [side for side in self.workers if side != taker_side]
        giver, taker = self.workers[giver_side], self.workers[taker_side]
        gives, takes = self._grips(giver)
        if not self._offer(giver, taker, gives, takes):
            return False
        self.take(taker, self.look_at(self._bar), takes)
        giver.open()
        giver.rise(_AWAY_M)
        giver.go_home()
        pause(self.hands, _CLEAR_S)
        return self._lay(taker, takes)

    def _grips(self, giver: Worker) -> tuple[Grip, Grip]:
        """The giver's grip, which is the nearer one, and the taker's."""
        bar, base = self.look_at(self._bar), giver.planner.base_m
        both = [self.grip_of(self._bar, number) for number in range(2)]
        near, far = sorted(both, key=lambda grip: float(np.linalg.norm(bar.point(grip.point_m) - base)))
        return near, far

    def _offer(self, giver: Worker, taker: Worker, gives: Grip, takes: Grip) -> bool:
        """Lift it and hold it between the arms, pointing from base to base."""
        bar = self.look_at(self._bar)
        yaw = self.take(giver, bar, gives)
        across, along = taker.planner.base_m - giver.planner.base_m, takes.point_m - gives.point_m
        bar_yaw = np.arctan2(across[1], across[0]) - np.arctan2(along[1], along[0])
        target = self.setup.places_m[_MIDDLE] + _turned(gives.point_m, bar_yaw)
        return self._bring(giver, target, yaw + bar_yaw - bar.yaw_rad)

    def _lay(self, taker: Worker, takes: Grip) -> bool:
        """Lay it along the goal, the way round that turns the wrist less."""
        goal, bar = self.goal(), self.look_at(self._bar)
        _, yaw = taker.planner.tool(taker.q)
        ways = []
        for bar_yaw in (goal.yaw_rad, goal.yaw_rad + np.pi):
            target = goal.position_m + _turned(takes.point_m, bar_yaw) + [0.0, 0.0, PUT_DOWN_M]
            tool_yaw = yaw + bar_yaw - bar.yaw_rad
            wrist = (tool_yaw - taker.planner.natural_yaw(target) + np.pi) % (2 * np.pi) - np.pi
            ways.append((abs(wrist), target, tool_yaw))
        _, target, tool_yaw = min(ways, key=lambda way: way[0])
        if not self._bring(taker, target, tool_yaw):
            return False
        taker.open()
        return self.lies_at_goal()

    def _bring(self, worker: Worker, target_m: np.ndarray, yaw_rad: float) -> bool:
        return worker.carry(target_m, yaw_rad, lifted(self._bar, self.setup.things[self._bar].center_m[2]))


def _turned(local_m: np.ndarray, yaw_rad: float) -> np.ndarray:
    """(3,) turned about the vertical."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y, z = local_m
    return np.array([c * x - s * y, s * x + c * y, z])
