"""LeRobot configs of one leader arm (`--teleop.type=yam_leader`) and of two (`bi_yam_leader`)."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.operator_keys.meanings import Meaning, button_meanings
from lerobot_robot_yam.face.registration import register_as


@dataclass(kw_only=True)
class LeaderArmConfig(ArmConfig):
    """Every field of `ArmConfig`, with a leader's defaults."""

    gripper: str = option(
        "end effector, as of a follower; the handle's trigger becomes the gripper's action", "yam_teaching_handle"
    )
    start: Literal["hold", "float"] = option(
        "what the arm does once it is energised: float against gravity, or hold", "float"
    )
    follower_arm: str | None = option(
        "profile whose joint limits the recorded action keeps; by default the leader's own arm", None
    )
    ee_gripper: str = option(
        "gripper that the follower carries; with no_gripper the action has no gripper", "linear_4310"
    )

    def __post_init__(self) -> None:
        """No checks yet: they come with the other arm's, and know which side this is."""


@dataclass(kw_only=True)
class LeaderOptions(ABC):
    """Options of a leader, one arm or two."""

    use_degrees: bool = option(
        "joints in degrees in actions and feedback, as the follower's option of this name", False
    )
    action_space: Literal["joint", "ee"] = option(
        "joint: actions and feedback are joint_1.pos …; ee: the pose of the follower's tool; as the follower's "
        "option of this name",
        "joint",
    )
    isolation: Literal["process", "thread"] = option(
        "process runs the control loop in another process; thread is for debugging", "process"
    )
    buttons: dict[str, Any] | str = option(
        "buttons of the handles press LeRobot's keys: record, dagger, or {next: left_bottom, stop: right_top, …}; see "
        "[buttons](buttons.md)",
        factory=dict,
    )
    auto_episodes: bool = option(
        "lerobot-record begins an episode when all leaders are lifted, and ends and saves it when they are home", False
    )

    @abstractmethod
    def arms(self) -> Mapping[str, LeaderArmConfig]:
        """The arms by feature prefix, in canonical order."""


def meanings_of(options: LeaderOptions) -> dict[str, Meaning]:
    """The meaning of each handle's button that has one, such as left_bottom. Raises ConfigError: see `buttons`."""
    from lerobot_robot_yam.arm.profile_files import load_gripper

    arms = options.arms()
    prefixes = [prefix for prefix, arm in arms.items() if load_gripper(arm.gripper).handle_encoder]
    taken = {f"{prefix}{arm.estop_button}": "estop_button" for prefix, arm in arms.items() if arm.estop_button}
    return button_meanings(options.buttons, prefixes, taken)


def _refuse(device: str, config: Any) -> None:
    """Refuse a config of which no teleoperator can be made; raises RefusedConfigError."""
    from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper
    from lerobot_robot_yam.face.devices.config_refusal import refuse  # loads profiles: LeRobot's start must not wait

    def check(resolved: Mapping[str, Any]) -> None:
        try:
            meanings_of(config)
        except ConfigError as error:
            raise ConfigError(f"{device}: {error}") from error
        for arm, options in zip(resolved.values(), config.arms().values(), strict=True):
            try:
                load_gripper(options.ee_gripper)
                joints = load_arm(options.follower_arm or options.arm).joint_count
            except ConfigError as error:
                raise ConfigError(f"{arm.name}: {error}") from error
            if arm.joints not in (0, joints):
                raise ConfigError(
                    f"{arm.name}: follower_arm {options.follower_arm!r} has {joints} joints, not {arm.joints}"
                )

    refuse(device, config, "leader", check)


@register_as(TeleoperatorConfig, "yam_leader", spare="i2rt_yam_leader")
@dataclass(kw_only=True)
class YamLeaderConfig(TeleoperatorConfig, LeaderOptions, LeaderArmConfig):
    """One leader arm: LeRobot's fields, `LeaderOptions`, and every field of `LeaderArmConfig`."""

    def __post_init__(self) -> None:
        _refuse("yam_leader", self)

    def arms(self) -> dict[str, LeaderArmConfig]:
        return {"": self}


@register_as(TeleoperatorConfig, "i2rt_yam_leader")
class I2rtYamLeaderConfig(YamLeaderConfig):
    """The same by a name that no other plugin claims."""


@register_as(TeleoperatorConfig, "bi_yam_leader", spare="bi_i2rt_yam_leader")
@dataclass(kw_only=True)
class BiYamLeaderConfig(TeleoperatorConfig, LeaderOptions):
    """Two leader arms."""

    left_arm_config: LeaderArmConfig
    right_arm_config: LeaderArmConfig

    def __post_init__(self) -> None:
        _refuse("bi_yam_leader", self)

    def arms(self) -> dict[str, LeaderArmConfig]:
        return {"left_": self.left_arm_config, "right_": self.right_arm_config}


@register_as(TeleoperatorConfig, "bi_i2rt_yam_leader")
class BiI2rtYamLeaderConfig(BiYamLeaderConfig):
    """The same by a name that no other plugin claims."""
