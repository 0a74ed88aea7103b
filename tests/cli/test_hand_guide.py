"""lerobot-record of a follower that a hand leads, with a key for its gripper, and lerobot-replay of it."""

import time

import numpy as np
import pytest
import yaml
from lerobot.datasets import LeRobotDataset

from tests.cli.conftest import ROOT, commands_on, options, virtual

pytestmark = pytest.mark.alone

ARM = "follower_left"
THERE, FARTHER = [0.3, 1.0, 0.9, -0.3, 0.1, 0.2], [-0.2, 1.3, 1.1, -0.4, -0.2, 0.4]
SECONDS = 9


commands = commands_on(ARM)


def joints(rig):
    return np.array(rig.state()["arms"][ARM]["q"])


def record(commands, root):
    """Record an episode in a terminal, in which the hand leads the arm to two places, and g is typed on the way."""
    rig = commands.rig
    config = yaml.safe_load((ROOT / "configs" / "sim" / "hand_guide_record.yaml").read_text())
    config["robot"]["cameras"] = {}
    path = commands.directory / "hand_guide.yaml"
    path.write_text(yaml.safe_dump(config))
    arguments = [
        f"--config_path={path}",
        "--dataset.num_episodes=1",
        f"--dataset.episode_time_s={SECONDS}",
        f"--dataset.root={root}",
        "--dataset.no_stamp=true",
    ]
    terminal = commands.in_terminal("lerobot-record", *arguments)
    try:
        terminal.wait_shown("is guided by hand", 120.0)
        rig.lift(ARM, THERE, 2.0)
        time.sleep(2.3)
        before = rig.state()["arms"][ARM]["opening"]
        terminal.type(b"g")
        time.sleep(0.7)
        after = rig.state()["arms"][ARM]["opening"]
        rig.lift(ARM, FARTHER, 2.0, then_release=True)
        time.sleep(2.5)
        led = joints(rig)
        assert terminal.end(60.0) == 0, terminal.shown[-4000:]
        assert terminal.modes()[0] == terminal.modes()[1]
    finally:
        terminal.close()
    return led, before, after


@pytest.mark.long
def test_what_a_hand_has_led_is_recorded_and_replayed(commands):
    rig, root = commands.rig, commands.directory / "data"
    led, before, after = record(commands, root)
    commands.assert_landed()
    assert abs(after - before) > 0.8  # the key has moved the gripper while the arm floated
    data = LeRobotDataset("local/yam_hand_guide", root=root)
    table = data.hf_dataset.with_format("numpy")
    state, action = np.stack(table["observation.state"]), np.stack(table["action"])
    assert len(action) > 0.5 * SECONDS * data.fps
    np.testing.assert_allclose(action[-1, :6], led, atol=5e-3)  # where the arm really was
    np.testing.assert_allclose(action[:, :6], state[:, :6], atol=0.05)
    assert (np.ptp(action[:, :6], axis=0)[:4] > 0.1).all() and np.ptp(action[:, 6]) > 0.8

    data = {"repo_id": "local/yam_hand_guide", "root": root, "episode": 0}
    replay = commands.start(
        "lerobot-replay", *options(robot=virtual("follower", ARM), dataset=data), "--play_sounds=false"
    )
    commands.wait_enabled(replay, ARM, timeout_s=150.0)
    nearest = np.full(6, np.inf)
    while replay.poll() is None:
        away = np.abs(joints(rig) - led)
        if away.max() < nearest.max():
            nearest = away
        time.sleep(0.02)
    assert replay.returncode == 0, commands.output()[-4000:]
    assert nearest.max() < 0.005, nearest
    commands.assert_landed()
