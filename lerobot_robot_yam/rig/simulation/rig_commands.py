"""What a control client can ask: one function per operation, `ask(device, request)` finds it by its name.

Requests and answers are JSON objects; `control.RigControl` is the client with a method per operation.
"""

import itertools
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import mujoco
import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.devices.simulated_motor import SimMotor
from lerobot_robot_yam.rig.simulation import fault_commands
from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.rig.simulation.lookup import body_of, channel_of, handle_of, number, vector, whole

_EVENTS_PER_ANSWER = 200
_TRACE_PER_ANSWER = 1000
_CHANGES_PER_ANSWER = 500
_TRUTH_PER_ANSWER = 100
_TRUTH_MAX_S = 120.0
_SEED_MAX = 2**63 - 1

Operation = Callable[[RigDevice, dict[str, Any]], dict[str, Any]]
_OPERATIONS: dict[str, Operation] = {"fault": fault_commands.fault, "clear_faults": fault_commands.clear_faults}


def ask(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    """Carry out a request.

    Raises:
        ConfigError: unknown operation, channel, body, motor or a value that does not fit.
    """
    operation = _OPERATIONS.get(request.get("op", ""))
    if operation is None:
        raise ConfigError(f"unknown operation {request.get('op')!r}; known: {', '.join(sorted(_OPERATIONS))}")
    try:
        return operation(device, request)
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"operation {request['op']}: {type(error).__name__}: {error}") from error


def _operation(function: Operation) -> Operation:
    _OPERATIONS[function.__name__.strip("_")] = function
    return function


