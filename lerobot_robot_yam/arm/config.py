"""Configuration of one arm: its channel, its hardware, and overrides of its profile.

Plain values only: the dataclass travels as JSON to the control process.
"""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from lerobot_robot_yam.arm import config_checks
from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.runtime_files import rig_name

SOCKETCAN, VIRTUAL = "socketcan", "yam_sim"  # python-can interfaces: the kernel's, and the virtual rig


@dataclass(kw_only=True)
class ArmConfig:
    """One arm on one CAN channel. `None` means: as the profile says.

    Attributes:
        name: what messages call this arm ("left", "right", …).
        channel: python-can channel, such as `can_follower_l` or, on the virtual rig, `follower_left`.
        interface: python-can interface (`socketcan`, `yam_sim`, …).
        can_options: further keyword arguments of `can.Bus`, such as `rig` and `scene` of the virtual rig.
        arm, gripper: profile names, or paths of YAML files of the same form.
        start: "hold" keeps the measured pose once energised (followers), "float" is gravity-compensated free
            motion (leaders).
        kp, kd: position gains in Nm/rad and Nm s/rad, one per joint.
        gripper_kp, gripper_kd: gains of the gripper motor, same units.
        gravity_factor: per joint, factor on the modelled gravity torque.
        coulomb_friction_nm: per joint, friction torque that is fed forward; None switches the term off.
        idle_kd: per joint, damping gain while floating, Nm s/rad.
        payload_mass_kg, payload_com_m: a load fixed to the tool, centre in the frame of `tcp_site`.
        ee_inertia: replaces the end effector's inertia: centre (3, m), quaternion w x y z (4), moments (3, kg m²).
        speed_limit_rad_s: limit on the set-point's speed, one per joint or one for all.
        gripper_speed_limit: strokes per second; None: the profile's.
        torque_limit_nm: per joint, clip on the commanded torque.
        float_speed_rad_s: floating joints are damped when they are faster, and held when they stay so.
        base_tilt_rad: [roll, pitch] of a base that does not stand upright, as in URDF: a wall is [1.57, 0], a ceiling
            [3.14, 0]. Model and landing go by it.
        rest_q_rad: per joint, where the arm lands; None: the profile's, folded on a table.
        max_relative_target: largest distance of a target from the measured position, rad (None: no such limit).
        gripper_stops_rad: motor angles [closed, open]; None: stored ones, else calibrated at start.
        gripper_force_limit_n: squeeze force above which the limiter reduces the command; None switches it off.
        calibration_path: JSON file that keeps the gripper's stops; None keeps nothing.
        command_timeout_s: a target older than this no longer moves the set-point; the arm holds.
        max_state_age_s: an older state is an error, never an answer.
        rate_hz: control rate, from 100; 0 runs as fast as the wire and the laws allow (benchmarks).
        identity_path: binding file (`yam-identify --bind`) of the arm that belongs on this channel; None: not checked.
        workspace: floor, keep-out boxes and distances that the set-point keeps; by default nothing is checked.
        gripper_search: False seeks no unknown stops at the start, and puts those aside that do not fit.
        effort_limit_nm: per joint, measured torque that latches the emergency stop after 50 ms; None: no limit.
        hold_integral: make up, slowly and within bounds, for the sag that the gravity model leaves while holding.
        skip_listen: do not listen for foreign drivers before energising.
        estop_button: button of the teaching handle that latches the emergency stop: "top", "bottom", or None.
    """

    channel: str
    name: str = "arm"
    interface: str = "socketcan"
    can_options: dict[str, Any] = field(default_factory=dict)
    arm: str = "yam"
    gripper: str = "linear_4310"
    start: Literal["hold", "float"] = "hold"
    kp: list[float] | None = None
    kd: list[float] | None = None
    gripper_kp: float | None = None
    gripper_kd: float | None = None
    gravity_factor: list[float] | None = None
    coulomb_friction_nm: list[float] | None = None
    idle_kd: list[float] | None = None
    payload_mass_kg: float = 0.0
    payload_com_m: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    ee_inertia: list[float] | None = None
    speed_limit_rad_s: list[float] | float | None = None
    gripper_speed_limit: float | None = None
    torque_limit_nm: list[float] | None = None
    float_speed_rad_s: float = 3.0
    base_tilt_rad: list[float] = field(default_factory=lambda: [0.0, 0.0])
    rest_q_rad: list[float] | None = None
    max_relative_target: float | None = None
    gripper_stops_rad: list[float] | None = None
    gripper_force_limit_n: float | None = 50.0
    calibration_path: str | None = None
    command_timeout_s: float = 0.5
    max_state_age_s: float = 0.25
    rate_hz: float = 250.0
    identity_path: str | None = None
    workspace: WorkspaceConfig = field(default_factory=WorkspaceConfig)
    gripper_search: bool = True
    effort_limit_nm: list[float] | None = None
    hold_integral: bool = True
    skip_listen: bool = False
    estop_button: Literal["top", "bottom"] | None = None

    def __post_init__(self) -> None:
        if isinstance(self.workspace, Mapping):  # as it comes out of JSON
            self.workspace = WorkspaceConfig.from_mapping(self.workspace)
        config_checks.check(self)
        self.workspace.check(self.name)

    @property
    def on_command_line(self) -> str:
        """Its channel as the options of `yam-identify` and `yam-zero` name it."""
        words = ["--channel", self.channel]
        rig = self.can_options.get("rig")
        if self.interface == VIRTUAL and rig and rig_name(rig)[1] is None:  # others end with their process
            words += ["--rig", rig]
        elif self.interface != SOCKETCAN:
            words += ["--interface", self.interface]
        return shlex.join(words)


def check_together(configs: Sequence[ArmConfig]) -> None:
    """Refuse arms of one robot that have the same name, channel or file, or tick at different rates.

    Raises:
        ConfigError: says which.
    """
    names = [config.name for config in configs]
    channels = [(config.interface, config.channel) for config in configs]
    if not configs or len(set(names)) < len(names) or len(set(channels)) < len(channels):
        raise ConfigError(f"arms of one robot need different names and channels, got {names} on {channels}")
    if len({config.rate_hz for config in configs}) > 1:
        raise ConfigError("arms of one robot tick together: give them the same rate_hz")
    for field_name in ("calibration_path", "identity_path"):
        paths = [path for config in configs if (path := getattr(config, field_name)) is not None]
        if len(set(paths)) < len(paths):
            raise ConfigError(
                f"{', '.join(names)}: each arm needs a {field_name} of its own, not all {paths[0]} (in a config, a "
                "block that begins with `<<` has what the other block has, unless it says otherwise)"
            )
