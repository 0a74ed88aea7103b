"""Judge of the rig: lays out a task's things by a seed, and judges the attempt from the true world state alone."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.scene.tasks import Region, Stage, Task
from lerobot_robot_yam.rig.world.world import World
from lerobot_robot_yam.rig.world.world_model import yaw_quat

REST_SPEED_M_S = 0.01
FALL_M = -0.05  # height below which a prop counts as fallen off the table


@dataclass(frozen=True)
class View:
    """State of the world at one instant.

    Attributes:
        sim_s: simulated time.
        frames: thing → origin (3,) and rotation (3, 3) of the thing's frame, in the world.
        speeds: prop → speed of its centre of mass, m/s.
        joints: jointed thing → position, m or rad.
        touching: prop → channels of arms and names of things that touch the prop.
        held: prop → channels of arms with both fingers in contact with the prop.
    """

    sim_s: float
    frames: Mapping[str, tuple[np.ndarray, np.ndarray]]
    speeds: Mapping[str, float]
    joints: Mapping[str, float]
    touching: Mapping[str, frozenset[str]]
    held: Mapping[str, frozenset[str]]


class TaskJudge:
    """Judge of one attempt at a task, stage by stage. Does no I/O: `Judge` supplies the views.

    arms: channels of the arms. begin: the world at the start. time_limit_s: replaces the task's limit, if not None.

    Attributes:
        stage: number of stages reached so far.
        success, failed: the verdict, which is final.
        reason: reason for a failure.
    """

    def __init__(self, task: Task, arms: frozenset[str], begin: View, time_limit_s: float | None = None):
        self._task, self._arms = task, arms
        self._time_limit_s = task.time_limit_s if time_limit_s is None else time_limit_s
        self._begin_s = begin.sim_s
        self._heights = {name: float(begin.frames[name][0][2]) for name in begin.speeds}
        self._met_since_s: float | None = None
        self.stage = 0
        self.success = self.failed = False
        self.reason = ""

    @property
    def decided(self) -> bool:
        return self.success or self.failed

    def update(self, view: View) -> list[dict[str, Any]]:
        """Judge the world at one instant; return the decisions as events.

        The `kind` of an event is "task_stage" (with `stage`, the number reached, 0 after a setback), "task_success" or
        "task_failed" (with `reason`). Each event has `task` and `since_s`, the simulated time since the start.
        """
        if self.decided:
            return []
        since_s = view.sim_s - self._begin_s
        if fallen := [name for name in self._heights if view.frames[name][0][2] < FALL_M]:
            return [self._fail(f"the {fallen[0]} fell off the table", since_s)]
        if since_s > self._time_limit_s:
            text = f"the time limit of {self._time_limit_s:g} s has passed"
            return [self._fail(f"{text}; {self.stage} of {len(self._task.success)} stages were reached", since_s)]
        stage = self._task.success[self.stage]
        if stage.airborne and view.touching[stage.prop] - self._arms:
            before, self.stage, self._met_since_s = self.stage, 0, None
            return [self._event("task_stage", since_s, stage=0)] if before else []
        if not self._is_met(stage, view):
            self._met_since_s = None
            return []
        self._met_since_s = view.sim_s if self._met_since_s is None else self._met_since_s
        if view.sim_s - self._met_since_s < stage.for_s:
            return []
        self.stage, self._met_since_s = self.stage + 1, None
        self.success = self.stage == len(self._task.success)
        events = [self._event("task_stage", since_s, stage=self.stage)]
        return events + ([self._event("task_success", since_s)] if self.success else [])

    def _fail(self, reason: str, since_s: float) -> dict[str, Any]:
        self.failed, self.reason = True, reason
        return self._event("task_failed", since_s, reason=reason)

    def _event(self, kind: str, since_s: float, **details: Any) -> dict[str, Any]:
        return {"kind": kind, "task": self._task.name, "since_s": round(since_s, 4), **details}

    def _is_met(self, stage: Stage, view: View) -> bool:
        if stage.joint_range is not None:
            low, high = stage.joint_range
            if not low <= view.joints[stage.joint] <= high:
                return False
        prop = stage.prop
        if not prop:
            return True
        origin = view.frames[prop][0]
        return not (
            (stage.lifted_m is not None and origin[2] - self._heights[prop] < stage.lifted_m)
            or (stage.inside is not None and not _contains(stage.inside, origin, view))
            or (stage.held_by and stage.held_by not in view.held[prop])
            or (stage.released and view.touching[prop] & self._arms)
            or (stage.still and view.speeds[prop] > REST_SPEED_M_S)
        )


def _contains(region: Region, point: np.ndarray, view: View) -> bool:
    if region.frame:
        origin, rotation = view.frames[region.frame]
        point = rotation.T @ (point - origin)
    off = point - region.center_m
    return bool(np.hypot(*off[:2]) <= region.radius_m and abs(off[2]) <= region.height_m)


Touches = Mapping[str, frozenset[str]]
"""Prop → names of the arms or things in contact."""


class Contacts:
    """Contacts of the scene's props in the last step."""

    def __init__(self, world: World):
        model = world.model
        self._data = world.data
        self._props = {model.body(thing.name).id: thing.name for thing in world.scene.props}
        self._bodies: np.ndarray = model.geom_bodyid
        self._names = [model.body(body).name for body in range(model.nbody)]
        owners = {body: name.partition("/")[0] for body, name in enumerate(self._names)}
        self._arms = {body: owner for body, owner in owners.items() if owner in world.profiles}
        self._fingers: dict[int, int] = {}  # body → index of the finger
        for channel, (_, gripper) in world.profiles.items():
            for number, name in enumerate(gripper.finger_joints):
                self._fingers[int(model.joint(f"{channel}/{name}").bodyid[0])] = number

    def look(self) -> tuple[Touches, Touches]:
        """Return prop → channels, things and "world" in contact, and prop → channels with both fingers in contact."""
        touching: dict[str, set[str]] = {name: set() for name in self._props.values()}
        fingers: dict[str, set[tuple[str, int]]] = {name: set() for name in self._props.values()}
        for body, other in self._pairs():
            prop = self._props[body]
            touching[prop].add(self._arms.get(other) or self._names[other])
            if other in self._fingers:
                fingers[prop].add((self._arms[other], self._fingers[other]))
        held = {
            prop: frozenset(channel for channel, finger in found if finger == 0 and (channel, 1) in found)
            for prop, found in fingers.items()
        }
        return {prop: frozenset(others) for prop, others in touching.items()}, held

    def _pairs(self) -> set[tuple[int, int]]:
        """Return (prop, other body) for each contact of a prop."""
        touching = self._data.contact.dist[: self._data.ncon] <= 0.0
        bodies = self._bodies[self._data.contact.geom[: self._data.ncon][touching]].tolist()
        pairs = {pair for first, second in bodies for pair in ((first, second), (second, first))}
        return {pair for pair in pairs if pair[0] in self._props}


