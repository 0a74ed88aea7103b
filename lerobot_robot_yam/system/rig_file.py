"""Rig file: one YAML file with the sections `robot` (followers and cameras) and `teleop` (leaders) of a run config.

Run configs of LeRobot refer to the file instead of repeating the arms: `robot: {type: yam_rig, file: rig.yaml}`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path
from lerobot_robot_yam.system.strict_yaml import merge, read_yaml

RIG_TYPE = "yam_rig"
ARMS_OF_TWO = ("left_arm_config", "right_arm_config")
BASE = "base_config"
_CAMERAS = "cameras"


def device_of(section: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a device in a run config; a device of type `yam_rig` is read from its rig file.

    Args:
        section: "robot" or "teleop".
        given: the device in the run config. A `yam_rig` has `file`; `options`, `id` and `calibration_dir`, which
            override those in the file; `arm_options`, which override those of each arm; `cameras`: False omits cameras.

    Raises:
        ConfigError: the file does not exist, cannot be read, or has no such device.
    """
    if given.get("type") != RIG_TYPE:
        return dict(given)
    if not given.get("file"):
        raise ConfigError(f"{section}: type {RIG_TYPE} needs `file`: the rig's file, which yam-setup writes")
    path = user_path(given["file"])
    if not path.exists():
        raise ConfigError(f"{section}: there is no {path}, the rig's file; yam-setup writes it ({Path.cwd()} is here)")
    held = read_yaml(path).get(section)
    if not isinstance(held, Mapping):
        raise ConfigError(f"{path} has no {section}: run yam-setup with {_MISSING.get(section, section)} plugged in")
    if held.get("type") == RIG_TYPE:
        raise ConfigError(f"{path}, {section}: a rig's file holds the arms themselves, not another {RIG_TYPE}")
    own = {key: given[key] for key in ("id", "calibration_dir") if given.get(key) is not None}
    of_arms = given.get("arm_options") or {}
    arms = [name for name in ARMS_OF_TWO if name in held]
    device = merge(held, {name: of_arms for name in arms} if arms else of_arms)
    device = merge(device, {**(given.get("options") or {}), **own})
    return device if given.get(_CAMERAS, True) else _without_cameras(device)


_MISSING = {"robot": "the followers", "teleop": "the leaders"}


def _without_cameras(device: Mapping[str, Any]) -> dict[str, Any]:
    kept = {key: value for key, value in device.items() if key != _CAMERAS}
    arms = {key: _without_cameras(kept[key]) for key in ARMS_OF_TWO if isinstance(kept.get(key), Mapping)}
    return {**kept, **arms}
