"""Scripted operator of one task: setup, and attempts that begin and end with the arms in their waiting poses."""

import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from lerobot_robot_yam.arm.model import build_model
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.errors import ConfigError, RigError
from lerobot_robot_yam.rig.operator.hands import Hands, Pose, Sight, see
from lerobot_robot_yam.rig.operator.plan import ArmPlanner
from lerobot_robot_yam.rig.operator.worker import Worker
from lerobot_robot_yam.rig.scene.props import Grip, Thing
from lerobot_robot_yam.rig.scene.tasks import PICK_AND_PLACE, Stage, Task
from lerobot_robot_yam.system.strict_yaml import parse

logger = logging.getLogger(__name__)

PUT_DOWN_M = 0.002  # height above its goal at which a prop is released
_LIFTED_M = 0.03  # minimum rise of a held prop; a prop that rose less has slipped
_TRIES = 4
SIDES = ("left", "right")


@dataclass(frozen=True)
class Setup:
    """A task with the things and arms that it needs.

    Attributes:
        things: name → prop or piece of furniture.
        planners: side → planner of the side's follower.
        homes_m: side → waiting position of the side's tool, (3,).
        places_m: name → point, (3,).
        stands: name → pose of the base in the world, (3,), m and rad.
        seed: seed of the operator's random choices.
    """

    task: Task
    things: Mapping[str, Thing]
    planners: Mapping[str, ArmPlanner]
    homes_m: Mapping[str, np.ndarray]
    places_m: Mapping[str, np.ndarray]
    stands: Mapping[str, np.ndarray]
    seed: int

    @property
    def last(self) -> Stage:
        return self.task.success[-1]

    def home_rad(self, side: str) -> np.ndarray:
        """Return the waiting pose of a follower, (n,)."""
        return self.planners[side].pose(self.homes_m[side])

    def nearest(self, point_m: np.ndarray) -> str:
        """Return the side whose base is nearest to a point."""
        off = {side: float(np.linalg.norm((planner.base_m - point_m)[:2])) for side, planner in self.planners.items()}
        return min(off, key=lambda side: off[side])


def sides_of(scene: Mapping[str, Any]) -> tuple[str, ...]:
    channels = {row["channel"] for row in scene["arms"]}
    return tuple(side for side in SIDES if f"follower_{side}" in channels)


def _planner(row: Mapping[str, Any], tilt_rad: float) -> ArmPlanner:
    arm = load_arm(row["arm"])
    names = [motor.name for motor in arm.motors]
    leads = slice(names.index(arm.folding.elbow) if arm.folding.elbow in names else 0, -1)
    model = build_model(row["arm"], row["gripper"], visuals=False)
    return ArmPlanner(model, np.array(row["position_m"]), float(row["yaw_rad"]), arm.bent_q_rad, leads, tilt_rad)


def make_setup(scene: Mapping[str, Any], task: str) -> Setup:
    """Build the setup for a task. Raises ConfigError: the scene lacks the task, a follower, or a waiting position."""
    where = f"scene {scene['name']}"
    tasks = {row["name"]: row for row in scene["tasks"]}
    if task not in tasks and task != PICK_AND_PLACE.name:
        raise ConfigError(f"{where} has no task '{task}'; it has: {', '.join(tasks) or 'no tasks'}")
    found = parse(Task, tasks[task], f"{where}: task {task}") if task in tasks else PICK_AND_PLACE
    arms = {row["channel"]: row for row in scene["arms"]}
    planners = {side: _planner(arms[f"follower_{side}"], found.tilt_rad) for side in sides_of(scene)}
    missing = [side for side in planners or SIDES if side not in scene["homes"] or not planners]
    if missing:
        raise ConfigError(f"{where}: task {task} needs followers, and under homes a waiting place of each: {missing}")
    things = [parse(Thing, row, f"{where}: {row['name']}") for row in (*scene["props"], *scene["furniture"])]
    return Setup(
        task=found,
        things={thing.name: thing for thing in things},
        planners=planners,
        homes_m={side: np.array(scene["homes"][side]) for side in planners},
        places_m={name: np.array(point) for name, point in scene["places"].items()},
        stands={name: np.array(pose) for name, pose in scene["stands"].items()},
        seed=scene["seed"],
    )


