"""The URDF of an arm says what its profile says."""

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.arm.model import build_model
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.profile_files import ARMS
from lerobot_robot_yam.arm.urdf_export import TOOL, urdf


def read(text):
    """The model that MuJoCo makes of a URDF, with all its links."""
    spec = mujoco.MjSpec.from_string(text)
    spec.compiler.fusestatic = False
    spec.compiler.boundmass = spec.compiler.boundinertia = 1e-9  # LeRobot's gripper joint moves nothing
    return spec.compile()


@pytest.mark.parametrize("gripper", ["linear_4310", "crank_4310", "yam_teaching_handle"])
@pytest.mark.parametrize("name", [name for name in ARMS if name != "none"])
def test_the_tool_and_the_weight_are_where_the_profile_has_them(name, gripper):
    arm, end = resolve_profiles(name, gripper)
    model, ours, kinematics = read(urdf(arm, end)), build_model(name, gripper), YamKinematics(arm, end)
    data, truth = mujoco.MjData(model), mujoco.MjData(ours)
    joints = [model.joint(motor.name) for motor in arm.motors]
    for q in np.random.default_rng(0).uniform(kinematics.lower, kinematics.upper, (5, len(joints))):
        for joint, value in zip(joints, q, strict=True):
            data.qpos[joint.qposadr] = value
        truth.qpos[: len(q)] = q
        mujoco.mj_forward(model, data)
        mujoco.mj_forward(ours, truth)
        tool, pose = data.body(TOOL), kinematics.fk(q)
        np.testing.assert_allclose(tool.xpos, pose[:3, 3], atol=1e-7)
        np.testing.assert_allclose(tool.xmat.reshape(3, 3), pose[:3, :3], atol=1e-7)
        weights = [data.qfrc_bias[joint.dofadr].item() for joint in joints]
        np.testing.assert_allclose(weights, truth.qfrc_bias[: len(q)], atol=1e-5)
    limits = np.array([joint.range for joint in joints])
    np.testing.assert_allclose(limits, arm.joint_limits_rad, atol=1e-7)
