"""The reader of rig files reads what LeRobot's parser reads, refuses what that refuses, and loads no LeRobot."""

import dataclasses
import subprocess
import sys
from types import SimpleNamespace

import pytest
import yaml
from lerobot.robots.config import RobotConfig
from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.commands.servers.rig_reader import check_options, read_rig
from lerobot_robot_yam.doctor.kit.targets import calibration_root
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.lerobot_command import config_refusal
from lerobot_robot_yam.face.lerobot_command.config_refusal import arm_config, rig_device
from lerobot_robot_yam.mobile.base_config import BASE_PREFIX, with_rail_file
from lerobot_robot_yam.system.strict_yaml import read_yaml
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig
from tests.support.hosted import rig_file
from tests.support.paths import ROOT

REGISTRIES = {"robot": RobotConfig, "teleop": TeleoperatorConfig}
FOLDERS = {"robot": ("robots", "follower"), "teleop": ("teleoperators", "leader")}
SERVED = ("yam_follower", "bi_yam_follower", "yam_base", "yam_mobile", "yam_leader", "bi_yam_leader")
RUN_CONFIGS = sorted(
    path
    for path in (ROOT / "configs").rglob("*.yaml")
    if all(device.get("type") in SERVED for name in REGISTRIES if isinstance(device := read_yaml(path).get(name), dict))
    and any(name in read_yaml(path) for name in REGISTRIES)
)
LEADER = {"channel": "can1", "follower": "can0"}
BASE_OPTIONS = {"channel": "can_base", "velocity_limit": [0.3, 0.3, 1], "observe_wheels": True, "rate_hz": 200}

ARMS = {f"{side}_arm_config": {"channel": f"can_{side}", "rate_hz": 200} for side in ("left", "right")}
MOBILE = {"type": "yam_mobile", **ARMS, "base_config": {"channel": "can_base", "rate_hz": 200}}


def by_lerobot(path, section):
    """What LeRobot's parser makes of a section: configs and options by prefix."""
    device = rig_device(REGISTRIES[section], section, {"file": str(path), "cameras": False})
    if device.type == "yam_base":
        directory = device.calibration_dir or calibration_root() / "robots" / "yam_base"
        config = with_rail_file(device.base(), directory, device.id)
        return {BASE_PREFIX: config}, {BASE_PREFIX: dataclasses.asdict(device.base())}
    folder, role = FOLDERS[section]
    directory = device.calibration_dir or calibration_root() / folder / device.type.replace("i2rt_", "")
    configs, options = {}, {}
    for prefix, arm in device.arms().items():
        config = configs[prefix] = arm_config(arm, f"{prefix}{role}")
        name = f"{prefix}{device.id}" if device.id else arm.channel
        config.calibration_path = config.calibration_path or str(directory / "yam" / f"{name}_gripper.json")
        fields = {field.name for field in dataclasses.fields(LeaderArmConfig if role == "leader" else ArmConfig)}
        options[prefix] = {name: value for name, value in dataclasses.asdict(arm).items() if name in fields}
        options[prefix]["name"] = config.name
    if device.type == "yam_mobile":
        configs[BASE_PREFIX] = with_rail_file(device.base(), directory, device.id)
        options[BASE_PREFIX] = dataclasses.asdict(device.base())
    return configs, options


def written(tmp_path, document):
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


def agree(path):
    devices = read_rig(path)
    assert [device.role for device in devices] == [name for name in REGISTRIES if read_yaml(path).get(name)]
    for device in devices:
        configs, options = by_lerobot(path, device.role)
        assert device.configs == configs and list(device.configs) == list(configs)
        assert device.options == options


