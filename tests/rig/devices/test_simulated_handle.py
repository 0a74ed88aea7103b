"""The simulated teaching-handle encoder."""

import pytest

from lerobot_robot_yam.damiao import handle_encoder
from lerobot_robot_yam.rig.devices.simulated_handle import SimHandle
from tests.support.rig_desk import Desk


@pytest.mark.parametrize("trigger", [0.0, 0.5, 1.0])
def test_a_report_carries_trigger_and_buttons(trigger):
    handle = SimHandle()
    handle.trigger = trigger
    handle.press((False, True))
    frame = handle.request(handle_encoder.encode_report_request())
    report = handle_encoder.decode_report(frame.data)
    assert frame.id == handle_encoder.REPORT_ID
    assert report.trigger == pytest.approx(trigger, abs=2e-3)
    assert report.buttons == (False, True)


def test_version_and_settings_are_as_drivers_require():
    handle = SimHandle()
    version = handle_encoder.decode_version(handle.request(handle_encoder.encode_version_request()).data)
    assert version >= handle_encoder.FIRMWARE_REQUIRED
    frequency = [
        handle_encoder.decode_eeprom_byte(handle.request(handle_encoder.encode_eeprom_read(offset)).data)
        for offset in (handle_encoder.EEPROM_REPORT_FREQUENCY_LOW, handle_encoder.EEPROM_REPORT_FREQUENCY_HIGH)
    ]
    assert handle_encoder.decode_frequency(*frequency) == 0


def test_reports_come_unasked_at_the_frequency_set():
    desk = Desk("leader_left")
    assert desk.send((handle_encoder.REQUEST_ID, handle_encoder.encode_report_frequency(50))) == []
    desk.run(1.0)
    assert len(desk.heard()) == pytest.approx(50, abs=3)
    desk.send((handle_encoder.REQUEST_ID, handle_encoder.encode_report_frequency(0)))
    desk.heard()
    desk.run(0.2)
    assert desk.heard() == []
    desk.close()


def test_a_button_edge_is_an_event_when_events_are_on():
    handle = SimHandle()
    assert handle.press((True, False)) is None
    handle.request(bytes((handle_encoder.ALL_DEVICES, 0x05, 0x03)))
    assert handle.press((True, False)) is None  # no edge
    event = handle.press((False, False))
    assert event.id == handle_encoder.EVENT_ID
    assert handle_encoder.decode_report(event.data).buttons == (False, False)


def test_another_device_or_a_silent_one_does_not_answer():
    handle = SimHandle()
    assert handle.request(bytes((7, handle_encoder.OP_REPORT))) is None
    handle.silent = True
    assert handle.request(handle_encoder.encode_report_request()) is None
