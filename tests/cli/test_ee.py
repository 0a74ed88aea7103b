"""An episode recorded in end-effector keys, and its replay: the tool goes where it went. Minutes: `-m long`."""

import logging
import math
import time

import numpy as np
import pytest
import yaml
from lerobot.datasets import LeRobotDataset

from lerobot_robot_yam.face.devices.feature_names import TOOL_NUMBERS
from tests.cli.conftest import ROOT

logger = logging.getLogger(__name__)

pytestmark = [pytest.mark.long, pytest.mark.alone, pytest.mark.timeout(900)]

FPS, SECONDS = 30, 12
KEYS = [
    f"{side}_{key}" for side in ("left", "right") for key in (*(f"{name}.pos" for name in TOOL_NUMBERS), "gripper.pos")
]
START = {"left": [0.3, 1.3, 1.2, -1.0, 0.1, 0.2], "right": [-0.3, 1.3, 1.2, -1.0, -0.1, -0.2]}
WAY = {"left": [[0.6, 1.5, 1.3, -0.9, 0.4, 0.2], [0.1, 1.7, 1.6, -1.1, 0.0, -0.3], [0.3, 1.4, 1.5, -1.3, 0.2, 0.2]]}
WAY["right"] = [[-q[0], *q[1:4], -q[4], -q[5]] for q in WAY["left"]]
STILL_S, LEG_S = 3.0, 2.0
ERROR_M = 0.002
START_S = 240.0  # what LeRobot's commands take to start and to save on a busy machine


class Watch:
    """Where the followers' tools really are, in the frames of their bases, over time."""

    def __init__(self, rig):
        self.rig, self.rows, self.began = rig, {side: [] for side in START}, 0
        self.bases = {row["channel"]: row for row in rig.scene()["arms"]}

    def look(self):
        arms = self.rig.state()["arms"]
        for side, rows in self.rows.items():
            base = self.bases[f"follower_{side}"]
            x, y, z = np.subtract(arms[f"follower_{side}"]["tcp_site"]["pos"], base["position_m"])
            c, s = math.cos(base["yaw_rad"]), math.sin(base["yaw_rad"])
            rows.append((c * x + s * y, -s * x + c * y, z))
        time.sleep(0.01)

    def path(self, side):
        """(k, 3)."""
        return np.array(self.rows[side])


def off_path(points, path):
    """(k,) distance of each point from a polyline (m, 3)."""
    start, along = path[:-1], np.diff(path, axis=0)
    length = np.maximum(np.einsum("ij,ij->i", along, along), 1e-18)
    share = np.clip(np.einsum("kij,ij->ki", points[:, None] - start, along) / length, 0.0, 1.0)
    return np.linalg.norm(points[:, None] - start - share[..., None] * along, axis=2).min(axis=1)


@pytest.fixture(scope="module")
def recorded(shared_ee_commands):
    """lerobot-record of the leaders' motion; the data set, and where the followers' tools were meanwhile."""
    commands = shared_ee_commands
    config = yaml.safe_load((ROOT / "configs" / "sim" / "record.yaml").read_text())
    config["robot"] |= {"cameras": {}, "action_space": "ee"}
    config["teleop"]["action_space"] = "ee"
    for side in ("left_arm_config", "right_arm_config"):
        del config["teleop"][side]["can_options"]  # no operator: the test moves the leaders
    config["dataset"] |= {"root": str(commands.directory / "data"), "no_stamp": True, "fps": FPS, "num_episodes": 1}
    config["dataset"] |= {"episode_time_s": SECONDS, "reset_time_s": 0}
    path = commands.directory / "record.yaml"
    path.write_text(yaml.safe_dump(config))
    process = commands.start("lerobot-record", f"--config_path={path}")
    try:
        commands.wait_connected(process, START_S)
        for side, q in START.items():
            commands.rig.hand(f"leader_{side}", [2.0], [q])
        while "Recording episode" not in commands.output():
            assert process.poll() is None, commands.output()[-4000:]
            time.sleep(0.05)
        times = STILL_S + LEG_S * np.arange(4)
        for side, q in START.items():
            commands.rig.hand(f"leader_{side}", times.tolist(), [q, *WAY[side]])
        watch, begin_s = Watch(commands.rig), time.monotonic()
        while time.monotonic() < begin_s + SECONDS and process.poll() is None:
            watch.look()
            if time.monotonic() < begin_s + STILL_S - 1.0:  # the followers come to the start from their rest
                watch.began = len(watch.rows["left"])
        assert commands.finish(process, START_S) == 0, commands.output()[-4000:]
    finally:
        process.kill()
        process.wait()
        for side in START:
            commands.rig.release(f"leader_{side}")
    return commands, LeRobotDataset("local/yam_sim", root=commands.directory / "data"), watch


def test_the_data_set_speaks_of_tools(recorded):
    _, data, watch = recorded
    for feature in ("action", "observation.state"):
        assert list(data.features[feature]["names"]) == KEYS
    table = data.hf_dataset.with_format("numpy")
    state = np.stack(table["observation.state"])
    assert np.ptp(np.stack(table["action"])[:, :3], axis=0).max() > 0.1, "the leader did not move"
    for index, side in enumerate(START):
        seen = state[FPS : -FPS // 2, 7 * index : 7 * index + 3]
        assert off_path(seen, watch.path(side)).max() < 0.005  # what was observed is where the tool was


def test_replay_brings_the_tools_back(recorded):
    commands, data, watched = recorded
    process = commands.start(
        "lerobot-replay",
        "--config_path=configs/sim/replay.yaml",
        "--robot.action_space=ee",
        f"--dataset.repo_id={data.repo_id}",
        f"--dataset.root={data.root}",
        "--dataset.episode=0",
    )
    commands.wait_enabled(process, "follower_left", "follower_right", timeout_s=START_S)
    watch = Watch(commands.rig)
    while process.poll() is None and commands.enabled("follower_left", "follower_right"):
        watch.look()
    assert commands.finish(process) == 0, commands.output()[-4000:]
    actions = np.stack(data.hf_dataset.with_format("numpy")["action"])
    for index, side in enumerate(START):
        path, before = watch.path(side), watched.path(side)[watched.began :]
        begin, end = before[0], before[-1]
        first = int(np.argmax(np.linalg.norm(path - begin, axis=1) < ERROR_M))  # from rest, it comes to the start
        last = int(np.linalg.norm(path - end, axis=1).argmin())
        final = np.linalg.norm(path[last] - end)
        deviation = off_path(path[first : last + 1], before)
        asked = off_path(path[first : last + 1], actions[:, 7 * index : 7 * index + 3])
        logger.info(
            f"{side}: final {final * 1e3:.2f} mm, path {deviation.max() * 1e3:.2f} mm (median "
            f"{np.median(deviation) * 1e3:.2f}), from the recorded actions {asked.max() * 1e3:.2f} mm"
        )
        assert first > 0 and last > first + 100
        assert final <= ERROR_M and deviation.max() <= ERROR_M
    commands.assert_landed()
