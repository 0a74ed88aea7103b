"""Whether the doctor finds out that this computer may go to sleep."""

import pytest

from lerobot_robot_yam.doctor import check_host
from lerobot_robot_yam.doctor.kit.findings import Section
from lerobot_robot_yam.system.sysfs import SYSFS


@pytest.mark.parametrize(
    ("states", "masked", "may_sleep"),
    [
        ("freeze mem disk\n", False, True),
        ("freeze mem disk\n", True, False),
        ("\n", False, False),
        (None, False, False),
    ],
)
def test_a_computer_that_may_sleep_is_warned_of(monkeypatch, tmp_path, states, masked, may_sleep):
    monkeypatch.setattr(check_host, "_STATES", tmp_path / "state")
    monkeypatch.setattr(check_host, "_SUSPEND", tmp_path / "suspend.target")
    monkeypatch.setattr(check_host, "_granted", lambda: "everything")
    if states is not None:
        (tmp_path / "state").write_text(states)
    if masked:
        (tmp_path / "suspend.target").symlink_to("/dev/null")
    section = Section("this computer")
    check_host.check_host(SYSFS, section)
    assert ("systemctl mask sleep.target" in repr(vars(section))) is may_sleep
