"""Search for the parts of a rig: the arm or base on each CAN channel, and the cameras. Energises nothing.

A channel has a follower, a leader, a leader without motors, a mobile base, or nothing. Motor registers and handle
versions are read to distinguish these cases, as in `yam-identify`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from lerobot_robot_yam.arm.config import ARMS, GRIPPERS, VIRTUAL, ArmConfig
from lerobot_robot_yam.arm.mounting import arm_ids, gripper_id
from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper
from lerobot_robot_yam.cameras.opening import config_of, plugged_cameras
from lerobot_robot_yam.cameras.video_devices import ROOT
from lerobot_robot_yam.commands.lib.arm_command import own_bus
from lerobot_robot_yam.control.preflight.fingerprint import Fingerprint, read_fingerprint
from lerobot_robot_yam.control.preflight.role import FIRST_IDS, are_wheels, likely_gripper
from lerobot_robot_yam.damiao.settings.handle_access import HandleAccess
from lerobot_robot_yam.doctor.check_session import driver_of
from lerobot_robot_yam.doctor.kit.targets import LEADER_GRIPPER, Target
from lerobot_robot_yam.errors import ChannelInUseError, SetupError, YamError
from lerobot_robot_yam.mobile.base_profile import BaseProfile
from lerobot_robot_yam.mobile.rail_profile import RAIL_MOTOR
from lerobot_robot_yam.rig.control import RigControl
from lerobot_robot_yam.system.sysfs import read_adapters

FOLLOWER, LEADER, PASSIVE, MOBILE_BASE = "follower", "leader", "leader without motors", "mobile base"
RAIL = "with a rail"  # mark of a base whose rail's motor answers
_PIXELS = {"width": 640, "height": 480, "fps": 30}
_RIG_PIXELS = {"width": 320, "height": 240, "fps": 30}
_WHEELS = {motor.can_id for motor in BaseProfile().motors()}
_IDS = sorted({can_id for name in ARMS for can_id in arm_ids(load_arm(name))} | _WHEELS | {RAIL_MOTOR.can_id})


@dataclass(frozen=True)
class FoundArm:
    """Arm or base found on a channel.

    Attributes:
        config: config with the arm's channel and interface; other fields are still at their defaults.
        role: FOLLOWER, LEADER, PASSIVE or MOBILE_BASE.
        arms, grippers: profiles that fit the motors found, most likely first; none of a base.
        mark: handle firmware, type of the gripper's motor, number of encoders, or a base's rail, for the drawing.
        options: options of the arm in the rig's file.
    """

    config: ArmConfig
    role: str
    arms: tuple[str, ...]
    grippers: tuple[str, ...]
    mark: str
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def channel(self) -> str:
        return self.config.channel

    @property
    def virtual(self) -> bool:
        """Whether the arm belongs to a virtual rig."""
        return self.config.interface == VIRTUAL


class FoundCamera(NamedTuple):
    """Camera found: a label to show to the user, LeRobot's config of the camera, and a proposed name."""

    label: str
    options: dict[str, Any]
    name: str = ""


def find_channels(rig: str | None, root: Path | None) -> list[str]:
    """Return the channels of the virtual rig `rig`; without a rig, or with `root`, the CAN interfaces in sysfs.

    Raises:
        SetupError: no channel was found.
        RigError: the rig cannot be reached.
    """
    if rig is not None and root is None:
        with RigControl(rig, hold=False) as control:
            scene = control.scene()
            return [*(arm["channel"] for arm in scene["arms"]), *([scene["base"]] if scene["base"] else [])]
    found = [adapter.name for adapter in read_adapters((root or ROOT) / "sys")]
    if not found:
        raise SetupError("there is no CAN adapter; plug one in (`lsusb` lists what is plugged in)")
    return found


def find_arms(configs: Sequence[ArmConfig], tell: Callable[[str], None]) -> list[FoundArm]:
    """Return the arms on these channels; `tell` gets a line per channel: the arm found, or why there is none.

    Raises:
        SetupError: no channel has an arm or a base.
    """
    found = []
    for config in configs:
        channel = config.channel
        try:
            arm = _find(config)
        except ChannelInUseError as error:
            tell(f"{channel}: left out: {error} ({driver_of(Target(config))}). End that session first")
        except YamError as error:
            tell(f"{channel}: left out: {error}")
        else:
            if arm is None:
                tell(f"{channel}: nothing answers; check the arm's power, its emergency stop and the CAN cable")
            else:
                tell(f"{channel}: a {arm.role} ({arm.mark})")
                found.append(arm)
    if not found:
        raise SetupError("no arm was found, and no base; yam-doctor says what is wrong")
    return found


def find_cameras(rig: str | None, root: Path) -> list[FoundCamera]:
    """Return the cameras of the virtual rig `rig`; without a rig, of this computer.

    Raises:
        RigError: the rig cannot be reached.
        CameraError: two cameras cannot be distinguished.
    """
    if rig is None:
        return [FoundCamera(str(one), config_of(one, root) | _PIXELS) for one in plugged_cameras(root)]
    with RigControl(rig, hold=False) as control:
        names = control.scene()["cameras"]
    rows = {name: {"type": "yam_sim", "camera": name, **_RIG_PIXELS} for name in names}
    return [FoundCamera(f"{name} of the rig", options, name) for name, options in rows.items()]


def _find(config: ArmConfig) -> FoundArm | None:
    with own_bus(config) as bus:
        found = read_fingerprint(bus, config.channel, config.interface, _IDS)
        devices = HandleAccess(bus, config.channel).devices() if found.handle_firmware else []
    if are_wheels([motor.gear_ratio if (motor := found.motors.get(i)) else None for i in FIRST_IDS]):
        missing = sorted(_WHEELS - set(found.motors))
        if missing:
            raise SetupError(
                f"a base, but its motors {missing} do not answer; yam-doctor --channel {config.channel}:base"
            )
        return FoundArm(config, MOBILE_BASE, (), (), RAIL if RAIL_MOTOR.can_id in found.motors else "no rail")
    arms = tuple(name for name in ARMS if found.motors and _fits(name, found))
    if len(devices) > 1:
        return FoundArm(config, PASSIVE, arms or ARMS, (LEADER_GRIPPER,), f"{len(devices)} encoders")
    if not arms:
        if found.motors:
            kinds = ", ".join(f"{can_id}: {motor.kind}" for can_id, motor in sorted(found.motors.items()))
            raise SetupError(f"motors answer that no arm has ({kinds}); yam-motors scan {config.on_command_line}")
        return None
    if found.handle_firmware is not None:
        version = ".".join(map(str, found.handle_firmware))
        return FoundArm(config, LEADER, arms, (LEADER_GRIPPER,), f"handle {version}")
    motor = found.motors.get(gripper_id(load_arm(arms[0])))
    motors = {name: load_gripper(name).motor for name in GRIPPERS}
    fitting = tuple(name for name, row in motors.items() if motor and row and row.type == motor.kind)
    grippers = fitting or (likely_gripper(False, motor.gear_ratio if motor else None),)
    return FoundArm(config, FOLLOWER, arms, grippers, f"gripper {motor.kind}" if motor else "no gripper motor")


def _fits(name: str, found: Fingerprint) -> bool:
    """Return whether all motors found have the types of the profile. Missing motors are left to yam-doctor."""
    there = [motor for motor in load_arm(name).motors if motor.can_id in found.motors]
    return bool(there) and all(motor.type == found.motors[motor.can_id].kind for motor in there)
