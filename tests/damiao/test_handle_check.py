import can
import pytest

from lerobot_robot_yam.damiao import handle_check
from lerobot_robot_yam.damiao.handle_check import prepare_handle
from lerobot_robot_yam.damiao.handle_encoder import (
    EEPROM_ADC_FREQUENCY_LOW,
    EEPROM_REPORT_FREQUENCY_HIGH,
    EEPROM_REPORT_FREQUENCY_LOW,
)
from lerobot_robot_yam.errors import MotorError
from tests.support.desk_bus import DeskBus


@pytest.fixture
def bus():
    with DeskBus([], handle=True) as desk:
        yield desk


def test_a_handle_that_waits_to_be_asked_is_left_alone(bus):
    assert prepare_handle(bus, "can_leader") == ((2, 4, 0), 0)
    assert [m.data.hex() for m in bus.sent] == ["ff03", "ff0719", "ff071c"]


def test_a_handle_that_reports_by_itself_is_told_to_wait(bus):
    bus.eeprom[EEPROM_REPORT_FREQUENCY_LOW] = 100
    bus.eeprom[EEPROM_REPORT_FREQUENCY_HIGH] = 0xFF
    assert prepare_handle(bus, "can_leader")[1] == 100
    assert bus.sent[-1].data.hex() == "ff0100"
    assert bus.eeprom[EEPROM_REPORT_FREQUENCY_LOW] == 0


def test_a_handle_that_goes_on_reporting_is_refused(bus, monkeypatch):
    monkeypatch.setattr(handle_check, "_SILENCE_LIMIT_S", 0.3)
    bus.eeprom[EEPROM_REPORT_FREQUENCY_LOW] = 100
    bus.stubborn = True
    with pytest.raises(MotorError, match="goes on reporting by itself"):
        prepare_handle(bus, "can_leader")


def test_what_others_say_is_no_report_of_the_handle(bus):
    bus.eeprom[EEPROM_REPORT_FREQUENCY_LOW] = 100
    bus.chatter = can.Message(arbitration_id=0x123, data=b"hello", is_extended_id=False)
    assert prepare_handle(bus, "can_leader")[1] == 100


@pytest.mark.parametrize(("firmware", "told"), [((2, 3, 0), True), ((2, 4, 0), False)])
def test_an_older_handle_is_told_to_sample_as_fast_as_it_can(bus, firmware, told):
    bus.firmware, bus.eeprom[EEPROM_ADC_FREQUENCY_LOW] = firmware, 10
    prepare_handle(bus, "can_leader")
    assert (bus.eeprom[EEPROM_ADC_FREQUENCY_LOW] == 255) == told
    sent = len(bus.sent)
    prepare_handle(bus, "can_leader")
    assert not [m for m in bus.sent[sent:] if m.data[1] == 0x04]  # it remembers


def test_no_handle(bus):
    bus.handle = False
    with pytest.raises(MotorError, match="can_leader: the teaching handle did not tell its firmware version"):
        prepare_handle(bus, "can_leader", timeout_s=0.005)


def test_old_firmware(bus):
    bus.firmware = (2, 2, 11)
    with pytest.raises(MotorError, match=r"2\.2\.11.*2\.2\.12"):
        prepare_handle(bus, "can_leader")
