"""Frames that the doctor may send, and answers that only a bus on a desk can be made to give."""

import ast
import errno
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_robot_yam import doctor
from lerobot_robot_yam.damiao import codec, handle_encoder
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.motor_spec import MotorSpec
from lerobot_robot_yam.damiao.registers import (
    Opcode,
    Register,
    encode_read,
    encode_refresh,
    encode_reply,
    encode_store,
    encode_write,
)
from lerobot_robot_yam.damiao.tables import REGISTER_ID
from lerobot_robot_yam.doctor.check_channel import BIN_EDGES_MS, BLOCKS, bars, examine_channel, histogram, percentile
from lerobot_robot_yam.doctor.check_encoders import handle_firmware, inspect_handle
from lerobot_robot_yam.doctor.check_link import Link
from lerobot_robot_yam.doctor.kit.findings import Section, Severity, empty_report
from lerobot_robot_yam.doctor.kit.questions import Questions, harmless
from lerobot_robot_yam.doctor.kit.targets import from_option
from lerobot_robot_yam.errors import LifeCycleError
from lerobot_robot_yam.system.own_commands import as_root
from tests.support.desk_bus import DeskBus

MODULES = sorted(Path(doctor.__path__[0]).rglob("*.py"))
TARGET = from_option("can_x:yam:yam_teaching_handle", "socketcan", None)


def test_questions_are_harmless():
    assert harmless(REGISTER_ID, encode_read(1, Register.PMAX))
    assert harmless(REGISTER_ID, encode_refresh(1))
    assert harmless(handle_encoder.REQUEST_ID, handle_encoder.encode_report_request())
    assert harmless(handle_encoder.REQUEST_ID, handle_encoder.encode_version_request())
    assert harmless(handle_encoder.REQUEST_ID, handle_encoder.encode_eeprom_read(25))


def test_commands_are_not():
    for motor_id in range(1, 9):
        for offset in (0, 0x100, 0x200, 0x300):
            for special in SpecialCommand:
                assert not harmless(motor_id + offset, special.value)
            assert not harmless(motor_id + offset, codec.encode_mit("DM4310", 0, 0, 0, 0, 0))
    assert not harmless(REGISTER_ID, encode_write(1, Register.TIMEOUT, 0))
    assert not harmless(REGISTER_ID, encode_store(1))
    assert not harmless(handle_encoder.REQUEST_ID, handle_encoder.encode_report_frequency(0))
    for opcode in (handle_encoder.OP_SET_ZERO, handle_encoder.OP_WRITE_EEPROM, 0x0F):
        assert not harmless(handle_encoder.REQUEST_ID, bytes((0xFF, opcode)))


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_only_questions_are(identifier, data):
    if harmless(identifier, data):
        registers = identifier == REGISTER_ID and data[2] in (Opcode.READ, Opcode.REFRESH)
        assert registers or (identifier == handle_encoder.REQUEST_ID and data[1] in (0x02, 0x03, 0x07))


def test_what_is_not_harmless_is_not_sent():
    with DeskBus([]) as bus:
        questions = Questions(bus, "can_x")
        with pytest.raises(LifeCycleError, match="does not send 0x1#"):
            questions._ask(SpecialCommand.ENABLE.value, 1)
        with pytest.raises(LifeCycleError):
            questions.handle(handle_encoder.encode_report_frequency(0), 0, bytes)
        assert bus.sent == []


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_only_one_module_sends(path):
    """No other one can make a message, send on a bus, or knows of a command."""
    names = {node.attr for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Attribute)}
    names |= {node.id for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Name)}
    commands = {"SpecialCommand", "MotorChain", "encode_mit", "prepare_handle", "RegisterAccess"}
    assert not names & commands
    if path.stem != "questions":
        assert not names & {"send", "send_many", "Message", "data_message", "BusPort"}


def test_error_frames_and_questions_of_others_are_no_answers():
    spec = MotorSpec("joint_1", 1, "DM4310")
    with DeskBus([spec]) as bus:
        wrong = encode_reply(1, Opcode.READ, Register.PMAX, 3.0)
        questions = Questions(bus, "can_x")
        bus.put(4, wrong, is_error_frame=True)
        bus.put(REGISTER_ID, wrong)
        assert questions.register(1, Register.PMAX) == 12.5
        (answer,) = questions.refresh([1], 0.05, 0.01)
        assert (answer.identifier, answer.nibble, answer.fault) == (17, 1, 1)
        bus.silent.add(1)
        assert questions.refresh([1], 0.02, 0.01) == []
        assert questions.round_trip_s(1, 0.01) is None


@pytest.fixture
def desk():
    with DeskBus([], handle=True) as bus:
        yield bus


def inspect(desk):
    questions, section = Questions(desk, "can_x"), Section("handles")
    inspect_handle(questions, TARGET, handle_firmware(questions), section)
    return section


def test_what_is_wrong_with_a_handle(desk):
    low = handle_encoder.EEPROM_REPORT_FREQUENCY_LOW
    desk.eeprom[low], desk.eeprom[handle_encoder.EEPROM_REPORT_FREQUENCY_HIGH] = 100, 0xFF
    desk.firmware = (2, 2, 11)
    desk.handle_data = handle_encoder.encode_report(-2.0, 0.0, (False, True))
    section = inspect(desk)
    old, talks, turned = section.findings
    assert all(problem.severity is Severity.PROBLEM for problem in section.findings)
    assert "2.2.11" in old.what and "2.2.12" in old.what and "update" in old.remedy
    assert "100 Hz" in talks.what and talks.remedy == "yam-handle report --channel can_x 0"
    assert desk.eeprom[low] == 100  # and is left to
    assert "-2.000 rad" in turned.what and "yam-handle zero --channel can_x" in turned.remedy
    assert section.rows[0]["buttons"] == [0, 1]


def test_a_handle_that_tells_only_half(desk):
    desk.handle_data = b"\x01"
    (warning,) = inspect(desk).findings
    assert warning.severity is Severity.WARNING and "trigger is unknown" in warning.what


class FullQueue(DeskBus):
    """A SocketCAN interface whose transmit queue is full."""

    def __init__(self, channel, **_):
        super().__init__([])

    def send(self, msg, timeout=None):
        raise can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS)


def test_no_buffer_space_while_asking(monkeypatch):
    monkeypatch.setitem(can.interfaces.BACKENDS, "socketcan", (FullQueue.__module__, FullQueue.__name__))
    report = empty_report()
    link = Link("can_x", up=True, driver="gs_usb", queue_length=10)
    examine_channel(from_option("can_x", "socketcan", None), link, 1, report, lambda text: None)
    (problem,) = report["channels"].findings
    assert "No buffer space" in problem.what
    assert problem.remedy == as_root("yam-setup-can --reset can_x")


def test_histogram():
    times = [0.26, 0.3, 0.31, 5.0, 99.0]
    assert histogram(times) == [2, 1, 0, 0, 0, 1, 0, 1]
    assert len(histogram([])) == len(BIN_EDGES_MS) + 1
    assert percentile(times, 0.5) == 0.31 and percentile(times, 0.99) == 99.0 and percentile([], 0.5) is None
    drawn = bars([1000, 1, 0, 0, 0, 0, 0, 0]).split()
    assert drawn == [BLOCKS[-1], BLOCKS[1], *BLOCKS[0] * 6]  # one in a thousand still shows
