"""Choice of the arm and gripper that Commander shows. Commander passes no options, so environment variables are used.

YAM_WALDO_ARM=big_yam YAM_WALDO_GRIPPER=crank_4310 waldo-commander --host 127.0.0.1
"""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.export.model_export import frame
from lerobot_robot_yam.arm.profile import GripperProfile
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ConfigError

ENV_ARM, ENV_GRIPPER = "YAM_WALDO_ARM", "YAM_WALDO_GRIPPER"
NO_TOOL = "NONE"


class ArmChoice(NamedTuple):
    """Arm and gripper, each given as a profile name or as the path of a YAML file."""

    arm: str = "yam"
    gripper: str = "linear_4310"

    @classmethod
    def of_environment(cls) -> "ArmChoice":
        """Return the choice given by the environment variables, with defaults for missing variables."""
        return cls(os.environ.get(ENV_ARM, "yam"), os.environ.get(ENV_GRIPPER, "linear_4310"))

    def environment(self) -> dict[str, str]:
        """Return the environment variables for this choice."""
        return {ENV_ARM: self.arm, ENV_GRIPPER: self.gripper}

    def resolved(self) -> ResolvedArm:
        """Return the arm's profiles and limits. Raises ConfigError: the arm or gripper is unknown."""
        return ResolvedArm(ArmConfig(channel="none", name=Path(self.arm).stem, arm=self.arm, gripper=self.gripper))


def tool_key(gripper: GripperProfile) -> str:
    """Return Commander's key for a gripper, or "NONE" if the gripper has no motor."""
    return NO_TOOL if gripper.motor is None else gripper.name.upper().replace(" ", "_")


def tool_keys(gripper: GripperProfile) -> list[str]:
    """Return Commander's tool keys for an arm with this gripper, in display order."""
    return list(dict.fromkeys((NO_TOOL, tool_key(gripper))))


def tool_centre(gripper: GripperProfile) -> np.ndarray:
    """Return the pose (4, 4), m, in the flange frame of the point between the fingers, or else of the tip.

    `gripper`: mounted profile (`mounting.mounted`), whose first body is fixed to the flange.
    """
    (root, *_) = gripper.bodies
    sites = {site.name: site for site in root.sites}
    site = sites.get("grasp_site", sites["tcp_site"])
    return frame(root.pos_m, root.quat_wxyz) @ frame(site.pos_m, site.quat_wxyz)


def tip(gripper: GripperProfile, key: str, offset_m: np.ndarray) -> np.ndarray:
    """Return the pose (4, 4), m, of the tool's tip in the flange frame, with an offset (3,) along the tool's own axes.

    Raises:
        ConfigError: the arm has no tool with this key.
    """
    if key not in tool_keys(gripper):
        raise ConfigError(f"no tool {key!r}; this arm has {', '.join(tool_keys(gripper))}")
    moved = np.eye(4)
    moved[:3, 3] = offset_m
    return moved if key == NO_TOOL else tool_centre(gripper) @ moved
