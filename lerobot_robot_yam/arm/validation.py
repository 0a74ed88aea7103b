"""Checks of numbers from callers; each conversion returns a copy."""

import math

import numpy as np

from lerobot_robot_yam.errors import ActionError

_NUMERIC = "fiu"  # kinds of numpy types for real numbers


def finite_vector(arm: str, what: str, value: object, n: int) -> np.ndarray:
    """Convert `value` to a new (n,) float array.

    Raises:
        ActionError: length or type is wrong, or an element is NaN or infinite; the message names the element.
    """
    try:
        given = np.asarray(value)
        if given.dtype.kind not in _NUMERIC + "O":  # numpy would parse text, and drop imaginary parts
            raise TypeError(f"{given.dtype} is no type of numbers")
        if given.dtype.kind == "O":
            given = np.array([_number(item) for item in given.flat]).reshape(given.shape)
        vector = given.astype(float)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:  # RuntimeError: a tensor with a gradient
        raise ActionError(f"{arm}: {what} must be {n} numbers ({error})") from error
    if vector.shape != (n,):
        raise ActionError(f"{arm}: {what} must have shape ({n},), not {vector.shape}")
    for index, number in enumerate(vector.tolist()):
        if not math.isfinite(number):
            raise ActionError(f"{arm}: {what}[{index}] is {number}; nothing was sent")
    return vector


def finite_floats(arm: str, what: str, value: object, n: int) -> list[float]:
    """Convert `value` to a list of n floats. For a list of floats this avoids numpy, whose code is rarely in the cache.

    Raises:
        ActionError: see `finite_vector`.
    """
    if isinstance(value, list | tuple) and len(value) == n:
        if all(type(item) is float and math.isfinite(item) for item in value):
            return list(value)
    return finite_vector(arm, what, value, n).tolist()


def finite_number(arm: str, what: str, value: object) -> float:
    """Convert `value` to a float. Raises ActionError: `value` is not a finite number."""
    try:
        number = value if type(value) is float else _number(value)
    except Exception as error:  # the conversion of an unknown type may raise anything
        raise ActionError(f"{arm}: {what} is not a number but {type(value).__name__} ({error})") from error
    if not math.isfinite(number):
        raise ActionError(f"{arm}: {what} is {number}; nothing was sent")
    return number


def check_range(arm: str, what: str, value: np.ndarray, low: float | np.ndarray, high: np.ndarray) -> None:
    """Check that speeds or gains of a target are in range. A motor would clip them, and the torque limit is for these.

    Args:
        arm, what: names for messages.
        value, low, high: (n,) values and their bounds, one per joint; a lower bound may be one number for all.

    Raises:
        ActionError: a value is outside its range; the message names joint and range.
    """
    outside = np.flatnonzero((value < low) | (value > high))
    if len(outside):
        i = int(outside[0])
        low = np.broadcast_to(low, value.shape)
        raise ActionError(
            f"{arm}: {what} of joint_{i + 1} is {value[i]:g}; it has to be within {low[i]:g} … {high[i]:g}; "
            "nothing was sent"
        )


def _number(value: object) -> float:
    """Convert one number to a float. Raises TypeError for text and booleans, else what `float(value)` raises."""
    if isinstance(value, str | bytes | bytearray | bool):
        raise TypeError("text and truth values are no positions")
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind not in _NUMERIC:
        raise TypeError(f"{value.dtype} is no type of numbers")
    shape = tuple(getattr(value, "shape", ()))
    if shape:
        raise TypeError(f"it has shape {shape}")
    return float(value)  # type: ignore[arg-type]
