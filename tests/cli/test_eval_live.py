"""Stock lerobot-eval in real time, as on a lab's own arms, here or over the link: whatever ends it, they land."""

import contextlib
import json
import os
import signal
import time

import numpy as np
import pytest

from lerobot_robot_yam.rig.control import running_rig
from tests.cli.conftest import Commands
from tests.policy_plugin.checkpoints import save_scripted
from tests.support.hosted import rig_file, running_host
from tests.support.landed import MOST_M, moved_after_cut_m

pytestmark = [pytest.mark.alone, pytest.mark.long]

FOLLOWERS = ("follower_left", "follower_right")
PLACES = {
    1: [("", "follower_left")],
    2: [(f"{side}_arm_config.", f"follower_{side}") for side in ("left", "right")],
}
LOW, HIGH = ([0.0, joint_2, 0.6, 0.0, 0.0, 0.0, 0.5] for joint_2 in (0.2, 0.9))


def raised(observation):
    """A judge: an arm is up."""
    return True if any(seen > 0.6 for key, seen in observation.items() if key.endswith("joint_2.pos")) else None


class Evaluation:
    """lerobot-eval on a rig; over the link the workstation has a runtime directory of its own.

    Attributes:
        success: who judges: over the link no rig can be asked.
    """

    def __init__(self, commands, over_link):
        self.commands, self.rig, self.over_link = commands, commands.rig, over_link
        self.success = f"{__name__}:raised" if over_link else "rig"
        self._ends = contextlib.ExitStack()

    def start(self, arms, *more, success=None, actions=""):
        """A policy that does what the file `actions` says, or asks for the pose in which the arms are."""
        commands = self.commands
        policy = save_scripted(commands.directory / "policy", "replay", arms=arms, actions=actions)
        return commands.start(
            "lerobot-eval",
            "--env.type=yam",
            "--env.task=lift_and_place",
            f"--env.success={success or self.success}",
            *(self._remote(arms) if self.over_link else self._local(arms)),
            "--env.discover_packages_path=tests.policy_plugin",
            f"--policy.path={policy}",
            "--eval.batch_size=1",
            f"--output_dir={commands.directory / 'out'}",
            *more,
        )

    def _local(self, arms):
        options = [f"--env.robot.type={'bi_' * (arms - 1)}yam_follower", "--env.robot.id=sim"]
        for place, channel in PLACES[arms]:
            options += [f"--env.robot.{place}interface=yam_sim", f"--env.robot.{place}channel={channel}"]
            options += [f"--env.robot.{place}gravity_factor=[1,1,1,1,1,1]"]
        return options

    def _remote(self, arms):
        directory = self.commands.directory
        file = rig_file(directory, self.rig, FOLLOWERS[:arms])
        host = self._ends.enter_context(running_host(file, directory))
        workstation = directory / "ws"
        workstation.mkdir(mode=0o700)
        self._ends.enter_context(pytest.MonkeyPatch.context()).setenv("YAM_RUNTIME_DIR", str(workstation))
        return [f"--env.robot.type={'bi_' * (arms - 1)}yam_remote", f"--env.robot.host={host.address}"]

    def successes(self):
        """Of its episodes, as lerobot-eval tells them."""
        info = json.loads((self.commands.directory / "out" / "eval_info.json").read_text())
        return info["per_task"][0]["metrics"]["successes"]

    def assert_landed(self, arms):
        for channel in FOLLOWERS[:arms]:
            assert not any(motor["enabled"] for motor in self.rig.state()["arms"][channel]["motors"].values())
            assert moved_after_cut_m(self.rig, channel) < MOST_M, f"{channel} fell"
        if self.over_link:
            assert not list((self.commands.directory / "ws").iterdir())

    def close(self):
        self._ends.close()


@pytest.fixture(params=[False, True], ids=["here", "over the link"])
def evaluation(request, tmp_path):
    with running_rig(scene="lift_and_place", arms=list(FOLLOWERS)) as rig:
        with contextlib.closing(Commands(rig, tmp_path)) as commands:
            with contextlib.closing(Evaluation(commands, request.param)) as evaluation:
                yield evaluation


def test_episodes_are_paced_and_the_arms_land_in_the_end(evaluation):
    begin = time.monotonic()
    process = evaluation.start(2, "--env.time_limit_s=3", "--eval.n_episodes=2")
    assert evaluation.commands.finish(process, 120.0) == 0, evaluation.commands.output()[-4000:]
    assert time.monotonic() - begin > 6.0
    assert evaluation.successes() == [False, False]
    evaluation.assert_landed(2)


def test_a_policy_moves_the_arms_and_a_function_judges(evaluation):
    actions = evaluation.commands.directory / "actions.npz"
    np.savez(actions, **{str(episode): np.array([pose], np.float32) for episode, pose in enumerate((LOW, HIGH))})
    more = [f"--env.reset_pose={LOW}".replace(" ", ""), "--env.time_limit_s=4", "--eval.n_episodes=2"]
    process = evaluation.start(1, *more, success=f"{__name__}:raised", actions=str(actions))
    assert evaluation.commands.finish(process, 120.0) == 0, evaluation.commands.output()[-4000:]
    assert evaluation.successes() == [False, True]
    evaluation.assert_landed(1)


def test_ctrl_c_in_the_middle_of_an_episode_lands_the_arm(evaluation):
    commands = evaluation.commands
    process = evaluation.start(1, "--env.time_limit_s=60", "--eval.n_episodes=1")
    commands.wait_enabled(process, FOLLOWERS[0])
    if not evaluation.over_link:
        commands.wait(lambda: evaluation.rig.task_state().get("seed") is not None, process, 60.0)  # the episode begins
    time.sleep(3.0)
    os.killpg(process.pid, signal.SIGINT)
    assert commands.finish(process) != 0
    evaluation.assert_landed(1)
