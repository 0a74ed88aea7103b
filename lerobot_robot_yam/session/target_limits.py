"""Checks and limits of a target before it is sent: keys, finite numbers, unit, joint limits, `max_relative_target`.

The control loop afterwards limits the speed of the set-point and the torque.
"""

import logging
from collections.abc import Mapping, Sequence

import numpy as np

from lerobot_robot_yam.arm.joint_map import RANGE_TOLERANCE_RAD, TURN
from lerobot_robot_yam.arm.validation import finite_number
from lerobot_robot_yam.errors import ActionError
from lerobot_robot_yam.state.records import Limited

logger = logging.getLogger(__name__)

# minimum clamped amount that is logged, rad or strokes: measured poses lie slightly outside the limits
_WORTH_SAYING = 0.01


def validate_action(device: str, action: Mapping[str, object], keys: Sequence[str]) -> np.ndarray:
    """Return the values (n,) of a LeRobot action in the order of `keys`. 0-d tensors and arrays count as numbers.

    Raises:
        ActionError: keys are missing or unknown, or values are not finite numbers.
    """
    if not isinstance(action, Mapping):
        raise ActionError(f"{device}: an action maps names to numbers; this is a {type(action).__name__}")
    if len(action) != len(keys) or any(key not in action for key in keys):
        missing = [key for key in keys if key not in action]
        unknown = [key for key in action if key not in keys]
        raise ActionError(f"{device}: action lacks {missing or 'nothing'} and has unknown {unknown or 'nothing'}")
    return np.array([finite_number(device, key, action[key]) for key in keys])


def refuse_degrees(device: str, q: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> None:
    """Raise ActionError if joint angles are too large for radians but form a possible pose in degrees.

    Otherwise the joint limits would clamp such angles to the ends of the ranges. Targets with a single outlier, or with
    values that are not a possible pose in degrees either, are clamped like any other target.

    Args:
        device: name for messages.
        q: (n,) joint target.
        lower, upper: (n,) joint limits, rad.

    Raises:
        ActionError: the angles seem to be degrees; nothing was sent.
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


def limit_target(
    target: Sequence[float],
    measured: Sequence[float],
    lower: Sequence[float],
    upper: Sequence[float],
    max_relative: float | None,
) -> tuple[list[float], Limited]:
    """Clamp a target (n,) to the joint limits, and to `max_relative` around the measured position (n,).

    The result never leaves the joint limits, even if the measured position is outside.

    Returns:
        The clamped target (n,), and flags of the limits that changed it.
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
    """Logs which limits change the targets: one line when a limit starts to act."""

    def __init__(self, arm: str):
        self._arm = arm
        self._before = Limited.NOTHING

    def note(self, limited: Limited) -> None:
        """Log the limits in `limited` that were not in the previous call."""
        if limited is self._before:
            return
        fresh = limited & ~self._before
        if fresh:
            logger.info("%s: target held back by %s", self._arm, fresh.name)
        self._before = limited
