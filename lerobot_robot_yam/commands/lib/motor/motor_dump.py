"""The file that holds the registers of an arm's motors, for people to read and for `yam-motors restore`."""

import contextlib
import itertools
import os
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import yaml

from lerobot_robot_yam.damiao.motor_spec import MOTOR_IDS
from lerobot_robot_yam.damiao.registers import Register, encode_value
from lerobot_robot_yam.damiao.settings.motor_memory import Contents, changes
from lerobot_robot_yam.damiao.settings.register_ranges import register_named
from lerobot_robot_yam.errors import ConfigError, YamError
from lerobot_robot_yam.system.paths import write_whole
from lerobot_robot_yam.system.runtime_files import slug
from lerobot_robot_yam.system.strict_yaml import read_yaml

_VERSION = 1
_HEAD = "# Registers of Damiao motors, written by yam-motors. `yam-motors restore` writes them back.\n"


def shown(register: Register, value: float | int) -> float | int:
    """The shortest number that the register holds as the same four bytes."""
    return int(value) if register.kind == "uint32" else float(str(np.float32(value)))


def save_dump(path: Path, channel: str, motors: Mapping[int, Contents]) -> None:
    """Write the file; a crash in the middle leaves the old one. Raises ConfigError: it cannot be written."""
    document = {
        "version": _VERSION,
        "channel": channel,
        "motors": {
            can_id: {register.name: shown(register, value) for register, value in contents.items()}
            for can_id, contents in motors.items()
        },
    }
    try:
        write_whole(path, _HEAD + yaml.safe_dump(document, sort_keys=False))
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error}") from error


def load_dump(path: Path) -> dict[int, Contents]:
    """Registers by CAN id. Raises ConfigError: the file cannot be read, or says what no motor can hold."""
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


def differences(
    names: Mapping[int, str], stored: Mapping[int, Contents], held: Mapping[int, Contents]
) -> list[list[str]]:
    """Rows of a table: motor, register, value in the file, value in the motor."""
    return [
        [names.get(can_id, f"motor {can_id}"), register.name, str(shown(register, old)), _said(register, new)]
        for can_id, contents in stored.items()
        for register, (old, new) in changes(contents, held[can_id]).items()
    ]


def _said(register: Register, value: float | int | None) -> str:
    return "not told" if value is None else str(shown(register, value))


@contextlib.contextmanager
def kept_until_stored(channel: str, motors: Mapping[int, Contents]) -> Iterator[None]:
    """A file for each motor with its registers before they are changed, which stays if that fails half way.

    One that an earlier failure of the same motor has left is older, and is kept until it has gone well.

    Raises:
        YamError: what the block raised, with the files' paths; ConfigError: they cannot be written.
    """
    home = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "yam-motors"
    paths = {
        can_id: _kept_path(home / f"{slug(channel)}-{can_id}.yaml", can_id, held) for can_id, held in motors.items()
    }
    for can_id, path in paths.items():
        if not path.exists():
            save_dump(path, channel, {can_id: motors[can_id]})
    try:
        yield
    except YamError as error:
        where = ", ".join(map(str, paths.values()))
        raise type(error)(f"{error}. The registers as they were before are in {where} (yam-motors restore)") from error
    for path in paths.values():
        path.unlink(missing_ok=True)


def _kept_path(path: Path, can_id: int, held: Contents) -> Path:
    """The path, or one beside it where an earlier failure has left a file of another motor with this id there."""
    paths = itertools.chain([path], (path.with_stem(f"{path.stem}-no{number}") for number in itertools.count(2)))
    return next(
        free
        for free in paths
        if not free.exists() or all(register.writable for register in changes(load_dump(free)[can_id], held))
    )
