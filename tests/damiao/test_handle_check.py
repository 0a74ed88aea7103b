import pytest

from lerobot_robot_yam.damiao.encoder import EEPROM_REPORT_FREQUENCY_HIGH, EEPROM_REPORT_FREQUENCY_LOW
from lerobot_robot_yam.damiao.handle_check import prepare_handle
from lerobot_robot_yam.errors import MotorError

from .desk_bus import DeskBus


@pytest.fixture
def bus():
    with DeskBus([], handle=True) as desk:
        yield desk


def test_a_handle_that_waits_to_be_asked_is_left_alone(bus):
    info = prepare_handle(bus, "can_leader")
    assert info.firmware == (2, 4, 0)
    assert info.report_frequency_hz == 0
    assert [m.data.hex() for m in bus.sent] == ["ff03", "ff0719", "ff071c"]


def test_a_handle_that_reports_by_itself_is_told_to_wait(bus):
    bus.eeprom[EEPROM_REPORT_FREQUENCY_LOW] = 100
    bus.eeprom[EEPROM_REPORT_FREQUENCY_HIGH] = 0xFF
    assert prepare_handle(bus, "can_leader").report_frequency_hz == 100
    assert bus.sent[-1].data.hex() == "ff0100"
    assert bus.eeprom[EEPROM_REPORT_FREQUENCY_LOW] == 0


def test_no_handle(bus):
    bus.handle = False
    with pytest.raises(MotorError, match="can_leader: the teaching handle did not tell its firmware version"):
        prepare_handle(bus, "can_leader", timeout_s=0.005)


def test_old_firmware(bus):
    bus.firmware = (2, 2, 11)
    with pytest.raises(MotorError, match=r"2\.2\.11.*2\.2\.12"):
        prepare_handle(bus, "can_leader")
