"""LeRobot processor steps between joints, this package's end-effector keys and LeRobot's `ee.*` keys, for one arm each.

    yam_joints_to_ee    joint_1.pos …, gripper.pos         →  ee.x, ee.y, ee.z, ee.wx, ee.wy, ee.wz, ee.gripper_pos
    yam_ee_to_joints    the same keys                      ←  by inverse kinematics
    yam_tool_to_ee      ee_x.pos … ee_rz.pos, gripper.pos  →  (a robot with `action_space: ee`)
    yam_ee_to_tool                                         ←

    w = log R           LeRobot's rotation vector, from the axes of the arm's base
    r = log(R R_downᵀ)  this package's, see `arm.tool_pose`

Positions are the same numbers, m, of `site` in the frame of the arm's base; the gripper stays 0 closed … 1 open.
`prefix` ("left_") precedes all keys of the arm; two arms take two steps. Importing this module registers the steps, so
import it before you load a pipeline that was saved with them.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np
from lerobot.configs import FeatureType, PipelineFeatureType, PolicyFeature
from lerobot.lerobot_types import EnvTransition, TransitionKey
from lerobot.processor import ProcessorStep, ProcessorStepRegistry

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.arm.tool_pose import downward, pose_to_vector, vector_to_pose
from lerobot_robot_yam.errors import ActionError
from lerobot_robot_yam.face.devices.ee_space import Tool
from lerobot_robot_yam.face.devices.feature_names import TOOL_NUMBERS

_TOOL = tuple(f"{name}.pos" for name in TOOL_NUMBERS)
_EE = ("ee.x", "ee.y", "ee.z", "ee.wx", "ee.wy", "ee.wz")
_GRIPPER_KEYS = {"joints": "gripper.pos", "tool": "gripper.pos", "ee": "ee.gripper_pos"}


@dataclass
class _ArmStep(ProcessorStep):
    """Base of the steps, each of which replaces the keys of one arm and its gripper.

    Attributes:
        arm, gripper: profile names.
        site: site whose pose the keys describe, tcp_site or grasp_site.
        prefix: prefix of all keys.
        use_degrees: whether joint keys are in degrees, like the robot's option of the same name.
    """

    arm: str = "yam"
    gripper: str = "linear_4310"
    site: str = "tcp_site"
    prefix: str = ""
    use_degrees: bool = False

    reads: ClassVar[str]
    writes: ClassVar[str]
    parts: ClassVar[tuple[TransitionKey, ...]] = (TransitionKey.ACTION, TransitionKey.OBSERVATION)
    _registry_name: ClassVar[str]

    def __post_init__(self) -> None:
        self._kinematics = YamKinematics(self.arm, self.gripper, self.site)
        self._axes = {"tool": downward(self._kinematics), "ee": np.eye(3)}  # rotation that counts as zero
        self._unit = np.pi / 180.0 if self.use_degrees else 1.0
        self._joints = tuple(f"joint_{i + 1}.pos" for i in range(len(self._kinematics.lower)))
        keys = {"joints": self._joints, "tool": _TOOL, "ee": _EE}
        self._source, self._target = keys[self.reads], keys[self.writes]
        self._gripper_keys = _GRIPPER_KEYS[self.reads], _GRIPPER_KEYS[self.writes]

    def get_config(self) -> dict[str, Any]:
        """Return the arguments with which LeRobot recreates the step."""
        return asdict(self)

    def convert(self, values: np.ndarray, transition: EnvTransition) -> np.ndarray:
        """Compute the values that the step writes from the values that it reads."""
        if self.reads == "joints":
            pose = self._kinematics.fk(values * self._unit)
        else:
            pose = vector_to_pose(values, self._axes[self.reads])
        return pose_to_vector(pose, self._axes[self.writes])

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Convert the action, the observation, or both, depending on which has the arm's keys.

        Raises:
            ActionError: neither has these keys, some keys are missing, or the values are not a valid pose.
        """
        source = [self.prefix + key for key in self._source]
        changed, found = transition.copy(), False
        for part in self.parts:
            values = transition.get(part)
            if isinstance(values, dict) and any(key in values for key in source):
                changed[part], found = self._replace(values, source, transition), True
        if not found:
            raise ActionError(f"{self._registry_name}: no {source} in {' or '.join(part.value for part in self.parts)}")
        return changed

    def _replace(self, values: Mapping[str, Any], source: list[str], transition: EnvTransition) -> dict[str, Any]:
        numbers = self.convert(_numbers(values, source), transition).tolist()
        old, new = (self.prefix + key for key in self._gripper_keys)
        replaced = {key: value for key, value in values.items() if key not in source and key != old}
        replaced |= {self.prefix + key: number for key, number in zip(self._target, numbers, strict=True)}
        if old in values:
            replaced[new] = float(values[old])
        return replaced

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """Replace the arm's keys in the description of the data."""
        kinds = {
            TransitionKey.ACTION: (PipelineFeatureType.ACTION, FeatureType.ACTION),
            TransitionKey.OBSERVATION: (PipelineFeatureType.OBSERVATION, FeatureType.STATE),
        }
        for part in self.parts:
            name, kind = kinds[part]
            described = features.get(name) or {}
            old_gripper, new_gripper = self._gripper_keys
            for old_keys, new_keys in ((self._source, self._target), ((old_gripper,), (new_gripper,))):
                found = [described.pop(self.prefix + key, None) for key in old_keys]
                if any(feature is not None for feature in found):
                    described |= {self.prefix + key: PolicyFeature(type=kind, shape=(1,)) for key in new_keys}
        return features


