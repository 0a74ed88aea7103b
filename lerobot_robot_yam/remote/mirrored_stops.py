"""Mirror of other computers' emergency stops: a stop latched or released there is latched or released here, too.

Each computer reports only its own stop, never a mirrored one. Therefore a stop is released where it was latched: a
mirrored stop that is released on this computer is latched again.

Each program on a computer has its own link and checks the computer's latch at different times. Therefore a computer
counts as stopped while any of its links reports a stop.
"""

import logging
from dataclasses import dataclass, field

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.state.emergency_stop import EmergencyStop

logger = logging.getLogger(__name__)

_GONE_S = 2.0  # silence of a computer, s, after which its stop may be released on this computer
_MOST = 64  # maximum number of remembered computers
_WHY = "its emergency stop is latched; `yam-estop release` there"


@dataclass
class _Computer:
    heard_s: float = 0.0
    stopped: bool = False
    # link → (its last report, time of the report in s)
    said: dict[bytes, tuple[bool, float]] = field(default_factory=dict)
    failed: bool = False  # whether latching or releasing this computer's stop failed the last time
    unwritten: bool = False  # whether this computer's stop cannot be latched locally


class MirroredStops:
    """Latch of this computer, with the stops of other computers mirrored into it.

    Args:
        called: role of the other computers, "host" or "workstation"; the reason of a mirrored stop begins with it.
        own: name of this computer in reports. Reports with this name are ignored: programs on one computer share a
            latch, and a stop mirrored into its own latch would never end.

    Attributes:
        stopped: (whether the emergency stop is latched here or should be but cannot, computer whose stop it is).
        unwritten: whether another computer's stop cannot be latched here.
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
        """Record a report from a link. When no link of a computer reports a stop, its mirrored stop is released.

        Args:
            name: name of the computer.
            link: id of the computer's link that reports.
            stopped: whether that computer itself has latched its stop.
            now: current time, s.
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
        """Latch here what other computers have latched, and update the attributes. Call `look` periodically.

        A change that fails is retried by the next call.
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
                EmergencyStop().latch(prefix + _WHY)  # new object: a stop that failed once never tries again
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
