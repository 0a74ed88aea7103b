"""Strict conversion of YAML to frozen dataclasses: unknown, missing or ill-typed keys raise an error with their place.

Fields may be `int`, `float`, `str`, `bool`, `np.ndarray`, another dataclass, `T | None`, `tuple[T, ...]` or
`dict[str, T]`. Array fields, made with `array_field(*shape)`, are checked against their shape (-1: any length), contain
finite float64 and are read-only.
"""

import dataclasses
import math
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.paths import user_path

_LARGEST = 1e9  # maximum number: arms in SI units stay far below, and larger numbers overflow in the model


def array_field(*shape: int, default: Any = dataclasses.MISSING) -> Any:
    """Create a dataclass field for a read-only float array of `shape` (-1: any length along that axis)."""
    if default is dataclasses.MISSING:
        return dataclasses.field(metadata={"shape": shape})
    value = None if default is None else _array(default, shape, "default")
    return dataclasses.field(default_factory=lambda: value, metadata={"shape": shape})


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file that contains a mapping. Raises ConfigError: it cannot be read, or contains no mapping."""
    try:
        document = yaml.safe_load(user_path(path).read_text(encoding="utf-8"))
    except Exception as error:  # besides OSError and YAMLError: "!!int x" is a ValueError, "!!bool x" a KeyError, …
        raise ConfigError(f"cannot read {path}: {error}") from error
    if not isinstance(document, dict):
        raise ConfigError(f"{path} holds no YAML mapping at its top level")
    return document


def merge(document: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return `document` with `overrides` applied: nested mappings are merged, other values replaced."""
    merged = dict(document)
    for key, value in overrides.items():
        old = merged.get(key)
        merged[key] = merge(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return merged


def parse[T](cls: type[T], document: Any, where: str) -> T:
    """Create dataclass `cls` from a mapping. Raises ConfigError: a key or value is wrong; `where` is in the message."""
    if not isinstance(document, Mapping):
        raise ConfigError(f"{where}: expected a mapping, found {type(document).__name__}")
    hints = typing.get_type_hints(cls)
    fields = {field.name: field for field in dataclasses.fields(cls)}  # type: ignore[arg-type]
    unknown = [key for key in document if key not in fields]
    if unknown:
        raise ConfigError(f"{where}: unknown keys {unknown}; known: {sorted(fields)}")
    values = {}
    for name, field in fields.items():
        if name in document:
            values[name] = _value(hints[name], document[name], field, f"{where}.{name}")
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise ConfigError(f"{where}: key '{name}' is missing")
    return cls(**values)


def _value(hint: Any, value: Any, field: dataclasses.Field, where: str) -> Any:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        if value is None:
            return None
        (hint,) = [a for a in arguments if a is not types.NoneType]
        return _value(hint, value, field, where)
    if origin is tuple:
        if not isinstance(value, list | tuple):
            raise ConfigError(f"{where}: expected a list, found {value!r}")
        return tuple(_value(arguments[0], item, field, f"{where}[{i}]") for i, item in enumerate(value))
    if origin is dict:
        if not isinstance(value, Mapping):
            raise ConfigError(f"{where}: expected a mapping, found {value!r}")
        return {str(k): _value(arguments[1], v, field, f"{where}.{k}") for k, v in value.items()}
    if hint is np.ndarray:
        return _array(value, field.metadata["shape"], where)
    if dataclasses.is_dataclass(hint):
        return parse(typing.cast(type, hint), value, where)
    return _scalar(hint, value, where)


def _array(value: Any, shape: tuple[int, ...], where: str) -> np.ndarray:
    try:
        given = np.asarray(value)
        if given.dtype.kind not in "fiuO":  # numpy would parse text; YAML reads 1e-3 as text, 1.0e-3 as a number
            raise TypeError(f"{given.dtype} is no type of numbers")
        if given.dtype.kind == "O" and not all(isinstance(item, int | float) for item in given.flat):
            raise TypeError("not all of them are numbers")
        array = given.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{where}: expected numbers, found {value!r}") from error
    if array.size == 0 and shape and shape[0] == -1:
        array = array.reshape((0, *shape[1:]))
    fits = array.ndim == len(shape) and all(s in (-1, n) for s, n in zip(shape, array.shape, strict=True))
    if not fits or not (np.abs(array) <= _LARGEST).all():
        raise ConfigError(f"{where}: expected numbers of at most {_LARGEST:g} and shape {shape}, found {value!r}")
    array.setflags(write=False)
    return array


def _scalar(hint: Any, value: Any, where: str) -> Any:
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        number = float(value) if abs(value) <= _LARGEST else math.inf  # an integer may be too large for a float
        if not math.isfinite(number):
            raise ConfigError(f"{where}: expected a number of at most {_LARGEST:g}, found {value!r}")
        return number
    if hint in (int, str, bool) and type(value) is hint:
        return value
    raise ConfigError(f"{where}: expected {hint.__name__}, found {value!r}")
