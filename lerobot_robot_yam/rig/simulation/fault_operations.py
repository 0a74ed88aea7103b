"""Operations that make channels, motors and cameras of a rig fail; how each kind of fault starts and ends."""

import math
from collections.abc import Callable
from typing import Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.bus.adapter import HoldBack
from lerobot_robot_yam.rig.bus.channel import PAYLOADS, Channel, ForeignDriver
from lerobot_robot_yam.rig.devices.flash import WAYS
from lerobot_robot_yam.rig.devices.motor_faults import FalseReading, LinkFaults
from lerobot_robot_yam.rig.devices.rail_board import SWITCHES, SimRailBoard
from lerobot_robot_yam.rig.devices.simulated_handle import SimEncoders, SimHandle
from lerobot_robot_yam.rig.devices.simulated_motor import SimMotor
from lerobot_robot_yam.rig.devices.thermometer import Ramp
from lerobot_robot_yam.rig.simulation.device import RigDevice
from lerobot_robot_yam.rig.simulation.operation import Operations, flag, number, operation, vector, whole
from lerobot_robot_yam.rig.world.outer_forces import Ballast

_Details = dict[str, Any]
_ID_MAX = 0x7FF
_NIBBLE_MAX = 0xF
_COUNT_MAX = 1_000_000
_DELAY_MAX_S = 10.0
_EVERY_MAX_S = 1000.0
_MASS_MAX_KG = 50.0
_RATE_MAX_HZ = 5000.0  # maximum rate of a foreign driver: one wire carries fewer than 8000 frames per second
_TORQUE_MAX_NM = 100.0
_BYTE_MAX = 255.0
_TEMPERATURE_MAX_C = 1000.0


def _handle_of(channel: Channel) -> SimHandle:
    if channel.handle is None:
        raise ConfigError("the channel has no teaching handle")
    return channel.handle


def _tool_of(device: RigDevice, channel: Channel) -> Ballast:
    if channel.name not in device.ballast:
        raise ConfigError("the channel has no arm, so no tool to hang a mass on")
    return device.ballast[channel.name]


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


def _board_of(channel: Channel) -> SimRailBoard:
    if not isinstance(channel.handle, SimRailBoard):
        raise ConfigError("the channel has no board of a rail; that is base_io")
    return channel.handle


def _switches(_: RigDevice, channel: Channel, value: Any) -> None:
    fields = {} if value is False else _fields(value, (), SWITCHES)
    _board_of(channel).stuck = {name: flag(reads) for name, reads in fields.items()}


CHANNEL_KINDS: dict[str, Callable[[RigDevice, Channel, Any], None]] = {
    "link_down": lambda device, channel, value: channel.set_link(device.clock.now(), down=flag(value)),
    "adapter_gone": lambda device, channel, value: channel.set_link(device.clock.now(), gone=flag(value)),
    "bus_off": lambda device, channel, value: channel.set_link(device.clock.now(), bus_off=flag(value)),
    "cable_out": lambda device, channel, value: setattr(channel, "cable_out", flag(value)),
    "foreign": _foreign,
    "latency_s": lambda device, channel, value: setattr(channel.adapter, "latency_s", number(value, 0.0, _DELAY_MAX_S)),
    "hold_back": _hold_back,
    "second_arm": _second_arm,
    "payload_kg": lambda device, channel, value: _tool_of(device, channel).carry(number(value, 0.0, _MASS_MAX_KG)),
    "encoders_silent": _encoders_silent,
    "switches": _switches,
    "brake_slips": lambda device, channel, value: setattr(_board_of(channel), "slips", flag(value)),
    "handle_silent": lambda device, channel, value: setattr(_handle_of(channel), "silent", flag(value)),
}


def _link_fault(name: str, check: Callable[[Any], Any]) -> Callable[[SimMotor, Any, _Details], None]:
    """Return the setter for a fault kind that sets the field `name` of `LinkFaults`."""
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


_OFFSETS = ("position_rad", "velocity_rad_s", "torque_nm", "drift_rad")


