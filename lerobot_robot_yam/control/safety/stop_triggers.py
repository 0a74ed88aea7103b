"""The triggers of one arm that stop all arms: a button of its handle, or too much effort.

Effort above its limit for longer than a knock lasts means that the arm presses on something it should not.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm

PATIENCE_S = 0.05  # knocks and starts are shorter
_BUTTONS = {None: None, "top": 0, "bottom": 1}


@dataclass(frozen=True)
class EffortVerdict:
    """The joint that exceeded its limit most, relative to it."""

    joint: str
    torque_nm: float
    limit_nm: float

    def __str__(self) -> str:
        return f"{self.joint} works with {self.torque_nm:.1f} Nm against its effort limit of {self.limit_nm:.1f} Nm"


class EffortLimit:
    """Watches the measured torque of n motors. Ask once per tick.

    Args:
        limit_nm: (n,) largest |tau|; infinity where there is no limit.
        names: of the joints.
    """

    def __init__(self, limit_nm: np.ndarray, names: Sequence[str]):
        self._limit = np.array(limit_nm, dtype=float)
        self._names = tuple(names)
        self._since: np.ndarray = np.full(len(self._limit), math.inf)

    def check(self, now: float, tau_nm: np.ndarray) -> EffortVerdict | None:
        """A verdict as long as a torque (n,) Nm has been above its limit for more than PATIENCE_S."""
        above = np.abs(tau_nm) > self._limit
        self._since = np.where(above, np.minimum(self._since, now), math.inf)
        over = now - self._since > PATIENCE_S
        if not over.any():
            return None
        worst = int(np.where(over, np.abs(tau_nm) / self._limit, 0.0).argmax())
        return EffortVerdict(self._names[worst], float(tau_nm[worst]), float(self._limit[worst]))


class StopButton:
    """A button of the handle that latches the emergency stop when it is pressed.

    Args:
        which: 0 the top one, 1 the other one, None: no button does.
    """

    def __init__(self, which: int | None):
        self._which = which
        self._down = True  # held down at start it means nothing until it has been released

    def pressed(self, buttons: tuple[bool, bool]) -> bool:
        """True on the tick on which it goes down."""
        if self._which is None:
            return False
        before, self._down = self._down, bool(buttons[self._which])
        return self._down and not before


class StopTriggers:
    """Ask once per tick.

    Args:
        config, hardware: of the arm.
    """

    def __init__(self, config: ArmConfig, hardware: ResolvedArm):
        self._arm = config.name
        self._button = StopButton(_BUTTONS[config.estop_button])
        self._effort: EffortLimit | None = None
        if config.effort_limit_nm is not None and hardware.joints:
            names = [motor.name for motor in hardware.motors[: hardware.joints]]
            self._effort = EffortLimit(np.array(config.effort_limit_nm), names)

    def check(self, now: float, buttons: tuple[bool, bool], tau_nm: np.ndarray, works: bool) -> str:
        """Why everything has to stop, empty when it has not.

        Args:
            now: s.
            buttons: of the handle, whether they are down.
            tau_nm: (joints,) measured.
            works: whether the effort limit applies now.
        """
        if self._button.pressed(buttons):
            return f"button of the handle of {self._arm}"
        if self._effort is not None:
            verdict = self._effort.check(now, tau_nm if works else np.zeros_like(tau_nm))
            if verdict is not None:
                return f"{self._arm}: {verdict}"
        return ""
