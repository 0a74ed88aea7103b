"""The arms that the doctor looks at: named on the command line, read from a LeRobot run config, or all of them."""

import dataclasses
import difflib
import json
import os
import shlex
from collections.abc import Mapping, Set
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from lerobot_robot_yam.arm.config import SOCKETCAN, VIRTUAL, ArmConfig, check_together
from lerobot_robot_yam.arm.leaders.lead_config import LeadConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.state.records import channel_key
from lerobot_robot_yam.system.paths import user_path
from lerobot_robot_yam.system.rig_file import ARMS_OF_TWO, device_of
from lerobot_robot_yam.system.runtime_files import rig_name
from lerobot_robot_yam.system.strict_yaml import read_yaml

LEADER_GRIPPER = "yam_teaching_handle"
_FIELDS = frozenset(field.name for field in dataclasses.fields(ArmConfig))
_CALIBRATED = ("channel", "interface", "can_options", "arm", "gripper", "calibration_path", "identity_path")
# What LeRobot's configs add to it, per device and per arm of two.
_OF_ALL = {"type", "id", "calibration_dir", "isolation", "use_degrees", "action_space"}
DEVICE_OPTIONS = {
    "robot": _OF_ALL | {"cameras", "observe_velocity", "observe_torque", "observe_temperature"},
    "teleop": _OF_ALL | {"buttons", "auto_episodes", "step_m"},
}
# Of a leader with a follower; the rest of `LeadConfig` is no option.
_LEADS = {field.name for field in dataclasses.fields(LeadConfig)} - {"together", "approach_s", "idle_speed_rad_s"}
ARM_OPTIONS = {"robot": {"cameras"}, "teleop": {"ee_gripper", "follower_arm", "gate_together"} | _LEADS}
_REAL_CAMERAS = ("opencv", "intelrealsense", "yam_realsense")
_DEVICES = {
    "robot": ("robots", ("yam_follower", "bi_yam_follower", "i2rt_yam_follower", "bi_i2rt_yam_follower")),
    "teleop": ("teleoperators", ("yam_leader", "bi_yam_leader", "i2rt_yam_leader", "bi_i2rt_yam_leader")),
}


@dataclass(frozen=True)
class Target:
    """One arm to look at.

    Attributes:
        config: the arm.
        declared: whether its arm and gripper were named; else the doctor goes by what answers.
        calibration: file in which LeRobot's device keeps the gripper's stops, None when that is unknown.
        calibrate: the command that finds the stops of the grippers of its device, when it is known.
    """

    config: ArmConfig
    declared: bool = True
    calibration: Path | None = None
    calibrate: str = ""

    @property
    def channel(self) -> str:
        """The CAN channel."""
        return self.config.channel

    @property
    def real(self) -> bool:
        """Whether the channel is a CAN interface of this computer."""
        return self.config.interface == SOCKETCAN

    @property
    def key(self) -> str:
        """Name of the channel's lock and blocks."""
        rig = self.config.can_options.get("rig") if self.config.interface == VIRTUAL else None
        return channel_key(self.config.interface, self.channel, rig)

    @cached_property
    def hardware(self) -> ResolvedArm:
        """Motors and limits as the profiles say.

        Raises:
            ConfigError: unknown arm or gripper.
        """
        return ResolvedArm(self.config)


@dataclass(frozen=True)
class Plan:
    """The arms to look at, and LeRobot's camera configs by name."""

    targets: tuple[Target, ...] = ()
    cameras: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def real(self) -> bool:
        """Whether this computer's own interfaces and cameras matter."""
        return not self.targets or any(target.real for target in self.targets)

    @property
    def real_cameras(self) -> bool:
        """Whether some cameras are this computer's own, whatever the arms are."""
        return any(camera.get("type") in _REAL_CAMERAS for camera in self.cameras.values())


def from_option(text: str, interface: str, rig: str | None) -> Target:
    """The arm that `NAME[:ARM[:GRIPPER]]` names.

    Raises:
        ConfigError: it names none, or an unknown arm or gripper.
    """
    channel, *profiles = text.split(":")
    if not channel or len(profiles) > 2:
        raise ConfigError(f"channel {text!r}: write NAME, NAME:ARM or NAME:ARM:GRIPPER")
    values = {key: value for key, value in zip(("arm", "gripper"), profiles, strict=False) if value}
    return _target({"channel": channel, "interface": interface, **values}, channel, rig)


def undeclared(channel: str) -> Target:
    """A CAN interface whose arm was not named."""
    return Target(ArmConfig(channel=channel, name=channel), declared=False)


