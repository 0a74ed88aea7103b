"""lerobot-teleoperate with a leader without motors: gate, approach by the follower, and the loss of an encoder."""

import time

import numpy as np
import pytest

from tests.cli.conftest import commands_on, options, virtual
from tests.support.waiting import wait

pytestmark = pytest.mark.alone

LEADER, FOLLOWER = "leader_left", "follower_left"
HOME, THERE = [0.0] * 6, [0.3, 1.1, 1.0, -0.3, 0.1, 0.2]


commands = commands_on(FOLLOWER, LEADER, driven=(FOLLOWER,), scene="passive_leaders")


def teleoperate(commands, *more):
    leader = virtual("passive_leader", LEADER)
    del leader["gravity_factor"]
    arms = options(robot=virtual("follower", FOLLOWER), teleop=leader)
    process = commands.start("lerobot-teleoperate", *arms, *more)
    commands.wait_enabled(process, FOLLOWER, timeout_s=120.0)
    return process


def joints(rig, channel):
    return np.array(rig.state()["arms"][channel]["q"])


def wait_near(commands, process, pose, within_rad=0.06, timeout_s=20.0):
    """Wait until the follower is there."""
    commands.wait(lambda: np.abs(joints(commands.rig, FOLLOWER) - pose).max() <= within_rad, process, timeout_s)


@pytest.mark.long
def test_a_lift_engages_and_a_lost_encoder_ends_it(commands):
    rig = commands.rig
    rig.lift(LEADER, HOME, 1.0)
    process = teleoperate(commands, f"--teleop.follower={FOLLOWER}", "--teleop.gate=auto", "--fps=30")
    wait_near(commands, process, HOME)
    rig.lift(LEADER, THERE, 1.5, trigger=1.0)
    wait_near(commands, process, THERE)
    wait(lambda: "approach -> engaged" in commands.output(), 10.0, commands.output)  # the blend ends after the way does
    assert "idle -> approach" in commands.output()
    time.sleep(1.0)
    np.testing.assert_allclose(joints(rig, FOLLOWER), joints(rig, LEADER), atol=0.05)
    assert rig.state()["arms"][FOLLOWER]["opening"] < 0.1

    rig.fault(LEADER, None, "encoders_silent", [1])
    assert commands.finish(process, 90.0) != 0
    assert f"leader ({LEADER}): newest state is" in commands.output()
    assert "nothing is heard of joint_2" in commands.output()
    commands.assert_landed()
