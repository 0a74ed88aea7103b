"""Options of one or two leaders, and their checks. Does not import LeRobot, whose registry would load all configs."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Literal

from lerobot_robot_yam.arm.config import ArmConfig, lead_of
from lerobot_robot_yam.arm.leaders.lead_config import LeadConfig, LeadOptions, check_leads
from lerobot_robot_yam.arm.option import option
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.lerobot_command.running_command import Meaning
from lerobot_robot_yam.face.operator_keys.handle_buttons import button_meanings

if TYPE_CHECKING:
    from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
    from lerobot_robot_yam.session.arm_session import Isolation


@dataclass(kw_only=True)
class GateOptions:
    """Options of a leader with or without motors that concern its follower and the gate between leader and follower."""

    ee_gripper: str = option(
        "gripper that the follower carries; with no_gripper the action has no gripper", "linear_4310"
    )
    follower: str | None = option(
        "CAN channel of the follower, on the same interface: it then follows at its control loop's rate "
        "(docs/teleoperation.md); by default at LeRobot's",
        None,
    )
    gate: Literal["auto", "button", "always"] = option(
        "what engages a leader with a follower: auto (lifting it from home), button (gate_button), always", "always"
    )
    gate_together: bool = option("both leaders of a pair engage and release together", True)
    gate_button: Literal["top", "bottom"] | None = option(
        "button of the teaching handle that engages and releases, with gate: button", None
    )
    gate_joints: list[int] = option(
        "joints whose distance from home counts for gate: auto, from 1; empty: the distance of all, L2",
        factory=lambda: [2],
    )
    home_rad: list[float] | None = option(
        "per joint, where leader and follower wait with gate: auto, rad; by default all zero", None
    )
    home_gripper: float = option("opening of the follower's gripper there, 0 closed … 1 open", 0.0)
    engage_threshold_rad: float = option("a leader farther from home engages, rad", 0.5)
    release_threshold_rad: float = option("a leader nearer to home for release_s releases, rad", 0.3)
    release_s: float = option("see release_threshold_rad, s", 0.5)
    approach_speed_rad_s: float = option("with which the follower goes to a leader that engages, rad/s", 1.0)


@dataclass(kw_only=True)
class LeaderArmConfig(ArmConfig, GateOptions, LeadOptions):
    """Options of one leader arm: every field of `ArmConfig`, with a leader's defaults, and a leader's own fields."""

    gripper: str = option(
        "end effector, as of a follower; the handle's trigger becomes the gripper's action", "yam_teaching_handle"
    )
    start: Literal["hold", "float"] = option(
        "what the arm does once it is energised: float against gravity, or hold", "float"
    )
    follower_arm: str | None = option(
        "profile whose joint limits the recorded action keeps; by default the leader's own arm", None
    )
    homing_speed_rad_s: float = option("with which leader and follower go home, rad/s", 0.5)
    fine_button: Literal["top", "bottom"] | None = option(
        "button of the teaching handle that switches fine mode on and off", None
    )
    fine_scale: float = option("share of the leader's motion that the follower makes in fine mode", 0.3)
    bilateral: list[float] | float = option(
        "force feedback: share of the position gain with which the follower's resistance pulls at the leader, 0 to "
        "0.5, one number or one per joint; usual are 0.1 to 0.2, and 0 is none",
        0.0,
    )
    mirror: bool = option(
        "while something else than this leader moves its follower, a policy in a rollout, the leader goes along, "
        "softly: a take-over begins aligned",
        False,
    )

    def __post_init__(self) -> None:
        """Skip the checks: they need both arms, with their sides."""

    def lead_config(self) -> LeadConfig | None:
        """Create the settings for the follower. Raises ConfigError: such options are set without a follower."""
        if self.follower is None:
            given = [name for name, usual in _NEED_FOLLOWER.items() if getattr(self, name) != usual]
            if given:
                raise ConfigError(f"{', '.join(given)}: set follower to the follower's channel, too")
            return None
        taken = {row.name: getattr(self, row.name) for row in fields(LeadConfig) if hasattr(self, row.name)}
        taken |= {"arm": self.follower_arm or self.arm, "gripper": self.ee_gripper, "together": self.gate_together}
        return LeadConfig(**taken)


_NEED_FOLLOWER = {"gate": "always", "gate_button": None, "fine_button": None, "bilateral": 0.0, "mirror": False}


@dataclass(kw_only=True)
class LeaderOptions(ABC):
    """Options of one or two leaders."""

    use_degrees: bool = option(
        "joints in degrees in actions and feedback, as the follower's option of this name", False
    )
    action_space: Literal["joint", "ee", "delta"] = option(
        "joint: actions and feedback are joint_1.pos …; ee: the pose of the follower's tool; as the follower's "
        "option of this name; delta: steps of the tool, for LeRobot's RL stack (docs/hil-serl.md)",
        "joint",
    )
    step_m: float = option(
        "longest step of the tool along an axis with action_space: delta, m; end_effector_step_sizes of LeRobot's "
        "config",
        0.02,
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
        """Return the config of each arm by its feature prefix, in canonical order."""

    def runs(self) -> "Isolation":
        """Return the isolation of the control loop, see `ArmSession`."""
        return self.isolation


BUTTON_OPTIONS = ("estop_button", "gate_button", "fine_button")


def meanings_of(options: LeaderOptions) -> dict[str, Meaning]:
    """Return button name, such as left_bottom, → meaning, for the handle buttons that have a meaning.

    Raises:
        ConfigError: `buttons` has a mistake, or `auto_episodes` is set without a gate.
    """
    from lerobot_robot_yam.arm.profile_files import load_gripper

    arms = options.arms()
    prefixes = [prefix for prefix, arm in arms.items() if load_gripper(arm.gripper).handle_encoder]
    taken = {
        f"{prefix}{button}": name
        for prefix, arm in arms.items()
        for name in BUTTON_OPTIONS
        if (button := getattr(arm, name)) is not None
    }
    if options.auto_episodes and any(arm.follower is None or arm.gate == "always" for arm in arms.values()):
        raise ConfigError("auto_episodes needs a gate that tells a lift: set follower, and gate to auto, for each arm")
    return button_meanings(options.buttons, prefixes, taken)


def refuse_leader(device: str, config: Any) -> None:
    """Raise RefusedConfigError if a teleoperator cannot be built from `config`."""
    from lerobot_robot_yam.face.lerobot_command.command_checks import channels_of
    from lerobot_robot_yam.face.lerobot_command.config_refusal import refuse

    def check(resolved: Mapping[str, Any]) -> None:
        check_leaders(device, config, resolved)
        robot = list(channels_of("robot").values())
        for arm in resolved.values():
            lead = lead_of(arm.config)
            if robot and lead is not None and lead.follower not in robot:
                raise ConfigError(
                    f"{arm.name}: its follower {lead.follower} is no arm of this command's robot, which has "
                    f"{', '.join(robot)}; set follower to one of these"
                )

    refuse(device, config, "leader", check)


def check_leaders(device: str, config: LeaderOptions, resolved: Mapping[str, "ResolvedArm"]) -> None:
    """Check leaders and what they say of their followers. resolved: prefix → arm. Raises ConfigError: a mistake."""
    # loads profiles: late import, to keep LeRobot's start quick
    from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper

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
    leads = {arm: lead for arm in resolved.values() if (lead := lead_of(arm.config)) is not None}
    check_leads(list(leads.values()))
    for arm, lead in leads.items():
        lead.check_joints(arm.name, arm.joints)
        lead.check_handle(arm.name, arm.gripper.handle_encoder)
