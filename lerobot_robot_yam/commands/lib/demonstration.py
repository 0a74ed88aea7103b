"""Attempts of the scripted operator in an environment in lock-step: what it sees and does, frame by frame."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from lerobot_robot_yam.rig.operator.demonstrator import Demonstrator
from lerobot_robot_yam.yam_env import YamEnv


class Frame(NamedTuple):
    """One step: the observation before it, the action (m,) really sent, and whether it brought success."""

    observation: dict[str, Any]
    action: np.ndarray
    success: bool


def demonstrate(env: YamEnv, seed: int) -> Iterator[Frame]:
    """The operator's attempt at the environment's task, laid out by `seed`, until it is over.

    Raises:
        ConfigError: the environment is not in lock-step, or its task has no operator.
        YamError: robot, rig or operator fail.
    """
    observation, _ = env.reset(seed=seed)
    rig, task = env.lockstep_task()
    operator = Demonstrator(rig, task, env.sides)
    try:
        over = False
        while not over:
            targets = operator.targets()
            action = env.action_of(np.concatenate([targets[side] for side in env.sides]))
            before = observation
            observation, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
            yield Frame(before, env.sent, bool(info["is_success"]))
    finally:
        operator.close()
