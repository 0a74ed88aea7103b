"""Server of the host: replies to clients, and lets one client at a time drive each group of arms.

Arms are energised only when a client requests it. Targets pass through this computer's session, with the same checks
and limits as targets of a local program. If a client is silent for too long, its arms are landed.
"""

import contextlib
import logging
import math
import platform
import secrets
import threading
from collections import deque
from collections.abc import Callable, Hashable, Sequence
from typing import Any

from lerobot_robot_yam.errors import ConfigError, LinkError, YamError
from lerobot_robot_yam.remote.host_address import machine_name, package_version
from lerobot_robot_yam.remote.hosted_group import HostedGroup, Phase
from lerobot_robot_yam.remote.link_messages import (
    Answer,
    Beat,
    Command,
    Echo,
    OtherVersionError,
    Question,
    States,
    decode,
)
from lerobot_robot_yam.remote.link_sockets import HostSockets
from lerobot_robot_yam.remote.mirrored_stops import MirroredStops
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.stop_latch import source_name
from lerobot_robot_yam.system.clock import SYSTEM
from lerobot_robot_yam.system.realtime import request_scheduling

logger = logging.getLogger(__name__)

RunTool = Callable[[Hashable, str, str, bool], dict[str, Any] | None]

_LOOK_S = 0.04  # interval between checks of emergency stops and silent clients, s
_REFUSED_S = 10.0  # minimum time between two log entries about refused messages, s
_RT_PRIORITY = 15  # real-time priority, below that of control loops
_LEAST_S = 0.002  # minimum time between two states messages, s: some control loops tick as fast as their bus allows
_QUIET_S = 0.1  # interval between states messages while no arm runs, s
_OLD_S = 0.5  # maximum age of a request that energises, releases or runs something, s; it is resent every 0.1 s
_MOST_TEXT = 400  # maximum number of logged characters of a client's text


