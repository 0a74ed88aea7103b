"""The role of what a channel carries: a leader has a teaching handle, a follower a gripper motor, a base eight wheels.

The role distinguishes swapped cables from dead motors, even without a binding. Nothing is energised.
"""

from collections.abc import Sequence

import can

from lerobot_robot_yam.arm.config import GRIPPERS, USUAL_GRIPPER
from lerobot_robot_yam.arm.profile import GripperProfile
from lerobot_robot_yam.arm.profile_files import load_gripper
from lerobot_robot_yam.control.preflight.fingerprint import gear_ratio
from lerobot_robot_yam.damiao.handle_check import handle_firmware
from lerobot_robot_yam.damiao.registers import agrees
from lerobot_robot_yam.damiao.tables import motor_type
from lerobot_robot_yam.mobile.base_profile import BaseProfile

FIRST_IDS = (1, 2, 3)
"""CAN ids of the motors that tell an arm from a base: an arm's have gears of 40 or 48, a base's of 10."""


def mistaken_role(bus: can.BusABC, channel: str, name: str, gripper: GripperProfile, gripper_id: int) -> str | None:
    """Return a message if the arm on the channel does not fit the profile `gripper`; None if the arm may be right.

    Requests handle and gripper motor (`mounting.gripper_id`); blocks for up to 0.15 s if neither replies.

    Raises:
        BusError: the channel is lost.
    """
    handle, gear = _answering(bus, channel, gripper_id)
    has_motor = gear is not None
    if gripper.handle_encoder and not handle and has_motor:
        return (
            f"{name}: channel {channel} carries a follower (a gripper motor answers, no teaching handle does), but "
            "it is configured as a leader: are the cables or channels swapped?"
        )
    if not gripper.handle_encoder and handle and not (gripper.motor and has_motor):
        return (
            f"{name}: channel {channel} carries a leader (a teaching handle answers), but it is configured as a "
            f"follower with gripper {gripper.name}: are the cables or channels swapped?"
        )
    if not gripper.handle_encoder and gripper.motor is None and has_motor:
        return (
            f"{name}: a gripper motor (id {gripper_id}) answers on channel {channel}, but gripper {gripper.name} "
            "has none: set `gripper`, or look whether the cables are swapped"
        )
    return None


def carries_base(bus: can.BusABC, channel: str) -> bool | None:
    """Return whether the channel carries a mobile base, see `are_wheels`. Raises BusError: the channel is lost."""
    return are_wheels([gear_ratio(bus, channel, can_id) for can_id in FIRST_IDS])


def are_wheels(gears: Sequence[float | None]) -> bool | None:
    """Return whether motors 1 to 3 with these gear ratios are a base's; False: an arm's; None: none has told.

    The gear ratio is read-only. It does not tell a steering motor from a drive motor: both have the same.
    """
    told = [gear for gear in gears if gear is not None]
    return all(agrees(gear, motor_type(BaseProfile().steer_type).gear_ratio) for gear in told) if told else None


def answering_gripper(bus: can.BusABC, channel: str, gripper_id: int) -> str:
    """Return the name of a gripper profile that fits the replies on the channel, see `likely_gripper`.

    Raises:
        BusError: the channel is lost.
    """
    return likely_gripper(*_answering(bus, channel, gripper_id))


def likely_gripper(handle: bool, gear: float | None) -> str:
    """Return the name of the first gripper profile that fits; several grippers may share a motor type.

    Args:
        handle: whether a teaching handle replies.
        gear: gear ratio of the gripper motor; None: no gripper motor replies.
    """
    if handle:
        return "yam_teaching_handle"
    if gear is None:
        return "no_gripper"
    motors = {name: load_gripper(name).motor for name in GRIPPERS}
    fitting = (name for name, motor in motors.items() if motor and motor_type(motor.type).gear_ratio == gear)
    return next(fitting, USUAL_GRIPPER)


def _answering(bus: can.BusABC, channel: str, gripper_id: int) -> tuple[bool, float | None]:
    return handle_firmware(bus, channel) is not None, gear_ratio(bus, channel, gripper_id)
