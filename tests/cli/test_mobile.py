"""A mobile base is recorded and replayed by LeRobot's own commands, by velocity and by the recorded odometry."""

import contextlib
import math

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_robot_yam.rig.control import running_rig
from tests.cli.conftest import Commands, one_episode, options
from tests.support.hosted import mobile_rig_file, running_host

pytestmark = [pytest.mark.alone, pytest.mark.long]

BASE = {"type": "yam_base", "id": "sim", "interface": "yam_sim", "channel": "base"}


@pytest.fixture
def commands(tmp_path):
    with running_rig(scene="mobile") as rig, contextlib.closing(Commands(rig, tmp_path, ())) as commands:
        yield commands


def way(commands, name, *arguments):
    """Run a command; returns the way that the base has really gone from where it began: m, m, degrees."""
    before = np.array(commands.rig.state()["base"]["pose"])
    assert commands.run(name, *arguments) == 0, commands.output()[-4000:]
    state = commands.rig.state()["base"]
    assert not any(motor["enabled"] for motor in state["motors"].values())
    gone = np.array(state["pose"]) - before
    s, c = math.sin(before[2]), math.cos(before[2])
    turned = math.degrees(math.remainder(gone[2], math.tau))
    return np.array([c * gone[0] + s * gone[1], c * gone[1] - s * gone[0], turned])


def test_a_drive_is_recorded_over_the_link(commands, tmp_path, monkeypatch):
    """The base is another machine's, with its own runtime directory."""
    (tmp_path / "workstation").mkdir(mode=0o700)
    with running_host(mobile_rig_file(tmp_path, commands.rig), tmp_path) as host:
        monkeypatch.setenv("YAM_RUNTIME_DIR", str(tmp_path / "workstation"))
        recorded = way(
            commands,
            "lerobot-record",
            *options(
                robot={"type": "yam_base_remote", "host": host.address, "observe_odometry": "true"},
                dataset=one_episode("link", tmp_path / "link", 6),
            ),
            "--teleop.discover_packages_path=tests.teleop_plugin",
            "--teleop.type=drive",
            "--play_sounds=false",
        )
        monkeypatch.undo()
    dataset = LeRobotDataset("local/link", root=tmp_path / "link")
    assert dataset.meta.robot_type == "yam_base"
    last = dataset.select_columns("observation.state")[-1]["observation.state"].numpy()[3:]
    assert recorded[0] > 0.4 and recorded[2] > 30.0
    assert last == pytest.approx(recorded, abs=5.0) and last[:2] == pytest.approx(recorded[:2], abs=0.05)


def test_a_recorded_drive_is_replayed_by_velocity_and_by_poses(commands, tmp_path):
    root = tmp_path / "drive"
    recorded = way(
        commands,
        "lerobot-record",
        *options(robot=BASE | {"observe_odometry": "true"}, dataset=one_episode("drive", root, 6)),
        "--teleop.discover_packages_path=tests.teleop_plugin",
        "--teleop.type=drive",
        "--play_sounds=false",
    )
    dataset = LeRobotDataset("local/drive", root=root)
    assert dataset.features["action"]["names"] == ["x.vel", "y.vel", "theta.vel"]
    names = dataset.features["observation.state"]["names"]
    assert names == ["x.vel", "y.vel", "theta.vel", "x.pos", "y.pos", "theta.pos"]
    last = dataset.select_columns("observation.state")[-1]["observation.state"].numpy()[3:]
    assert recorded[0] > 0.4 and recorded[2] > 30.0
    assert last == pytest.approx(recorded, abs=5.0) and last[:2] == pytest.approx(recorded[:2], abs=0.05)
    replay = options(dataset={"repo_id": "local/drive", "root": root, "episode": 0})
    by_velocity = way(commands, "lerobot-replay", *options(robot=BASE), *replay, "--play_sounds=false")
    by_poses = way(
        commands, "lerobot-replay", *options(robot=BASE | {"replay_poses": "true"}), *replay, "--play_sounds=false"
    )
    assert by_velocity[:2] == pytest.approx(recorded[:2], abs=0.25)
    assert by_poses[:2] == pytest.approx(recorded[:2], abs=0.03) and by_poses[2] == pytest.approx(recorded[2], abs=3.0)
