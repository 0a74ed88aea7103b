"""Other projects' distributions beside ours: names that they take, files that they put over ours, a newer LeRobot."""

import json
import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import draccus
import pytest
from lerobot.robots import RobotConfig, make_robot_from_config
from lerobot.teleoperators import TeleoperatorConfig, make_teleoperator_from_config

import lerobot_robot_yam
from lerobot_robot_yam.config_yam_follower import BiYamFollowerConfig, YamFollowerConfig
from lerobot_robot_yam.face.start_messages import NEWEST_TESTED
from lerobot_robot_yam.system import other_plugins
from lerobot_teleoperator_yam.config_yam_leader import BiYamLeaderConfig, YamLeaderConfig
from tests.support.plugins import THEIR_TYPES, write_metadata, write_plugin

ROOT = Path(lerobot_robot_yam.__file__).parent.parent
CHOICES = """
    import json
    import lerobot.scripts.lerobot_calibrate as command
    from lerobot.robots import RobotConfig
    from lerobot.teleoperators import TeleoperatorConfig
    command.register_third_party_plugins()
    command.register_third_party_plugins()
    import draccus
    from lerobot.robots import make_robot_from_config
    from lerobot_robot_yam import YamFollowerConfig
    config = YamFollowerConfig(channel="can9")  # in Python one uses the class that one knows
    assert make_robot_from_config(config).name == "yam_follower"
    assert draccus.decode(RobotConfig, draccus.encode(config, RobotConfig)) == config
    choices = {**RobotConfig.get_known_choices(), **TeleoperatorConfig.get_known_choices()}
    print(json.dumps({name: c.__module__ for name, c in choices.items() if "yam" in name}))
"""
ONE = {"channel": "can9", "id": "lab"}
TWO = {"left_arm_config": {"channel": "can8"}, "right_arm_config": {"channel": "can9"}, "id": "lab"}
DEVICES = {
    "yam_follower": (RobotConfig, make_robot_from_config, YamFollowerConfig, ONE),
    "bi_yam_follower": (RobotConfig, make_robot_from_config, BiYamFollowerConfig, TWO),
    "yam_leader": (TeleoperatorConfig, make_teleoperator_from_config, YamLeaderConfig, ONE),
    "bi_yam_leader": (TeleoperatorConfig, make_teleoperator_from_config, BiYamLeaderConfig, TWO),
}


def run(site, program):
    """Run a program with what is installed in `site` before all else; returns the finished process."""
    path = os.pathsep.join([str(site), *filter(None, [os.environ.get("PYTHONPATH")])])
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        cwd=site,
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=280,
    )


def overlay(site, name, files):
    """Our packages as they are installed, with the files of another distribution over those of one of them."""
    for package in ("lerobot_robot_yam", "lerobot_strategy_yam", "lerobot_teleoperator_yam"):
        ignore = shutil.ignore_patterns("__pycache__", "configs")
        shutil.copytree(ROOT / package, site / package, ignore=ignore, copy_function=os.symlink)
    write_plugin(site, name, "0.1.2", name, files)


@pytest.mark.parametrize("name", DEVICES)
def test_each_device_has_a_second_name_and_is_the_same_by_it(name):
    base, make, config_class, fields = DEVICES[name]
    spare = name.replace("yam", "i2rt_yam")
    made = {}
    for type_name in (name, spare):
        config = draccus.decode(base, {"type": type_name, **fields})
        assert config.type == type_name and isinstance(config, config_class)
        assert draccus.decode(base, json.loads(json.dumps(draccus.encode(config, base)))) == config
        assert draccus.encode(config, base)["type"] == type_name
        made[type_name] = make(config)
    assert type(made[name]) is type(made[spare])
    assert made[name].calibration_fpath == made[spare].calibration_fpath  # the stops are found by either
    assert made[name].name == made[spare].name == name  # data sets go together, too


