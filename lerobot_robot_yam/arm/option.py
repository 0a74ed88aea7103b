"""A field of a config with the words that `--help` of LeRobot's commands and docs/options.md say of it."""

import dataclasses
from collections.abc import Callable
from typing import Any

_NEEDED = dataclasses.MISSING


def option(text: str, default: Any = _NEEDED, factory: Callable[[], Any] | Any = _NEEDED) -> Any:
    """A field of a dataclass; `text` says what it means, in which unit, and what happens without it.

    Args:
        text: goes where draccus, LeRobot's parser, looks for it.
        default, factory: as of `dataclasses.field`; with neither, the field has to be given.
    """
    escaped = text.replace("%", "%%")  # argparse formats it
    return dataclasses.field(default=default, default_factory=factory, metadata={"custom_args": {"help": escaped}})


def options_of(kind: type) -> list[tuple[str, Any, str]]:
    """Name, default and text of each option of a config class, in order."""
    rows = []
    for field in dataclasses.fields(kind):
        text = field.metadata.get("custom_args", {}).get("help", "").replace("%%", "%")
        default = field.default_factory() if field.default_factory is not _NEEDED else field.default
        rows.append((field.name, default, text))
    return rows
