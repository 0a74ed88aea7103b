"""LeRobot config of two leaders and a driver of the base (`--teleop.type=yam_mobile_leader`)."""

from dataclasses import dataclass
from typing import Literal

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.arm.config import VIRTUAL
from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.driving.drive_options import DriveOptions, PadOptions, refuse_drive
from lerobot_robot_yam.face.registration import register_as
from lerobot_teleoperator_yam.config_yam_leader import BiYamLeaderConfig
from lerobot_teleoperator_yam.leader_options import BUTTON_OPTIONS, LeaderArmConfig, meanings_of, refuse_leader


@register_as(TeleoperatorConfig, "yam_mobile_leader")
@dataclass(kw_only=True)
class YamMobileLeaderConfig(BiYamLeaderConfig, DriveOptions, PadOptions):
    """Two leader arms, every option of `bi_yam_leader`; and a gamepad or a handle that drives the base."""

    drive: Literal["pad", "left", "right", "rig"] = option(
        "what drives the base: a gamepad; or the left or right leader's handle while drive_button is held, and its "
        "follower stays; or the scripted operator of the virtual rig",
        "pad",
    )
    drive_button: Literal["top", "bottom"] = option("button of the handle, with drive: left or right", "top")

    def __post_init__(self) -> None:
        refuse_leader("yam_mobile_leader", self)
        refuse_drive(self.check_drive, self.check_pad, self.check_handle, device="yam_mobile_leader")

    @property
    def driver(self) -> LeaderArmConfig | None:
        """The leader whose handle drives; None: none does."""
        return {"left": self.left_arm_config, "right": self.right_arm_config}.get(self.drive)

    def check_handle(self, device: str) -> None:
        """Check what drives. Raises ConfigError: there is no such handle, or its button has another meaning."""
        from lerobot_robot_yam.arm.profile_files import load_gripper  # late import, for a quick start

        if self.action_space == "delta":
            raise ConfigError(f"{device}: action_space: delta is for one arm without a base")
        if self.drive not in ("pad", "left", "right", "rig") or self.drive_button not in ("top", "bottom"):
            raise ConfigError(f"{device}: drive is pad, left, right or rig, and drive_button top or bottom")
        if self.drive == "rig" and self.left_arm_config.interface not in (VIRTUAL, "yam_lockstep"):
            raise ConfigError(f"{device}: drive: rig is for leaders of the virtual rig; choose pad, left or right")
        if self.driver is None:
            return
        if not load_gripper(self.driver.gripper).handle_encoder:
            raise ConfigError(f"{device}: drive: {self.drive}: the {self.drive} leader has no teaching handle")
        taken = {getattr(self.driver, name): name for name in BUTTON_OPTIONS}
        if f"{self.drive}_{self.drive_button}" in meanings_of(self):
            taken[self.drive_button] = "buttons"
        if self.drive_button in taken:
            raise ConfigError(
                f"{device}: button {self.drive}_{self.drive_button} has two meanings: drive_button and "
                f"{taken[self.drive_button]}; give it one"
            )
