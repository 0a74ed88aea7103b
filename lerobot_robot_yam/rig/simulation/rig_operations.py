"""All operations of a rig in another process or in lock-step.

Times are simulated seconds unless a key says `monotonic_s`; lengths are in m, angles in rad, forces in N.
"""

import functools
import inspect
import itertools
import runpy
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import mujoco
import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.devices.simulated_motor import SimMotor
from lerobot_robot_yam.rig.scene.props import Thing
from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.rig.simulation.fault_operations import FaultOperations
from lerobot_robot_yam.rig.simulation.hand_operations import HandOperations
from lerobot_robot_yam.rig.simulation.operation import REGISTERED, checked, number, operation, vector
from lerobot_robot_yam.rig.world.outer_forces import contacts_of, tool_bodies

_EVENTS_PER_ANSWER = 200
_TRACE_LENGTH, _TRACE_PER_ANSWER = 500_000, 1000
_PLACEMENT = ("channel", "role", "arm", "gripper", "position_m", "yaw_rad")


class RigOperations(HandOperations, FaultOperations):
    """All operations. Each raises ConfigError if the rig rejects the request: unknown name, or invalid value."""

    name: str

    @operation
    def scene(self) -> dict[str, Any]:
        """Describe the scene with the fields of scene files.

        Returns:
            name, seed, arms with their placement, base (its channel, or None),
            places, homes, stands, props, furniture, tasks; names of the cameras.
        """
        scene = self.device.scene
        return {
            "name": scene.name,
            "seed": scene.options.seed,
            "arms": [{key: getattr(row, key) for key in _PLACEMENT} for row in scene.arms],
            "base": scene.base and scene.base.channel,
            "places": dict(scene.places or {}),
            "homes": dict(scene.homes or {}),
            "stands": dict(scene.stands or {}),
            "props": [asdict(thing) for thing in scene.props],
            "furniture": [asdict(thing) for thing in scene.furniture],
            "tasks": [asdict(task) for task in scene.tasks],
            "cameras": [camera.name for camera in scene.cameras],
        }

    @operation
    def state(self, bodies: bool = False, brief: bool = False) -> dict[str, Any]:
        """Read the true state of the world; `brief` is faster and omits sites and all motor keys except `enabled`.

        Returns:
            sim_s, monotonic_s; arms[channel]: q and dq (n,), opening 0 … 1 or None, trigger, buttons, held,
            resists (whether the hand released an arm that worked against it), clients,
            motors[name]: {id, enabled, fault, torque_nm, motor_rad, flash_writes},
            second_motors (fault "second_arm") likewise, tcp_site and grasp_site: {pos (3,), mat (9,)};
            base, if there is one: pose (x, y, m, and heading, rad), mount {pos, quat}, motors likewise, and with a rail
            rail: height, m, upper and lower (what the switches read), brake_on (its output);
            props[name] and furniture[name]: {pos, quat};
            joints[name], of furniture: m or rad; with `bodies`, bodies[name]: position (3,).
        """
        world, scene = self.device.world, self.device.scene
        mujoco.mj_kinematics(world.model, world.data)

        def poses(things: Sequence[Thing]) -> dict[str, Any]:
            found = {thing.name: world.data.body(thing.name) for thing in things}
            return {name: {"pos": body.xpos, "quat": body.xquat} for name, body in found.items()}

        jointed = [thing.name for thing in scene.furniture if thing.joint is not None]
        return {
            "sim_s": world.sim_s,
            "monotonic_s": world.stamp_s,
            "arms": {name: self._arm(name, brief) for name in self.device.hands},
            **({} if scene.base is None else {"base": self._base(scene.base.channel)}),
            "props": poses(scene.props),
            "furniture": poses(scene.furniture),
            "joints": {name: world.data.joint(name).qpos[0] for name in jointed},
            **({"bodies": world.bodies()} if bodies else {}),
        }

    def _base(self, name: str) -> dict[str, Any]:
        motors = {motor.name: _motor(motor) for motor in self.device.channels[name].motors}
        board, rail = self.device.board, {}
        if board is not None:
            upper, lower = board.switches()
            rail = {"rail": {"height": board.height_m, "upper": upper, "lower": lower, "brake_on": board.brake_on}}
        mount = self.device.world.data.body(f"{name}/mount")
        where = {"pose": self.device.world.base_pose(), "mount": {"pos": mount.xpos, "quat": mount.xquat}}
        return {**where, "motors": motors, **rail}

    def _arm(self, name: str, brief: bool) -> dict[str, Any]:
        world, channel, hand = self.device.world, self.device.channels[name], self.device.hands[name]
        handle, motors = channel.handle, channel.motors
        arm: dict[str, Any] = {
            "q": [world.qpos[a] for a in world.joint_addresses(name)],
            "dq": [world.qvel[a] for a in world.joint_dofs(name)],
            "opening": world.opening(name),
            "trigger": handle.trigger if handle else None,
            "buttons": list(handle.buttons) if handle else None,
            "held": hand.gripping,
            "resists": hand.resisted,
            "clients": len(channel.clients),
            "motors": {motor.name: {"enabled": motor.enabled} if brief else _motor(motor) for motor in motors},
            "second_motors": {motor.name: _motor(motor.twin) for motor in motors if motor.twin is not None},
        }
        for site in () if brief else ("tcp_site", "grasp_site"):
            index = mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_SITE, f"{name}/{site}")
            if index >= 0:
                arm[site] = {"pos": world.data.site_xpos[index], "mat": world.data.site_xmat[index]}
        return arm

    @operation
    def forces(self, channel: str) -> dict[str, Any]:
        """Read the external forces on an arm, except pushes, each (3,), N, in world axes.

        Returns:
            tool_n: sum of all contact forces on the tool from things other than the arm; hand_n: force of a soft hand;
            contacts: body, other, point_m, force_n of each contact between the arm and other things.
        """
        world, name = self.device.world, self._channel_of(channel).name
        contacts, tool = list(contacts_of(world, name)), tool_bodies(world, name)
        on_tool = [contact.force_n for contact in contacts if contact.body in tool]
        return {
            "tool_n": np.sum(on_tool, axis=0) if on_tool else np.zeros(3),
            "hand_n": self.device.hands[name].force_n,
            "contacts": [contact._asdict() for contact in contacts],
        }

    # tasks

    @operation
    def task(self, name: str, seed: int, time_limit_s: float | None = None) -> None:
        """Begin an attempt at a task of the scene: place all things by the seed, at rest. The arms stay.

        time_limit_s: replaces the task's time limit, if not None.
        """
        self.device.judge.place(name, seed, None if time_limit_s is None else number(time_limit_s, 0.0))
        self.device.events.add("task_placed", task=name, seed=seed)

    @operation
    def task_state(self) -> dict[str, Any]:
        """Read the progress of the current attempt.

        Returns:
            task (None before the first attempt), seed, success, failed, reason (of the failure), since_s (simulated
            time from placing to the verdict, or to now), stage (number of stages reached), stages (of the task).
        """
        return self.device.judge.state()

    # events and frames

    def events(self, since: int = 0) -> list[dict[str, Any]]:
        """Read all events from number `since` on, each with number, sim_s, monotonic_s, kind and details.

        An event motor_disabled has channel, motor, and the positions of the arm's bodies at that time, as in `state`.
        """
        found: list[dict[str, Any]] = []
        while chunk := self.some_events(since)["events"]:
            found += chunk
            since = chunk[-1]["number"] + 1
        return found

    @operation
    def some_events(self, since: int) -> dict[str, Any]:
        """Read at most 200 events from number `since` on, under the key events."""
        return {"events": self.device.events.since(since, _EVENTS_PER_ANSWER)}

    @operation
    def log(self, kind: str, **details: Any) -> None:
        """Add an event to the rig's log."""
        self.device.events.add(kind, **details)

    @operation
    def trace_start(self, channel: str) -> None:
        """Start recording each frame that clients send to the channel."""
        self._channel_of(channel).trace = deque(maxlen=_TRACE_LENGTH)

    def trace(self, channel: str) -> list[tuple[float, float, int, int]]:
        """Read (sent, arrived, identifier, first data byte) of each frame since `trace_start`; times monotonic, s."""
        found: list[tuple[float, float, int, int]] = []
        while chunk := self.some_frames(channel, len(found))["frames"]:
            found += [(sent, arrived, ident, first) for sent, arrived, ident, first in chunk]
        return found

    @operation
    def some_frames(self, channel: str, since: int) -> dict[str, Any]:
        """Read at most 1000 rows of `trace` from number `since` on, under the key frames."""
        trace = self._channel_of(channel).trace or ()
        return {"frames": list(itertools.islice(trace, since, since + _TRACE_PER_ANSWER))}

    # changes

    @operation
    def place(self, prop: str, pos: Sequence[float], quat: Sequence[float] = (1.0, 0.0, 0.0, 0.0)) -> None:
        """Put a prop at pos (3,) with orientation quat (4,), w x y z, at rest."""
        world, props = self.device.world, [thing.name for thing in self.device.scene.props]
        if prop not in props:
            raise ConfigError(f"no prop {prop!r}; the scene has {props}")
        position, turn = vector(pos, 3), vector(quat, 4)
        if not np.linalg.norm(turn) > 0.0:
            raise ConfigError(f"{turn.tolist()} is not an orientation; give a quaternion w x y z that is not all zero")
        world.put(prop, position, turn)
        world.refresh()
        self.device.events.add("placed", prop=prop, pos=position.tolist())

    @operation
    def set_pose(
        self,
        channel: str,
        q: Sequence[float] | None = None,
        opening: float | None = None,
        dq: Sequence[float] | None = None,
    ) -> None:
        """Set an arm's joints q (n,), moving at dq (n,) or at rest, and its gripper's opening, 0 … 1, instantly."""
        pose = None if q is None else vector(q, len(q))
        self.device.world.set_pose(
            self._channel_of(channel).name,
            pose,
            None if opening is None else number(opening, 0.0, 1.0),
            0.0 if dq is None or q is None else vector(dq, len(q)),
        )
        self.device.world.refresh()
        self.device.events.add("set_pose", channel=channel)

    @operation
    def push(self, channel: str, body: str, force: Sequence[float], seconds: float) -> None:
        """Push a body of an arm with a force (3,), N, in world axes: "tool" at its frame, "link4" at its centre."""
        model, name, site = self.device.world.model, f"{self._channel_of(channel).name}/{body}", None
        if body == "tool":
            site = int(model.site(f"{channel}/tcp_site").id)
            index = int(model.site_bodyid[site])
        else:
            index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
            if index < 0:
                raise ConfigError(f"no body {name!r}; bodies are named tool, base, link1 and so on")
        self.device.push(index, vector(force, 3), number(seconds, 0.0), site)
        self.device.events.add("push", body=name, force=force, seconds=seconds)

    @operation
    def cut_torque(self, channel: str) -> None:
        """Disable all motors of the arm immediately, like an emergency stop of the motor supply."""
        for motor in self._channel_of(channel).motors:
            motor.disable()

    @operation
    def load(self, path: str) -> None:
        """Run a Python file in the rig's process, once, and call its `install(device)`, for user-defined measurements.

        `device` is the rig's `RigDevice`. `install` may add entries to the device's `operations`, `each_step` and
        `each_advance`.
        """
        if path not in self.device.loaded:
            self.device.loaded.add(path)
            runpy.run_path(path)["install"](self.device)


