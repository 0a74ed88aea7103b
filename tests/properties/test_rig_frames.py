"""The rig's motors, handle and wire take any frame of any client: the world stays finite, answers are well formed."""

import contextlib
import math
import struct

import numpy as np
import pytest
from hypothesis import strategies as st

from lerobot_robot_yam.damiao.codec import SpecialCommand, decode_feedback, encode_mit
from lerobot_robot_yam.damiao.handle_encoder import HANDLE_IDS, REQUEST_ID
from lerobot_robot_yam.damiao.registers import REGISTERS, Opcode, Register, decode_reply
from lerobot_robot_yam.damiao.tables import FRAME_TIME_S, REGISTER_ID, motor_type
from lerobot_robot_yam.errors import BusError
from lerobot_robot_yam.rig.devices import packets
from lerobot_robot_yam.rig.devices.packets import Frame, Wire
from tests.support.cases import for_all
from tests.support.rig_desk import Desk

NAME = "leader_left"
IDS = range(1, 7)
SETTINGS = [Register.PMAX, Register.VMAX, Register.TMAX, Register.TIMEOUT, Register.MST_ID, Register.ESC_ID]


class Rig(Desk):
    """A leader's channel whose client may set a frame's stamp and flags."""

    def __init__(self):
        super().__init__(NAME)

    def exchange(self, frames):
        """Send one packet, let 4 ms pass, return the answers."""
        self.channel.receive(self._theirs, frames, self.now_s)
        self.run(0.004)
        return self.heard()


def floats32():
    """Four bytes that are a float32: any, the ends of the range, denormals, infinity, NaN."""
    ends = [0.0, -1.0, 12.5, 1e-45, -1e-45, 1e-30, 3.4e38, -3.4e38, math.inf, -math.inf, math.nan]
    return (st.floats(width=32) | st.sampled_from(ends)).map(lambda value: struct.pack("<f", value))


def stored_frames():
    """Frames as a packet can hold them."""
    return st.builds(Frame, st.floats(), st.integers(0, 2**29 - 1), st.binary(max_size=8), st.integers(0, 255))


def writes(register, value):
    """A request to write four bytes to a register of any motor."""
    return st.builds(
        lambda ident, register, raw: (REGISTER_ID, bytes((ident, 0, Opcode.WRITE, register)) + raw),
        st.sampled_from(IDS),
        register,
        value,
    )


def client_frames():
    """What a client may send: commands of every mode, register requests, handle requests, nonsense."""
    ident = st.sampled_from(IDS)
    command = st.builds(int.__add__, ident, st.sampled_from([0, 0, 0x100, 0x200, 0x300]))
    special = st.sampled_from([command.value for command in SpecialCommand])
    mit = st.tuples(*[st.floats(-600, 600)] * 5).map(lambda values: encode_mit("DM4310", *values))
    mode = st.integers(1, 4).map(lambda number: bytes((number, 0, 0, 0)))
    request = st.builds(
        lambda ident, opcode, register: (REGISTER_ID, bytes((ident, 0, opcode, register, 0, 0, 0, 0))),
        ident,
        st.sampled_from([int(code) for code in Opcode]),
        st.sampled_from(sorted(REGISTERS)),
    )
    content = st.one_of(
        st.tuples(command, special),
        st.tuples(ident, mit),
        st.tuples(command, st.binary(min_size=8, max_size=8)),
        st.tuples(command, st.builds(bytes.__add__, floats32(), floats32())),
        request,
        writes(st.sampled_from(sorted(REGISTERS)), st.binary(min_size=4, max_size=4)),
        writes(st.sampled_from(SETTINGS), floats32()),
        writes(st.just(int(Register.CTRL_MODE)), mode),
        st.tuples(st.just(REQUEST_ID), st.binary(max_size=7).map(lambda data: b"\xff" + data)),
        st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)),
    )
    stamp, flags = st.just(0.0) | st.floats(), st.sampled_from([0] * 8 + [1, 2, 3])
    return st.builds(lambda content, stamp, flags: Frame(stamp, *content, flags), content, stamp, flags)


@for_all(short=30, packets=st.lists(st.lists(client_frames(), max_size=6), min_size=1, max_size=8))
def test_no_frame_breaks_the_rig(packets):
    with contextlib.closing(Rig()) as rig:
        for motor in rig.channel.motors:  # energised from the start, so that commands act
            rig.special(motor.can_id, SpecialCommand.ENABLE)
        last = -math.inf
        for frames in packets:
            for answer in rig.exchange(frames):
                assert math.isfinite(answer.stamp_s) and answer.stamp_s >= last
                last = answer.stamp_s
                assert 0 <= answer.id <= 0x7FF and answer.flags == 0
                if answer.id in HANDLE_IDS:
                    assert 2 <= len(answer.data) <= 8
                else:
                    assert len(answer.data) == 8
                    assert np.isfinite(decode_feedback("DM4310", answer.data)).all()
        data = rig.device.world.data
        for values in (data.qpos, data.qvel, data.actuator_force):
            assert np.isfinite(values).all()
        assert not data.warning.number.any(), "MuJoCo gave the state up"
        for motor in rig.channel.motors:
            assert abs(motor.torque_nm) <= motor_type(motor.kind).torque_max_nm * (1 + 1e-9)


@pytest.fixture(scope="module")
def shared_rig():
    """For what holds in any state the rig may be in."""
    with contextlib.closing(Rig()) as rig:
        yield rig


@for_all(short=60, frames=st.lists(client_frames(), min_size=1, max_size=15))
def test_only_the_motor_that_was_meant_answers(shared_rig, frames):
    """One answer at most, from the motor that was addressed; identifiers are left as they are."""
    for frame in frames:
        if frame.id == REGISTER_ID and frame.data[2:4] in (b"\x55\x07", b"\x55\x08"):
            continue
        answers = shared_rig.exchange([frame])
        if frame.id != REQUEST_ID or frame.flags:  # an earlier request may have told the handle to report by itself
            answers = [answer for answer in answers if answer.id not in HANDLE_IDS]
        assert len(answers) <= (0 if frame.flags else 2 if frame.id == REQUEST_ID else 1)
        for answer in answers:
            if frame.id == REQUEST_ID:
                assert answer.id in HANDLE_IDS
                continue
            meant = int.from_bytes(frame.data[:2], "little") if frame.id == REGISTER_ID else frame.id & 0xFF
            assert answer.id == meant + 16
            reply = decode_reply(answer.data) if frame.id == REGISTER_ID else None
            assert (reply.motor_id if reply else answer.data[0] & 0xF) == meant


@for_all(
    packet=st.binary(max_size=100) | st.binary(min_size=48, max_size=48),
    frames=st.lists(stored_frames(), max_size=5),
)
def test_packets_are_whole_or_refused(packet, frames):
    again = packets.unpack(packets.pack(frames))
    assert [tuple(f)[1:] for f in again] == [tuple(f)[1:] for f in frames]
    try:
        for frame in packets.unpack(packet):
            assert len(frame.data) <= 8
    except BusError:
        assert len(packet) % packets.RECORD_SIZE


@for_all(stamps=st.lists(st.floats(), min_size=1, max_size=20), now=st.floats(0, 1e7))
def test_the_wire_keeps_order_and_time_whatever_the_senders_clock_says(stamps, now):
    line, last = Wire(), -math.inf
    for stamp in stamps:
        sent = packets.send_time(stamp, now)
        assert now - 0.06 <= sent <= now
        through = line.transmit(sent)
        assert through >= last and through >= sent + 0.9 * FRAME_TIME_S
        last = through
    assert last <= now + len(stamps) * FRAME_TIME_S * 1.01
