"""Mirror of other computers' emergency stops: a stop latched or released there is latched or released here, too.

Each computer reports only its own stop, never one that it mirrors. So a stop ends where it began: a mirrored stop that
is released here is latched again.

The programs of a computer have a link each, and check the computer's latch at different times. So a computer counts as
stopped while one of its links reports a stop.
"""

import logging
from dataclasses import dataclass, field

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.state.emergency_stop import EmergencyStop

logger = logging.getLogger(__name__)

_GONE_S = 2.0  # silence of a computer, s, after which its stop is not latched again if a person releases it here
_MOST = 64  # largest number of computers that are remembered
_WHY = "its emergency stop is latched; `yam-estop release` there"


@dataclass
class _Computer:
    heard_s: float = 0.0
    stopped: bool = False
    said: dict[bytes, tuple[bool, float]] = field(default_factory=dict)  # link → its last report, and when (s)
    failed: bool = False  # whether latching or releasing this computer's stop failed the last time
    unwritten: bool = False  # whether the computer's stop cannot be latched here


class MirroredStops:
    """Latch of this computer, with the stops of other computers mirrored into it.

    Args:
        called: role of the other computers, "host" or "workstation"; reasons of their stops begin with it.
        own: name of this computer for the others. Its reports are ignored: programs of one computer share a latch,
            which would last for ever if it were mirrored.

    Attributes:
        stopped: whether the emergency stop is latched here, or should be and cannot; and the computer whose stop it is.
        unwritten: whether the stop of another computer cannot be latched here.
    """

    def __init__(self, called: str, own: str) -> None:
        self._stop, self._called, self._own = EmergencyStop(), called, own
        self._computers: dict[str, _Computer] = {}
        self.stopped, self.unwritten = (False, own), False

    @property
    def own(self) -> bool:
        """Whether this computer itself has latched the stop."""
        return self.stopped == (True, self._own)

    def hear(self, name: str, link: bytes, stopped: bool, now: float) -> None:
        """Note what a link of a computer reports. Once no link of the computer reports a stop, the mirrored stop ends.

        Args:
            name: name of the computer.
            link: the computer's link that reports.
            stopped: whether that computer itself has latched its stop.
            now: present time, s.
        """
        if name == self._own:
            return
        computer = self._computers.get(name)
        if computer is None:
            if len(self._computers) >= _MOST:
                self._computers.pop(min(self._computers, key=lambda other: self._computers[other].heard_s))
            computer = self._computers[name] = _Computer()
        computer.heard_s, computer.said[link] = now, (stopped, now)
        computer.said = {link: said for link, said in computer.said.items() if now - said[1] < _GONE_S}
        before, computer.stopped = computer.stopped, any(said for said, _ in computer.said.values())
        if computer.stopped is not before:
            self.look(now)

    def look(self, now: float) -> None:
        """Latch here what other computers have latched, and update the attributes; call this periodically.

        A change that fails is tried again by the next call.
        """
        for name, computer in sorted(self._computers.items(), key=lambda item: item[1].stopped):  # releases first
            if not computer.stopped or computer.unwritten or now - computer.heard_s < _GONE_S:
                self._follow(name, computer)
        self.unwritten = any(computer.unwritten for computer in self._computers.values())
        reason, latched = self._stop.reason(), self.unwritten or self._stop.latched
        others = (n for n, c in self._computers.items() if c.unwritten or reason.startswith(self._prefix(n)))
        self.stopped = latched, next(others, self._own) if latched else self._own

    def _prefix(self, name: str) -> str:
        return f"{self._called} {name}: "

    def _follow(self, name: str, computer: _Computer) -> None:
        prefix = self._prefix(name)
        try:
            if computer.stopped and not self._stop.latched:
                EmergencyStop().latch(prefix + _WHY)  # a new object, since one that has failed never tries again
            elif not computer.stopped and self._stop.latched and self._stop.reason().startswith(prefix):
                self._stop.release()
                logger.warning("%semergency stop released, as there", prefix)
        except (OSError, ConfigError) as error:
            if not computer.failed:
                logger.error(
                    "%sits emergency stop cannot be %s here, and is tried again: %s; can %s be written to?",
                    prefix,
                    "latched" if computer.stopped else "released",
                    error,
                    self._stop.directory,
                )
            computer.failed, computer.unwritten = True, computer.stopped
        else:
            computer.failed = computer.unwritten = False
