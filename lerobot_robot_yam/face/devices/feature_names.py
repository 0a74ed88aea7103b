"""Names of a robot's values in LeRobot's features, in canonical order: left joints, left gripper, right joints …"""

import re
from collections.abc import Iterable, Mapping

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper

TOOL_NUMBERS = ("ee_x", "ee_y", "ee_z", "ee_rx", "ee_ry", "ee_rz")
"""Names of an arm's values if actions are end-effector poses instead of joints, see `ee_space`."""

STEPS = ("delta_x", "delta_y", "delta_z")
"""Names of the values of an action that is a step of the end effector, see `rl_stack`."""

JOINT = re.compile(r"(.+_)?joint_\d+\.pos")
"""Key of a joint's position; the group is the arm's prefix, such as `left_`."""

_SPACES = {
    "joint": JOINT,
    "ee": re.compile(rf"(.+_)?({'|'.join(TOOL_NUMBERS)})\.pos"),
    "delta": re.compile("|".join(STEPS)),
}


def motor_names(prefix: str, joints: int, gripper: bool) -> list[str]:
    """Return `joint_1`, `joint_2` …, `gripper`, each with a prefix such as `left_`."""
    return [f"{prefix}joint_{index + 1}" for index in range(joints)] + [f"{prefix}gripper"] * gripper


def motors_of(arms: Mapping[str, ArmConfig]) -> list[str]:
    """Return the motor names of `arms` (prefix → config). Raises ConfigError: an arm or gripper is unknown."""
    return [key.removesuffix(".pos") for key in action_keys(arms, "joint")]


def action_keys(arms: Mapping[str, ArmConfig], action_space: str) -> list[str]:
    """Return the action keys of `arms` (prefix → config): `left_joint_1.pos` …, or `left_ee_x.pos` … for "ee"."""
    keys = []
    for prefix, arm in arms.items():
        joints = load_arm(arm.arm).joint_count
        names = motor_names(prefix, joints, load_gripper(arm.gripper).motor is not None)
        if action_space == "ee":
            names[:joints] = [f"{prefix}{name}" for name in TOOL_NUMBERS]
        keys += [f"{name}.pos" for name in names]
    return keys


def space_of(keys: Iterable[str]) -> str | None:
    """Return the `action_space` of these action keys: "joint", "ee" or "delta"; None if the keys do not show it."""
    found = {space for key in keys for space, pattern in _SPACES.items() if pattern.fullmatch(key)}
    return found.pop() if len(found) == 1 else None
