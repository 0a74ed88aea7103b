"""One base as configured: its profile with measured sizes, its limits and motors."""

import numpy as np

from lerobot_robot_yam.damiao.motor_spec import check_specs
from lerobot_robot_yam.mobile.base_config import BaseConfig


class ResolvedBase:
    """One base.

    Attributes:
        config: the configuration. name: the base's name, for messages.
        profile, limits: geometry and limits.
        motors, n: motors in the order of the records, and their number.
        sign: (n,) direction of each motor.
    """

    def __init__(self, config: BaseConfig):
        self.config, self.name = config, config.name
        self.profile, self.limits = config.profile(), config.limits()
        self.motors = self.profile.motors()
        self.n = len(self.motors)
        self.sign = np.array(self.profile.signs, dtype=float)
        check_specs(self.motors, config.name)
