"""The simulated teaching-handle encoder."""

import pytest

from lerobot_robot_yam.damiao import handle_encoder
from lerobot_robot_yam.rig.devices.simulated_handle import SimHandle
from tests.support.rig_desk import Desk


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
