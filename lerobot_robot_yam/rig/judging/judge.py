"""The rig's judge: it counts transfers of every prop, strews a task's things by a seed, and judges the attempt.

It looks at the true world alone, never at an operator.

In a transfer a prop leaves the table, rises by at least `LIFT_M`, and comes to rest at least `CARRY_M` away, in no
gripper. A cycle is a chain of transfers that brings it from one end place to the other.
"""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.judging.task_judge import FALL_M, REST_SPEED_M_S, TaskJudge, View
from lerobot_robot_yam.rig.scene.tasks import Task
from lerobot_robot_yam.rig.world.world import World
from lerobot_robot_yam.rig.world.world_model import yaw_quat

LIFT_M = 0.05
CARRY_M = 0.15
ENDS = ("A", "B")  # places between which a cycle runs
_AIRBORNE_M = 0.01
_REST_S = 0.2
_PLACE_RADIUS_M = 0.08
_STEP_S = 0.004  # a shorter one does not tell a speed

Point = tuple[float, ...]
Touches = Mapping[str, frozenset[str]]
"""Prop → what touches it."""


class Transfers:
    """Follows one prop.

    Args:
        prop: its name, as in the events.
        places: name → (x, y) in m; names the ends of a transfer.
    """

    def __init__(self, prop: str, places: Mapping[str, Sequence[float]]):
        self._prop = prop
        self._places = {name: (float(xy[0]), float(xy[1])) for name, xy in places.items()}
        self.reset()

    def reset(self) -> None:
        """The prop was put somewhere: what was under way does not count."""
        self._last: tuple[float, Point] | None = None
        self._rest: Point | None = None  # where it last lay still
        self._still_since: float | None = None
        self._moving: dict[str, Any] | None = None
        self._cycle: dict[str, Any] | None = None  # the start of the cycle under way
        self._fallen = False

    def update(
        self, time_s: float, wall_s: float, position_m: Sequence[float], held: Callable[[], bool]
    ) -> list[dict[str, Any]]:
        """Take the prop's centre (3,) at a simulated and a monotonic time; return the events that this completes.

        `held`: says whether an arm's fingers are closed on it; asked only where that matters.

        Events carry `kind` ("transfer", "drop", "cycle" or "fall"), `prop`, `start` and `end` as
        {"sim_s", "monotonic_s"}, and for the first three `lift_m`, `carry_m`, `from`, `to` ({"place", "xy_m"}).
        A "drop" is a prop that came down again without having been lifted and carried far enough.
        """
        position = tuple(position_m)
        if self._last is None:
            self._last = (time_s, position)
            return []
        last_s, last = self._last
        if time_s - last_s < _STEP_S:
            return []
        self._last = (time_s, position)
        now = {"sim_s": round(time_s, 4), "monotonic_s": round(wall_s, 4)}
        speed = math.dist(position, last) / (time_s - last_s)
        if position[2] < FALL_M:
            if self._fallen:
                return []
            start = self._moving["start"] if self._moving else now
            self.reset()
            self._fallen = True
            return [{"kind": "fall", "prop": self._prop, "start": start, "end": now}]
        self._fallen = False
        if speed >= REST_SPEED_M_S or (self._moving is not None and held()):
            self._still_since = None
        elif self._still_since is None:
            self._still_since = time_s
        still = self._still_since is not None and time_s - self._still_since >= _REST_S
        if self._moving is None:
            if self._rest is not None and position[2] - self._rest[2] > _AIRBORNE_M:
                # Carrying counts from where it left the table: pushing it along the table does not.
                self._moving = {"start": now, "from": (*position[:2], self._rest[2]), "lift_m": 0.0}
            elif still:
                self._rest = position
            return []
        self._moving["lift_m"] = max(self._moving["lift_m"], position[2] - self._moving["from"][2])
        if not still or position[2] - self._moving["from"][2] > _AIRBORNE_M:
            return []
        moving, self._moving, self._rest = self._moving, None, position
        return self._settled(moving, position, now)

    def _settled(self, moving: dict[str, Any], position: Point, now: dict[str, float]) -> list[dict[str, Any]]:
        good = moving["lift_m"] >= LIFT_M and math.dist(position[:2], moving["from"][:2]) >= CARRY_M
        events = [self._event("transfer" if good else "drop", moving, position, now)]
        if not good:
            self._cycle = None
            return events
        if self._place_of(moving["from"]) in ENDS:
            self._cycle = dict(moving)
        if self._cycle is not None:
            self._cycle["lift_m"] = min(self._cycle["lift_m"], moving["lift_m"])
            if {self._place_of(self._cycle["from"]), self._place_of(position)} == set(ENDS):
                events.append(self._event("cycle", self._cycle, position, now))
                self._cycle = None
        return events

    def _event(self, kind: str, moving: dict[str, Any], end: Point, now: dict[str, float]) -> dict[str, Any]:
        def where(position: Point) -> dict[str, Any]:
            return {"place": self._place_of(position), "xy_m": [round(v, 4) for v in position[:2]]}

        return {
            "kind": kind,
            "prop": self._prop,
            "lift_m": round(moving["lift_m"], 4),
            "carry_m": round(math.dist(end[:2], moving["from"][:2]), 4),
            "from": where(moving["from"]),
            "to": where(end),
            "start": moving["start"],
            "end": now,
        }

    def _place_of(self, position_m: Sequence[float]) -> str | None:
        """Name of the place where the prop lies, or None."""
        near = (name for name, xy in self._places.items() if math.dist(position_m[:2], xy) < _PLACE_RADIUS_M)
        return next(near, None)


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

    def holds(self, prop: str) -> bool:
        """Whether an arm's two fingers both touch a prop."""
        return bool(self.look()[1][prop])

    def _pairs(self) -> set[tuple[int, int]]:
        """(prop, other body) of every contact of a prop."""
        touching = self._data.contact.dist[: self._data.ncon] <= 0.0
        bodies = self._bodies[self._data.contact.geom[: self._data.ncon][touching]].tolist()
        pairs = {pair for first, second in bodies for pair in ((first, second), (second, first))}
        return {pair for pair in pairs if pair[0] in self._props}


