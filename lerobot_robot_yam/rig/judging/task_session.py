"""The task that a rig is set: strews the world by a seed, has the attempt judged, and tells how it stands."""

import math
from typing import Any

import mujoco
import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.judging.task_judge import TaskJudge, View
from lerobot_robot_yam.rig.scene.furnish import yaw_quat
from lerobot_robot_yam.rig.scene.tasks import Task
from lerobot_robot_yam.rig.world.contacts import Contacts
from lerobot_robot_yam.rig.world.world import World


class TaskSession:
    """At most one task at a time, of those that the scene has.

    Args:
        world: the physics.
        contacts: of its props.
    """

    def __init__(self, world: World, contacts: Contacts):
        self._world, self._contacts = world, contacts
        self._tasks = {task.name: task for task in world.scene.tasks}
        self._arms = frozenset(world.profiles)
        model = world.model
        self._bodies = {thing.name: model.body(thing.name).id for thing in world.scene.things}
        self._dofs = {thing.name: int(model.joint(thing.name).dofadr[0]) for thing in world.scene.props}
        self._joints = {
            thing.name: int(model.joint(thing.name).qposadr[0])
            for thing in world.scene.furniture
            if thing.joint is not None
        }
        self._task: Task | None = None
        self._judge: TaskJudge | None = None
        self._seed = 0
        self._begin_s = self._decided_s = 0.0

    def place(self, task_name: str, seed: int, time_limit_s: float | None = None) -> None:
        """Begin an attempt: every thing where `seed` has it, at rest. The arms stay as they are.

        `time_limit_s`: in place of the task's own, if not None.

        Raises:
            ConfigError: the scene has no such task.
        """
        if task_name not in self._tasks:
            raise ConfigError(f"no task {task_name!r}; the scene has {', '.join(self._tasks) or 'none'}")
        task, world = self._tasks[task_name], self._world
        random = np.random.default_rng(seed)
        for thing in world.scene.props:
            world.put(thing.name, thing.center_m, yaw_quat(thing.yaw_rad))
        for name in self._joints:
            world.set_joint(name, 0.0)
        props = {thing.name: thing for thing in world.scene.props}
        for draw in task.randomise:
            if draw.position is not None:
                world.set_joint(draw.thing, random.uniform(*draw.position))
                continue
            thing = props[draw.thing]
            usual = ((draw.x_m, thing.center_m[0]), (draw.y_m, thing.center_m[1]), (draw.yaw_rad, thing.yaw_rad))
            x, y, yaw = (value if bounds is None else random.uniform(*bounds) for bounds, value in usual)
            world.put(thing.name, np.array([x, y, thing.center_m[2]]), yaw_quat(yaw))
        world.data.qacc_warmstart[:] = 0.0  # what was before leaves no trace
        mujoco.mj_forward(world.model, world.data)
        world.refresh()
        self._task, self._seed, self._begin_s = task, seed, world.sim_s
        self._judge = TaskJudge(task, self._arms, self._view(), time_limit_s)

    def update(self) -> list[dict[str, Any]]:
        """Look at the world; returns what was decided, as `TaskJudge.update` does, each with the seed."""
        if self._judge is None or self._judge.success or self._judge.failed:
            return []
        events = self._judge.update(self._view())
        self._decided_s = self._world.sim_s
        return [{**event, "seed": self._seed} for event in events]

    def state(self) -> dict[str, Any]:
        """How the attempt stands, see `control.RigOperations.task_state`."""
        task, judge = self._task, self._judge
        if task is None or judge is None:
            return {"task": None}
        decided = judge.success or judge.failed
        return {
            "task": task.name,
            "seed": self._seed,
            "success": judge.success,
            "failed": judge.failed,
            "reason": judge.reason,
            "since_s": (self._decided_s if decided else self._world.sim_s) - self._begin_s,
            "stage": judge.stage,
            "stages": len(task.success),
        }

    def _view(self) -> View:
        world, data = self._world, self._world.data
        touching, held = self._contacts.look()
        frames = {name: (data.xpos[i].copy(), data.xmat[i].reshape(3, 3).copy()) for name, i in self._bodies.items()}
        return View(
            sim_s=world.sim_s,
            frames=frames,
            speeds={name: math.hypot(*world.qvel[dof : dof + 3]) for name, dof in self._dofs.items()},
            joints={name: world.qpos[address] for name, address in self._joints.items()},
            touching=touching,
            held=held,
        )
