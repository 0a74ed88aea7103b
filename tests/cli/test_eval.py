"""Stock lerobot-eval in lock-step: recorded actions do again what they did, whatever the number of rigs."""

import json

import draccus
import numpy as np
import pytest
from lerobot.configs.eval import EvalPipelineConfig

from lerobot_robot_yam.commands.configs import config_path
from lerobot_robot_yam.commands.data.gathering import demonstrate
from lerobot_robot_yam.rig.scene.tasks import SCRIPTS
from lerobot_robot_yam.yam_env import YamEnv
from tests.cli.conftest import Commands
from tests.face.test_yam_env import two_arms
from tests.policy_plugin.checkpoints import save_scripted

CONFIG = "train/lift_and_place_eval"
SEED = 1000  # LeRobot's own


@pytest.fixture
def commands(tmp_path):
    """Without a rig: in lock-step each environment has its own."""
    return Commands(None, tmp_path)


def environment(**fields):
    """The shipped evaluation's, without cameras: they cost most of the time and judge nothing."""
    config = draccus.parse(EvalPipelineConfig, config_path(CONFIG), args=[]).env
    config.robot.cameras = {}
    for name, value in fields.items():
        setattr(config, name, value)
    config.__post_init__()
    return config


def demonstrated(count, path, off_rad):
    """The operator's attempts from SEED on, kept as a file for the replayed policy.

    off_rad: spread of an offset that spoils an episode's actions.
    """
    rng = np.random.default_rng(0)
    env = YamEnv(environment())
    try:
        attempts = [list(demonstrate(env, SEED + index)) for index in range(count)]
    finally:
        env.close()
    off = [np.append(rng.normal(0.0, off_rad, 6), 0.0).astype(np.float32) for _ in attempts]
    np.savez(path, **{str(i): np.array([f.action + off[i] for f in frames]) for i, frames in enumerate(attempts)})


def evaluate(commands, name, policy, episodes, rigs):
    """Successes by seed, as lerobot-eval tells them."""
    out = commands.directory / name
    status = commands.run(
        "lerobot-eval",
        f"--config_path={config_path(CONFIG)}",
        "--env.discover_packages_path=tests.policy_plugin",
        f"--policy.path={policy}",
        "--env.robot.cameras={}",
        f"--eval.n_episodes={episodes}",
        f"--eval.batch_size={rigs}",
        f"--output_dir={out}",
        timeout_s=1800.0,
    )
    assert status == 0, commands.output()[-4000:]
    info = json.loads((out / "eval_info.json").read_text())
    return info["per_task"][0]["metrics"]["successes"]


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_what_succeeds_now_and_then_does_so_on_the_same_seeds(commands):
    actions = commands.directory / "actions.npz"
    demonstrated(12, actions, off_rad=0.04)
    policy = save_scripted(commands.directory / "policy", "replay", arms=1, actions=str(actions))
    one = evaluate(commands, "one", policy, 12, 1)
    assert 2 <= sum(one) <= 10
    assert evaluate(commands, "again", policy, 12, 1) == one
    assert evaluate(commands, "two", policy, 12, 2) == one
    nothing = save_scripted(commands.directory / "nothing", "replay", arms=1)
    assert not any(evaluate(commands, "still", nothing, 12, 2))


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("task", SCRIPTS)
def test_the_operator_masters_every_task(task, tmp_path):
    env = YamEnv(environment(task=task, robot=two_arms(tmp_path)))
    try:
        outcomes = [list(demonstrate(env, seed))[-1].success for seed in range(50)]
    finally:
        env.close()
    assert np.mean(outcomes) >= 0.95, [seed for seed, won in enumerate(outcomes) if not won]
