"""Reader of rig files for yam-host, based on LeRobot's parser.

`python -m lerobot_robot_yam.commands.servers.rig_reader RIG` prints one JSON line: the groups of arms, or an error.
"""

import dataclasses
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lerobot.robots.config import RobotConfig
from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.doctor.kit.targets import calibration_root
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.lerobot_command.config_refusal import arm_config, rig_device
from lerobot_robot_yam.system.strict_yaml import read_yaml
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig

# Section of the file -> base class of its configs, LeRobot's folder of calibration files, role of its arms.
_SECTIONS: dict[str, tuple[Any, str, str]] = {
    "robot": (RobotConfig, "robots", "follower"),
    "teleop": (TeleoperatorConfig, "teleoperators", "leader"),
}


def groups_in(path: Path) -> list[dict[str, Any]]:
    """Return for each group: role, device, arms (prefix -> config) and options (prefix -> LeRobot's options).

    Raises:
        ConfigError: the file has no arms, or no session would start with one of its arms.
    """
    document, groups = read_yaml(path), []
    for section, (registry, folder, role) in _SECTIONS.items():
        if not isinstance(document.get(section), Mapping):
            continue
        device = rig_device(registry, section, {"file": str(path), "cameras": False})
        if not hasattr(device, "arms") or "passive" in device.type or "hand" in device.type:
            raise ConfigError(f"{path}, {section}: yam-host serves followers and leaders, no {device.type}")
        kind = device.type.replace("i2rt_", "")
        directory = Path(device.calibration_dir or calibration_root() / folder / kind) / "yam"
        arms, options = {}, {}
        for prefix, arm in device.arms().items():
            config = arm_config(arm, f"{prefix}{role}")
            ident = f"{prefix}{device.id}" if device.id else arm.channel
            config.calibration_path = config.calibration_path or str(directory / f"{ident}_gripper.json")
            arms[prefix], options[prefix] = dataclasses.asdict(config), {**_options(arm), "name": config.name}
        groups.append({"role": section, "device": kind, "arms": arms, "options": options})
    if not groups:
        raise ConfigError(f"{path} has no arms, neither robot nor teleop; yam-setup writes such a file")
    return groups


def _options(arm: Any) -> dict[str, Any]:
    """Return the options of an arm's LeRobot device, without the options that LeRobot itself defines."""
    kind: Any = LeaderArmConfig if isinstance(arm, LeaderArmConfig) else ArmConfig
    plain = {field.name: getattr(arm, field.name) for field in dataclasses.fields(kind)}
    return {
        name: dataclasses.asdict(value) if dataclasses.is_dataclass(value) and not isinstance(value, type) else value
        for name, value in plain.items()
    }


def main() -> None:
    """Print the groups of the file in argv, or the error, as one JSON line."""
    try:
        told: dict[str, Any] = {"groups": groups_in(Path(sys.argv[1]))}
    except ConfigError as error:
        told = {"error": str(error)}
    sys.stdout.write(json.dumps(told) + "\n")


if __name__ == "__main__":
    main()