class StateStream:
    """Thread that publishes the newest states of all arms, directly after each tick of a control loop.

    Args:
        groups: groups of the host; ticks of the first running group trigger the messages.
        stops: source for which machines have latched the emergency stop.
        publish: callback that sends states to all clients.
    """

    def __init__(self, groups: Sequence[HostedGroup], stops: MirroredStops, publish: Callable[[States], None]):
        self._stops, self._publish = stops, publish
        self._parts = [part for group in groups for part in group.parts]
        self._leads = [group.parts[-1] for group in groups]
        self._run = secrets.randbits(62) + 1
        self._sent, self._sent_s = 0, 0.0  # state number before the last message, and time of that message
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._stream, name="yam-states", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread. Idempotent."""
        self._ended.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _stream(self) -> None:
        request_scheduling(_RT_PRIORITY)
        while not self._ended.is_set():
            try:
                self._await_tick()
                parts = [(part.number, record) for part in self._parts if (record := part.record()) is not None]
                self._publish(States(self._run, self._stops.name, self._stops.own, self._stops.others, parts))
            except Exception:
                logger.exception("states were not sent")
                self._ended.wait(_QUIET_S)

    def _await_tick(self) -> None:
        """Wait for the next tick of the first running group."""
        client = next((client for part in self._leads if (client := part.client) is not None), None)
        if client is None:
            self._ended.wait(_QUIET_S)
            return
        SYSTEM.sleep(max(0.0, self._sent_s + _LEAST_S - SYSTEM.now()))
        with contextlib.suppress(YamError, ValueError):  # closed in the meantime
            self._sent = client.await_next(self._sent)
        self._sent_s = SYSTEM.now()


class HostServer:
    """Server that runs until `must_end` of `run` returns True.

    Args:
        sockets: listening sockets; the server closes them at the end.
        groups: the groups of arms.
        land_after_s: a client's arms are landed after this time without a message from the client, s.
        run_tool: callback that runs a tool on this computer for a client; see `HostTools.run`.
    """

    def __init__(self, sockets: HostSockets, groups: Sequence[HostedGroup], land_after_s: float, run_tool: RunTool):
        self._sockets, self._groups, self._land_after_s, self._run_tool = sockets, groups, land_after_s, run_tool
        for group in groups:
            others = frozenset(part.key for other in groups for part in other.parts if other is not group)
            for part in group.parts:
                part.leaders = others
        self._group_of = {part.number: group for group in groups for part in group.parts}
        self._stops = MirroredStops("workstation", machine_name())
        self._stream = StateStream(groups, self._stops, sockets.publish)
        # numbers of handled estop requests; clients count from random numbers
        self._acted: deque[int] = deque(maxlen=100)
        self._refused_s = -math.inf  # time of the last log entry about a refused message

    def run(self, must_end: Callable[[], bool]) -> None:
        """Serve until `must_end` returns True, then land all arms."""
        self._stream.start()
        look_s = 0.0
        try:
            while not must_end():
                received = self._sockets.receive(_LOOK_S)
                if received is not None:
                    self._handle(*received)
                if SYSTEM.now() >= look_s:
                    look_s = SYSTEM.now() + _LOOK_S
                    self._look()
        finally:
            for group in self._groups:
                group.land("the host ends")
            for group in self._groups:
                group.close()
            self._stream.stop()
            self._sockets.close()

    def _handle(self, client: bytes, data: bytes) -> None:
        """Handle one message. A malformed or forbidden message has no effect."""
        received_s = SYSTEM.now()
        try:
            message = decode(data)
            if isinstance(message, Command):
                if message.part not in self._group_of:
                    raise LinkError(f"there is no arm or base {message.part}")
                self._group_of[message.part].take(message)
            elif isinstance(message, Beat):
                held = [group.heard(message.session) for group in self._groups]
                self._stops.hear(message.machine, client, message.stopped, received_s)
                self._sockets.answer(client, Echo(message.sent_s, received_s, SYSTEM.now(), any(held)))
            elif isinstance(message, Question):
                self._sockets.answer(client, self._answer(client, message))
            else:
                raise LinkError("a message that only a host sends has come")
        except LinkError as error:
            if received_s - self._refused_s > _REFUSED_S:
                self._refused_s = received_s
                logger.warning("a message is refused: %s", error)
            if isinstance(error, OtherVersionError):
                self._sockets.answer(client, Answer(0))  # this reply shows the client that the versions differ
        except Exception:
            logger.exception("a message could not be handled; it has no effect")

    def _look(self) -> None:
        self._stops.look(SYSTEM.now())
        for group in self._groups:
            if self._stops.unwritten:
                group.land("a workstation's emergency stop cannot be latched here")
            if group.silent_s > self._land_after_s and not any(other.led_by_hand for other in self._groups):
                group.land(f"its client has been silent for {self._land_after_s:g} s")

    def _answer(self, client: bytes, question: Question) -> Answer:
        try:
            return Answer(question.number, self._result(client, question))
        except YamError as error:
            return Answer(question.number, None, str(error), type(error).__name__)

    def _result(self, client: bytes, asked: Question) -> dict[str, Any] | None:
        """Return the result of a request; None: not done yet, the client resends. Raises YamError: refused."""
        if asked.op == "hello":
            return self._told()
        if self._is_late(asked):
            return None
        if asked.op == "tool":
            return self._run_tool((client, asked.number), asked.tool, asked.channel, asked.json)
        if asked.op == "estop":
            return self._estop(asked)
        group = next((group for group in self._groups if group.role == asked.group), None)
        if group is None:
            roles = ", ".join(group.role for group in self._groups)
            raise ConfigError(f"the host's rig has no {asked.group}; it has {roles}")
        if asked.session == 0:
            raise LinkError("a client that drives arms has a session")
        if asked.op == "start":
            return {"ready": True} if group.start(asked.session, _printable(asked.who), asked.search) else None
        landed = group.stop(asked.session)
        return None if landed is None else {"landed": landed}

    @staticmethod
    def _is_late(asked: Question) -> bool:
        """Whether a request that makes something happen is old: its client may be dead, and a live client resends it.

        Landing and stopping are never too late.
        """
        age_s = SYSTEM.now() - asked.sent_s
        if abs(age_s) <= _OLD_S or asked.op == "stop" or (asked.op == "estop" and asked.action != "release"):
            return False
        if asked.sent_s > 0.0:
            logger.warning("a request (%s) is %.1f s old: not carried out", asked.op, age_s)
        return True

    def _estop(self, asked: Question) -> dict[str, Any]:
        stop = EmergencyStop()
        if asked.number not in self._acted:  # a resent request must not undo later changes by others
            try:
                if asked.action == "latch":
                    stop.latch(_printable(f"{asked.who}: {asked.why}"), asked.who)
                elif asked.action == "release":
                    stop.release(*asked.sources or [source_name(asked.who)])
            except OSError as error:
                raise ConfigError(f"the host's emergency stop: {error}") from error
            self._acted.append(asked.number)
        self._stops.look(SYSTEM.now())
        heard = [group.role for group in self._groups if group.phase is not Phase.FREE]
        sources = stop.sources()
        return {"latched": stop.latched, "reason": "; ".join(sources.values()), "sources": sources, "heard_by": heard}

    def _told(self) -> dict[str, Any]:
        stop = EmergencyStop()
        return {
            "package": package_version(),
            "computer": platform.node(),
            "groups": {group.role: group.told() for group in self._groups},
            "stop": stop.reason() if stop.latched else "",
        }


def _printable(text: str) -> str:
    """Replace control characters in a client's text, which could move the terminal's cursor; truncate the text."""
    return "".join(character if character.isprintable() else "?" for character in text)[:_MOST_TEXT]
