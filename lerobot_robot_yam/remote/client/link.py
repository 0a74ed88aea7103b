"""A client's link to a host: states come, commands and signs of life go, the emergency stop goes both ways."""

import logging
import math
import secrets
import struct
from collections.abc import Callable, Mapping

from lerobot_robot_yam.control.process.lifeline import take_nudges
from lerobot_robot_yam.errors import LifeCycleError, LinkError, YamError
from lerobot_robot_yam.remote.client.host_question import Asker, Host
from lerobot_robot_yam.remote.client.state_mirror import StateMirror
from lerobot_robot_yam.remote.wire.clock_offset import ClockOffset
from lerobot_robot_yam.remote.wire.host_address import machine_number, who
from lerobot_robot_yam.remote.wire.link_messages import (
    Beat,
    Command,
    Kind,
    kind_of,
    pack_beat,
    pack_command,
    unpack_echo,
    unpack_states,
)
from lerobot_robot_yam.remote.wire.mirrored_stop import MirroredStop
from lerobot_robot_yam.remote.wire.transport import ClientSockets
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import COMMAND_DTYPE, KEY_BYTES
from lerobot_robot_yam.system.clock import SYSTEM
from lerobot_robot_yam.system.shared_block import SharedBlock

logger = logging.getLogger(__name__)

_BEAT_S = 0.1
_STOP_LOOK_S = 0.04
_FIRST_S = 0.02  # between signs of life until the host's clock is known
_WAIT_S = 0.02  # for messages of the host and commands of our program
_LOST_S = 1.0  # without a word of the host: told in the log
_ECHOES = 5  # before times of the host mean anything
_START_S = 57.0  # less than what our program waits for us
_GONE_S = 5.0  # without a word of the host: nothing more comes of what it was asked; it lands the arms alone
LAND_S = 75.0  # longer than a landing takes
_TIME = struct.Struct("<d")
_TIMES_AT = [COMMAND_DTYPE.fields[name][1] for name in ("target_stamp_s", "coupled_until_s", "request_stamp_s")]  # type: ignore[index]
_LEADER_AT = COMMAND_DTYPE.fields["leader"][1]  # type: ignore[index]
_LEADER = slice(_LEADER_AT, _LEADER_AT + KEY_BYTES)
_LET_GO = "the host has let go of the arms (another client may have them); connect again"


