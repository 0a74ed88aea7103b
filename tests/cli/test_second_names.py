"""Beside a plugin that has taken our names, arms are driven by their second names."""

import os

import pytest

from tests.support.plugins import THEIR_TYPES, write_plugin

pytestmark = pytest.mark.alone

ARMS = [
    *("--robot.type=i2rt_yam_follower", "--robot.id=sim", "--robot.interface=yam_sim", "--robot.channel=follower_left"),
    *("--teleop.type=i2rt_yam_leader", "--teleop.id=sim", "--teleop.interface=yam_sim", "--teleop.channel=leader_left"),
    *("--robot.gravity_factor=[1,1,1,1,1,1]", "--teleop.gravity_factor=[1,1,1,1,1,1]"),
    *("--robot.rate_hz=100", "--teleop.rate_hz=100"),
]


@pytest.mark.long
def test_teleoperate_beside_a_plugin_that_has_taken_our_names(commands, monkeypatch):
    site = commands.directory / "site"
    write_plugin(site, "lerobot_robot_theirs", "1.2", "lerobot_robot_theirs", {"__init__.py": THEIR_TYPES})
    monkeypatch.setenv("PYTHONPATH", f"{site}:{os.environ.get('PYTHONPATH', '')}")
    status = commands.run("lerobot-teleoperate", *ARMS, "--teleop_time_s=1")
    assert status == 0, commands.output()[-4000:]
    assert commands.output().count("lerobot_robot_theirs 1.2") == 2  # two names, each said once
    assert "use 'i2rt_yam_follower'" in commands.output()
    stored = commands.directory / "cal" / "robots" / "yam_follower" / "yam"
    assert [path.name for path in stored.iterdir()] == ["sim_gripper.json"]  # where they are by the first name, too
    commands.assert_landed()
