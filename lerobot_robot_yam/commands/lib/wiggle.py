"""Turn the last joint of an arm a little, so that a person sees which arm a channel drives."""

from collections.abc import Callable
from pathlib import Path

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.session.yam_arm import YamArm

WIGGLE_RAD = 0.08
SPEED_RAD_S = 0.15


def hazard(config: ArmConfig) -> str:
    """What is about to happen, for the person who shall confirm it."""
    text = (
        f"HAZARD: this energises the arm on channel {config.channel}, which then holds its pose, turns its last joint "
        f"by ±{WIGGLE_RAD} rad at up to {SPEED_RAD_S} rad/s, lands and goes limp. Keep hands off all arms and the "
        "emergency stop within reach."
    )
    path = config.calibration_path
    if load_gripper(config.gripper).motor is not None and (path is None or not Path(path).exists()):
        known = "give --calibration to avoid that" if path is None else f"there is no {path} yet"
        text += f" Its gripper closes and opens fully to find its stops ({known})."
    return text


def wiggle(config: ArmConfig, which: Callable[[], str | None] | None) -> str:
    """Energise, hold, wiggle until `which` names the arm that moved, land.

    Args:
        config: the arm.
        which: asked after each wiggle; None from it repeats. Without it the arm wiggles once.

    Returns:
        The answer, "" when nobody was asked.

    Raises:
        YamError: what failed; the arm has landed, or was never energised.
    """
    if not load_arm(config.arm).joint_count:
        raise ConfigError(f"{config.name}: arm {config.arm!r} has no joint to turn")
    with YamArm(config, start="hold") as arm:
        home = arm.observe().setpoint_q
        while True:
            for offset in (WIGGLE_RAD, -WIGGLE_RAD, 0.0):
                arm.move_to([*home[:-1], home[-1] + offset], speed_rad_s=SPEED_RAD_S)
            if which is None:
                return ""
            answer = which()
            if answer:
                return answer
