"""A python-can bus as the chain uses it: several frames per call, our errors, arrival times on our clock."""

import errno
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import can

from lerobot_robot_yam.errors import BusError
from lerobot_robot_yam.system.clock import clock_of
from lerobot_robot_yam.system.own_commands import as_root

RESET_LINK = as_root("yam-setup-can --reset")
"""Command that takes a link down and up as the arms need it; the channel's name follows."""

_STAMP_TRUST_S = 1.0  # largest age of a bus's own stamp that is used
_EPOCH_S = 1e9  # stamps above are seconds since 1970, as in python-can; below, seconds of the monotonic clock


def data_message(can_id: int, data: bytes) -> can.Message:
    """Make a classic data frame with an 11-bit identifier."""
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


def is_classic_data(message: can.Message) -> bool:
    """Return whether a motor or handle can have sent a frame: both send data frames with 11-bit identifiers only."""
    return not (message.is_extended_id or message.is_remote_frame or message.is_error_frame)


def _receiver(bus: can.BusABC) -> Callable[[float], can.Message | None]:
    """Return a `bus.recv` that waits by the monotonic clock.

    python-can's own (4.6) measures its wait with `time.time`. If the clock is set back by a second during the wait, it
    waits a second longer, `recv(0)` included, and motors that nobody commands let go after 0.4 s. No public call waits
    by another clock, so this uses `_recv_internal`, which interfaces implement and whose wait is the kernel's. This
    method also takes 0.2 µs per frame instead of 0.7. An interface that overrides `recv` keeps its own.
    """
    if getattr(bus.recv, "__func__", None) is not can.BusABC.recv:
        return bus.recv
    receive, matches = bus._recv_internal, bus._matches_filters

    def recv(timeout_s: float) -> can.Message | None:
        deadline_s = time.monotonic() + timeout_s if timeout_s > 0.0 else 0.0  # most calls do not wait
        while True:
            message, filtered = receive(timeout_s)
            if message is not None and (filtered or matches(message)):
                return message
            timeout_s = max(0.0, deadline_s - time.monotonic())
            if message is None and timeout_s == 0.0:
                return None

    return recv


class BusPort:
    """Sending and receiving on a bus that somebody else opened and will close.

    A bus may offer `send_many(messages)` to take a whole tick in one system call.
    """

    def __init__(self, bus: can.BusABC, channel: str):
        self.channel = channel
        self._send_one: Callable[[can.Message], None] = bus.send
        self._send_many: Callable[[Sequence[can.Message]], Any] | None = getattr(bus, "send_many", None)
        self._recv = _receiver(bus)
        self.clock = clock_of(bus)
        self._epoch_offset_s = 0.0
        self._asked_s = (-math.inf, -math.inf)  # when the last question but one was asked, and the last
        self.synchronise()

    def synchronise(self) -> None:
        """Note how far the epoch clock is from the monotonic one; the epoch clock may be stepped at any time.

        Call this before each question: a frame with a stamp before the previous question is stamped wrongly.
        """
        now = self.clock.now()
        self._epoch_offset_s = time.time() - now
        self._asked_s = (self._asked_s[1], now)

    def send(self, messages: Sequence[can.Message]) -> None:
        """Queue frames without waiting. Raises BusError: the channel is gone or its transmit queue is full."""
        try:
            if self._send_many is not None:
                self._send_many(messages)
            else:
                for message in messages:
                    self._send_one(message)
        except BusError:
            raise
        except (can.CanError, OSError) as error:
            raise self._error("send", error) from error

    def recv(self, timeout_s: float) -> can.Message | None:
        """Return the next frame, or None after `timeout_s`; 0 does not wait. Raises BusError: the channel is gone."""
        try:
            return self._recv(timeout_s)
        except BusError:
            raise
        except (can.CanError, OSError) as error:
            raise self._error("receive", error) from error

    def arrival_s(self, message: can.Message) -> float:
        """Return when the frame arrived (the clock's time): the bus's own stamp where that is believable, else now.

        The kernel (and the rig) stamp the arrival, while now is the later time of reading. An adapter's own clock
        drifts, and then an answer seems to have come before its question.
        """
        now = self.clock.now()
        stamp = message.timestamp
        if stamp > _EPOCH_S:
            stamp -= self._epoch_offset_s
        return stamp if max(now - _STAMP_TRUST_S, self._asked_s[0]) < stamp < now else now

    def _error(self, verb: str, error: Exception) -> BusError:
        number = getattr(error, "error_code", None) or getattr(error, "errno", None)
        if "buffer full" in str(error):  # python-can's text, which has no number
            number = errno.ENOBUFS
        if number == errno.ENOBUFS:
            advice = (
                "frames wait, and no motor takes them: check the motors' power and the cable; or too few may wait: "
                f"{RESET_LINK} {self.channel}"
            )
        else:
            advice = "check that the adapter is plugged in and the link is up (yam-setup-can --list); to bring it up: "
            advice += f"{RESET_LINK} {self.channel}"
        found = BusError(f"CAN channel {self.channel}: {verb} failed ({error}); {advice}")
        found.errno = number
        return found
