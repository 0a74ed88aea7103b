"""lerobot-record and lerobot-replay of an arm of seven joints that another one leads, from profile and scene files."""

import json

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_robot_yam.rig.control import running_rig
from tests.cli.conftest import Commands
from tests.support.seven_joints import ARM, KEYS, REACH, STOPS, write_scene

pytestmark = pytest.mark.alone

FOLLOWER, LEADER = "follower_left", "leader_left"
SECONDS = 6
ROBOT = [
    "--robot.type=yam_follower",
    "--robot.id=seven",
    f"--robot.channel={FOLLOWER}",
    "--robot.interface=yam_sim",
    f"--robot.arm={ARM}",
    f"--robot.gripper_stops_rad={STOPS}",
    "--robot.rate_hz=100",
]
TELEOP = [
    "--teleop.type=yam_leader",
    "--teleop.id=seven",
    f"--teleop.channel={LEADER}",
    "--teleop.interface=yam_sim",
    f"--teleop.arm={ARM}",
    "--teleop.rate_hz=100",
]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("seven")
    with running_rig(scene=write_scene(folder)) as rig:
        commands = Commands(rig, folder, (FOLLOWER, LEADER))
        process = commands.start(
            "lerobot-record",
            *ROBOT,
            *TELEOP,
            "--dataset.repo_id=local/seven",
            f"--dataset.root={folder / 'data'}",
            "--dataset.no_stamp=true",
            "--dataset.single_task=Wave",
            "--dataset.num_episodes=1",
            f"--dataset.episode_time_s={SECONDS}",
            "--dataset.reset_time_s=0",
            "--dataset.fps=30",
            "--dataset.push_to_hub=false",
            "--play_sounds=false",
        )
        commands.wait_connected(process)
        start = rig.state()["arms"][LEADER]["q"]
        rig.hand(LEADER, [0.5, 2.5, 4.0, 5.0], [start, REACH, REACH, start], [0.0, 0.0, 1.0, 0.0])
        assert commands.finish(process, 150.0) == 0, commands.output()[-4000:]
        yield commands, LeRobotDataset("local/seven", root=folder / "data")


@pytest.mark.long
def test_every_joint_is_recorded(recorded):
    commands, data = recorded
    for feature in ("action", "observation.state"):
        assert list(data.features[feature]["names"]) == KEYS
    table = data.hf_dataset.with_format("numpy")
    state, action = np.stack(table["observation.state"]), np.stack(table["action"])
    assert state.shape == action.shape == (len(data), 8) and len(data) > 0.5 * SECONDS * data.fps
    moved = np.ptp(action, axis=0)
    assert (moved[:7] > 0.2).all() and moved[7] > 0.8  # every joint, and the trigger
    lag = np.abs(state[32:, :7] - action[30:-2, :7])
    assert np.median(lag) < 0.03 and lag.max() < 0.3
    assert json.loads((data.root / "meta" / "info.json").read_text())["robot_type"] == "yam_follower"
    commands.assert_landed()
