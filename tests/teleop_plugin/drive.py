"""A teleoperator that drives a base along a curve; it knows nothing of ours but the names of the velocities."""

import time

from lerobot.teleoperators.teleoperator import Teleoperator

from tests.teleop_plugin.config_drive import DriveConfig


class Drive(Teleoperator):
    """The least that LeRobot asks of a teleoperator."""

    config_class = DriveConfig
    name = "drive"

    def __init__(self, config: DriveConfig):
        super().__init__(config)
        self.config, self._began_s, self._connected = config, None, False

    action_features = dict.fromkeys(["x.vel", "y.vel", "theta.vel"], float)
    feedback_features = {}
    is_calibrated = True

    @property
    def is_connected(self):
        return self._connected

    def connect(self, calibrate=True):
        self._connected = True

    def calibrate(self): ...

    def configure(self): ...

    def get_action(self):
        """Its time begins with the first action: connecting takes seconds."""
        self._began_s = self._began_s or time.monotonic()
        drives = time.monotonic() - self._began_s < self.config.drive_s
        return {"x.vel": self.config.speed * drives, "y.vel": 0.0, "theta.vel": self.config.turn * drives}

    def send_feedback(self, feedback): ...

    def disconnect(self):
        self._connected = False