@pytest.mark.parametrize("path", RUN_CONFIGS, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_the_run_configs_are_read_as_lerobot_reads_them(path):
    agree(path)


@pytest.mark.parametrize(
    "document",
    [
        {"robot": {"type": "yam_follower", "channel": "can0", "kp": [1] * 6, "use_degrees": True, "id": 7}},
        {
            "robot": {
                "type": "i2rt_yam_follower",
                "channel": "can0",
                "workspace": {"floor_z_m": 0},
                "max_state_age_s": "1e-1",
            }
        },
        {"robot": {"type": "yam_base", **BASE_OPTIONS}},
        {"robot": {"type": "yam_base", **BASE_OPTIONS, "rail": {"stroke_m": 1}, "rail_action": "pos"}},
        {"robot": {**MOBILE, "id": "lab"}},
        {"teleop": {"type": "yam_leader", **LEADER, "gate": "auto", "bilateral": 0.1, "calibration_dir": "/x"}},
        {
            "robot": {"type": "yam_follower", "channel": "can0", "cameras": {"top": {"type": "opencv"}}},
            "teleop": {"type": "yam_leader", **LEADER, "mirror": True, "buttons": {"stop": "top"}},
        },
    ],
    ids=lambda document: "-".join(device["type"] for device in document.values()),
)
def test_a_file_is_read_as_lerobot_reads_it(tmp_path, document):
    agree(written(tmp_path, document))


def test_files_of_rigs_are_read_as_lerobot_reads_them(tmp_path):
    agree(rig_file(tmp_path, SimpleNamespace(name="a-rig")))
    agree(rig_file(tmp_path, SimpleNamespace(name="a-rig"), gate="auto"))


@pytest.mark.parametrize(
    ("section", "device", "said"),
    [
        ("robot", {"type": "yam_follower", "channel": "can0", "max_relativ_target": 1.0}, "max_relativ_target"),
        ("robot", {"type": "yam_follower", "channel": "can0", "use_degrees": "maybe"}, "maybe"),
        ("robot", {"type": "yam_follower", "channel": "can0", "kp": [1.0]}, "kp takes 6 numbers"),
        ("robot", {"type": "yam_follower", "channel": "can0", "track_integral": None}, "true or false"),
        ("robot", {"type": "yam_follower", "gripper": "linear_4310"}, "channel"),
        ("robot", {"type": "yam_follower", "channel": "can0", "gripper": "a_hand"}, "a_hand"),
        ("robot", {"type": "bi_yam_follower", "left_arm_config": {"channel": "can0"}}, "right_arm_config"),
        (
            "robot",
            {"type": "bi_yam_follower", "left_arm_config": {"channel": "can0"}, "right_arm_config": None},
            "channel",
        ),
        (
            "robot",
            {"type": "bi_yam_follower", "left_arm_config": {"channel": "c"}, "right_arm_config": {"channel": "c"}},
            "different names and channels",
        ),
        ("robot", {"type": "yam_base", **BASE_OPTIONS, "rate_hz": 50}, "100 to 350"),
        ("robot", {"type": "yam_base", **BASE_OPTIONS, "wheels": 4}, "wheels"),
        ("robot", {**MOBILE, "base_config": {"channel": "can_base", "rate_hz": 250}}, "same rate_hz"),
        ("robot", {**MOBILE, "base_config": {"channel": "can_left", "rate_hz": 200}}, "different names and channels"),
        ("robot", {**MOBILE, "base_config": {"channel": "can_base", "rate_hz": 20}}, "100 to 350"),
        ("teleop", {"type": "yam_leader", "channel": "can1", "gate": "auto"}, "set follower"),
        ("teleop", {"type": "yam_leader", **LEADER, "follower_arm": "a_leg"}, "a_leg"),
        ("teleop", {"type": "yam_leader", **LEADER, "bilateral": [0.1] * 3}, "6 numbers"),
        ("teleop", {"type": "yam_leader", **LEADER, "buttons": {"dance": "top"}}, "dance"),
    ],
    ids=str,
)
def test_what_lerobot_refuses_is_refused(tmp_path, section, device, said):
    path = written(tmp_path, {section: device})
    with pytest.raises(ConfigError, match=said) as ours:
        read_rig(path)
    with pytest.raises(ConfigError, match=said):
        by_lerobot(path, section)
    assert str(path) in str(ours.value)


@pytest.mark.parametrize("section, kind", [*(("robot", kind) for kind in SERVED[:4]), ("teleop", "yam_leader")])
@pytest.mark.parametrize(
    "options",
    [{"channel": "can0", "cameras": {}}, {"chanel": "can0"}, {"base_config": {"chanel": "c", "rate_hz": 200}}],
)
def test_names_of_options_are_checked_as_lerobot_checks_them(section, kind, options):
    def told(check):
        try:
            check(section, {"type": kind, **options}, "rig.yaml")
        except ConfigError as error:
            return str(error)
        return ""

    assert told(check_options) == told(config_refusal.check_options)


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({"teleop": {"type": "yam_passive_leader", "channel": "can9"}}, "no yam_passive_leader"),
        ({"robot": {"type": "yam_leader", "channel": "can9"}}, "no yam_leader"),
        ({"robot": {"type": "so101_follower", "port": "/dev/ttyACM0"}}, "no so101_follower"),
        ({"robot": {"channel": "can9"}}, "no device without type"),
        ({"dataset": {}}, "has no arms"),
    ],
)
def test_what_a_host_does_not_serve_is_refused(tmp_path, document, said):
    with pytest.raises(ConfigError, match=said):
        read_rig(written(tmp_path, document))


READ = """
import sys
from pathlib import Path
from lerobot_robot_yam.commands.servers.host import groups_of
print([group.device for group in groups_of(Path(sys.argv[1]))])
print([name for name in ("lerobot", "torch", "mujoco") if name in sys.modules])
"""


def test_neither_lerobot_nor_torch_nor_mujoco_is_loaded(tmp_path):
    path = rig_file(tmp_path, SimpleNamespace(name="a-rig"), gate="auto")
    answer = subprocess.run([sys.executable, "-c", READ, str(path)], capture_output=True, text=True, check=True)
    assert answer.stdout.splitlines() == ["['bi_yam_follower', 'bi_yam_leader']", "[]"]
