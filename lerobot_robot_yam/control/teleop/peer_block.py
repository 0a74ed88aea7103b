"""The state of another control loop's arm, read at loop rate: a leader reads its follower, a follower its leader."""

import math
from collections.abc import Collection
from typing import Any

from lerobot_robot_yam.damiao.motor_spec import MAX_MOTORS
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.state.records import STATE_DTYPE, packed, state_path
from lerobot_robot_yam.system.shared_block import SharedBlock

FRESH_S = 0.03  # largest age of a state that is used: seven ticks without news from the other loop
_LOOK_S = 0.05  # period of looking for a block that is absent or silent


class PeerBlock:
    """Reader of some fields of the state that is published under a channel's key. Call `look` once per tick.

    Fields are unpacked with `struct`, which takes 5 µs per tick; reading a numpy record takes 40 µs.

    Args:
        key: key of the other arm's channel.
        fields: names of the fields of `STATE_DTYPE` that are wanted, besides stamp_s.
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
        """Read the newest state; return whether it is fresh. A state that is being written is read later.

        Raises nothing: a block that cannot be read counts as absent.
        """
        if now - self._stamp_s > FRESH_S and now >= self._look_s:
            self._look_s = now + _LOOK_S
            self._find()
        block = self._block
        if block is None:
            return False
        sequence = block.sequence()  # read before the record, which may be newer than its number, never older
        if sequence != self._sequence and (payload := block.glance_bytes()) is not None:
            self._sequence, self._values = sequence, self._unpack(payload)
            self._stamp_s = self._values[self._at["stamp_s"]]
        return now - self._stamp_s <= FRESH_S

    def _find(self) -> None:
        """Open the block that is published now, if that is another one than ours."""
        if self._block is not None and self._block.current:
            return
        self.close()
        try:
            self._block = SharedBlock(state_path(self.key), STATE_DTYPE, create=False)
        except (OSError, YamError):  # absent (yet), or of another version of this package
            self._block = None

    def value(self, name: str) -> Any:
        """Return a field with one value, as read last."""
        return self._values[self._at[name]]

    def slots(self, name: str, count: int) -> tuple[Any, ...]:
        """Return the first `count` values of a field, as read last."""
        first = self._at[name]
        return self._values[first : first + count]

    def close(self) -> None:
        """Close the block. Idempotent."""
        block, self._block = self._block, None
        self._sequence, self._stamp_s = 0, -math.inf
        if block is not None:
            block.close()
