"""A scripted operator of one task: attempts that begin and end with the arms at their waiting poses."""

import logging
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from lerobot_robot_yam.errors import ConfigError, RigError
from lerobot_robot_yam.rig.operator.hands import Hands, Pose, Sight, see
from lerobot_robot_yam.rig.operator.scripts.setup import Setup
from lerobot_robot_yam.rig.operator.worker import Worker
from lerobot_robot_yam.rig.scene.props import Grip

logger = logging.getLogger(__name__)

PUT_DOWN_M = 0.002  # above where it shall lie a prop is let go
_LIFTED_M = 0.03  # a prop that rose less slipped from the fingers
_TRIES = 4


class Script(ABC):
    """Does one task, as often as asked. Every method may raise Interrupted: the arms are switched off.

    Args:
        hands: the operator's eyes, hands and clock.
        setup: the task, its things and the arms.

    Attributes:
        height_m: height of the tool on its way over the table.
        endless: `work` is done again and again from where it ended; nothing is placed, nothing judged.
        workers: side → its arm.
    """

    height_m: ClassVar[float] = 0.125
    endless: ClassVar[bool] = False

    def __init__(self, hands: Hands, setup: Setup):
        self.hands, self.setup = hands, setup
        self.workers = {
            side: Worker(hands, side, planner, setup.homes_m[side], self.height_m)
            for side, planner in setup.planners.items()
        }

    def begin(self) -> None:
        """Take all arms from wherever they are to their waiting poses."""
        for worker in self.workers.values():
            worker.unfold()
        for worker in self.workers.values():
            worker.wait()
            worker.settle()

    def attempt(self) -> None:
        """Do the task once, from what is seen, in a few tries where something slips."""
        for _ in range(_TRIES):
            try:
                if self.work():
                    break
            except RigError as error:  # out of reach on the way
                logger.warning("%s", error)
                self._retreat()
        self._retreat()

    @abstractmethod
    def work(self) -> bool:
        """One try; whether it looks done. Raises RigError where a point is out of reach."""

    def _retreat(self) -> None:
        for worker in self.workers.values():
            if worker.holds:
                worker.open()
        for worker in self.workers.values():
            worker.go_home()
        for worker in self.workers.values():
            worker.wait()

    def take(self, worker: Worker, thing: Pose, grip: Grip) -> float:
        """Reach a thing at a grip and close the fingers on it; returns the yaw of the tool."""
        point = thing.point(grip.point_m)
        thing_yaw = thing.edge_yaw_rad if grip.turns == 4 else thing.yaw_rad
        yaw = worker.planner.grasp_yaw(point, grip.yaw_rad + thing_yaw, grip.turns)
        worker.reach(point, yaw)
        worker.close()
        return yaw

    def look_at(self, thing: str) -> Pose:
        """Where a thing is now."""
        return see(self.hands).things[thing]

    def grip_of(self, thing: str, number: int = 0) -> Grip:
        """How to take a thing. Raises ConfigError: the scene does not say."""
        grips = self.setup.things[thing].grips
        if number >= len(grips):
            raise ConfigError(f"task {self.setup.task.name}: {thing} needs {number + 1} grips; it has {len(grips)}")
        return grips[number]

    def lies_at_goal(self) -> bool:
        """Whether the prop of the last stage is in its region, seen from above."""
        goal, region = self.goal(), self.setup.last.inside
        off = self.look_at(self.setup.last.prop).position_m - goal.position_m
        return region is not None and bool(np.linalg.norm(off[:2]) < region.radius_m)

    def goal(self) -> Pose:
        """The pose that the last stage of success asks of its prop: the middle of the region, turned as its frame."""
        region = self.setup.last.inside
        if region is None:
            raise ConfigError(f"task {self.setup.task.name}: its last stage needs a region inside which the prop ends")
        if not region.frame:
            return Pose(region.center_m, np.array([1.0, 0.0, 0.0, 0.0]))
        frame = self.look_at(region.frame)
        return Pose(frame.point(region.center_m), frame.quat_wxyz)


def lifted(prop: str, from_m: float, by_m: float = _LIFTED_M) -> Callable[[Sight], bool]:
    """For `Worker.carry`: whether a prop has risen above the height `from_m` at which it lay."""
    return lambda sight: bool(sight.things[prop].position_m[2] - from_m > by_m)
