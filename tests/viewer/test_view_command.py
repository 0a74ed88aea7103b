"""yam-view on the command line: without viser, and what it says of itself."""

import argparse
import subprocess
import sys

from lerobot_robot_yam.commands.pages.view import driving_plan, main
from lerobot_robot_yam.system.own_commands import install_extra
from tests.support.paths import ROOT

WITHOUT_VISER = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("viser", "websockets"):
            raise ModuleNotFoundError(f"No module named {name!r}")

sys.meta_path.insert(0, Absent())
from lerobot_robot_yam.commands.pages.view import main
try:
    main(["--help"])
except SystemExit as ended:
    assert ended.code == 0
assert not {"viser", "torch", "lerobot"} & set(sys.modules)
for arguments in ([], ["--desktop"]):
    assert main(arguments) == 1
"""


def test_without_viser():
    """It says what to install; its help needs none of it."""
    ended = subprocess.run([sys.executable, "-c", WITHOUT_VISER], capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0, ended.stderr
    assert "--host" in ended.stdout and "Traceback" not in ended.stderr
    assert ended.stderr.count(install_extra("view")) == 2


def test_followers_of_a_run_config_are_driven_and_nothing_else():
    path = ROOT / "configs" / "real" / "teleoperate.yaml"
    found = driving_plan(argparse.Namespace(config_path=path, rig=None)).configs
    assert [config.channel for config in found] == ["can_follower_l", "can_follower_r"]
    assert all(config.calibration_path and "robots" in config.calibration_path for config in found)


def test_the_window_refuses_a_data_set_and_asks_the_other_computer(capsys):
    assert main(["--desktop", "--dataset", "data/mine"]) == 1
    assert "the window shows no data set" in capsys.readouterr().err
    assert main(["--desktop", "--remote", "127.0.0.1:1"]) == 1  # nobody is there
    assert "127.0.0.1:1" in capsys.readouterr().err
