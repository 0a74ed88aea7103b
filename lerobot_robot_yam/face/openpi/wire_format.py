"""Messages of openpi's websocket protocol as bytes, and the names by which observations travel.

Messages are msgpack, with NumPy arrays and scalars as marked dictionaries: an array is
`{b"__ndarray__": True, b"data": bytes, b"dtype": "<f4", b"shape": [50, 14]}`, a scalar
`{b"__npgeneric__": True, b"data": value, b"dtype": "|b1"}`. Source: openpi-client 0.1.2, `msgpack_numpy.py`. The
package msgpack-numpy has other keys, and falls back to pickle; openpi-client itself wants NumPy 1, LeRobot NumPy 2.
"""

from typing import Any

import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.own_commands import install_extra

try:
    import msgpack
except ImportError as error:
    raise ConfigError(f"openpi's protocol needs websockets and msgpack ({error}); {install_extra('openpi')}") from error

PROMPT_KEY = "prompt"
ENDPOINT_KEY, INFER, RESET = "endpoint", "infer", "reset"  # RoboArena's `policy_server.py`: what a message asks for
ENDPOINTS_KEY = "endpoints"  # in a greeting: which of them the server knows
IMAGE_KEYS = "image_keys"  # in a greeting: names of the images that the server has to see
STATEFUL_KEY = "stateful"  # in a greeting: whether an answer depends on earlier observations of its connection
RESET_DONE = "reset successful"  # RoboArena's answer, as text
_PREFIX = "observation."
_PLAIN_KINDS = "biufSU"  # truth values, integers, floats, text: nothing that is a pointer or runs code


def observation_name(key: str) -> str:
    """LeRobot's name of what travels under a key.

    `observation.state` is also called `observation/state` (DROID, LIBERO) and `state` (ALOHA), and
    `observation.images.top` in a dictionary `images` is called `top`: its key is `images/top`.
    """
    name = key.replace("/", ".")
    return name if name.startswith(_PREFIX) else _PREFIX + name


def encode_message(message: Any) -> bytes:
    """Bytes of a message: dictionaries, lists, text, numbers, arrays.

    Raises:
        TypeError: it contains something else.
    """
    return msgpack.packb(message, default=_pack)


def decode_message(data: bytes) -> Any:
    """The message that these bytes say. Arrays are read-only.

    Raises:
        ValueError: they are not msgpack, or contain an invalid array.
    """
    try:
        return msgpack.unpackb(data, object_hook=_unpack)
    except (KeyError, TypeError, msgpack.exceptions.UnpackException) as error:
        raise ValueError(f"not a message of openpi: {error!r}") from error


def _pack(value: Any) -> dict[bytes, Any]:
    if not isinstance(value, np.ndarray | np.generic):
        raise TypeError(f"{type(value).__name__} has no place in a message of openpi")
    _check_kind(value.dtype)
    if isinstance(value, np.ndarray):
        return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}
    return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}


def _unpack(value: dict[Any, Any]) -> Any:
    if b"__ndarray__" in value:
        return np.frombuffer(value[b"data"], _dtype(value)).reshape(value[b"shape"])
    if b"__npgeneric__" in value:
        return _dtype(value).type(value[b"data"])
    return value


def _dtype(value: dict[Any, Any]) -> np.dtype:
    dtype = np.dtype(value[b"dtype"])
    _check_kind(dtype)
    return dtype


def _check_kind(dtype: np.dtype) -> None:
    if dtype.kind not in _PLAIN_KINDS:
        raise TypeError(f"arrays of {dtype} have no place in a message of openpi")
