"""The parts of a rig that are there: what is on each CAN channel, and the cameras. Energises nothing, opens no camera.

On a channel is a follower, a leader, a leader without motors, or nothing. Registers of motors and the versions of
handles tell it, as in `yam-identify`; they are asked.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_robot_yam.arm.config import ARMS, GRIPPERS, SOCKETCAN, VIRTUAL, ArmConfig
from lerobot_robot_yam.arm.mounting import arm_ids, gripper_id
from lerobot_robot_yam.arm.profile_files import load_arm, load_gripper
from lerobot_robot_yam.cameras.opening import config_of, plugged_cameras
from lerobot_robot_yam.cameras.video_devices import ROOT
from lerobot_robot_yam.commands.lib.arm_command import own_bus
from lerobot_robot_yam.control.preflight.fingerprint import Fingerprint, read_fingerprint
from lerobot_robot_yam.control.preflight.role import likely_gripper
from lerobot_robot_yam.damiao.settings.handle_access import HandleAccess
from lerobot_robot_yam.doctor.check_session import driver_of
from lerobot_robot_yam.doctor.kit.targets import LEADER_GRIPPER, Target
from lerobot_robot_yam.errors import ChannelInUseError, SetupError, YamError
from lerobot_robot_yam.rig.control import RigControl
from lerobot_robot_yam.system.runtime_files import rig_name
from lerobot_robot_yam.system.sysfs import read_adapters

FOLLOWER, LEADER, PASSIVE = "follower", "leader", "leader without motors"
_PIXELS = {"width": 640, "height": 480, "fps": 30}
_IDS = sorted({can_id for name in ARMS for can_id in arm_ids(load_arm(name))})


@dataclass(frozen=True)
class Place:
    """Where the arms are.

    Attributes:
        interface: python-can interface.
        rig: name of the virtual rig, None of real arms.
        root: whose sysfs lists adapters and cameras; None: this computer's, and of a virtual rig its own channels.
    """

    interface: str
    rig: str | None
    root: Path | None

    @classmethod
    def of(cls, interface: str | None, rig: str | None, root: Path | None) -> "Place":
        """As the options of a command say."""
        interface = interface or (VIRTUAL if rig else SOCKETCAN)
        return cls(interface, rig_name(rig)[0] if interface == VIRTUAL else None, root)

    @property
    def sysfs(self) -> Path:
        """Root of sysfs."""
        return (self.root or ROOT) / "sys"

    def channels(self) -> list[str]:
        """Channels that there are.

        Raises:
            SetupError: none.
            RigError: the rig cannot be reached.
        """
        if self.rig is not None and self.root is None:
            with RigControl(self.rig, hold=False) as rig:
                return [arm["channel"] for arm in rig.scene()["arms"]]
        found = [adapter.name for adapter in read_adapters(self.sysfs)]
        if not found:
            raise SetupError("there is no CAN adapter; plug one in (`lsusb` lists what is plugged in)")
        return found

    def config(self, channel: str) -> ArmConfig:
        """The arm on a channel, as far as nobody has been asked."""
        return ArmConfig(name=channel, channel=channel, interface=self.interface, can_options=self._can_options)

    def options(self, arm: "FoundArm") -> dict[str, Any]:
        """Options by which a rig's file says where an arm is."""
        where = {"interface": VIRTUAL, "can_options": self._can_options} if self.interface == VIRTUAL else {}
        return {"channel": arm.channel, **where}

    @property
    def _can_options(self) -> dict[str, str]:
        return {} if self.rig is None else {"rig": self.rig}


@dataclass(frozen=True)
class FoundArm:
    """One arm.

    Attributes:
        channel: CAN channel.
        role: FOLLOWER, LEADER or PASSIVE.
        arms, grippers: profiles that fit what answers, the likeliest first.
        mark: firmware of the handle, or type of the gripper's motor, for the drawing.
    """

    channel: str
    role: str
    arms: tuple[str, ...]
    grippers: tuple[str, ...]
    mark: str


@dataclass(frozen=True)
class FoundCamera:
    """One camera.

    Attributes:
        label: for the person who names it.
        options: LeRobot's config of it.
        name: a name that suits it, empty without one.
    """

    label: str
    options: dict[str, Any]
    name: str = ""


def find_arms(place: Place, channels: Sequence[str], tell: Callable[[str], None]) -> list[FoundArm]:
    """The arms on these channels; of a channel that has none, `tell` gets the reason.

    Raises:
        SetupError: none has.
    """
    found = []
    for channel in channels:
        try:
            arm = _find(place.config(channel))
        except ChannelInUseError as error:
            tell(f"{channel}: left out: {error} ({driver_of(Target(place.config(channel)))}). End that session first")
        except YamError as error:
            tell(f"{channel}: left out: {error}")
        else:
            if arm is None:
                tell(f"{channel}: nothing answers; check the arm's power, its emergency stop and the CAN cable")
            else:
                tell(f"{channel}: a {arm.role} ({arm.mark})")
                found.append(arm)
    if not found:
        raise SetupError("no arm was found; yam-doctor says what is wrong")
    return found


def find_cameras(place: Place) -> list[FoundCamera]:
    """Cameras of the virtual rig; else of the computer.

    Raises:
        RigError: the rig cannot be reached.
        CameraError: nothing tells a camera from another.
    """
    if place.rig is None:
        root = place.root or ROOT
        return [FoundCamera(str(one), config_of(one, root) | _PIXELS) for one in plugged_cameras(root)]
    with RigControl(place.rig, hold=False) as rig:
        names = rig.scene()["cameras"]
    size = {"width": 320, "height": 240, "fps": 30}
    return [FoundCamera(f"{name} of the rig", {"type": "yam_sim", "camera": name, **size}, name) for name in names]


def _find(config: ArmConfig) -> FoundArm | None:
    with own_bus(config) as bus:
        found = read_fingerprint(bus, config.channel, config.interface, _IDS)
        devices = HandleAccess(bus, config.channel).devices() if found.handle_firmware else []
    arms = tuple(name for name in ARMS if found.motors and _fits(name, found))
    if len(devices) > 1:
        return FoundArm(config.channel, PASSIVE, arms or ARMS, (LEADER_GRIPPER,), f"{len(devices)} encoders")
    if not arms:
        if found.motors:
            kinds = ", ".join(f"{can_id}: {motor.kind}" for can_id, motor in sorted(found.motors.items()))
            raise SetupError(f"motors answer that no arm has ({kinds}); yam-motors scan {config.on_command_line}")
        return None
    if found.handle_firmware is not None:
        version = ".".join(map(str, found.handle_firmware))
        return FoundArm(config.channel, LEADER, arms, (LEADER_GRIPPER,), f"handle {version}")
    motor = found.motors.get(gripper_id(load_arm(arms[0])))
    motors = {name: load_gripper(name).motor for name in GRIPPERS}
    fitting = tuple(name for name, row in motors.items() if motor and row and row.type == motor.kind)
    grippers = fitting or (likely_gripper(False, motor.gear_ratio if motor else None),)
    return FoundArm(config.channel, FOLLOWER, arms, grippers, f"gripper {motor.kind}" if motor else "no gripper motor")


def _fits(name: str, found: Fingerprint) -> bool:
    """Whether all of this arm's motors that answer are of its types; a missing one is the doctor's business."""
    there = [motor for motor in load_arm(name).motors if motor.can_id in found.motors]
    return bool(there) and all(motor.type == found.motors[motor.can_id].kind for motor in there)
