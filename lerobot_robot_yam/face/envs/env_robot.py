"""The robot of an environment before it is connected: options that are checked, and its place in a lock-step rig."""

from collections.abc import Mapping, Sequence
from typing import Any

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.feature_names import motors_of
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.rig.scene.scene import ArmPlacement


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

    Raises:
        ConfigError: there is no such camera.
    """
    if name is not None and name not in cameras:
        raise ConfigError(f"env.render_camera: there is no camera '{name}'; there are {', '.join(cameras) or 'none'}")


def put_in_lockstep(robot: Any, rig: LockstepRig) -> None:
    """Change a follower's config in place: its arms' channels and its cameras become those of the rig.

    Raises:
        ConfigError: the scene lacks an arm, or a camera is not rendered by a rig.
    """
    rows = {row.channel: row for row in rig.device.scene.arms}
    robot.isolation = "lockstep"
    for arm in robot.arms().values():
        if arm.channel not in rows:
            raise ConfigError(f"{arm.channel}: the scene has {', '.join(rows)}")
        arm.interface, arm.can_options = "yam_lockstep", {"rig": rig.name}
        if arm.gripper_stops_rad is None:  # stored ones would tie the outcome to what was stored
            arm.gripper_stops_rad = _stops(rows[arm.channel])
    for name, camera in robot.all_cameras().items():
        if camera.type != "yam_sim":
            raise ConfigError(f"camera {name} is of type {camera.type}; in lock-step only yam_sim keeps the rig's time")
        camera.rig = rig.name


def _stops(row: ArmPlacement) -> list[float] | None:
    calibration = load_gripper(row.gripper).calibration
    if calibration is None:
        return None
    stops = calibration.nominal_stops_rad if row.stops_rad is None else row.stops_rad
    return [float(stop) for stop in stops]
