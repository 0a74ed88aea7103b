"""A LeRobot teleoperator without arms, for `armless`."""

from dataclasses import dataclass

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig


@TeleoperatorConfig.register_subclass("handless")
@dataclass
class HandlessConfig(TeleoperatorConfig):
    pass


class Connected:
    """What both have in common."""

    is_connected, is_calibrated = False, True

    def calibrate(self):
        pass

    def configure(self):
        pass


class Handless(Connected, Teleoperator):
    """A teleoperator that always asks for the same."""

    config_class, name = HandlessConfig, "handless"
    action_features, feedback_features = {"joint.pos": float}, {}

    def connect(self, calibrate=True):
        self.is_connected = True

    def get_action(self):
        return {"joint.pos": 0.0}

    def send_feedback(self, feedback):
        pass

    def disconnect(self):
        self.is_connected = False
