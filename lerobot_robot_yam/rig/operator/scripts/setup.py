"""A scripted operator's knowledge before it begins, from a scene as `RigOperations.scene` returns it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.model import build_model
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.operator.plan import ArmPlanner
from lerobot_robot_yam.rig.scene.props import Thing
from lerobot_robot_yam.rig.scene.tasks import PICK_AND_PLACE, Stage, Task
from lerobot_robot_yam.system.strict_yaml import parse

SIDES = ("left", "right")


@dataclass(frozen=True)
class Setup:
    """A task, and the things and arms that do it.

    Attributes:
        task: the task.
        things: props and furniture by name.
        planners: side → planner of the follower that stands there.
        homes_m: side → where its tool waits, (3,).
        places_m: named points, (3,).
    """

    task: Task
    things: Mapping[str, Thing]
    planners: Mapping[str, ArmPlanner]
    homes_m: Mapping[str, np.ndarray]
    places_m: Mapping[str, np.ndarray]

    @property
    def last(self) -> Stage:
        """The last stage of success."""
        return self.task.success[-1]

    def home_rad(self, side: str) -> np.ndarray:
        """The waiting pose of a follower, (n,)."""
        return self.planners[side].pose(self.homes_m[side])

    def nearest(self, point_m: np.ndarray) -> str:
        """The side whose base is nearest to a point."""
        off = {side: float(np.linalg.norm((planner.base_m - point_m)[:2])) for side, planner in self.planners.items()}
        return min(off, key=lambda side: off[side])


def sides_of(scene: Mapping[str, Any]) -> tuple[str, ...]:
    """Sides on which there is a follower."""
    channels = {row["channel"] for row in scene["arms"]}
    return tuple(side for side in SIDES if f"follower_{side}" in channels)


def make_planners(scene: Mapping[str, Any]) -> dict[str, ArmPlanner]:
    """Side → planner of the follower that stands there."""
    planners = {}
    for side in sides_of(scene):
        (row,) = [row for row in scene["arms"] if row["channel"] == f"follower_{side}"]
        arm = load_arm(row["arm"])
        names = [motor.name for motor in arm.motors]
        leads = slice(names.index(arm.folding.elbow) if arm.folding.elbow in names else 0, -1)
        planners[side] = ArmPlanner(
            build_model(row["arm"], row["gripper"], visuals=False),
            np.array(row["position_m"]),
            float(row["yaw_rad"]),
            seed_rad=arm.bent_q_rad,
            leads=leads,
        )
    return planners


def make_setup(scene: Mapping[str, Any], task: str) -> Setup:
    """The setup for a task of a scene.

    Raises:
        ConfigError: the scene has no such task, no follower, or no waiting place for one.
    """
    where = f"scene {scene['name']}"
    tasks = {row["name"]: row for row in scene["tasks"]}
    if task not in tasks and task != PICK_AND_PLACE.name:
        raise ConfigError(f"{where} has no task '{task}'; it has: {', '.join(tasks) or 'no tasks'}")
    planners = make_planners(scene)
    missing = [side for side in planners or SIDES if side not in scene["homes"] or not planners]
    if missing:
        raise ConfigError(f"{where}: task {task} needs followers, and under homes a waiting place of each: {missing}")
    things = [parse(Thing, row, f"{where}: {row['name']}") for row in (*scene["props"], *scene["furniture"])]
    return Setup(
        task=parse(Task, tasks[task], f"{where}: task {task}") if task in tasks else PICK_AND_PLACE,
        things={thing.name: thing for thing in things},
        planners=planners,
        homes_m={side: np.array(scene["homes"][side]) for side in planners},
        places_m={name: np.array(point) for name, point in scene["places"].items()},
    )
