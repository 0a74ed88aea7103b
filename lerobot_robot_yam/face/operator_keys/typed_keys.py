"""Keys that the user types for the driver itself, beside those that LeRobot hears."""

import logging
import re
from collections.abc import Callable
from typing import Any

from lerobot_robot_yam.face.operator_keys.pseudo_terminal import PseudoTerminal, pseudo_terminal

logger = logging.getLogger(__name__)

# What an arrow, a function key, or Alt with a letter sends: none of its characters was typed.
_SEQUENCE = re.compile(r"\x1b+(?:\[[0-?]*[ -/]*[@-~]?|O[0-9;]*.?|.)", re.DOTALL)


class TypedKeys:
    """Calls back for each key of some, from a thread of its own.

    Under X11 the keys of the whole desktop count, as LeRobot's do; else those that are typed into the terminal. LeRobot
    hears them, too.

    Args:
        pressed: called with the key, a single character.
    """

    def __init__(self, pressed: Callable[[str], None]):
        self._pressed = pressed
        self._listener: Any = None
        self._terminal: PseudoTerminal | None = None

    def start(self) -> None:
        """Begin to listen. LeRobot's own listener must not have been started yet."""
        from lerobot.utils import keyboard_input

        if keyboard_input.pynput_can_capture() and keyboard_input.keyboard is not None:
            self._listener = keyboard_input.keyboard.Listener(on_press=self._on_press)
            self._listener.start()
            return
        self._terminal = pseudo_terminal()
        self._terminal.take()
        self._terminal.heard = lambda typed: self._tell(_SEQUENCE.sub("", typed.decode(errors="replace")))

    def stop(self) -> None:
        """Listen no more, and leave the terminal as it was. Idempotent."""
        listener, self._listener = self._listener, None
        if listener is not None:
            listener.stop()
        terminal, self._terminal = self._terminal, None
        if terminal is not None:
            terminal.heard = lambda typed: None
            terminal.give_back()

    def _on_press(self, key: Any) -> None:
        self._tell(getattr(key, "char", None) or "")

    def _tell(self, typed: str) -> None:
        for key in typed:
            try:
                self._pressed(key)
            except Exception:
                logger.exception("the key %r was not understood", key)
