"""Hardware and settings of a connected arm, for printing or for storing with recorded data."""

from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from lerobot_robot_yam.control.preflight.binding import Binding
from lerobot_robot_yam.session.arm_client import ArmClient

_PACKAGES = ("lerobot_robot_yam", "python-can", "mujoco", "lerobot")


@dataclass(frozen=True, eq=False)
class ArmInfo:
    """Hardware and settings of a connected arm with n joints; SI units.

    Attributes:
        name, channel, interface, rate_hz: as configured.
        arm, gripper: names of the profiles.
        has_gripper: whether the gripper has a motor.
        joint_names: (n,) names of the joints.
        motor_types: type of each motor, the gripper's last.
        joint_limits_rad: (n, 2) lower and upper limits.
        speed_limit_rad_s, torque_limit_nm, kp, kd, idle_kd, gravity_factor: (n,) settings; kp and kd: current gains.
        gripper_stops_rad: motor angles of the closed and the open gripper; None until known.
        gripper_force_limit_n: maximum squeeze force, N; None: no limit.
        firmware: motor name -> firmware version from the binding file (`identity_path`); empty without a binding.
        versions: name -> version of each package that drives the arm.
    """

    name: str
    channel: str
    interface: str
    rate_hz: float
    arm: str
    gripper: str
    has_gripper: bool
    joint_names: tuple[str, ...]
    motor_types: tuple[str, ...]
    joint_limits_rad: np.ndarray
    speed_limit_rad_s: np.ndarray
    torque_limit_nm: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    idle_kd: np.ndarray
    gravity_factor: np.ndarray
    gripper_stops_rad: tuple[float, float] | None
    gripper_force_limit_n: float | None
    firmware: dict[str, int | None]
    versions: dict[str, str]

    @classmethod
    def of(cls, client: ArmClient) -> "ArmInfo":
        """Collect the hardware and settings of a client's arm.

        Raises:
            LifeCycleError: the arm is not connected.
            ConfigError: the arm's binding cannot be read.
        """
        hw, config = client.hardware, client.config
        bound = None if config.identity_path is None else Binding.load(Path(config.identity_path))
        firmware = (
            {}
            if bound is None
            else {
                motor.name: bound.fingerprint.motors[motor.can_id].software
                for motor in hw.motors
                if motor.can_id in bound.fingerprint.motors
            }
        )
        j = slice(hw.joints)
        return cls(
            name=config.name,
            channel=config.channel,
            interface=config.interface,
            rate_hz=config.rate_hz,
            arm=hw.arm.name,
            gripper=hw.gripper.name,
            has_gripper=hw.has_gripper,
            joint_names=tuple(hw.joint_names),
            motor_types=tuple(motor.type for motor in hw.motors),
            joint_limits_rad=np.stack([hw.lower[j], hw.upper[j]], axis=1),
            speed_limit_rad_s=hw.speed_limit[j].copy(),
            torque_limit_nm=hw.torque_limit_nm[j].copy(),
            kp=client.kp.copy(),
            kd=client.kd.copy(),
            idle_kd=hw.idle_kd[j].copy(),
            gravity_factor=np.array(hw.arm.gravity_factor),
            gripper_stops_rad=client.published().gripper_stops_rad,
            gripper_force_limit_n=config.gripper_force_limit_n,
            firmware=firmware,
            versions={package: found for package in _PACKAGES if (found := _version(package))},
        )


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # running from a checkout that is not installed
        return ""
