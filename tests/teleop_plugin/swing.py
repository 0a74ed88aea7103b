"""A teleoperator that swings one joint; it knows nothing of YAM arms but the names of their joints."""

import math
import time

from lerobot.teleoperators.teleoperator import Teleoperator

from tests.teleop_plugin.config_swing import SwingConfig

_POSE = {"joint_1.pos": 0.0, "joint_2.pos": 1.0, "joint_3.pos": 1.0, "joint_4.pos": 0.0, "joint_5.pos": 0.0}
_PERIOD_S = 4.0


class Swing(Teleoperator):
    """The least that LeRobot asks of a teleoperator."""

    config_class = SwingConfig
    name = "swing"

    def __init__(self, config: SwingConfig):
        super().__init__(config)
        self.config, self._began_s = config, None

    action_features = dict.fromkeys([*_POSE, "joint_6.pos", "gripper.pos"], float)
    feedback_features = {}
    is_calibrated = True

    @property
    def is_connected(self):
        return self._began_s is not None

    def connect(self, calibrate=True):
        self._began_s = time.monotonic()

    def calibrate(self): ...

    def configure(self): ...

    def get_action(self):
        turn = 2 * math.pi * (time.monotonic() - self._began_s) / _PERIOD_S
        return _POSE | {
            "joint_1.pos": self.config.swing_rad * math.sin(turn),
            "joint_6.pos": 0.0,
            "gripper.pos": 0.5,
        }

    def send_feedback(self, feedback): ...

    def disconnect(self):
        self._began_s = None
