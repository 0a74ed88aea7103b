"""Motors may answer with any register contents: what differs from the expectation is named, and nothing is enabled."""

import math
import struct

import can
import pytest
from hypothesis import strategies as st

from lerobot_robot_yam.damiao import motor_inspection, registers
from lerobot_robot_yam.damiao.chain import MotorChain
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.motor_inspection import listen, verify
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.registers import REGISTERS, Opcode, Register
from lerobot_robot_yam.damiao.settings.register_access import RegisterAccess
from lerobot_robot_yam.damiao.tables import REGISTER_ID, motor_type
from lerobot_robot_yam.errors import ChannelInUseError, ConfigError, MotorError
from tests.support.cases import for_all, numbers
from tests.support.frames import NoisyBus, impostors, is_classic_data, messages

pytestmark = pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")  # of numpy's small types

SPECS = [MotorSpec("shoulder", 1, "DM4340"), MotorSpec("wrist", 4, "DM4310"), MotorSpec("gripper", 7, "DM3507")]
VERIFIED = (
    Register.PMAX,
    Register.VMAX,
    Register.TMAX,
    Register.TIMEOUT,
    Register.MST_ID,
    Register.CTRL_MODE,
    Register.GR,
)


class RawRegisters(NoisyBus):
    """Motors whose registers are four bytes each, whatever these mean."""

    def __init__(self, specs):
        super().__init__(specs)
        self.raw = {}  # (CAN id, register) -> bytes
        for spec in specs:
            for register, value in self.registers[spec.can_id].items():
                self.raw[spec.can_id, int(register)] = registers.encode_value(register, value)

    def _answer_register(self, data):
        request = registers.decode_request(data)
        spec = self.specs[request.motor_id]
        if request.opcode == Opcode.REFRESH:
            self._answer(spec, self._feedback(spec))
            return
        key = request.motor_id, request.register
        if request.opcode == Opcode.WRITE:
            self.raw[key] = data[4:]
        value = self.raw.get(key, bytes(4))
        self._answer(spec, bytes((request.motor_id, 0, request.opcode, request.register)) + value)


def contents():
    """Four bytes: any, the special floats, all ones, small integers."""
    floats = st.floats(width=32) | st.sampled_from([math.nan, math.inf, -math.inf, 12.5, 10.0, 1e-45])
    return st.one_of(
        st.binary(min_size=4, max_size=4),
        floats.map(lambda value: struct.pack("<f", value)),
        st.integers(0, 0x20).map(lambda value: struct.pack("<I", value)),
        st.sampled_from([b"\xff" * 4, bytes(4), struct.pack("<I", 8000), struct.pack("<I", 8001)]),
    )


def nothing_energised(bus):
    special = [m for m in bus.sent if m.arbitration_id != REGISTER_ID]
    return not special and SpecialCommand.ENABLE.value not in [bytes(m.data) for m in bus.sent]


def same(register, found, expected):
    """Equal: integers exactly, floats to float32."""
    if REGISTERS[register].kind == "uint32":
        return found == expected
    return math.isclose(found, expected, rel_tol=1e-4)