class Judge:
    """Lays out the scene's tasks, and judges one attempt at a time."""

    def __init__(self, world: World):
        self._world, self._contacts = world, Contacts(world)
        self._tasks = {task.name: task for task in world.scene.tasks}
        self._arms = frozenset(world.profiles)
        model, props = world.model, world.scene.props
        self._bodies = {thing.name: model.body(thing.name).id for thing in world.scene.things}
        self._dofs = {thing.name: int(model.joint(thing.name).dofadr[0]) for thing in props}
        jointed = [thing.name for thing in world.scene.furniture if thing.joint is not None]
        self._joints = {name: int(model.joint(name).qposadr[0]) for name in jointed}
        self._task: Task | None = None
        self._attempt: TaskJudge | None = None
        self._seed = 0
        self._begin_s = self._decided_s = 0.0

    def place(self, task_name: str, seed: int, time_limit_s: float | None = None) -> None:
        """Begin an attempt: place each thing at the position drawn with `seed`, at rest. The arms stay.

        time_limit_s: replaces the task's limit, if not None.

        Raises:
            ConfigError: the scene has no such task.
        """
        if task_name not in self._tasks:
            raise ConfigError(f"no task {task_name!r}; the scene has {', '.join(self._tasks) or 'no tasks'}")
        task, world = self._tasks[task_name], self._world
        random = np.random.default_rng(seed)
        props = {thing.name: thing for thing in world.scene.props}
        for thing in props.values():
            world.put(thing.name, thing.center_m, yaw_quat(thing.yaw_rad))
        for name in self._joints:
            world.set_joint(name, 0.0)
        for draw in task.randomise:
            if draw.position is not None:
                world.set_joint(draw.thing, random.uniform(*draw.position))
                continue
            thing = props[draw.thing]
            usual = ((draw.x_m, thing.center_m[0]), (draw.y_m, thing.center_m[1]), (draw.yaw_rad, thing.yaw_rad))
            x, y, yaw = (value if bounds is None else random.uniform(*bounds) for bounds, value in usual)
            world.put(thing.name, np.array([x, y, thing.center_m[2]]), yaw_quat(yaw))
        world.data.qacc_warmstart[:] = 0.0  # the solver starts independently of earlier steps
        mujoco.mj_forward(world.model, world.data)
        world.refresh()
        self._task, self._seed, self._begin_s = task, seed, world.sim_s
        world.look_seed = seed
        self._attempt = TaskJudge(task, self._arms, self._view(), time_limit_s)

    def update(self) -> list[dict[str, Any]]:
        """Judge the current world; return the events of `TaskJudge.update`, with the seed."""
        if self._attempt is None or self._attempt.decided:
            return []
        self._decided_s = self._world.sim_s
        return [{**event, "seed": self._seed} for event in self._attempt.update(self._view())]

    def state(self) -> dict[str, Any]:
        """Return the progress of the current attempt, see `RigOperations.task_state`."""
        task, attempt = self._task, self._attempt
        if task is None or attempt is None:
            return {"task": None}
        return {
            "task": task.name,
            "seed": self._seed,
            "success": attempt.success,
            "failed": attempt.failed,
            "reason": attempt.reason,
            "since_s": (self._decided_s if attempt.decided else self._world.sim_s) - self._begin_s,
            "stage": attempt.stage,
            "stages": len(task.success),
        }

    def _view(self) -> View:
        world, data = self._world, self._world.data
        frames = {name: (data.xpos[i].copy(), data.xmat[i].reshape(3, 3).copy()) for name, i in self._bodies.items()}
        speeds = {name: math.hypot(*world.qvel[dof : dof + 3]) for name, dof in self._dofs.items()}
        joints = {name: world.qpos[address] for name, address in self._joints.items()}
        return View(world.sim_s, frames, speeds, joints, *self._contacts.look())
