"""Arm and gripper profiles: all numbers that describe the hardware. `profile_files` loads them.

Conventions: SI units; quaternions w x y z; joint value = (motor angle - zero) * direction; gripper commands from 0
(closed) to 1 (open). Arrays of an arm have one entry per joint: n joints, 0 for the arm "none".
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from lerobot_robot_yam.arm.joint_map import RANGE_TOLERANCE_RAD
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.strict_yaml import array_field

EE_BODY = "gripper"  # root body of the end effector in the model

COLOURS: dict[str, tuple[float, float, float, float]] = {
    "housing": (0.13, 0.13, 0.15, 1.0),
    "metal": (0.74, 0.76, 0.78, 1.0),
    "cap": (0.30, 0.31, 0.34, 1.0),
    "accent": (0.95, 0.47, 0.08, 1.0),
    "rubber": (0.20, 0.20, 0.21, 1.0),
    "soft": (0.90, 0.90, 0.86, 1.0),
}


@dataclass(frozen=True, eq=False)
class Joint:
    """Hinge (rad) or slide (m). `axis` is in the body's own frame."""

    name: str
    kind: str
    axis: np.ndarray = array_field(3)


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass, centre of mass, principal axes and principal moments of inertia, in the body's frame."""

    mass_kg: float
    com_m: np.ndarray = array_field(3)
    quat_wxyz: np.ndarray = array_field(4)
    moments_kg_m2: np.ndarray = array_field(3)


@dataclass(frozen=True, eq=False)
class Site:
    """Named frame on a body."""

    name: str
    pos_m: np.ndarray = array_field(3)
    quat_wxyz: np.ndarray = array_field(4)


@dataclass(frozen=True, eq=False)
class Shape:
    """Primitive that draws a body, and collides if `collides` is set.

    kind: "cylinder" or "capsule" between `from_m` and `to_m`; "box" or "ellipsoid" with full extents `size_m` at
    `center_m`, rotated by `quat_wxyz`. colour: a key of `COLOURS`, or "none" for an invisible shape.
    """

    kind: str
    colour: str
    radius_m: float = 0.0
    collides: bool = False
    from_m: np.ndarray = array_field(3, default=(0, 0, 0))
    to_m: np.ndarray = array_field(3, default=(0, 0, 0))
    center_m: np.ndarray = array_field(3, default=(0, 0, 0))
    size_m: np.ndarray = array_field(3, default=(0, 0, 0))
    quat_wxyz: np.ndarray = array_field(4, default=(1, 0, 0, 0))


@dataclass(frozen=True, eq=False)
class Body:
    """One link: its frame in the parent's frame at joint value 0, inertia, sites, shapes.

    extents_m (2, 3): bounding box [min, max] of the real surface in the body's frame, if known.
    """

    name: str
    parent: str
    inertial: Inertial
    pos_m: np.ndarray = array_field(3)
    quat_wxyz: np.ndarray = array_field(4)
    joint: Joint | None = None
    sites: tuple[Site, ...] = ()
    shapes: tuple[Shape, ...] = ()
    extents_m: np.ndarray | None = array_field(2, 3, default=None)


@dataclass(frozen=True)
class ArmMotor:
    """Motor of a joint. `type` is a key of `damiao.tables.MOTOR_TYPES`; direction is +1 or -1."""

    name: str
    can_id: int
    type: str
    direction: int


@dataclass(frozen=True)
class Folding:
    """Motor names of the joints with a role in a landing; None if the arm has no such joint.

    The base turns about the vertical and keeps its angle. Angles of shoulder and elbow increase as the arm unfolds,
    which lifts the tool over obstacles. The wrist stays raised while the arm folds, and is lowered last.
    """

    base: str | None = "joint_1"
    shoulder: str | None = "joint_2"
    elbow: str | None = "joint_3"
    wrist: str | None = "joint_4"


@dataclass(frozen=True)
class GripperMotor:
    """Motor of a gripper, with gains (Nm/rad, Nm s/rad) and limits; `speed_limit_per_s` in strokes per second."""

    name: str
    can_id: int
    type: str
    direction: int
    kp: float
    kd: float
    idle_kd: float
    torque_limit_nm: float
    speed_limit_per_s: float
    armature_kg_m2: float
    friction_nm: float


@dataclass(frozen=True, eq=False)
class Calibration:
    """Parameters of the search for a gripper's stops. A span between the stops outside min … max is rejected.

    Angles are in joint space (motor angle * direction). nominal_stops_rad is [closed, open].
    """

    closed_is_larger: bool
    min_span_rad: float
    max_span_rad: float
    torque_nm: float
    timeout_per_direction_s: float
    standstill_rad: float
    check_interval_s: float
    standstill_checks: int
    pause_s: float
    nominal_stops_rad: np.ndarray = array_field(2)


@dataclass(frozen=True)
class Limiter:
    """Parameters of the grip-force limiter; force_map is "linear" or "crank"."""

    max_force_n: float
    clog_force_threshold_nm: float
    clog_speed_threshold_per_s: float
    sign: float
    force_map: str
    gripper_stroke_m: float
    motor_stroke_rad: float = 0.0
    close_angle_rad: float = 0.0
    open_angle_rad: float = 0.0
    motor_reading_offset_rad: float = 0.0


