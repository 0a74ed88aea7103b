"""lerobot-record with followers that take their targets from their leaders at loop rate."""

import threading
import time

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_robot_yam.commands.lib.feel_figures import likeness
from lerobot_robot_yam.rig.control import running_rig
from lerobot_robot_yam.state.arm_state import ArmState
from lerobot_robot_yam.state.records import STATE_DTYPE, channel_key, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock
from scripts import recorders
from tests.cli.conftest import Commands, one_episode, options, virtual
from tests.support.coupled import FOLLOWER, LEADER, POSE, sweep
from tests.support.spoken import Spoken

pytestmark = pytest.mark.alone

SECONDS = 8.0
LATE_S = 0.2  # six frames of a recorder that is held up; the sweep comes by again after 2 s


class StateLog:
    """Every state that an arm publishes, in a thread."""

    def __init__(self, rig, channel):
        self._block = SharedBlock(state_path(channel_key("yam_sim", channel, rig.name)), STATE_DTYPE, create=False)
        self.states = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        seen = 0
        while not self._stop.is_set():
            sequence = self._block.sequence()
            if sequence != seen and (payload := self._block.glance_bytes()) is not None:
                seen = sequence
                self.states.append(ArmState(payload))
            time.sleep(0.0005)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()
        self._block.close()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    directory = tmp_path_factory.mktemp("coupled")
    with running_rig(arms=[LEADER, FOLLOWER]) as rig, pytest.MonkeyPatch.context() as monkeypatch:
        spoken = Spoken(directory, monkeypatch)
        commands = Commands(rig, directory, (LEADER, FOLLOWER))
        root = directory / "data"
        process = commands.start(
            "lerobot-record",
            *options(
                robot=virtual("follower", FOLLOWER, gripper_stops_rad="[3.25,-3.3]"),
                teleop=virtual("leader", LEADER, follower=FOLLOWER),
                dataset=one_episode("coupled", root, SECONDS + 4),
            ),
            "--play_sounds=true",
        )
        commands.wait_connected(process, timeout_s=150.0)
        rig.hand(LEADER, [2.0], [POSE.tolist()])
        time.sleep(2.5)
        with StateLog(rig, FOLLOWER) as log:
            sweep(rig, SECONDS)
            time.sleep(2.0)
            for channel in (LEADER, FOLLOWER):
                recorders.truth_start(rig, channel, 60.0)  # more than it takes to fetch it
            time.sleep(5.0)
            truth = [recorders.truth(rig, channel) for channel in (LEADER, FOLLOWER)]
            for channel in (LEADER, FOLLOWER):
                recorders.truth_stop(rig, channel)
            assert commands.finish(process, 120.0) == 0, commands.output()[-4000:]
        commands.assert_landed()
        said = commands.output(), spoken.lines(2)
        yield truth, log.states, LeRobotDataset("local/coupled", root=root), said


def typical_jerk_ratio(stamps_s, leader, follower):
    """Of spans of half a second the middle one.

    Where a loop ticks late, because others have the processor, the follower stands still and catches up. Two such
    moments of 10 ms in 4 s make 7.5 of a ratio of 1.1 over all of it, and 1.15 of the middle one. What is the
    coupling's is in every span: the corners of a target at 30 fps make 4.0 of the one and 4.4 of the other.
    """
    spans = [slice(begin, begin + 500) for begin in range(0, len(stamps_s) - 499, 500)]
    return np.median([likeness(stamps_s[span], leader[span], follower[span]).jerk_ratio for span in spans])


@pytest.mark.long
def test_the_follower_is_at_its_leader(recorded):
    (leader, follower), _, _, said = recorded
    first = max(leader["stamp_s"][0], follower["stamp_s"][0])
    pairs = [truth["q"][truth["stamp_s"] >= first][:4000, :6] for truth in (leader, follower)]
    found = likeness(leader["stamp_s"][:4000], *pairs)
    assert np.ptp(pairs[0], axis=0).min() > 0.5
    assert found.lag_s.max() < 0.02, found
    assert found.error_rad.max() < 0.004, found
    assert typical_jerk_ratio(leader["stamp_s"][:4000], *pairs) < 1.5, found
    output, aloud = said
    assert output.count("gate: approach -> engaged") == 1
    assert "Recording episode 0" in aloud and aloud.count("engaged") == 1


@pytest.mark.long
def test_every_recorded_action_is_the_target_of_its_tick(recorded):
    """The data set numbers its frames, and does not say when they were taken: each tick is behind the one before."""
    _, states, data, _ = recorded
    coupled = [state for state in states if state.coupled]
    stamps, targets = (np.array(column) for column in zip(*((s.published_s, s.action) for s in coupled), strict=True))
    assert len(coupled) > 1000
    table = data.hf_dataset.with_format("numpy")
    actions, times = np.stack(table["action"]), np.stack(table["timestamp"])
    inside = (times > 5.0) & (times < 8.0)
    assert inside.sum() > 60
    taken = []
    for action in actions[inside]:
        near = (stamps > taken[-1]) & (stamps < taken[-1] + LATE_S) if taken else stamps > 0.0
        apart = np.abs(targets[near] - action).max(axis=1)
        assert apart.min() < 1e-6, f"frame {len(taken)} is no target behind {taken[-1:]} s"
        taken.append(stamps[near][apart.argmin()])
    assert taken[-1] - taken[0] == pytest.approx(np.ptp(times[inside]), rel=0.1)
