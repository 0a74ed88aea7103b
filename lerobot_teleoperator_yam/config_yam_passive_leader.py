"""LeRobot configs of one leader without motors (`--teleop.type=yam_passive_leader`), and of two such leaders."""

from dataclasses import dataclass, fields
from typing import Any, ClassVar, Literal

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.arm.leaders.lead_config import LeadConfig, LeadOptions
from lerobot_robot_yam.arm.leaders.passive_config import JOINT_SIGNS, Kind, PassiveConfig, PassiveOptions
from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.registration import register_as
from lerobot_teleoperator_yam.leader_options import GateOptions, LeaderOptions, refuse_leader


@dataclass(kw_only=True)
class PassiveLeaderArmConfig(GateOptions, LeadOptions, PassiveOptions):
    """One leader without motors, on its CAN channel."""

    channel: str = option("CAN channel by python-can's name, such as can_lead_l or, on the virtual rig, leader_left")
    name: str = option("what messages call this arm; by default the side and that it leads", "arm")
    interface: str = option("python-can interface: socketcan or yam_sim (the virtual rig)", "socketcan")
    can_options: dict[str, Any] = option(
        "further keyword arguments of can.Bus, such as rig and scene of the virtual rig", factory=dict
    )
    kind: Kind = option("station of the vendor that the leader is from, which tells how its encoders turn", "desk")
    joint_sign: list[int] | None = option("per joint, 1 or -1: how its encoder turns; by default as of the kind", None)
    mapping: Literal["direct", "range"] = option(
        "direct: the leader's angles are the follower's; range: a leader of another size, whose range is stretched "
        "onto the follower's",
        "direct",
    )
    leader_range_rad: list[list[float]] | None = option(
        "per joint, the leader's lowest and highest angle for mapping: range, rad; by default as calibrated", None
    )
    passive_calibration_path: str | None = option(
        "JSON file that keeps zeros and ranges; by default in LeRobot's calibration directory", None
    )
    arm: str = option("profile of the follower, whose joints the leader's are", "yam")
    max_state_age_s: float = option("a state that is older, s, is an error, never an answer", 0.25)
    gate_button: Literal["top", "bottom"] | None = option(
        "button of the trigger that engages and releases, with gate: button", None
    )
    home_rad: list[float] | None = option(
        "per joint, where leader and follower wait with gate: auto, and where the leader lies while it is calibrated, "
        "rad; by default all zero",
        None,
    )

    # constants instead of the options of a leader with motors
    gripper: ClassVar[str] = "yam_teaching_handle"
    start: ClassVar[str] = "float"
    follower_arm: ClassVar[str | None] = None
    estop_button: ClassVar[str | None] = None
    fine_button: ClassVar[str | None] = None

    def __post_init__(self) -> None:
        """Skip the checks: they need both arms, with their sides."""

    def passive_config(self) -> PassiveConfig:
        """Create the settings for reading the encoders. Raises ConfigError: the kind is unknown."""
        if self.kind not in JOINT_SIGNS:
            raise ConfigError(f"{self.name}: kind takes one of {', '.join(JOINT_SIGNS)}; got {self.kind!r}")
        return PassiveConfig(
            joint_sign=JOINT_SIGNS[self.kind] if self.joint_sign is None else self.joint_sign,
            mapping=self.mapping,
            leader_range_rad=self.leader_range_rad,
            calibration_path=self.passive_calibration_path,
            home_rad=self.home_rad,
        )

    def lead_config(self) -> LeadConfig | None:
        """Create the settings for the follower. Raises ConfigError: such options are set without a follower."""
        if self.follower is None:
            if self.gate != "always" or self.gate_button is not None:
                raise ConfigError("gate and gate_button: set follower to the follower's channel, too")
            return None
        taken = {row.name: getattr(self, row.name) for row in fields(LeadConfig) if hasattr(self, row.name)}
        return LeadConfig(**taken | {"gripper": self.ee_gripper, "together": self.gate_together})


def _refuse(device: str, config: Any) -> None:
    """Raise RefusedConfigError if a teleoperator cannot be built from `config`."""
    from lerobot_robot_yam.arm.profile_files import load_arm  # late import, for a quick start
    from lerobot_robot_yam.face.lerobot_command.config_refusal import RefusedConfigError

    refuse_leader(device, config)
    try:
        for prefix, arm in config.arms().items():
            name = f"{prefix}leader" if arm.name == "arm" else arm.name
            arm.passive_config().check(name, load_arm(arm.arm).joint_count)
    except ConfigError as error:
        raise RefusedConfigError(str(error)) from error


@register_as(TeleoperatorConfig, "yam_passive_leader")
@dataclass(kw_only=True)
class YamPassiveLeaderConfig(TeleoperatorConfig, LeaderOptions, PassiveLeaderArmConfig):
    """One leader without motors: LeRobot's fields, `LeaderOptions`, and every field of `PassiveLeaderArmConfig`."""

    def __post_init__(self) -> None:
        _refuse("yam_passive_leader", self)

    def arms(self) -> dict[str, Any]:
        return {"": self}


@register_as(TeleoperatorConfig, "bi_yam_passive_leader")
@dataclass(kw_only=True)
class BiYamPassiveLeaderConfig(TeleoperatorConfig, LeaderOptions):
    """Two leaders without motors."""

    left_arm_config: PassiveLeaderArmConfig
    right_arm_config: PassiveLeaderArmConfig

    def __post_init__(self) -> None:
        _refuse("bi_yam_passive_leader", self)

    def arms(self) -> dict[str, Any]:
        return {"left_": self.left_arm_config, "right_": self.right_arm_config}
