"""The unit that brings links up, as systemd reads it, and the same by hand."""

import shutil
import subprocess

import pytest

from lerobot_robot_yam.doctor.check_link import NO_RESTART
from lerobot_robot_yam.setup.link_unit import UNIT_TEXT, bring_up
from lerobot_robot_yam.system.sysfs import read_adapters
from tests.support.doctor_desk import Sysfs


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_systemd_takes_the_unit(tmp_path):
    unit = tmp_path / "yam-can@can_follower_l.service"
    unit.write_text(UNIT_TEXT)
    done = subprocess.run(["systemd-analyze", "verify", unit], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    unit.write_text(UNIT_TEXT.replace("Type=oneshot", "Type=nothing"))
    assert subprocess.run(["systemd-analyze", "verify", unit], capture_output=True, timeout=60).stderr


@pytest.mark.parametrize("driver", ["gs_usb", "peak_usb"])
def test_by_hand_a_link_gets_what_the_unit_gives_it(tmp_path, driver):
    sysfs = Sysfs(tmp_path)
    sysfs.adapter("can_x", "1-1", kernel_driver=driver)
    commands = [" ".join(command) for command in bring_up(*read_adapters(tmp_path))]
    unit = UNIT_TEXT.replace("%i", "can_x")
    assert all(command in unit for command in commands)
    assert len(commands) == (2 if driver in NO_RESTART else 3)
