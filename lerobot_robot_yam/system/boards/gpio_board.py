"""Switches and brake on the pins of a Raspberry Pi, by gpiozero, which finds the libraries of each model."""

import contextlib
import logging
import math
import time
from collections.abc import Iterator

import gpiozero

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.boards.switch_board import BoardSample

logger = logging.getLogger(__name__)


class GpioBoard:
    """Driver of three pins: inputs are pulled up and high when triggered; a low output engages the brake.

    Args:
        pins: BCM numbers of upper switch, lower switch and brake.
    """

    def __init__(self, pins: tuple[int, ...]):
        with contextlib.ExitStack() as opened:  # a pin that is in use must not keep the others
            self._upper, self._lower = (
                opened.enter_context(gpiozero.DigitalInputDevice(pin, pull_up=True)) for pin in pins[:2]
            )
            self._brake = opened.enter_context(
                gpiozero.DigitalOutputDevice(pins[2], active_high=True, initial_value=False)
            )
            self._opened = opened.pop_all()
        self._sample = BoardSample(False, False, None, -math.inf)
        self._failed: set[str] = set()

    def read(self) -> BoardSample:
        with self._reported("read"):
            # A device with a pull-up counts as active when its pin is low.
            upper, lower = not self._upper.is_active, not self._lower.is_active
            self._sample = BoardSample(upper, lower, not self._brake.value, time.monotonic())
        return self._sample

    def set_brake(self, on: bool) -> None:
        with self._reported("set"):
            self._brake.value = not on

    @contextlib.contextmanager
    def _reported(self, what: str) -> Iterator[None]:
        """Log an error of the pins once, until they work again.

        The age of the sample tells the loop, which goes on to command the motor.
        """
        try:
            yield
            self._failed.discard(what)
        except Exception as error:  # lgpio and its likes have errors of their own, which derive from nothing else
            if what not in self._failed:
                logger.error("rail: pins cannot be %s: %s", what, error)
            self._failed.add(what)

    def close(self) -> None:
        self._opened.close()


def open_board(name: str, port: str, pins: tuple[int, ...]) -> GpioBoard:
    """Open the pins. Raises ConfigError, which begins with `name`: this computer has none, or they are in use."""
    try:
        return GpioBoard(pins)
    except Exception as error:  # lgpio and its likes have errors of their own, which derive from nothing else
        raise ConfigError(
            f"{name}: pins {list(pins)} cannot be opened: {error}. Check that this is a Raspberry Pi with lgpio, that "
            "your user is in the group gpio, and that no other program uses them"
        ) from error
