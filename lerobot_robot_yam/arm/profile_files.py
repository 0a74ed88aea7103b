"""Reading arm and gripper profiles from the YAML files in `profiles/`, or from a file of the user's.

`load_arm("yam")`, `load_gripper("linear_4310")`. A path to a YAML file works in place of a name, and `overrides`
replaces any field: `load_arm("yam", {"kp": [...]})`.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile
from lerobot_robot_yam.arm.profile_checks import check_arm, check_gripper
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.strict_yaml import merge, parse, read_yaml

ARMS = ("yam", "yam_pro", "yam_ultra", "yam_ultra_2", "big_yam")
NO_ARM = "none"
"""Arm name for gripper-only use: no joints, the gripper fixed in the world."""
GRIPPERS = ("crank_4310", "linear_3507", "linear_4310", "flexible_4310", "yam_teaching_handle", "no_gripper")

_DIRECTORY = Path(__file__).parent / "profiles"


def load_arm(name: str | Path, overrides: Mapping[str, Any] | None = None) -> ArmProfile:
    """The profile of an arm by name (`ARMS` or "none") or YAML path. Raises ConfigError."""
    return _load("arm", ArmProfile, check_arm, (*ARMS, NO_ARM), name, overrides)


def load_gripper(name: str | Path, overrides: Mapping[str, Any] | None = None) -> GripperProfile:
    """The profile of an end effector by name (`GRIPPERS`) or YAML path. Raises ConfigError."""
    return _load("gripper", GripperProfile, check_gripper, GRIPPERS, name, overrides)


def _load[T](
    what: str,
    kind: type[T],
    check: Callable[[T, str], None],
    names: Sequence[str],
    name: str | Path,
    overrides: Mapping[str, Any] | None,
) -> T:
    if name in names:
        document = _packaged(f"{what}s", str(name))
    elif str(name).endswith((".yaml", ".yml")):
        document = read_yaml(Path(name))
    else:
        raise ConfigError(f"unknown {what} '{name}'; known: {', '.join(names)}, or a path to a YAML profile")
    profile = parse(kind, merge(document, overrides or {}), f"{what} '{name}'")
    check(profile, f"{what} '{name}'")
    return profile


@cache
def _packaged(folder: str, name: str) -> dict[str, Any]:
    return read_yaml(_DIRECTORY / folder / f"{name}.yaml")
