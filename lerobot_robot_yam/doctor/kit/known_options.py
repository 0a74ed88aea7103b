"""The options of our LeRobot devices by type, where LeRobot is not loaded; a test compares them with the configs."""

import dataclasses
import difflib
from collections.abc import Mapping, Sequence, Set
from typing import Any, NamedTuple

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.leaders.lead_config import LeadConfig
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.rig_file import ARMS_OF_TWO

ARM_FIELDS = frozenset(field.name for field in dataclasses.fields(ArmConfig))
_LEAD_FIELDS = frozenset(field.name for field in dataclasses.fields(LeadConfig))
_OF_ALL = frozenset({"type", "id", "calibration_dir"})
_OF_DEVICE = _OF_ALL | {"isolation", "use_degrees", "action_space"}
_OF_LEADERS = _OF_DEVICE | {"buttons", "auto_episodes", "step_m"}
# Of a leader with a follower; the rest of `LeadConfig` is no option.
_LEADS = _LEAD_FIELDS - {"together", "approach_s", "idle_speed_rad_s"} | {"ee_gripper", "gate_together"}
_WITHOUT_MOTORS = {"homing_speed_rad_s", "fine_button", "fine_scale", "bilateral", "mirror"}
_PASSIVE = {"channel", "name", "interface", "can_options", "arm", "max_state_age_s"}
_PASSIVE |= {"kind", "joint_sign", "mapping", "leader_range_rad", "passive_calibration_path"}
_ARMS_OF_TWO = frozenset(ARMS_OF_TWO)
_KEYS_OF_TWO = frozenset({"left_gripper_key", "right_gripper_key"})


class Options(NamedTuple):
    """Names of options.

    Attributes:
        device: of the device, one arm or two.
        arm: of each of its arms.
        one, two: of the device alone when it has one arm, or two.
    """

    device: frozenset[str]
    arm: frozenset[str]
    one: frozenset[str] = frozenset()
    two: frozenset[str] = _ARMS_OF_TWO


_FOLLOWERS = _OF_DEVICE | {"cameras", "observe_velocity", "observe_torque", "observe_temperature"}
OPTIONS = {
    "yam_follower": Options(_FOLLOWERS, ARM_FIELDS | {"cameras"}),
    "yam_leader": Options(_OF_LEADERS, ARM_FIELDS | _LEADS | {"follower_arm"}),
    "yam_passive_leader": Options(_OF_LEADERS, frozenset(_LEADS - _WITHOUT_MOTORS - {"gripper"} | _PASSIVE)),
    "yam_hand_guide": Options(
        _OF_ALL | {"arm", "gripper", "action_space"}, frozenset(), frozenset({"gripper_key"}), _KEYS_OF_TWO
    ),
}
"""By the type of the device with one arm."""


def of_one_arm(kind: str) -> str:
    """The type of the device with one arm that a type is of: "yam_leader" of "bi_i2rt_yam_leader"."""
    return kind.removeprefix("bi_").replace("i2rt_", "")


def is_one_of(kind: object, kinds: Sequence[str]) -> bool:
    """Whether a type is one of these, by its first or second name, with one arm or two."""
    spelled = {f"{two}{spare}{one}" for one in kinds for two in ("", "bi_") for spare in ("", "i2rt_")}
    return kind in spelled


def check_options(device: Mapping[str, Any], arms: Mapping[str, Mapping[str, Any]], where: str) -> None:
    """Refuse what LeRobot would not know.

    Args:
        device: of one of our types.
        arms: its arms' options by prefix; of one arm those of the device.

    Raises:
        ConfigError: names the option, and one that is like it.
    """
    options = OPTIONS[of_one_arm(device["type"])]
    two = str(device["type"]).startswith("bi_")
    of_device: Set[str] = options.device | (options.two if two else options.arm | options.one)
    places: list[tuple[str, Mapping[str, Any], Set[str]]] = [(where, device, of_device)]
    places += [(f"{where}, {prefix}arm_config", arm, options.arm) for prefix, arm in arms.items() if prefix]
    for place, given, known in places:
        for name in map(str, given):
            if name not in known:
                near = difflib.get_close_matches(name, known, 1)
                raise ConfigError(f"{place}: there is no option {name!r}" + (f"; {near[0]!r}?" if near else ""))