@_operation
def _scene(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    scene = device.scene
    arms = [
        {
            "channel": row.channel,
            "role": row.role,
            "arm": row.arm,
            "gripper": row.gripper,
            "position_m": row.position_m,
            "yaw_rad": row.yaw_rad,
        }
        for row in scene.arms
    ]
    return {
        "name": scene.name,
        "seed": scene.options.seed,
        "arms": arms,
        "places": dict(scene.places or {}),
        "homes": dict(scene.homes or {}),
        "props": [asdict(thing) for thing in scene.props],
        "furniture": [asdict(thing) for thing in scene.furniture],
        "tasks": [asdict(task) for task in scene.tasks],
    }


@_operation
def _state(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    world = device.world
    mujoco.mj_kinematics(world.model, world.data)
    arms = {}
    for row in device.scene.arms:
        channel = device.channels[row.channel]
        arm: dict[str, Any] = {
            "q": [world.qpos[a] for a in world.joint_addresses(row.channel)],
            "dq": [world.qvel[a] for a in world.joint_dofs(row.channel)],
            "opening": world.opening(row.channel),
            "trigger": channel.handle.trigger if channel.handle else None,
            "buttons": list(channel.handle.buttons) if channel.handle else None,
            "held": row.channel in device.hands and device.hands[row.channel].gripping,
            "resists": row.channel in device.hands and device.hands[row.channel].resisted,
            "clients": len(channel.clients),
            "motors": {motor.name: _motor(motor) for motor in channel.motors},
            "second_motors": {motor.name: _motor(motor.twin) for motor in channel.motors if motor.twin is not None},
        }
        for site in ("tcp_site", "grasp_site"):
            index = mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_SITE, f"{row.channel}/{site}")
            if index >= 0:
                arm[site] = {"pos": world.data.site_xpos[index], "mat": world.data.site_xmat[index]}
        arms[row.channel] = arm
    things = {
        thing.name: {"pos": world.data.body(thing.name).xpos, "quat": world.data.body(thing.name).xquat}
        for thing in device.scene.things
    }
    answer = {
        "sim_s": world.sim_s,
        "monotonic_s": world.stamp_s,
        "arms": arms,
        "props": {thing.name: things[thing.name] for thing in device.scene.props},
        "furniture": {thing.name: things[thing.name] for thing in device.scene.furniture},
        "joints": {
            thing.name: world.data.joint(thing.name).qpos[0]
            for thing in device.scene.furniture
            if thing.joint is not None
        },
    }
    if request.get("bodies"):
        answer["bodies"] = world.bodies()
    return answer


def _motor(motor: SimMotor) -> dict[str, Any]:
    return {
        "id": motor.can_id,
        "enabled": motor.enabled,
        "fault": int(motor.fault),
        "torque_nm": motor.torque_nm,
        "motor_rad": motor.motor_angle_rad,
    }


@_operation
def _place(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    world, prop = device.world, request["prop"]
    if prop not in {box.name for box in device.scene.props}:
        raise ConfigError(f"no prop {prop!r}; the scene has {[box.name for box in device.scene.props]}")
    position, quat = vector(request["pos"], 3), vector(request.get("quat") or [1, 0, 0, 0], 4)
    if not np.linalg.norm(quat) > 0.0:
        raise ConfigError(f"{quat.tolist()} is no orientation; a quaternion is w x y z, not all zero")
    world.put(prop, position, quat)
    world.refresh()
    device.judge.moved(prop)
    device.events.add("placed", prop=prop, pos=position.tolist())
    return {}


@_operation
def _task(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    name, limit_s = str(request["name"]), request.get("time_limit_s")
    seed = whole(request["seed"], 0, _SEED_MAX)
    device.judge.place(name, seed, None if limit_s is None else number(limit_s, 0.0))
    device.events.add("task_placed", task=name, seed=seed)
    return {}


@_operation
def _task_state(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    return device.judge.state()


@_operation
def _set_pose(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    channel, q, opening = channel_of(device, request), request.get("q"), request.get("opening")
    device.world.set_pose(
        channel.name,
        None if q is None else vector(q, len(q)),
        None if opening is None else number(opening, 0.0, 1.0),
    )
    device.world.refresh()
    device.events.add("set_pose", channel=channel.name)
    return {}


@_operation
def _push(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    name = request["body"]
    if request.get("channel"):
        name = f"{channel_of(device, request).name}/{name}"
    device.push(body_of(device, name), vector(request["force"], 3), number(request["seconds"], 0.0))
    device.events.add("push", body=name, force=request["force"], seconds=request["seconds"])
    return {}


@_operation
def _trigger(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    handle = handle_of(channel_of(device, request))
    handle.trigger, handle.trigger_rate = number(request["value"], 0.0, 1.0), 0.0
    return {}


@_operation
def _buttons(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    channel = channel_of(device, request)
    first, second = request["value"]
    event = handle_of(channel).press((bool(first), bool(second)))
    if event is not None:
        channel.emit(event, device.clock.now())
    return {}


@_operation
def _cut_torque(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    for motor in channel_of(device, request).motors:
        motor.disable()
    return {}


@_operation
def _hand(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    channel = channel_of(device, request)
    if channel.name not in device.hands:
        raise ConfigError(f"{channel.name} is no leader; hands pull {list(device.hands)}")
    hand = device.hands[channel.name]
    if request.get("release"):
        hand.release()
    else:
        hand.move(request["times"], request["q"], request.get("trigger", 0.0))
    return {"sim_s": device.world.sim_s}


@_operation
def _events(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    return {"events": device.events.since(int(request.get("since", 0)), _EVENTS_PER_ANSWER)}


@_operation
def _log(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    device.events.add(str(request["kind"]), **request.get("details", {}))
    return {}


@_operation
def _trace(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    channel = channel_of(device, request)
    if request.get("start"):
        channel.start_trace()
    start = int(request.get("since", 0))
    return {"frames": list(itertools.islice(channel.trace or (), start, start + _TRACE_PER_ANSWER))}


@_operation
def _watch(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    channel, watch = channel_of(device, request).name, device.watch
    if request.get("start"):
        watch.start(channel)
        return {}
    if not watch.knows(channel):
        raise ConfigError(f"{channel} is not watched; call watch_start first")
    if request.get("stop"):
        watch.stop(channel)
        return {}
    return watch.report(channel, int(request.get("since", 0)), _CHANGES_PER_ANSWER)


@_operation
def _truth(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    channel, truth = channel_of(device, request).name, device.truth
    if request.get("start"):
        truth.start(channel, number(request.get("seconds", 1.0), 0.001, _TRUTH_MAX_S))
        return {}
    if request.get("stop"):
        truth.stop(channel)
        return {}
    if not truth.knows(channel):
        raise ConfigError(f"{channel}: the truth is not kept; call truth_start first")
    return truth.report(channel, number(request.get("after_s", 0.0)), _TRUTH_PER_ANSWER)
