"""A person takes over one arm and then the other while a policy drives (yam_dagger), with the virtual rig.

A LeRobot that takes strategies from plugins runs it by its own command: `scripts/test --lerobot PATH`. With an older
one everything is LeRobot's but the choice of the strategy.
"""

import time

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_strategy_yam.config_yam_dagger import TAKES_PLUGINS
from tests.cli.conftest import CALM, ROOT
from tests.support.rolling import FOLLOWERS, FPS, Rollout, config, data_set, one_arm

pytestmark = pytest.mark.alone

LEFT, RIGHT = FOLLOWERS
STEP_RAD = 1.2 * 1.5 / FPS  # from frame to frame, at a set-point's limit of speed; and of a gripper's stroke


class Shared(Rollout):
    """A rollout that a person shares with a policy."""

    stock = TAKES_PLUGINS  # the command

    def start(self, command, *arguments, cwd=ROOT):
        program = [command] if self.stock else ["-m", "tests.support.strategy_here"]
        super().start(*program, *arguments, cwd=cwd)

    def toggle(self, channel):
        """Press the lower button of a follower's leader, as a thumb does."""
        self.rig.press(channel.replace("follower", "leader"), "record", 0.1)

    def rewind(self):
        """Press the upper button of a handle."""
        self.rig.press("leader_right", "sync", 0.1)

    def gap(self, channel):
        """From a leader to its follower, rad."""
        return float(np.abs(self.joints(channel) - self.joints(channel.replace("follower", "leader"))).max())

    def pull(self, channel, by_rad):
        """Pull the leader of a follower by so much at each of its first three joints."""
        leader = channel.replace("follower", "leader")
        goal = self.joints(leader) + np.array([by_rad] * 3 + [0.0] * 3)
        self.rig.hand(leader, [1.0], [goal.tolist()])

    def presses_s(self):
        """When buttons went down, as the rig has logged it."""
        return [event["monotonic_s"] for event in self.rig.events() if event["kind"] == "button" and event["down"]]


@pytest.fixture
def rollout(commands):
    rollout = Shared(commands)
    yield rollout
    rollout.abandon()


def shared_config(root, **fields):
    """The config of a rollout whose leaders lead and mirror."""
    strategy = {"type": "yam_dagger" if TAKES_PLUGINS else "dagger"}
    document = config("dagger", strategy=strategy, dataset=data_set(root, episode_time_s=600, **fields))
    document["robot"]["cameras"] = {}
    for side in ("left", "right"):
        document["teleop"][f"{side}_arm_config"] |= {"follower": f"follower_{side}", "mirror": True}
    return document


@pytest.mark.long
def test_one_arm_is_taken_over_while_the_policy_drives_the_other(rollout):
    rollout.begin(shared_config(rollout.root), "sines", *CALM, amplitude=0.3)
    rollout.wait_until(lambda: "yam_dagger is ready" in rollout.commands.output(), 200.0)
    rollout.wait_moved(0.15)
    rollout.watch(2.0)
    assert max(map(rollout.gap, FOLLOWERS)) < 0.15  # the leaders go along
    rollout.toggle(LEFT)
    rollout.wait_said("the left arm is taken over")
    rollout.pull(LEFT, 0.4)
    assert rollout.way(RIGHT, 3.0) > 0.2  # the policy goes on
    rollout.wait_until(lambda: rollout.gap(LEFT) < 0.03)
    rollout.toggle(LEFT)
    rollout.wait_said("the left arm is given back")
    rollout.rig.release("leader_left")
    rollout.watch(2.0)
    rollout.toggle(RIGHT)
    rollout.wait_said("the right arm is taken over")
    rollout.toggle(LEFT)  # nothing is left to the policy
    rollout.wait_said("the left arm is taken over", 2)
    rollout.watch(1.0)
    assert max(rollout.way(channel, 1.0) for channel in FOLLOWERS) < 0.05
    for channel in FOLLOWERS:
        rollout.toggle(channel)
    rollout.wait_said("the right arm is given back")
    rollout.watch(1.0)
    rollout.press("\x1b")
    assert rollout.end() == 0, rollout.commands.output()[-4000:]
    rollout.assert_ended_well()

    human, steps = frames(rollout.root)
    edges = np.flatnonzero(np.diff(human)) + 1
    presses_s = rollout.presses_s()
    begin, end, again, end_again = (presses_s[index] for index in (0, 1, 2, 5))
    lengths = FPS * np.diff([begin, end, again, end_again])
    assert np.diff(edges) == pytest.approx(lengths, abs=3), (edges, lengths)  # no frame is missing
    for key, largest in steps.items():
        assert largest.max() < STEP_RAD, (key, largest.round(3), edges)


def frames(root):
    """Of each frame, whether a person had taken over; the largest steps to the next one, rad and of the stroke."""
    table = LeRobotDataset("local/rollout_test", root=root).hf_dataset.with_format("numpy")
    steps = {}
    for key in ("action", "observation.state"):
        steps[key] = np.abs(np.diff(np.stack(table[key]), axis=0)).max(axis=1)
    return np.stack(table["intervention"]).ravel().astype(int), steps


