"""The URDF and the meshes that Commander shows: the kinematics of the planner, and the looks of the profile."""

import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest
import trimesh

from lerobot_robot_yam.arm.export.body_meshes import meshes
from lerobot_robot_yam.arm.export.primitives import joined
from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.arm.model import VISUAL_GROUP, build_spec
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.profile_files import ARMS, GRIPPERS
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.waldo.arm_model import ArmModel

MOTORIZED = [name for name in GRIPPERS if name.endswith(("4310", "3507"))]


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


def written(arm="yam", gripper="linear_4310"):
    profiles = resolve_profiles(arm, gripper)
    model = ArmModel(*profiles)
    model.write()
    return model, *profiles


@pytest.mark.parametrize("arm", ARMS)
def test_the_urdf_has_the_kinematics_of_the_planner(arm):
    model, profile, gripper = written(arm)
    spec = mujoco.MjSpec.from_file(str(model.urdf_path))
    spec.compiler.fusestatic = False
    read = spec.compile()
    data, ours = mujoco.MjData(read), YamKinematics(profile, gripper, profile.bodies[-1].name)
    assert read.njnt == 6 and np.allclose(read.jnt_range, profile.joint_limits_rad, atol=1e-8)
    poses = np.random.default_rng(0).uniform(ours.lower, ours.upper, size=(200, 6))
    poses[:50, 1], poses[:50, 3:5] = poses[:50, 2], 0.0  # gimbal lock
    for q in poses:
        data.qpos[:] = q
        mujoco.mj_kinematics(read, data)
        flange, pose = data.body(profile.bodies[-1].name), ours.poses(q)
        assert np.abs(flange.xpos - pose[:3, 3]).max() < 1e-6
        assert np.abs(flange.xmat.reshape(3, 3) - pose[:3, :3]).max() < 1e-6


def test_the_urdf_is_one_chain_of_meshes():
    model, profile, _ = written()
    robot = ET.parse(model.urdf_path).getroot()
    parents = [joint.find("parent").get("link") for joint in robot.iter("joint")]
    assert len(set(parents)) == len(parents) == len(profile.bodies)
    drawn = {link.get("name") for link in robot.iter("link") if link.find("visual") is not None}
    assert drawn == {body.name for body in profile.bodies if any(shape.colour != "none" for shape in body.shapes)}
    for mesh in robot.iter("mesh"):
        assert mesh.attrib.keys() == {"filename"}
        name = mesh.get("filename").removeprefix("package://lerobot_robot_yam/")
        assert trimesh.load(model.mesh_dir / name).volume > 0.0  # its faces look outwards
    assert model.mesh_dir == model.urdf_path.parent / "meshes"


@pytest.mark.parametrize("gripper", MOTORIZED)
def test_fingers_slide_from_open_to_closed_as_in_the_profile(gripper):
    model, profile, mounted = written("yam", gripper)
    there = build_spec(profile, mounted).compile()
    data = mujoco.MjData(there)
    fingers = [body for body in mounted.bodies if body.joint is not None]
    for position, opening in ((0.0, mounted.finger_range_m[1]), (1.0, mounted.finger_range_m[0])):
        data.qpos[:6], data.qpos[6:] = 0.3, opening
        mujoco.mj_kinematics(there, data)
        flange = data.body(profile.bodies[-1].name)
        for index, (body, file) in enumerate(zip(fingers, model.jaw_meshes, strict=True)):
            drawn = joined([mesh for mesh, _ in meshes(there, there.body(body.name).id, (VISUAL_GROUP,))])
            in_base = drawn.moved(data.body(body.name).xmat.reshape(3, 3), data.body(body.name).xpos).vertices
            place = (in_base - flange.xpos) @ flange.xmat.reshape(3, 3)
            shift = -model.jaws.axis * model.jaws.travel_m * position * (1.0 if index % 2 == 0 else -1.0)
            ours = trimesh.load(model.mesh_dir / file).vertices + shift
            for extreme in (np.min, np.max):
                assert np.allclose(extreme(ours, axis=0), extreme(place, axis=0), atol=1e-4)


def test_files_are_written_once_and_each_content_has_its_folder(cache):
    model, *_ = written()
    before = model.urdf_path.stat().st_mtime_ns
    again, *_ = written()
    other, *_ = written("yam", "crank_4310")
    assert again.folder == model.folder != other.folder and model.urdf_path.stat().st_mtime_ns == before
    assert sorted(path.name for path in model.folder.parent.iterdir()) == sorted([model.folder.name, other.folder.name])


def test_a_cache_that_cannot_be_written_is_an_error_with_a_way_out(cache, monkeypatch):
    (cache / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache / "file"))
    with pytest.raises(ConfigError, match="XDG_CACHE_HOME"):
        ArmModel(*resolve_profiles("yam", "linear_4310")).write()
