"""The caller's side of the safety chain: what a target must be, and what is held back before it is sent.

validate (keys, shape, finite, unit) → joint limits → max_relative_target; the loop adds set-point speed and torque
clip.
"""

import logging
import math
from collections.abc import Mapping, Sequence

import numpy as np

from lerobot_robot_yam.arm.joints import RANGE_TOLERANCE_RAD, TURN
from lerobot_robot_yam.arm.state import Limited
from lerobot_robot_yam.errors import ActionError

logger = logging.getLogger(__name__)

_NUMERIC = "fiu"  # kinds of numpy types whose values are real numbers
_WORTH_SAYING = 0.01  # rad, or of the gripper's stroke: measured poses may lie a little outside the limits


def finite_vector(arm: str, what: str, value: object, n: int) -> np.ndarray:
    """`value` as a private (n,) float array.

    Raises:
        ActionError: wrong length or type, NaN or infinity; names the element.
    """
    try:
        given = np.asarray(value)
        if given.dtype.kind not in _NUMERIC + "O":  # text would be parsed, imaginary parts dropped
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


def finite_number(arm: str, what: str, value: object) -> float:
    """`value` as a float.

    Raises:
        ActionError: no number, NaN or infinity.
    """
    try:
        number = value if type(value) is float else _number(value)
    except Exception as error:  # whatever turning it into a number raises, it is none
        raise ActionError(f"{arm}: {what} is not a number but {type(value).__name__} ({error})") from error
    if not math.isfinite(number):
        raise ActionError(f"{arm}: {what} is {number}; nothing was sent")
    return number


def check_range(arm: str, what: str, value: np.ndarray, low: float, high: np.ndarray) -> None:
    """Refuse what a motor's frame cannot carry: the torque limit would reckon with it, and the motor with less.

    Args:
        arm, what: for messages.
        value: (n,) per joint.
        low: smallest share of `high` that is possible: 0, or -1.
        high: (n,) largest value.

    Raises:
        ActionError: names the joint and its range.
    """
    outside = np.flatnonzero((value < low * high) | (value > high))
    if len(outside):
        i = int(outside[0])
        raise ActionError(
            f"{arm}: {what} of joint_{i + 1} is {value[i]:g}; its motor takes {low * high[i]:g} … {high[i]:g}; "
            "nothing was sent"
        )


def action_vector(device: str, action: Mapping[str, object], keys: Sequence[str]) -> np.ndarray:
    """The values of a LeRobot action in the order of `keys`, (n,). 0-d tensors and arrays are numbers.

    Raises:
        ActionError: missing or unknown keys, values that are not finite numbers.
    """
    if not isinstance(action, Mapping):
        raise ActionError(f"{device}: an action maps names to numbers; this is a {type(action).__name__}")
    if len(action) != len(keys) or any(key not in action for key in keys):
        missing = [key for key in keys if key not in action]
        unknown = [key for key in action if key not in keys]
        raise ActionError(f"{device}: action lacks {missing or 'nothing'} and has unknown {unknown or 'nothing'}")
    return np.array([finite_number(device, key, action[key]) for key in keys])


def refuse_degrees(device: str, q: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> None:
    """Refuse joint angles that are none in radians, but a pose of the arms in degrees.

    Clamped to the joint limits, they would send the arms all the way there. A single wild value is no sign of degrees,
    and what no pose fits is not either: these are limited like any other target.

    Args:
        device: for messages.
        q: (n,) target of the joints.
        lower, upper: (n,) joint limits, rad.

    Raises:
        ActionError: degrees, as it seems; nothing was sent.
    """
    wild = np.abs(q) > TURN
    if np.count_nonzero(wild) < 2:
        return
    pose = np.radians(q)
    if np.all((pose > lower - RANGE_TOLERANCE_RAD) & (pose < upper + RANGE_TOLERANCE_RAD)):
        raise ActionError(
            f"{device}: {np.count_nonzero(wild)} joints are asked for more than a whole turn (up to "
            f"{np.abs(q).max():.1f} rad), which would be a pose in degrees; nothing was sent. Does the policy or data "
            "set speak degrees? Then set use_degrees to true"
        )


def _number(value: object) -> float:
    """One number as a float; raises whatever the value's type raises, TypeError for what only looks like one."""
    if isinstance(value, str | bytes | bytearray | bool):
        raise TypeError("text and truth values are no positions")
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind not in _NUMERIC:
        raise TypeError(f"{value.dtype} is no type of numbers")
    shape = tuple(getattr(value, "shape", ()))
    if shape:
        raise TypeError(f"it has shape {shape}")
    return float(value)  # type: ignore[arg-type]


def limit_target(
    target: Sequence[float],
    measured: Sequence[float],
    lower: Sequence[float],
    upper: Sequence[float],
    max_relative: float | None,
) -> tuple[list[float], Limited]:
    """Joint limits, then `max_relative` distance from the measured position; n each. Says what was held back.

    A measured position may lie outside the limits; the result never does.
    """
    limited = Limited.NOTHING
    inside = [
        low if value < low else high if value > high else value
        for value, low, high in zip(target, lower, upper, strict=True)
    ]
    if inside != target and any(abs(a - b) > _WORTH_SAYING for a, b in zip(inside, target, strict=True)):
        limited |= Limited.JOINT_LIMIT
    if max_relative is not None:
        near = [
            min(max(a, m - max_relative, low), max(m + max_relative, low), high)
            for a, m, low, high in zip(inside, measured, lower, upper, strict=True)
        ]
        if near != inside:
            limited |= Limited.RELATIVE_TARGET
        inside = near
    return inside, limited


class LimitLog:
    """Logs the beginning of each stretch of limiting, not every tick of it."""

    def __init__(self, arm: str):
        self._arm = arm
        self._before = Limited.NOTHING

    def note(self, limited: Limited) -> None:
        """Warn once when a limit begins to act."""
        if limited is self._before:
            return
        fresh = limited & ~self._before
        if fresh:
            logger.warning("%s: target held back by %s", self._arm, fresh.name)
        self._before = limited
