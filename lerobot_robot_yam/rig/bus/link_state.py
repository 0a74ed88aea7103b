"""State of a channel's network interface, and the SocketCAN errors that its clients get while the interface is not up.

The state is one 64-bit word per channel in sealed memory: the rig writes the word, and each client reads it before each
send or receive. Reading is nearly free, and the word also reaches a client that never reads its socket.
"""

import errno
import os
from collections.abc import Callable, Sequence
from enum import IntEnum
from pathlib import Path

import can

from lerobot_robot_yam.system import sealed_memory

BUS_OFF_FRAME_ID = 0x40  # identifier of the error frame for bus-off: CAN_ERR_BUSOFF in linux/can/error.h
TX_QUEUE_FRAMES = 10  # length of the kernel's default queue of a CAN interface
_WORD = 8
_STATE_BITS, _UNPLUG_BITS = 8, 24  # sizes of the two lowest fields of the word; the other bits count changes


class LinkState(IntEnum):
    """State of the interface as the operating system reports it."""

    UP = 0
    DOWN = 1  # `ip link set canX down`
    GONE = 2  # the adapter is unplugged
    BUS_OFF = 3  # the controller left the bus after too many errors


class Link:
    """Interface of one channel, on the rig's side.

    Attributes:
        word: list of one element, the interface's word, which `watch_link` maps into other processes.
        publish: callback that receives the word after each change.
        unplugs: number of times that the adapter was unplugged.
    """

    def __init__(self) -> None:
        self.state = LinkState.UP
        self.publish: Callable[[int], None] = lambda word: None
        self._down = self._gone = self._bus_off = False
        self.unplugs = self._changes = 0
        self.word = [int(self.state)]

    def change(self, down: bool | None = None, gone: bool | None = None, bus_off: bool | None = None) -> None:
        """Set the interface down, its adapter gone or its controller bus-off, or undo this; None changes nothing.

        Down and gone also end a bus-off, as on a real controller.
        """
        self.unplugs += bool(gone) and not self._gone
        self._bus_off = (self._bus_off if bus_off is None else bus_off) and not (down or gone)
        self._down = self._down if down is None else down
        self._gone = self._gone if gone is None else gone
        if self._gone:
            self.state = LinkState.GONE
        elif self._down:
            self.state = LinkState.DOWN
        else:
            self.state = LinkState.BUS_OFF if self._bus_off else LinkState.UP
        self._changes += 1
        self.word[0] = (self._changes << _UNPLUG_BITS | self.unplugs) << _STATE_BITS | self.state
        self.publish(self.word[0])


class LinkTable:
    """Table of the words of all channels of a rig, published at `path`."""

    def __init__(self, path: Path, count: int):
        self._path = path
        self._descriptor = sealed_memory.allocate(path.name, count * _WORD)
        self._map = sealed_memory.map_to_write(self._descriptor)
        self._link = sealed_memory.publish(self._descriptor, path)
        # A view stores eight bytes at once; struct would clear them first, and a reader could see the zeros.
        self._words = memoryview(self._map).cast("Q")

    def write(self, index: int, word: int) -> None:
        """Publish the word of the channel with number `index`."""
        self._words[index] = word

    def close(self) -> None:
        """Show all links as up, so that clients see the end of the rig instead of a link error, and remove the file."""
        for index in range(len(self._words)):
            self._words[index] &= ~((1 << _STATE_BITS) - 1)  # state UP
        self._words.release()
        self._map.close()
        sealed_memory.unpublish(self._path, self._link)
        os.close(self._descriptor)


def watch_link(path: Path, index: int) -> memoryview:
    """Map the word of the channel with number `index`; the result's element 0 is the word.

    Raises:
        OSError: the rig has ended.
    """
    descriptor = sealed_memory.find(path)
    try:
        mapped = sealed_memory.map_to_read(descriptor)
    finally:
        os.close(descriptor)
    return memoryview(mapped)[index * _WORD : (index + 1) * _WORD].cast("Q")


class ClientLink:
    """View of the interface by one client; usable from any thread.

    Unlike in the kernel, every receive on an interface that is down raises, not only the first.

    Args:
        word: word of the channel, a sequence of one element, see `Link.word` and `watch_link`.
        unplugs: number of times that the adapter had been unplugged when the client connected.
    """

    def __init__(self, word: Sequence[int], unplugs: int):
        self._word = word
        self._unplugs = unplugs
        self._fine = -1  # last word read while the interface was up
        self._queued_word = -1
        self._queued = 0  # frames in the queue of an interface in bus-off

    def check_receive(self) -> None:
        """Raise can.CanOperationError if the interface is down or its adapter is gone."""
        if self._word[0] != self._fine:
            self._state("Error receiving")

    def check_send(self, frames: int) -> bool:
        """Return whether the frames reach the wire; in bus-off they enter a queue that never empties (False).

        Raises:
            can.CanOperationError: the interface is down, its adapter is gone, or its queue is full.
        """
        word = self._word[0]
        if word == self._fine or self._state("Failed to transmit") == LinkState.UP:
            return True
        if word != self._queued_word:
            self._queued_word, self._queued = word, 0
        self._queued += frames
        if self._queued > TX_QUEUE_FRAMES:
            raise _error("Failed to transmit", errno.ENOBUFS)
        return False

    def _state(self, what: str) -> LinkState:
        word = self._word[0]
        state = LinkState(word & (1 << _STATE_BITS) - 1)
        unplugs = word >> _STATE_BITS & (1 << _UNPLUG_BITS) - 1
        if unplugs != self._unplugs or state == LinkState.GONE:  # the socket of an unplugged adapter stays unusable
            raise _error(what, errno.ENODEV)
        if state == LinkState.DOWN:
            raise _error(what, errno.ENETDOWN)
        if state == LinkState.UP:
            self._fine = word
        return state


def _error(what: str, code: int) -> can.CanOperationError:
    return can.CanOperationError(f"{what}: {os.strerror(code)}", code)
