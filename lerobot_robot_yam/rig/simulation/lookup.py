"""Channels, motors, handles, bodies and values that requests of control clients name.

Each function raises ConfigError, which names what is wrong.
"""

import math
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.bus.channel import Channel
from lerobot_robot_yam.rig.devices.simulated_handle import SimHandle
from lerobot_robot_yam.rig.devices.simulated_motor import SimMotor
from lerobot_robot_yam.rig.simulation.device import RigDevice


def channel_of(device: RigDevice, request: Mapping[str, Any]) -> Channel:
    """The channel that a request names."""
    name = request.get("channel")
    if name not in device.channels:
        raise ConfigError(f"no channel {name!r}; the scene has {', '.join(device.channels)}")
    return device.channels[name]


def handle_of(channel: Channel) -> SimHandle:
    """A leader's handle."""
    if channel.handle is None:
        raise ConfigError(f"channel {channel.name} has no teaching handle")
    return channel.handle


def motors_of(channel: Channel, which: str | int | None) -> list[SimMotor]:
    """The motor of that name or CAN id; None: all."""
    if which is None:
        return channel.motors
    found = [motor for motor in channel.motors if which in (motor.name, motor.can_id)]
    if not found:
        raise ConfigError(f"{channel.name} has no motor {which!r}; it has {[m.name for m in channel.motors]}")
    return found


def body_of(device: RigDevice, name: str) -> int:
    """Number of a body of the model."""
    index = mujoco.mj_name2id(device.world.model, mujoco.mjtObj.mjOBJ_BODY, name)
    if index < 0:
        raise ConfigError(f"no body {name!r}; bodies are named channel/body, props by their name")
    return index


def vector(value: Any, length: int) -> np.ndarray:
    """`length` finite numbers."""
    array = np.asarray(value, float)
    if array.shape != (length,) or not np.isfinite(array).all():
        raise ConfigError(f"expected {length} finite numbers, not {value!r}")
    return array


def number(value: Any, low: float = -math.inf, high: float = math.inf) -> float:
    """A finite number from `low` to `high`."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError(f"expected a finite number, not {value!r}")
    if not low <= value <= high:
        raise ConfigError(f"expected a number from {low} to {high}, not {value!r}")
    return float(value)


def flag(value: Any) -> bool:
    """True or False."""
    if not isinstance(value, bool):
        raise ConfigError(f"expected true or false, not {value!r}")
    return value


def whole(value: Any, low: int, high: int) -> int:
    """An integer from `low` to `high`."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ConfigError(f"expected a whole number from {low} to {high}, not {value!r}")
    return value
