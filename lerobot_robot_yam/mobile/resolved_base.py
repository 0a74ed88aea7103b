"""One base as configured: its profile with measured sizes, its limits and motors."""

import numpy as np

from lerobot_robot_yam.damiao.motor_spec import check_specs
from lerobot_robot_yam.mobile.base_config import BaseConfig
from lerobot_robot_yam.mobile.rail_profile import RAIL_MOTOR


class ResolvedBase:
    """One base.

    Attributes:
        config: the configuration. name: the base's name, for messages.
        profile, limits: geometry and limits.
        motors, n: motors in the order of the records, the rail's last if there is one, and their number.
        sign: (n,) direction of each motor.
    """

    def __init__(self, config: BaseConfig):
        self.config, self.name = config, config.name
        self.profile, self.limits = config.profile(), config.limits()
        self.motors, signs = self.profile.motors(), self.profile.signs
        if config.rail is not None:
            self.motors, signs = [*self.motors, RAIL_MOTOR], (*signs, config.rail.direction)
        self.n = len(self.motors)
        self.sign = np.array(signs, dtype=float)
        check_specs(self.motors, config.name)
