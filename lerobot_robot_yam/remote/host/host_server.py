"""The host: answers its clients, and lets one at a time drive each group of arms.

Nothing is energised but by a client that asks for it. Targets go through the session of this computer, which checks
and limits them as it does a local program's; a client that is silent for too long has its arms landed.
"""

import logging
import platform
import queue
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from lerobot_robot_yam.errors import ConfigError, LinkError, YamError
from lerobot_robot_yam.remote.host.client_stops import ClientStops
from lerobot_robot_yam.remote.host.host_tools import HostTools
from lerobot_robot_yam.remote.host.hosted_group import HostedGroup, Phase, Reply
from lerobot_robot_yam.remote.host.state_stream import StateStream
from lerobot_robot_yam.remote.wire.host_address import package_version
from lerobot_robot_yam.remote.wire.link_messages import (
    VERSION,
    Beat,
    Echo,
    Kind,
    OtherVersionError,
    kind_of,
    number_of,
    pack_answer,
    pack_echo,
    text_of,
    unpack_beat,
    unpack_command,
    unpack_json,
)
from lerobot_robot_yam.remote.wire.transport import HostSockets
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.system.clock import SYSTEM

logger = logging.getLogger(__name__)

_LOOK_S = 0.04
_MOST_OPEN = 1000
_TOLD_S = 10.0  # between two lines about messages that were refused


class HostServer:
    """Serves until it is told to end.

    Args:
        sockets: which listen; closed at the end.
        groups: of arms.
        land_after_s: a client that is silent for so long has its arms landed.
        tools: what clients may have run here.
    """

    def __init__(self, sockets: HostSockets, groups: Sequence[HostedGroup], land_after_s: float, tools: HostTools):
        self._sockets, self._groups, self._land_after_s, self._tools = sockets, groups, land_after_s, tools
        for group in groups:
            group.leaders = frozenset(arm.key for other in groups for arm in other.arms if other is not group)
        self._group_of = {arm.number: group for group in groups for arm in group.arms}
        self._stops = ClientStops()
        self._stream = StateStream(groups, sockets.publish, lambda: self._stops.stopped)
        self._refused, self._told_s = 0, SYSTEM.now()
        self._open: set[tuple[bytes, int]] = set()  # questions that are not answered yet
        self._replies: queue.SimpleQueue[tuple[bytes, bytes]] = queue.SimpleQueue()  # of any thread

    def run(self, must_end: Callable[[], bool]) -> None:
        """Serve; at the end all arms are landed."""
        self._stream.start()
        look_s = SYSTEM.now()
        try:
            while not must_end():
                received = self._sockets.receive(_LOOK_S)
                if received is not None:
                    self._handle(*received)
                self._send_replies()
                if SYSTEM.now() >= look_s:
                    look_s = SYSTEM.now() + _LOOK_S
                    self._look()
        finally:
            for group in self._groups:
                group.land("the host ends")
            for group in self._groups:
                group.close()
            self._tools.close()
            self._send_replies()
            self._stream.stop()
            self._sockets.close()

    def _handle(self, client: bytes, message: bytes) -> None:
        """One message. What cannot be read, or does not count, is counted and has no effect."""
        received_s = SYSTEM.now()
        try:
            kind = kind_of(message)
            if kind is Kind.COMMAND:
                command = unpack_command(message)
                if command.arm not in self._group_of:
                    raise LinkError(f"there is no arm {command.arm}")
                self._group_of[command.arm].take(command)
            elif kind is Kind.BEAT:
                self._beat(client, unpack_beat(message), received_s)
            elif kind is Kind.ASK:
                self._ask(client, unpack_json(message))
            else:
                raise LinkError(f"a message of kind {kind.name} is none for a host")
        except OtherVersionError as error:
            self._note_refused(error, received_s)
            self._sockets.answer(client, pack_answer(0, {}))  # by which the client knows, too
        except LinkError as error:
            self._note_refused(error, received_s)
        except Exception:
            logger.exception("a message could not be handled; it has no effect")
            self._refused += 1

    def _note_refused(self, error: LinkError, now: float) -> None:
        self._refused += 1
        if self._refused == 1 or now - self._told_s > _TOLD_S:
            logger.warning("%d messages refused so far; the last: %s", self._refused, error)
            self._told_s = now

    def _beat(self, client: bytes, beat: Beat, received_s: float) -> None:
        held = [group.heard(beat.session) for group in self._groups]
        self._stops.hear(beat.machine, client, bool(beat.stopped), received_s)
        self._sockets.answer(client, pack_echo(Echo(beat.sent_s, received_s, SYSTEM.now(), any(held))))

    def _look(self) -> None:
        self._stops.look(SYSTEM.now())
        for group in self._groups:
            if self._stops.unwritten:
                group.land("a workstation's emergency stop cannot be latched here")
            if group.silent_s() > self._land_after_s and not any(other.led_by_hand for other in self._groups):
                group.land(f"its client has been silent for {self._land_after_s:g} s")

    def _ask(self, client: bytes, asked: Mapping[str, Any]) -> None:
        number = asked["number"]
        if (client, number) in self._open:  # asked again while it waits
            return
        if len(self._open) >= _MOST_OPEN:
            self._open.clear()
        self._open.add((client, number))

        def reply(fields: Mapping[str, Any]) -> None:
            self._open.discard((client, number))
            self._replies.put((client, pack_answer(number, fields)))

        try:
            op = text_of(asked, "op")
            if op == "hello":
                reply(self._told())
            elif op == "start":
                search = asked.get("search") is not False
                self._role(asked).start(number_of(asked, "session"), text_of(asked, "who"), search, reply)
            elif op == "stop":
                self._role(asked).stop(number_of(asked, "session"), reply)
            elif op == "tool":
                channel = text_of(asked, "channel") if "channel" in asked else ""
                self._tools.run(text_of(asked, "tool"), channel, asked.get("json") is True, reply)
            elif op == "estop":
                self._estop(asked, reply)
            else:
                raise LinkError(f"the host knows no {op!r}")
        except YamError as error:
            reply({"error": str(error), "kind": type(error).__name__})
            if isinstance(error, LinkError):
                raise

    def _role(self, asked: Mapping[str, Any]) -> HostedGroup:
        role = text_of(asked, "group")
        for group in self._groups:
            if group.role == role:
                return group
        raise ConfigError(f"the host's rig has no {role}; it has {', '.join(group.role for group in self._groups)}")

    def _estop(self, asked: Mapping[str, Any], reply: Reply) -> None:
        action, stop = text_of(asked, "action"), EmergencyStop()
        try:
            if action == "latch":
                stop.latch(f"{text_of(asked, 'who')}: {text_of(asked, 'why')}")
            elif action == "release":
                stop.release()
            elif action != "status":
                raise LinkError(f"an emergency stop has no {action!r}")
        except OSError as error:
            raise ConfigError(f"the host's emergency stop: {error}") from error
        self._stops.look(SYSTEM.now())
        heard = [group.role for group in self._groups if group.phase is not Phase.FREE]
        reply({"latched": stop.latched, "reason": stop.reason(), "heard_by": heard})

    def _told(self) -> dict[str, Any]:
        stop = EmergencyStop()
        return {
            "version": VERSION,
            "package": package_version(),
            "computer": platform.node(),
            "land_after_s": self._land_after_s,
            "groups": {group.role: group.told() for group in self._groups},
            "stop": stop.reason() if stop.latched else "",
            "refused": self._refused,
        }

    def _send_replies(self) -> None:
        while not self._replies.empty():
            self._sockets.answer(*self._replies.get())
