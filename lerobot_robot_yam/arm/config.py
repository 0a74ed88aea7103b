"""Configuration of one arm: channel, hardware, and overrides of profile values.

All values are plain, since the dataclass is sent to the control process as JSON.
"""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

from lerobot_robot_yam.arm import config_checks
from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.leaders.lead_config import LeadConfig
from lerobot_robot_yam.arm.leaders.passive_config import PassiveConfig
from lerobot_robot_yam.arm.option import from_plain, option
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.runtime_files import rig_name

SOCKETCAN, VIRTUAL = "socketcan", "yam_sim"  # python-can interfaces: SocketCAN and the virtual rig
PROFILES = Path(__file__).parent / "profiles"
NO_ARM = "none"
"""Arm name for a gripper without an arm: no joints, the gripper fixed in the world."""
USUAL_ARM, USUAL_GRIPPER = "yam", "linear_4310"


class JointPace(NamedTuple):
    """Limits of a set-point's joints: speed, rad/s (None: the profile's), and acceleration, rad/s²."""

    speed_rad_s: float | None
    acceleration_rad_s2: float


PACES = {"calm": JointPace(None, 30.0), "normal": JointPace(2.5, 40.0), "fast": JointPace(4.0, 60.0)}
"""Limits per `teleop_speed`. A hand that swings with 2 Hz needs 2.5 rad/s and 32 rad/s² for ±0.2 rad, 3.8 and 47 for
±0.3; accelerations are a quarter above that, with which a gap is closed."""


def _packaged(folder: str, usual: str) -> tuple[str, ...]:
    """List the names of the profiles in a folder, the default profile first."""
    names = {path.stem for path in (PROFILES / folder).glob("*.yaml")} - {usual, NO_ARM}
    return usual, *sorted(names)


ARMS, GRIPPERS = _packaged("arms", USUAL_ARM), _packaged("grippers", USUAL_GRIPPER)
"""Names of the arms and end effectors that have a profile in this package."""


class ChannelConfig(Protocol):
    """What the configurations of arms and bases have in common."""

    name: str
    channel: str
    interface: str
    can_options: dict[str, Any]
    rate_hz: float

    @property
    def on_command_line(self) -> str: ...


def channel_options(config: ChannelConfig) -> str:
    """Return the command line options that name a channel."""
    words = ["--channel", config.channel]
    rig = config.can_options.get("rig")
    if config.interface == VIRTUAL and rig and rig_name(rig)[1] is None:  # auto rigs end with their process
        words += ["--rig", rig]
    elif config.interface != SOCKETCAN:
        words += ["--interface", config.interface]
    return shlex.join(words)


