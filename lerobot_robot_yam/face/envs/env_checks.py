"""Options of an environment that can be checked before its robot is connected: afterwards, arms would be energised."""

from collections.abc import Mapping, Sequence

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.feature_names import motors_of


def check_reset_pose(pose: Sequence[float] | None, arms: Mapping[str, ArmConfig]) -> None:
    """Refuse a reset pose that the arms cannot take.

    Args:
        pose: joints (rad) and grippers (0 … 1) in canonical order, None for none.
        arms: by feature prefix, in canonical order.

    Raises:
        ConfigError: too few values or too many, or one beyond its limits.
    """
    if pose is None:
        return
    motors = motors_of(arms)
    limits: list[tuple[float, float]] = []
    for arm in arms.values():
        limits += load_arm(arm.arm).joint_limits_rad.tolist()
        limits += [(0.0, 1.0)] * (load_gripper(arm.gripper).motor is not None)
    if len(pose) != len(limits):
        raise ConfigError(f"env.reset_pose: {len(pose)} values, not {len(limits)}: {', '.join(motors)}")
    for motor, value, (low, high) in zip(motors, pose, limits, strict=True):
        if not low <= value <= high:
            raise ConfigError(
                f"env.reset_pose: {motor} is {value:g}, outside {low:.3f} … {high:.3f} (rad; grippers 0 … 1)"
            )


def check_render_camera(name: str | None, cameras: Sequence[str]) -> None:
    """Refuse a render camera that is not there.

    Args:
        name: the option; None leaves the choice to the environment.
        cameras: those that there are.

    Raises:
        ConfigError: it is none of them.
    """
    if name is not None and name not in cameras:
        raise ConfigError(f"env.render_camera: there is no camera '{name}'; there are {', '.join(cameras) or 'none'}")
