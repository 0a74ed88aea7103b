"""LeRobot's own `lerobot-record` in this process, of devices without arms, watched as one of followers is."""

import contextlib
import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
from lerobot.configs.dataset import DatasetRecordConfig
from lerobot.robots import Robot, RobotConfig
from lerobot.scripts import lerobot_record

from lerobot_robot_yam.face.recorder.episode_log import EpisodeLog
from lerobot_robot_yam.face.recorder.rehearsal import rehearse
from lerobot_robot_yam.face.session_desk import SessionDesk
from tests.support.handless import Connected, HandlessConfig

TASK = "put the cube into the bowl"


@RobotConfig.register_subclass("armless")
@dataclass
class ArmlessConfig(RobotConfig):
    size: tuple[int, int] = (48, 64)  # of its images
    noise: bool = False  # which no encoder makes smaller
    rehearsal: Any = None  # called for each image of the rehearsal; None: there is none


class Armless(Connected, Robot):
    """A robot that is nothing but a camera, and reports as a follower does."""

    config_class, name, cameras = ArmlessConfig, "armless", {"top": None}
    action_features = {"joint.pos": float}

    def __init__(self, config):
        super().__init__(config)
        self.shape, self.random = (*config.size, 3), np.random.default_rng(0) if config.noise else None
        self.rehearsal = config.rehearsal

    @property
    def observation_features(self):
        return {"joint.pos": float, "top": self.shape}

    def connect(self, calibrate=True):
        self.is_connected, self.log, self.desk = True, EpisodeLog(), SessionDesk()
        self.log.begin()
        self.desk.begin()
        if self.rehearsal is not None:
            rehearse(self.step)

    def step(self):
        self.rehearsal()
        return {"top": self.get_observation()["top"]}

    def get_observation(self):
        image = np.zeros(self.shape, np.uint8)
        if self.random is not None:
            image = self.random.integers(0, 256, self.shape, np.uint8)
        self.log.observed([], {"top": image})
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


def record(root, robot=None, **options):
    """Record until it ends; `options` of the data set. Returns LeRobot's data set."""
    dataset = DatasetRecordConfig(
        repo_id="local/desk", root=str(root), single_task=TASK, push_to_hub=False, no_stamp=True, **options
    )
    config = lerobot_record.RecordConfig(
        robot=robot or ArmlessConfig(), teleop=HandlessConfig(), dataset=dataset, play_sounds=False
    )
    with same_log():
        return lerobot_record.record(config)
