"""Cameras by their roles (top, wrist_left, …) in a YAML file. The rest of the file stays as it is, comments too.

The text is changed where YAML's own parser says that a value is. What came of it is read again and compared.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from lerobot_robot_yam.errors import ConfigError, SetupError

ROLES = ("top", "wrist_left", "wrist_right")
_STEP = "  "


def with_cameras(text: str, cameras: Mapping[str, Mapping[str, Any]]) -> str:
    """The text of a run config with these cameras, by role, under `robot.cameras`; without `robot`, under `cameras`.

    A role that is there keeps what it says beside these fields, unless it is of another type.

    Raises:
        ConfigError: the text is no YAML, or written in a way that this cannot change.
    """
    for role, fields in reversed(list(cameras.items())):  # each new one comes before those that are there
        text = _with_camera(text, role, fields)
    return text


def read_config(path: Path) -> str:
    """Text of a file, empty when there is none.

    Raises:
        SetupError: it cannot be read.
    """
    try:
        return path.read_text()
    except FileNotFoundError:
        return ""
    except (OSError, UnicodeDecodeError) as error:
        raise SetupError(f"{path} cannot be read: {error}") from error


def named_cameras(text: str) -> dict[str, Mapping[str, Any]]:
    """The cameras of a run config, by role.

    Raises:
        ConfigError: the text is no YAML.
    """
    cameras: Any = _loaded(text)
    for key in _place(cameras):
        cameras = cameras.get(key) if isinstance(cameras, Mapping) else None
    found = cameras if isinstance(cameras, Mapping) else {}
    return {role: fields for role, fields in found.items() if isinstance(fields, Mapping)}


def _with_camera(text: str, role: str, fields: Mapping[str, Any]) -> str:
    config = _loaded(text)
    place = _place(config)
    old = named_cameras(text).get(role, {})
    camera = {**(old if old.get("type") == fields.get("type") else {}), **fields}
    changed = _edited(text, [*place, role], camera)
    if not _holds(changed, _put(config, [*place, role], camera)):
        raise ConfigError(
            f"the file writes {'.'.join([*place, role])} in a way that cannot be changed here (an anchor?): write by "
            f"hand {role}: {_flow(camera)}"
        )
    return changed


def _holds(text: str, config: Any) -> bool:
    try:
        return _loaded(text) == config
    except ConfigError:
        return False


def _put(group: Any, path: list[str], value: Any) -> dict[str, Any]:
    """The same with a value at this place; what shares an anchor with it stays."""
    key, *rest = path
    group = group or {}
    return {**group, key: _put(group.get(key), rest, value) if rest else value}


def _place(config: Any) -> list[str]:
    return ["robot", "cameras"] if isinstance(config, Mapping) and "robot" in config else ["cameras"]


def _edited(text: str, path: list[str], value: Mapping[str, Any]) -> str:
    node = yaml.compose(text, yaml.SafeLoader)
    if node is None:  # comments at most
        return f"{text}{'' if text.endswith(chr(10)) or not text else chr(10)}{_block(path, value, '')}"
    for depth, key in enumerate(path):
        if not isinstance(node, yaml.MappingNode):
            raise ConfigError(f"{'.'.join(path[:depth]) or 'the file'} is no group of keys: correct it first")
        found = {k.value: (k, v) for k, v in node.value}
        if key not in found:
            return _inserted(text, node, path[depth:], value)
        key_node, node = found[key]
        if depth == len(path) - 1 or not node.value:
            written = _flow(value) if depth == len(path) - 1 else f"{{{_inline(path[depth + 1 :], value)}}}"
            return f"{text[: key_node.end_mark.index]}: {written}{text[_end(node) :]}"
    raise AssertionError("a path has keys")


def _inserted(text: str, node: yaml.MappingNode, path: list[str], value: Mapping[str, Any]) -> str:
    """A key before the first one of a group that has some."""
    at = node.value[0][0].start_mark.index
    if node.flow_style:
        return f"{text[:at]}{_inline(path, value)}, {text[at:]}"
    indent = " " * node.value[0][0].start_mark.column
    if path[0] == "cameras" and not indent:  # at the end of a file: not above what its first comment is about
        return f"{text}{'' if text.endswith(chr(10)) else chr(10)}{_block(path, value, '')}"
    return f"{text[:at]}{_block(path, value, indent).lstrip()}{indent}{text[at:]}"


def _block(path: list[str], value: Mapping[str, Any], indent: str) -> str:
    *groups, role = path
    lines = [f"{indent}{_STEP * depth}{group}:" for depth, group in enumerate(groups)]
    return "\n".join([*lines, f"{indent}{_STEP * len(groups)}{role}: {_flow(value)}"]) + "\n"


def _inline(path: list[str], value: Mapping[str, Any]) -> str:
    *groups, role = path
    return "".join(f"{group}: {{" for group in groups) + f"{role}: {_flow(value)}" + "}" * len(groups)


def _flow(value: Mapping[str, Any]) -> str:
    return yaml.safe_dump(dict(value), default_flow_style=True, sort_keys=False, width=10**6).strip()


def _end(node: yaml.Node) -> int:
    """Where the last word of a value ends: of a block, YAML's own mark is behind the comments that follow."""
    return node.end_mark.index if getattr(node, "flow_style", True) is not False else max(map(_end, _leaves(node)))


def _leaves(node: yaml.Node) -> Iterator[yaml.Node]:
    for item in node.value:
        yield from item if isinstance(item, tuple) else (item,)


def _loaded(text: str) -> Any:
    try:
        return yaml.safe_load(text) or {}
    except yaml.YAMLError as error:
        raise ConfigError(f"the file is no YAML: {error}") from error
