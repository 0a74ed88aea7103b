"""A handle that does not take or tell what it should."""

import pytest

from lerobot_robot_yam.damiao import handle_encoder
from lerobot_robot_yam.damiao.settings.handle_access import HandleAccess
from lerobot_robot_yam.errors import MotorError
from tests.support.desk_bus import SPECS, DeskBus


@pytest.fixture
def desk():
    with DeskBus(SPECS, handle=True) as bus:
        yield bus


@pytest.fixture
def handle(desk):
    return HandleAccess(desk, "desk")


def test_a_setting_that_is_not_taken_is_told(desk, handle):
    desk.eeprom[handle_encoder.EEPROM_REPORT_FREQUENCY_LOW] = 100
    desk.stubborn = True
    with pytest.raises(MotorError, match="reports 100 times a second, not 0; switch the arm's power off and on"):
        handle.set_report_frequency(0)


def test_a_setting_that_is_so_already_is_not_sent(desk, handle):
    desk.sent.clear()
    handle.set_report_frequency(0)
    assert {bytes(message.data)[1] for message in desk.sent} == {handle_encoder.OP_READ_EEPROM}


def test_a_zero_that_is_not_taken_is_told(desk, handle):
    desk.handle_data = handle_encoder.encode_report(0.3, 0.0, (False, False))
    with pytest.raises(MotorError, match=r"the trigger reads \+0.301 rad after its zero was set; let go of it"):
        handle.set_zero()


def test_a_handle_that_tells_only_half_is_named(desk, handle):
    desk.handle_data = b"\x01"
    with pytest.raises(MotorError, match="does not report its trigger"):
        handle.report()
    desk.handle = False
    with pytest.raises(MotorError, match="does not tell EEPROM byte 9"):
        handle.eeprom(handle_encoder.EEPROM_ZERO_HIGH)
    with pytest.raises(MotorError, match="no teaching handle answers"):
        handle.firmware()
