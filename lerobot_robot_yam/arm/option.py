"""Options of config classes: help texts for `--help` and docs/options.md, configs from JSON, conversion of numbers."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from lerobot_robot_yam.errors import ConfigError

_NEEDED = dataclasses.MISSING


def option(text: str, default: Any = _NEEDED, factory: Callable[[], Any] | Any = _NEEDED) -> Any:
    """Create a field of a config dataclass.

    Args:
        text: help text with the meaning of the field, its unit and its default; LeRobot's parser draccus shows it.
        default, factory: as for `dataclasses.field`; with neither, the field is required.
    """
    escaped = text.replace("%", "%%")  # argparse applies % formatting to the text
    return dataclasses.field(default=default, default_factory=factory, metadata={"custom_args": {"help": escaped}})


def from_plain[T](kind: type[T], values: Mapping[str, Any], where: str) -> T:
    """Create a config from plain values, as from `dataclasses.asdict` or JSON.

    Raises:
        ConfigError: a key is unknown; the message begins with `where`.
    """
    known = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise ConfigError(f"{where}: unknown keys {unknown}; known: {known}")
    return kind(**values)


def options_of(kind: type) -> list[tuple[str, Any, str]]:
    """List name, default and help text of each option of a config class, in order."""
    rows = []
    for field in dataclasses.fields(kind):
        text = field.metadata.get("custom_args", {}).get("help", "").replace("%%", "%")
        default = field.default_factory() if field.default_factory is not _NEEDED else field.default
        rows.append((field.name, default, text))
    return rows


def within(what: str, value: Any, low: float, high: float) -> None:
    """Check a number. Raises ConfigError, which begins with `what`: it is not a number from `low` to `high`."""
    number = real(value)
    if not (math.isfinite(number) and low <= number <= high):
        raise ConfigError(f"{what} is {low:g} to {high:g}, not {value!r}")


def real(value: Any) -> float:
    """Convert a real number in a config to a float; NaN for anything else: text, booleans, overflow."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return math.nan
    try:
        return float(value)
    except OverflowError:  # an integer too large for a float
        return math.nan
