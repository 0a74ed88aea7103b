"""openpi's wire format: msgpack, with NumPy arrays and scalars as marked dictionaries.

An array is `{b"__ndarray__": True, b"data": bytes, b"dtype": "<f4", b"shape": [50, 14]}`, a scalar
`{b"__npgeneric__": True, b"data": value, b"dtype": "|b1"}`. Source: openpi-client 0.1.2, `msgpack_numpy.py`. The
package msgpack-numpy has other keys, and falls back to pickle; openpi-client itself wants NumPy 1, LeRobot NumPy 2.
"""

from typing import Any

import msgpack
import numpy as np

_PLAIN_KINDS = "biufSU"  # truth values, integers, floats, text: nothing that is a pointer or runs code


def encode(message: Any) -> bytes:
    """Bytes of a message: dictionaries, lists, text, numbers, arrays.

    Raises:
        TypeError: it contains something else.
    """
    return msgpack.packb(message, default=_pack)


def decode(data: bytes) -> Any:
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
