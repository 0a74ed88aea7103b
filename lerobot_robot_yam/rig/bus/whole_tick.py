"""Replies to a whole tick in one pass: a packet with one MIT command per motor, answered with one packet.

A running control loop sends only such packets. `Channel.receive` does the same frame by frame, for any frames and with
any fault. Bytes and times are identical, because this loop executes the operations of `SimMotor`, `Drive` and `codec`
in the same order:

    control = kp (u* − base) + kd u̇* + tau,    reported position = direction (u + u̇ · ahead) + zero

The loop takes a third of the time. numpy is slower: the physics evicts arrays of seven numbers from the caches.
"""

import struct
from collections.abc import Sequence
from typing import Any

from lerobot_robot_yam.damiao.handle_encoder import REQUEST_ID, encode_report_request
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.rig.bus.adapter import Adapter
from lerobot_robot_yam.rig.devices.packets import Wire, send_time
from lerobot_robot_yam.rig.devices.simulated_handle import SimHandle
from lerobot_robot_yam.rig.devices.simulated_motor import AHEAD_S, SimMotor
from lerobot_robot_yam.rig.devices.thermometer import PERIOD_S

_LONG, _SHORT = 0xFFFF, 0xFFF  # number of steps of a frame's fields, see `codec`
_SPECIAL = b"\xff" * 7  # first bytes of every special command
_REQUEST = encode_report_request()
_DATA_SIZE = 8  # size of the data at the end of a record, bytes


