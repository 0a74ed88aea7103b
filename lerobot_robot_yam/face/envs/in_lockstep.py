"""A robot's configuration, moved from wherever it was meant for onto a virtual rig in lock-step."""

from typing import Any

from lerobot_robot_yam.arm.profile_files import load_gripper
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.rig.scene.scene import ArmPlacement


def put_in_lockstep(robot: Any, rig: LockstepRig) -> None:
    """Change a follower's config in place: its arms' channels and its cameras become those of the rig.

    Raises:
        ConfigError: the scene lacks an arm, or a camera is none of a rig.
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
