"""The rig's judge: it lays a task's things out by a seed, and judges the attempt by the true world alone."""

import math
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.scene.tasks import Task
from lerobot_robot_yam.rig.simulation.task_judge import TaskJudge, View
from lerobot_robot_yam.rig.world.world import World
from lerobot_robot_yam.rig.world.world_model import yaw_quat

Touches = Mapping[str, frozenset[str]]
"""Prop → what touches it."""


class Contacts:
    """Touches of the scene's props, as of the last step."""

    def __init__(self, world: World):
        model = world.model
        self._data = world.data
        self._props = {model.body(thing.name).id: thing.name for thing in world.scene.props}
        self._bodies: np.ndarray = model.geom_bodyid
        self._names = [model.body(body).name for body in range(model.nbody)]
        owners = {body: name.partition("/")[0] for body, name in enumerate(self._names)}
        self._arms = {body: owner for body, owner in owners.items() if owner in world.profiles}
        self._fingers: dict[int, int] = {}  # body → number of the finger
        for channel, (_, gripper) in world.profiles.items():
            for number, name in enumerate(gripper.finger_joints):
                self._fingers[int(model.joint(f"{channel}/{name}").bodyid[0])] = number

    def look(self) -> tuple[Touches, Touches]:
        """For each prop the channels, things and "world" that touch it, and the channels whose two fingers both do."""
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
        """(prop, other body) of every contact of a prop."""
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
        """Begin an attempt: every thing where `seed` has it, at rest. The arms stay as they are.

        `time_limit_s`: in place of the task's own, if not None.

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
        world.data.qacc_warmstart[:] = 0.0  # the past leaves no trace
        mujoco.mj_forward(world.model, world.data)
        world.refresh()
        self._task, self._seed, self._begin_s = task, seed, world.sim_s
        world.look_seed = seed
        self._attempt = TaskJudge(task, self._arms, self._view(), time_limit_s)

    def update(self) -> list[dict[str, Any]]:
        """Look at the world; return what was decided: the events of `TaskJudge.update`, with the seed."""
        if self._attempt is None or self._attempt.decided:
            return []
        self._decided_s = self._world.sim_s
        return [{**event, "seed": self._seed} for event in self._attempt.update(self._view())]

    def state(self) -> dict[str, Any]:
        """How the attempt stands, see `RigOperations.task_state`."""
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
