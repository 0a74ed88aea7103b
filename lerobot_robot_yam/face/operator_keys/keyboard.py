"""Where LeRobot's key listener listens in this process, and how to press a key there."""

from typing import Any, Protocol

from lerobot_robot_yam.face.operator_keys.pseudo_terminal import pseudo_terminal

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


class Keyboard(Protocol):
    """A way to LeRobot's listener."""

    def take(self) -> None:
        """Be ready before the listener starts."""

    def give_back(self) -> None:
        """Leave everything as it was. Idempotent."""

    def press(self, key: str) -> None:
        """Press a key, by LeRobot's name of it."""


class X11Keyboard:
    """Under X11 LeRobot hears, through pynput, the keys of the whole desktop. So does the window that has the focus.

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
    from lerobot.utils import keyboard_input

    if keyboard_input.pynput_can_capture() and keyboard_input.keyboard is not None:
        return X11Keyboard()
    return pseudo_terminal()