@ProcessorStepRegistry.register("yam_joints_to_ee")
@dataclass
class YamJointsToEE(_ArmStep):
    """Forward kinematics, from joints to LeRobot's `ee.*`, in actions and observations."""

    reads, writes = "joints", "ee"


@ProcessorStepRegistry.register("yam_ee_to_joints")
@dataclass
class YamEEToJoints(_ArmStep):
    """Inverse kinematics, from an action in LeRobot's `ee.*` to joints.

    The first solution starts from the joints in the transition's observation, each later one from the previous
    solution, until `reset`.
    """

    reads, writes = "ee", "joints"
    parts = (TransitionKey.ACTION,)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._tool = Tool(f"{self.prefix}arm", self._kinematics)

    def convert(self, values: np.ndarray, transition: EnvTransition) -> np.ndarray:
        observed = transition.get(TransitionKey.OBSERVATION)
        if not isinstance(observed, dict):
            raise ActionError("yam_ee_to_joints needs an observation with joints beside the action")
        q = _numbers(observed, [self.prefix + key for key in self._joints]) * self._unit
        return self._tool.follow(vector_to_pose(values, self._axes["ee"]), q) / self._unit

    def reset(self) -> None:
        """Start a new path: the next action does not continue the previous ones."""
        self._tool.begin()


@ProcessorStepRegistry.register("yam_tool_to_ee")
@dataclass
class YamToolToEE(_ArmStep):
    """Conversion from a robot's keys with `action_space: ee` to LeRobot's `ee.*`, in actions and observations."""

    reads, writes = "tool", "ee"


@ProcessorStepRegistry.register("yam_ee_to_tool")
@dataclass
class YamEEToTool(_ArmStep):
    """Conversion from LeRobot's `ee.*` to a robot's keys with `action_space: ee`, in actions and observations."""

    reads, writes = "ee", "tool"


def _numbers(values: Mapping[str, Any], keys: list[str]) -> np.ndarray:
    missing = [key for key in keys if key not in values]
    if missing:
        raise ActionError(f"processor step: {missing} are missing; there are {sorted(values)}")
    return np.array([float(values[key]) for key in keys])
