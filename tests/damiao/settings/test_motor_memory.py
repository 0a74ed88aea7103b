"""Registers of motors that do not take, keep or tell what they should."""

import pytest

from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.settings.motor_memory import (
    put,
    read_contents,
    require_alone,
    require_limp,
    store,
)
from lerobot_robot_yam.damiao.settings.register_access import RegisterAccess
from lerobot_robot_yam.errors import MotorError
from tests.support.stubborn_desk import StubbornDesk

HOT, LOW = {Register.OT_VALUE: 90.0}, {Register.UV_VALUE: 14.0}


@pytest.fixture
def desk():
    with StubbornDesk() as bus:
        yield bus


@pytest.fixture
def access(desk):
    return RegisterAccess(desk, "desk")


def test_values_are_set_and_what_was_there_is_told(desk, access):
    assert put(access, {3: HOT | LOW}) == {3: {Register.OT_VALUE: 100.0, Register.UV_VALUE: 15.0}}
    assert put(access, {3: HOT | LOW}) == {3: {}}
    assert desk.registers[3][Register.OT_VALUE] == 90.0


def test_a_register_that_stays_leaves_the_motor_as_it_was(desk, access):
    desk.stays[3] = {Register.UV_VALUE}
    with pytest.raises(MotorError, match="motor 3 did not take UV_VALUE 14: it still holds 15; nothing was changed"):
        put(access, {3: HOT | LOW})
    assert desk.registers[3][Register.OT_VALUE] == 100.0


def test_a_register_that_cannot_be_put_back_is_named(desk, access):
    class Latch(dict):
        """Once it is hot it stays so."""

        def __setitem__(self, register, value):
            super().__setitem__(register, 90.0 if register is Register.OT_VALUE else value)

    desk.registers[3] = Latch(desk.registers[3])
    desk.stays[3] = {Register.UV_VALUE}
    with pytest.raises(MotorError, match=r"NOT PUT BACK: OT_VALUE of motor 3 \(was 100\); switch the power"):
        put(access, {3: HOT | LOW})


def test_a_register_that_is_not_told_is_not_written(desk, access):
    desk.silent = {3}
    with pytest.raises(MotorError, match="motor 3 does not tell register OT_VALUE; nothing was changed"):
        put(access, {3: HOT})


def test_storing_is_quiet_when_nothing_else_changes(desk, access):
    assert store(access, 3) == [] and desk.stored == [3]


def test_a_store_without_an_answer_is_told(desk, access):
    desk.unconfirmed = {3}
    with pytest.raises(MotorError, match="motor 3 did not confirm storing its registers; its RAM is as it was"):
        store(access, 3)


def test_registers_that_every_store_changes_are_named(desk, access):
    desk.lost_when_stored[3] = {Register.UV_VALUE: 12.0}
    with pytest.raises(MotorError, match="storing the registers of motor 3 changed others: UV_VALUE from 15 to 12"):
        store(access, 3)
    assert desk.stored == [3, 3]  # not for ever: flash wears out


def test_a_read_only_register_that_changes_is_named_at_once(desk, access):
    desk.lost_when_stored[3] = {Register.GR: 9.0}
    with pytest.raises(MotorError, match="changed others: GR from 40 to 9"):
        store(access, 3)
    assert desk.stored == [3]


def test_only_a_limp_motor_that_is_alone_may_be_changed(desk, access):
    require_alone(access, 3, "joint_3")
    require_limp(access, 3, "joint_3")
    desk.speechless = {3}
    with pytest.raises(MotorError, match=r"joint_3 \(id 3\) gives no feedback; nothing was changed"):
        require_limp(access, 3, "joint_3")
    desk.fault[2] = 1
    with pytest.raises(MotorError, match=r"joint_2 \(id 2\) is energised; nothing was changed"):
        require_limp(access, 2, "joint_2")
    desk.doubled = {4}
    with pytest.raises(MotorError, match="2 motors answer to id 4; nothing was changed"):
        require_alone(access, 4, "joint_4")
    assert read_contents(access, 9) == {}
