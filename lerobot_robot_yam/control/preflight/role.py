"""The role of an arm: a leader has a teaching handle, a follower has a gripper motor.

The role distinguishes swapped cables from dead motors, even without a binding. Nothing is energised.
"""

import can

from lerobot_robot_yam.arm.config import GRIPPERS, USUAL_GRIPPER
from lerobot_robot_yam.arm.profile import GripperProfile
from lerobot_robot_yam.arm.profile_files import load_gripper
from lerobot_robot_yam.control.preflight.fingerprint import gear_ratio
from lerobot_robot_yam.damiao.handle_check import handle_firmware
from lerobot_robot_yam.damiao.tables import motor_type


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
