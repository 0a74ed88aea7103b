"""The kinds of faults of a rig: what each does to a channel or to a motor. `FaultOperations.fault` describes them."""

import math
from collections.abc import Callable
from typing import Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.bus.adapter import HoldBack
from lerobot_robot_yam.rig.bus.channel import PAYLOADS, Channel, ForeignDriver
from lerobot_robot_yam.rig.devices.flash import WAYS
from lerobot_robot_yam.rig.devices.motor_faults import FalseReading
from lerobot_robot_yam.rig.devices.simulated_handle import SimEncoders, SimHandle
from lerobot_robot_yam.rig.devices.simulated_motor import SimMotor
from lerobot_robot_yam.rig.devices.thermometer import Ramp
from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.rig.simulation.operation import flag, number, vector, whole

_Details = dict[str, Any]
_ID_MAX = 0x7FF
_NIBBLE_MAX = 0xF
_COUNT_MAX = 1_000_000
_DELAY_MAX_S = 10.0
_EVERY_MAX_S = 1000.0
_MASS_MAX_KG = 50.0
_RATE_MAX_HZ = 5000.0  # one wire carries less than 8000 frames a second
_TORQUE_MAX_NM = 100.0
_BYTE_MAX = 255.0
_TEMPERATURE_MAX_C = 1000.0


def _handle_of(channel: Channel) -> SimHandle:
    if channel.handle is None:
        raise ConfigError("the channel has no teaching handle")
    return channel.handle


def _foreign(device: RigDevice, channel: Channel, value: Any) -> None:
    if value is False:
        channel.foreign = None
        return
    fields = _fields(value, ("id", "rate_hz"), ("payload",))
    payload = fields.get("payload", "hold")
    if payload not in PAYLOADS:
        raise ConfigError(f"payload must be one of {PAYLOADS}, not {payload!r}")
    rate_hz = number(fields["rate_hz"], 0.01, _RATE_MAX_HZ)
    channel.foreign = ForeignDriver(whole(fields["id"], 0, _ID_MAX), rate_hz, payload, device.clock.now())


def _hold_back(device: RigDevice, channel: Channel, value: Any) -> None:
    if value is False:
        channel.adapter.hold = None
        return
    fields = _fields(value, ("seconds",), ("every_s",))
    seconds = number(fields["seconds"], 0.0, _DELAY_MAX_S)
    every_s = number(fields["every_s"], seconds, _EVERY_MAX_S) if "every_s" in fields else math.inf
    channel.adapter.hold = HoldBack(device.clock.now(), seconds, every_s)


def _second_arm(_: RigDevice, channel: Channel, value: Any) -> None:
    if value is False:
        for motor in channel.motors:
            motor.twin = None
        return
    fields = {} if value is True else _fields(value, ("q_rad",), ())
    angles = vector(fields["q_rad"], len(channel.motors)).tolist() if fields else [None] * len(channel.motors)
    for motor, angle in zip(channel.motors, angles, strict=True):
        motor.plug_in_twin(angle)


def _encoders_silent(device: RigDevice, channel: Channel, value: Any) -> None:
    encoders = _handle_of(channel)
    if not isinstance(encoders, SimEncoders):
        raise ConfigError("the arm has motors, and no encoders of a passive leader")
    devices = range(len(encoders.joints) + 1)
    silent = (devices if value else []) if isinstance(value, bool) else value
    encoders.silent_devices = frozenset(whole(one, 0, devices[-1]) for one in silent)


CHANNEL_KINDS: dict[str, Callable[[RigDevice, Channel, Any], None]] = {
    "link_down": lambda device, channel, value: channel.set_link(device.clock.now(), down=flag(value)),
    "adapter_gone": lambda device, channel, value: channel.set_link(device.clock.now(), gone=flag(value)),
    "bus_off": lambda device, channel, value: channel.set_link(device.clock.now(), bus_off=flag(value)),
    "cable_out": lambda device, channel, value: setattr(channel, "cable_out", flag(value)),
    "foreign": _foreign,
    "latency_s": lambda device, channel, value: setattr(channel.adapter, "latency_s", number(value, 0.0, _DELAY_MAX_S)),
    "hold_back": _hold_back,
    "second_arm": _second_arm,
    "payload_kg": lambda device, channel, value: device.ballast[channel.name].carry(number(value, 0.0, _MASS_MAX_KG)),
    "encoders_silent": _encoders_silent,
    "handle_silent": lambda device, channel, value: setattr(_handle_of(channel), "silent", flag(value)),
}


