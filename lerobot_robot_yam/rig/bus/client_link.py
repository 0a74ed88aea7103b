"""What a client's send and receive meet when its interface is not up: the errors that SocketCAN gives."""

import errno
import os
from collections.abc import Sequence

import can

from lerobot_robot_yam.rig.bus.link_state import LinkState, state_of, unplugs_of

BUS_OFF_FRAME_ID = 0x40  # CAN_ERR_BUSOFF of linux/can/error.h
TX_QUEUE_FRAMES = 10  # the kernel's default queue of a CAN interface


class ClientLink:
    """One client's view of its interface. Several threads may call it.

    Unlike the kernel's, a receive on an interface that is down raises each time, not once.

    Args:
        word: of its channel: a sequence of one, see `Link.word` and `watch_link`.
        unplugs: how often its adapter had been unplugged when the rig let us in.
    """

    def __init__(self, word: Sequence[int], unplugs: int):
        self._word = word
        self._unplugs = unplugs
        self._fine = -1  # the last word seen under which nothing was wrong
        self._queued_word = -1
        self._queued = 0  # frames that wait in the queue of an interface in bus-off

    def check_receive(self) -> None:
        """
        Raises:
            can.CanOperationError: the interface is down, or its adapter is gone.
        """
        if self._word[0] != self._fine:
            self._state("Error receiving")

    def check_send(self, frames: int) -> bool:
        """Whether `frames` frames get out; False: they are taken into a queue that never empties.

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
        state = state_of(word)
        if unplugs_of(word) != self._unplugs or state == LinkState.GONE:
            raise _error(what, errno.ENODEV)
        if state == LinkState.DOWN:
            raise _error(what, errno.ENETDOWN)
        if state == LinkState.UP:
            self._fine = word
        return state


def _error(what: str, code: int) -> can.CanOperationError:
    return can.CanOperationError(f"{what}: {os.strerror(code)}", code)
