"""Who may drive arms: one holder at a time, which has to give signs of life."""

from collections.abc import Hashable

from lerobot_robot_yam.errors import ChannelInUseError
from lerobot_robot_yam.system.clock import SYSTEM, Clock


class Lease:
    """The right to drive some arms. It ends when its holder lets go, never by itself: what becomes of the arms of a
    silent holder is for its owner to say.

    Args:
        what: the arms, for refusals.
        clock: by which silence is measured.

    Attributes:
        holder: who has it, by whatever its owner tells holders apart; None: nobody.
        who: the holder in words; empty: nobody.
    """

    def __init__(self, what: str, clock: Clock = SYSTEM):
        self._what, self._clock = what, clock
        self.holder: Hashable = None
        self.who = ""
        self._heard_s = 0.0

    def check(self, holder: Hashable) -> None:
        """Raises ChannelInUseError: another one has it; names it."""
        if self.holder is not None and self.holder != holder:
            raise ChannelInUseError(f"{self._what} is driven by {self.who}; end that first")

    def take(self, holder: Hashable, who: str) -> None:
        """Have it from now on. Raises ChannelInUseError: see `check`."""
        self.check(holder)
        self.holder, self.who, self._heard_s = holder, who, self._clock.now()

    def renew(self, holder: Hashable) -> bool:
        """Note a sign of life; whether this one has it."""
        if holder is None or self.holder != holder:
            return False
        self._heard_s = self._clock.now()
        return True

    def release(self) -> None:
        """Let go of it. Idempotent."""
        self.holder, self.who = None, ""

    @property
    def silent_s(self) -> float:
        """For how long its holder has said nothing, s; 0: there is none."""
        return 0.0 if self.holder is None else self._clock.now() - self._heard_s
