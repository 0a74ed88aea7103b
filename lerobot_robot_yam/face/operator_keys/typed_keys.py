"""Keys typed by a person, beside LeRobot's own listener or without one."""

import logging
from collections.abc import Callable

from lerobot.utils.keyboard_input import TerminalKeyListener, create_key_listener

from lerobot_robot_yam.face.lerobot_command.running_command import callers

logger = logging.getLogger(__name__)


def listen(pressed: Callable[[str], None], terminal: bool = False) -> Callable[[], None]:
    """Listen to keys through LeRobot's key listener, in the listener's thread.

    A terminal has only one reader: if LeRobot's own listener reads the terminal, `pressed` gets its keys, too.

    Args:
        pressed: callback with LeRobot's name of the key: a character, or a word such as "left".
        terminal: whether only keys typed into this terminal count, also where LeRobot hears keys of the whole desktop.

    Returns:
        The function that stops listening.
    """

    def tell(key: str) -> None:
        try:
            pressed(key)
        except Exception:
            logger.exception("the key %r was not understood", key)

    theirs = _terminal_listener()
    if theirs is None:
        own = TerminalKeyListener(tell) if terminal else create_key_listener(tell)
        if terminal:
            own.start()
        return own.stop if own is not None else lambda: None
    heard = theirs._on_key

    def both(key: str) -> None:
        tell(key)
        heard(key)

    theirs._on_key = both
    return lambda: setattr(theirs, "_on_key", heard)


def _terminal_listener() -> TerminalKeyListener | None:
    """Return the key listener of the running command, if it reads a terminal."""
    for caller in callers():
        values = caller.f_locals
        for found in (values.get("listener"), getattr(values.get("self"), "_listener", None)):
            if isinstance(found, TerminalKeyListener):
                return found
    return None
