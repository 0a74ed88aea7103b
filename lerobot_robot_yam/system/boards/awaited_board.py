"""A board that another process still holds: a thread opens it as soon as it is free, so that no loop waits for it."""

import logging
import threading
from collections.abc import Callable

from lerobot_robot_yam.system.boards.switch_board import BoardSample, LostBoard, SwitchBoard

logger = logging.getLogger(__name__)

_AGAIN_S = 0.005  # interval of attempts, s: the kernel frees the port of a killed process after about 50 ms
_LAST_S = 1.0  # wait for the board at the end, s: a brake that was released must not be left so


class AwaitedBoard:
    """Driver that opens a board later, see `SwitchBoard`; until then it has no sample. Opening engages the brake.

    Args:
        name: the axis, for messages.
        opens: function that opens the board, or raises an error.
    """

    def __init__(self, name: str, opens: Callable[[], SwitchBoard]):
        self._name, self._opens = name, opens
        self._board: SwitchBoard = LostBoard()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._await, name="yam-rail-await", daemon=True)
        self._thread.start()

    def read(self) -> BoardSample:
        return self._board.read()

    def set_brake(self, on: bool) -> None:
        self._board.set_brake(on)  # the loop repeats it at each tick

    def close(self) -> None:
        """Open the board even now, if that takes little time, and close it: that engages the brake."""
        self._thread.join(_LAST_S)
        self._ended.set()
        self._thread.join()
        self._board.close()

    def _await(self) -> None:
        said = False
        while not self._ended.is_set():
            try:
                self._board = self._opens()
            except Exception as error:  # whatever it is: the motor alone holds the carriage until the brake is engaged
                if not said:  # as text, since gpiozero reserves the pins as long as the error lives
                    logger.warning("%s: the motor holds until its brake can be engaged: %s", self._name, str(error))
                said = True
                self._ended.wait(_AGAIN_S)
            else:
                logger.info("%s: switches and brake are open", self._name)
                return