@dataclass(frozen=True, eq=False)
class ArmProfile:
    """Profile of an arm: motors, gains, limits, simulation parameters, rest poses, links. Arrays have shape (n,).

    Attributes:
        self_contacts: pairs of body names whose shapes collide with each other; other links do not collide.
        gripper_can_id: CAN id of the motor of any gripper on this arm; None: see `mounting.gripper_id`.
        bent_q_rad: pose for work on a table, tool pointing down, from which the scripted operator plans.
        zero_pose: motor name -> description of the joint's pose at 0.
        grasp_site_m: gripper name -> position of `grasp_site` in the gripper's root body, m; overrides the gripper's
            profile.
    """

    name: str
    motors: tuple[ArmMotor, ...]
    bodies: tuple[Body, ...]
    rest_q_rad: dict[str, np.ndarray] = array_field(-1)
    kp: np.ndarray = array_field(-1)
    kd: np.ndarray = array_field(-1)
    idle_kd: np.ndarray = array_field(-1)
    gravity_factor: np.ndarray = array_field(-1)
    coulomb_friction_nm: np.ndarray = array_field(-1)
    joint_limits_rad: np.ndarray = array_field(-1, 2)
    speed_limit_rad_s: np.ndarray = array_field(-1)
    torque_limit_nm: np.ndarray = array_field(-1)
    armature_kg_m2: np.ndarray = array_field(-1)
    friction_nm: np.ndarray = array_field(-1)
    self_contacts: tuple[tuple[str, ...], ...] = ()
    folding: Folding = Folding()
    gripper_can_id: int | None = None
    bent_q_rad: np.ndarray | None = array_field(-1, default=None)
    zero_pose: dict[str, str] = field(default_factory=dict)
    grasp_site_m: dict[str, np.ndarray] | None = array_field(3, default=None)

    @property
    def joint_count(self) -> int:
        return len(self.motors)

    def rest_q(self, gripper: "GripperProfile") -> np.ndarray:
        """Return the rest pose (n,) rad with `gripper` mounted, in which the arm stays when torque is cut.

        A pose in this profile takes precedence over one in the gripper's profile.

        Raises:
            ConfigError: neither profile has a rest pose, or the gripper's does not fit this arm's joints.
        """
        if not self.joint_count:
            return np.zeros(0)
        if gripper.name in self.rest_q_rad:
            return self.rest_q_rad[gripper.name]
        rest = (gripper.rest_q_rad or {}).get(self.name)
        if rest is None:
            raise ConfigError(
                f"arm '{self.name}' has no rest pose for gripper '{gripper.name}' (it has {sorted(self.rest_q_rad)}); "
                f"add rest_q_rad.{self.name} to the gripper's profile, or rest_q_rad.{gripper.name} to the arm's"
            )
        low, high = self.joint_limits_rad.T
        if rest.shape != low.shape or ((rest < low - RANGE_TOLERANCE_RAD) | (rest > high + RANGE_TOLERANCE_RAD)).any():
            limits = f"{low.tolist()} … {high.tolist()}"
            raise ConfigError(
                f"gripper '{gripper.name}': rest_q_rad.{self.name} {rest.tolist()} is not within the joints' {limits}"
            )
        return rest


@dataclass(frozen=True, eq=False)
class GripperProfile:
    """Profile of an end effector. `motor`, `calibration` and `limiter` are None if there is no motor.

    Attributes:
        finger_range_m: [closed, open] position of both finger joints, m.
        handle_encoder: whether the end effector is a teaching handle with an encoder on the bus.
        rest_q_rad: arm name -> rest pose, rad, with this end effector; the arm's profile takes precedence.
    """

    name: str
    bodies: tuple[Body, ...]
    handle_encoder: bool = False
    motor: GripperMotor | None = None
    calibration: Calibration | None = None
    limiter: Limiter | None = None
    finger_range_m: np.ndarray | None = array_field(2, default=None)
    rest_q_rad: dict[str, np.ndarray] | None = array_field(-1, default=None)

    @property
    def finger_joints(self) -> tuple[str, ...]:
        """Names of the sliding finger joints; empty if there are none."""
        return tuple(body.joint.name for body in self.bodies if body.joint)

    @property
    def stroke_rad(self) -> float:
        """Nominal stroke of the motor between the stops, rad; 0 if there is no motor."""
        if self.calibration is None:
            return 0.0
        closed, opened = self.calibration.nominal_stops_rad
        return float(abs(opened - closed))


@dataclass(frozen=True)
class Load:
    """Differences between the real end effector and its profile.

    payload_com_m is the payload's centre of mass in the frame of tcp_site. ee_mass_kg replaces the mass of the end
    effector's root body, ee_inertia its inertial: centre of mass (3), quaternion (4), principal moments (3).
    """

    payload_mass_kg: float = 0.0
    payload_com_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ee_mass_kg: float | None = None
    ee_inertia: Sequence[float] | None = None

    def __post_init__(self) -> None:
        numbers = [self.payload_mass_kg, *self.payload_com_m, self.ee_mass_kg or 0.0, *(self.ee_inertia or ())]
        if not np.isfinite(numbers).all() or self.payload_mass_kg < 0 or (self.ee_mass_kg or 0.0) < 0:
            raise ConfigError(f"payload and end-effector masses must be finite and not negative: {self}")
        if len(self.payload_com_m) != 3:
            raise ConfigError(f"payload_com_m needs three numbers in metres, got {self.payload_com_m}")
        if self.ee_inertia is not None and (len(self.ee_inertia) != 10 or min(self.ee_inertia[7:]) <= 0):
            raise ConfigError(
                "ee_inertia needs 10 numbers (centre of mass 3, quaternion 4, principal moments 3 > 0), "
                f"got {list(self.ee_inertia)}"
            )
