"""A mobile base, alone and with arms, is recorded, replayed and rolled out by LeRobot's own commands."""

import contextlib
import math

import numpy as np
import pytest
import yaml
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_robot_yam.rig.control import running_rig
from tests.cli.conftest import Commands, one_episode, options
from tests.policy_plugin.checkpoints import save_scripted
from tests.support.hosted import mobile_rig_file, running_host
from tests.support.paths import ROOT

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


FOLLOWERS = ("follower_left", "follower_right")


@pytest.mark.parametrize("where", ["local", "link"])
def test_a_recorded_attempt_carries_the_block_again(tmp_path, where):
    """As the shipped configs do it, once with the robot on this computer, once with the robot at a host."""
    root = tmp_path / "carried"
    with tables(tmp_path, where) as (commands, config):
        recorded = commands.run(
            "lerobot-record",
            f"--config_path={config('mobile_record')}",
            *options(dataset={"root": root, "no_stamp": "true"}),
        )
        assert recorded == 0, commands.output()[-4000:]
        (attempt,) = [event for event in commands.rig.events() if event["kind"] == "attempt"]
        assert attempt["success"] and not energised(commands.rig)
    dataset = LeRobotDataset("local/yam_mobile_sim", root=root)
    names = dataset.features["action"]["names"]
    assert dataset.meta.robot_type == "yam_mobile" and names[-3:] == ["x.vel", "y.vel", "theta.vel"]
    first = dataset.select_columns("observation.state")[0]["observation.state"].numpy()
    assert np.abs(first[-3:]).max() < 0.05  # the attempt is in it from its beginning: odometry at zero
    with tables(tmp_path, where) as (commands, config):
        commands.rig.task("mobile_tables", 0, 600.0)  # the same places, and more time until the verdict
        replayed = commands.run(
            "lerobot-replay", f"--config_path={config('mobile_replay')}", *options(dataset={"root": root})
        )
        assert replayed == 0, commands.output()[-4000:]
        assert commands.rig.task_state()["success"] and not energised(commands.rig)


@pytest.mark.parametrize("where", ["local", "link"])
def test_a_policy_drives_arms_and_base(tmp_path, where):
    policy = save_scripted(tmp_path / "policy", "sines", arms=2, more=3, fps=15, chunk_size=15, amplitude=0.1)
    with tables(tmp_path, where) as (commands, config):
        before = commands.rig.state()["base"]["pose"]
        rolled = commands.run(
            "lerobot-rollout",
            f"--config_path={config('mobile_rollout', cameras=False)}",
            "--robot.discover_packages_path=tests.policy_plugin",
            f"--policy.path={policy}",
            "--duration=8",
        )
        assert rolled == 0, commands.output()[-4000:]
        gone = np.array(commands.rig.state()["base"]["pose"]) - before
        assert np.abs(gone).max() > 0.005 and not energised(commands.rig)


@contextlib.contextmanager
def tables(directory, where):
    """Commands on a rig with two tables, and a function: path of a shipped config, the robot there or over a link."""
    with contextlib.ExitStack() as stack:
        rig = stack.enter_context(running_rig(scene="mobile_tables", operator="mobile_tables"))
        host = None
        if where == "link":
            file = mobile_rig_file(directory, rig, FOLLOWERS, rate_hz=100)
            host = stack.enter_context(running_host(file, directory))

        def config(name, cameras=True):
            document = yaml.safe_load((ROOT / "configs" / "sim" / f"{name}.yaml").read_text())
            robot = document["robot"]
            if not cameras:
                del robot["cameras"], robot["observe_odometry"]  # the policy has 7 numbers of each arm, 3 of the base
            if host is not None:
                kept = {key: robot[key] for key in ("id", "cameras", "observe_odometry") if key in robot}
                document["robot"] = {"type": "yam_mobile_remote", "host": str(host.address), **kept}
            path = directory / f"{name}.yaml"
            path.write_text(yaml.safe_dump(document))
            return path

        yield stack.enter_context(contextlib.closing(Commands(rig, directory, ()))), config


def energised(rig):
    state = rig.state()
    parts = (*state["arms"].values(), state["base"])
    return [name for part in parts for name, motor in part["motors"].items() if motor["enabled"]]
