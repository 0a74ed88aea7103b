"""Write docs/options.md from the descriptions of the options, which `--help` shows too.

scripts/run python scripts/options_page.py > docs/options.md
"""

import dataclasses
import enum

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.option import options_of
from lerobot_robot_yam.config_yam_camera import YamSimCameraConfig
from lerobot_robot_yam.config_yam_env import YamEnvConfig
from lerobot_robot_yam.config_yam_follower import CameraOptions, YamRigConfig
from lerobot_robot_yam.config_yam_realsense import YamRealsenseCameraConfig
from lerobot_robot_yam.face.devices.remote_device import RemoteOptions
from lerobot_robot_yam.face.driving.drive_options import DriveOptions, PadOptions
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.rail_config import RailConfig
from lerobot_robot_yam.robot_options import BaseOptions, FollowerOptions
from lerobot_strategy_yam.config_yam_dagger import YamDaggerStrategyConfig
from lerobot_teleoperator_yam.config_yam_gamepad import YamBaseKeysConfig
from lerobot_teleoperator_yam.config_yam_hand_guide import (
    BiYamHandGuideConfig,
    HandGuideOptions,
    YamHandGuideConfig,
)
from lerobot_teleoperator_yam.config_yam_mobile_leader import YamMobileLeaderConfig
from lerobot_teleoperator_yam.config_yam_passive_leader import PassiveLeaderArmConfig
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig, LeaderOptions

_PAGE = """# Options

Every option of arms, robots, teleoperators, rollouts, cameras and environments, with its default. `--help` of
LeRobot's commands says the same, of the type that stands before it: `--robot.type=yam_follower --help`.

This page is written by `scripts/run python scripts/options_page.py`.
"""
_SECTIONS = [
    (
        "An arm",
        "Write `--robot.gripper=…` for a single arm and `--robot.left_arm_config.gripper=…` for one of two; for\n"
        "leaders `--teleop.…`. In a run config they are keys of the same names.",
        ArmConfig,
    ),
    ("A leader arm", "A leader's arm has these, too, and other defaults of two of those above.", LeaderArmConfig),
    (
        "The workspace of an arm",
        "Write `--robot.workspace.floor_z_m=0`. See [workspace](workspace.md).",
        WorkspaceConfig,
    ),
    ("A robot", "Options of `yam_follower` and `bi_yam_follower` as a whole.", FollowerOptions),
    ("The cameras of a robot", "Of any robot.", CameraOptions),
    (
        "A mobile base",
        "Write `--robot.velocity_limit=…` with `yam_base`, `--robot.base_config.velocity_limit=…` with `yam_mobile`.\n"
        "See [mobile base](mobile-base.md).",
        BaseConfig,
    ),
    (
        "The rail of a mobile base",
        "Write `--robot.rail.io=gpio`. See [linear rail](mobile-base.md#linear-rail).",
        RailConfig,
    ),
    (
        "A robot with a mobile base",
        "Options of `yam_base` and `yam_mobile` as a whole, besides `cameras` and `isolation` of any robot.\n"
        "`yam_mobile` has those of `bi_yam_follower`, too.",
        BaseOptions,
    ),
    ("A teleoperator", "Options of `yam_leader` and `bi_yam_leader` as a whole.", LeaderOptions),
    (
        "A hand that guides a follower",
        "Options of `yam_hand_guide` and `bi_yam_hand_guide`. See [hand-guiding](hand-guiding.md).",
        HandGuideOptions,
    ),
    ("The key of one gripper", "Of `yam_hand_guide`.", YamHandGuideConfig),
    ("The keys of two grippers", "Of `bi_yam_hand_guide`.", BiYamHandGuideConfig),
    (
        "A leader without motors",
        "Options of `yam_passive_leader`, and of each arm of `bi_yam_passive_leader`. See\n"
        "[other leaders](other-leaders.md).",
        PassiveLeaderArmConfig,
    ),
    (
        "A driver of a base",
        "Options of `yam_gamepad` and `yam_base_keys`. See [gamepad](gamepad.md).",
        DriveOptions,
    ),
    ("A gamepad", "Of `yam_gamepad`.", PadOptions),
    ("Keys", "Of `yam_base_keys`.", YamBaseKeysConfig),
    (
        "Two leaders and a driver of the base",
        "Options of `yam_mobile_leader`, which has those of `bi_yam_leader`, of a driver and of a gamepad, too.",
        YamMobileLeaderConfig,
    ),
    (
        "A rollout that you share with the policy",
        "Options of `lerobot-rollout --strategy.type=yam_dagger`. See [rollout](rollout.md#corrections-arm-by-arm).",
        YamDaggerStrategyConfig,
    ),
    (
        "Arms of another computer",
        "Options of `yam_remote`, `bi_yam_remote`, `yam_base_remote`, `yam_mobile_remote`, and of the teleoperators\n"
        "`yam_remote_leader` and `bi_yam_remote_leader`, which have those of a robot or a teleoperator, too. See\n"
        "[two machines](two-machines.md).",
        RemoteOptions,
    ),
    (
        "A rig's file",
        "Options of the robot `yam_rig`; the teleoperator of this type has them, too, but for `cameras`. See\n"
        "[setup](setup.md).",
        YamRigConfig,
    ),
    ("A virtual camera", "Options of a camera of type `yam_sim`.", YamSimCameraConfig),
    (
        "A real camera",
        "Options of a camera of type `yam_realsense`. See [cameras](cameras.md).",
        YamRealsenseCameraConfig,
    ),
    ("An environment", "Options of `lerobot-eval --env.type=yam`. See [evaluation](evaluation.md).", YamEnvConfig),
]


@dataclasses.dataclass(kw_only=True)
class _Leaders(DriveOptions, PadOptions, LeaderOptions):
    """Options that stand in sections of their own."""


_ABOVE = {
    LeaderArmConfig: ArmConfig,
    YamHandGuideConfig: HandGuideOptions,
    BiYamHandGuideConfig: HandGuideOptions,
    YamBaseKeysConfig: DriveOptions,
    YamMobileLeaderConfig: _Leaders,
}


def _shown(default: object) -> str:
    if default is dataclasses.MISSING:
        return "–"
    if default is None or isinstance(default, WorkspaceConfig) or default in ({}, []):
        return "none"
    default = default.value if isinstance(default, enum.Enum) else default
    return f"`{str(default).lower() if isinstance(default, bool) else default}`"


def page() -> str:
    """Return the whole page."""
    text = _PAGE
    for title, says, kind in _SECTIONS:
        above = {name: default for name, default, _ in options_of(_ABOVE[kind])} if kind in _ABOVE else {}
        rows = [
            f"| `{name}` | {_shown(default)} | {words} |"
            for name, default, words in options_of(kind)
            if words and not (name in above and above[name] == default)
        ]
        text += "\n".join(
            ["", f"## {title}", "", says, "", "| Option | Default | Meaning |", "|---|---|---|", *rows, ""]
        )
    return text


if __name__ == "__main__":
    print(page(), end="")
