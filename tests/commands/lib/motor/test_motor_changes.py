"""All motors of a command are changed, or none; a motor that does not get its new id has its old one."""

import contextlib
import errno
import io
from argparse import Namespace

import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.commands.lib.motor.motor_bench import MotorBench
from lerobot_robot_yam.commands.lib.motor.motor_changes import apply, set_id, store_motors
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.errors import BusError, MotorError
from tests.support.stubborn_desk import StubbornDesk

YES = Namespace(yes=True)


def ids(old, new, answers, yes=True):
    return Namespace(yes=yes, old=old, new=new, answers=answers)


HOT = {Register.OT_VALUE: 90.0}


@pytest.fixture
def desk():
    with StubbornDesk() as bus:
        yield bus


@pytest.fixture
def bench(desk, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return MotorBench(ArmConfig(name="left", channel="desk"), desk)


@pytest.fixture
def energised_meanwhile(desk, monkeypatch):
    """A person who energises motor 3 by another program before they answer."""

    class Person(io.StringIO):
        def readline(self):
            desk.fault[3] = Fault.NORMAL
            return super().readline()

    return lambda word: monkeypatch.setattr("sys.stdin", Person(f"{word}\n"))


def held(desk, register=Register.OT_VALUE):
    return [registers[register] for registers in desk.registers.values()]


def test_one_motor_that_refuses_leaves_all_as_they_were(desk, bench):
    desk.stays[5] = {Register.OT_VALUE}
    with pytest.raises(MotorError, match="5 did not take OT_VALUE.*; nothing was changed. The registers .*/desk-"):
        apply(YES, bench, dict.fromkeys(range(1, 8), HOT), "write", store_too=True)
    assert held(desk) == [100.0] * 7 and desk.stored == []


def test_ctrl_c_waits_for_the_end_and_the_end_is_told(desk, bench, capsys):
    desk.interrupts = True
    with pytest.raises(KeyboardInterrupt):
        apply(YES, bench, dict.fromkeys(range(1, 8), HOT), "write", store_too=True)
    assert held(desk) == [90.0] * 7 and "written, stored and read back" in capsys.readouterr().err
    desk.interrupts = True
    with pytest.raises(KeyboardInterrupt):
        set_id(ids(7, 7, 30), bench)
    assert "motor 7 is now motor 7 and answers as 30; stored and read back" in capsys.readouterr().err


def test_a_terminal_that_is_closed_meanwhile_stops_nothing_half_way(desk, bench, monkeypatch):
    """SIGHUP waits until all is stored, but what is said then goes nowhere."""

    class Closed(io.StringIO):
        def write(self, text):
            if desk.stored:
                raise OSError(errno.EIO, "Input/output error")
            return super().write(text)

    desk.reverts = {1: {Register.UV_VALUE: 20.0}}
    monkeypatch.setattr("sys.stderr", Closed())
    with contextlib.suppress(OSError):
        apply(YES, bench, dict.fromkeys(range(1, 8), HOT), "write", store_too=True)
    assert set(desk.stored) == set(range(1, 8))


def test_an_adapter_that_goes_leaves_the_person_knowing_which_motors_were_changed(desk, bench):
    desk.unplugged_by = 3
    with pytest.raises(BusError, match=r"NOT PUT BACK: OT_VALUE of motor 1 \(was 100\), .* motor 3 .*; switch"):
        apply(YES, bench, dict.fromkeys(range(1, 8), HOT), "write", store_too=False)
    assert held(desk) == [90.0] * 3 + [100.0] * 4


def test_a_motor_that_keeps_its_id_keeps_all_of_them(desk, bench):
    desk.stays[7] = {Register.ESC_ID}
    with pytest.raises(MotorError, match="motor 9 answers 0 times, as nothing; it has its old ids again, nothing was"):
        set_id(ids(7, 9, 25), bench)
    assert held(desk, Register.MST_ID) == [17, 18, 19, 20, 21, 22, 23] and desk.stored == []


def test_a_motor_that_is_energised_while_the_question_waits_is_left_alone(desk, bench, energised_meanwhile):
    asks = Namespace(yes=False, motor=["3"])
    for word, change in (
        ("write", lambda: apply(asks, bench, {3: HOT}, "write", store_too=True)),
        ("store", lambda: store_motors(asks, bench)),
        ("set-id", lambda: set_id(ids(3, 9, 25, yes=False), bench)),
    ):
        desk.fault[3] = Fault.DISABLED
        energised_meanwhile(word)
        with pytest.raises(MotorError, match="joint_3 .* is energised; nothing was changed"):
            change()
    assert held(desk) == [100.0] * 7 and desk.stored == [] and held(desk, Register.ESC_ID)[2] == 3
