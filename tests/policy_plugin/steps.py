"""Processor steps that make one of LeRobot's own policies move: its policy server takes no others.

A checkpoint names them by their import path, so whoever loads it needs no registration.
"""

import math
import time
from dataclasses import dataclass

from lerobot.processor import ObservationProcessorStep, PolicyActionProcessorStep
from lerobot.utils.constants import OBS_ENV_STATE, OBS_STATE

GRIPPER = 6


class _Chunk:
    """The one being worked on: an observation, then its actions one by one."""

    index = 0


@dataclass
class Surroundings(ObservationProcessorStep):
    """Begins a chunk. ACT wants to see more than joints, and a picture would cost a test machine too much."""

    def observation(self, observation):
        _Chunk.index = 0
        return observation | {OBS_ENV_STATE: observation[OBS_STATE].clone()}

    def transform_features(self, features):
        return features


@dataclass
class Swing(PolicyActionProcessorStep):
    """Adds to every joint, there and back for ever, by the time of the wall."""

    amplitude: float
    period_s: float
    fps: float

    def action(self, action):
        t_s = time.monotonic() + _Chunk.index / self.fps
        _Chunk.index += 1
        share = (1.0 - math.cos(2.0 * math.pi * t_s / self.period_s)) / 2.0
        action = action + self.amplitude * share
        action[..., GRIPPER :: GRIPPER + 1] = 1.0
        return action

    def get_config(self):
        return {"amplitude": self.amplitude, "period_s": self.period_s, "fps": self.fps}

    def transform_features(self, features):
        return features
