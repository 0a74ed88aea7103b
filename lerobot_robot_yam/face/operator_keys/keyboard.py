"""Where LeRobot's key listener listens in this process, and how to press a key there."""

import logging
from typing import Any, Protocol

from lerobot_robot_yam.face.operator_keys.pseudo_terminal import pseudo_terminal

logger = logging.getLogger(__name__)


class Keyboard(Protocol):
    """A way to LeRobot's listener."""

    def take(self) -> None:
        """Be ready before the listener starts."""

    def give_back(self) -> None:
        """Leave everything as it was. Idempotent."""

    def press(self, key: str) -> None:
        """Press a key, by LeRobot's name of it."""


class X11Keyboard:
    """Under X11 LeRobot hears, through pynput, the keys of the whole desktop. So does the window that has the focus."""

    def __init__(self, pynput_keyboard: Any):
        self._keys = pynput_keyboard

    def take(self) -> None:
        """Open the way to the display."""
        self._controller = self._keys.Controller()

    def give_back(self) -> None:
        """Nothing was changed."""

    def press(self, key: str) -> None:
        """Press and release it."""
        self._controller.tap(getattr(self._keys.Key, key, key))


def keyboard() -> Keyboard:
    """The way that fits LeRobot's own choice of a listener."""
    from lerobot.utils import keyboard_input

    if keyboard_input.pynput_can_capture() and keyboard_input.keyboard is not None:
        return X11Keyboard(keyboard_input.keyboard)
    return pseudo_terminal()
