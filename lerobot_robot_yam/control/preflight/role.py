"""The role of an arm: a leader has a teaching handle, a follower a gripper motor.

It tells swapped cables from dead motors without any binding. Asks only; energises nothing.
"""

from dataclasses import dataclass

import can

from lerobot_robot_yam.arm.profile import GripperProfile
from lerobot_robot_yam.control.preflight.fingerprint import gear_ratio
from lerobot_robot_yam.damiao.handle_check import handle_firmware
from lerobot_robot_yam.damiao.tables import motor_type


@dataclass(frozen=True)
class Role:
    """The devices at the end of an arm: handle, gripper motor (with its gear ratio), both or neither.

    gripper_id: CAN id at which a gripper's motor was asked for.
    """

    handle: bool
    gripper_gear_ratio: float | None
    gripper_id: int


def probe_role(bus: can.BusABC, channel: str, gripper_id: int) -> Role:
    """Ask for the handle and for the gripper motor (`mounting.gripper_id`); up to 0.15 s when neither is there.

    Raises:
        BusError: the channel is gone.
    """
    return Role(handle_firmware(bus, channel) is not None, gear_ratio(bus, channel, gripper_id), gripper_id)


def mistaken_role(bus: can.BusABC, channel: str, name: str, gripper: GripperProfile, gripper_id: int) -> str | None:
    """Message when another arm answers than the one with the profile `gripper`; None when it may be the right one.

    Raises:
        BusError: the channel is gone.
    """
    found = probe_role(bus, channel, gripper_id)
    has_motor = found.gripper_gear_ratio is not None
    if gripper.handle_encoder and not found.handle and has_motor:
        return (
            f"{name}: channel {channel} carries a follower (a gripper motor answers, no teaching handle does), but "
            "it is configured as a leader: are the cables or channels swapped?"
        )
    if not gripper.handle_encoder and found.handle and not (gripper.motor and has_motor):
        return (
            f"{name}: channel {channel} carries a leader (a teaching handle answers), but it is configured as a "
            f"follower with gripper {gripper.name}: are the cables or channels swapped?"
        )
    if not gripper.handle_encoder and gripper.motor is None and has_motor:
        return (
            f"{name}: a gripper motor (id {found.gripper_id}) answers on channel {channel}, but gripper {gripper.name} "
            "has none: set `gripper`, or look whether the cables are swapped"
        )
    return None


def likely_gripper(found: Role) -> str:
    """Name of a gripper profile that fits; motors of one type do not tell their grippers apart."""
    if found.handle:
        return "yam_teaching_handle"
    if found.gripper_gear_ratio is None:
        return "no_gripper"
    return "linear_3507" if found.gripper_gear_ratio == motor_type("DM3507").gear_ratio else "linear_4310"
