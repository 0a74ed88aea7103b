"""A data set of arms over the link is that of local arms on the same rig, but for timing: both in lock-step."""

import contextlib
import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from lerobot.datasets import LeRobotDataset, aggregate_pipeline_dataset_features, create_initial_features
from lerobot.processor import make_default_processors
from lerobot.utils.constants import ACTION, OBS_STATE, OBS_STR
from lerobot.utils.feature_utils import build_dataset_frame, combine_feature_dicts

from lerobot_robot_yam.config_yam_follower import BiYamFollowerConfig, BiYamRemoteConfig, FollowerArmConfig
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.yam_follower import BiYamFollower, BiYamRemote
from tests.support.hosted import FOLLOWERS, ServedArms
from tests.support.link_in_step import LinkInStep
from tests.support.rigged import STOPS

FPS, FRAMES = 30, 30


def local(rig, tmp_path):
    """The robot of this computer."""
    where = {"interface": "yam_lockstep", "can_options": {"rig": rig.name}, "gravity_factor": [1.0] * 6}
    arms = [FollowerArmConfig(channel=channel, gripper_stops_rad=STOPS, **where) for channel in FOLLOWERS]
    config = BiYamFollowerConfig(
        left_arm_config=arms[0], right_arm_config=arms[1], observe_velocity=True, calibration_dir=tmp_path
    )
    config.isolation = "lockstep"
    return BiYamFollower(config)


def remote(served):
    """The robot of another one."""
    config = BiYamRemoteConfig(host=str(served.address), observe_velocity=True)
    config.runs = lambda: LinkInStep.on(served, config.hosted)
    return BiYamRemote(config)


def action(robot, frame):
    """Every joint of both arms swings, and the grippers open and close."""
    swing = 0.5 * (1.0 - np.cos(2.0 * np.pi * frame / FRAMES))
    return {key: float(0.8 * swing if "gripper" in key else 0.4 * swing) for key in robot.action_features}


def record(robot, root):
    """An episode as lerobot-record keeps it; the robot is still connected."""
    robot.connect()
    teleop_action, _, observation = make_default_processors()
    features = combine_feature_dicts(
        aggregate_pipeline_dataset_features(
            pipeline=teleop_action,
            initial_features=create_initial_features(action=robot.action_features),
            use_videos=False,
        ),
        aggregate_pipeline_dataset_features(
            pipeline=observation,
            initial_features=create_initial_features(observation=robot.observation_features),
            use_videos=False,
        ),
    )
    data = LeRobotDataset.create("local/same", FPS, features, root, robot_type=robot.name, use_videos=False)
    for frame in range(FRAMES):
        seen = build_dataset_frame(data.features, robot.get_observation(), prefix=OBS_STR)
        sent = build_dataset_frame(data.features, robot.send_action(action(robot, frame)), prefix=ACTION)
        data.add_frame({**seen, **sent, "task": "swing"})
        robot._arms.clock.sleep(1.0 / FPS)
    data.save_episode()
    data.finalize()
    return root


def recorded_over_the_link(root):
    with contextlib.closing(LockstepRig(arms=list(FOLLOWERS))) as rig, ServedArms(rig, *FOLLOWERS) as served:
        robot = remote(served)
        try:
            return record(robot, root)
        finally:
            robot.disconnect()


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    directory = tmp_path_factory.mktemp("here")
    with contextlib.closing(LockstepRig(arms=list(FOLLOWERS))) as rig:
        robot = local(rig, directory)
        yield record(robot, directory / "data")
        robot.discard()


def rows(root, key):
    """(frames, n) of a feature."""
    return np.stack(table(root)[key].to_numpy())


def told(root, name):
    """What a file beside the data says."""
    return json.loads((root / "meta" / f"{name}.json").read_text())


def table(root):
    (path,) = (root / "data").rglob("*.parquet")
    return pq.read_table(path)


def test_it_is_the_same(here, tmp_path):
    there = recorded_over_the_link(tmp_path / "data")
    assert told(here, "info") == told(there, "info") and told(here, "info")["robot_type"] == "bi_yam_follower"
    ours, theirs = told(here, "stats"), told(there, "stats")
    assert {key: list(of) for key, of in ours.items()} == {key: list(of) for key, of in theirs.items()}
    assert all(np.allclose(of[what], theirs[key][what], atol=1e-4) for key, of in ours.items() for what in of)
    assert table(here).schema == table(there).schema
    for key in table(here).column_names:
        assert np.abs(rows(here, key) - rows(there, key)).max() < 1e-4, key
    assert np.ptp(rows(there, OBS_STATE)[:, :6], axis=0).min() > 0.3, "the arms did not move"
