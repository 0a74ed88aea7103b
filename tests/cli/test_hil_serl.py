"""LeRobot's RL stack on the rig: its environment with a person who takes over, and its actor beside its learner."""

import re
import shlex
import signal
import socket
import time

import draccus
import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.commands.model_file import main as write_model
from tests.cli.conftest import ROOT, commands_on

pytest.importorskip("placo", reason='LeRobot\'s RL stack needs the extra: pip install -e ".[hil-serl]"')

from lerobot.rl.gym_manipulator import GymManipulatorConfig  # noqa: E402
from lerobot.rl.train_rl import TrainRLServerPipelineConfig  # noqa: E402

FOLLOWER, LEADER = "follower_left", "leader_left"
READY, AWAY = [0.0, 1.0, 1.0, -0.3, 0.0, 0.0], [0.4, 1.2, 1.1, -0.3, 0.0, 0.0]
PLUGIN = "--env.discover_packages_path=lerobot_robot_yam"
IK = "env.processor.inverse_kinematics"
STEPS = 200


commands = commands_on(FOLLOWER, LEADER)


def start(commands, module, config, *options):
    assert write_model(["--format=urdf", str(commands.directory / "yam.urdf")]) == 0
    urdf = f"--{IK}.urdf_path={commands.directory / 'yam.urdf'}"
    return commands.start("-m", f"lerobot.rl.{module}", PLUGIN, f"--config_path={config}", urdf, *options)


def record(commands, root):
    """Start to record an episode; returns once it has begun."""
    process = start(
        commands,
        "gym_manipulator",
        "configs/sim/hil_serl.yaml",
        "--mode=record",
        "--dataset.num_episodes_to_record=1",
        f"--dataset.root={root}",
        "--env.processor.reset.control_time_s=60",
    )
    commands.wait(lambda: "Reset the environment done." in commands.output(), process)
    time.sleep(5.0)  # LeRobot's reset time
    return process


def tools(rig, kinematics):
    """Where the tools of leader and follower are, (2, 3) m."""
    arms = rig.state()["arms"]
    return np.array([kinematics.fk(np.array(arms[channel]["q"]))[:3, 3] for channel in (LEADER, FOLLOWER)])


@pytest.mark.long
@pytest.mark.alone
def test_a_person_takes_over_and_the_episode_is_recorded(commands):
    rig, root, kinematics = commands.rig, commands.directory / "data", YamKinematics("yam", "linear_4310")
    process = record(commands, root)
    rig.lift(LEADER, READY, 1.0)
    time.sleep(1.3)
    alone = tools(rig, kinematics)
    rig.press(LEADER, "record", 0.1)
    time.sleep(0.5)
    before = tools(rig, kinematics)
    np.testing.assert_allclose(before[1], alone[1], atol=2e-3)  # the follower has not gone to the leader
    rig.lift(LEADER, AWAY, 1.5, trigger=1.0)
    time.sleep(2.5)
    leader, follower = tools(rig, kinematics) - before
    assert np.linalg.norm(leader) > 0.1
    np.testing.assert_allclose(follower, leader, atol=0.01)
    assert rig.state()["arms"][FOLLOWER]["opening"] < 0.05
    rig.press(LEADER, "sync", 0.1)
    assert commands.finish(process) == 0, commands.output()[-4000:]
    commands.assert_landed()

    table = LeRobotDataset("local/yam_hil_serl", root=root).hf_dataset.with_format("numpy")
    action, reward, done = (np.stack(table[key]) for key in ("action", "next.reward", "next.done"))
    assert action.shape[1] == 4 and np.abs(action[:, :3]).max() <= 1.0
    np.testing.assert_allclose(action[:, :3].sum(axis=0) * 0.02, leader, atol=0.015)
    assert reward.sum() == reward[-1] == 1.0 and done.sum() == done[-1] == 1


@pytest.mark.long
@pytest.mark.alone
def test_actor_and_learner_run_beside_each_other(commands):
    root = commands.directory / "data"
    process = record(commands, root)
    time.sleep(3.0)
    commands.rig.press(LEADER, "sync", 0.1)
    assert commands.finish(process) == 0, commands.output()[-4000:]

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    shared = [f"--dataset.root={root}", f"--policy.actor_learner_config.learner_port={port}"]
    shared += [f"--policy.online_steps={STEPS}", "--policy.online_step_before_learning=20", "--batch_size=8"]
    config = "configs/train/hil_serl.yaml"
    output = commands.directory / "output"
    learner = start(
        commands, "learner", config, *shared, f"--output_dir={output}_learner", "--env.processor.reset=null"
    )
    commands.wait(lambda: "gRPC server started" in commands.output(), learner)
    actor = start(commands, "actor", config, *shared, f"--output_dir={output}_actor")
    commands.wait(lambda: "Policy loop finished" in commands.output(), actor)
    said = commands.output()
    ends = [int(step) for step in re.findall(r"Global step (\d+): Episode reward", said)]
    assert len(ends) == 2 and ends[-1] > STEPS - 5 and "Shutting down act_with_policy" not in said
    assert "Load new parameters from Learner" in said and "Optimization frequency loop" in said
    for process in (actor, learner):
        process.send_signal(signal.SIGINT)
    assert commands.finish(actor) == 0 and commands.finish(learner) == 0, commands.output()[-4000:]
    commands.assert_landed()


def written():
    """(place, module, arguments) of each command that a reader can type."""
    for place in ("docs/hil-serl.md", "configs/sim/hil_serl.yaml", "configs/train/hil_serl.yaml"):
        text = re.sub(r"\\\n#? *", "", (ROOT / place).read_text())
        for module, arguments in re.findall(r"python -m lerobot\.rl\.(\w+) (.*)", text):
            yield pytest.param(module, shlex.split(arguments), id=f"{place} {module}")


@pytest.mark.parametrize("module, arguments", list(written()))
def test_lerobot_takes_what_is_written(module, arguments):
    plugin, config, *options = arguments
    assert plugin == PLUGIN
    kind = GymManipulatorConfig if module == "gym_manipulator" else TrainRLServerPipelineConfig
    parsed = draccus.parse(kind, ROOT / config.removeprefix("--config_path="), options)
    if module == "learner":
        assert parsed.to_dict()["env"]["robot"]["channel"] == FOLLOWER  # it writes its config down


def test_both_configs_describe_the_same_environment():
    env = draccus.parse(GymManipulatorConfig, ROOT / "configs" / "sim" / "hil_serl.yaml", []).env
    train = draccus.parse(TrainRLServerPipelineConfig, ROOT / "configs" / "train" / "hil_serl.yaml", [])
    for part in ("robot", "teleop", "processor", "fps", "task"):
        assert getattr(train.env, part) == getattr(env, part), part
    steps = env.processor.inverse_kinematics.end_effector_step_sizes
    assert set(steps.values()) == {env.teleop.step_m} and env.robot.use_degrees
    assert train.policy.num_discrete_actions == 3
