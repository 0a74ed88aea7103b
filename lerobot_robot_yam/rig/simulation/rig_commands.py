"""The operations of control clients: one function each, which `ask(device, request)` finds by its name.

Requests and answers are JSON objects; `rig_operations.RigOperations` has a method per operation.
"""

import itertools
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import mujoco
import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.devices.simulated_motor import SimMotor
from lerobot_robot_yam.rig.scene.props import Thing
from lerobot_robot_yam.rig.simulation import fault_commands
from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.rig.simulation.grips import Softness
from lerobot_robot_yam.rig.simulation.lookup import body_of, channel_of, flag, handle_of, number, vector, whole
from lerobot_robot_yam.rig.world.outer_forces import contacts_of, tool_bodies

_EVENTS_PER_ANSWER = 200
_TRACE_LENGTH, _TRACE_PER_ANSWER = 500_000, 1000
_CHANGES_PER_ANSWER = 500
_TRUTH_PER_ANSWER = 100
_TRUTH_MAX_S = 120.0
_SEED_MAX = 2**63 - 1
_HAND_FLAGS = (("gives_way", True), ("then_release", False))
_PRESS_S = (0.005, 60.0)  # it ends at the next look of the rig, every 5 ms

Operation = Callable[[RigDevice, dict[str, Any]], dict[str, Any] | None]
_OPERATIONS: dict[str, Operation] = {"fault": fault_commands.fault, "clear_faults": fault_commands.clear_faults}


def ask(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    """Carry out a request. Raises ConfigError: it names something unknown, or a value that does not fit."""
    operation = _OPERATIONS.get(request.get("op", ""))
    if operation is None:
        raise ConfigError(f"unknown operation {request.get('op')!r}; known: {', '.join(sorted(_OPERATIONS))}")
    try:
        return operation(device, request) or {}
    except ConfigError:
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"operation {request['op']}: {type(error).__name__}: {error}") from error


def _operation(function: Operation) -> Operation:
    _OPERATIONS[function.__name__.strip("_")] = function
    return function


