"""What a configuration amounts to: profiles with the user's overrides, and the derived constants of one arm."""

from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.model import Load
from lerobot_robot_yam.arm.mounting import mounted
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile
from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper
from lerobot_robot_yam.damiao.motor_spec import MAX_MOTORS, MotorSpec, check_specs
from lerobot_robot_yam.errors import ConfigError

_OF_THE_PROFILE = ("kp", "kd", "gravity_factor", "idle_kd", "torque_limit_nm", "speed_limit_rad_s")


class Roles(NamedTuple):
    """Indices of the joints of a `profile.Folding`; None where the arm has no such joint."""

    base: int | None
    shoulder: int | None
    elbow: int | None
    wrist: int | None


class Hardware:
    """Resolved description of one arm with its end effector. n motors: the joints, then the gripper's if it has one.

    Attributes:
        arm, gripper: profiles with overrides applied.
        joints: number of arm joints, 0 for gripper-only use.
        n: number of motors.
        slots: of its motors in the shared records.
        direction, kp, kd, idle_kd, torque_limit_nm: (n,).
        lower, upper: (n,) command limits; rad, and 0 … 1 for the gripper.
        folding: which joint does what in a landing.
        rest_q: (joints,) rad, where it lands.
        tilt_rad: roll and pitch of its base.
        lies_at_rest: it is known that cutting torque at rest_q moves nothing.
    """

    def __init__(self, config: ArmConfig):
        gripper_motor = {
            "kp": config.gripper_kp,
            "kd": config.gripper_kd,
            "speed_limit_per_s": config.gripper_speed_limit,
        }
        gripper_motor = {key: value for key, value in gripper_motor.items() if value is not None}
        try:
            given = _per_joint(config, load_arm(config.arm).joint_count)
            self.arm: ArmProfile = load_arm(config.arm, {key: given[key] for key in _OF_THE_PROFILE if key in given})
            gripper: GripperProfile = load_gripper(config.gripper)
            if gripper_motor and gripper.motor is not None:
                gripper = load_gripper(config.gripper, {"motor": gripper_motor})
            self.gripper = mounted(gripper, self.arm)
        except ConfigError as error:
            raise ConfigError(f"{config.name}: {error}") from error
        if config.estop_button is not None and not self.gripper.handle_encoder:
            raise ConfigError(
                f"{config.name}: estop_button is a button of the teaching handle, and {self.gripper.name} has none; "
                "set it on a leader with a handle"
            )
        motor = self.gripper.motor
        self.joints = self.arm.joint_count
        self.n = self.joints + (motor is not None)
        if self.n == 0:
            raise ConfigError(f"{config.name}: arm {config.arm!r} with gripper {config.gripper!r} has no motor")
        if self.n > MAX_MOTORS:
            raise ConfigError(
                f"{config.name}: arm {config.arm!r} has {self.n} motors, at most {MAX_MOTORS} can be driven"
            )
        self.slots = slice(self.n)
        self.motors = [MotorSpec(m.name, m.can_id, m.type) for m in self.arm.motors]
        joint = self.arm
        direction = [float(m.direction) for m in joint.motors]
        kp, kd, idle_kd, torque = (
            list(joint.kp),
            list(joint.kd),
            list(joint.idle_kd),
            list(joint.torque_limit_nm),
        )
        speed = list(joint.speed_limit_rad_s)
        lower, upper = list(joint.joint_limits_rad[:, 0]), list(joint.joint_limits_rad[:, 1])
        if motor is not None:
            self.motors.append(MotorSpec(motor.name, motor.can_id, motor.type, turns=True))
            direction.append(float(motor.direction))
            kp.append(motor.kp)
            kd.append(motor.kd)
            idle_kd.append(motor.idle_kd)
            torque.append(motor.torque_limit_nm)
            speed.append(motor.speed_limit_per_s)
            lower.append(0.0)
            upper.append(1.0)
        check_specs(self.motors, config.name)
        self.direction = np.array(direction)
        self.kp, self.kd, self.idle_kd = np.array(kp), np.array(kd), np.array(idle_kd)
        self.torque_limit_nm = np.array(torque)
        self.lower, self.upper = np.array(lower), np.array(upper)
        self.coulomb_nm = np.array(given.get("coulomb_friction_nm", [0.0] * self.joints))
        self.speed_limit = np.array(speed)
        names = [motor.name for motor in joint.motors]
        named = (joint.folding.base, joint.folding.shoulder, joint.folding.elbow, joint.folding.wrist)
        self.folding = Roles(*(names.index(name) if name in names else None for name in named))
        self.rest_q = self._rest_q(config.name, given.get("rest_q_rad"))
        self.tilt_rad = (config.base_tilt_rad[0], config.base_tilt_rad[1])
        self.lies_at_rest = config.rest_q_rad is None and not any(self.tilt_rad)
        x, y, z = config.payload_com_m
        self.load = Load(
            payload_mass_kg=config.payload_mass_kg,
            payload_com_m=(x, y, z),
            ee_inertia=None if config.ee_inertia is None else tuple(config.ee_inertia),
        )

    def _rest_q(self, name: str, given: list[float] | None) -> np.ndarray:
        if given is None or not self.joints:
            return self.arm.rest_q(self.gripper.name) if self.joints else np.zeros(0)
        rest, (low, high) = np.array(given), self.arm.joint_limits_rad.T
        if not ((rest >= low) & (rest <= high)).all():
            limits = f"{low.tolist()} … {high.tolist()}"
            raise ConfigError(f"{name}: rest_q_rad {rest.tolist()} is not within the joints' limits {limits}")
        return rest

    @property
    def has_gripper(self) -> bool:
        """True when the end effector has a motor."""
        return self.gripper.motor is not None


def _per_joint(config: ArmConfig, joints: int) -> dict[str, list[float]]:
    """What the configuration gives for each joint, by field.

    Raises:
        ConfigError: not as many numbers as the arm has joints.
    """
    given = {}
    for key in (*_OF_THE_PROFILE, "coulomb_friction_nm", "effort_limit_nm", "rest_q_rad"):
        value = getattr(config, key)
        if value is None:
            continue
        given[key] = value if isinstance(value, list) else [value] * joints
        if len(given[key]) != joints:
            raise ConfigError(f"{key} takes {joints} numbers, one per joint of arm '{config.arm}'; got {value}")
    return given