@pytest.mark.long
def test_the_arms_go_back_and_episodes_are_kept_or_dropped(rollout):
    document = shared_config(rollout.root)
    gate = {"gate": "button", "gate_button": "bottom", "gate_together": False}
    document["teleop"]["left_arm_config"] |= gate  # which takes the arm over, and gives it back
    rollout.begin(document, "reach", *CALM, amplitude=0.5)
    rollout.wait_until(lambda: "yam_dagger is ready" in rollout.commands.output(), 200.0)
    start = {channel: rollout.joints(channel) for channel in FOLLOWERS}
    rollout.wait_until(lambda: all(away(rollout, start, channel) > 0.45 for channel in FOLLOWERS))
    rollout.rewind()
    rollout.wait_said("the arms go back along their way")
    rollout.wait_until(lambda: all(away(rollout, start, channel) < 0.15 for channel in FOLLOWERS))
    rollout.toggle(LEFT)
    rollout.wait_said("the left arm is taken over")
    rollout.wait_until(lambda: away(rollout, start, RIGHT) > 0.45)  # the policy tries again
    assert away(rollout, start, LEFT) < 0.3 and rollout.gap(LEFT) < 0.05
    rollout.rewind()
    rollout.wait_said("still taken over by its gate")
    rollout.press("x")
    rollout.wait_said("episode 1 discarded")
    rollout.watch(1.0)
    rollout.press("n")
    rollout.wait_said("episode 1 saved")
    rollout.toggle(LEFT)
    rollout.wait_said("the left arm is given back")
    rollout.wait_until(lambda: away(rollout, start, LEFT) > 0.45)
    rollout.press("\x1b")
    assert rollout.end() == 0, rollout.commands.output()[-4000:]
    rollout.assert_ended_well()
    data = LeRobotDataset("local/rollout_test", root=rollout.root)
    table = data.hf_dataset.with_format("numpy")
    episode, human = np.array(table["episode_index"]), np.stack(table["intervention"]).ravel()
    state = np.delete(np.stack(table["observation.state"]), [6, 13], axis=1)
    assert data.num_episodes == 3
    assert not human[episode == 0].any() and human[episode == 1].all() and human[episode == 2][0]
    assert np.all(np.diff(state[episode == 0][:, 1]) > -0.02)  # the way back is in no episode
    assert not human[episode == 2][-1]


def away(rollout, start, channel):
    """How far a follower is from where it was, rad."""
    return float(np.abs(rollout.joints(channel) - start[channel]).max())


@pytest.mark.long
def test_lerobots_own_dagger_takes_over_without_its_wait(rollout):
    document = shared_config(rollout.root)
    document["strategy"] = {"type": "dagger", "smooth_handover": False, "record_autonomous": True}
    document["teleop"]["buttons"] = "dagger"
    path, rollout.stock = rollout.root, True
    rollout.begin(document, "sines", *CALM, amplitude=0.3)
    rollout.wait_until(lambda: "DAgger strategy ready" in rollout.commands.output(), 200.0)
    rollout.wait_moved(0.15)
    rollout.watch(2.0)
    rollout.toggle(LEFT)  # which corrects: LeRobot pauses first
    rollout.wait_said("Entering correction mode")
    waited_s = time.monotonic() - rollout.presses_s()[0]
    assert waited_s < 0.5
    assert max(map(rollout.gap, FOLLOWERS)) < 0.15
    rollout.watch(1.5)
    rollout.toggle(RIGHT)
    rollout.wait_said("Resuming autonomous mode")
    rollout.watch(1.0)
    rollout.rewind()  # the upper button of the right handle, which stops here
    assert rollout.end() == 0, rollout.commands.output()[-4000:]
    rollout.assert_ended_well()
    assert "Smooth handover" not in rollout.commands.output()
    human, steps = frames(path)
    (begin, _) = edges = np.flatnonzero(np.diff(human)) + 1
    assert steps["observation.state"][begin - 1] < STEP_RAD, (steps, edges)


@pytest.mark.long
def test_one_arm_shared_by_keys_with_a_policy_of_chunks_lands_when_it_ends(rollout):
    rollout.channels = FOLLOWERS[:1]
    document = one_arm(shared_config(rollout.root, num_episodes=2))
    document["inference"] = {"type": "rtc", "queue_threshold": 8}
    rollout.begin(document, "sines", amplitude=0.3)
    rollout.wait_until(lambda: "yam_dagger is ready" in rollout.commands.output(), 200.0)
    rollout.wait_moved(0.15)
    for number in (1, 2):
        rollout.press(" ")
        rollout.wait_said("the arm is taken over", number)
        rollout.pull(LEFT, 0.2)
        rollout.watch(1.5)
        assert rollout.gap(LEFT) < 0.03
        rollout.rig.release("leader_left")
        if number == 1:
            rollout.press(" ")
            rollout.wait_said("the arm is given back")
            assert rollout.way(LEFT, 3.0) > 0.2
            rollout.press("n")
            rollout.wait_said("episode 0 saved")
            rollout.watch(1.0)
    rollout.press("n")  # the second, which is the last
    assert rollout.end() == 0, rollout.commands.output()[-4000:]
    rollout.assert_ended_well()
    human, _ = frames(rollout.root)
    assert np.abs(np.diff(human)).sum() == 3
