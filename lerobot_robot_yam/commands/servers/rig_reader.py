"""Reader of rig files for yam-host and yam-doctor.

It decodes them as LeRobot's parser does, but loads no LeRobot and no torch.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import draccus
from draccus.utils import DraccusException

from lerobot_robot_yam.arm.config import ArmConfig, check_together
from lerobot_robot_yam.arm.config_checks import check_switches
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.doctor.kit.targets import calibration_root
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.lerobot_command import config_refusal
from lerobot_robot_yam.face.lerobot_command.config_refusal import arm_config
from lerobot_robot_yam.mobile.base_config import BASE_PREFIX, BaseConfig, with_rail_file
from lerobot_robot_yam.robot_options import BaseOptions, FollowerOptions, MobileOptions, RobotOptions
from lerobot_robot_yam.system.paths import user_path
from lerobot_robot_yam.system.rig_file import ARMS_OF_TWO, BASE, RIG_TYPE, device_of
from lerobot_robot_yam.system.strict_yaml import read_yaml
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig, LeaderOptions, check_leaders


class Device(NamedTuple):
    """Robot or teleoperator in a rig's file.

    Attributes:
        role: "robot" or "teleop".
        type: LeRobot's type name.
        configs: prefix -> config of an arm or of the base.
        options: prefix -> options of that arm or base, from which LeRobot's device is built.
    """

    role: str
    type: str
    configs: dict[str, ArmConfig | BaseConfig]
    options: dict[str, dict[str, Any]]


@dataclass(kw_only=True)
class _DeviceOptions:
    """Options that LeRobot itself has for each device."""

    id: str | None = None
    calibration_dir: Path | None = None


@dataclass(kw_only=True)
class _FollowerArm(ArmConfig):
    """One follower arm."""

    def __post_init__(self) -> None:
        """Postpone the checks until the arm's side is known."""


@dataclass(kw_only=True)
class _BaseRobotOptions(RobotOptions, BaseOptions):
    """Options of `yam_base`."""


_TWO_FOLLOWERS: dict[str, Any] = {"left_": _FollowerArm, "right_": _FollowerArm}
_ROBOTS: dict[str, Any] = {
    "yam_follower": (FollowerOptions, {"": _FollowerArm}),
    "bi_yam_follower": (FollowerOptions, _TWO_FOLLOWERS),
    "yam_base": (_BaseRobotOptions, {BASE_PREFIX: BaseConfig}),
    "yam_mobile": (MobileOptions, {**_TWO_FOLLOWERS, BASE_PREFIX: BaseConfig}),
}
_TELEOPERATORS: dict[str, Any] = {
    "yam_leader": (LeaderOptions, {"": LeaderArmConfig}),
    "bi_yam_leader": (LeaderOptions, {"left_": LeaderArmConfig, "right_": LeaderArmConfig}),
}
# Section of the file -> LeRobot's folder of calibration files, role of the section's arms,
# LeRobot's type -> (options of the device as a whole, prefix -> options of its arms and base).
_SECTIONS = {"robot": ("robots", "follower", _ROBOTS), "teleop": ("teleoperators", "leader", _TELEOPERATORS)}


def read_rig(path: Path) -> list[Device]:
    """Return the robot and the teleoperator of a rig's file.

    Raises:
        ConfigError: the file does not exist or has no arms, or no session would start with them.
    """
    path = user_path(path)
    if not path.is_file():
        raise ConfigError(f"there is no {path}, the rig's file; yam-setup writes it")
    document = read_yaml(path)
    devices = [_device(path, section) for section in _SECTIONS if isinstance(document.get(section), Mapping)]
    if not devices:
        raise ConfigError(f"{path} has no arms, neither robot nor teleop; yam-setup writes such a file")
    return devices


