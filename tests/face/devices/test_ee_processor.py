"""Processor steps: LeRobot's conventions, there and back, described and stored as LeRobot does it."""

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PipelineFeatureType, PolicyFeature
from lerobot.processor import RobotProcessorPipeline
from lerobot.processor.converters import robot_action_observation_to_transition, transition_to_robot_action
from lerobot.utils.rotation import Rotation

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.errors import ActionError
from lerobot_robot_yam.face.devices.ee_processor import YamEEToJoints, YamEEToTool, YamJointsToEE, YamToolToEE
from lerobot_robot_yam.face.devices.ee_space import Tool
from lerobot_robot_yam.face.devices.feature_names import TOOL_NUMBERS
from tests.support import seven_joints

Q = np.array([0.3, 1.2, 1.0, -1.0, 0.2, -0.3])
EE = ["ee.x", "ee.y", "ee.z", "ee.wx", "ee.wy", "ee.wz"]


def pipeline(*steps):
    return RobotProcessorPipeline(
        steps=list(steps), to_transition=robot_action_observation_to_transition, to_output=transition_to_robot_action
    )


def joints(q, prefix="", gripper=0.4):
    return {f"{prefix}joint_{i + 1}.pos": float(value) for i, value in enumerate(q)} | {f"{prefix}gripper.pos": gripper}


def tool(q, prefix=""):
    numbers = Tool("arm", YamKinematics("yam", "linear_4310")).numbers(np.asarray(q))
    return {f"{prefix}{name}.pos": float(value) for name, value in zip(TOOL_NUMBERS, numbers, strict=True)} | {
        f"{prefix}gripper.pos": 0.4
    }


def test_ee_keys_are_lerobots_convention():
    action = pipeline(YamJointsToEE())((joints(Q), {}))
    pose = YamKinematics("yam", "linear_4310").fk(Q)
    assert list(action) == [*EE, "ee.gripper_pos"]
    assert [action[key] for key in EE[:3]] == pytest.approx(pose[:3, 3])
    rotation = Rotation.from_rotvec([action[key] for key in EE[3:]]).as_matrix()  # as its own steps read it
    np.testing.assert_allclose(rotation, pose[:3, :3], atol=1e-6)
    assert action["ee.gripper_pos"] == 0.4


@pytest.mark.parametrize("use_degrees", [False, True])
def test_joints_to_ee_and_back_along_a_path(use_degrees):
    there = pipeline(YamJointsToEE(prefix="left_", use_degrees=use_degrees))
    back = pipeline(YamEEToJoints(prefix="left_", use_degrees=use_degrees))
    unit = 180 / np.pi if use_degrees else 1.0
    for share in np.linspace(0.0, 1.0, 40):
        q = (Q + share * np.array([0.5, 0.3, 0.4, 0.2, -0.4, 0.6])) * unit
        observed = joints(q + 0.05 * unit, "left_") | {"top": "image"}
        wanted = joints(q, "left_") | {"right_joint_1.pos": 0.7}
        found = back((there((wanted, observed)), observed))
        assert found == pytest.approx(wanted, abs=1e-4 * unit)


def test_an_arm_of_seven_joints_has_seven_keys_on_one_side_and_six_on_the_other():
    there, back = pipeline(YamJointsToEE(arm=seven_joints.ARM)), pipeline(YamEEToJoints(arm=seven_joints.ARM))
    wanted = joints(seven_joints.REACH)
    theirs = there((wanted, {}))
    assert list(theirs) == [*EE, "ee.gripper_pos"]
    found = back((theirs, joints(np.add(seven_joints.REACH, 0.02))))
    assert list(found) == seven_joints.KEYS
    assert there((found, {})) == pytest.approx(theirs, abs=1e-4)
    joint = PolicyFeature(type=FeatureType.ACTION, shape=(1,))
    described = {PipelineFeatureType.ACTION: dict.fromkeys(seven_joints.KEYS, joint)}
    assert list(there.transform_features(described)[PipelineFeatureType.ACTION]) == [*EE, "ee.gripper_pos"]
    described = {PipelineFeatureType.ACTION: dict.fromkeys([*EE, "ee.gripper_pos"], joint)}
    assert list(back.transform_features(described)[PipelineFeatureType.ACTION]) == seven_joints.KEYS


def test_our_keys_and_lerobots_are_the_same_pose():
    ours = tool(Q)
    theirs = pipeline(YamToolToEE())((ours, {}))
    assert theirs == pytest.approx(pipeline(YamJointsToEE())((joints(Q), {})), abs=1e-6)
    # In a rollout the robot's observation stands beside the policy's action, and stays as it is.
    assert pipeline(YamEEToTool())((theirs, tool(Q + 0.1))) == pytest.approx(ours, abs=1e-6)


