"""What of one arm stops all arms: a button of its handle, or that it works too hard."""

import numpy as np

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.resolved_arm import Hardware
from lerobot_robot_yam.control.safety.effort_monitor import EffortLimit
from lerobot_robot_yam.control.safety.handle_monitor import StopButton

_BUTTONS = {None: None, "top": 0, "bottom": 1}


class StopTriggers:
    """Ask once per tick.

    Args:
        config, hardware: of the arm.
    """

    def __init__(self, config: ArmConfig, hardware: Hardware):
        self._arm = config.name
        self._button = StopButton(_BUTTONS[config.estop_button])
        self._effort: EffortLimit | None = None
        if config.effort_limit_nm is not None and hardware.joints:
            names = [motor.name for motor in hardware.motors[: hardware.joints]]
            self._effort = EffortLimit(np.array(config.effort_limit_nm), names)

    def check(self, now: float, buttons: tuple[bool, bool], tau_nm: np.ndarray, works: bool) -> str:
        """Why everything has to stop, empty when it has not. `tau_nm` (joints,), measured.

        works: whether its effort is to be limited now.
        """
        if self._button.pressed(buttons):
            return f"button of the handle of {self._arm}"
        if self._effort is not None:
            verdict = self._effort.check(now, tau_nm if works else np.zeros_like(tau_nm))
            if verdict is not None:
                return f"{self._arm}: {verdict}"
        return ""