class Script(ABC):
    """Script of one task, which may be repeated. Each method raises Interrupted if the arms are switched off.

    Args:
        hands: interface to the rig: sight, hands and clock.
        setup: the task, its things and the arms.

    Attributes:
        height_m: height at which the tool travels over the table.
        endless: whether each `work` continues where the previous one ended, without placing things and without verdict.
        drives: whether it drives a base, and therefore makes one attempt in each episode of whoever reads what it asks.
        workers: side → worker of that side.
    """

    height_m: ClassVar[float] = 0.125
    endless: ClassVar[bool] = False
    drives: ClassVar[bool] = False

    def __init__(self, hands: Hands, setup: Setup):
        self.hands, self.setup = hands, setup
        self.workers = {
            side: Worker(hands, side, planner, setup.homes_m[side], self.height_m)
            for side, planner in setup.planners.items()
        }

    def begin(self) -> None:
        """Move all arms from any pose to their waiting poses."""
        for worker in self.workers.values():
            worker.unfold()
        for worker in self.workers.values():
            worker.wait()
            worker.settle()

    def attempt(self) -> None:
        """Perform the task once, with a few retries in case an object slips."""
        for _ in range(_TRIES):
            try:
                if self.work():
                    break
            except RigError as error:  # a point of the path is out of reach
                logger.warning("%s", error)
                self._retreat()
        self._retreat()

    @abstractmethod
    def work(self) -> bool:
        """Try the task once; return whether it appears to be done. Raises RigError: a point is out of reach."""

    def _retreat(self) -> None:
        for worker in self.workers.values():
            if worker.holds:
                worker.open()
        for worker in self.workers.values():
            worker.go_home()
        for worker in self.workers.values():
            worker.wait()

    def take(self, worker: Worker, thing: Pose, grip: Grip) -> float:
        """Reach for a grip of a thing and close the fingers on it; return the yaw of the tool."""
        point = thing.point(grip.point_m)
        thing_yaw = thing.edge_yaw_rad if grip.turns == 4 else thing.yaw_rad
        yaw = worker.planner.grasp_yaw(point, grip.yaw_rad + thing_yaw, grip.turns)
        worker.reach(point, yaw)
        worker.close()
        return yaw

    def look_at(self, thing: str) -> Pose:
        """Return the current pose of a thing."""
        return see(self.hands).things[thing]

    def grip_of(self, thing: str, number: int = 0) -> Grip:
        """Return the grip of a thing with index `number`. Raises ConfigError: the thing has too few grips."""
        grips = self.setup.things[thing].grips
        if number >= len(grips):
            raise ConfigError(f"task {self.setup.task.name}: {thing} needs {number + 1} grips; it has {len(grips)}")
        return grips[number]

    def lies_at_goal(self) -> bool:
        """Return whether the last stage's prop is in its region, seen from above."""
        goal, region = self.goal(), self.setup.last.inside
        off = self.look_at(self.setup.last.prop).position_m - goal.position_m
        return region is not None and bool(np.linalg.norm(off[:2]) < region.radius_m)

    def goal(self) -> Pose:
        """Return the goal pose of the last stage's prop: the middle of its region, with the region frame's rotation."""
        region = self.setup.last.inside
        if region is None:
            raise ConfigError(f"task {self.setup.task.name}: its last stage needs a region inside which the prop ends")
        if not region.frame:
            return Pose(region.center_m, np.array([1.0, 0.0, 0.0, 0.0]))
        frame = self.look_at(region.frame)
        return Pose(frame.point(region.center_m), frame.quat_wxyz)


def lifted(prop: str, from_m: float, by_m: float = _LIFTED_M) -> Callable[[Sight], bool]:
    """Return a test for `Worker.carry`: whether a prop is more than `by_m` above its initial height `from_m`."""
    return lambda sight: bool(sight.things[prop].position_m[2] - from_m > by_m)
