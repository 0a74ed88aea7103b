"""Homing of the rail: up to the upper switch, then down to the lower one."""

from collections.abc import Callable, Generator
from typing import TYPE_CHECKING

from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.mobile.rail_profile import HOMING_RAD_S, HOMING_TIMEOUT_S

if TYPE_CHECKING:
    from lerobot_robot_yam.control.mobile.rail_controller import RailController

_SETTLE_S = 0.2  # rest at a switch, s; as the vendor's
_LEFT_RAD = 3.0  # way after which the switch at the other end must have let go, rad
_NAMES = {1.0: "upper", -1.0: "lower"}


def seek(axis: "RailController", now: Callable[[], float], way: float) -> Generator[float, None, float]:
    """Drive to the upper (way 1) or lower switch (-1): yield rates, rad/s; return the angle where it was triggered.

    Raises:
        MotorError: a switch is stuck, missing or at the wrong end.
    """
    near, far, begin_s, start = _NAMES[way], _NAMES[-way], now(), axis.q
    left = not getattr(axis.sample, far)  # whether the other end has been left
    while not getattr(axis.sample, near):
        other = getattr(axis.sample, far)
        if left and other:
            raise MotorError(
                f"{axis.name}: rail: the {far} switch was triggered on the way to the {near} one: set direction, if it "
                "runs the wrong way, or exchange the switches"
            )
        left = left or not other
        if not left and abs(axis.q - start) > _LEFT_RAD:
            raise MotorError(
                f"{axis.name}: rail: the {far} switch stays triggered away from its end: it is stuck, or its wire is "
                "off (an open wire reads as triggered)"
            )
        if now() > begin_s + HOMING_TIMEOUT_S:
            raise MotorError(
                f"{axis.name}: rail: no {near} switch within {HOMING_TIMEOUT_S:g} s; check it and the belt"
            )
        yield way * HOMING_RAD_S
    found, until_s = axis.q, now() + _SETTLE_S
    while now() < until_s:
        yield 0.0
    return found
