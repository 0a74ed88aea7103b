"""A leading `~` means the home directory wherever a configuration names a file."""

from pathlib import Path

import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.doctor.kit.targets import from_config
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.scene.scene import load_scene
from tests.support.paths import ROOT

PACKAGE = ROOT / "lerobot_robot_yam"


@pytest.fixture
def home(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path


def test_paths_of_an_arm(home):
    config = ArmConfig(channel="x", calibration_path="~/stops.json", identity_path="~/arm.json")
    assert (config.calibration_path, config.identity_path) == (f"{home}/stops.json", f"{home}/arm.json")


def test_profiles_and_scenes(home):
    (home / "mine.yaml").write_text((PACKAGE / "arm/profiles/arms/yam.yaml").read_text())
    assert load_arm("~/mine.yaml") is not None
    (home / "scene.yaml").write_text("extends: base.yaml\n")
    (home / "far.yaml").write_text("extends: ~/base.yaml\n")
    (home / "base.yaml").write_text((PACKAGE / "rig/scene/scenes/bimanual_table.yaml").read_text())
    for name in ("~/scene.yaml", "~/far.yaml", f"{home}/far.yaml"):
        assert load_scene(name).channels == load_scene().channels


def test_the_doctor_looks_at_the_same_files(home):
    (home / "run.yaml").write_text("robot: {type: yam_follower, channel: can_x, calibration_path: ~/stops.json}")
    (target,) = from_config(Path("~/run.yaml"), None).targets
    assert target.calibration == home / "stops.json"


def test_the_home_of_an_unknown_user_is_refused():
    with pytest.raises(ConfigError, match="~nobody-of-that-name/x.json: .*write the path in full"):
        ArmConfig(channel="x", identity_path="~nobody-of-that-name/x.json")
