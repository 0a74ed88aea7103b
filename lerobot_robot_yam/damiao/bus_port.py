"""Wrapper of a python-can bus: several frames per call, errors of this package, arrival times on the bus's clock."""

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
"""Command that brings a link down and up with the settings that arms need; append the channel's name."""

_STAMP_TRUST_S = 1.0  # maximum age at which a frame's timestamp is used
_EPOCH_S = 1e9  # timestamps above this are seconds since 1970, as in python-can; others are monotonic times


def data_message(can_id: int, data: bytes) -> can.Message:
    """Create a classic data frame with an 11-bit identifier."""
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


def is_classic_data(message: can.Message) -> bool:
    """Return whether a motor or handle can have sent this frame: both send only data frames with 11-bit identifiers."""
    return not (message.is_extended_id or message.is_remote_frame or message.is_error_frame)


def _receiver(bus: can.BusABC) -> Callable[[float], can.Message | None]:
    """Return a replacement of `bus.recv` that measures its timeout with the monotonic clock.

    python-can (4.6) measures timeouts with `time.time`. If that clock is set back by a second during the wait, `recv`
    waits a second longer, even with timeout 0, and motors without commands go limp after 0.4 s. No public method waits
    on another clock, so this function calls `_recv_internal`, which interfaces implement and which waits in the kernel.
    It also costs 0.2 µs per frame instead of 0.7. The method of an interface that overrides `recv` is returned as is.
    """
    if getattr(bus.recv, "__func__", None) is not can.BusABC.recv:
        return bus.recv
    receive, matches = bus._recv_internal, bus._matches_filters

    def recv(timeout_s: float) -> can.Message | None:
        deadline_s = time.monotonic() + timeout_s if timeout_s > 0.0 else 0.0  # timeout 0 is the usual case
        while True:
            message, filtered = receive(timeout_s)
            if message is not None and (filtered or matches(message)):
                return message
            timeout_s = max(0.0, deadline_s - time.monotonic())
            if message is None and timeout_s == 0.0:
                return None

    return recv


class BusPort:
    """Sending and receiving on a bus that the caller opens and closes.

    A bus may offer `send_many(messages)` to queue the frames of a whole tick in one system call.
    """

    def __init__(self, bus: can.BusABC, channel: str):
        self.channel = channel
        self._send_one: Callable[[can.Message], None] = bus.send
        self._send_many: Callable[[Sequence[can.Message]], Any] | None = getattr(bus, "send_many", None)
        self._recv = _receiver(bus)
        self.clock = clock_of(bus)
        self._epoch_offset_s = 0.0
        self._asked_s = (-math.inf, -math.inf)  # times of the last two requests, older one first
        self.synchronise()

    def synchronise(self) -> None:
        """Measure the offset between the epoch clock and the monotonic clock; the epoch clock may be stepped any time.

        Call this before each request: timestamps before the previous request are rejected as wrong.
        """
        now = self.clock.now()
        self._epoch_offset_s = time.time() - now
        self._asked_s = (self._asked_s[1], now)

    def send(self, messages: Sequence[can.Message]) -> None:
        """Queue frames without waiting. Raises BusError: the channel is lost or its transmit queue is full.

        python-can's interfaces also raise errors of libusb, pyserial and `struct`, which have no class in common.
        """
        try:
            if self._send_many is not None:
                self._send_many(messages)
            else:
                for message in messages:
                    self._send_one(message)
        except BusError:
            raise
        except Exception as error:
            raise self._error("send", error) from error

    def recv(self, timeout_s: float) -> can.Message | None:
        """Return the next frame, or None after `timeout_s`; 0 does not wait. Raises BusError: the channel is lost."""
        try:
            return self._recv(timeout_s)
        except BusError:
            raise
        except Exception as error:  # see `send`
            raise self._error("receive", error) from error

    def arrival_s(self, message: can.Message) -> float:
        """Return when the frame arrived (the bus's clock): the frame's timestamp if plausible, else the current time.

        The kernel (and the rig) timestamp the arrival, whereas the current time is the later time of reading. An
        adapter's own clock drifts, so that a reply could seem to have arrived before its request.
        """
        now = self.clock.now()
        stamp = message.timestamp
        if stamp > _EPOCH_S:
            stamp -= self._epoch_offset_s
        return stamp if max(now - _STAMP_TRUST_S, self._asked_s[0]) < stamp < now else now

    def _error(self, verb: str, error: Exception) -> BusError:
        number = getattr(error, "error_code", None) or getattr(error, "errno", None)
        if "buffer full" in str(error):  # python-can raises this without an error number
            number = errno.ENOBUFS
        if number == errno.ENOBUFS:
            advice = (
                "frames wait, and no motor takes them: check the motors' power and the cable; or too few may wait: "
                f"{RESET_LINK} {self.channel}"
            )
        else:
            advice = "check that the adapter is plugged in and the link is up (yam-setup-can --list); to bring it up: "
            advice += f"{RESET_LINK} {self.channel}"
        what = str(error) if isinstance(error, can.CanError | OSError) else repr(error)
        found = BusError(f"CAN channel {self.channel}: {verb} failed ({what}); {advice}")
        found.errno = number if isinstance(number, int) else None
        return found
