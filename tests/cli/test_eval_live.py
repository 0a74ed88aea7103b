"""Stock lerobot-eval in real time, as on a lab's own arms: whatever ends it, they land."""

import json
import os
import signal
import time

import pytest

from lerobot_robot_yam.rig.client.rig_control import running_rig
from tests.cli.conftest import Commands
from tests.policy_plugin.checkpoints import save_replayed
from tests.support.landed import MOST_M, moved_after_cut_m

pytestmark = pytest.mark.alone

FOLLOWERS = ("follower_left", "follower_right")
PLACES = {
    1: [("", "follower_left")],
    2: [(f"{side}_arm_config.", f"follower_{side}") for side in ("left", "right")],
}


@pytest.fixture
def commands(tmp_path):
    with running_rig(scene="lift_and_place", arms=list(FOLLOWERS)) as rig:
        yield Commands(rig, tmp_path)


def start(commands, arms, *more):
    """A policy that asks for the pose in which the arms are."""
    policy = save_replayed(commands.directory / "policy", arms=arms)
    options = [f"--env.robot.type={'bi_' * (arms - 1)}yam_follower", "--env.robot.id=sim"]
    for place, channel in PLACES[arms]:
        options += [f"--env.robot.{place}interface=yam_sim", f"--env.robot.{place}channel={channel}"]
        options += [f"--env.robot.{place}gravity_factor=[1,1,1,1,1,1]"]
    return commands.start(
        "lerobot-eval",
        "--env.type=yam",
        "--env.task=lift_and_place",
        *options,
        "--env.discover_packages_path=tests.policy_plugin",
        f"--policy.path={policy}",
        "--eval.batch_size=1",
        f"--output_dir={commands.directory / 'out'}",
        *more,
    )


def assert_landed(commands, arms):
    for channel in FOLLOWERS[:arms]:
        assert not any(motor["enabled"] for motor in commands.rig.state()["arms"][channel]["motors"].values())
        assert moved_after_cut_m(commands.rig, channel) < MOST_M, f"{channel} fell"


@pytest.mark.long
def test_episodes_are_paced_and_the_arms_land_in_the_end(commands):
    begin = time.monotonic()
    process = start(commands, 2, "--env.time_limit_s=3", "--eval.n_episodes=2")
    assert commands.finish(process, 120.0) == 0, commands.output()[-4000:]
    assert time.monotonic() - begin > 6.0
    info = json.loads((commands.directory / "out" / "eval_info.json").read_text())
    assert info["per_task"][0]["metrics"]["successes"] == [False, False]
    assert_landed(commands, 2)


@pytest.mark.long
def test_ctrl_c_in_the_middle_of_an_episode_lands_the_arm(commands):
    process = start(commands, 1, "--env.time_limit_s=60", "--eval.n_episodes=1")
    commands.wait_enabled(process, FOLLOWERS[0])
    deadline = time.monotonic() + 60.0
    while commands.rig.task_state().get("seed") is None:  # it has been laid out: the episode begins
        assert time.monotonic() < deadline and process.poll() is None, commands.output()[-4000:]
        time.sleep(0.1)
    time.sleep(2.0)
    os.killpg(process.pid, signal.SIGINT)
    assert commands.finish(process) != 0
    assert_landed(commands, 1)