class Judge:
    """Watches a world: at any time the transfers between the scene's places, and at most one task of the scene."""

    def __init__(self, world: World):
        self._world, self._contacts = world, Contacts(world)
        self._tasks = {task.name: task for task in world.scene.tasks}
        self._arms = frozenset(world.profiles)
        model, props = world.model, world.scene.props
        self._bodies = {thing.name: model.body(thing.name).id for thing in world.scene.things}
        self._dofs = {thing.name: int(model.joint(thing.name).dofadr[0]) for thing in props}
        jointed = [thing.name for thing in world.scene.furniture if thing.joint is not None]
        self._joints = {name: int(model.joint(name).qposadr[0]) for name in jointed}
        places = {name: point[:2].tolist() for name, point in (world.scene.places or {}).items()}
        self._transfers = {thing.name: Transfers(thing.name, places) for thing in props} if len(places) >= 2 else {}
        self._task: Task | None = None
        self._attempt: TaskJudge | None = None
        self._seed = 0
        self._begin_s = self._decided_s = 0.0

    def moved(self, prop: str) -> None:
        """A prop was put somewhere: that is no transfer."""
        if prop in self._transfers:
            self._transfers[prop].reset()

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
            self.moved(thing.name)
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

    def update(self, now_s: float) -> list[dict[str, Any]]:
        """Look at the world at a time of the clock; returns what happened and was decided.

        Events are those of `Transfers.update` and `TaskJudge.update`, the latter with the seed.
        """
        world = self._world
        events = []
        for name, transfers in self._transfers.items():
            position = world.data.xpos[self._bodies[name]].tolist()
            events += transfers.update(world.sim_s, now_s, position, functools.partial(self._contacts.holds, name))
        if self._attempt is not None and not self._attempt.decided:
            events += [{**event, "seed": self._seed} for event in self._attempt.update(self._view())]
            self._decided_s = world.sim_s
        return events

    def state(self) -> dict[str, Any]:
        """How the attempt stands, see `control.RigOperations.task_state`."""
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
