"""Every option says what it means, in docs/options.md and in the help of LeRobot's commands."""

import importlib
import sys

import pytest
from lerobot.configs import parser
from lerobot.scripts.lerobot_record import RecordConfig

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.option import options_of
from lerobot_robot_yam.config_yam_follower import CameraOptions
from lerobot_robot_yam.robot_options import FollowerOptions
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig, LeaderOptions
from tests.support.paths import ROOT, SCRIPTS

KINDS = (ArmConfig, WorkspaceConfig, FollowerOptions, CameraOptions, LeaderArmConfig, LeaderOptions)


def test_the_page_is_what_the_options_say(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    page = importlib.import_module("options_page").page()
    assert (ROOT / "docs" / "options.md").read_text() == page, (
        "scripts/run python scripts/options_page.py > docs/options.md"
    )


@pytest.mark.parametrize("kind", KINDS)
def test_every_option_has_a_text(kind):
    assert [name for name, _, text in options_of(kind) if not text] == []


@pytest.mark.parametrize(
    ("types", "kinds"),
    [
        (["--robot.type=yam_follower"], (ArmConfig, WorkspaceConfig, FollowerOptions, CameraOptions)),
        (["--teleop.type=yam_leader"], (LeaderArmConfig, LeaderOptions)),
    ],
)
def test_help_says_it_too(monkeypatch, capsys, types, kinds):
    monkeypatch.setattr(sys, "argv", ["lerobot-record", *types, "--help"])
    monkeypatch.setenv("COLUMNS", "200")

    @parser.wrap()
    def command(cfg: RecordConfig):
        pytest.fail("it asked for help")

    with pytest.raises(SystemExit):
        command()
    said = " ".join(capsys.readouterr().out.split())
    for kind in kinds:
        for name, _, text in options_of(kind):
            if name != "workspace":  # a group of options, which have texts of their own
                assert " ".join(text.split()) in said, name
