"""lerobot-record on the shipped config, what it wrote, and lerobot-replay of it."""

import itertools

import av
import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from .conftest import CALM

pytestmark = pytest.mark.alone

KEYS = [*(f"joint_{n}.pos" for n in range(1, 7)), "gripper.pos"]
BI_KEYS = [f"{side}_{key}" for side in ("left", "right") for key in KEYS]
CAMERAS = ("top", "wrist_left", "wrist_right")
SECONDS, EPISODES = 8, 2


@pytest.fixture(scope="module")
def recorded(shared_commands, tmp_path_factory):
    commands = shared_commands
    root = tmp_path_factory.mktemp("recorded") / "data"  # another one each time that a still machine makes us try again
    status = commands.run(
        "lerobot-record",
        "--config_path=configs/sim/record.yaml",
        *CALM,
        f"--dataset.root={root}",
        "--dataset.no_stamp=true",
        f"--dataset.episode_time_s={SECONDS}",
        "--dataset.reset_time_s=1",
    )
    assert status == 0, commands.output()[-4000:]
    return commands, LeRobotDataset("local/yam_sim", root=root)


def test_data_set_has_the_canonical_form(recorded):
    _, data = recorded
    assert data.num_episodes == EPISODES and data.fps == 30
    for feature in ("action", "observation.state"):
        assert tuple(data.features[feature]["shape"]) == (14,)
        assert list(data.features[feature]["names"]) == BI_KEYS
    for camera in CAMERAS:
        assert tuple(data.features[f"observation.images.{camera}"]["shape"]) == (240, 320, 3)
    assert data.meta.robot_type == "bi_yam_follower"


def test_arms_follow_the_leaders(recorded):
    _, data = recorded
    table = data.hf_dataset.with_format("numpy")
    state, action = np.stack(table["observation.state"]), np.stack(table["action"])
    assert np.isfinite(state).all() and np.isfinite(action).all()
    assert len(state) > 0.5 * EPISODES * SECONDS * data.fps
    assert (np.ptp(action, axis=0)[[0, 1, 2]] > 0.1).any(), "the operator did not move a leader"
    joints = [*range(6), *range(7, 13)]
    for episode in range(EPISODES):
        rows = np.stack(table["episode_index"]) == episode
        # In the first second the followers approach, under their speed limits, where the leaders have gone meanwhile.
        lag = np.abs(state[rows][32:, joints] - action[rows][30:-2, joints])
        assert lag.max() < 0.3 and np.median(lag) < 0.03


@pytest.mark.parametrize("camera", CAMERAS)
def test_videos_decode_and_move(recorded, camera):
    _, data = recorded
    frames = []
    for path in sorted((data.root / "videos" / f"observation.images.{camera}").rglob("*.mp4")):
        with av.open(str(path)) as video:
            frames += [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    assert len(frames) == len(data) and frames[0].shape == (240, 320, 3)
    assert all(frame.std() > 10 for frame in frames[:: data.fps])  # a picture, not a colour
    changed = sum(not np.array_equal(a, b) for a, b in itertools.pairwise(frames))
    assert changed > 0.5 * len(frames)


def test_recording_lands_its_arms(recorded):
    recorded[0].assert_landed()


def test_replay_follows_the_recording(recorded):
    commands, data = recorded
    process = commands.start(
        "lerobot-replay",
        "--config_path=configs/sim/replay.yaml",
        f"--dataset.repo_id={data.repo_id}",
        f"--dataset.root={data.root}",
        "--dataset.episode=1",
    )
    commands.wait_enabled(process, "follower_left", "follower_right")
    last = np.zeros(0)
    while process.poll() is None:
        arms = commands.rig.state()["arms"]
        if commands.enabled("follower_left", "follower_right"):
            tracked = [np.append(arms[c]["q"][:6], arms[c]["opening"]) for c in ("follower_left", "follower_right")]
            last = np.append(last, np.concatenate(tracked))
    assert commands.finish(process) == 0, commands.output()[-4000:]
    seen = last.reshape(-1, 14)
    goal = np.array(data.hf_dataset.with_format("numpy")[len(data) - 1]["action"])
    joints = [*range(6), *range(7, 13)]
    assert np.abs(seen[:, joints] - goal[joints]).max(axis=1).min() < 0.1  # it came to where the episode ended
    commands.assert_landed()
