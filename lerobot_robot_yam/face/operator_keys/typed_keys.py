"""Keys that mean something to the driver itself, typed where LeRobot's key listener hears its own."""

import logging
from collections.abc import Callable
from types import FrameType

from lerobot.utils.keyboard_input import TerminalKeyListener, create_key_listener

from lerobot_robot_yam.face.recorder.record_command import callers

logger = logging.getLogger(__name__)


class TypedKeys:
    """Calls back for each key, from a thread of its own; LeRobot hears them, too.

    Args:
        pressed: called with LeRobot's name of the key: a character, or a word such as "left".
    """

    def __init__(self, pressed: Callable[[str], None]):
        self._pressed = pressed
        self._listens = False
        self._end: Callable[[], None] = lambda: None

    def listen(self, frame: FrameType | None) -> None:
        """Begin at the first call, when LeRobot's own listener runs; `frame` is where LeRobot has called.

        A terminal has one reader: where LeRobot reads it, its listener tells this one as well.
        """
        if self._listens:
            return
        self._listens = True
        theirs = _listener(frame)
        if theirs is None:
            own = create_key_listener(self._tell)
            self._end = (lambda: None) if own is None else own.stop
            return
        heard = theirs._on_key

        def both(key: str) -> None:
            self._tell(key)
            heard(key)

        def leave() -> None:
            theirs._on_key = heard

        theirs._on_key, self._end = both, leave

    def stop(self) -> None:
        """Listen no more. Idempotent."""
        end, self._end, self._listens = self._end, lambda: None, False
        end()

    def _tell(self, key: str) -> None:
        try:
            self._pressed(key)
        except Exception:
            logger.exception("the key %r was not understood", key)


def _listener(frame: FrameType | None) -> TerminalKeyListener | None:
    """The listener of the command that has called down to `frame`, if it reads a terminal."""
    for caller in callers(frame):
        values = caller.f_locals
        for found in (values.get("listener"), getattr(values.get("self"), "_listener", None)):
            if isinstance(found, TerminalKeyListener):
                return found
    return None
