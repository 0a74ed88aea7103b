"""Cameras by role (top, wrist_left, …) in a YAML file. Edits preserve the rest of the file, including comments."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap
from ruamel.yaml.error import YAMLError
from ruamel.yaml.scalarstring import SingleQuotedScalarString
from ruamel.yaml.util import load_yaml_guess_indent

from lerobot_robot_yam.errors import ConfigError, SetupError

ROLES = ("top", "wrist_left", "wrist_right")
_NO_LIMIT = 10**6  # maximum length of a line that is written without a break, characters


def read_config(path: Path) -> str:
    """Return the text of a file, empty if the file does not exist. Raises SetupError: the file cannot be read."""
    try:
        return path.read_text()
    except FileNotFoundError:
        return ""
    except (OSError, UnicodeDecodeError) as error:
        raise SetupError(f"{path} cannot be read: {error}") from error


def named_cameras(text: str) -> dict[str, Mapping[str, Any]]:
    """Return the options of each camera of a run config, by role. Raises ConfigError: the text is not YAML."""
    cameras: Any = _loaded(text)
    for key in _place(cameras):
        cameras = cameras.get(key) if isinstance(cameras, Mapping) else None
    found = cameras if isinstance(cameras, Mapping) else {}
    return {role: fields for role, fields in found.items() if isinstance(fields, Mapping)}


def with_cameras(text: str, cameras: Mapping[str, Mapping[str, Any]]) -> str:
    """Add cameras, by role, to the text of a run config, under `robot.cameras` or, without `robot`, under `cameras`.

    An existing role keeps its other fields, unless the type differs.

    Raises:
        ConfigError: the text is not YAML, or is written in a form that cannot be edited.
    """
    if not _loaded(text):  # empty, or only comments
        text = f"{text.rstrip()}\ncameras:\n".lstrip()
    wanted, before = _loaded(text), named_cameras(text)
    editor = YAML()
    editor.preserve_quotes, editor.width = True, _NO_LIMIT
    try:
        _, indent, offset = load_yaml_guess_indent(text)
        document = editor.load(text)
    except YAMLError as error:  # such as a duplicate key in a group
        raise ConfigError(f"the file is no YAML: {error}") from error
    editor.indent(mapping=indent or 2, sequence=indent or 2, offset=offset or 0)
    place = _place(wanted)
    group = _group(document, place)
    for role, fields in reversed(list(cameras.items())):  # each new role is inserted before the existing roles
        same = before.get(role, {}).get("type") == fields.get("type")
        wanted = _put(wanted, [*place, role], {**(before[role] if same else {}), **fields})
        if not same:
            _made(group, role, flow=True)
        group[role].update({key: _scalar(value) for key, value in fields.items()})
    written = io.StringIO()
    editor.dump(document, written)
    if _loaded(written.getvalue()) != wanted:
        raise ConfigError(
            f"the file writes {'.'.join(place)} in a way that cannot be changed here (an anchor?): write by hand "
            + yaml.safe_dump(dict(cameras), default_flow_style=True, sort_keys=False, width=_NO_LIMIT).strip()
        )
    return written.getvalue()


def _group(document: Any, place: list[str]) -> CommentedMap:
    """Return the group of keys at a place of the document; create the group if it is missing."""
    group = document
    for depth, key in enumerate(["the file", *place]):
        if depth and group.get(key) is None:
            _made(group, key, at=len(group) if depth == 1 else 0)  # a comment at a group's end is for the next group
        group = group[key] if depth else document
        if not isinstance(group, CommentedMap):
            raise ConfigError(f"{'.'.join(place[:depth]) or key} is no group of keys: correct it first")
    return group


def _made(group: CommentedMap, key: str, at: int = 0, flow: bool = False) -> None:
    """Set `key` of a group to an empty group; an existing value is replaced, a new key is inserted at index `at`."""
    new = CommentedMap()
    if flow:
        new.fa.set_flow_style()
    if key in group:
        group[key] = new
    else:
        group.insert(at, key, new)


def _put(group: Any, path: list[str], value: Any) -> dict[str, Any]:
    """Return a copy of a group with `value` at this path; other values with the same anchor are unchanged."""
    key, *rest = path
    group = group or {}
    return {**group, key: _put(group.get(key), rest, value) if rest else value}


def _place(config: Any) -> list[str]:
    return ["robot", "cameras"] if isinstance(config, Mapping) and "robot" in config else ["cameras"]


def _scalar(value: Any) -> Any:
    """Quote a text that YAML 1.1 (PyYAML) would read as another type, such as a serial number of digits, or `on`."""
    return SingleQuotedScalarString(value) if isinstance(value, str) and yaml.safe_load(value) != value else value


def _loaded(text: str) -> Any:
    try:
        return yaml.safe_load(text) or {}
    except yaml.YAMLError as error:
        raise ConfigError(f"the file is no YAML: {error}") from error
