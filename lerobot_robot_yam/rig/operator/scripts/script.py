"""A scripted operator of one task: attempts that begin and end with the arms at their waiting poses."""

import logging
from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from lerobot_robot_yam.errors import ConfigError, RigError
from lerobot_robot_yam.rig.operator.guidance import Guide, Hands
from lerobot_robot_yam.rig.operator.scripts.setup import Setup
from lerobot_robot_yam.rig.operator.sight import Pose
from lerobot_robot_yam.rig.operator.worker import Worker
from lerobot_robot_yam.rig.scene.props import Grip

logger = logging.getLogger(__name__)

_TRIES = 4


class Script(ABC):
    """Does one task, as often as asked.

    Args:
        hands: the operator's eyes, hands and clock.
        setup: the task, and what it is done with.

    Attributes:
        height_m: height of the tool on its way over the table.
        workers: the arm of each side.
    """

    height_m: ClassVar[float] = 0.125

    def __init__(self, hands: Hands, setup: Setup):
        self.setup = setup
        self.guide = Guide(hands, setup.planners)
        self.workers = {
            side: Worker(self.guide, side, planner, setup.homes_m[side], self.height_m)
            for side, planner in setup.planners.items()
        }

    def begin(self) -> None:
        """Take all arms from wherever they are to their waiting poses.

        Raises:
            Interrupted: the arms are switched off.
        """
        self.guide.forget()
        for worker in self.workers.values():
            worker.unfold()
        for worker in self.workers.values():
            worker.wait()
            self.guide.settle(worker.side)

    def attempt(self) -> None:
        """Do the task once, from what is seen; a few tries where something slips. It does not say whether it is done.

        Raises:
            Interrupted: the arms are switched off.
        """
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
        """One try; whether it looks done. May raise RigError where a point is out of reach."""

    def _retreat(self) -> None:
        for worker in self.workers.values():
            if worker.holds:
                worker.open()
        for worker in self.workers.values():
            worker.go_home()
        for worker in self.workers.values():
            worker.wait()

    def look_at(self, thing: str) -> Pose:
        """Where a thing is now."""
        return self.guide.see().things[thing]

    def grip_of(self, thing: str, number: int = 0) -> Grip:
        """How to take a thing.

        Raises:
            ConfigError: the scene does not say.
        """
        grips = self.setup.things[thing].grips
        if number >= len(grips):
            raise ConfigError(f"task {self.setup.task.name}: {thing} needs {number + 1} grips; it has {len(grips)}")
        return grips[number]

    def goal(self) -> Pose:
        """Where the last stage of success wants its prop: the middle of the region, as its frame is turned."""
        region = self.setup.last.inside
        if region is None:
            raise ConfigError(f"task {self.setup.task.name}: its last stage needs a region inside which the prop ends")
        if not region.frame:
            return Pose(region.center_m, np.array([1.0, 0.0, 0.0, 0.0]))
        frame = self.look_at(region.frame)
        return Pose(frame.point(region.center_m), frame.quat_wxyz)


def grip_yaw(grip: Grip, pose: Pose) -> float:
    """Yaw of a tool that takes a thing by a grip, one of `grip.turns`."""
    return grip.yaw_rad + (pose.edge_yaw_rad if grip.turns == 4 else pose.yaw_rad)


def turned(local_m: np.ndarray, yaw_rad: float) -> np.ndarray:
    """(3,) turned about the vertical."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y, z = local_m
    return np.array([c * x - s * y, s * x + c * y, z])
