"""Says once, not at every tick, what keeps an arm from its target."""

import logging

logger = logging.getLogger(__name__)

_FAR_RAD, _NEAR_RAD = 0.3, 0.1  # between target and set-point: held back by the speed limit, and no longer


class HeldBack:
    """What holds the arm named `arm` back from where it is told to go."""

    def __init__(self, arm: str):
        self._arm = arm
        self._by_speed = self._by_workspace = False

    def by_speed(self, gap_rad: float) -> bool:
        """Whether the speed limit does; `gap_rad` is the largest between target and set-point."""
        before, self._by_speed = self._by_speed, gap_rad > (_NEAR_RAD if self._by_speed else _FAR_RAD)
        if self._by_speed and not before:
            logger.warning("%s: target is %.2f rad away; it follows at its speed limit", self._arm, gap_rad)
        return self._by_speed

    def by_workspace(self, by: str) -> bool:
        """Whether the workspace does; `by` names the parts, empty when it does not."""
        if by and not self._by_workspace:
            logger.warning("%s: held back: %s", self._arm, by)
        self._by_workspace = bool(by)
        return self._by_workspace
