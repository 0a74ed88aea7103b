"""One file per rig: stock commands take it, and their configs name it by the type `yam_rig`."""

import draccus
import pytest
import yaml
from lerobot.scripts.lerobot_calibrate import CalibrateConfig
from lerobot.scripts.lerobot_record import RecordConfig
from lerobot.scripts.lerobot_replay import ReplayConfig
from lerobot.scripts.lerobot_teleoperate import TeleoperateConfig

from lerobot_robot_yam.config_yam_follower import BiYamFollowerConfig, YamFollowerConfig
from lerobot_robot_yam.doctor.kit.targets import from_config
from lerobot_robot_yam.face.lerobot_command.command_checks import channels_of
from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError
from lerobot_teleoperator_yam.config_yam_leader import BiYamLeaderConfig
from tests.support.lerobot_calls import while_parsing

CAMERA = {"type": "yam_sim", "camera": "top"}
TWO = {
    "robot": {
        "type": "bi_yam_follower",
        "id": "lab",
        "left_arm_config": {"channel": "a", "speed_limit_rad_s": 1.5, "cameras": {"wrist": CAMERA}},
        "right_arm_config": {"channel": "b", "gripper": "crank_4310"},
        "cameras": {"top": CAMERA},
    },
    "teleop": {
        "type": "bi_yam_leader",
        "id": "lab",
        "left_arm_config": {"channel": "c"},
        "right_arm_config": {"channel": "d", "ee_gripper": "crank_4310"},
    },
}
ONE = {"robot": {"type": "yam_follower", "channel": "a", "speed_limit_rad_s": 1.5}}
DATASET = {"repo_id": "local/x", "single_task": "none"}
NAMES_IT = {"robot": {"type": "yam_rig", "file": "rig.yaml"}, "teleop": {"type": "yam_rig", "file": "rig.yaml"}}
REPLAY = ["--robot.type=yam_rig", "--robot.file=rig.yaml", "--dataset.repo_id=local/x", "--dataset.episode=0"]


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Writes a file where commands are run; by default the rig's."""
    monkeypatch.chdir(tmp_path)

    def written(document, name="rig.yaml"):
        (tmp_path / name).write_text(yaml.safe_dump(document))
        return tmp_path / name

    return written


def test_the_file_itself_is_a_config(write):
    path = write(TWO)
    assert draccus.parse(TeleoperateConfig, path, []).teleop.left_arm_config.channel == "c"
    options = [f"--dataset.{name}={value}" for name, value in DATASET.items()]
    assert draccus.parse(RecordConfig, path, options).robot.right_arm_config.gripper == "crank_4310"


def test_configs_name_it_and_get_devices_of_its_types(write):
    write(TWO)
    config = draccus.parse(RecordConfig, write({**NAMES_IT, "dataset": DATASET}, "record.yaml"), [])
    assert type(config.robot) is BiYamFollowerConfig and type(config.teleop) is BiYamLeaderConfig
    assert config.robot.type == "bi_yam_follower" and config.robot.id == "lab"
    assert list(config.robot.all_cameras()) == ["top", "left_wrist"]
    write(ONE)
    assert type(draccus.parse(ReplayConfig, None, REPLAY).robot) is YamFollowerConfig


@pytest.mark.parametrize(("rig", "arm"), [(TWO, lambda robot: robot.right_arm_config), (ONE, lambda robot: robot)])
def test_options_are_laid_over_the_file(write, rig, arm):
    write(rig)
    given = ["--robot.type=yam_rig", "--robot.file=rig.yaml", "--robot.id=other", "--robot.cameras=false"]
    given += ["--robot.options={use_degrees: true}", "--robot.arm_options={speed_limit_rad_s: 0.5}"]
    robot = draccus.parse(CalibrateConfig, None, given).robot
    assert (robot.id, robot.use_degrees, robot.all_cameras()) == ("other", True, {})
    assert arm(robot).speed_limit_rad_s == 0.5


@pytest.mark.parametrize(
    ("rig", "says"),
    [
        (None, "robot: there is no rig.yaml, the rig's file; yam-setup writes it"),
        ({"teleop": TWO["teleop"]}, "rig.yaml has no robot: run yam-setup with the followers plugged in"),
        ({"robot": NAMES_IT["robot"]}, "rig.yaml, robot: a rig's file holds the arms themselves"),
        ({"robot": {**ONE["robot"], "chanel": "x"}}, "rig.yaml, robot: The fields `chanel` are not valid"),
        ({"robot": {**ONE["robot"], "kp": [1]}}, "rig.yaml, robot: follower: kp takes 6 numbers"),
        ({"robot": {**ONE["robot"], "type": "yam_folower"}}, "rig.yaml, robot: Couldn't find a choice class for"),
        ("robot", "rig.yaml holds no YAML mapping"),
    ],
)
def test_mistakes_are_one_line_that_names_the_file(write, rig, says):
    if rig is not None:
        write(rig)
    with pytest.raises(RefusedConfigError, match=says) as refused:
        draccus.parse(ReplayConfig, None, REPLAY)
    assert "\n" not in str(refused.value)


def test_the_doctor_and_the_look_for_equal_channels_follow_the_name(write):
    write(TWO)
    path = write(NAMES_IT, "run.yaml")
    assert [target.channel for target in from_config(path, None).targets] == ["a", "b", "c", "d"]
    assert list(while_parsing(lambda: channels_of("teleop"), **NAMES_IT).values()) == ["c", "d"]
