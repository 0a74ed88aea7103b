"""Lease of some arms: the right of one holder at a time to drive them, renewed by signs of life."""

from collections.abc import Hashable

from lerobot_robot_yam.errors import ChannelInUseError
from lerobot_robot_yam.system.clock import SYSTEM, Clock


class Lease:
    """Right to drive some arms. A lease never ends by itself: its owner decides about a silent holder's arms.

    Args:
        what: name of the arms, for refusals.
        clock: clock that measures the holder's silence.

    Attributes:
        holder: key of the holder, chosen by the owner; None: nobody holds the lease.
        who: the holder in words; empty: nobody.
    """

    def __init__(self, what: str, clock: Clock = SYSTEM):
        self._what, self._clock = what, clock
        self.holder: Hashable = None
        self.who = ""
        self._heard_s = 0.0

    def check(self, holder: Hashable) -> None:
        """Refuse everybody but the holder. Raises ChannelInUseError: another one does; the message names it."""
        if self.holder is not None and self.holder != holder:
            raise ChannelInUseError(f"{self._what} is driven by {self.who}; end that first")

    def take(self, holder: Hashable, who: str) -> None:
        """Give the lease to `holder`. Raises ChannelInUseError: see `check`."""
        self.check(holder)
        self.holder, self.who, self._heard_s = holder, who, self._clock.now()

    def renew(self, holder: Hashable) -> bool:
        """Note a sign of life from `holder`; return whether `holder` has the lease."""
        if holder is None or self.holder != holder:
            return False
        self._heard_s = self._clock.now()
        return True

    def release(self) -> None:
        """End the lease. Idempotent."""
        self.holder, self.who = None, ""

    @property
    def silent_s(self) -> float:
        """Time since the holder's last sign of life, s; 0 without a holder."""
        return 0.0 if self.holder is None else self._clock.now() - self._heard_s
