"""LeRobot configs for guiding a follower by hand (`--teleop.type=yam_hand_guide`), or two (`bi_yam_hand_guide`)."""

from dataclasses import dataclass
from typing import Any, Literal

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.registration import register_as


@dataclass(kw_only=True)
class HandGuideOptions:
    """Options of a hand guide that describe the followers of the same command."""

    arm: str = option("profile of the follower, or of both", "yam")
    gripper: str = option("gripper of the follower, or of both", "linear_4310")
    action_space: Literal["joint", "ee"] = option("as the follower's option of this name", "joint")


def _refuse(device: str, config: Any, keys: tuple[str, ...]) -> None:
    """Raise RefusedConfigError if a teleoperator cannot be built from `config`."""
    from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper  # late import, for a quick start
    from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError

    try:
        load_arm(config.arm)
        load_gripper(config.gripper)
        for key in keys:
            if not isinstance(key, str) or len(key) != 1 or key not in _FREE:
                raise ConfigError(
                    f"{device}: a gripper's key is one small letter that LeRobot has no use for ({_FREE}), not {key!r}"
                )
        if len(set(keys)) < len(keys):
            raise ConfigError(f"{device}: both grippers have the key {keys[0]!r}; give them different ones")
        if config.action_space not in ("joint", "ee"):
            raise ConfigError(f"{device}: action_space must be joint or ee, not {config.action_space!r}")
    except ConfigError as error:
        raise RefusedConfigError(str(error)) from error


# keys without a meaning in LeRobot's recordings and rollouts; capitals count as lower case
_FREE = "abdefgijklmotuvwxyz"


@register_as(TeleoperatorConfig, "yam_hand_guide")
@dataclass(kw_only=True)
class YamHandGuideConfig(TeleoperatorConfig, HandGuideOptions):
    """Options for guiding one follower by hand."""

    gripper_key: str = option("opens and closes the gripper when it is typed", "g")

    def __post_init__(self) -> None:
        _refuse("yam_hand_guide", self, self.keys())

    def keys(self) -> tuple[str, ...]:
        """Return the key of each gripper."""
        return (self.gripper_key,)

    def prefixes(self) -> tuple[str, ...]:
        """Return the feature prefix of each arm."""
        return ("",)


@register_as(TeleoperatorConfig, "bi_yam_hand_guide")
@dataclass(kw_only=True)
class BiYamHandGuideConfig(TeleoperatorConfig, HandGuideOptions):
    """Options for guiding two followers by hand."""

    left_gripper_key: str = option("opens and closes the left gripper when it is typed", "f")
    right_gripper_key: str = option("opens and closes the right gripper when it is typed", "j")

    def __post_init__(self) -> None:
        _refuse("bi_yam_hand_guide", self, self.keys())

    def keys(self) -> tuple[str, ...]:
        """Return the key of each gripper."""
        return (self.left_gripper_key, self.right_gripper_key)

    def prefixes(self) -> tuple[str, ...]:
        """Return the feature prefix of each arm."""
        return ("left_", "right_")
