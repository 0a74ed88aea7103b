"""lerobot-record on the shipped config, what it wrote, and lerobot-replay of it."""

import itertools
import json

import av
import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_robot_yam.face.recorder.kept_episodes import SIDE_CAR
from tests.cli.conftest import CALM
from tests.support.rigged import sim_config
from tests.support.set_points import SetPointWatch

pytestmark = pytest.mark.alone

KEYS = [*(f"joint_{n}.pos" for n in range(1, 7)), "gripper.pos"]
BI_KEYS = [f"{side}_{key}" for side in ("left", "right") for key in KEYS]
FOLLOWERS = ("follower_left", "follower_right")
CAMERAS = ("top", "wrist_left", "wrist_right")
SECONDS, EPISODES = 5, 2
MOVES = 5.0  # of 255: noise alone changes a patch by less than 1


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
        # Leaders move at up to 1.5 rad/s. A walk of Python's collector over what LeRobot has loaded makes it 0.24.
        assert lag.max() < 0.2 and np.median(lag) < 0.03


def test_each_episode_has_a_row_of_figures(recorded):
    commands, data = recorded
    rows = [json.loads(line) for line in (data.root / SIDE_CAR).read_text().splitlines()]
    lengths = [int(data.meta.episodes[index]["length"]) for index in range(EPISODES)]
    assert [row["episode_index"] for row in rows] == list(range(EPISODES))
    assert [row["frames"] for row in rows] == lengths == [len(row["times_s"]) for row in rows]
    assert all(0.5 * data.fps < row["achieved_fps"] < 1.1 * data.fps for row in rows)
    for index, length in enumerate(lengths):
        assert f"episode {index}: {length} frames at " in commands.output()
    assert f"kept {EPISODES} episodes of this session; {EPISODES} in {data.root}" in commands.output()


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
    assert np.median(motion(frames)) > MOVES


def motion(frames):
    """The most that a patch of 16 × 16 pixels changes within half a second, again and again: noise does not count."""
    small = [frame.reshape(15, 16, 20, 16, 3).mean(axis=(1, 3)) for frame in frames[::15]]
    return [np.abs(after - before).max() for before, after in itertools.pairwise(small)]


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
    last = np.zeros(0)
    with SetPointWatch(commands.rig.name, [sim_config(commands.rig, c) for c in FOLLOWERS]) as watch:
        commands.wait_enabled(process, *FOLLOWERS)
        while process.poll() is None:
            arms = commands.rig.state()["arms"]
            if commands.enabled(*FOLLOWERS):
                tracked = [np.append(arms[c]["q"][:6], arms[c]["opening"]) for c in FOLLOWERS]
                last = np.append(last, np.concatenate(tracked))
    assert watch.findings == [] and all(0.1 < ratio <= 1.0 for ratio in watch.ratios.values())
    assert commands.finish(process) == 0, commands.output()[-4000:]
    seen = last.reshape(-1, 14)
    ended = np.array(data.hf_dataset.with_format("numpy")[len(data) - 1]["observation.state"])  # in mid-motion
    joints = [*range(6), *range(7, 13)]
    assert np.abs(seen[:, joints] - ended[joints]).max(axis=1).min() < 0.1  # it came to where the episode ended
    commands.assert_landed()
