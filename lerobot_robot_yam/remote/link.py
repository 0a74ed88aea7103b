"""Client's link to a host: receives states, sends commands and heartbeats, mirrors emergency stops both ways."""

import logging
import math
import secrets
from collections import deque
from collections.abc import Callable, Mapping
from typing import NamedTuple

from lerobot_robot_yam.control.process.lifeline import take_nudges
from lerobot_robot_yam.errors import LifeCycleError, LinkError, YamError
from lerobot_robot_yam.remote.host_address import machine_name, who
from lerobot_robot_yam.remote.host_question import Host, ask_over
from lerobot_robot_yam.remote.link_messages import Answer, Beat, Command, Echo, States
from lerobot_robot_yam.remote.link_sockets import ClientSockets
from lerobot_robot_yam.remote.mirrored_part import MirroredPart
from lerobot_robot_yam.remote.mirrored_stops import RELAYED, MirroredStops
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.system.clock import SYSTEM

logger = logging.getLogger(__name__)

_BEAT_S = 0.1  # heartbeat interval, s
_FIRST_S = 0.02  # heartbeat interval until the host's clock offset is known, s
_STOP_LOOK_S = 0.04  # interval between checks of the emergency stop, s
_WAIT_S = 0.02  # wait for messages from the host and commands from the local program, s
_LOST_S = 1.0  # silence after which the host counts as lost, s; later states may belong to another client
_START_S = 57.0  # timeout of energising arms, s; shorter than the local program's timeout for this process
_GONE_S = 5.0  # silence of the host that cancels a request, s; the host lands the arms by itself
LAND_S = 75.0  # timeout of a landing, s; longer than a landing takes
_LEAST = 5  # minimum number of echoes for a known clock offset
_WINDOW = 50  # number of echoes kept, 5 s of heartbeats: two clocks drift apart by 0.1 ms in that time
_DRIFT_S = 0.001  # offset change that clock drift can explain, s; after a larger change, earlier echoes are discarded
_LET_GO = "the host has let go of the arms (another client may have them); connect again"


class _Measured(NamedTuple):
    round_trip_s: float
    offset_s: float


class ClockOffset:
    """Offset between the host's monotonic clock and the local one, from the fastest recent round trip.

    An echo that was sent at t0, arrived at the host at t1, left the host at t2 and came back at t3 gives

        offset = ((t1 - t0) + (t2 - t3)) / 2        wrong by at most half of (t3 - t0) - (t2 - t1)

    (RFC 5905, section 8). The echo with the shortest round trip in the window counts, until another echo
    contradicts its offset: a monotonic clock stops while its computer sleeps.

    Attributes:
        offset_s: host's clock minus the local clock; NaN before the first echo.
        error_s: maximum error of offset_s.
    """

    def __init__(self) -> None:
        self._measured: deque[_Measured] = deque(maxlen=_WINDOW)
        self.offset_s, self.error_s = math.nan, math.inf

    @property
    def known(self) -> bool:
        """Whether there are enough echoes to trust the offset."""
        return len(self._measured) >= _LEAST

    def add(self, echo: Echo, now: float) -> None:
        """Add an echo that came back at `now`, s. Echoes with a negative round trip are ignored."""
        round_trip_s = (now - echo.sent_s) - (echo.answered_s - echo.received_s)
        if round_trip_s < 0.0 or echo.answered_s < echo.received_s:
            return
        offset_s = ((echo.received_s - echo.sent_s) + (echo.answered_s - now)) / 2.0
        if abs(offset_s - self.offset_s) > self.error_s + round_trip_s / 2.0 + _DRIFT_S:  # False for NaN
            self.clear()
        self._measured.append(_Measured(round_trip_s, offset_s))
        best = min(self._measured)
        self.offset_s, self.error_s = best.offset_s, best.round_trip_s / 2.0

    def clear(self) -> None:
        """Discard all echoes, after the host has restarted or a computer has slept."""
        self._measured.clear()
        self.offset_s, self.error_s = math.nan, math.inf