class WholeTick:
    """Motors of a channel, each on a `Drive`, and the channel's handle. size: packet size, bytes."""

    def __init__(self, motors: Sequence[SimMotor], handle: SimHandle | None):
        self._motors, self._handle = motors, handle
        self._world = motors[0].world
        count, rest = len(motors), 0 if handle is None else 1
        # Records as in `packets`: stamp; identifier, length and flags as one word; data.
        self._records = struct.Struct("<" + "dQ8s" * (count + rest))
        self._headers = struct.Struct("<" + "dQ8x" * (count + rest))
        self._commands = struct.Struct(">" + "16xHHHH" * count + "24x" * rest)
        self.size = self._records.size
        self._settings: list[tuple[float, int, int] | None] = []

    def answer(self, packet: bytes, now_s: float, wire: Wire, adapter: Adapter) -> bytes | None:
        """Reply to a packet if all motors are plain (`SimMotor.plain_settings`) and the handle is not silent.

        Returns:
            The reply; None, without any change of state, if a motor is not plain or the packet has another format.
        """
        if len(packet) != self.size or _SPECIAL in packet:
            return None
        settings = [motor.plain_settings() for motor in self._motors]
        if settings != self._settings and not self._lay_out(settings):
            return None
        headers, count = self._headers.unpack(packet), len(self._heads)
        sent_s = headers[0]
        if headers[1::2] != self._heads or headers[0::2] != (sent_s,) * count:
            return None
        if self._handle is not None and not packet.startswith(_REQUEST, self.size - _DATA_SIZE):
            return None
        through_s = wire.transmit_all(send_time(sent_s, now_s) + adapter.latency_s, 2 * count)
        answers = self._serve(self._commands.unpack(packet), through_s)
        if self._handle is not None:
            answers.append(self._handle.report().data)
        reply: list[float | int | bytes] = [0] * (3 * count)
        reply[0::3] = adapter.arrivals_s(through_s[count:])
        reply[1::3] = self._answer_heads
        reply[2::3] = answers
        return self._records.pack(*reply)

    def _serve(self, quarters: tuple[int, ...], at_s: Sequence[float]) -> list[bytes]:
        """Execute MIT commands of four 16-bit words each, delivered at `at_s`; return the data of the replies."""
        world = self._world
        sim_s, stamp_s, qpos, qvel, force = world.sim_s, world.stamp_s, world.qpos, world.qvel, world.force
        ctrl, answers = world.ctrl, []
        words = quarters[0::4], quarters[1::4], quarters[2::4], quarters[3::4]
        for (devices, place, ranges), one, two, three, four, through_s in zip(self._rows, *words, at_s, strict=False):
            motor, drive, thermometer = devices
            actuator, first, last, v_first, v_last, base, coefficient, direction, zero, status = place
            p_max, v_max, t_max, kp_max, kd_max, p_range, v_range, t_range = ranges
            motor.last_command_s = sim_s
            if last is None:
                angle, rate = base + coefficient * qpos[first], coefficient * qvel[v_first]
            else:
                angle = base + coefficient * (qpos[first] + qpos[last])
                rate = coefficient * (qvel[v_first] + qvel[v_last])

            position = one * p_range / _LONG - p_max
            kp = ((two & 0xF) << 8 | three >> 8) * kp_max / _SHORT
            kd = ((three & 0xFF) << 4 | four >> 12) * kd_max / _SHORT
            true = zero + direction * angle
            if not -p_max <= true <= p_max:
                position += true - ((true + p_max) % p_range - p_max)
            if (kp, kd) != drive.gains:
                drive.set_gains(kp, kd)
            ctrl[actuator] = (
                kp * (direction * (position - zero) - base)
                + kd * (direction * ((two >> 4) * v_range / _SHORT - v_max))
                + direction * ((four & _SHORT) * t_range / _SHORT - t_max)
            )

            ahead = through_s - stamp_s
            ahead = 0.0 if ahead < 0.0 else AHEAD_S if ahead > AHEAD_S else ahead
            position = direction * (angle + rate * ahead) + zero
            if not -p_max <= position <= p_max:
                position = (position + p_max) % p_range - p_max
            velocity, torque = direction * rate, direction * force[actuator]
            if sim_s - thermometer.measured_at_s >= PERIOD_S:
                thermometer.read(velocity, torque, sim_s, 0.0)
            velocity = v_max if velocity > v_max else -v_max if velocity < -v_max else velocity
            torque = t_max if torque > t_max else -t_max if torque < -t_max else torque
            word = (
                status
                | int((position + p_max) * _LONG / p_range) << 40
                | int((velocity + v_max) * _SHORT / v_range) << 28
                | int((torque + t_max) * _SHORT / t_range) << 16
                | thermometer.word
            )
            answers.append(word.to_bytes(8, "big"))
        return answers

    def _lay_out(self, settings: list[tuple[float, int, int] | None]) -> bool:
        """Cache values that are constant between ticks; return whether all motors are plain.

        `answer` calls this method again when zeros or identifiers have changed.
        """
        plain = [setting for setting in settings if setting is not None]
        if len(plain) < len(settings):
            return False
        self._settings = settings
        heads = [_head(can_id, 8) for _, can_id, _ in plain]
        self._answer_heads = [_head(answer_id, 8) for _, _, answer_id in plain]
        if self._handle is not None:
            report = self._handle.report()
            heads.append(_head(REQUEST_ID, len(_REQUEST)))
            self._answer_heads.append(_head(report.id, len(report.data)))
        self._heads = tuple(heads)
        self._rows = [_row(motor) for motor in self._motors]
        return True


def _head(ident: int, length: int) -> int:
    """Return the second word of a record: identifier and length of a plain frame."""
    return ident | length << 32


def _row(motor: SimMotor) -> tuple[tuple[Any, ...], ...]:
    drive = motor.drive
    first, last = drive.q[0], drive.q[1] if len(drive.q) > 1 else None
    p, v, t, kp, kd = motor.ranges
    status = (Fault.NORMAL << 4 | motor.can_id & 0xF) << 56
    place = (drive.actuator, first, last, drive.v[0], drive.v[-1], drive.base_rad, drive.coefficient)
    ranges = (p, v, t, kp, kd, p + p, v + v, t + t)
    return (motor, drive, motor.thermometer), (*place, motor.direction, motor.zero_rad, status), ranges
