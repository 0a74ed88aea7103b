"""Velocities of a mobile base, and of its rail, from what a person asks of an input device.

    v = deflection · limit · (slow_factor while slow)        in the body frame
    v = R(−heading) v_global                                 in global mode

The base stands still after a trouble of the input device, an emergency stop, or a start with a pushed stick, until all
sticks are at rest.
"""

import logging
import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from lerobot_robot_yam.errors import ConfigError, YamError
from lerobot_robot_yam.face.driving.drive_options import DriveOptions
from lerobot_robot_yam.face.driving.driven_base import driven_base
from lerobot_robot_yam.face.driving.pad_map import FRAME, RESET
from lerobot_robot_yam.mobile.odometry import to_body
from lerobot_robot_yam.state.emergency_stop import EmergencyStop

logger = logging.getLogger(__name__)

STOPPED = "the emergency stop was latched"  # trouble; an input device also notes it while LeRobot asks for no action
VALID_S = 0.5  # age from which a press no longer counts, s: nobody asked for it in time


class Asked(NamedTuple):
    """What a person asks of the base.

    Attributes:
        deflection: of x, y, theta, height, −1 … 1; zeros at rest.
        slow: whether to drive slowly.
        presses: `FRAME`, `RESET`: what was pressed since the last call.
        trouble: why the base must not move: the input device cannot be heard, or `STOPPED`; empty if all is well.
    """

    deflection: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    slow: bool = False
    presses: Sequence[str] = ()
    trouble: str = ""


class Driver(Protocol):
    """Input device with which a person drives: a gamepad, a keyboard, a leader's handle."""

    def asked(self) -> Asked:
        """Return what the person asks now."""


class BaseDrive:
    """Action of the base, from what a person asks.

    Args:
        device: LeRobot's type name, for messages.
        options: speeds.
        stop: the emergency stop.
    """

    def __init__(self, device: str, options: DriveOptions, stop: EmergencyStop):
        self._device, self._stop, self._keys = device, stop, options.drive_keys()
        self._limits = np.array([*options.speed, options.rail_speed])
        self._limits[2] = math.radians(self._limits[2])
        self._slow_factor = options.slow_factor
        self._global = False
        self._blocked = ""  # why the base stands still until the sticks are at rest

    def action(self, asked: Asked) -> dict[str, float]:
        """Return LeRobot's action of the base: `x.vel`, `y.vel` in m/s, `theta.vel` in deg/s, `height.vel` in m/s."""
        at_rest = not any(asked.deflection)
        self._guard(asked.trouble or (STOPPED if self._stop.latched else ""), at_rest)
        for press in asked.presses:
            self._pressed(press, at_rest and not self._blocked)
        twist = np.array(asked.deflection) * self._limits * (self._slow_factor if asked.slow else 1.0)
        if not self._blocked and not at_rest:
            twist = self._in_body_frame(twist)
        if self._blocked:
            twist = np.zeros(4)
        twist[2] = math.degrees(twist[2])
        return dict(zip(self._keys, (twist + 0.0).tolist(), strict=False))  # without −0.0

    def _guard(self, trouble: str, at_rest: bool) -> None:
        """Block the base in trouble; free it once there is none and the sticks are at rest."""
        if trouble:
            if self._blocked != trouble:
                logger.error(
                    "%s: %s; the base brakes, and moves again once all sticks are at rest", self._device, trouble
                )
            self._blocked = trouble
        elif self._blocked and at_rest:
            logger.info("%s: drives again", self._device)
            self._blocked = ""

    def _in_body_frame(self, twist: np.ndarray) -> np.ndarray:
        """Turn a twist (4,) into the body frame, and slow it down to what the base does, which is then recorded."""
        base = driven_base()
        if self._global:
            try:
                if base is None:
                    raise ConfigError("no base is connected in this process")
                twist[:3] = to_body(twist[:3], float(base.observe().pose[2]))
            except YamError as error:
                self._global = False
                self._guard(f"the heading is not known ({error}); back in the local frame", False)
        if base is not None:
            twist[:3] /= max(1.0, float((np.abs(twist[:3]) / base.hardware.limits.velocity).max()))
            if (rail := base.config.rail) is not None:
                twist[3] = np.clip(twist[3], -rail.velocity_limit, rail.velocity_limit)
        return twist

    def _pressed(self, press: str, at_rest: bool) -> None:
        """Switch the frame, or reset the odometry. Both change what a pushed stick means, so sticks must be at rest."""
        if press not in (FRAME, RESET):
            return
        if not at_rest:
            logger.warning("%s: let go of all sticks before you change the frame or reset the odometry", self._device)
            return
        if press == FRAME and self._global:
            self._global = False
            logger.info("%s: drives in the local frame", self._device)
            return
        base = driven_base()
        try:
            if base is None:
                raise ConfigError("only a base that is connected in this process tells its odometry")
            base.observe()  # refuses an old heading
            if press == FRAME:
                self._global = True
                logger.info("%s: drives in the odometry's frame", self._device)
            else:
                base.reset_odometry()
                logger.info("%s: the odometry begins here", self._device)
        except YamError as error:
            what = "stays in the local frame" if press == FRAME else "the odometry is not reset"
            logger.warning("%s: %s: %s", self._device, what, error)


def shaped(deflection: float, dead_zone: float, expo: float) -> float:
    """Return a deflection −1 … 1 without the dead zone, and with a share `expo` (0 … 1) of its cube."""
    beyond = max(abs(deflection) - dead_zone, 0.0) / (1.0 - dead_zone)
    return math.copysign((1.0 - expo) * beyond + expo * beyond**3, deflection) if beyond else 0.0
