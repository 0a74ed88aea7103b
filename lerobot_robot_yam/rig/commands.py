"""What a control client can ask: one function per operation, `ask(device, request)` finds it by its name.

Requests and answers are JSON objects; `control.RigControl` is the client with a method per operation.
"""

import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.channel import Channel
from lerobot_robot_yam.rig.device import RigDevice
from lerobot_robot_yam.rig.handle import SimHandle
from lerobot_robot_yam.rig.link_faults import LinkFaults
from lerobot_robot_yam.rig.motors import SimMotor

_EVENTS_PER_ANSWER = 200
_TRACE_PER_ANSWER = 1000

Operation = Callable[[RigDevice, dict[str, Any]], dict[str, Any]]
_OPERATIONS: dict[str, Operation] = {}


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


def _channel(device: RigDevice, request: dict[str, Any]) -> Channel:
    name = request.get("channel")
    if name not in device.channels:
        raise ConfigError(f"no channel {name!r}; the scene has {', '.join(device.channels)}")
    return device.channels[name]


def _handle(device: RigDevice, request: dict[str, Any]) -> SimHandle:
    channel = _channel(device, request)
    if channel.handle is None:
        raise ConfigError(f"channel {channel.name} has no teaching handle")
    return channel.handle


def _motors(channel: Channel, which: str | int | None) -> list[SimMotor]:
    """The motors named (name or CAN id), all without one."""
    if which is None:
        return channel.motors
    found = [motor for motor in channel.motors if which in (motor.name, motor.can_id)]
    if not found:
        raise ConfigError(f"{channel.name} has no motor {which!r}; it has {[m.name for m in channel.motors]}")
    return found


def _body(device: RigDevice, name: str) -> int:
    index = mujoco.mj_name2id(device.world.model, mujoco.mjtObj.mjOBJ_BODY, name)
    if index < 0:
        raise ConfigError(f"no body {name!r}; bodies are named channel/body, props by their name")
    return index


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
    places = dict(scene.places or {})
    props = [{"name": box.name, "size_m": box.size_m} for box in scene.props]
    return {"name": scene.name, "arms": arms, "places": places, "props": props}


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
            "motors": {
                motor.name: {
                    "id": motor.can_id,
                    "enabled": motor.enabled,
                    "fault": int(motor.fault),
                    "torque_nm": motor.torque_nm,
                    "motor_rad": motor.motor_angle_rad,
                }
                for motor in channel.motors
            },
        }
        for site in ("tcp_site", "grasp_site"):
            index = mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_SITE, f"{row.channel}/{site}")
            if index >= 0:
                arm[site] = {"pos": world.data.site_xpos[index], "mat": world.data.site_xmat[index]}
        arms[row.channel] = arm
    props = {
        box.name: {"pos": world.data.body(box.name).xpos, "quat": world.data.body(box.name).xquat}
        for box in device.scene.props
    }
    answer = {"sim_s": world.sim_s, "monotonic_s": world.stamp_s, "arms": arms, "props": props}
    if request.get("bodies"):
        names = [world.model.body(i).name for i in range(1, world.model.nbody)]
        answer["bodies"] = {name: world.data.body(name).xpos for name in names}
    return answer


@_operation
def _place(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    world, prop = device.world, request["prop"]
    if prop not in {box.name for box in device.scene.props}:
        raise ConfigError(f"no prop {prop!r}; the scene has {[box.name for box in device.scene.props]}")
    position, quat = _vector(request["pos"], 3), _vector(request.get("quat") or [1, 0, 0, 0], 4)
    joint = world.model.joint(prop)
    start = int(joint.qposadr[0])
    world.data.qpos[start : start + 7] = [*position, *(quat / np.linalg.norm(quat))]
    dof = int(joint.dofadr[0])
    world.data.qvel[dof : dof + 6] = 0.0
    world.refresh()
    if prop in device.judges:
        device.judges[prop].reset()
    device.events.add("placed", prop=prop, pos=position.tolist())
    return {}


@_operation
def _set_pose(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    channel, q = _channel(device, request), request.get("q")
    device.world.set_pose(channel.name, None if q is None else _vector(q, len(q)), request.get("opening"))
    device.world.refresh()
    device.events.add("set_pose", channel=channel.name)
    return {}


@_operation
def _push(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    name = request["body"]
    if request.get("channel"):
        name = f"{_channel(device, request).name}/{name}"
    device.push(_body(device, name), _vector(request["force"], 3), float(request["seconds"]))
    device.events.add("push", body=name, force=request["force"], seconds=request["seconds"])
    return {}


@_operation
def _fault(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    channel, kind, value = _channel(device, request), request["kind"], request["value"]
    if kind == "bus_off":
        channel.cut = bool(value)
    elif kind == "handle_silent":
        _handle(device, request).silent = bool(value)
    elif kind == "latency_s":
        channel.latency_s = float(value)
    else:
        for motor in _motors(channel, request.get("motor")):
            if kind == "nibble":
                motor.faults.sticky_fault = int(value) if request.get("sticky") else None
                motor.fail(int(value))
            elif kind == "register":
                motor.set_register(int(request["register"]), value)
                channel.identifiers_changed()
            else:
                motor.faults.set({kind: value})
    device.events.add("fault_set", channel=channel.name, fault=kind, motor=request.get("motor"), value=value)
    return {}


@_operation
def _clear_faults(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    channel = _channel(device, request)
    channel.cut = False
    channel.latency_s = device.scene.options.latency_s
    if channel.handle is not None:
        channel.handle.silent = False
    for motor in channel.motors:
        motor.faults = LinkFaults()
    return {}


@_operation
def _trigger(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    handle = _handle(device, request)
    handle.trigger, handle.trigger_rate = float(np.clip(request["value"], 0.0, 1.0)), 0.0
    return {}


@_operation
def _buttons(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    first, second = request["value"]
    event = _handle(device, request).press((bool(first), bool(second)))
    if event is not None:
        _channel(device, request).emit(event, time.monotonic())
    return {}


@_operation
def _cut_torque(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    for motor in _channel(device, request).motors:
        motor.disable()
    return {}


@_operation
def _hand(device: RigDevice, request: dict[str, Any]) -> dict[str, Any]:
    channel = _channel(device, request)
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
    channel = _channel(device, request)
    if request.get("start"):
        channel.start_trace()
    rows = list(channel.trace or ())
    start = int(request.get("since", 0))
    return {"frames": rows[start : start + _TRACE_PER_ANSWER]}


def _vector(value: Any, length: int) -> np.ndarray:
    vector = np.asarray(value, float)
    if vector.shape != (length,) or not np.isfinite(vector).all():
        raise ConfigError(f"expected {length} finite numbers, not {value!r}")
    return vector
