"""Arms and bases that the doctor examines: named on the command line, read from a LeRobot run config, or all arms."""

import dataclasses
import json
import os
import shlex
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from lerobot_robot_yam.arm.config import SOCKETCAN, VIRTUAL, ArmConfig, LeadArmConfig, check_together
from lerobot_robot_yam.arm.leaders.passive_config import JOINT_SIGNS, PassiveConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_config import BASE, BaseConfig, with_rail_file
from lerobot_robot_yam.mobile.resolved_base import ResolvedBase
from lerobot_robot_yam.state.records import channel_key
from lerobot_robot_yam.system.paths import user_path
from lerobot_robot_yam.system.rig_file import device_of
from lerobot_robot_yam.system.runtime_files import rig_name
from lerobot_robot_yam.system.strict_yaml import read_yaml

LEADER_GRIPPER = "yam_teaching_handle"
# Options of an arm that `lerobot-calibrate` needs.
_CALIBRATED = ("channel", "interface", "can_options", "arm", "gripper", "calibration_path", "identity_path")
_CALIBRATED_PASSIVE = ("kind", "joint_sign", "home_rad", "passive_calibration_path")
# Options that a hand guide shares with its follower, and their defaults.
_OF_GUIDES = {"arm": "yam", "gripper": "linear_4310", "action_space": "joint"}
_REAL_CAMERAS = ("opencv", "intelrealsense", "yam_realsense")
_PASSIVE, _GUIDE = "yam_passive_leader", "yam_hand_guide"
_BASE, _MOBILE, _MOBILE_LEADER = "yam_base", "yam_mobile", "yam_mobile_leader"
# Section of a run config -> LeRobot's folder of calibration files, and our device types with one arm or a base.
_DEVICES = {
    "robot": ("robots", ("yam_follower", _BASE, _MOBILE)),
    "teleop": ("teleoperators", ("yam_leader", _PASSIVE, _GUIDE, _MOBILE_LEADER)),
}
_ARM_FIELDS = frozenset(field.name for field in dataclasses.fields(ArmConfig))
_BASE_FIELDS = frozenset(field.name for field in dataclasses.fields(BaseConfig))


class _OnChannel:
    """Part on a channel of its own. noun: what messages call it."""

    config: ArmConfig | BaseConfig
    noun: ClassVar[str]

    @property
    def channel(self) -> str:
        return self.config.channel

    @property
    def real(self) -> bool:
        """Whether the channel is a CAN interface of this computer."""
        return self.config.interface == SOCKETCAN

    @property
    def key(self) -> str:
        """Channel key in the file names of the channel's lock and shared blocks."""
        rig = self.config.can_options.get("rig") if self.config.interface == VIRTUAL else None
        return channel_key(self.config.interface, self.channel, rig)


@dataclass(frozen=True)
class BaseTarget(_OnChannel):
    """Mobile base to examine. declared: true, since nothing about a base is inferred."""

    config: BaseConfig
    declared: ClassVar[bool] = True
    noun: ClassVar[str] = "base"

    @cached_property
    def hardware(self) -> ResolvedBase:
        """Motors and limits."""
        return ResolvedBase(self.config)


@dataclass(frozen=True)
class Target(_OnChannel):
    """Arm to examine.

    Attributes:
        config: config of the arm.
        declared: whether arm and gripper were named; if not, the doctor infers both from the motors' replies.
        calibration: file in which LeRobot's device stores the gripper's stops; None: unknown.
        calibrate: command that finds the stops of the device's grippers; empty: unknown.
    """

    config: ArmConfig
    declared: bool = True
    calibration: Path | None = None
    calibrate: str = ""
    noun: ClassVar[str] = "arm"

    @cached_property
    def hardware(self) -> ResolvedArm:
        """Motors and limits from the profiles. Raises ConfigError: unknown arm or gripper."""
        return ResolvedArm(self.config)

    @property
    def driven(self) -> ArmConfig:
        """Config with the file of gripper stops that LeRobot's device uses."""
        if self.calibration is None:
            return self.config
        return dataclasses.replace(self.config, calibration_path=str(self.calibration))


Examined = Target | BaseTarget


@dataclass(frozen=True)
class Plan:
    """Arms and bases to examine, and LeRobot's camera configs by name."""

    targets: tuple[Examined, ...] = ()
    cameras: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def arms(self) -> tuple[Target, ...]:
        """The arms among the targets."""
        return tuple(target for target in self.targets if isinstance(target, Target))

    @property
    def followers(self) -> tuple[Target, ...]:
        """Arms without a teaching handle."""
        return tuple(target for target in self.arms if target.config.gripper != LEADER_GRIPPER)

    @property
    def real(self) -> bool:
        """Whether this computer's own interfaces and cameras have to be checked."""
        return not self.targets or any(target.real for target in self.targets)

    @property
    def real_cameras(self) -> bool:
        """Whether any of the cameras belongs to this computer, regardless of the arms."""
        return any(camera.get("type") in _REAL_CAMERAS for camera in self.cameras.values())


