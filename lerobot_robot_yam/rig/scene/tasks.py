"""Tasks in a scene file: the initial positions of things, and the stages of success.

tasks:
  - name: lift_and_place
    description: Lift the red cube and put it on the green pad.
    time_limit_s: 15
    randomise: [{thing: cube, x_m: [0.28, 0.40], y_m: [0.27, 0.39], yaw_rad: [-3.14, 3.14]}]
    success:
      - {prop: cube, lifted_m: 0.05}
      - {prop: cube, released: true, still: true, for_s: 0.3, inside: {center_m: [0.34, 0.12, 0.025], ...}}
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.scene.props import Thing
from lerobot_robot_yam.system.strict_yaml import array_field

SCRIPTS = ("lift_and_place", "handover", "drawer", "insertion", "mobile_tables")
"""Names of the operator's scripts, see `operator.task_scripts`."""


@dataclass(frozen=True, eq=False)
class Draw:
    """Random initial state of one thing: each given value is drawn uniformly from [minimum, maximum].

    x_m, y_m, yaw_rad: for a prop, in the world. position: for a jointed thing, m or rad. Omitted values are those of
    the scene.
    """

    thing: str
    x_m: np.ndarray | None = array_field(2, default=None)
    y_m: np.ndarray | None = array_field(2, default=None)
    yaw_rad: np.ndarray | None = array_field(2, default=None)
    position: np.ndarray | None = array_field(2, default=None)


@dataclass(frozen=True, eq=False)
class Region:
    """An upright cylinder of radius `radius_m` that extends `height_m` above and below `center_m`.

    frame: thing in whose frame the cylinder is given; "" for the world. The region contains a prop if it contains the
    origin of the prop's frame.
    """

    center_m: np.ndarray = array_field(3)
    radius_m: float = 0.03
    height_m: float = 0.01
    frame: str = ""


@dataclass(frozen=True, eq=False)
class Stage:
    """A stage of success, reached when all its conditions hold together for `for_s`.

    Attributes:
        prop: prop to which the next six conditions apply.
        lifted_m: minimum height of the prop above its initial height.
        inside: region that must contain the prop.
        held_by: follower whose two fingers must touch the prop.
        released: no arm may touch the prop.
        still: the prop must be at rest.
        airborne: only arms may touch the prop after the previous stage; any other touch restarts all stages.
        joint, joint_range: jointed thing, and the range of its position.
    """

    prop: str = ""
    lifted_m: float | None = None
    inside: Region | None = None
    held_by: str = ""
    released: bool = False
    still: bool = False
    airborne: bool = False
    joint: str = ""
    joint_range: np.ndarray | None = array_field(2, default=None)
    for_s: float = 0.0


@dataclass(frozen=True, eq=False)
class Task:
    """A task; success means reaching all stages of `success` in order within `time_limit_s`.

    description: text for data sets and policies. script: script of the operator, one of `SCRIPTS`; defaults to the
    task's name. tilt_rad: backward tilt of the tools from straight down, so that cameras see what the tools hold.
    """

    name: str
    description: str
    time_limit_s: float
    success: tuple[Stage, ...]
    randomise: tuple[Draw, ...] = ()
    script: str = ""
    tilt_rad: float = 0.0

    @property
    def does(self) -> str:
        """Name of the operator's script for the task."""
        return self.script or self.name


PICK_AND_PLACE = Task(
    "pick_and_place", "Carry the prop from A to B and back, handing it over at M.", math.inf, (), tilt_rad=0.45
)
"""Endless task, without verdict, of the scripted operator; available in any scene that has these places."""


def check_tasks(tasks: Sequence[Task], things: Sequence[Thing], followers: Collection[str], where: str) -> None:
    """Raise ConfigError if a task has impossible values, or names a thing or arm that the scene lacks."""
    names = [task.name for task in tasks]
    if len(set(names)) < len(names) or not all(names):
        raise ConfigError(f"{where}: tasks need unique, non-empty names, not {names}")
    by_name = {thing.name: thing for thing in things}
    for task in tasks:
        place = f"{where}: task {task.name}"
        if task.time_limit_s <= 0.0 or not task.success:
            raise ConfigError(f"{place}: needs a time_limit_s above zero and one or more stages of success")
        if task.script and task.script not in SCRIPTS:
            raise ConfigError(f"{place}: script is one of {SCRIPTS}, not '{task.script}'")
        for draw in task.randomise:
            _check_draw(draw, by_name, f"{place}: randomise")
        for stage in task.success:
            _check_stage(stage, by_name, followers, f"{place}: success")


def _check_draw(draw: Draw, things: dict[str, Thing], where: str) -> None:
    thing = _known(draw.thing, things, where)
    pose, position = (draw.x_m, draw.y_m, draw.yaw_rad), draw.position
    given = [bounds for bounds in (*pose, position) if bounds is not None]
    if not given or any(low > high for low, high in given):
        raise ConfigError(f"{where}: {draw.thing} needs bounds, each [least, largest]")
    if thing.joint is None:
        if thing.fixed or position is not None:
            raise ConfigError(f"{where}: {draw.thing} can be given x_m, y_m and yaw_rad if it is a prop, no position")
        return
    low, high = thing.joint.range
    if position is None or len(given) > 1 or position[0] < low or position[1] > high:
        raise ConfigError(f"{where}: {draw.thing} can be given a position within its joint's range, and nothing else")


def _check_stage(stage: Stage, things: dict[str, Thing], followers: Collection[str], where: str) -> None:
    asked = (stage.lifted_m, stage.inside, stage.held_by, stage.released, stage.still, stage.airborne)
    of_prop = any(value is not None and value != "" and value is not False for value in asked)
    if of_prop != bool(stage.prop) or (stage.joint_range is not None) != bool(stage.joint):
        raise ConfigError(f"{where}: a stage names a prop and conditions on it, or a joint and its joint_range")
    if not stage.prop and not stage.joint:
        raise ConfigError(f"{where}: a stage needs a prop or a joint")
    if stage.prop and (_known(stage.prop, things, where).fixed or things[stage.prop].joint is not None):
        raise ConfigError(f"{where}: '{stage.prop}' is no prop")
    if stage.joint and _known(stage.joint, things, where).joint is None:
        raise ConfigError(f"{where}: '{stage.joint}' has no joint")
    if stage.joint_range is not None and stage.joint_range[0] > stage.joint_range[1]:
        raise ConfigError(f"{where}: joint_range is [least, largest], not {stage.joint_range}")
    if stage.held_by and stage.held_by not in followers:
        raise ConfigError(f"{where}: held_by is one of {sorted(followers)}, not '{stage.held_by}'")
    if stage.for_s < 0.0:
        raise ConfigError(f"{where}: for_s cannot be below zero")
    region = stage.inside
    if region is None:
        return
    if region.radius_m <= 0.0 or region.height_m <= 0.0:
        raise ConfigError(f"{where}: a region needs a radius_m and a height_m above zero")
    if region.frame:
        _known(region.frame, things, where)


def _known(name: str, things: dict[str, Thing], where: str) -> Thing:
    if name not in things:
        raise ConfigError(f"{where}: there is no '{name}'; the scene has {', '.join(things) or 'nothing'}")
    return things[name]