def _device(path: Path, section: str) -> Device:
    given = device_of(section, {"type": RIG_TYPE, "file": str(path), "cameras": False})
    folder, role, types = _SECTIONS[section]
    kind = str(given.pop("type", "")).replace("i2rt_", "")
    if kind not in types:
        raise ConfigError(f"{path}, {section}: yam-host serves {', '.join(types)}, no {kind or 'device without type'}")
    whole, kinds = types[kind]
    try:
        device = draccus.decode(_class_of(kind, whole, kinds), given)
        parts: dict[str, Any] = {prefix: _part(device, prefix) for prefix in kinds}
        check_switches(kind, device)
        configs = {prefix: _config(part, f"{prefix}{role}") for prefix, part in parts.items()}
        check_together(list(configs.values()))
        resolved = {prefix: ResolvedArm(row) for prefix, row in configs.items() if isinstance(row, ArmConfig)}
        if role == "leader":
            check_leaders(kind, device, resolved)
    except (ConfigError, DraccusException) as error:
        raise ConfigError(f"{path}, {section}: {error}") from error
    calibration_dir = Path(device.calibration_dir or calibration_root() / folder / kind)
    for prefix, arm in resolved.items():
        ident = f"{prefix}{device.id}" if device.id else arm.config.channel
        arm.config.calibration_path = arm.config.calibration_path or str(
            calibration_dir / "yam" / f"{ident}_gripper.json"
        )
    for prefix, base in configs.items():
        if isinstance(base, BaseConfig):
            configs[prefix] = with_rail_file(base, calibration_dir, device.id)
    options = {prefix: {**_options(part), "name": configs[prefix].name} for prefix, part in parts.items()}
    return Device(section, kind, configs, options)


def check_options(section: str, device: Mapping[str, Any], where: str) -> None:
    """Check option names as `config_refusal.check_options` does; without LeRobot for the types of this module."""
    _, _, types = _SECTIONS[section]
    kind = str(device["type"]).replace("i2rt_", "")
    known = _class_of(kind, *types[kind]) if kind in types else None
    if known is not None and section == "robot":  # cameras, which LeRobot's classes declare
        places = [name for name in (*ARMS_OF_TWO, BASE) if isinstance(device.get(name), Mapping)]
        device = {name: value for name, value in device.items() if name != "cameras"}
        device |= {name: {key: v for key, v in device[name].items() if key != "cameras"} for name in places}
    config_refusal.check_options(section, device, where, known)


def _class_of(kind: str, whole: Any, parts: Mapping[str, Any]) -> Any:
    """Make the dataclass with the options of a device that LeRobot's class of this type has, without cameras."""
    methods = {"__post_init__": lambda self: None, "arms": lambda self: {p: _part(self, p) for p in parts}}
    more: dict[str, Any] = {"namespace": methods, "kw_only": True}
    if len(parts) == 1:
        return dataclasses.make_dataclass(kind, (), bases=(_DeviceOptions, whole, *parts.values()), **more)
    fields = [(_field(prefix), part) for prefix, part in parts.items()]
    return dataclasses.make_dataclass(kind, fields, bases=(_DeviceOptions, whole), **more)


def _field(prefix: str) -> str:
    return "base_config" if prefix == BASE_PREFIX else f"{prefix}arm_config"


def _part(device: Any, prefix: str) -> Any:
    """Return the options of an arm or of the base."""
    return getattr(device, _field(prefix), device)


def _config(part: ArmConfig | BaseConfig, name: str) -> ArmConfig | BaseConfig:
    return part.checked() if isinstance(part, BaseConfig) else arm_config(part, name)


def _options(part: Any) -> dict[str, Any]:
    """Return the options of an arm or base as plain values, without those of the device as a whole."""
    kind: Any = next(kind for kind in (LeaderArmConfig, ArmConfig, BaseConfig) if isinstance(part, kind))
    names = {field.name for field in dataclasses.fields(kind)}
    return {name: value for name, value in dataclasses.asdict(part).items() if name in names}