def from_option(text: str, interface: str, rig: str | None) -> Examined:
    """Parse `NAME[:ARM[:GRIPPER]]` or `NAME:base`. Raises ConfigError: malformed, or an unknown arm or gripper."""
    channel, *profiles = text.split(":")
    if not channel or len(profiles) > 2:
        raise ConfigError(f"channel {text!r}: write NAME, NAME:ARM, NAME:ARM:GRIPPER or NAME:{BASE}")
    if profiles == [BASE]:
        return _base_target({"channel": channel, "interface": interface}, channel, rig)
    values = {key: value for key, value in zip(("arm", "gripper"), profiles, strict=False) if value}
    return _target({"channel": channel, "interface": interface, **values}, channel, rig)


def from_config(
    path: Path, rig: str | None, check: Callable[[str, Mapping[str, Any], str], None] = lambda *_: None
) -> Plan:
    """Read arms and cameras from a LeRobot run config with our robots or teleoperators.

    Args:
        path: file of the run config.
        rig: name of the virtual rig; None: the config names the rig, if any.
        check: called for each of our devices with the config's section, the options, and the location for messages.

    Raises:
        ConfigError: the file is unreadable, has none of our devices, or has options with which no session would start.
    """
    document = read_yaml(path)
    targets: list[Examined] = []
    cameras: dict[str, Mapping[str, Any]] = {}
    environment = document.get("env")  # environment of an evaluation
    robot: Mapping[str, Any] = {}
    for section, (folder, kinds) in _DEVICES.items():
        device = document.get(section) or (environment.get(section) if isinstance(environment, Mapping) else None)
        if isinstance(device, Mapping):
            device = device_of(section, device)
        if not isinstance(device, Mapping) or (kind := _of_one_arm(device)) not in kinds:
            continue
        where = f"{path}, {section}"
        arms = {} if kind == _GUIDE else _arms(device, where)
        check(section, device, where)
        cameras.update(_cameras(device))
        if section == "robot":
            robot = device
        elif kind == _GUIDE:
            _check_guide(device, robot, where)
        directory = Path(
            device.get("calibration_dir") or calibration_root() / folder / device["type"].replace("i2rt_", "")
        )
        calibrate = _calibrate(section, device, arms)
        first = len(targets)
        for prefix, arm in arms.items():
            ident = f"{prefix}{device['id']}" if device.get("id") else arm.get("channel")
            if kind == _PASSIVE:
                target = _passive_target(arm, f"{prefix}{section}", rig, directory / "yam" / f"{ident}_passive.json")
            else:
                values = {"gripper": LEADER_GRIPPER, **arm} if section == "teleop" else dict(arm)
                target = _target(values, f"{prefix}{section}", rig)
                file = Path(target.config.calibration_path or directory / "yam" / f"{ident}_gripper.json")
                target = dataclasses.replace(target, calibration=file)
            targets.append(dataclasses.replace(target, calibrate=calibrate))
            cameras.update({f"{prefix}{name}": camera for name, camera in _cameras(arm).items() if prefix})
        if (base := _base(device)) is not None:
            plain = _base_target(base, BASE, rig)
            ident = str(device["id"]) if device.get("id") else None
            targets.append(BaseTarget(with_rail_file(plain.config, directory, ident)))
        if arms or base:  # a hand guide has none
            check_together([target.config for target in targets[first:]])
    if not targets:
        ours = ", ".join(kind for _, kinds in _DEVICES.values() for kind in kinds)
        raise ConfigError(f"{path} has no robot or teleoperator of type {ours}, or of one with two arms")
    return Plan(tuple(targets), cameras)


def calibration_root() -> Path:
    """Return LeRobot's directory of calibration files, by the rules of lerobot.utils.constants and huggingface_hub."""
    cache = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    hub = os.environ.get("HF_HOME") or f"{cache}/huggingface"
    home = os.environ.get("HF_LEROBOT_HOME") or f"{hub}/lerobot"
    return user_path(os.environ.get("HF_LEROBOT_CALIBRATION") or f"{home}/calibration")


def _of_one_arm(device: Mapping[str, Any]) -> str:
    """Return the single-arm device type, such as "yam_leader" for "bi_i2rt_yam_leader"."""
    return str(device.get("type")).removeprefix("bi_").replace("i2rt_", "")