@dataclass(kw_only=True)
class ArmConfig:
    """One arm on one CAN channel."""

    channel: str = option(
        "CAN channel by python-can's name, such as can_follower_l or, on the virtual rig, follower_left"
    )
    name: str = option("what messages call this arm; by default the side and whether it follows or leads", "arm")
    interface: str = option(
        "python-can interface: socketcan (the kernel's; any other may take too long to open for a stand-by to "
        "land the arm in time) or yam_sim (the virtual rig)",
        "socketcan",
    )
    can_options: dict[str, Any] = option(
        "further keyword arguments of can.Bus, such as rig and scene of the virtual rig", factory=dict
    )
    arm: str = option(f"profile: {', '.join(ARMS)}, or the path of a YAML file of that form", USUAL_ARM)
    gripper: str = option(
        f"end effector: {', '.join(GRIPPERS)}, or the path of a YAML file of that form",
        USUAL_GRIPPER,
    )
    start: Literal["hold", "float"] = option(
        "what the arm does once it is energised: hold (followers), or float against gravity (leaders)", "hold"
    )
    kp: list[float] | None = option("stiffness per joint, Nm/rad; by default the profile's", None)
    kd: list[float] | None = option("damping per joint, Nm s/rad; by default the profile's", None)
    gripper_kp: float | None = option("stiffness of the gripper's motor, Nm/rad; by default the profile's", None)
    gripper_kd: float | None = option("damping of the gripper's motor, Nm s/rad; by default the profile's", None)
    gravity_factor: list[float] | None = option(
        "per joint, factor on the modelled weight, 0 to 2; by default the profile's", None
    )
    tuning: str | None = option(
        "file of yam-tune with what this arm weighs and how it rubs; by default what the profile says", None
    )
    coulomb_friction_nm: list[float] | None = option(
        "per joint, friction torque that is fed forward, Nm; by default none", None
    )
    idle_kd: list[float] | None = option("per joint, damping while floating, Nm s/rad; by default the profile's", None)
    payload_mass_kg: float = option("load that is fixed to the tool, kg, at most 3", 0.0)
    payload_com_m: list[float] = option(
        "centre of that load in the frame of the tool, m", factory=lambda: [0.0, 0.0, 0.0]
    )
    ee_inertia: list[float] | None = option(
        "replaces the end effector's inertia: centre (3, m), quaternion w x y z (4), moments (3, kg m²)", None
    )
    speed_limit_rad_s: list[float] | float | None = option(
        "of the set-point, rad/s, one number or one per joint; joints exceed it by a tenth at most. By default "
        "that of `teleop_speed`",
        None,
    )
    acceleration_limit_rad_s2: list[float] | float | None = option(
        "of the set-point, rad/s², 5 to 100, one number or one per joint; less where the torque limits allow less. By "
        "default that of `teleop_speed`",
        None,
    )
    teleop_speed: Literal["calm", "normal", "fast"] = option(
        "speed and acceleration limits of a follower: calm (the profile's 1.5 rad/s, and 30 rad/s²), normal (2.5 and "
        "40) or fast (4 and 60), see docs/teleoperation.md; limits given beside it take its place",
        "calm",
    )
    gripper_speed_limit: float | None = option(
        "of the gripper's set-point, strokes per second; by default the profile's, 2.5", None
    )
    torque_limit_nm: list[float] | None = option(
        "per joint, limit of the commanded torque, Nm; by default the profile's", None
    )
    float_speed_rad_s: float = option(
        "floating joints are damped when they are faster, rad/s, and held when they stay so", 3.0
    )
    base_tilt_rad: list[float] = option(
        "roll and pitch of a base that does not stand upright, rad, as in URDF: a wall is [1.57, 0], a ceiling "
        "[3.14, 0]",
        factory=lambda: [0.0, 0.0],
    )
    rest_q_rad: list[float] | None = option(
        "per joint, where the arm lands, rad; by default the profile's, folded on a table", None
    )
    max_relative_target: float | None = option(
        "farthest that a target may be from the measured position, rad; by default no limit", None
    )
    gripper_stops_rad: list[float] | None = option(
        "angles of the gripper's motor, closed and open, rad; by default stored ones, else they are searched", None
    )
    gripper_force_limit_n: float | None = option(
        "force at the fingers above which the gripper yields, N; null: no limit", 50.0
    )
    calibration_path: str | None = option(
        "JSON file that keeps the gripper's stops; by default in LeRobot's calibration directory (YamArm: none)", None
    )
    command_timeout_s: float = option("when the newest target is older, s, the arm holds", 0.5)
    max_state_age_s: float = option("a state that is older, s, is an error, never an answer", 0.25)
    rate_hz: float = option("of the control loop, Hz, from 100; 0 is as fast as the wire allows (benchmarks)", 250.0)
    identity_path: str | None = option(
        "binding file of the arm that belongs on this channel (yam-identify --bind); by default it is not checked", None
    )
    workspace: WorkspaceConfig = option(
        "floor, boxes and distances that the arm keeps (docs/workspace.md); by default nothing is checked",
        factory=WorkspaceConfig,
    )
    gripper_search: bool = option("false: unknown stops of the gripper are not searched at the start", True)
    effort_limit_nm: list[float] | None = option(
        "per joint, torque beyond what weight and motion need that latches the emergency stop after 50 ms, Nm, except "
        "in a landing; by default no limit",
        None,
    )
    hold_integral: bool = option(
        "make up, slowly and within bounds, for the sag that the model of gravity leaves while the arm holds", True
    )
    track_integral: bool = option(
        "make up for it also while the arm follows targets, more quickly, and for the friction of soft joints: "
        "replays come nearer to what was recorded",
        False,
    )
    skip_listen: bool = option(
        "true: do not listen for another driver on the channel before the arm is energised", False
    )
    estop_button: Literal["top", "bottom"] | None = option(
        "button of the teaching handle that latches the emergency stop: top or bottom; by default none", None
    )

    def __post_init__(self) -> None:
        if isinstance(self.workspace, Mapping):  # values from JSON
            self.workspace = WorkspaceConfig.from_mapping(self.workspace)
        config_checks.check(self)
        self.workspace.check(self.name)

    @property
    def on_command_line(self) -> str:
        """Command line options with which `yam-identify` and `yam-zero` find the arm's channel."""
        return channel_options(self)


@dataclass(kw_only=True)
class LeadArmConfig(ArmConfig):
    """Configuration of a leader's arm. lead: None if the arm has no follower. passive: for a leader without motors."""

    lead: LeadConfig | None = None
    passive: PassiveConfig | None = None

    def __post_init__(self) -> None:
        if isinstance(self.passive, Mapping):
            self.passive = from_plain(PassiveConfig, self.passive, "passive")
        if isinstance(self.lead, Mapping):  # values from JSON
            self.lead = from_plain(LeadConfig, self.lead, "lead")
        super().__post_init__()
        if self.lead is not None:
            self.lead.check(self.name)


def lead_of(config: ArmConfig) -> LeadConfig | None:
    """Return the options that couple a leader to its follower, or None if the arm leads no follower."""
    return config.lead if isinstance(config, LeadArmConfig) else None


def passive_of(config: ChannelConfig) -> PassiveConfig | None:
    """Return the options for reading a leader without motors, or None if the arm has motors."""
    return config.passive if isinstance(config, LeadArmConfig) else None


def check_together(configs: Sequence[ChannelConfig]) -> None:
    """Check that the arms of one robot have different names, channels and files, and the same rate.

    Raises:
        ConfigError: two arms share a name, channel or file, or rates differ; the message names the values.
    """
    names = [config.name for config in configs]
    channels = [(config.interface, config.channel) for config in configs]
    if not configs or len(set(names)) < len(names) or len(set(channels)) < len(channels):
        raise ConfigError(f"arms of one robot need different names and channels, got {names} on {channels}")
    if len({config.rate_hz for config in configs}) > 1:
        raise ConfigError("arms of one robot tick together: give them the same rate_hz")
    for field_name in ("calibration_path", "identity_path", "tuning"):
        paths = [path for config in configs if (path := getattr(config, field_name, None)) is not None]
        if len(set(paths)) < len(paths):
            raise ConfigError(
                f"{', '.join(names)}: each arm needs a {field_name} of its own, not all {paths[0]} (in a config, a "
                "block that begins with `<<` has what the other block has, unless it says otherwise)"
            )
