"""Actions of LeRobot's RL stack, given by a leader: steps of the follower's tool along x, y and z, and its gripper.

    delta_x, delta_y, delta_z      -1 … 1, of the longest step of a frame, in the frame of the arm's base
    gripper                        0 opens, 1 stops, 2 closes

LeRobot's own names of the gripper's values are the other way round: those arms' grippers close by rising values.

A step is what the leader's tool has moved since the person took over, less the steps given before. So the follower
does not jump to the leader, and what a step was too short for comes with the next ones.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.arm_group import ArmGroup
from lerobot_robot_yam.face.devices.feature_names import STEPS
from lerobot_robot_yam.face.devices.pair_check import Models

_OPENS, _CLOSES = 0.0, 2.0
_HALF = 0.5
_AFRESH_S = 0.5  # without an action: the follower was reset, the hand has gone elsewhere


class ToolSteps:
    """Keys and actions of one leader, see above.

    Args:
        arms: the leader.
        models: profiles of its follower.
        step_m: longest step along an axis, `end_effector_step_sizes` of LeRobot's config.
        opening: reads the opening that the follower's gripper is asked for, 0 closed … 1 open.

    Raises:
        ConfigError: two leaders, or a follower without a gripper.
    """

    def __init__(self, arms: ArmGroup, models: Models, step_m: float, opening: Callable[[], float]):
        side = arms.sides[0]
        if len(arms.sides) != 1 or not side.joints or side.gripper_index is None:
            raise ConfigError(f"{arms.device}: action_space: delta is for one arm with a gripper, as is LeRobot's RL")
        if not step_m > 0.0:
            raise ConfigError(f"{arms.device}: step_m must be positive, not {step_m}")
        self.keys = [*STEPS, "gripper"]
        self._side, self._step_m, self._opening = side, step_m, opening
        (arm, gripper) = models[0]
        self._kinematics = YamKinematics(arm, gripper)
        self._anchor: np.ndarray | None = None  # (3,) m, where the leader's tool was less the steps given since
        self._closes = self._squeezed = False
        self._given_s = 0.0

    @property
    def features(self) -> dict[str, Any]:
        """As LeRobot's data sets describe an action."""
        names = {name: place for place, name in enumerate(self.keys)}
        return {"dtype": "float32", "shape": (len(names),), "names": names}

    def begin(self) -> None:
        """Nobody moves the follower by this leader."""
        self._anchor = None

    def action(self, vector: np.ndarray) -> dict[str, float]:
        """The step that a leader at joints and trigger opening `vector` (n + 1,), rad and 0 … 1, asks for.

        After `begin`, or half a second without a call, it is none, and the gripper goes on as it does.
        """
        now_s, tool = time.monotonic(), self._kinematics.fk(vector[self._side.slice])[:3, 3]
        squeezed = bool(vector[self._side.gripper_index] < _HALF)
        if self._anchor is None or now_s - self._given_s > _AFRESH_S:
            self._anchor, self._closes = tool, self._opening() < _HALF
        elif squeezed is not self._squeezed:
            self._closes = squeezed
        self._squeezed, self._given_s = squeezed, now_s
        step = np.clip((tool - self._anchor) / self._step_m, -1.0, 1.0)
        self._anchor = self._anchor + step * self._step_m
        return dict(zip(self.keys, [*step.tolist(), _CLOSES if self._closes else _OPENS], strict=True))