@pytest.fixture(scope="module")
def no_wait():
    """The second answer of a pair of motors comes at once on a desk."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(motor_inspection, "_DUPLICATE_WAIT_S", 0.0)
        yield


@for_all(
    changes=st.dictionaries(
        st.tuples(st.sampled_from([s.can_id for s in SPECS]), st.sampled_from(VERIFIED)), contents(), max_size=3
    )
)
def test_any_contents_are_refused_by_name_or_equal(no_wait, changes):
    with RawRegisters(SPECS) as bus:
        bus.raw.update({(can_id, int(register)): data for (can_id, register), data in changes.items()})
        wrong = []
        for (can_id, register), data in changes.items():
            spec = bus.specs[can_id]
            row = motor_type(spec.type)
            expected = {
                Register.PMAX: row.position_max_rad,
                Register.VMAX: row.velocity_max_rad_s,
                Register.TMAX: row.torque_max_nm,
                Register.TIMEOUT: 8000,
                Register.MST_ID: spec.feedback_id,
                Register.CTRL_MODE: 1,
                Register.GR: row.gear_ratio,
            }[register]
            if not same(register, registers.decode_value(register, data), expected):
                wrong.append((spec.name, REGISTERS[register].name))
        chain = MotorChain(bus, SPECS, channel="desk")
        try:
            verify(chain)
        except MotorError as error:
            assert wrong, error
            assert all(name in str(error) and register in str(error) for name, register in wrong)
        else:
            assert not wrong
        assert nothing_energised(bus)


def replies(ident, registers_=st.sampled_from([int(r) for r in Register][:4])):  # noqa: B008
    """Register replies of motor `ident`."""
    return st.builds(
        lambda ident, register, value: bytes((ident, 0, Opcode.READ, register)) + value, ident, registers_, contents()
    )


def strangers():
    """Well-formed answers on the identifier of the motor that is asked, from another motor or about another matter."""
    other = replies(st.sampled_from([1, 7, 0x24])) | replies(st.just(4), st.sampled_from([9, 21, 60]))
    written = replies(st.just(4)).map(lambda data: data[:2] + bytes((Opcode.WRITE,)) + data[3:])
    return st.builds(lambda data: can.Message(arbitration_id=0x14, is_extended_id=False, data=data), other | written)


@for_all(
    short=60,
    register=st.sampled_from(list(Register)[:4]),
    data=contents(),
    noise=st.lists(messages() | impostors(0x14, replies(st.just(4))) | strangers(), max_size=4),
    fate=st.sampled_from(["ok", "ok", "silent", "late"]),
)
def test_a_register_is_read_as_it_is_or_not_at_all(register, data, noise, fate):
    with RawRegisters(SPECS) as bus:
        bus.raw[4, int(register)] = data
        chain = MotorChain(bus, SPECS, channel="desk")
        bus.noise = noise
        getattr(bus, fate, set()).add(4)
        try:
            found = chain.read_register(1, register, timeout_s=1.0 if fate == "ok" else 0.0005, attempts=2)
        except MotorError as error:
            assert fate != "ok" and "wrist" in str(error) and REGISTERS[register].name in str(error)
        else:
            assert fate == "ok"
            value = registers.decode_value(register, data)
            assert found == value or (found != found and value != value)
        bus.noise = []
        bus.late.clear()
        bus.release()
        stamp = chain.stamp_s[1]
        chain.drain()  # an answer that comes too late is no feedback
        chain.feedback.publish()
        if fate == "late":
            assert noise or (chain.stamp_s[1] == stamp and chain.duplicates[1] == 0)
        assert nothing_energised(bus)


@for_all(register=st.integers(-3, 300), value=numbers())
def test_a_written_register_holds_the_value(register, value):
    with RawRegisters(SPECS) as bus:
        access, motor_id = RegisterAccess(bus, "desk"), SPECS[2].can_id
        try:
            access.write(motor_id, register, value)
        except ConfigError as error:
            assert not bus.sent and str(error)
            return
        assert REGISTERS[register].writable
        held = access.read(motor_id, register)
        if REGISTERS[register].kind == "uint32":
            assert held == value
        else:
            assert held == pytest.approx(float(value), rel=1e-6, abs=1e-44)
        assert nothing_energised(bus)


@for_all(register=st.integers(-3, 300), value=numbers(), data=contents())
def test_values_and_bytes_are_each_others_inverse(register, value, data):
    try:
        packed = registers.encode_value(register, value)
    except ConfigError:
        assert register not in REGISTERS or not _storable(register, value)
    else:
        assert len(packed) == 4
        assert registers.encode_value(register, registers.decode_value(register, packed)) == packed
    if register in REGISTERS:
        again = registers.decode_value(register, data)
        assert _storable(register, again) == (not isinstance(again, float) or math.isfinite(again))


def _storable(register, value):
    try:
        number = float(value)
    except OverflowError:
        return False
    if REGISTERS[register].kind == "float":
        return math.isfinite(number) and abs(number) <= 3.4028234663852886e38
    return math.isfinite(number) and 0 <= value <= 2**32 - 1 and value == int(value)


@for_all(short=60, frames=st.lists(messages(), max_size=6), motor=st.sampled_from(SPECS))
def test_only_traffic_of_motors_counts_as_a_foreign_driver(frames, motor):
    with NoisyBus(SPECS) as bus:
        for message in frames:
            bus.deliver(message)
        ids = [spec.can_id for spec in SPECS]
        watched = {base + i for base in (0, 0x100, 0x200, 0x300, 16) for i in ids} | {REGISTER_ID, 0}
        driven = any(is_classic_data(m) and m.arbitration_id in watched for m in frames)
        try:
            listen(bus, 0.002, ids, "desk")
        except ChannelInUseError as error:
            assert driven and "desk" in str(error)
        else:
            assert not driven
        assert not bus.sent
