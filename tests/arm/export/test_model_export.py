"""The files of an arm for other software say what its profile says, and what its maker has published."""

import json

import mujoco
import numpy as np
import pytest
from lerobot.model.kinematics import RobotKinematics

from lerobot_robot_yam.arm.export.model_export import mjcf, urdf
from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.arm.model import Physics, build_model
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.profile_files import ARMS, GRIPPERS
from tests.support.paths import GOLDEN

PUBLISHED = json.loads((GOLDEN / "fk.json").read_text())
REVISED = json.loads((GOLDEN / "yam_ultra_2.json").read_text())["fk"]  # its zeros are rounded, see test_kinematics
CASES = [(arm, cases, 1e-6) for arm, cases in PUBLISHED["cases"].items()] + [("yam_ultra_2", REVISED, 2e-5)]
SITES = ("tcp_site", "grasp_site")
REAL_ARMS = [name for name in ARMS if name != "none"]


def read(text):
    """The model that MuJoCo makes of a URDF, with all its links."""
    spec = mujoco.MjSpec.from_string(text)
    spec.compiler.fusestatic = False
    spec.compiler.boundmass = spec.compiler.boundinertia = 1e-9  # LeRobot's gripper joint moves nothing
    return spec.compile()


def test_every_arm_has_published_poses():
    assert {arm for arm, _, _ in CASES} == set(REAL_ARMS)


@pytest.mark.parametrize(("name", "cases", "tolerance"), CASES, ids=[case[0] for case in CASES])
def test_mujoco_finds_the_published_poses_in_the_mjcf(name, cases, tolerance, tmp_path):
    (tmp_path / "arm.xml").write_text(mjcf(*resolve_profiles(name, PUBLISHED["gripper"])))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data = mujoco.MjData(model)
    for case in cases:
        data.qpos[:6] = case["q"]
        mujoco.mj_forward(model, data)
        for name in SITES:
            site, pose = data.site(name), np.array(case[name])
            np.testing.assert_allclose(site.xpos, pose[:3, 3], atol=tolerance)
            np.testing.assert_allclose(site.xmat.reshape(3, 3), pose[:3, :3], atol=tolerance)


@pytest.mark.parametrize(("name", "cases", "tolerance"), CASES, ids=[case[0] for case in CASES])
def test_lerobot_finds_the_published_poses_in_the_urdf(name, cases, tolerance, tmp_path):
    """Its reader of URDF is placo."""
    arm, gripper = resolve_profiles(name, PUBLISHED["gripper"])
    (tmp_path / "arm.urdf").write_text(urdf(arm, gripper))
    joints = [motor.name for motor in arm.motors]
    for site in SITES:
        reader = RobotKinematics(str(tmp_path / "arm.urdf"), site, joints)
        for case in cases:
            pose = reader.forward_kinematics(np.degrees(case["q"]))
            np.testing.assert_allclose(pose, np.array(case[site]), atol=tolerance)


@pytest.mark.parametrize("gripper", GRIPPERS)
@pytest.mark.parametrize("name", ARMS)
def test_the_mjcf_is_the_arm_of_the_rig(name, gripper):
    model = mujoco.MjModel.from_xml_string(mjcf(*resolve_profiles(name, gripper)))
    ours = build_model(name, gripper, physics=Physics())
    for field in ("jnt_range", "dof_armature", "dof_frictionloss", "body_mass", "body_inertia", "geom_size"):
        np.testing.assert_allclose(getattr(model, field), getattr(ours, field), rtol=1e-5, atol=1e-9, err_msg=field)
    assert (model.npair, model.neq) == (ours.npair, ours.neq)


@pytest.mark.parametrize("gripper", ["linear_4310", "crank_4310", "yam_teaching_handle"])
@pytest.mark.parametrize("name", REAL_ARMS)
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
        tool, pose = data.body("tcp_site"), kinematics.fk(q)
        np.testing.assert_allclose(tool.xpos, pose[:3, 3], atol=1e-7)
        np.testing.assert_allclose(tool.xmat.reshape(3, 3), pose[:3, :3], atol=1e-7)
        weights = [data.qfrc_bias[joint.dofadr].item() for joint in joints]
        np.testing.assert_allclose(weights, truth.qfrc_bias[: len(q)], atol=1e-5)
    limits = np.array([joint.range for joint in joints])
    np.testing.assert_allclose(limits, arm.joint_limits_rad, atol=1e-7)