def test_observations_are_converted_beside_the_action():
    step = YamToolToEE()
    transition = robot_action_observation_to_transition((tool(Q), tool(Q + 0.1) | {"top": "image"}))
    observation = step(transition)["observation"]
    assert observation["top"] == "image" and observation["ee.x"] == pytest.approx(tool(Q + 0.1)["ee_x.pos"])
    assert "ee_x.pos" in transition["observation"]  # what was given is as it was


def test_two_arms_take_two_steps():
    both = pipeline(YamJointsToEE(prefix="left_"), YamJointsToEE(arm="big_yam", prefix="right_"))
    action = both((joints(Q, "left_") | joints(Q, "right_"), {}))
    assert list(action)[:7] == [f"left_{key}" for key in (*EE, "ee.gripper_pos")]
    expected = YamKinematics("big_yam", "linear_4310").fk(Q)[:3, 3]
    assert [action[f"right_{key}"] for key in EE[:3]] == pytest.approx(expected)


def test_tensors_are_numbers():
    action = {key: torch.tensor(value) for key, value in joints(Q).items()}
    assert all(type(value) is float for value in pipeline(YamJointsToEE())((action, {})).values())


@pytest.mark.parametrize(
    ("step", "action", "observation", "named"),
    [
        (YamJointsToEE, {"joint_1.pos": 0.0}, {}, "joint_2"),
        (YamJointsToEE, {"ee.x": 0.0}, {}, "yam_joints_to_ee"),
        (YamEEToJoints, dict.fromkeys(EE, 0.1), {}, "joint_1"),
        (YamEEToJoints, dict.fromkeys(EE, 0.1), None, "observation"),
        (YamEEToTool, dict.fromkeys(EE, 0.1) | {"ee.wx": 1e200}, {}, "no pose"),
        (YamEEToJoints, dict.fromkeys(EE, 0.1) | {"ee.x": float("nan")}, joints(Q), "no pose"),
    ],
)
def test_what_cannot_be_converted_is_named(step, action, observation, named):
    with pytest.raises(ActionError, match=named):
        step()(robot_action_observation_to_transition((action, observation or {})) | {"observation": observation})


def test_features_are_described():
    features = {
        PipelineFeatureType.ACTION: dict.fromkeys(joints(Q), float),
        PipelineFeatureType.OBSERVATION: dict.fromkeys(joints(Q), float) | {"top": (240, 320, 3)},
    }
    features = YamJointsToEE().transform_features(features)
    assert list(features[PipelineFeatureType.ACTION]) == [*EE, "ee.gripper_pos"]
    assert list(features[PipelineFeatureType.OBSERVATION]) == ["top", *EE, "ee.gripper_pos"]
    assert features[PipelineFeatureType.ACTION]["ee.x"].type is FeatureType.ACTION
    features = YamEEToJoints().transform_features(features)
    assert list(features[PipelineFeatureType.ACTION]) == list(joints(Q))
    assert list(features[PipelineFeatureType.OBSERVATION]) == ["top", *EE, "ee.gripper_pos"]


def test_a_pipeline_is_stored_and_loaded(tmp_path):
    pipeline(YamJointsToEE(arm="big_yam", prefix="left_"), YamEEToTool(arm="big_yam", prefix="left_")).save_pretrained(
        tmp_path
    )
    (name,) = [path.name for path in tmp_path.iterdir()]
    loaded = RobotProcessorPipeline.from_pretrained(
        tmp_path,
        config_filename=name,
        to_transition=robot_action_observation_to_transition,
        to_output=transition_to_robot_action,
    )
    assert [type(step) for step in loaded.steps] == [YamJointsToEE, YamEEToTool]
    action = loaded((joints(Q, "left_"), {}))
    assert action["left_ee_x.pos"] == pytest.approx(YamKinematics("big_yam", "linear_4310").fk(Q)[0, 3])


def test_reset_begins_a_new_path():
    step = YamEEToJoints()
    both = np.array([[2.6, 0.36, 1.01, 1.03, -0.69, -1.36], [-0.54, 0.8, 0.97, 1.29, 0.69, 1.78]])  # one pose
    action = pipeline(YamJointsToEE())((joints(both[0]), {}))
    for q in both:
        assert pipeline(step)((action, joints(q + 0.02))) == pytest.approx(joints(q), abs=0.01)
        step.reset()