def perform(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    """Execute a request: {"op": name, and the arguments of the operation}.

    Raises:
        ConfigError: a name is unknown, or a value is invalid.
    """
    name, given = request.get("op", ""), {key: value for key, value in request.items() if key != "op"}
    known: dict[str, Callable[..., Any]] = REGISTERED | device.operations
    if name not in known:
        raise ConfigError(f"unknown operation {name!r}; known: {', '.join(sorted(known))}")
    act = known[name] if name in device.operations else functools.partial(REGISTERED[name], _OnDevice(device))
    try:
        return act(**checked(inspect.signature(act), given)) or {}
    except ConfigError:
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"operation {name}: {type(error).__name__}: {error}") from error


class _OnDevice(RigOperations):
    """Operations in the rig's own process."""

    def __init__(self, device: RigDevice):
        self.device = device

    def request(self, op: str, **arguments: Any) -> dict[str, Any]:
        return perform(self.device, {"op": op, **arguments})


def _motor(motor: SimMotor) -> dict[str, Any]:
    return {
        "id": motor.can_id,
        "enabled": motor.enabled,
        "fault": int(motor.fault),
        "torque_nm": motor.torque_nm,
        "motor_rad": motor.motor_angle_rad,
        "flash_writes": motor.flash.writes,
    }
