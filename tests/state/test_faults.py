import pytest

from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.state.fault_page import document
from lerobot_robot_yam.state.faults import FAULT_TROUBLE, RESPONSES, Response, Trouble
from lerobot_robot_yam.state.link_faults import LINK_RESPONSES, LinkFault
from tests.support.paths import ROOT

DOCUMENT = ROOT / "docs" / "faults.md"


def test_every_trouble_has_a_rule():
    assert set(RESPONSES) == set(Trouble) and set(LINK_RESPONSES) == set(LinkFault)


def test_the_document_is_what_the_loop_reads():
    assert DOCUMENT.read_text() == document(), "python -m lerobot_robot_yam.state.fault_page > docs/faults.md"


def test_every_fault_code_has_a_trouble():
    assert set(FAULT_TROUBLE) == set(Fault) - {Fault.NORMAL}


@pytest.mark.parametrize("trouble", Trouble)
def test_what_stops_an_arm_says_how_to_bring_it_back(trouble):
    rule = RESPONSES[trouble]
    if rule.arm in (Response.GO_ON, Response.HOLD_UNTIL_TARGET):
        assert not rule.in_place
    else:
        assert any(word in rule.rearm for word in ("connect again", "rearm()", "release", "id", "free"))


def test_a_name_fits_into_its_field_of_the_state():
    assert all(len(trouble.encode()) <= 40 for trouble in Trouble)


def test_every_fault_of_the_link_is_tried():
    source = (ROOT / "tests" / "remote" / "test_link_faults.py").read_text()
    tried = {LinkFault.WORKSTATION_STOP, LinkFault.HOST_STOP}  # by one test, which is given them
    assert {fault for fault in LinkFault if f"check(lab, LinkFault.{fault.name})" in source} | tried == set(LinkFault)