def test_a_name_that_is_taken_costs_that_name_only(tmp_path):
    write_plugin(tmp_path, "lerobot_robot_theirs", "1.2", "lerobot_robot_theirs", {"__init__.py": THEIR_TYPES})
    done = run(tmp_path, CHOICES)
    assert done.returncode == 0, done.stderr
    held = json.loads(done.stdout)
    theirs = {name for name, module in held.items() if module == "lerobot_robot_theirs"}
    assert theirs == {"yam_follower", "bi_yam_leader"}
    spares = {f"{bi}i2rt_yam_{kind}" for bi in ("", "bi_") for kind in ("follower", "leader")}
    kinds = ("hand_guide", "passive_leader", "remote", "remote_leader")
    others = {f"{bi}yam_{kind}" for bi in ("", "bi_") for kind in kinds}
    others |= {"yam_base", "yam_mobile", "yam_base_remote", "yam_mobile_remote"}
    others |= {"yam_gamepad", "yam_base_keys", "yam_mobile_leader"}
    assert set(held) - theirs == spares | others | {"bi_yam_follower", "yam_leader", "yam_rig"}
    said = [line for line in done.stderr.splitlines() if "lerobot_robot_theirs 1.2" in line]
    assert len(said) == 2
    assert "'yam_follower'" in said[0] and "use 'i2rt_yam_follower'" in said[0]
    assert "'bi_yam_leader'" in said[1] and "use 'bi_i2rt_yam_leader'" in said[1]


@pytest.mark.long
@pytest.mark.parametrize("theirs", [{"config_yam_leader.py": THEIR_TYPES}, {}], ids=["other", "none"])
def test_another_projects_leaders_over_ours_are_noticed(theirs, tmp_path):
    overlay(tmp_path, "lerobot_teleoperator_yam", {"__init__.py": "", **theirs})
    if not theirs:
        (tmp_path / "lerobot_teleoperator_yam" / "config_yam_leader.py").unlink()
    done = run(tmp_path, CHOICES)
    said = done.stderr.strip().splitlines()
    error = next(line for line in said if "errors.ConfigError: " in line)
    assert "lerobot_teleoperator_yam.config_yam_leader" in error and "lerobot_teleoperator_yam 0.1.2" in error
    assert "pip uninstall lerobot_robot_yam lerobot_teleoperator_yam" in error and "from its clone" in error


@pytest.mark.long
def test_our_remaining_files_notice_another_projects_package_over_ours(tmp_path):
    """LeRobot imports nothing else of us then: it is up to the leaders, and to the doctor."""
    theirs = {"__init__.py": "from . import config_yam_follower", "config_yam_follower.py": ""}
    overlay(tmp_path, "lerobot_robot_yam", theirs)
    leaders = run(tmp_path, "import lerobot_teleoperator_yam")
    assert "ConfigError: lerobot_robot_yam is not the YAM driver's: lerobot_robot_yam 0.1.2" in leaders.stderr
    (tmp_path / "sysfs").mkdir()
    look = "from lerobot_robot_yam.commands.doctor import main; main(['--json', '--sysfs=sysfs'])"
    doctor = run(tmp_path, look)
    assert "lerobot_robot_yam is not the YAM driver's" in doctor.stdout, doctor.stderr


@pytest.mark.long
def test_a_newer_lerobot_is_spoken_of_once(tmp_path):
    write_metadata(tmp_path, "lerobot", "0.7.0")
    done = run(tmp_path, "import lerobot_robot_yam, lerobot.robots.config, lerobot.cameras.configs")
    assert done.returncode == 0, done.stderr
    assert done.stderr.count(f"LeRobot 0.7.0 is newer than {NEWEST_TESTED}") == 1


@pytest.mark.parametrize("version, warned", [("0.7.0rc1", 1), ("0.6.10", 1), (NEWEST_TESTED, 0), ("0.6.1", 0)])
def test_which_lerobot_is_newer(version, warned, tmp_path):
    write_metadata(tmp_path, "lerobot", version)
    done = run(
        tmp_path,
        "from lerobot_robot_yam.face.start_messages import warn_if_newer; warn_if_newer(); warn_if_newer()",
    )
    assert done.stderr.count("newer than") == warned, done.stderr


def test_the_file_that_marks_our_distribution_is_ours():
    assert (ROOT / other_plugins._OURS_ALONE).is_file()
