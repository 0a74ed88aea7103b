"""State of a channel's network interface, and how the clients of other processes see it.

One 64-bit word per channel in sealed memory: written by the rig, looked at by each client before it sends or
receives. A word costs a client nothing, reaches one that never reads its socket, and cannot get lost.
"""

import os
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path

from lerobot_robot_yam.system import sealed_memory

_WORD = 8
_STATE_BITS, _UNPLUG_BITS = 8, 24  # of the word, from below; the rest counts changes


class LinkState(IntEnum):
    """What the system would say about the interface."""

    UP = 0
    DOWN = 1  # `ip link set canX down`
    GONE = 2  # the adapter is unplugged
    BUS_OFF = 3  # the controller has left the bus after too many errors


def state_of(word: int) -> LinkState:
    """The state in a word."""
    return LinkState(word & (1 << _STATE_BITS) - 1)


def unplugs_of(word: int) -> int:
    """How often the adapter had been unplugged; a client that saw another number holds a dead socket."""
    return word >> _STATE_BITS & (1 << _UNPLUG_BITS) - 1


class Link:
    """One interface, as the rig moves it.

    Attributes:
        word: a list of one: its word, as `watch_link` shows it to other processes.
        publish: called with the word after every change.
        unplugs: how often the adapter was taken away.
    """

    def __init__(self) -> None:
        self.state = LinkState.UP
        self.publish: Callable[[int], None] = lambda word: None
        self._down = self._gone = self._bus_off = False
        self.unplugs = self._changes = 0
        self.word = [int(self.state)]

    def set_down(self, down: bool) -> None:
        """Take the interface down or bring it up; down also ends a bus-off, as on a real controller."""
        self._down = down
        self._bus_off = self._bus_off and not down
        self._changed()

    def unplug(self, gone: bool) -> None:
        """Take the adapter away or plug it in again."""
        self.unplugs += gone and not self._gone
        self._gone = gone
        self._bus_off = self._bus_off and not gone
        self._changed()

    def set_bus_off(self, bus_off: bool) -> None:
        """Drive the controller into bus-off or restart it."""
        self._bus_off = bus_off
        self._changed()

    def _changed(self) -> None:
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
    """The words of all channels of a rig, which others find at `path`; the rig's side."""

    def __init__(self, path: Path, count: int):
        self._path = path
        self._descriptor = sealed_memory.allocate(path.name, count * _WORD)
        self._map = sealed_memory.map_to_write(self._descriptor)
        self._link = sealed_memory.publish(self._descriptor, path)
        # A view stores eight bytes in one go; struct clears them first, and a reader could see that.
        self._words = memoryview(self._map).cast("Q")

    def write(self, index: int, word: int) -> None:
        """Show the word of channel number `index`."""
        self._words[index] = word

    def close(self) -> None:
        """Show every link as up, so that clients hear of the rig's end instead, and remove the link."""
        for index in range(len(self._words)):
            self._words[index] &= ~((1 << _STATE_BITS) - 1)  # that is UP; of what was unplugged nobody is to hear now
        self._words.release()
        self._map.close()
        sealed_memory.unpublish(self._path, self._link)
        os.close(self._descriptor)


def watch_link(path: Path, index: int) -> memoryview:
    """The word of channel number `index`, `[0]` of the result; mapped for as long as that lives.

    Raises:
        OSError: the rig has ended.
    """
    descriptor = sealed_memory.find(path)
    try:
        mapped = sealed_memory.map_to_read(descriptor)
    finally:
        os.close(descriptor)
    return memoryview(mapped)[index * _WORD : (index + 1) * _WORD].cast("Q")
