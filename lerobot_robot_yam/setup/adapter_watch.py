"""Detection of the adapter that the user indicates, by plugging the adapter in or by moving the wrist of its arm.

Connected adapters are read from sysfs; of arms, only motor positions are read. The user may always type a line instead:
`Answer` waits up to the given time, s, for a line, and returns the line or None. `Tell` receives a line of text.
"""

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import can

from lerobot_robot_yam.damiao.codec import decode_feedback
from lerobot_robot_yam.damiao.tables import Fault
from lerobot_robot_yam.doctor.kit.questions import Questions
from lerobot_robot_yam.errors import MotorError
from lerobot_robot_yam.system.sysfs import CanAdapter, read_adapters

_PLUGS_S = 0.2  # polling interval for connected adapters, s
_SETTLE_S = 0.8  # wait for all channels of a new adapter, and for udev to rename them, s
MOVED_RAD = 0.3  # motion that counts as deliberate, rad; less than half of this may be a shaking table
_WRIST_IDS, _WRIST_MOTOR = (4, 5, 6), "DM4310"
_POLL_S, _ANSWER_S = 0.05, 0.02
_RESTS_S, _RESTS_RAD = 0.3, 0.02
_RESTLESS_S = 10.0  # maximum wait for rest, s: a hanging arm may sway for long, but its wrist joints hardly move


Answer = Callable[[float], str | None]
Tell = Callable[[str], None]


class PlugWatch:
    """Watch for newly plugged-in adapters. Create the watch before asking the user to plug one in.

    Args:
        sysfs: root of sysfs.
    """

    def __init__(self, sysfs: Path):
        self._sysfs = sysfs
        self._before = set(_places(sysfs))

    def wait(self, answer: Answer, tell: Tell) -> list[CanAdapter] | str:
        """Wait until one adapter is plugged in, or plugged in again; return its channels, or the typed line."""
        while (line := answer(_PLUGS_S)) is None:
            now = _places(self._sysfs)
            if set(now) - self._before:
                time.sleep(_SETTLE_S)
                now = _places(self._sysfs)
                new = [adapter for key, adapter in now.items() if key not in self._before]
                if len({a.usb.port if a.usb else a.place for a in new}) == 1:
                    return new
                if new:
                    self._before = set(now)
                    tell(f"several came at once: {', '.join(a.name for a in new)}; unplug them, and plug in one")
            self._before &= set(now)
        return line


def _places(sysfs: Path) -> dict[tuple[str | None, ...], CanAdapter]:
    """Return (place, channel) -> adapter for all connected adapters; names change, so they cannot be keys."""
    return {(a.place, *a.number, None if a.place else a.name): a for a in read_adapters(sysfs)}


class WristWatch:
    """Watch for arms whose wrists move after the watch was created. Energises nothing.

    Create the watch before asking the user. The constructor waits until all wrists rest: remaining motion of a
    previous arm would count as an answer.

    Args:
        buses: channel -> open bus, for exclusive use.

    Raises (every method):
        MotorError: no motor replies, or a motor is energised and would resist the hand.
        BusError: a channel is disconnected.
    """

    def __init__(self, buses: Mapping[str, can.BusABC]):
        self._questions = {channel: Questions(bus, channel) for channel, bus in buses.items()}
        self._clock = next(iter(self._questions.values())).clock
        self._start: dict[tuple[str, int], float] = {}
        self._await_rest()
        if not self._start:
            raise MotorError(f"no arm answers on {', '.join(buses)}: switch the arms' power on, check the CAN cables")

    def wait(self, answer: Answer, tell: Tell) -> tuple[str, str]:
        """Wait until the wrist of one arm moves; return its channel and "", or "" and the typed line."""
        while (line := answer(_POLL_S)) is None:
            moved = self._moved_rad()
            furthest = max(moved, key=lambda channel: moved[channel])
            if moved[furthest] >= MOVED_RAD:
                also = [channel for channel in moved if channel != furthest and moved[channel] >= MOVED_RAD / 2]
                if not also:
                    return furthest, ""
                tell(f"several arms move ({', '.join([furthest, *also])}): move one alone")
                self._await_rest()
        return "", line

    def _await_rest(self) -> None:
        """Wait until no wrist moves, and store the wrists' positions."""
        until_s = self._clock.now() + _RESTLESS_S
        while True:
            self._start.clear()
            self._moved_rad()
            self._clock.sleep(_RESTS_S)
            if max(self._moved_rad().values()) < _RESTS_RAD or self._clock.now() > until_s:
                return

    def _moved_rad(self) -> dict[str, float]:
        """Return channel -> largest deviation of a wrist joint from its stored position, rad."""
        moved = dict.fromkeys(self._questions, 0.0)
        for channel, questions in self._questions.items():
            for answer in questions.refresh(_WRIST_IDS, _ANSWER_S, 0.0):
                where = channel, answer.nibble
                if answer.fault == Fault.NORMAL:
                    raise MotorError(f"{channel}: motor {answer.nibble} is energised: end the session that drives it")
                position = decode_feedback(_WRIST_MOTOR, answer.data).position
                moved[channel] = max(moved[channel], abs(position - self._start.setdefault(where, position)))
        return moved
