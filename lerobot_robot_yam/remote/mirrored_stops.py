"""Mirror of other computers' emergency stops: a stop latched or released there is latched or released here, too.

Each computer's stop is a source of its own here. Its release there removes its own latch here, and no other: the arms
stay stopped while anybody else has stopped them. A mirrored stop that is released on this computer is latched again.

A computer reports only its own stop, never what it mirrors from the same link; so no stop keeps itself alive. A host
relays its workstations' stops to each other under their names, and a workstation relays none of these.

Each program on a computer has its own link and checks the computer's latch at different times. Therefore a computer
counts as stopped while any of its links reports a stop.
"""

import logging
from dataclasses import dataclass, field

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.state.stop_latch import StopLatch, source_name

logger = logging.getLogger(__name__)

RELAYED = ":relayed"  # end of the name under which a workstation mirrors what a host only relays
_ROLES = ("host", "workstation")
_GONE_S = 2.0  # silence of a computer, s, after which its stop may be released on this computer
_MOST = 64  # maximum number of remembered computers
_WHY = "its emergency stop is latched; `yam-estop release` there"


@dataclass
class _Computer:
    heard_s: float = 0.0
    stopped: bool = False
    # link → (its last report, time of the report in s)
    said: dict[bytes, tuple[bool, float]] = field(default_factory=dict)
    told: bool = False  # whether its stop was logged
    failed: bool = False  # whether latching or releasing this computer's stop failed the last time
    unwritten: bool = False  # whether this computer's stop cannot be latched locally


class MirroredStops:
    """Latches of this computer, with the stops of other computers mirrored into them.

    Args:
        called: role of the other computers, "host" or "workstation"; the source of a mirrored stop begins with it.
        name: name of this computer in reports. Reports with this name are ignored: programs on one computer share the
            latches.

    Attributes:
        own: whether this computer itself has latched the stop.
        others: names of the other computers whose stops are latched here, or should be but cannot.
        unwritten: whether another computer's stop cannot be latched here.
    """

    def __init__(self, called: str, name: str) -> None:
        self._stop, self._called, self.name = StopLatch(), called, name
        self._computers: dict[str, _Computer] = {}
        self.own, self.others, self.unwritten = False, list[str](), False

    def hear(self, name: str, link: bytes, stopped: bool, now: float) -> None:
        """Record a report from a link. When no link of a computer reports a stop, its mirrored stop is released.

        Args:
            name: name of the computer.
            link: id of the computer's link that reports.
            stopped: whether that computer itself has latched its stop.
            now: current time, s.
        """
        if name == self.name:
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
        latched = self._stop.names()
        for name, computer in self._computers.items():
            if not computer.stopped or computer.unwritten or now - computer.heard_s < _GONE_S:
                self._follow(name, computer, self._source(name) in latched)
        latched = self._stop.names()
        self.unwritten = any(computer.unwritten for computer in self._computers.values())
        sources = {self._source(name): name for name in self._computers}
        self.others = [n for s, n in sources.items() if s in latched or self._computers[n].unwritten]
        (role,) = (role for role in _ROLES if role != self._called)  # of mirrors in which this computer is another's
        self.own = any(not (s in sources or s.startswith(f"{role}:") or s.endswith(RELAYED)) for s in latched)

    def _source(self, name: str) -> str:
        return source_name(f"{self._called}:{name}")

    def _follow(self, name: str, computer: _Computer, latched: bool) -> None:
        prefix = f"{self._called} {name}: "
        try:
            if computer.stopped and not latched:
                self._stop.latch(prefix + _WHY, self._source(name))
                if not computer.told:  # without room for its name, the latch is written again and again
                    computer.told = True
                    logger.error("emergency stop: %s%s", prefix, _WHY)
            elif not computer.stopped and latched:
                self._stop.release(self._source(name))
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
            computer.told &= computer.stopped
