"""lerobot-rollout on the virtual rig: every strategy with both inference engines, on two arms and on one.

What each of them does to the arms is judged by the rig. The default tier runs one, `-m long` all of them.
"""

import itertools
import os
import signal
import time

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from scripts import recorders
from tests.cli.test_record import BI_KEYS, KEYS
from tests.policy_plugin.checkpoints import statistics
from tests.support.recordings import KEYS as ACTION_KEYS
from tests.support.rolling import FOLLOWERS, FPS, Rollout, config, data_set, one_arm

pytestmark = pytest.mark.alone

LEADERS = ("leader_left", "leader_right")
AMPLITUDE_RAD = 0.3
TOOL_KEYS = ACTION_KEYS["ee"]
SECONDS = 6.0  # a first inference can take a while
RTC = {"type": "rtc", "queue_threshold": 8}
INFERENCES = {"sync": {"type": "sync"}, "rtc": RTC}
STRATEGIES = ("base", "sentry", "highlight", "episodic", "dagger")
LONG = pytest.mark.long
MATRIX = [
    pytest.param(*case, id="-".join(map(str, case))) for case in itertools.product(STRATEGIES, INFERENCES, (1, 2))
]


@pytest.fixture
def rollout(commands, request):
    """On so many arms (2 where a test does not say)."""
    rollout = Rollout(commands, FOLLOWERS[: getattr(request, "param", 2)])
    yield rollout
    rollout.abandon()


def records(root, episodes):
    """The data set of a rollout; its numbers are finite and have moved."""
    data = LeRobotDataset("local/rollout_test", root=root)
    assert data.num_episodes == episodes and data.fps == FPS
    table = data.hf_dataset.with_format("numpy")
    rows = {key: np.stack(table[key]) for key in ("action", "observation.state")}
    assert len(data) > 1.0 * FPS
    for values in rows.values():
        assert np.isfinite(values).all() and 0.1 < np.ptp(values, axis=0)[:6].max() < 2 * AMPLITUDE_RAD
    return data


@LONG
@pytest.mark.parametrize("strategy, inference, rollout", MATRIX, indirect=["rollout"])
def test_every_strategy_moves_the_arms_and_lands_them(rollout, strategy, inference):
    document = config("dagger" if strategy == "dagger" else "rollout", inference=INFERENCES[inference])
    document["strategy"] = {"type": strategy}
    if strategy != "base":
        document["dataset"] = data_set(rollout.root, num_episodes=2, episode_time_s=3, reset_time_s=1)
    if strategy in ("base", "sentry"):
        document["duration"] = SECONDS
    if len(rollout.channels) == 1:
        document = one_arm(document)
    rollout.begin(document, "sines", amplitude=AMPLITUDE_RAD)
    if strategy == "highlight":
        rollout.wait_moved(0.15)
        rollout.press("s")  # keep what was, and what comes
        rollout.wait_said("Flushing ring buffer")
        rollout.watch(1.5)
        rollout.press("s")
        rollout.wait_said("Episode saved")
        rollout.press("\x1b")
    if strategy == "dagger":
        rollout.wait_moved(0.15)
        correct(rollout, 1)
        rollout.wait_said("Resuming autonomous mode")
        rollout.watch(1.5)
        correct(rollout, 2)
    assert rollout.end() == 0, rollout.commands.output()[-4000:]
    rollout.assert_moved(0.15)
    rollout.assert_ended_well()
    if strategy != "base":
        data = records(rollout.root, episodes={"sentry": 1, "highlight": 1}.get(strategy, 2))
        assert list(data.features["action"]["names"]) == (KEYS if len(rollout.channels) == 1 else BI_KEYS)


def correct(rollout, number):
    """Pause the policy, lead the arms by hand for a while, and hand them back; for the so-manieth time."""
    rollout.press(" ")
    rollout.wait_said("Smooth handover: moving leader", number)
    rollout.watch(2.5)
    rollout.press("\t")
    rollout.wait_said("Entering correction mode", number)
    push_leaders(rollout, 0.2)
    rollout.watch(2.0)
    rollout.press("\t")
    rollout.wait_said("Phase transition: correcting -> paused", number)
    for channel in rollout.channels:
        rollout.rig.release(channel.replace("follower", "leader"))
    rollout.press(" ")


