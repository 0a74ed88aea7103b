"""The opening that a leader's trigger asks of the follower's gripper, from 0 closed to 1 open."""

import math

NEAR = 0.05  # of the stroke: so near to the gripper's opening the trigger takes over


class TriggerPickup:
    """A trigger cannot be led. While another has the gripper the trigger has no say, and then not before it has met or
    passed the gripper's opening: a person who takes over drops nothing.
    """

    def __init__(self) -> None:
        self._left: float | None = None  # opening that another has left behind
        self._before = 1.0  # the trigger's at the last tick
        self.opening: float | None = None  # None before the first report, and before anything is left

    def leave(self, opening: float, trigger: float) -> None:
        """Another has the gripper, and it is that far open; `trigger` as for `advance`."""
        self._left = self.opening = opening
        if not math.isnan(trigger):
            self._before = 1.0 - trigger

    def advance(self, trigger: float) -> None:
        """One tick; `trigger` 0 released … 1 squeezed, NaN while the handle is silent: the opening stays."""
        if math.isnan(trigger):
            return
        asks, before = 1.0 - trigger, self._before
        self._before = asks
        left = self._left
        if left is not None and abs(asks - left) > NEAR and (asks - left) * (before - left) > 0.0:
            return
        self._left, self.opening = None, asks
