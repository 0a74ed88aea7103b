"""Mounting of an end effector on an arm: adapts the arm-dependent parts of the end effector's profile."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.profile import ArmProfile, Body, GripperProfile
from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper
from lerobot_robot_yam.errors import ConfigError

TIP = "tip"
"""Parent of an end effector's root body in profiles: stands for the arm's last body."""
MAKERS_GRIPPER_ID = 7  # CAN id of the motor in every gripper that the maker sells

_GRASP_SITE = "grasp_site"


def resolve_profiles(
    arm: str | Path | ArmProfile, gripper: str | Path | GripperProfile
) -> tuple[ArmProfile, GripperProfile]:
    """Load the profiles of an arm and of an end effector by name or path, and adapt the end effector to the arm.

    If both are profiles already, they count as resolved and are returned unchanged.

    Raises:
        ConfigError: a name is unknown, a profile is invalid, or the end effector does not fit the arm.
    """
    if isinstance(arm, ArmProfile) and isinstance(gripper, GripperProfile):
        return arm, gripper
    arm = arm if isinstance(arm, ArmProfile) else load_arm(arm)
    return arm, mounted(gripper if isinstance(gripper, GripperProfile) else load_gripper(gripper), arm)


def gripper_id(arm: ArmProfile, own: int = MAKERS_GRIPPER_ID) -> int:
    """Choose the CAN id of a gripper's motor: the arm profile's, else `own`, or the next id if a joint uses `own`."""
    if arm.gripper_can_id is not None:
        return arm.gripper_can_id
    joints = [motor.can_id for motor in arm.motors]
    return max(joints) + 1 if own in joints else own


def seeks_stops(config: ArmConfig) -> bool:
    """Return whether the gripper closes and opens fully when the arm is energised, because its stops are unknown."""
    if not config.gripper_search or config.gripper_stops_rad is not None or load_gripper(config.gripper).motor is None:
        return False
    return config.calibration_path is None or not Path(config.calibration_path).exists()


def arm_ids(arm: ArmProfile) -> tuple[int, ...]:
    """List the CAN ids of all motors that may reply on this arm's channel: the joints', then a gripper's."""
    return (*(motor.can_id for motor in arm.motors), gripper_id(arm))


def mounted(gripper: GripperProfile, arm: ArmProfile) -> GripperProfile:
    """Adapt an end effector's profile to this arm: the motor's CAN id, the root body's parent, names, grasp point.

    If the arm uses the names of the finger joints, these get the numbers after the arm's joints. The arm's profile may
    override the grasp point.

    Raises:
        ConfigError: the parent of a body is neither in the end effector nor the arm's last body.
    """
    joints = {body.joint.name for body in arm.bodies if body.joint}
    numbers = range(len(joints) + 1, len(joints) + 1 + len(gripper.finger_joints))
    renamed = {}
    if not joints.isdisjoint(gripper.finger_joints):
        renamed = {name: f"joint{number}" for name, number in zip(gripper.finger_joints, numbers, strict=True)}
    motor = gripper.motor and replace(gripper.motor, can_id=gripper_id(arm, gripper.motor.can_id))
    bodies = tuple(_mounted(body, gripper, arm, renamed) for body in gripper.bodies)
    return replace(gripper, motor=motor, bodies=bodies)


def _mounted(body: Body, gripper: GripperProfile, arm: ArmProfile, renamed: Mapping[str, str]) -> Body:
    tip = arm.bodies[-1].name
    parents = {own.name: own.name for own in gripper.bodies} | {TIP: tip, tip: tip}
    if body.parent not in parents:
        raise ConfigError(
            f"gripper '{gripper.name}': body {body.name} is fixed to '{body.parent}', which is neither one of its "
            f"bodies nor the last one of arm '{arm.name}' ({tip}); write `parent: {TIP}`"
        )
    joint = body.joint and replace(body.joint, name=renamed.get(body.joint.name, body.joint.name))
    point = (arm.grasp_site_m or {}).get(gripper.name)
    sites = tuple(
        site if point is None or site.name != _GRASP_SITE else replace(site, pos_m=point) for site in body.sites
    )
    return replace(body, parent=parents[body.parent], joint=joint, sites=sites)