class Link:
    """Link to one host.

    Args:
        host: the host.
        arms: number on the host → arm whose states are mirrored; the owner of the link may change the mapping.
        drives: whether to send commands of these arms, once `start` has energised them.
        nudged: file descriptor that becomes readable when a command was written; None without commands.
    """

    def __init__(self, host: Host, arms: Mapping[int, MirroredPart], drives: bool = False, nudged: int | None = None):
        self._host, self._arms, self._nudged = host, arms, nudged
        self._sockets = ClientSockets(host.address, host.client_key(), also=nudged)
        self._session = secrets.randbits(62) + 1 if drives else 0
        self._started_s: float | None = None  # time since which the host accepts commands; None: not at all
        # whether the host has released the arms without a request; states may then be another client's
        self._let_go = False
        self._number = 0  # number of the newest command
        self._answer: Answer | None = None
        self._machine, self._told_stopped = machine_name(), False
        self._clock, self._stops = ClockOffset(), MirroredStops("host", self._machine)
        self._beat_s = self._look_s = -math.inf
        self._heard_s, self._lost, self._run = SYSTEM.now(), False, 0

    @property
    def up(self) -> bool:
        """Whether the host's clock offset and the states of all arms are known."""
        return self._clock.known and all(arm.known for arm in self._arms.values())

    def start(self, group: str, search: bool, unwanted: Callable[[], bool]) -> None:
        """Make the host energise a group. Commands are sent only afterwards.

        Args:
            group: "robot" or "teleop".
            search: whether to search for the grippers' stops.
            unwanted: callback, polled while waiting; if it returns True, the host releases the group.

        Raises:
            YamError: the host refuses, or does not reply.
            LifeCycleError: `unwanted` has returned True.
        """
        fields = {"group": group, "session": self._session, "who": who(), "search": search}
        try:
            self._ask("start", _START_S, unwanted, **fields)
            self._started_s = SYSTEM.now()
            while not self.up and self._started_s is not None and not unwanted():
                self.turn()
                if SYSTEM.now() > self._started_s + _GONE_S:
                    port = self._host.address.port + 1
                    raise LinkError(f"{self._host.address}: no states come; is port {port} open?")
        except LinkError:
            self.stop(group)  # the host may have energised the arms despite the error
            raise
        if unwanted():
            self.stop(group)
            raise LifeCycleError("nobody waits for the arms any more; the host has let go of them")

    def stop(self, group: str) -> bool:
        """Make the host land the group. Return whether its arms have landed; False, with a log entry, if unknown."""
        self._started_s = None
        try:
            landed = bool(self._ask("stop", LAND_S, group=group, session=self._session)["landed"])
        except YamError as error:
            logger.error("%s; it lands the arms by itself once it has missed this computer for long", error)
            return False
        if landed:
            for arm in self._arms.values():
                arm.note(Mode.OFF)
        return landed

    def _ask(
        self, op: str, within_s: float, unwanted: Callable[[], bool] = lambda: False, **fields: object
    ) -> dict[str, object]:
        """Send a request like `Host.ask` while the link keeps running. Raises LinkError: the host is silent."""

        def turn() -> Answer | None:
            self.turn()
            if SYSTEM.now() - self._heard_s > _GONE_S:
                raise LinkError(f"{self._host.address}: no word of the host for {_GONE_S:g} s; look there what it does")
            answer, self._answer = self._answer, None
            return answer

        def ahead_s() -> float | None:
            return None if math.isnan(self._clock.offset_s) else self._clock.offset_s

        return ask_over(self._sockets, turn, self._host.address, op, within_s, ahead_s, unwanted, **fields)

    def turn(self) -> None:
        """Run one round: wait briefly, then forward the host's messages and the local program's commands."""
        sockets = self._sockets
        came = sockets.wait(_WAIT_S)
        now = SYSTEM.now()
        if self._nudged is not None and self._nudged in came and not take_nudges(self._nudged):
            sockets.ignore(self._nudged)  # closed at the other end, so it would stay readable
            self._nudged = None
        try:
            if sockets.states in came and (states := sockets.newest_states()) is not None:
                self._take_states(states, now)
            while sockets.commands in came and (message := sockets.receive()) is not None:
                if isinstance(message, Answer):
                    self._answer = message
                elif isinstance(message, Echo):
                    self._take_echo(message)
        except LinkError as error:
            logger.warning("%s: %s", self._host.address, error)
        self._send_commands()
        self._beat(now)
        if now - self._heard_s > _LOST_S and not self._lost:
            self._lost = True
            logger.error("%s: no word of the host; the arms hold there", self._host.address)

    def _take_echo(self, echo: Echo) -> None:
        self._clock.add(echo, SYSTEM.now())
        # not the time of reading, because an echo may have waited in the queue
        self._heard_s = max(self._heard_s, echo.sent_s)
        if self._started_s is not None and not echo.held and echo.sent_s > self._started_s:
            self._started_s, self._let_go = None, True
            for arm in self._arms.values():
                arm.note(Mode.LAND, _LET_GO)
        if self._lost and SYSTEM.now() - self._heard_s < _LOST_S:
            self._lost = False
            logger.warning("%s: the host is back", self._host.address)

    def _take_states(self, states: States, now: float) -> None:
        if states.run != self._run:  # the host's program has restarted, and possibly its computer
            self._run = states.run
            self._clock.clear()
        if self._clock.known and now - self._heard_s < _LOST_S and not self._let_go:
            for number, record in states.parts:
                if (arm := self._arms.get(number)) is not None:
                    arm.write(record, self._clock.offset_s)
        if states.machine != self._machine:  # else the host has the same latches
            others = any(machine != self._machine for machine in states.stopped_by)
            self._stops.hear(str(self._host.address), b"", states.stopped, now)
            self._stops.hear(f"{self._host.address}{RELAYED}", b"", others, now)

    def _beat(self, now: float) -> None:
        """Send a heartbeat when due, or when this computer's emergency stop has been latched or released."""
        due = now - self._beat_s >= (_BEAT_S if self._clock.known else _FIRST_S)
        if not due and now - self._look_s < _STOP_LOOK_S:
            return
        self._look_s = now
        self._stops.look(now)  # other links of this computer may have changed the stop
        if due or self._stops.own is not self._told_stopped:
            self._beat_s, self._told_stopped = now, self._stops.own
            self._sockets.send(Beat(self._session, self._machine, now, self._told_stopped))

    def _send_commands(self) -> None:
        """Send new commands, with times converted to the host's clock."""
        if self._started_s is None or not self._clock.known:
            return
        for number, arm in self._arms.items():
            if (record := arm.command(self._clock.offset_s)) is not None:
                self._number += 1
                self._sockets.send(Command(self._session, self._number, number, record))

    def close(self) -> None:
        self._sockets.close()
