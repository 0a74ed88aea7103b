"""What a simulated motor keeps over a power cycle."""

import pytest

from lerobot_robot_yam.damiao import registers
from lerobot_robot_yam.damiao.codec import SpecialCommand
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.damiao.tables import Fault
from tests.support.rig_desk import Desk


@pytest.fixture
def desk():
    desk = Desk(friction=0)
    yield desk
    desk.close()


def write(desk, **values):
    for name, value in values.items():
        desk.send((0x7FF, registers.encode_write(1, Register[name], value)))


def store(desk):
    return desk.send((0x7FF, registers.encode_store(1)))


def cycle(desk):
    """Switch the power off and on."""
    desk.motor(1).power(False)
    desk.motor(1).power(True)


def held(desk, name):
    (answer,) = desk.send((0x7FF, registers.encode_read(1, Register[name])))
    return registers.decode_reply(answer.data).value


def test_what_is_stored_survives_and_the_rest_does_not(desk):
    write(desk, TIMEOUT=5000)
    assert store(desk)
    write(desk, OT_VALUE=90.0)
    cycle(desk)
    assert (held(desk, "TIMEOUT"), held(desk, "OT_VALUE")) == (5000, 100.0)


def test_without_power_it_is_limp_and_silent(desk):
    desk.special(1, SpecialCommand.ENABLE)
    desk.motor(1).power(False)
    assert desk.send((1, SpecialCommand.ENABLE.value)) == []
    assert desk.motor(1).torque_nm == 0
    desk.motor(1).power(True)
    assert desk.mit(1).fault == Fault.DISABLED


def test_firmware_that_reverts_keeps_what_was_written_last(desk):
    desk.motor(1).flash.way = "reverts"
    write(desk, TIMEOUT=5000, OT_VALUE=90.0)
    assert store(desk)
    assert (held(desk, "TIMEOUT"), held(desk, "OT_VALUE")) == (8000, 90.0)


def test_a_power_cut_leaves_half_of_what_was_to_be_stored(desk):
    desk.motor(1).flash.way = "cut"
    write(desk, OT_VALUE=90.0, TIMEOUT=5000)
    assert store(desk) == []
    desk.motor(1).power(True)
    assert (held(desk, "OT_VALUE"), held(desk, "TIMEOUT")) == (90.0, 8000)
