"""Operations that make channels, motors and cameras of a rig fail."""

from typing import Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.bus.channel import Channel
from lerobot_robot_yam.rig.devices.simulated_handle import SimEncoders
from lerobot_robot_yam.rig.devices.simulated_motor import SimMotor
from lerobot_robot_yam.rig.simulation.fault_kinds import CHANNEL_KINDS, KINDS, MOTOR_KINDS
from lerobot_robot_yam.rig.simulation.operation import Operations, operation


class FaultOperations(Operations):
    """Faults of channels, motors and cameras."""

    @operation
    def fault(self, channel: str, motor: str | int | None, kind: str, value: Any = True, **details: Any) -> None:
        """Make something fail, until `clear_faults` or the same kind with False, 0 or its usual value.

        Of one motor (name or CAN id) or, with None, of every motor of the channel:
            "silent" (bool): neither obeys nor answers.
            "power" (bool): False cuts its power; True gives it back, with the registers that its flash holds.
            "storing" ("reverts" or "cut", or False): what STORE does: other registers become what flash held; or the
                power goes in the middle.
            "drop_next" (answers), "loss_rate" (0 … 1), "delay_s" (s): answers are lost or late.
            "command_loss_rate" (0 … 1): share of frames that it does not hear.
            "duplicate" (bool, or {"q_rad": rad}): a second motor has its identifiers, see "second_arm".
            "wrong_id" (identifier, or False): answers come under it; the registers do not know it.
            "corrupt_rate" (0 … 1; all_bytes=True): share of answers with random contents; motor number and fault
                code stay right without all_bytes.
            "reading" ({"position_rad", "velocity_rad_s", "torque_nm", "answers", "freeze"}, each optional, or False):
                its answers lie, and its own servo does not know. They add these offsets (joint sign; positions wrap at
                the end of the frame's range), the next `answers` of them or all. With "freeze": true all repeat the
                first one's position, velocity and torque.
            "temperatures_c" ([power stage, coil] °C, or False): its sensors lie; the motor does not act on them.
            "temperature_ramp" ({"rate_c_per_s", "from_c"}, or False): it warms or cools from from_c on. At OT_VALUE
                (power stage, 0xB) or 100 °C (coil, 0xC) it switches itself off, and again after each CLEAR while it is
                as hot.
            "torque_bias_nm" (Nm, joint sign): while enabled it adds this torque, and does not report it.
            "stuck" (bool): jammed. "friction_nm" (Nm): additional dry friction.
            "nibble" (fault code; sticky=True survives CLEAR): it fails with that code now.
            "register" (value; register=number): overwrites a register, read-only ones too.
        Of the channel, motor None:
            "link_down" (bool): as `ip link set canX down`: send and receive raise "Network is down".
            "adapter_gone" (bool): open buses are dead for good ("No such device"), opening raises BusError.
            "bus_off" (bool): one error frame (0x40), nothing gets through, sends raise "No buffer space available"
                after 10 frames; ended by False, or by link_down.
            "cable_out" (bool): nothing gets through, and nobody is told.
            "foreign" ({"id", "rate_hz", "payload": "hold" or "zero"}, or False): another computer sends frames to
                that identifier: MIT commands to stay where the motor is, or eight zero bytes. Motors obey and answer.
            "latency_s" (s): each way; commands reach the motors late, and answers the host. Time stamps are those of
                the arrival at the host.
            "hold_back" ({"seconds", "every_s"}, or False): from now on, again every every_s or once, the adapter keeps
                received frames back for so long and then gives them all at once, in order, stamped with that moment.
            "second_arm" (bool, or {"q_rad": rad per motor, joint sign}): another arm with the same identifiers is on
                the bus. Each of its motors hears every frame and answers after the first arm's, with its own registers,
                fault code and bare shaft. It is limp until it is enabled. Without q_rad the shafts are 0.3 rad from
                where the arm was when the rig started. `state` shows them as second_motors.
            "payload_kg" (kg): a point mass at the tool.
            "handle_silent" (bool).
            "encoders_silent" (bool, or numbers of devices from 0): of a leader without motors.
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
        """Undo all that `fault` did to the channel, except registers and latched fault codes."""
        device, where = self.device, self._channel_of(channel)
        where.set_link(device.clock.now(), bus_off=False, down=False, gone=False)
        where.cable_out = False
        where.foreign = None
        where.adapter.repair(device.scene.options.latency_s)
        device.ballast[channel].repair()
        if where.handle is not None:
            where.handle.silent = False
            if isinstance(where.handle, SimEncoders):
                where.handle.silent_devices = frozenset()
        for motor in where.motors:
            motor.repair()
        where.identifiers_changed()
        device.events.add("faults_cleared", channel=channel)

    def camera_fault(self, camera: str, kind: str | None, seconds: float | None = None) -> None:
        """Make a camera of the scene fail for every client of a live rig.

        "stall": no new frames, for `seconds` or until None. "dead": its clients are told, and it cannot be opened. None
        ends both; clients of a dead camera connect anew.
        """
        self.request("camera_fault", camera=camera, kind=kind, seconds=seconds)


def _motors_of(channel: Channel, which: str | int | None) -> list[SimMotor]:
    """Return the motor of that name or CAN id; None: all."""
    found = [motor for motor in channel.motors if which in (None, motor.name, motor.can_id)]
    if which is not None and not found:
        raise ConfigError(f"{channel.name} has no motor {which!r}; it has {[m.name for m in channel.motors]}")
    return found
