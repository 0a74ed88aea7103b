"""What a configuration amounts to: profiles with the user's overrides, and the derived constants of one arm."""

from typing import Any

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.model import Load
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile, load_arm, load_gripper
from lerobot_robot_yam.arm.state import MAX_MOTORS
from lerobot_robot_yam.damiao.motor_spec import MotorSpec, check_specs
from lerobot_robot_yam.errors import ConfigError


class Hardware:
    """Resolved description of one arm with its end effector. n motors: the joints, then the gripper's if it has one.

    Attributes:
        arm, gripper: profiles with overrides applied.
        joints: number of arm joints, 0 for gripper-only use.
        n: number of motors.
        slots: of its motors in the shared records.
        direction, kp, kd, idle_kd, torque_limit_nm: (n,).
        lower, upper: (n,) command limits; rad, and 0 … 1 for the gripper.
    """

    def __init__(self, config: ArmConfig):
        overrides: dict[str, Any] = {}
        for key in ("kp", "kd", "gravity_factor", "idle_kd", "torque_limit_nm"):
            value = getattr(config, key)
            if value is not None:
                overrides[key] = value
        if config.speed_limit_rad_s is not None:
            limit = config.speed_limit_rad_s
            overrides["speed_limit_rad_s"] = [limit] * 6 if isinstance(limit, int | float) else limit
        gripper_motor = {
            "kp": config.gripper_kp,
            "kd": config.gripper_kd,
            "speed_limit_per_s": config.gripper_speed_limit,
        }
        gripper_motor = {key: value for key, value in gripper_motor.items() if value is not None}
        try:
            self.arm: ArmProfile = load_arm(config.arm, overrides)
            self.gripper: GripperProfile = load_gripper(config.gripper)
            if gripper_motor and self.gripper.motor is not None:
                self.gripper = load_gripper(config.gripper, {"motor": gripper_motor})
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
            raise ConfigError(f"{config.name}: arm {config.arm!r} has {self.n} motors; {MAX_MOTORS} can be driven")
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
        coulomb = config.coulomb_friction_nm
        self.coulomb_nm = np.zeros(self.joints) if coulomb is None else np.array(coulomb[: self.joints], dtype=float)
        self.speed_limit = np.array(speed)
        self.rest_q = joint.rest_q(self.gripper.name) if self.joints else np.zeros(0)
        x, y, z = config.payload_com_m
        self.load = Load(
            payload_mass_kg=config.payload_mass_kg,
            payload_com_m=(x, y, z),
            ee_inertia=None if config.ee_inertia is None else tuple(config.ee_inertia),
        )

    @property
    def has_gripper(self) -> bool:
        """True when the end effector has a motor."""
        return self.gripper.motor is not None
