"""Checks before leader and follower are energised: this process can lead, and both use the same actions."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lerobot_robot_yam.arm.config import SOCKETCAN, ArmConfig, lead_of
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile
from lerobot_robot_yam.errors import ChannelInUseError, ConfigError
from lerobot_robot_yam.face.devices.feature_names import space_of
from lerobot_robot_yam.face.lerobot_command.running_command import under_a_command
from lerobot_robot_yam.state.records import channel_key
from lerobot_robot_yam.system.runtime_dirs import sessions
from lerobot_robot_yam.system.runtime_files import runtime_dir

Models = Sequence[tuple[ArmProfile, GripperProfile]]
"""Profiles of arm and end effector that actions refer to, for each arm in canonical order."""

_INTERFACES = Path("/sys/class/net")


@dataclass(frozen=True)
class Spoken:
    """Format of a device's actions.

    Attributes:
        device: name in messages.
        action_keys: keys of the device's actions.
        use_degrees: whether angles are in degrees.
        models: profiles of the arms whose joints or end effectors the actions describe.
    """

    device: str
    action_keys: Sequence[str]
    use_degrees: bool
    models: Models


def check_pair(one: Spoken, other: Spoken) -> None:
    """Check that two devices match. Raises ConfigError: their actions differ in space, keys, unit or arm."""
    both = f"{one.device} and {other.device}"
    spaces = {space_of(spoken.action_keys) for spoken in (one, other)}
    if "delta" in spaces and under_a_command():
        raise ConfigError(f"{both}: action_space: delta is for LeRobot's RL stack, not for this command")
    if spaces == {"joint", "ee"}:
        raise ConfigError(f"{both}: one speaks of joints, the other of tool poses; give both the same action_space")
    if "delta" not in spaces and (differing := sorted(set(one.action_keys) ^ set(other.action_keys))):
        remedy = "drive one arm with one, or two with two"
        if all(key.endswith("gripper.pos") for key in differing):
            remedy = "set ee_gripper of the leader's arm to the follower's gripper; to lead one, the leader needs "
            remedy += "a handle or a gripper motor"
        elif not any(key.endswith(".pos") for key in differing):
            remedy = "a leader of arms alone drives no base; use yam_mobile_leader"
        raise ConfigError(f"{both}: only one has {', '.join(differing)}; {remedy}")
    if "delta" not in spaces and other.use_degrees is not one.use_degrees:
        raise ConfigError(f"{both}: one uses degrees; give both the same use_degrees")
    for (arm, gripper), (other_arm, other_gripper) in zip(one.models, other.models, strict=True):
        same = np.array_equal(arm.joint_limits_rad, other_arm.joint_limits_rad)
        if spaces & {"ee", "delta"}:
            same = (arm.name, gripper.name) == (other_arm.name, other_gripper.name)
        if not same:  # recorded actions would differ from the executed ones
            raise ConfigError(
                f"{both}: one speaks of {arm.name} with {gripper.name}, the other of {other_arm.name} with "
                f"{other_gripper.name}; set follower_arm and ee_gripper of the leader's arm to what the follower is"
            )


def check_followers(leaders: Sequence[ArmConfig], driven: Collection[str]) -> None:
    """Check that this process can lead the followers (a leader's option `follower`).

    Args:
        leaders: configs of the leaders' arms.
        driven: channel keys of the arms that this process drives.

    Raises:
        ConfigError: the follower's channel is not a CAN interface of this computer.
        ChannelInUseError: another process drives the follower.
    """
    holders = sessions(runtime_dir())
    for config in leaders:
        lead = lead_of(config)
        if lead is None:
            continue
        key = channel_key(config.interface, lead.follower, config.can_options.get("rig"))
        if key in driven:
            continue
        if key in holders:
            raise ChannelInUseError(
                f"{config.name}: its follower {lead.follower} is driven by process {holders[key]} (ps -p "
                f"{holders[key]}), which takes no targets from here; end it first"
            )
        if config.interface == SOCKETCAN and not (_INTERFACES / lead.follower).exists():
            raise ConfigError(
                f"{config.name}: its follower's channel {lead.follower} is no CAN interface of this computer "
                "(yam-setup-can --list shows them); is the adapter plugged in?"
            )
