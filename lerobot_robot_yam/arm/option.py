"""Fields of configs: their words in `--help` and docs/options.md, and configs that come out of JSON."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from lerobot_robot_yam.errors import ConfigError

_NEEDED = dataclasses.MISSING


def option(text: str, default: Any = _NEEDED, factory: Callable[[], Any] | Any = _NEEDED) -> Any:
    """A field of a dataclass; `text` says what it means, in which unit, and what happens without it.

    Args:
        text: goes where draccus, LeRobot's parser, looks for it.
        default, factory: as of `dataclasses.field`; with neither, the field has to be given.
    """
    escaped = text.replace("%", "%%")  # argparse formats it
    return dataclasses.field(default=default, default_factory=factory, metadata={"custom_args": {"help": escaped}})


def from_plain[T](kind: type[T], values: Mapping[str, Any], where: str) -> T:
    """A config from plain values, as `dataclasses.asdict` and JSON give them.

    Raises:
        ConfigError: an unknown key; begins with `where`.
    """
    known = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise ConfigError(f"{where}: unknown keys {unknown}; known: {known}")
    return kind(**values)


def options_of(kind: type) -> list[tuple[str, Any, str]]:
    """Name, default and text of each option of a config class, in order."""
    rows = []
    for field in dataclasses.fields(kind):
        text = field.metadata.get("custom_args", {}).get("help", "").replace("%%", "%")
        default = field.default_factory() if field.default_factory is not _NEEDED else field.default
        rows.append((field.name, default, text))
    return rows
