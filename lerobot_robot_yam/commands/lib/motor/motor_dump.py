"""Dump file of the registers of an arm's motors, for people to read and for `yam-motors restore`."""

import contextlib
import os
from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path

import numpy as np
import yaml

from lerobot_robot_yam.damiao.motor_spec import MOTOR_IDS
from lerobot_robot_yam.damiao.registers import Register, encode_value
from lerobot_robot_yam.damiao.settings.motor_memory import Contents
from lerobot_robot_yam.damiao.settings.register_ranges import register_named
from lerobot_robot_yam.errors import ConfigError, YamError
from lerobot_robot_yam.system.paths import write_whole
from lerobot_robot_yam.system.runtime_files import slug
from lerobot_robot_yam.system.strict_yaml import read_yaml

_VERSION = 1
_HEAD = "# Registers of Damiao motors, written by yam-motors. `yam-motors restore` writes them back.\n"


def shown(register: Register, value: float | int | None) -> float | int | str:
    """Return the shortest number with the same four bytes as the register; a text if the value is unknown."""
    if value is None:
        return "not told"
    return int(value) if register.kind == "uint32" else float(str(np.float32(value)))


def save_dump(path: Path, channel: str, motors: Mapping[int, Contents]) -> None:
    """Write a dump atomically. Raises ConfigError: the file cannot be written."""
    registers = {can_id: {r.name: shown(r, value) for r, value in held.items()} for can_id, held in motors.items()}
    document = {"version": _VERSION, "channel": channel, "motors": registers}
    try:
        write_whole(path, _HEAD + yaml.safe_dump(document, sort_keys=False))
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error}") from error


def load_dump(path: Path) -> dict[int, Contents]:
    """Read a dump; return CAN id -> registers. Raises ConfigError: unreadable, or a value that no motor can hold."""
    document = read_yaml(path)
    version, motors = document.get("version"), document.get("motors")
    if version != _VERSION or not isinstance(motors, dict) or not motors:
        raise ConfigError(f"{path} is no dump of motors of version {_VERSION}; make one with yam-motors dump")
    found: dict[int, Contents] = {}
    for can_id, registers in motors.items():
        if can_id not in MOTOR_IDS or not isinstance(registers, dict):
            raise ConfigError(f"{path}: motors.{can_id}: expected a CAN id from 1 to 15 with registers by name")
        found[can_id] = {}
        for name, value in registers.items():
            register = register_named(str(name))
            if type(value) not in (int, float):
                raise ConfigError(f"{path}: motors.{can_id}.{name}: expected a number, found {value!r}")
            encode_value(register, value)
            found[can_id][register] = value
        if found[can_id].get(Register.ESC_ID, can_id) != can_id:
            raise ConfigError(f"{path}: motors.{can_id}.ESC_ID: it is not {can_id}; change ids with yam-motors set-id")
    return found


@contextlib.contextmanager
def kept_until_stored(channel: str, motors: Mapping[int, Contents]) -> Iterator[None]:
    """Save a dump before the block changes the motors' registers; delete the dump if the block succeeds.

    Raises:
        YamError: the block failed; the message ends with the path of the dump.
        ConfigError: the dump cannot be written.
    """
    home = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "yam-motors"
    path = home / f"{slug(channel)}-{datetime.now():%Y%m%d-%H%M%S-%f}.yaml"
    save_dump(path, channel, motors)
    try:
        yield
    except YamError as error:
        raise type(error)(f"{error}. The registers as they were before are in {path} (yam-motors restore)") from error
    path.unlink(missing_ok=True)
