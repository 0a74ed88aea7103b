"""Commands that documents and configs tell readers to type: LeRobot takes them, and one finds what another has left."""

import argparse
import re
import shlex
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import draccus
import pytest
from lerobot.configs.train import TrainPipelineConfig
from lerobot.robots import make_robot_from_config
from lerobot.scripts.lerobot_calibrate import CalibrateConfig
from lerobot.scripts.lerobot_record import RecordConfig
from lerobot.utils.constants import CHECKPOINTS_DIR, LAST_CHECKPOINT_LINK, PRETRAINED_MODEL_DIR

from lerobot_robot_yam.commands import estop
from lerobot_robot_yam.commands.configs import config_names
from lerobot_robot_yam.doctor.kit.targets import from_config
from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError
from lerobot_strategy_yam.config_yam_dagger import TAKES_PLUGINS
from tests.docs import test_configs
from tests.support.pages import PAGES
from tests.support.paths import ROOT

EVALUATION, TRAINING = "configs/train/lift_and_place_eval.yaml", "configs/train/lift_and_place_train.yaml"
GATHERING = ("docs/evaluation.md", "lerobot_robot_yam/commands/data/gather.py")
NEEDS_PLUGINS = pytest.mark.skipif(not TAKES_PLUGINS, reason="needs a LeRobot with strategies from plugins")
KINDS = test_configs.COMMANDS | test_configs.TRAINING
KIND_OF = {"rollout": ("dagger",)}  # kinds of configs that a program takes besides its own
RECORDING, SINGLE_ARM = "docs/recording.md", "configs/real/single_arm_record.yaml"


def options(place, program, containing):
    """Options of the one command of that program in a file that has this in it, by name."""
    text = re.sub(r"\\\n#?\s*", "", (ROOT / place).read_text())
    text = re.sub(r"\n +(?=--)", " ", text)
    found = [line for line in re.findall(rf"{program} [^\n`]*", text) if containing in line]
    assert len(set(found)) == 1, f"{place}: {found}"
    return dict(re.findall(r"--([\w.-]+)[= ](\S+)", found[0]))


def written():
    """Each LeRobot command that a reader can type as it stands, once."""
    seen = set()
    for path in (*PAGES, *sorted(ROOT.glob("configs/*/*.yaml"))):
        text = re.sub(r"\\\n#?\s*", "", path.read_text())
        found = re.findall(r"`(lerobot-[a-z]+ [^`]*)`", text.replace("```", "\0"))
        found += re.findall(r"^#?\s*(?:scripts/run )?(lerobot-[a-z]+ .*)", text, re.MULTILINE)
        for command in dict.fromkeys(re.sub(r"\s+", " ", command).strip() for command in found):
            same = command.replace("--config_path configs", "--config_path=configs")
            if "… " not in command and re.search(r"--config_path|\.type=", command) and same not in seen:
                seen.add(same)
                marks = [NEEDS_PLUGINS] if "yam_dagger" in command else []
                yield pytest.param(command, id=f"{path.name} {command[:60]}", marks=marks)


a_rig = test_configs.a_rig  # the rig.yaml that commands are given


@pytest.mark.parametrize("command", list(written()))
def test_lerobot_takes_what_is_written(command):
    program, *arguments = shlex.split(command)
    options = [option for option in arguments if not option.startswith(("--config_path=", "--policy.path="))]
    (config,) = [option.partition("=")[2] for option in arguments if option.startswith("--config_path=")] or [None]
    kind = program.removeprefix("lerobot-")
    if config and not options and config.startswith("configs/"):  # `test_configs` parses these as they stand
        name = config.removeprefix("configs/").removesuffix(".yaml")
        assert name in config_names() and name.rpartition("/")[2].rpartition("_")[2] in (kind, *KIND_OF.get(kind, ()))
        return
    path = config and (Path(config) if Path(config).is_file() else ROOT / config)  # the rig's is where commands are run
    try:
        parsed = draccus.parse(KINDS[kind], path, options)
    except RefusedConfigError as refused:  # only the reader has what is replayed
        (root,) = [option.partition("=")[2] for option in options if option.startswith("--dataset.root=")]
        assert kind == "replay" and f"there is no data set in {root};" in str(refused)
        return
    dataset = getattr(parsed, "dataset", None)
    for name in ("repo_id", "root"):
        given = [option.partition("=")[2] for option in options if option.startswith(f"--dataset.{name}=")]
        assert not given or str(getattr(dataset, name)) == given[0]