def push_leaders(rollout, by_rad, trigger=0.0):
    """Pull each leader away from where it is, as a hand would that squeezes its trigger so far."""
    for channel in rollout.channels:
        leader = channel.replace("follower", "leader")
        goal = rollout.joints(leader) + np.array([by_rad, by_rad, by_rad, 0.0, 0.0, 0.0])
        rollout.rig.hand(leader, [1.0], [goal.tolist()], trigger)


# DAgger, step by step


def gap(rollout, channel):
    """Largest distance of a follower from its leader, rad."""
    return float(np.abs(rollout.joints(channel) - rollout.joints(channel.replace("follower", "leader"))).max())


def openings(rollout):
    return np.array([rollout.rig.state()["arms"][channel]["opening"] for channel in rollout.channels])


@LONG
def test_dagger_hands_the_arms_over_and_takes_them_back(rollout):
    for leader in LEADERS:
        recorders.watch_start(rollout.rig, leader)
    strategy = {"type": "dagger", "record_autonomous": True}
    rollout.begin(config("dagger", strategy=strategy, dataset=data_set(rollout.root)), "reach", amplitude=0.5)
    rollout.wait_moved(0.49)
    rollout.watch(1.0)
    policy = {channel: rollout.joints(channel) for channel in FOLLOWERS}
    assert all(gap(rollout, channel) > 0.4 for channel in FOLLOWERS)  # the leaders have stayed where they were

    rollout.press(" ")  # pause: each leader is led to its follower
    rollout.wait_said("Smooth handover: moving leader arm to follower position")
    rollout.wait_until(lambda: all(gap(rollout, channel) < 0.05 for channel in FOLLOWERS))
    rollout.assert_within_speed(LEADERS)
    held = openings(rollout)
    assert np.all(held < 0.8)

    rollout.press("\t")  # correct: the leaders float, the followers follow; nothing jumps, nothing is dropped
    rollout.wait_said("Entering correction mode")
    rollout.watch(1.0)
    for channel in FOLLOWERS:
        assert np.abs(rollout.joints(channel) - policy[channel]).max() < 0.08
    assert openings(rollout) == pytest.approx(held, abs=0.05)  # though the triggers are released
    push_leaders(rollout, 0.35, trigger=0.95)
    for channel in FOLLOWERS:  # a light hand moves both
        rollout.wait_until(lambda c=channel: np.abs(rollout.joints(c) - policy[c])[:3].min() > 0.25)
    rollout.wait_until(lambda: np.all(openings(rollout) < 0.1))  # the triggers were squeezed past what was held
    rollout.watch(1.0)
    assert all(gap(rollout, channel) < 0.06 for channel in FOLLOWERS)

    rollout.press("\t")  # pause: the leaders hold
    rollout.wait_said("Phase transition: correcting -> paused")
    rollout.watch(0.5)
    corrected = {channel: rollout.joints(channel) for channel in FOLLOWERS}
    for leader in LEADERS:
        rollout.rig.release(leader)
    rollout.watch(1.0)
    assert all(np.abs(rollout.joints(channel) - corrected[channel]).max() < 0.05 for channel in FOLLOWERS)

    rollout.press(" ")  # the policy takes over from where the human has left the arms
    rollout.wait_said("Resuming autonomous mode")
    rollout.wait_until(lambda: all(np.abs(rollout.joints(c) - policy[c]).max() < 0.05 for c in FOLLOWERS))
    rollout.watch(1.0)
    rollout.press("\x1b")
    assert rollout.end() == 0, rollout.commands.output()[-4000:]
    rollout.assert_ended_well()
    assert_labelled(rollout.root)


def assert_labelled(root):
    """One stretch of frames is the human's; in it, and only in it, actions leave what the policy wants."""
    data = LeRobotDataset("local/rollout_test", root=root)
    table = data.hf_dataset.with_format("numpy")
    human = np.stack(table["intervention"]).ravel()
    action = np.stack(table["action"])[:, [1, 2, 8, 9]]
    assert 10 < human.sum() < len(human) - 20 and np.abs(np.diff(human.astype(int))).sum() == 2
    reached = action[~human].max(axis=0)
    assert np.all(action[human].max(axis=0) > reached + 0.2)


