"""Teleoperators that are not ours drive our followers, as they drive any robot of LeRobot."""

import time

import numpy as np
import pytest

from tests.cli.conftest import commands_on, options, virtual

pytestmark = pytest.mark.alone

FOLLOWER = "follower_left"


commands = commands_on(FOLLOWER)


@pytest.mark.long
def test_a_teleoperator_of_somebody_else_moves_a_follower(commands):
    process = commands.start(
        "lerobot-teleoperate",
        *options(robot=virtual("follower", FOLLOWER)),
        "--teleop.discover_packages_path=tests.teleop_plugin",
        "--teleop.type=swing",
        "--teleop.swing_rad=0.4",
        "--fps=30",
        "--teleop_time_s=10",
    )
    commands.wait_enabled(process, FOLLOWER, timeout_s=120.0)
    seen = []
    while process.poll() is None:
        arm = commands.rig.state()["arms"][FOLLOWER]
        if all(motor["enabled"] for motor in arm["motors"].values()):
            seen.append([*arm["q"], arm["opening"]])
        time.sleep(0.02)
    assert process.returncode == 0, commands.output()[-4000:]
    way = np.array(seen)
    raised = way[np.abs(way[:, 1] - 1.0) < 0.05]
    assert raised[:, 0].min() < -0.3 and raised[:, 0].max() > 0.3
    np.testing.assert_allclose(np.median(raised[:, 6]), 0.5, atol=0.05)
    commands.assert_landed()
