"""Switches and brake on the vendor's USB-GPIO converter: a thread polls it, so that the loop never waits for it.

    set outputs   3A, then pairs of channel and level       answer 2A and the same pairs
    read a range  5B first last pull (0: up)                answer 4B first last pull, then one level per channel

After a restart the converter sends 2A FF, which is no answer, and its outputs are no longer set.
"""

import contextlib
import logging
import math
import termios
import threading
import time

import serial

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.boards.switch_board import BoardSample

logger = logging.getLogger(__name__)

_BAUD = 115200
_ANSWER_S = 0.04  # wait for an answer, s; the vendor waits 0.2 s, but a sample of 0.1 s is too old here
_PERIOD_S, _BACKOFF_S = 0.005, 0.5  # interval of readings, s; at most that after failures, s
_ATTEMPTS = 2
_PULL_UP = 0
_LOST = (OSError, termios.error)  # errors of a port: those of pyserial are OSErrors; it passes on those of termios


class UsbBoard:
    """Driver of one converter.

    Args:
        port: serial port.
        channels: of upper switch, lower switch and brake.
    """

    def __init__(self, port: str, channels: tuple[int, ...]):
        self._port = port
        self._upper, self._lower, self._brake = channels
        self._first, self._last = sorted(channels[:2])
        self._wanted = True
        self._confirmed: bool | None = None
        self._sample = BoardSample(False, False, None, -math.inf)
        self._device = self._open()
        self._failures = 0
        self._wake, self._ended = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._poll, name="yam-rail-io", daemon=True)
        self._thread.start()

    def read(self) -> BoardSample:
        return self._sample

    def set_brake(self, on: bool) -> None:
        if on != self._wanted:
            self._wanted = on
            self._wake.set()

    def close(self) -> None:
        """End the thread, which sets the brake first if that is still to be done."""
        self._ended.set()
        self._wake.set()
        self._thread.join()
        self._device.close()

    def _open(self) -> serial.Serial:
        return serial.Serial(self._port, _BAUD, timeout=_ANSWER_S, write_timeout=_ANSWER_S, exclusive=True)

    def _poll(self) -> None:
        while not self._ended.is_set() or (self._confirmed is not self._wanted and self._failures == 0):
            self._wake.clear()
            try:
                heard = self._set_brake() & self._read_switches()
            except _LOST as error:  # unplugged: it may come back
                heard = False
                self._open_again(error)
            if not heard and self._failures == 0:
                logger.warning("rail: the converter on %s does not confirm or answer", self._port)
            self._failures = 0 if heard else self._failures + 1
            self._wake.wait(min(_PERIOD_S * 2**self._failures, _BACKOFF_S) if self._failures < 10 else _BACKOFF_S)

    def _open_again(self, error: Exception) -> None:
        if self._failures == 0:
            logger.error("rail: the converter on %s is lost: %s", self._port, error)
        self._confirmed = None
        with contextlib.suppress(*_LOST):
            self._device.close()
            self._device = self._open()

    def _set_brake(self) -> bool:
        """Set the output each time, since a converter that has restarted no longer has it; return whether it is so."""
        wanted = self._wanted
        pair = bytes((self._brake, not wanted))
        if self._ask(b"\x3a" + pair, b"\x2a" + pair, 0) is None:
            return False
        self._confirmed = wanted
        return True

    def _read_switches(self) -> bool:
        stamp_s, span = time.monotonic(), bytes((self._first, self._last, _PULL_UP))
        levels = self._ask(b"\x5b" + span, b"\x4b" + span, self._last - self._first + 1)
        if levels is None:
            return False
        upper, lower = (bool(levels[channel - self._first]) for channel in (self._upper, self._lower))
        self._sample = BoardSample(upper, lower, self._confirmed, stamp_s)
        return True

    def _ask(self, request: bytes, head: bytes, rest: int) -> bytes | None:
        """Send a request, twice if need be; return what follows `head` in the answer, `rest` bytes."""
        for _ in range(_ATTEMPTS):
            self._device.reset_input_buffer()
            self._device.write(request)
            answer = self._device.read(len(head) + rest)
            if len(answer) == len(head) + rest and answer.startswith(head):
                return bytes(answer[len(head) :])
        return None


def open_board(name: str, port: str, channels: tuple[int, ...]) -> UsbBoard:
    """Open the converter. Raises ConfigError, which begins with `name`: there is none on the port, or it is in use."""
    try:
        return UsbBoard(port, channels)
    except _LOST as error:
        raise ConfigError(
            f"{name}: {port} cannot be opened: {error}. Check that the converter is plugged in, that your user is in "
            "the group dialout, and that no other program uses it"
        ) from error