# policies that misbehave

ENDS = ("nan", "short")  # before its time


@pytest.mark.parametrize(
    "inference, behaviour, status, says",
    [
        pytest.param("sync", "jumps", 0, "it follows at its speed limit", id="jumps-sync", marks=LONG),
        pytest.param("rtc", "jumps", 0, "it follows at its speed limit", id="jumps-rtc", marks=LONG),
        pytest.param("sync", "nan", 1, "left_joint_2.pos is nan; nothing was sent", id="nan-sync", marks=LONG),
        pytest.param("rtc", "nan", 1, "left_joint_2.pos is nan; nothing was sent", id="nan-rtc", marks=LONG),
        pytest.param("sync", "short", 1, "must match the size of tensor", id="short-sync", marks=LONG),
        pytest.param("rtc", "short", 0, "Fatal error in RTC thread", id="short-rtc", marks=LONG),
        pytest.param("sync", "slow", 0, "no target for 0.5 s; it holds", id="slow-sync", marks=LONG),
        pytest.param("rtc", "slow", 0, "", id="slow-rtc", marks=LONG),
        pytest.param("sync", "nothing", 0, "", id="nothing-sync", marks=LONG),
        pytest.param("rtc", "nothing", 0, "", id="nothing-rtc", marks=LONG),
    ],
)
def test_no_policy_moves_an_arm_faster_than_its_limits(rollout, inference, behaviour, status, says):
    document = config("rollout", inference=INFERENCES[inference], duration=20 if behaviour in ENDS else SECONDS)
    rollout.begin(document, behaviour, amplitude=1.0 if behaviour == "jumps" else AMPLITUDE_RAD)
    assert rollout.end() == status, rollout.commands.output()[-4000:]
    assert says in rollout.commands.output(), rollout.commands.output()[-4000:]
    rollout.assert_ended_well()
    if behaviour in ("nothing", "short"):
        rollout.assert_moved(-1.0, at_most_rad=0.05)  # limp, the wrist settles
    else:
        rollout.assert_moved(0.05)


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_two_signals_land_the_arms_too(rollout, number):
    rollout.begin(config("rollout"), "sines", amplitude=0.8)
    rollout.wait_moved(0.15)
    for _ in range(2):  # LeRobot takes the second one for "at once"
        os.killpg(rollout.process.pid, number)
        time.sleep(0.7)
    assert rollout.end() in (0, 1), rollout.commands.output()[-4000:]
    rollout.assert_ended_well()


# degrees and radians


@pytest.mark.long
def test_a_policy_in_degrees_moves_a_robot_in_degrees(rollout):
    document = config("rollout", duration=SECONDS)
    document["robot"]["use_degrees"] = True
    fields = {"amplitude": float(np.degrees(AMPLITUDE_RAD)), "stats": statistics(2, degrees=True)}
    rollout.begin(document, "sines", **fields)
    assert rollout.end() == 0, rollout.commands.output()[-4000:]
    rollout.assert_moved(0.15, at_most_rad=0.5)
    rollout.assert_ended_well()


# tool poses


@LONG
def test_a_policy_of_tool_poses_moves_the_tools(rollout):
    document = config("rollout", duration=SECONDS, strategy={"type": "sentry"}, dataset=data_set(rollout.root))
    document["robot"]["action_space"] = "ee"
    near = {key: {kind: row.clamp(max=1.0) for kind, row in rows.items()} for key, rows in statistics(2).items()}
    rollout.begin(document, "sines", amplitude=0.06, stats=near, action_feature_names=list(TOOL_KEYS))
    assert rollout.end() == 0, rollout.commands.output()[-4000:]
    rollout.assert_moved(0.05)
    rollout.assert_ended_well()
    data = LeRobotDataset("local/rollout_test", root=rollout.root)
    assert list(data.features["action"]["names"]) == list(TOOL_KEYS)
    seen = np.stack(data.hf_dataset.with_format("numpy")["observation.state"])
    assert 0.03 < np.ptp(seen, axis=0)[:3].max() < 0.12  # m: there and back