@_operation
def _scene(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    scene = device.scene
    shown = ("channel", "role", "arm", "gripper", "position_m", "yaw_rad")
    return {
        "name": scene.name,
        "seed": scene.options.seed,
        "arms": [{key: getattr(row, key) for key in shown} for row in scene.arms],
        "places": dict(scene.places or {}),
        "homes": dict(scene.homes or {}),
        "props": [asdict(thing) for thing in scene.props],
        "furniture": [asdict(thing) for thing in scene.furniture],
        "tasks": [asdict(task) for task in scene.tasks],
        "cameras": [camera.name for camera in scene.cameras],
    }


@_operation
def _state(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    world, brief = device.world, flag(request.get("brief", False))
    mujoco.mj_kinematics(world.model, world.data)
    arms = {}
    for name, channel in device.channels.items():
        handle, hand = channel.handle, device.hands.get(name)
        arm: dict[str, Any] = {
            "q": [world.qpos[a] for a in world.joint_addresses(name)],
            "dq": [world.qvel[a] for a in world.joint_dofs(name)],
            "opening": world.opening(name),
            "trigger": handle.trigger if handle else None,
            "buttons": list(handle.buttons) if handle else None,
            "held": hand is not None and hand.gripping,
            "resists": hand is not None and hand.resisted,
            "clients": len(channel.clients),
            "motors": {motor.name: {"enabled": motor.enabled} if brief else _motor(motor) for motor in channel.motors},
            "second_motors": {motor.name: _motor(motor.twin) for motor in channel.motors if motor.twin is not None},
        }
        for site in () if brief else ("tcp_site", "grasp_site"):
            index = mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_SITE, f"{name}/{site}")
            if index >= 0:
                arm[site] = {"pos": world.data.site_xpos[index], "mat": world.data.site_xmat[index]}
        arms[name] = arm

    def poses(things: Sequence[Thing]) -> dict[str, Any]:
        bodies = {thing.name: world.data.body(thing.name) for thing in things}
        return {name: {"pos": body.xpos, "quat": body.xquat} for name, body in bodies.items()}

    jointed = [thing.name for thing in device.scene.furniture if thing.joint is not None]
    answer = {
        "sim_s": world.sim_s,
        "monotonic_s": world.stamp_s,
        "arms": arms,
        "props": poses(device.scene.props),
        "furniture": poses(device.scene.furniture),
        "joints": {name: world.data.joint(name).qpos[0] for name in jointed},
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
        "flash_writes": motor.flash.writes,
    }


@_operation
def _place(device: RigDevice, request: dict[str, Any]) -> None:
    world, prop = device.world, request["prop"]
    if prop not in {box.name for box in device.scene.props}:
        raise ConfigError(f"no prop {prop!r}; the scene has {[box.name for box in device.scene.props]}")
    position, quat = vector(request["pos"], 3), vector(request.get("quat") or [1, 0, 0, 0], 4)
    if not np.linalg.norm(quat) > 0.0:
        raise ConfigError(f"{quat.tolist()} is not an orientation; give a quaternion w x y z that is not all zero")
    world.put(prop, position, quat)
    world.refresh()
    device.judge.moved(prop)
    device.events.add("placed", prop=prop, pos=position.tolist())


@_operation
def _task(device: RigDevice, request: dict[str, Any]) -> None:
    name, limit_s = str(request["name"]), request.get("time_limit_s")
    seed = whole(request["seed"], 0, _SEED_MAX)
    device.judge.place(name, seed, None if limit_s is None else number(limit_s, 0.0))
    device.events.add("task_placed", task=name, seed=seed)


@_operation
def _task_state(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    return device.judge.state()


@_operation
def _set_pose(device: RigDevice, request: dict[str, Any]) -> None:
    channel, q, opening = channel_of(device, request), request.get("q"), request.get("opening")
    pose = None if q is None else vector(q, len(q))
    device.world.set_pose(channel.name, pose, None if opening is None else number(opening, 0.0, 1.0))
    device.world.refresh()
    device.events.add("set_pose", channel=channel.name)


@_operation
def _push(device: RigDevice, request: dict[str, Any]) -> None:
    name, force, site = request["body"], vector(request["force"], 3), None
    seconds = number(request["seconds"], 0.0)
    if request.get("channel"):
        channel = channel_of(device, request).name
        if name == "tool":
            site = int(device.world.model.site(f"{channel}/tcp_site").id)
        name = f"{channel}/{name}"
    body = body_of(device, name) if site is None else int(device.world.model.site_bodyid[site])
    device.push(body, force, seconds, site)
    device.events.add("push", body=name, force=request["force"], seconds=seconds)


@_operation
def _forces(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    channel = channel_of(device, request).name
    contacts, tool = list(contacts_of(device.world, channel)), tool_bodies(device.world, channel)
    on_tool = [contact.force_n for contact in contacts if contact.body in tool]
    return {
        "tool_n": np.sum(on_tool, axis=0) if on_tool else np.zeros(3),
        "hand_n": device.hands[channel].force_n,
        "contacts": [contact._asdict() for contact in contacts],
    }


@_operation
def _trigger(device: RigDevice, request: dict[str, Any]) -> None:
    handle = handle_of(channel_of(device, request))
    handle.trigger, handle.trigger_rate = number(request["value"], 0.0, 1.0), 0.0


@_operation
def _buttons(device: RigDevice, request: dict[str, Any]) -> None:
    channel = channel_of(device, request)
    handle_of(channel)
    first, second = request["value"]
    device.presses.hold(channel, (flag(first), flag(second)), device.clock.now())


@_operation
def _press(device: RigDevice, request: dict[str, Any]) -> None:
    channel = channel_of(device, request)
    handle_of(channel)
    seconds = number(request["seconds"], *_PRESS_S)
    device.presses.press(channel, str(request["button"]), device.world.sim_s + seconds, device.clock.now())


@_operation
def _cut_torque(device: RigDevice, request: dict[str, Any]) -> None:
    for motor in channel_of(device, request).motors:
        motor.disable()


@_operation
def _hand(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    hand = device.hands[channel_of(device, request).name]
    if request.get("release"):
        hand.release()
        return {"sim_s": device.world.sim_s}
    asked = {name: request[name] for name in Softness._fields if request.get(name) is not None}
    softness = Softness(**asked).check() if asked else None
    gives_way, then_release = (flag(request.get(key, usual)) for key, usual in _HAND_FLAGS)
    hand.move(request["times"], request["q"], request.get("trigger", 0.0), softness, gives_way, then_release)
    return {"sim_s": device.world.sim_s}


@_operation
def _events(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    return {"events": device.events.since(int(request.get("since", 0)), _EVENTS_PER_ANSWER)}


@_operation
def _log(device: RigDevice, request: dict[str, Any]) -> None:
    device.events.add(str(request["kind"]), **request.get("details", {}))


@_operation
def _trace(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    channel = channel_of(device, request)
    if request.get("start"):
        channel.trace = deque(maxlen=_TRACE_LENGTH)
    start = int(request.get("since", 0))
    return {"frames": list(itertools.islice(channel.trace or (), start, start + _TRACE_PER_ANSWER))}


@_operation
def _watch(device: RigDevice, request: dict[str, Any]) -> dict[str, Any] | None:
    channel, watch = channel_of(device, request).name, device.watch
    if request.get("start"):
        watch.start(channel)
    elif not watch.knows(channel):
        raise ConfigError(f"{channel} is not watched; call watch_start first")
    elif request.get("stop"):
        watch.stop(channel)
    else:
        return watch.report(channel, int(request.get("since", 0)), _CHANGES_PER_ANSWER)
    return None


@_operation
def _truth(device: RigDevice, request: dict[str, Any]) -> dict[str, Any] | None:
    channel, truth = channel_of(device, request).name, device.truth
    if request.get("start"):
        truth.start(channel, number(request.get("seconds", 1.0), 0.001, _TRUTH_MAX_S))
    elif request.get("stop"):
        truth.stop(channel)
    elif not truth.knows(channel):
        raise ConfigError(f"{channel}: the truth is not recorded; call truth_start first")
    else:
        return truth.report(channel, number(request.get("after_s", 0.0)), _TRUTH_PER_ANSWER)
    return None