def _arms(device: Mapping[str, Any], where: str) -> dict[str, Mapping[str, Any]]:
    """Return prefix -> options of each arm."""
    if device["type"] == _BASE or (device["type"] == _MOBILE_LEADER and "left_arm_config" not in device):
        return {}
    if not str(device["type"]).startswith("bi_") and device["type"] not in (_MOBILE, _MOBILE_LEADER):
        return {"": device}
    arms: dict[str, Mapping[str, Any]] = {}
    for prefix in ("left_", "right_"):
        if not isinstance(arm := device.get(f"{prefix}arm_config"), Mapping):
            raise ConfigError(f"{where}: {prefix}arm_config is missing")
        arms[prefix] = arm
    return arms


def _base(device: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the options of a robot's base, if it has one."""
    base = device if device["type"] == _BASE else device.get("base_config")
    return base if isinstance(base, Mapping) else None


def _check_guide(guide: Mapping[str, Any], robot: Mapping[str, Any], where: str) -> None:
    """Check that a hand guide's options match the config's follower; otherwise the guide fails at its first action."""
    if not robot or str(guide["type"]).startswith("bi_") != str(robot["type"]).startswith("bi_"):
        raise ConfigError(
            f"{where}: a hand guides a yam_follower, two hands guide a bi_yam_follower: name that as robot"
        )
    for arm in _arms(robot, where).values():
        for name, usual in _OF_GUIDES.items():
            own = guide.get(name, usual)
            follower = (robot if name == "action_space" else arm).get(name, usual)
            if own != follower:
                raise ConfigError(f"{where}: {name} is {own}, the follower's is {follower}: give both the same")


def _calibrate(section: str, device: Mapping[str, Any], arms: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the lerobot-calibrate command for this device, whose calibration files are found by type and id."""
    given = {name: device[name] for name in ("type", "id", "calibration_dir") if device.get(name) is not None}
    names = (*_CALIBRATED, *_CALIBRATED_PASSIVE) if _of_one_arm(device) == _PASSIVE else _CALIBRATED
    for prefix, arm in arms.items():
        place = f"{prefix}arm_config." if prefix else ""
        given |= {f"{place}{name}": arm[name] for name in names if arm.get(name) is not None}
    values = {name: value if isinstance(value, str) else json.dumps(value) for name, value in given.items()}
    options = [shlex.quote(f"--{section}.{name}={value}") for name, value in values.items()]
    return " ".join(["lerobot-calibrate", *options])


def _cameras(options: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    cameras = options.get("cameras")
    if not isinstance(cameras, Mapping):
        return {}
    return {str(name): camera for name, camera in cameras.items() if isinstance(camera, Mapping)}


def _passive_target(arm: Mapping[str, Any], name: str, rig: str | None, calibration: Path) -> Target:
    """Return the target of a leader without motors. `calibration`: default file of the leader's zeros."""
    target = _target({**arm, "gripper": LEADER_GRIPPER}, name, rig)
    kind = arm.get("kind", "desk")
    if kind not in JOINT_SIGNS:
        raise ConfigError(f"{target.config.name}: kind takes one of {', '.join(JOINT_SIGNS)}; got {kind!r}")
    passive = PassiveConfig(
        joint_sign=arm.get("joint_sign") or JOINT_SIGNS[kind],
        mapping=arm.get("mapping", "direct"),
        leader_range_rad=arm.get("leader_range_rad"),
        calibration_path=arm.get("passive_calibration_path") or str(calibration),
        home_rad=arm.get("home_rad"),
    )
    passive.check(target.config.name, target.hardware.joints)
    values = {field.name: getattr(target.config, field.name) for field in dataclasses.fields(ArmConfig)}
    return dataclasses.replace(target, config=LeadArmConfig(**values, passive=passive))


def _target(values: Mapping[str, Any], name: str, rig: str | None) -> Target:
    try:
        target = Target(ArmConfig(**_known(values, _ARM_FIELDS, name, rig)))
        _ = target.hardware  # raises for unknown profiles
    except TypeError as error:  # the channel is missing
        raise ConfigError(f"{name}: {error}") from error
    return target


def _base_target(values: Mapping[str, Any], name: str, rig: str | None) -> BaseTarget:
    try:
        return BaseTarget(BaseConfig(**_known(values, _BASE_FIELDS, name, rig)))
    except TypeError as error:
        raise ConfigError(f"{name}: {error}") from error


def _known(values: Mapping[str, Any], fields: Collection[str], name: str, rig: str | None) -> dict[str, Any]:
    """Return the values of these fields, with the name of the virtual rig."""
    known = {key: value for key, value in values.items() if key in fields}
    options = dict(known.pop("can_options", None) or {})
    if known.get("interface") == VIRTUAL:
        options.pop("operator", None)  # without the scripted operator, so that no leader moves during the check
        options["rig"], _ = rig_name(rig or options.get("rig"))
    return {"name": name, **known, "can_options": options}
