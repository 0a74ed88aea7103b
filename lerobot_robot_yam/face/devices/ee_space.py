"""End-effector keys for the arms of one LeRobot device, in place of joint keys (`action_space: ee`).

    ee_x.pos, ee_y.pos, ee_z.pos       tcp_site in the frame of the arm's base, m
    ee_rx.pos, ee_ry.pos, ee_rz.pos    rotation vector from "pointing straight down, facing forward", rad
    gripper.pos                        as with joints, if there is a gripper

with prefixes `left_` and `right_` for two arms. `arm.tool_pose` defines the rotation vector. The names end in .pos
because lerobot-rollout drops other names. `EeSpace` has `keys`, `vector`, `action` and `begin`, like `ArmGroup`.
"""

import logging
from collections.abc import Mapping

import numpy as np

from lerobot_robot_yam.arm.kinematics import IkResult, PoseTracker, YamKinematics, pose_distance_m
from lerobot_robot_yam.arm.tool_pose import downward, pose_to_vector, vector_to_pose
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.face.devices.arm_group import ArmGroup
from lerobot_robot_yam.face.devices.feature_names import TOOL_NUMBERS
from lerobot_robot_yam.face.devices.pair_check import Models
from lerobot_robot_yam.session.target_limits import validate_action
from lerobot_robot_yam.state.modes import Mode

logger = logging.getLogger(__name__)

_JUMP_M = 0.1  # distance between two poses above which a new path starts, m (1 rad counts as 0.1 m)
_SEARCHES = 12  # maximum number of attempts at the first pose of a path, about 1 ms each; usually one or two
_ATTEMPTS = 4  # maximum number of attempts at each later pose; usually one
_REACH_RAD = 0.7  # maximum turn of a joint between poses, rad, so that the arm never swings to its other side
_WORTH_SAYING_M = 1e-3  # error at or above which a pose counts as out of reach, m (1 rad counts as 0.1 m)
_QUIET = 30  # number of poses within reach, about a second, after which the next warning may be logged


class EeSpace:
    """Actions of a group of arms as end-effector poses of `models`, instead of joints.

    Raises:
        ConfigError: an arm has no joints.
    """

    def __init__(self, arms: ArmGroup, models: Models):
        self._arms = arms
        self._tools = []
        self.keys: list[str] = []
        for side, (arm, gripper) in zip(arms.sides, models, strict=True):
            if not side.joints:
                raise ConfigError(f"{side.name}: a gripper alone has no pose; use action_space: joint")
            self._tools.append(Tool(side.name, YamKinematics(arm, gripper)))
            names = (*TOOL_NUMBERS, "gripper") if side.has_gripper else TOOL_NUMBERS
            self.keys += [f"{side.prefix}{name}.pos" for name in names]

    def action(self, vector: np.ndarray) -> dict[str, float]:
        """Convert joints and grippers in canonical order and SI units to a LeRobot action."""
        values = vector.copy()
        for side, tool in zip(self._arms.sides, self._tools, strict=True):
            values[side.slice] = tool.numbers(vector[side.slice])
        return dict(zip(self.keys, values.tolist(), strict=True))

    def vector(self, action: Mapping[str, object]) -> np.ndarray:
        """Return joints and grippers, in canonical order and SI units, for the end-effector poses of an action.

        For a pose out of reach, the joints are those at the nearest reachable pose.

        Raises:
            ActionError: keys are missing or unknown, or values are not finite numbers or not a valid pose.
            YamError: an arm is silent or in fault.
        """
        vector = validate_action(self._arms.device, action, self.keys)
        states = self._arms.newest()
        for side, tool, state in zip(self._arms.sides, self._tools, states, strict=True):
            if state.mode is not Mode.TRACK:  # at the first action, after a pause, and after an emergency stop
                tool.begin()
            vector[side.slice] = tool.joints(vector[side.slice], state.setpoint_q)
        return vector

    def begin(self) -> None:
        """Start new paths, because something else has moved the arms."""
        for tool in self._tools:
            tool.begin()


class Tool:
    """End effector of one arm: converts joints to the six `TOOL_NUMBERS` and back."""

    def __init__(self, name: str, kinematics: YamKinematics):
        self._name = name
        self._kinematics = kinematics
        self._reference = downward(kinematics)
        self._tracker = PoseTracker(kinematics, kinematics.middle)
        self._before: np.ndarray | None = None
        self._reached = _QUIET  # number of poses since the last pose out of reach

    def numbers(self, q: np.ndarray) -> np.ndarray:
        """Return the (6,) `TOOL_NUMBERS` at joints `q` (n,) rad."""
        return pose_to_vector(self._kinematics.fk(q), self._reference)

    def begin(self) -> None:
        self._before = None

    def joints(self, numbers: np.ndarray, setpoint: np.ndarray) -> np.ndarray:
        """Return joints (n,) rad as `follow` does, for `numbers` (6,) instead of a pose."""
        return self.follow(vector_to_pose(numbers, self._reference), setpoint)

    def follow(self, pose: np.ndarray, setpoint: np.ndarray) -> np.ndarray:
        """Return joints (n,) rad for a pose (4, 4), or for the nearest reachable pose.

        The search for a path's first solution starts from the arm's set-point (n,) rad, each later search from the
        previous solution. This keeps the kinematic branch even if the arm lags behind. Only for a first pose far from
        the set-point may the solution be on any branch.

        Raises:
            ActionError: `pose` is not a valid pose.
        """
        begins = self._before is None or pose_distance_m(self._before, pose) > _JUMP_M
        if begins:
            self._tracker.restart(setpoint)
        if begins and pose_distance_m(self._kinematics.fk(setpoint), pose) > _JUMP_M:
            result = self._tracker.solve(pose, attempts=_SEARCHES)
        else:
            result = self._tracker.solve(pose, attempts=_ATTEMPTS, within_rad=_REACH_RAD)
        self._before = pose
        self._note(result)
        return result.q

    def _note(self, result: IkResult) -> None:
        """Warn when poses start to be out of reach."""
        if result.converged or result.error_m < _WORTH_SAYING_M:
            self._reached += 1
            return
        if self._reached >= _QUIET:
            logger.warning(
                "%s: pose out of reach; going as near as possible, %.0f mm and %.2f rad off",
                self._name,
                result.position_error_m * 1e3,
                result.orientation_error_rad,
            )
        self._reached = 0
