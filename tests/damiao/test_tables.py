import pytest

from lerobot_robot_yam.damiao.tables import Fault, ReceiveMode, fault_text


@pytest.mark.parametrize(("mode", "expected"), [("p16", 23), ("same", 7), ("zero", 0), ("plus_one", 8)])
def test_receive_modes(mode, expected):
    assert ReceiveMode(mode).feedback_id(7) == expected


def test_every_fault_reads_as_text():
    texts = {fault_text(code) for code in Fault}
    assert len(texts) == len(Fault)
    assert fault_text(0xD) == fault_text(Fault.COMMUNICATION_LOST)
    assert "watchdog" in fault_text(0xD)


def test_an_undocumented_fault_is_still_shown():
    assert fault_text(0x5) == "0x5 unknown code"
