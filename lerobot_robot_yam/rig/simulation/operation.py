"""Operations of a rig: methods that run in the rig's process, wherever they are called.

A client sends the name and arguments of an operation as JSON, and receives the result. The rig checks the arguments
against the signature of the method.
"""

import functools
import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from types import NoneType, UnionType
from typing import Any, Concatenate, cast, get_args

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.bus.channel import Channel
from lerobot_robot_yam.rig.devices.simulated_handle import SimHandle
from lerobot_robot_yam.rig.simulation.device import RigDevice

REGISTERED: dict[str, Callable[..., Any]] = {}
"""Bodies of all operations by name, as functions of an `Operations` object and the arguments."""


class Operations(ABC):
    """Base class for sets of operations. Only objects in the rig's process have a `device`."""

    device: RigDevice

    @abstractmethod
    def request(self, op: str, **arguments: Any) -> dict[str, Any]:
        """Execute an operation in the rig; return its result. Raises ConfigError: the rig rejects the request."""

    def _channel_of(self, name: str) -> Channel:
        """Return a channel by name. Raises ConfigError: there is no such channel."""
        channels = self.device.channels
        if name not in channels:
            raise ConfigError(f"no channel {name!r}; the scene has {', '.join(channels)}")
        return channels[name]

    def _handle_of(self, channel: str) -> SimHandle:
        """Return the handle of a leader. Raises ConfigError: the channel has no handle."""
        handle = self._channel_of(channel).handle
        if handle is None:
            raise ConfigError(f"channel {channel} has no teaching handle")
        return handle


def operation[S: Operations, **P, R](method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """Turn a method of `Operations` into an operation: its body acts on `self.device`, a call sends a request."""
    name = method.__name__
    REGISTERED[name] = method
    signature = inspect.signature(method)
    packed = [row.name for row in signature.parameters.values() if row.kind is row.VAR_KEYWORD]

    @functools.wraps(method)
    def send(self: S, *args: P.args, **kwargs: P.kwargs) -> R:
        _, *given = signature.bind(self, *args, **kwargs).arguments.items()
        arguments = dict(given)
        for key in packed:
            arguments |= arguments.pop(key, {})
        return cast(R, self.request(name, **arguments))

    return send


def checked(signature: inspect.Signature, given: dict[str, Any]) -> dict[str, Any]:
    """Check scalar numbers, flags and texts against their annotations. Raises ConfigError: a value is invalid."""
    signature.bind(**given)
    found = {}
    for key, value in given.items():
        kind = signature.parameters[key].annotation if key in signature.parameters else Any
        kinds = set(get_args(kind)) if isinstance(kind, UnionType) else {kind}
        optional = value is None and NoneType in kinds
        kinds.discard(NoneType)
        check = _CHECKS.get(kinds.pop()) if len(kinds) == 1 and not optional else None
        try:
            found[key] = value if check is None else check(value)
        except ConfigError as error:
            raise ConfigError(f"{key}: {error}") from error
    return found


def number(value: Any, low: float = -math.inf, high: float = math.inf) -> float:
    """Return `value` as a float. Raises ConfigError: not a finite number from `low` to `high`."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError(f"expected a finite number, not {value!r}")
    if not low <= value <= high:
        raise ConfigError(f"expected a number from {low} to {high}, not {value!r}")
    return float(value)


def flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ConfigError(f"expected true or false, not {value!r}")
    return value


def whole(value: Any, low: int = 0, high: int = 2**63 - 1) -> int:
    """Return `value`. Raises ConfigError: not an integer from `low` to `high`."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ConfigError(f"expected a whole number from {low} to {high}, not {value!r}")
    return value


def vector(value: Any, length: int) -> np.ndarray:
    """Return `value` as an array. Raises ConfigError: not `length` finite numbers."""
    array = np.asarray(value, float)
    if array.shape != (length,) or not np.isfinite(array).all():
        raise ConfigError(f"expected {length} finite numbers, not {value!r}")
    return array


_CHECKS: dict[Any, Callable[[Any], Any]] = {bool: flag, float: number, int: whole}