class Link:
    """To one host.

    Args:
        host: which.
        mirror: for its states.
        commands: command blocks of the arms that are driven, by their number on the host; none: it only watches.
        leaders: keys of leaders' channels here and there, for followers that follow one.
        nudged: descriptor that can be read when something was commanded; None: it only watches.
    """

    def __init__(
        self,
        host: Host,
        mirror: StateMirror,
        commands: Mapping[int, SharedBlock],
        leaders: Mapping[str, str],
        nudged: int | None = None,
    ):
        self._host, self._mirror, self._commands, self._nudged = host, mirror, commands, nudged
        self._leaders = {here.encode(): there.encode() for here, there in leaders.items()}
        self._sockets = ClientSockets(host.address, host.client_key(), also=nudged)
        self._asker = Asker(host, self._sockets, self._turn_while_there)
        self._session = secrets.randbits(63) + 1 if commands else 0
        self._seen = dict.fromkeys(commands, 0)
        self._drives, self._begin_s = False, math.inf  # the host takes commands; since when
        self._let_go = False  # it has let go of the arms without being asked: their states may be another client's
        self._sequence = 0
        self._clock, self._stop = ClockOffset(), MirroredStop(f"host {host.address}")
        self._machine, self._stopped = machine_number(), False
        self._theirs: bool | None = None  # whether the host's stop is latched, if it has said so since the last look
        self._beat_s = self._look_s = -math.inf
        self._heard_s, self._lost, self._run = SYSTEM.now(), False, 0

    @property
    def up(self) -> bool:
        """Whether the host's states are known, and its clock."""
        return len(self._clock) >= _ECHOES and self._mirror.complete

    def start(self, group: str, search: bool, unwanted: Callable[[], bool]) -> None:
        """Have the host energise a group; until then nothing is commanded.

        Args:
            group: which.
            search: whether stops of grippers are sought.
            unwanted: asked again and again; once it says True the host lets go of the group.

        Raises:
            YamError: what the host says, or that it says nothing.
            LifeCycleError: unwanted.
        """
        fields = {"group": group, "session": self._session, "who": who(), "search": search}
        try:
            self._drives = bool(self._asker.ask("start", _START_S, unwanted, **fields))
        except LinkError:
            self.stop(group)  # it may have energised them by now
            raise
        self._begin_s = SYSTEM.now()
        deadline = SYSTEM.now() + _GONE_S
        while not self.up and self._drives and not unwanted():
            self.turn()
            if SYSTEM.now() > deadline:
                self.stop(group)
                raise LinkError(f"{self._host.address}: no states come; is port {self._host.address.port + 1} open?")
        if unwanted():
            self.stop(group)
            raise LifeCycleError("nobody waits for the arms any more; the host has let go of them")

    def stop(self, group: str) -> bool:
        """Have the host land the group; whether its arms are down. Says so in the log where they are not."""
        self._drives = False
        landed = False
        deadline = SYSTEM.now() + LAND_S
        while SYSTEM.now() < deadline:
            try:
                landed = bool(self._asker.ask("stop", _GONE_S, group=group, session=self._session)["landed"])
                break
            except LinkError as error:
                if SYSTEM.now() - self._heard_s > _GONE_S:
                    logger.error("%s; it lands the arms by itself once it has missed this computer for long", error)
                    break
            except YamError as error:
                logger.warning("%s", error)
                SYSTEM.sleep(_BEAT_S)
        if landed:
            self._mirror.note(Mode.OFF)
        return landed

    def turn(self) -> None:
        """One round: wait a little, pass on what has come from the host, and what our program commands."""
        sockets = self._sockets
        came = sockets.wait(_WAIT_S)
        now = SYSTEM.now()
        if self._nudged is not None and self._nudged in came and not take_nudges(self._nudged):
            sockets.ignore(self._nudged)  # it could be read without end
            self._nudged = None
        if sockets.states in came and (message := sockets.newest_states()) is not None:
            self._take_states(message)
        while sockets.commands in came and (message := sockets.receive()) is not None:
            self._hear(message)
        self._send_commands()
        self._look_at_stop(now)
        if now - self._beat_s >= (_BEAT_S if len(self._clock) >= _ECHOES else _FIRST_S):
            self._beat_s, self._stopped = now, self._stop.own  # as it is now: other links of ours may have told it
            self._sockets.send(pack_beat(Beat(self._session, self._machine, now, self._stopped)))
        if now - self._heard_s > _LOST_S and not self._lost:
            self._lost = True
            logger.error("%s: no word of the host; the arms hold there", self._host.address)

    def _turn_while_there(self) -> None:
        """One round while the host is asked for something, which takes long. Raises LinkError: the host has gone."""
        self.turn()
        if SYSTEM.now() - self._heard_s > _GONE_S:
            raise LinkError(f"{self._host.address}: no word of the host for {_GONE_S:g} s; look there what it does")

    def _hear(self, message: bytes) -> None:
        """Any message but of states."""
        try:
            if kind_of(message) is not Kind.ECHO:
                self._asker.hear(message)
                return
            echo = unpack_echo(message)
        except LinkError as error:
            logger.warning("%s: %s", self._host.address, error)
            return
        now = SYSTEM.now()
        self._clock.add(echo, now)
        self._heard_s = now
        if self._drives and not echo.held and echo.sent_s > self._begin_s:
            self._drives, self._let_go = False, True
            self._mirror.note(Mode.LAND, _LET_GO)
        if self._lost:
            self._lost = False
            logger.warning("%s: the host is back", self._host.address)

    def _take_states(self, message: bytes) -> None:
        try:
            states = unpack_states(message)
        except LinkError as error:
            logger.warning("%s: %s", self._host.address, error)
            return
        if states.run != self._run:  # the host has been started anew; its computer may have been, too
            self._run = states.run
            self._clock.clear()
        quiet_s = SYSTEM.now() - self._heard_s  # after so long the arms may be another client's
        if len(self._clock) >= _ECHOES and quiet_s < _LOST_S and not self._let_go:
            self._mirror.write(states.arms, self._clock.offset_s)
        self._theirs = None if states.stopped_by == self._machine else bool(states.stopped)

    def _look_at_stop(self, now: float) -> None:
        """Follow the host's stop. One of our own is told at once."""
        if now - self._look_s >= _STOP_LOOK_S:
            self._look_s = now
            theirs, self._theirs = self._theirs, None
            if theirs is not None:
                self._stop.follow(theirs, "its emergency stop is latched; `yam-estop release` there")
            if self._stop.own is not self._stopped:
                self._beat_s = -math.inf

    def _send_commands(self) -> None:
        """Pass on command records that are new, with their times by the host's clock."""
        if not self._drives or len(self._clock) < _ECHOES:
            return
        for arm, block in self._commands.items():
            sequence = block.sequence()
            if sequence == self._seen[arm]:
                continue
            payload = block.glance_bytes()
            if payload is None:  # being written: at the next look
                continue
            self._seen[arm] = sequence
            self._sequence += 1
            record = bytearray(payload)
            for at in _TIMES_AT:
                _TIME.pack_into(record, at, _TIME.unpack_from(record, at)[0] + self._clock.offset_s)
            if leader := payload[_LEADER].rstrip(b"\0"):
                record[_LEADER] = self._leaders.get(leader, b"").ljust(KEY_BYTES, b"\0")
            self._sockets.send(pack_command(Command(self._session, self._sequence, arm, record)))

    def close(self) -> None:
        """Let go of sockets and blocks."""
        self._sockets.close()
        self._mirror.close()
