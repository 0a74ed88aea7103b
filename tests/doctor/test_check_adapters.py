"""Names of CAN adapters, on directory trees laid out as sysfs is."""

import pytest

from lerobot_robot_yam.doctor.check_adapters import check_adapters, read_rules
from lerobot_robot_yam.doctor.kit.findings import Section, Severity
from lerobot_robot_yam.system.own_commands import as_root
from lerobot_robot_yam.system.sysfs import read_adapters
from tests.support.doctor_desk import RULE, Sysfs

NAMING = as_root("yam-setup-can --no-rights")


@pytest.fixture
def sysfs(tmp_path):
    return Sysfs(tmp_path / "sys")


def check(sysfs, rules=()):
    adapters = read_adapters(sysfs.root)
    section = Section("adapters")
    check_adapters(adapters, [adapter.name for adapter in adapters], rules, section)
    return section


def test_adapters_with_names_by_serial_number(sysfs):
    sysfs.adapter("can_follower_l", "1-2.1", serial="0031AAAA")
    sysfs.adapter("can_follower_r", "1-2.2", serial="0031BBBB")
    rules = [f'{RULE}ATTRS{{serial}}=="0031AAAA", NAME="can_follower_l"']
    section = check(sysfs, rules)
    assert section.findings == []
    first, second = section.rows
    assert (first["serial"], first["port"], first["driver"]) == ("0031AAAA", "1-2.1:1.0", "gs_usb")
    assert (first["named_by"], second["named_by"]) == ("serial number", None)  # no rule: unknown, not guessed


def test_names_by_order_of_discovery(sysfs):
    sysfs.adapter("can0", "1-2.1", serial="0031AAAA")
    sysfs.adapter("can1", "1-2.2", serial="0031BBBB")
    section = check(sysfs)
    assert [f.severity for f in section.findings] == [Severity.WARNING] * 2
    assert all(f.remedy == NAMING for f in section.findings)


def test_one_adapter_alone_cannot_be_swapped(sysfs):
    sysfs.adapter("can0", "1-2.1", serial="0031AAAA")
    assert [f.severity for f in check(sysfs).findings] == [Severity.NOTE]


def test_equal_serial_numbers(sysfs):
    sysfs.adapter("can_follower_l", "1-2.1", serial="0001")
    sysfs.adapter("can_follower_r", "1-2.2", serial="0001")
    rules = [f'{RULE}ATTRS{{serial}}=="0001", NAME="can_follower_l"']
    problems = check(sysfs, rules).findings
    assert [f.where for f in problems] == ["can_follower_l", "can_follower_r"]
    assert all(f.severity is Severity.PROBLEM and "0001" in f.what for f in problems)
    assert problems[0].remedy == f"{NAMING} can_follower_l"
    ports = [f'{RULE}KERNELS=="1-2.{i}:1.0", NAME="can_follower_{side}"' for i, side in ((1, "l"), (2, "r"))]
    assert check(sysfs, ports).findings == []


def test_two_channels_of_one_adapter_share_a_serial_number(sysfs):
    sysfs.adapter("can_follower_l", "1-2", serial="0001")
    sysfs.adapter("can0", "1-2", serial="0001", number="0x1")
    (finding,) = check(sysfs).findings
    assert finding.where == "can0" and finding.severity is Severity.WARNING
    assert finding.remedy == NAMING


def test_two_channels_that_an_old_kernel_does_not_tell_apart(sysfs):
    sysfs.adapter("can_follower_l", "1-2", serial="0001")
    sysfs.adapter("can_follower_r", "1-2", serial="0001")
    problems = check(sysfs).findings
    assert [f.where for f in problems] == ["can_follower_l", "can_follower_r"]
    assert all(f.severity is Severity.PROBLEM and "Linux 6.1" in f.remedy for f in problems)
    assert "from can_follower_r, another channel" in problems[0].what


def test_rules_are_read_without_comments(tmp_path):
    (tmp_path / "90-yam-can.rules").write_text('# NAME="can9"\n\nSUBSYSTEM=="net", NAME="can_follower_l"\n')
    assert read_rules([tmp_path, tmp_path / "missing"]) == ["", 'SUBSYSTEM=="net", NAME="can_follower_l"']


def test_other_interfaces_and_vcan(sysfs):
    for name, kind in (("eth0", "1"), ("vcan0", "280")):
        (sysfs.root / "class/net" / name).mkdir()
        (sysfs.root / "class/net" / name / "type").write_text(f"{kind}\n")
    section = check(sysfs)
    assert [row["name"] for row in section.rows] == ["vcan0"]
    assert section.rows[0]["driver"] is None and section.findings == []
