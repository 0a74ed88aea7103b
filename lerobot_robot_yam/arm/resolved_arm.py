"""One arm as configured: profiles with the user's overrides, and constants derived from them."""

import copy
import dataclasses
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.config import PACES, ArmConfig
from lerobot_robot_yam.arm.mounting import mounted
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile, Load
from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper
from lerobot_robot_yam.arm.tuning import Tuning, load_tuning
from lerobot_robot_yam.damiao.motor_spec import MAX_MOTORS, MotorSpec, check_specs
from lerobot_robot_yam.errors import ConfigError

_ARM_OVERRIDES = ("kp", "kd", "gravity_factor", "idle_kd", "torque_limit_nm", "speed_limit_rad_s")
_GRIPPER_OVERRIDES = {"gripper_kp": "kp", "gripper_kd": "kd", "gripper_speed_limit": "speed_limit_per_s"}


class Roles(NamedTuple):
    """Joint indices for the motor names in a `profile.Folding`; None if the arm has no such joint."""

    base: int | None
    shoulder: int | None
    elbow: int | None
    wrist: int | None


class ResolvedArm:
    """One arm with its end effector. n motors: those of the joints, then the gripper's if it has one.

    Attributes:
        config: the configuration. name: the arm's name, for messages.
        arm, gripper: profiles with overrides applied.
        joints, joint_names: number of arm joints (0 without an arm), and names of their motors.
        n: number of motors.
        slots: slice of the motors in the shared records.
        direction, kp, kd, idle_kd, torque_limit_nm: (n,) values from the profiles.
        speed_limit: (n,) speed limit of the set-point; rad/s, for the gripper strokes per second.
        acceleration_limit: (joints,) acceleration limit of the set-point, rad/s².
        lower, upper: (n,) command limits; rad, for the gripper 0 … 1.
        coulomb_nm: (joints,) friction feedforward.
        folding: indices of the joints with a role in a landing.
        rest_q: (joints,) rad, pose in which the arm lands.
        tilt_rad: roll and pitch of the base.
        lies_at_rest: whether the arm is known to stay at rest_q when torque is cut.
        load: differences between the real end effector and its profile.

    Raises:
        ConfigError: a name is unknown, or a value is inconsistent or out of range; the message names the arm.
    """

    def __init__(self, config: ArmConfig):
        self.config, self.name = config, config.name
        try:
            arm, gripper = load_arm(config.arm), load_gripper(config.gripper)
            given = _per_joint(config, arm.joint_count)
            overrides = {key: given[key] for key in _ARM_OVERRIDES if key in given}
            self.arm: ArmProfile = load_arm(config.arm, overrides) if overrides else arm
            rows = [(field, getattr(config, key)) for key, field in _GRIPPER_OVERRIDES.items()]
            of_motor = {field: value for field, value in rows if value is not None}
            if of_motor and gripper.motor is not None:
                gripper = load_gripper(config.gripper, {"motor": of_motor})
            self.gripper: GripperProfile = mounted(gripper, self.arm)
            tuning = None if config.tuning is None else self._use(load_tuning(config.tuning))
        except ConfigError as error:
            raise ConfigError(f"{config.name}: {error}") from error
        if config.estop_button is not None and not self.gripper.handle_encoder:
            raise ConfigError(
                f"{config.name}: estop_button is a button of the teaching handle, and {self.gripper.name} has none; "
                "set it on a leader with a handle"
            )
        joint, motor = self.arm, self.gripper.motor
        self.joints = joint.joint_count
        self.n = self.joints + (motor is not None)
        if self.n == 0:
            raise ConfigError(f"{config.name}: arm {config.arm!r} with gripper {config.gripper!r} has no motor")
        if self.n > MAX_MOTORS:
            raise ConfigError(
                f"{config.name}: arm {config.arm!r} has {self.n} motors, at most {MAX_MOTORS} can be driven"
            )
        self.slots = slice(self.n)
        grippers = [] if motor is None else [motor]
        self.motors = [
            *(MotorSpec(row.name, row.can_id, row.type) for row in joint.motors),
            *(MotorSpec(row.name, row.can_id, row.type, turns=True) for row in grippers),
        ]
        check_specs(self.motors, config.name)
        directions = [row.direction for row in joint.motors] + [row.direction for row in grippers]
        self.direction = np.array(directions, dtype=float)
        self.kp, self.kd, self.idle_kd, self.torque_limit_nm = (
            np.array([*getattr(joint, key), *(getattr(row, key) for row in grippers)])
            for key in ("kp", "kd", "idle_kd", "torque_limit_nm")
        )
        self.speed_limit = np.array([*joint.speed_limit_rad_s, *(row.speed_limit_per_s for row in grippers)])
        self.acceleration_limit = np.array(given["acceleration_limit_rad_s2"])
        self.lower = np.array([*joint.joint_limits_rad[:, 0], *(0.0 for _ in grippers)])
        self.upper = np.array([*joint.joint_limits_rad[:, 1], *(1.0 for _ in grippers)])
        self.coulomb_nm = np.array(given.get("coulomb_friction_nm", [0.0] * self.joints))
        self.joint_names = names = [row.name for row in joint.motors]
        named = (joint.folding.base, joint.folding.shoulder, joint.folding.elbow, joint.folding.wrist)
        self.folding = Roles(*(names.index(name) if name in names else None for name in named))
        self.rest_q = self._rest_q(given.get("rest_q_rad"))
        self.tilt_rad = (config.base_tilt_rad[0], config.base_tilt_rad[1])
        self.lies_at_rest = config.rest_q_rad is None and not any(self.tilt_rad)
        x, y, z = config.payload_com_m
        self.load = Load(
            payload_mass_kg=config.payload_mass_kg,
            payload_com_m=(x, y, z),
            ee_inertia=None if config.ee_inertia is None else tuple(config.ee_inertia),
        )
        if tuning is not None and tuning.payload.mass_kg:
            self.load = tuning.load

    def _use(self, tuning: Tuning) -> Tuning:
        """Apply a tuning; gravity factors in the configuration take precedence over those of the tuning."""
        if self.config.ee_inertia is not None:
            raise ConfigError("tuning and ee_inertia both say what the end effector weighs; leave one of them out")
        if self.config.payload_mass_kg and tuning.payload.mass_kg:
            raise ConfigError(
                f"tuning has a payload of {tuning.payload.mass_kg:.3g} kg, and payload_mass_kg is "
                f"{self.config.payload_mass_kg:g}; leave one of them out"
            )
        arm, self.gripper = tuning.tuned(self.arm, self.gripper)
        factor = self.arm.gravity_factor if self.config.gravity_factor is not None else arm.gravity_factor
        self.arm = dataclasses.replace(arm, gravity_factor=factor)
        return tuning

    def _rest_q(self, given: list[float] | None) -> np.ndarray:
        if given is None or not self.joints:
            return self.arm.rest_q(self.gripper)
        rest, (low, high) = np.array(given), self.arm.joint_limits_rad.T
        if not ((rest >= low) & (rest <= high)).all():
            limits = f"{low.tolist()} … {high.tolist()}"
            raise ConfigError(f"{self.name}: rest_q_rad {rest.tolist()} is not within the joints' limits {limits}")
        return rest

    def without_search(self) -> "ResolvedArm":
        """Return a copy in whose configuration the start-up search for the gripper's stops is switched off."""
        other = copy.copy(self)
        other.config = dataclasses.replace(self.config, gripper_search=False)
        return other

    @property
    def has_gripper(self) -> bool:
        """Whether the end effector has a motor."""
        return self.gripper.motor is not None


def _per_joint(config: ArmConfig, joints: int) -> dict[str, list[float]]:
    """Map field names to the configuration's numbers per joint. Raises ConfigError: the count is wrong."""
    given: dict[str, list[float]] = {}
    pace = PACES[config.teleop_speed]
    usual = {"speed_limit_rad_s": pace.speed_rad_s, "acceleration_limit_rad_s2": pace.acceleration_rad_s2}
    for key in (*_ARM_OVERRIDES, "acceleration_limit_rad_s2", "coulomb_friction_nm", "effort_limit_nm", "rest_q_rad"):
        value = usual.get(key) if getattr(config, key) is None else getattr(config, key)
        if value is None:
            continue
        given[key] = value if isinstance(value, list) else [value] * joints
        if len(given[key]) != joints:
            raise ConfigError(f"{key} takes {joints} numbers, one per joint of arm '{config.arm}'; got {value}")
    return given