def from_config(path: Path, rig: str | None) -> Plan:
    """Arms and cameras of a LeRobot run config with our robots or teleoperators.

    Raises:
        ConfigError: unreadable, it has none of ours, or what no session would start with.
    """
    document = read_yaml(path)
    targets: list[Target] = []
    cameras: dict[str, Mapping[str, Any]] = {}
    environment = document.get("env")  # of an evaluation
    for section, (folder, types) in _DEVICES.items():
        device = document.get(section) or (environment.get(section) if isinstance(environment, Mapping) else None)
        if isinstance(device, Mapping):
            device = device_of(section, device)
        if not isinstance(device, Mapping) or device.get("type") not in types:
            continue
        cameras.update(_cameras(device))
        directory = Path(
            device.get("calibration_dir") or calibration_root() / folder / device["type"].replace("i2rt_", "")
        )
        arms = _arms(device, f"{path}, {section}")
        _check_options(section, device, arms, f"{path}, {section}")
        calibrate = _calibrate(section, device, arms)
        first = len(targets)
        for prefix, arm in arms.items():
            values = {"gripper": LEADER_GRIPPER, **arm} if section == "teleop" else dict(arm)
            ident = f"{prefix}{device['id']}" if device.get("id") else values.get("channel")
            target = _target(values, f"{prefix}{section}", rig)
            file = Path(target.config.calibration_path or directory / "yam" / f"{ident}_gripper.json")
            targets.append(dataclasses.replace(target, calibration=file, calibrate=calibrate))
            cameras.update({f"{prefix}{name}": camera for name, camera in _cameras(arm).items() if prefix})
        check_together([target.config for target in targets[first:]])
    if not targets:
        known = ", ".join(name for _, types in _DEVICES.values() for name in types)
        raise ConfigError(f"{path} has no robot or teleoperator of type {known}")
    return Plan(tuple(targets), cameras)


def calibration_root() -> Path:
    """Directory of LeRobot's calibration files, by the rules of lerobot.utils.constants and huggingface_hub."""
    cache = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    hub = os.environ.get("HF_HOME") or f"{cache}/huggingface"
    home = os.environ.get("HF_LEROBOT_HOME") or f"{hub}/lerobot"
    return user_path(os.environ.get("HF_LEROBOT_CALIBRATION") or f"{home}/calibration")


def _arms(device: Mapping[str, Any], where: str) -> dict[str, Mapping[str, Any]]:
    """Options of each arm by prefix."""
    if not str(device["type"]).startswith("bi_"):
        return {"": device}
    arms: dict[str, Mapping[str, Any]] = {}
    for prefix in ("left_", "right_"):
        if not isinstance(arm := device.get(f"{prefix}arm_config"), Mapping):
            raise ConfigError(f"{where}: {prefix}arm_config is missing")
        arms[prefix] = arm
    return arms


def _check_options(section: str, device: Mapping[str, Any], arms: Mapping[str, Mapping[str, Any]], where: str) -> None:
    """Refuse options that LeRobot would not know."""
    of_arm: Set[str] = _FIELDS | ARM_OPTIONS[section]
    of_device: Set[str] = DEVICE_OPTIONS[section] | (of_arm if "" in arms else set(ARMS_OF_TWO))
    places: list[tuple[str, Mapping[str, Any], Set[str]]] = [(where, device, of_device)]
    places += [(f"{where}, {prefix}arm_config", arm, of_arm) for prefix, arm in arms.items() if prefix]
    for place, options, known in places:
        for name in map(str, options):
            if name not in known:
                near = difflib.get_close_matches(name, known, 1)
                raise ConfigError(f"{place}: there is no option {name!r}" + (f"; {near[0]!r}?" if near else ""))


def _calibrate(section: str, device: Mapping[str, Any], arms: Mapping[str, Mapping[str, Any]]) -> str:
    """LeRobot's command for this very device: its files are found by type and id."""
    given = {name: device[name] for name in ("type", "id", "calibration_dir") if device.get(name) is not None}
    for prefix, arm in arms.items():
        place = f"{prefix}arm_config." if prefix else ""
        given |= {f"{place}{name}": arm[name] for name in _CALIBRATED if arm.get(name) is not None}
    values = {name: value if isinstance(value, str) else json.dumps(value) for name, value in given.items()}
    options = [shlex.quote(f"--{section}.{name}={value}") for name, value in values.items()]
    return " ".join(["lerobot-calibrate", *options])


def _cameras(options: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    cameras = options.get("cameras")
    if not isinstance(cameras, Mapping):
        return {}
    return {str(name): camera for name, camera in cameras.items() if isinstance(camera, Mapping)}


def _target(values: Mapping[str, Any], name: str, rig: str | None) -> Target:
    known = {key: value for key, value in values.items() if key in _FIELDS}
    options = dict(known.pop("can_options", None) or {})
    if known.get("interface") == VIRTUAL:
        options.pop("operator", None)  # no leader may move while the doctor looks
        options["rig"], _ = rig_name(rig or options.get("rig"))
    try:
        target = Target(ArmConfig(**{"name": name, **known, "can_options": options}))
        _ = target.hardware  # profiles that there are
    except TypeError as error:  # no channel
        raise ConfigError(f"{name}: {error}") from error
    return target
