"""The simulated teaching-handle encoder."""

import pytest

from lerobot_robot_yam.damiao import handle_encoder
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