def ours():
    """Each command of this package that a reader can type as it stands, once."""
    seen = set()
    for path in (*PAGES, *sorted(ROOT.glob("configs/*/*.yaml"))):
        text = re.sub(r"\\\n#?\s*", "", path.read_text())
        text = re.sub(r'sudo "\$\(which (yam-[a-z-]+)\)"', r"\1", text)
        found = re.findall(r"`(yam-[^`\n]*)`", text) + re.findall(
            r"^#?\s*(yam-[a-z-]+(?: [^#\n]*)?)", text, re.MULTILINE
        )
        for command in dict.fromkeys(command.strip() for command in found):
            if "…" not in command and command not in seen:
                seen.add(command)
                yield pytest.param(command, id=f"{path.name} {command[:60]}")


@pytest.mark.parametrize("command", list(ours()))
def test_our_programs_take_what_is_written(command, monkeypatch):
    def only_parse(parser, arguments=None, namespace=None):
        _, unknown = parser.parse_known_args(arguments, namespace)
        sys.exit(f"unknown: {unknown}" if unknown else 0)

    program, *arguments = shlex.split(command)
    if program == "yam-estop":  # a shell script, so that it starts at once
        main = estop.main
    else:
        (entry,) = entry_points(group="console_scripts", name=program)
        main = entry.load()
    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", only_parse)
    monkeypatch.chdir(ROOT)
    if arguments or program == "yam-doctor":  # else it is spoken of, not to be typed
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 0


@pytest.mark.parametrize("place", [RECORDING, "configs/real/record.yaml"])
def test_what_is_recorded_is_replayed(place):
    recorded = options(place, "lerobot-record", "configs/real/record.yaml")
    replay = RECORDING if place == RECORDING else "configs/real/replay.yaml"
    replayed = options(replay, "lerobot-replay", "configs/real/replay.yaml")
    assert {name: recorded[f"dataset.{name}"] for name in ("repo_id", "root")} == {
        name: replayed[f"dataset.{name}"] for name in ("repo_id", "root")
    }


def test_the_first_pages_have_their_commands_looked_at():
    looked_at = {command.values[0] for command in written()}
    assert {f"lerobot-{kind}" for kind in ("record", "calibrate", "teleoperate", "replay")} <= {
        command.split()[0] for command in looked_at
    }


@pytest.mark.parametrize("config", ["configs/real/record.yaml", SINGLE_ARM, "configs/sim/record.yaml"])
def test_the_doctor_names_the_calibration_of_this_very_robot(config, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    monkeypatch.setattr("lerobot.robots.robot.HF_LEROBOT_CALIBRATION", tmp_path)
    for target in from_config(ROOT / config, None).targets:
        if not target.hardware.has_gripper:
            continue  # a handle
        robot = draccus.parse(CalibrateConfig, None, shlex.split(target.calibrate)[1:]).robot
        stored = {arm.channel: arm for arm in make_robot_from_config(robot)._arms._configs}[target.channel]
        assert Path(stored.calibration_path) == target.calibration
        assert (stored.arm, stored.gripper) == (target.config.arm, target.config.gripper)


@pytest.mark.long
def test_an_evaluation_knows_real_cameras():
    """`lerobot-eval` imports no camera itself."""
    code = "import lerobot_robot_yam, lerobot.envs.configs\nfrom lerobot.cameras.configs import CameraConfig\n"
    code += "assert {'opencv', 'intelrealsense', 'yam_realsense', 'yam_sim'} <= set(CameraConfig.get_known_choices())"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


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


@pytest.mark.parametrize("place", ["docs/real-arms.md", SINGLE_ARM])
def test_what_a_single_arm_stores_is_found_by_its_recording(place, tmp_path, monkeypatch):
    monkeypatch.setattr("lerobot.robots.robot.HF_LEROBOT_CALIBRATION", tmp_path)
    given = options(place, "lerobot-calibrate", "yam_follower")
    calibrated = draccus.parse(CalibrateConfig, None, [f"--{name}={value}" for name, value in given.items()]).robot
    recorded = draccus.parse(RecordConfig, ROOT / SINGLE_ARM, []).robot
    stored, sought = (make_robot_from_config(config)._arms._configs[0] for config in (calibrated, recorded))
    assert Path(stored.calibration_path).is_relative_to(tmp_path)
    assert (stored.calibration_path, stored.channel) == (sought.calibration_path, sought.channel)
    assert (stored.arm, stored.gripper) == (sought.arm, sought.gripper)
