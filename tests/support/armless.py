"""LeRobot's own `lerobot-record` in this process, of devices without arms, watched as one of followers is."""

import contextlib
import inspect
import logging
from dataclasses import dataclass

import numpy as np
from lerobot.configs.dataset import DatasetRecordConfig
from lerobot.robots import Robot, RobotConfig
from lerobot.scripts import lerobot_record

from lerobot_robot_yam.face.desk.session_desk import SessionDesk
from lerobot_robot_yam.face.recorder.episode_log import EpisodeLog
from tests.support.handless import Connected, HandlessConfig

SIZE = 48, 64
TASK = "put the cube into the bowl"


@RobotConfig.register_subclass("armless")
@dataclass
class ArmlessConfig(RobotConfig):
    pass


class Armless(Connected, Robot):
    """A robot that is nothing but a camera, and reports as a follower does."""

    config_class, name, cameras = ArmlessConfig, "armless", {}
    observation_features = {"joint.pos": float, "top": (*SIZE, 3)}
    action_features = {"joint.pos": float}

    def connect(self, calibrate=True):
        self.is_connected, self.log, self.desk = True, EpisodeLog(inspect.currentframe()), SessionDesk()
        self.desk.begin(inspect.currentframe())

    def get_observation(self):
        image = np.zeros((*SIZE, 3), np.uint8)
        self.log.observed(inspect.currentframe(), [], {"top": image})
        self.desk.observed()
        return {"joint.pos": 0.0, "top": image}

    def send_action(self, action):
        return action

    def disconnect(self):
        self.is_connected = False
        self.log.end()
        self.desk.end()


@contextlib.contextmanager
def same_log():
    """LeRobot's commands replace the handlers of the log, which are others' here."""
    root = logging.getLogger()
    handlers, level = list(root.handlers), root.level
    try:
        yield
    finally:
        root.handlers[:] = handlers
        root.setLevel(level)


def record(root, **options):
    """Record until it ends; `options` of the data set. Returns LeRobot's data set."""
    dataset = DatasetRecordConfig(
        repo_id="local/desk", root=str(root), single_task=TASK, push_to_hub=False, no_stamp=True, **options
    )
    config = lerobot_record.RecordConfig(
        robot=ArmlessConfig(), teleop=HandlessConfig(), dataset=dataset, play_sounds=False
    )
    with same_log():
        return lerobot_record.record(config)