def _reading(motor: SimMotor, value: Any, details: _Details) -> None:
    if value is False:
        motor.reading = None
        return
    fields = _fields(value, (), (*_OFFSETS, "scale", "answers", "freeze"))
    offsets = {key: number(fields[key]) for key in _OFFSETS if key in fields}
    answers = whole(fields["answers"], 0, _COUNT_MAX) if "answers" in fields else None
    q_scale, dq_scale = vector(fields.get("scale", (1.0, 1.0)), 2).tolist()
    freeze = flag(fields.get("freeze", False))
    motor.reading = FalseReading(**offsets, scale=(q_scale, dq_scale), answers=answers, freeze=freeze)


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


class FaultOperations(Operations):
    """Operations that inject faults into channels, motors and cameras."""

    @operation
    def fault(self, channel: str, motor: str | int | None, kind: str, value: Any = True, **details: Any) -> None:
        """Inject a fault, until `clear_faults` or until the same kind is set to False, 0 or its normal value.

        Kinds for one motor (name or CAN id) or, with None, for all motors of the channel:
            "silent" (bool): ignores all frames and sends no replies.
            "power" (bool): False cuts the power; True restores it, and the registers return to those in flash.
            "storing" ("reverts" or "cut", or False): effect of STORE: the other registers revert to the flash contents,
                or the power fails during the write.
            "drop_next" (number of replies), "loss_rate" (0 … 1): replies are lost.
            "command_loss_rate" (0 … 1): fraction of frames to the motor that are lost.
            "duplicate" (bool, or {"q_rad": rad}): a second motor has the same identifiers, see "second_arm".
            "wrong_id" (identifier, or False): replies have this identifier instead of the one in the registers.
            "corrupt_rate" (0 … 1; all_bytes=True): fraction of replies with random contents; motor number and fault
                code stay intact unless all_bytes is set.
            "reading" ({"position_rad", "velocity_rad_s", "torque_nm", "drift_rad", "scale", "answers", "freeze"}, each
                optional, or False): the next `answers` replies, by default all, are false; the motor's own servo is not
                affected. The given offsets are added (joint sign; positions wrap at the end of the frame's range);
                drift_rad is added once more with each reply. "scale" multiplies position and velocity. With "freeze":
                true all these replies repeat position, velocity and torque of the first.
            "temperatures_c" ([power stage, coil] °C, or False): false readings; the motor does not react.
            "temperature_ramp" ({"rate_c_per_s", "from_c"}, or False): the motor warms or cools from from_c. At OT_VALUE
                (power stage, 0xB) or 100 °C (coil, 0xC) it switches off, and again after CLEAR if still too hot.
            "torque_bias_nm" (Nm, joint sign): torque that the motor adds while enabled, and does not report.
            "stuck" (bool): jammed. "friction_nm" (Nm): additional dry friction.
            "nibble" (fault code; sticky=True survives CLEAR): the motor enters this fault now.
            "register" (value; register=number): overwrites a register, including read-only ones.
        Kinds for the channel, with motor None:
            "link_down" (bool): as after `ip link set canX down`: send and receive raise "Network is down".
            "adapter_gone" (bool): open buses fail permanently ("No such device"), opening a bus raises BusError.
            "bus_off" (bool): one error frame (0x40), then no frames pass, and sends raise "No buffer space available"
                after 10 frames; ended by False or by link_down.
            "cable_out" (bool): frames are lost in both directions, without an error.
            "foreign" ({"id", "rate_hz", "payload": "hold" or "zero"}, or False): another computer sends frames to
                this identifier: MIT commands to stay at the motor's position, or zero bytes. Motors obey and reply.
            "latency_s" (s): delay of commands and of replies. Timestamps are times of arrival at the host.
            "hold_back" ({"seconds", "every_s"}, or False): from now on, once or every every_s, the adapter holds
                received frames back for `seconds`, then delivers them all at once, in order, stamped with that time.
            "second_arm" (bool, or {"q_rad": rad per motor, joint sign}): another arm with the same identifiers is on
                the bus. Each of its motors receives all frames and replies after the first arm's motor, with separate
                registers, fault code and bare shaft. The second arm is limp until enabled. Without q_rad each shaft is
                0.3 rad from the arm's pose at the rig's start. `state` lists its motors as second_motors.
            "payload_kg" (kg): point mass at the tool.
            "handle_silent" (bool): the teaching handle, or the board of a rail, sends nothing.
            "switches" ({"upper", "lower"}, each optional, or False): on base_io, what a rail's switch reads, whatever
                is true: True as when stuck or unplugged, False as when broken.
            "brake_slips" (bool): on base_io, the rail's brake does not grip.
            "encoders_silent" (bool, or device numbers from 0): encoders of a leader without motors send nothing.
        """
        device, where = self.device, self._channel_of(channel)
        try:
            if kind in CHANNEL_KINDS:
                if motor is not None:
                    raise ConfigError(f"it concerns the whole channel: give motor None, not {motor!r}")
                CHANNEL_KINDS[kind](device, where, value)
            elif kind in MOTOR_KINDS:
                for one in _motors_of(where, motor):
                    MOTOR_KINDS[kind](one, value, details)
                where.identifiers_changed()
            else:
                raise ConfigError(f"no fault kind {kind!r}; known: {', '.join(KINDS)}")
        except ConfigError as error:
            raise ConfigError(f"fault {kind!r} on {channel}: {error}") from error
        device.events.add("fault_set", channel=channel, fault=kind, motor=motor, value=value)

    @operation
    def clear_faults(self, channel: str) -> None:
        """Undo all faults of the channel, except overwritten registers and latched fault codes."""
        device, where = self.device, self._channel_of(channel)
        where.set_link(device.clock.now(), bus_off=False, down=False, gone=False)
        where.cable_out = False
        where.foreign = None
        where.adapter.latency_s, where.adapter.hold = device.scene.options.latency_s, None
        if channel in device.ballast:
            device.ballast[channel].carry(0.0)
        if isinstance(where.handle, SimRailBoard):
            where.handle.stuck, where.handle.slips = {}, False
        if where.handle is not None:
            where.handle.silent = False
            if isinstance(where.handle, SimEncoders):
                where.handle.silent_devices = frozenset()
        for motor in where.motors:
            _repair(motor)
        where.identifiers_changed()
        device.events.add("faults_cleared", channel=channel)

    def camera_fault(self, camera: str, kind: str | None, seconds: float | None = None) -> None:
        """Make a camera of the scene fail for all clients of a live rig.

        "stall": no new frames, for `seconds` or until None. "dead": the camera's clients receive an error, and the
        camera cannot be opened. None ends both; clients of a dead camera must connect again.
        """
        self.request("camera_fault", camera=camera, kind=kind, seconds=seconds)


