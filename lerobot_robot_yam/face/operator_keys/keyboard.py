"""The keyboard that LeRobot's key listener listens to in this process: keys are pressed there, and heard.

Under X11 LeRobot hears, through pynput, the keys of the whole desktop; else those that are typed into the terminal.
"""

import logging
import re
from collections.abc import Callable
from typing import Any, Protocol

from lerobot_robot_yam.face.operator_keys.pseudo_terminal import PseudoTerminal, pseudo_terminal

logger = logging.getLogger(__name__)

_KEYSYMS = {
    "up": "Up",
    "down": "Down",
    "right": "Right",
    "left": "Left",
    "esc": "Escape",
    "enter": "Return",
    "tab": "Tab",
    "space": "space",
    "backspace": "BackSpace",
}
# What an arrow, a function key, or Alt with a letter sends: none of its characters was typed.
_SEQUENCE = re.compile(r"\x1b+(?:\[[0-?]*[ -/]*[@-~]?|O[0-9;]*.?|.)", re.DOTALL)


class Keyboard(Protocol):
    """A way to LeRobot's listener."""

    def take(self) -> None:
        """Be ready before the listener starts."""

    def give_back(self) -> None:
        """Leave everything as it was. Idempotent."""

    def press(self, key: str) -> None:
        """Press a key, by LeRobot's name of it."""


class X11Keyboard:
    """Of the whole desktop: the window that has the focus hears the keys, too.

    Keys are pressed with Xlib, which pynput stands on: a listener hears some keys of pynput's own Controller twice.
    """

    def take(self) -> None:
        """Open the display."""
        from Xlib.display import Display

        self._display: Any = Display()

    def give_back(self) -> None:
        """Close the display."""
        shown, self._display = self._display, None
        if shown is not None:
            shown.close()

    def press(self, key: str) -> None:
        """Press and release it."""
        from Xlib import XK, X
        from Xlib.ext import xtest

        keysym = XK.string_to_keysym(_KEYSYMS.get(key, key)) or ord(key)
        code = self._display.keysym_to_keycode(keysym)
        for event in (X.KeyPress, X.KeyRelease):
            xtest.fake_input(self._display, event, code)
        self._display.sync()


def keyboard() -> Keyboard:
    """The way that fits LeRobot's own choice of a listener."""
    return pseudo_terminal() if _pynput() is None else X11Keyboard()


def _pynput() -> Any:
    """`pynput.keyboard`, where LeRobot's listener uses it; None where it reads a terminal."""
    from lerobot.utils import keyboard_input

    return keyboard_input.keyboard if keyboard_input.pynput_can_capture() else None


class TypedKeys:
    """Keys for the driver itself. Calls back for each, from a thread of its own; LeRobot hears them, too.

    Args:
        pressed: called with the key, a single character.
    """

    def __init__(self, pressed: Callable[[str], None]):
        self._pressed = pressed
        self._listener: Any = None
        self._terminal: PseudoTerminal | None = None

    def start(self) -> None:
        """Begin to listen. LeRobot's own listener must not have been started yet."""
        pynput = _pynput()
        if pynput is not None:
            self._listener = pynput.Listener(on_press=self._on_press)
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
