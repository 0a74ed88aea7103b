"""Whether the actions of two devices of one process mean the same: a leader's and its follower's."""

import inspect
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.feature_names import space_of
from lerobot_robot_yam.face.recorder.record_command import under_a_command

Models = Sequence[tuple[ArmProfile, GripperProfile]]
"""Of each arm in canonical order: the arm and end effector that actions speak of."""


@dataclass(frozen=True)
class Spoken:
    """How a device speaks.

    Attributes:
        device: its name, for messages.
        action_keys: of its actions.
        use_degrees: its angles are degrees.
        models: what they are the joints of.
    """

    device: str
    action_keys: Sequence[str]
    use_degrees: bool
    models: Models


def check_pair(one: Spoken, other: Spoken) -> None:
    """Refuse two devices whose actions differ in space, keys, unit or arm. Raises ConfigError: says in which."""
    both = f"{one.device} and {other.device}"
    spaces = {space_of(spoken.action_keys) for spoken in (one, other)}
    if "delta" in spaces and under_a_command(inspect.currentframe()):
        raise ConfigError(f"{both}: action_space: delta is for LeRobot's RL stack, not for this command")
    if spaces == {"joint", "ee"}:
        raise ConfigError(f"{both}: one speaks of joints, the other of tool poses; give both the same action_space")
    if "delta" not in spaces and (differing := sorted(set(one.action_keys) ^ set(other.action_keys))):
        remedy = "drive one arm with one, or two with two"
        if all(key.endswith("gripper.pos") for key in differing):
            remedy = "set ee_gripper of the leader's arm to the follower's gripper; to lead one, the leader needs "
            remedy += "a handle or a gripper motor"
        raise ConfigError(f"{both}: only one has {', '.join(differing)}; {remedy}")
    if "delta" not in spaces and other.use_degrees is not one.use_degrees:
        raise ConfigError(f"{both}: one uses degrees; give both the same use_degrees")
    for (arm, gripper), (other_arm, other_gripper) in zip(one.models, other.models, strict=True):
        same = np.array_equal(arm.joint_limits_rad, other_arm.joint_limits_rad)
        if spaces & {"ee", "delta"}:
            same = (arm.name, gripper.name) == (other_arm.name, other_gripper.name)
        if not same:  # what is recorded would not be what is done
            raise ConfigError(
                f"{both}: one speaks of {arm.name} with {gripper.name}, the other of {other_arm.name} with "
                f"{other_gripper.name}; set follower_arm and ee_gripper of the leader's arm to what the follower is"
            )
