"""The URDF and the meshes that Commander shows: the kinematics of the planner, and the looks of the profile."""

import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest
import trimesh

from lerobot_robot_yam.arm.model import VISUAL_GROUP, build_spec
from lerobot_robot_yam.arm.mounting import resolve_profiles
from lerobot_robot_yam.arm.profile_files import ARMS, GRIPPERS
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.viewer.drawing.bodies import meshes
from lerobot_robot_yam.viewer.drawing.primitives import joined
from lerobot_robot_yam.waldo.kinematics.serial_chain import SerialChain
from lerobot_robot_yam.waldo.model.arm_model import ArmModel

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


def read_by_mujoco(path):
    """The links and joints of a URDF, which has no inertias."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False
    for body in spec.bodies[1:]:
        body.explicitinertial, body.mass, body.inertia = True, 1.0, [1.0, 1.0, 1.0]
    return spec.compile()


@pytest.mark.parametrize("arm", ARMS)
def test_the_urdf_has_the_kinematics_of_the_planner(arm):
    model, profile, _ = written(arm)
    read, chain = read_by_mujoco(model.urdf_path), SerialChain(profile)
    data = mujoco.MjData(read)
    assert read.njnt == chain.n and np.allclose(read.jnt_range, profile.joint_limits_rad, atol=1e-9)
    poses = np.random.default_rng(0).uniform(chain.lower, chain.upper, size=(1000, chain.n))
    poses[:100, 1] = poses[:100, 2]
    poses[:100, 3:5] = 0.0  # gimbal lock
    for q, pose in zip(poses, chain.pose(poses), strict=True):
        data.qpos[:] = q
        mujoco.mj_kinematics(read, data)
        flange = data.body(profile.bodies[-1].name)
        assert np.abs(flange.xpos - pose[:3, 3]).max() < 1e-6
        assert np.abs(flange.xmat.reshape(3, 3) - pose[:3, :3]).max() < 1e-6


def test_the_urdf_is_one_chain_of_meshes():
    model, profile, _ = written()
    robot = ET.parse(model.urdf_path).getroot()
    parents = [joint.find("parent").get("link") for joint in robot.iter("joint")]
    assert len(set(parents)) == len(parents) == len(profile.bodies)
    for mesh in robot.iter("mesh"):
        assert mesh.attrib.keys() == {"filename"}
        name = mesh.get("filename").removeprefix("package://lerobot_robot_yam/")
        assert (model.mesh_dir / name).is_file()
    assert model.mesh_dir == model.urdf_path.parent / "meshes"


def drawn(spec_model, body):
    """What yam-view draws of a link, in one mesh, in the link's frame."""
    return trimesh.Trimesh(*joined([mesh for mesh, _ in meshes(spec_model, body, (VISUAL_GROUP,))]))


@pytest.mark.parametrize(
    "arm, gripper", [("yam", "linear_4310"), ("big_yam", "crank_4310"), ("yam_ultra", "flexible_4310")]
)
def test_links_look_as_in_yam_view(arm, gripper):
    model, profile, mounted = written(arm, gripper)
    spec_model = build_spec(profile, mounted).compile()
    for body in profile.bodies:
        ours = [trimesh.load(path) for path in sorted(model.mesh_dir.glob(f"{body.name}_*.stl"))]
        if not ours:
            assert not [shape for shape in body.shapes if shape.colour != "none"]
            continue
        both, theirs = trimesh.util.concatenate(ours), drawn(spec_model, spec_model.body(body.name).id)
        assert np.allclose(both.bounds, theirs.bounds, atol=1e-3)
        assert both.volume == pytest.approx(theirs.volume, rel=0.03)  # and above 0: its faces look outwards


@pytest.mark.parametrize("gripper", MOTORIZED)
def test_fingers_slide_from_open_to_closed_as_in_the_profile(gripper):
    model, profile, mounted = written("yam", gripper)
    spec_model = build_spec(profile, mounted).compile()
    data = mujoco.MjData(spec_model)
    flange = profile.bodies[-1].name
    for position, opening in ((0.0, mounted.finger_range_m[1]), (1.0, mounted.finger_range_m[0])):
        data.qpos[profile.joint_count :] = opening
        mujoco.mj_kinematics(spec_model, data)
        origin, turn = data.body(flange).xpos, data.body(flange).xmat.reshape(3, 3)
        fingers = [body for body in mounted.bodies if body.joint is not None]
        for index, (body, file) in enumerate(zip(fingers, model.jaw_meshes, strict=True)):
            theirs = drawn(spec_model, spec_model.body(body.name).id)
            frame = data.body(body.name)
            place = (theirs.vertices @ frame.xmat.reshape(3, 3).T + frame.xpos - origin) @ turn
            shift = -model.jaws.axis * model.jaws.travel_m * position * (1.0 if index % 2 == 0 else -1.0)
            ours = trimesh.load(model.mesh_dir / file).vertices + shift
            assert np.allclose(ours.min(axis=0), place.min(axis=0), atol=1e-3)
            assert np.allclose(ours.max(axis=0), place.max(axis=0), atol=1e-3)


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