def _repair(motor: SimMotor) -> None:
    """Undo all faults of a motor, except overwritten registers and a latched fault code."""
    if motor.unpowered:
        motor.power(True)
    motor.faults = LinkFaults()
    motor.flash.way = "all"
    motor.reading = motor.twin = None
    motor.sticky_fault = False
    motor.thermometer.held = motor.thermometer.ramp = None
    motor.set_bias(0.0)
    motor.drive.jam(False)
    motor.drive.rub(0.0)


def _fields(value: Any, needed: tuple[str, ...], optional: tuple[str, ...]) -> dict[str, Any]:
    """Return `value`. Raises ConfigError: `value` is not a mapping with exactly these keys."""
    if not isinstance(value, dict) or set(needed) - set(value) or set(value) - {*needed, *optional}:
        parts = [f"{{{', '.join(needed)}}}"] * bool(needed) + [f"maybe {', '.join(optional)}"] * bool(optional)
        raise ConfigError(f"expected {' and '.join(parts)}, or false, not {value!r}")
    return value


def _motors_of(channel: Channel, which: str | int | None) -> list[SimMotor]:
    """Return the motor with this name or CAN id, or all motors for None."""
    found = [motor for motor in channel.motors if which in (None, motor.name, motor.can_id)]
    if which is not None and not found:
        raise ConfigError(f"{channel.name} has no motor {which!r}; it has {[m.name for m in channel.motors]}")
    return found