def _link_fault(name: str, check: Callable[[Any], Any]) -> Callable[[SimMotor, Any, _Details], None]:
    """A kind that sets the field of that name of `LinkFaults`."""
    return lambda motor, value, details: setattr(motor.faults, name, check(value))


def _share(value: Any) -> float:
    return number(value, 0.0, 1.0)


def _duplicate(motor: SimMotor, value: Any, details: _Details) -> None:
    if value is False:
        motor.twin = None
        return
    motor.plug_in_twin(None if value is True else number(_fields(value, ("q_rad",), ())["q_rad"]))


def _corrupt_rate(motor: SimMotor, value: Any, details: _Details) -> None:
    motor.faults.corrupt_rate = _share(value)
    motor.faults.corrupt_all = flag(details.get("all_bytes", False))


def _reading(motor: SimMotor, value: Any, details: _Details) -> None:
    if value is False:
        motor.reading = None
        return
    fields = _fields(value, (), ("position_rad", "velocity_rad_s", "torque_nm", "answers", "freeze"))
    offsets = {key: number(fields[key]) for key in ("position_rad", "velocity_rad_s", "torque_nm") if key in fields}
    answers = whole(fields["answers"], 0, _COUNT_MAX) if "answers" in fields else None
    motor.reading = FalseReading(**offsets, answers=answers, freeze=flag(fields.get("freeze", False)))


def _temperatures(motor: SimMotor, value: Any, details: _Details) -> None:
    held = None if value is False else vector(value, 2).clip(0.0, _BYTE_MAX).tolist()
    motor.thermometer.held = held and (held[0], held[1])


def _temperature_ramp(motor: SimMotor, value: Any, details: _Details) -> None:
    if value is False:
        motor.thermometer.ramp = None
        return
    fields = _fields(value, ("rate_c_per_s", "from_c"), ())
    rate = number(fields["rate_c_per_s"], -_TEMPERATURE_MAX_C, _TEMPERATURE_MAX_C)
    from_c = number(fields["from_c"], 0.0, _TEMPERATURE_MAX_C)
    motor.thermometer.ramp = Ramp(rate, from_c, motor.world.sim_s)


def _storing(motor: SimMotor, value: Any, details: _Details) -> None:
    way = value or "all"
    if way not in WAYS:
        raise ConfigError(f"a motor stores in one of the ways {WAYS}, not {way!r}")
    motor.flash.way = way


def _nibble(motor: SimMotor, value: Any, details: _Details) -> None:
    code = whole(value, 0, _NIBBLE_MAX)
    motor.sticky_fault = flag(details.get("sticky", False))
    motor.fail(code)


MOTOR_KINDS: dict[str, Callable[[SimMotor, Any, _Details], None]] = {
    "silent": _link_fault("silent", flag),
    "power": lambda motor, value, details: motor.power(flag(value)),
    "storing": _storing,
    "drop_next": _link_fault("drop_next", lambda value: whole(value, 0, _COUNT_MAX)),
    "loss_rate": _link_fault("loss_rate", _share),
    "command_loss_rate": _link_fault("command_loss_rate", _share),
    "delay_s": _link_fault("delay_s", lambda value: number(value, 0.0, _DELAY_MAX_S)),
    "duplicate": _duplicate,
    "wrong_id": _link_fault("wrong_id", lambda value: None if value is False else whole(value, 0, _ID_MAX)),
    "corrupt_rate": _corrupt_rate,
    "reading": _reading,
    "temperatures_c": _temperatures,
    "temperature_ramp": _temperature_ramp,
    "torque_bias_nm": lambda motor, value, details: motor.set_bias(number(value, -_TORQUE_MAX_NM, _TORQUE_MAX_NM)),
    "stuck": lambda motor, value, details: motor.drive.jam(flag(value)),
    "friction_nm": lambda motor, value, details: motor.drive.rub(number(value, 0.0, _TORQUE_MAX_NM)),
    "nibble": _nibble,
    "register": lambda motor, value, details: motor.set_register(whole(details["register"], 0, _ID_MAX), number(value)),
}

KINDS = (*MOTOR_KINDS, *CHANNEL_KINDS)


def _fields(value: Any, needed: tuple[str, ...], optional: tuple[str, ...]) -> dict[str, Any]:
    """A mapping with these keys."""
    if not isinstance(value, dict) or set(needed) - set(value) or set(value) - {*needed, *optional}:
        parts = [f"{{{', '.join(needed)}}}"] * bool(needed) + [f"maybe {', '.join(optional)}"] * bool(optional)
        raise ConfigError(f"expected {' and '.join(parts)}, or false, not {value!r}")
    return value
