"""The rail's brake: when it is engaged, and when that is certain."""

import math

from lerobot_robot_yam.system.boards.switch_board import BoardSample, SwitchBoard

CONFIRM_S = 0.5  # time within which the driver must confirm what the brake shall do, s
_EARLY_S = 0.03  # time in which the driver may go on to confirm a brake that was engaged early, s
_SETTLE_S = 0.2  # time that the brake's mechanics need after that, s; the vendor waits as long


class RailBrake:
    """Brake of a rail, engaged at first. engaged: what it shall do."""

    def __init__(self) -> None:
        self.engaged = True
        self._since_s = self._confirmed_s = math.inf
        self._early, self._early_s = False, -math.inf

    def set(self, io: SwitchBoard, engaged: bool, now: float) -> None:
        """Engage or release the brake, from now on."""
        if engaged != self.engaged:
            self.engaged, self._since_s, self._confirmed_s = engaged, now, math.inf
        io.set_brake(engaged or self._early)

    def look(self, sample: BoardSample, now: float, early: bool) -> None:
        """Note what the driver confirms. early: engage its output in this tick, whether or not that is to last."""
        self._since_s = min(self._since_s, now)
        self._early, self._early_s = early, now if early else self._early_s
        if sample.brake_on is self.engaged:
            self._confirmed_s = min(self._confirmed_s, now)
        elif self._confirmed_s < math.inf and now - self._early_s > _EARLY_S:
            self._since_s, self._confirmed_s = now, math.inf

    def holds(self, now: float) -> bool:
        """Return whether the brake is engaged and has had the time to grip."""
        return self.engaged and now - self._confirmed_s >= _SETTLE_S

    def free(self, now: float) -> bool:
        """Return whether the brake is released and has had the time to let go."""
        return not self.engaged and now - self._confirmed_s >= _SETTLE_S

    def unconfirmed(self, now: float) -> bool:
        """Return whether the driver has not confirmed in time what the brake shall do."""
        return self._confirmed_s == math.inf and now - self._since_s > CONFIRM_S
