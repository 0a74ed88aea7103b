"""Commands that documents and configs tell readers to type: LeRobot takes them, and one finds what another has left."""

import re
from pathlib import Path

import draccus
import pytest
from lerobot.configs.train import TrainPipelineConfig
from lerobot.robots import make_robot_from_config
from lerobot.scripts.lerobot_calibrate import CalibrateConfig
from lerobot.scripts.lerobot_record import RecordConfig
from lerobot.utils.constants import CHECKPOINTS_DIR, LAST_CHECKPOINT_LINK, PRETRAINED_MODEL_DIR

ROOT = Path(__file__).parent.parent
EVALUATION, TRAINING = "configs/train/lift_and_place_eval.yaml", "configs/train/lift_and_place_train.yaml"
GATHERING = ("docs/evaluation.md", "lerobot_robot_yam/gather.py")
SINGLE_ARM = "configs/real/single_arm_record.yaml"


def options(place, program, containing):
    """Options of the one command of that program in a file that has this in it, by name."""
    text = re.sub(r"\\\n#?\s*", "", (ROOT / place).read_text())
    found = [line for line in re.findall(rf"{program} [^\n`]*", text) if containing in line]
    assert len(set(found)) == 1, f"{place}: {found}"
    return dict(re.findall(r"--([\w.-]+)[= ](\S+)", found[0]))


@pytest.mark.parametrize("place", ["docs/evaluation.md", TRAINING])
def test_what_is_gathered_is_trained_on(place):
    train = options(place, "lerobot-train", TRAINING)
    gathered = [options(where, "yam-gather", EVALUATION)["root"] for where in GATHERING]
    assert gathered == [train["dataset.root"]] * len(GATHERING)
    arguments = [f"--{name}={value}" for name, value in train.items() if name != "config_path"]
    config = draccus.parse(TrainPipelineConfig, ROOT / train["config_path"], arguments)
    assert config.dataset.root == train["dataset.root"] and str(config.output_dir) == train["output_dir"]


@pytest.mark.parametrize("place", ["docs/evaluation.md", EVALUATION])
def test_what_is_trained_is_evaluated(place):
    trained = Path(options("docs/evaluation.md", "lerobot-train", TRAINING)["output_dir"])
    evaluated = options(place, "lerobot-eval", EVALUATION)["policy.path"]
    assert Path(evaluated) == trained / CHECKPOINTS_DIR / LAST_CHECKPOINT_LINK / PRETRAINED_MODEL_DIR


@pytest.mark.parametrize("place", ["README.md", SINGLE_ARM])
def test_what_a_single_arm_stores_is_found_by_its_recording(place, tmp_path, monkeypatch):
    monkeypatch.setattr("lerobot.robots.robot.HF_LEROBOT_CALIBRATION", tmp_path)
    given = options(place, "lerobot-calibrate", "yam_follower")
    calibrated = draccus.parse(CalibrateConfig, None, [f"--{name}={value}" for name, value in given.items()]).robot
    recorded = draccus.parse(RecordConfig, ROOT / SINGLE_ARM, []).robot
    stored, sought = (make_robot_from_config(config)._arms._configs[0] for config in (calibrated, recorded))
    assert Path(stored.calibration_path).is_relative_to(tmp_path)
    assert (stored.calibration_path, stored.channel) == (sought.calibration_path, sought.channel)
    assert (stored.arm, stored.gripper) == (sought.arm, sought.gripper)
