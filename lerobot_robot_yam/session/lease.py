"""Lease: exclusive right of one holder to drive some arms, renewed by heartbeats."""

from collections.abc import Hashable

from lerobot_robot_yam.errors import ChannelInUseError
from lerobot_robot_yam.system.clock import SYSTEM, Clock


class Lease:
    """Exclusive right to drive some arms. A lease never expires; its owner decides about the arms of a silent holder.

    Args:
        what: name of the arms, for messages.
        clock: clock that measures the holder's silence.

    Attributes:
        holder: key of the holder, chosen by the owner; None: no holder.
        who: description of the holder; empty: no holder.
    """

    def __init__(self, what: str, clock: Clock = SYSTEM):
        self._what, self._clock = what, clock
        self.holder: Hashable = None
        self.who = ""
        self._heard_s = 0.0

    def check(self, holder: Hashable) -> None:
        """Raise ChannelInUseError if another holder than `holder` has the lease; the message names it."""
        if self.holder is not None and self.holder != holder:
            raise ChannelInUseError(f"{self._what} is driven by {self.who}; end that first")

    def take(self, holder: Hashable, who: str) -> None:
        """Give the lease to `holder`. Raises ChannelInUseError: another holder has the lease."""
        self.check(holder)
        self.holder, self.who, self._heard_s = holder, who, self._clock.now()

    def renew(self, holder: Hashable) -> bool:
        """Record a heartbeat from `holder`. Return whether `holder` has the lease."""
        if holder is None or self.holder != holder:
            return False
        self._heard_s = self._clock.now()
        return True

    def release(self) -> None:
        """Release the lease. Idempotent."""
        self.holder, self.who = None, ""

    @property
    def silent_s(self) -> float:
        """Time since the holder's last heartbeat, s; 0 without a holder."""
        return 0.0 if self.holder is None else self._clock.now() - self._heard_s
