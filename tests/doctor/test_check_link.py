"""Interface states, on the recorded output of the system's own tools (see recorded/README.md)."""

import json
from dataclasses import replace

import pytest

from lerobot_robot_yam.doctor.check_link import IP_COMMAND, check_links, parse_links, tool_output
from lerobot_robot_yam.doctor.kit.findings import Section, Severity
from lerobot_robot_yam.system.own_commands import as_root
from tests.support.doctor_desk import RECORDED, recorded

RESET = as_root("yam-setup-can --reset can_follower_l")
AGAIN = (
    "sudo ip link set can_follower_l down && sudo ip link set can_follower_l up txqueuelen 100 type can bitrate 1000000"
)
PROBLEMS = {
    "down": ("down", RESET),
    "bus_off": ("bus-off", RESET),
    "error_passive": ("transmit errors 128", "switch the arm's power on"),
    "bitrate": ("500000 instead of 1000000", RESET),
    "fixed_bitrate": ("500000 instead of 1000000", RESET),
    "can_fd": ("CAN FD is on", f"{AGAIN} fd off restart-ms 100"),
    "listen_only": ("listen-only", f"{AGAIN} listen-only off"),
    "no_buffer": ("no buffer space: 10 frames wait", RESET),
}
WARNINGS = {
    "bus_off": ("restart-ms is 0", RESET),
    "error_warning": ("error-warning", "terminators"),
    "no_buffer": ("4211 refused by a full queue", "power"),
    "generic_names": ("holds only 10 frames", "sudo ip link set can1 txqueuelen 100"),
    "restart_refused": ("which gs_usb cannot do", "restart-ms 0"),
}


def check(name):
    links = parse_links(recorded(name), recorded(name, "tc"))
    section = Section("interfaces")
    check_links(links, [link.name for link in links], section)
    return links, section


def test_healthy_interfaces_have_no_findings():
    links, section = check("healthy")
    assert [link.name for link in links] == ["can_follower_l", "can_follower_r", "can_leader_l", "can_leader_r"]
    assert section.findings == []
    assert all(link.usable for link in links)
    assert section.rows[0]["state"] == "ERROR-ACTIVE" and section.rows[0]["device"] == "1-2.1:1.0"


@pytest.mark.parametrize("name", PROBLEMS)
def test_a_bad_state_is_a_problem_with_its_command(name):
    what, remedy = PROBLEMS[name]
    (problem,) = [f for f in check(name)[1].findings if f.severity is Severity.PROBLEM]
    assert problem.where == "can_follower_l"
    assert what in problem.what
    assert problem.remedy == remedy or (not remedy.startswith("sudo") and remedy in problem.remedy)


@pytest.mark.parametrize("name", WARNINGS)
def test_a_doubtful_state_is_a_warning(name):
    what, remedy = WARNINGS[name]
    (warning,) = [f for f in check(name)[1].findings if f.severity is Severity.WARNING and what in f.what]
    assert remedy in warning.remedy


@pytest.mark.parametrize("name", ["down", "bus_off", "bitrate", "listen_only", "no_buffer"])
def test_motors_are_not_asked_through_an_interface_in_such_a_state(name):
    assert not check(name)[0][0].usable


def test_no_gs_usb_adapter_is_told_to_restart_by_itself():
    """Its driver cannot: the kernel would refuse the whole command, or crash at bus-off."""
    for path in RECORDED.glob("*.ip.json"):
        for link in parse_links(path.read_text()):
            command = replace(link, modes=("FD",)).repair()
            assert ("restart-ms" in command) == (link.driver in ("mcp251xfd", "peak_canfd"))


def test_only_wanted_interfaces_have_findings():
    section = Section("interfaces")
    check_links(parse_links(recorded("down")), ["can_other"], section)
    assert section.findings == [] and len(section.rows) == 1


def test_without_the_queue_tool_its_numbers_are_unknown():
    (link,) = parse_links(recorded("no_buffer"))
    assert link.waiting is None and link.refused is None and link.usable


@pytest.mark.parametrize("text", ["", "[{},{}]", "[]"])
def test_no_interface(text):
    assert parse_links(text) == []


@pytest.mark.parametrize("text", ["{}", "[1]", "no json"])
def test_what_is_not_the_tools_output_is_refused(text):
    with pytest.raises(ValueError):
        parse_links(text)


def test_the_tool_of_this_computer_can_be_read():
    text, reason = tool_output(IP_COMMAND)
    if text is None:
        assert reason
    else:
        assert isinstance(parse_links(text), list)
        json.loads(text or "[]")


def test_a_missing_tool_is_said():
    text, reason = tool_output(("yam-no-such-tool",))
    assert text is None and "yam-no-such-tool" in reason
