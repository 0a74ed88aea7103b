"""Finding an arm's adapter by moving its wrist by hand: the motors are asked where they are, and nothing else."""

import time
from collections.abc import Callable, Mapping

import can

from lerobot_robot_yam.damiao.codec import decode_feedback
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.doctor.kit.questions import Questions
from lerobot_robot_yam.errors import MotorError

MOVED_RAD = 0.3  # on purpose; less than half of it may be a table that shakes
_WRIST_IDS, _WRIST_MOTOR = (4, 5, 6), "DM4310"
_POLL_S, _ANSWER_S = 0.05, 0.02
_RESTS_S, _RESTS_RAD = 0.3, 0.02
_RESTLESS_S = 10.0  # an arm that hangs may sway for long; its wrist hardly does


class WristWatch:
    """Arms whose wrists are moved after this was made. Make it before the person is asked to. Energises nothing.

    It waits for the hand that still moves the arm before this one: that would be taken for an answer.

    Args:
        buses: open, by channel; nobody else drives them.

    Raises (every method):
        MotorError: no motor answers, or one is energised, so that a hand would work against it.
        BusError: a channel is gone.
    """

    def __init__(self, buses: Mapping[str, can.BusABC]):
        self._questions = {channel: Questions(bus, channel) for channel, bus in buses.items()}
        self._start: dict[tuple[str, int], float] = {}
        self._await_rest()
        if not self._start:
            raise MotorError(f"no arm answers on {', '.join(buses)}: switch the arms' power on, check the CAN cables")

    def wait(self, answer: Callable[[float], str | None], tell: Callable[[str], None]) -> tuple[str | None, str | None]:
        """Wait until the wrist of one arm is moved, or the person types a line.

        Args:
            answer: waits at most so many seconds for a typed line; None when there is none.
            tell: takes a line of text.

        Returns:
            The channel, or the line; the other is None.
        """
        while (line := answer(_POLL_S)) is None:
            moved = self._moved_rad()
            furthest = max(moved, key=lambda channel: moved[channel])
            if moved[furthest] >= MOVED_RAD:
                also = [channel for channel in moved if channel != furthest and moved[channel] >= MOVED_RAD / 2]
                if not also:
                    return furthest, None
                tell(f"several arms move ({', '.join([furthest, *also])}): move one alone")
                self._await_rest()
        return None, line

    def _await_rest(self) -> None:
        """Wait until no wrist moves, and begin from there."""
        until_s = time.monotonic() + _RESTLESS_S
        while True:
            self._start.clear()
            self._moved_rad()
            time.sleep(_RESTS_S)
            if max(self._moved_rad().values()) < _RESTS_RAD or time.monotonic() > until_s:
                return

    def _moved_rad(self) -> dict[str, float]:
        """How far any joint of each wrist is from where it was first."""
        moved = dict.fromkeys(self._questions, 0.0)
        for channel, questions in self._questions.items():
            for answer in questions.refresh(_WRIST_IDS, _ANSWER_S, 0.0):
                where = channel, answer.nibble
                if answer.fault == Fault.NORMAL:
                    raise MotorError(f"{channel}: motor {answer.nibble} is energised: end the session that drives it")
                position = decode_feedback(_WRIST_MOTOR, answer.data).position
                moved[channel] = max(moved[channel], abs(position - self._start.setdefault(where, position)))
        return moved
