"""Reader of an arm's state from another control loop, at loop rate, for leaders and followers of each other."""

import math
from collections.abc import Collection
from typing import Any

from lerobot_robot_yam.damiao.motor_spec import MAX_MOTORS
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.state.records import STATE_DTYPE, packed, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock

FRESH_S = 0.03  # maximum age of a usable state: seven ticks without an update by the other loop
_LOOK_S = 0.05  # interval between attempts to open a block that is absent or stale


class PeerBlock:
    """Reader of selected fields of the state published under a channel key. Call `look` once per tick.

    Unpacking the fields with `struct` takes 5 µs per tick; reading a numpy record takes 40 µs.

    Args:
        key: the other arm's channel key.
        fields: names of the `STATE_DTYPE` fields to read, besides stamp_s.
    """

    def __init__(self, key: str, fields: Collection[str]):
        self.key = key
        layout, self._at = packed(STATE_DTYPE, MAX_MOTORS, {*fields, "stamp_s"})
        self._unpack = layout.unpack
        self._block: SharedBlock | None = None
        self._look_s = -math.inf
        self._sequence = 0
        self._values: tuple[Any, ...] = ()
        self._stamp_s = -math.inf

    def look(self, now: float) -> bool:
        """Read the newest state; return whether the state is fresh. A state being written is read at a later call.

        Raises nothing: an unreadable block counts as absent.
        """
        if now - self._stamp_s > FRESH_S and now >= self._look_s:
            self._look_s = now + _LOOK_S
            self._find()
        block = self._block
        if block is None:
            return False
        sequence = block.sequence()  # read before the record: the record may be newer than this number, never older
        if sequence != self._sequence and (payload := block.glance_bytes()) is not None:
            self._sequence, self._values = sequence, self._unpack(payload)
            self._stamp_s = self._values[self._at["stamp_s"]]
        return now - self._stamp_s <= FRESH_S

    def _find(self) -> None:
        """Open the block that is published under the key, unless that block is open already."""
        if self._block is not None and self._block.current:
            return
        self.close()
        try:
            self._block = SharedBlock(state_path(self.key), STATE_DTYPE, create=False)
        except (OSError, YamError):  # absent (yet), or written by another version of this package
            self._block = None

    def value(self, name: str) -> Any:
        """Return the value of a scalar field from the last read."""
        return self._values[self._at[name]]

    def slots(self, name: str, count: int) -> tuple[Any, ...]:
        """Return the first `count` values of a field from the last read."""
        first = self._at[name]
        return self._values[first : first + count]

    def close(self) -> None:
        """Close the block. Idempotent."""
        block, self._block = self._block, None
        self._sequence, self._stamp_s = 0, -math.inf
        if block is not None:
            block.close()
