"""The two blocks of one arm: its states, which the loop writes, and its commands, which the caller writes.

The caller makes the memory of both and hands the descriptors on, so that no file has to be there or stay there.
"""

import os
from typing import NamedTuple

from lerobot_robot_yam.state.records import COMMAND_DTYPE, STATE_DTYPE
from lerobot_robot_yam.system.shared_block import SharedBlock


class Descriptors(NamedTuple):
    """Of the memory of both blocks, as the caller has made it."""

    states: int
    commands: int

    def copies(self) -> "Descriptors":
        """The same for a loop in this process, which closes its own."""
        return Descriptors(*map(os.dup, self))


class BlockPair(NamedTuple):
    """Both as the loop has them."""

    states: SharedBlock  # to write
    commands: SharedBlock  # to read

    @classmethod
    def of(cls, descriptors: Descriptors) -> "BlockPair":
        """Map what the caller has made."""
        return cls(
            SharedBlock(None, STATE_DTYPE, create=True, descriptor=descriptors.states),
            SharedBlock(None, COMMAND_DTYPE, create=False, descriptor=descriptors.commands),
        )

    def close(self) -> None:
        """Let go of both. Idempotent."""
        for block in self:
            block.close()
