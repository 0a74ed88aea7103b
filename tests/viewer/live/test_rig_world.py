"""The world of a rig, and pictures of cameras that somebody has opened, as others see them without asking the rig."""

import contextlib

import numpy as np
import pytest
import yaml

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.errors import RigError, StaleStateError
from lerobot_robot_yam.rig.client.launch import rig_path, tell_scene, told_scene
from lerobot_robot_yam.rig.client.rendered_camera import frame_dtype, frame_path
from lerobot_robot_yam.rig.scene.scene import load_scene
from lerobot_robot_yam.rig.world.world import World, WorldBlock
from lerobot_robot_yam.system.shared_block import SharedBlock
from lerobot_robot_yam.viewer.live.rig_world import RenderedPictures, RigWorld

OPTIONS = {"arms": ["follower_left"], "seed": 3}


@contextlib.contextmanager
def shown(name="shown", scene=None, options=OPTIONS):
    """A world, and the reader of what is published of it."""
    world = World(load_scene(scene, options))
    tell_scene(name, scene, options)
    block = WorldBlock(rig_path(name, "world"), world)
    block.publish(world)
    reader = RigWorld(name)
    try:
        yield world, block, reader
    finally:
        reader.close()
        block.close()
        rig_path(name, "scene").unlink()


def test_things_and_cameras_are_where_the_rig_has_them():
    with shown() as (world, block, reader):
        world.put("cube", np.array([0.3, 0.1, 0.5]), np.array([1.0, 1.0, 0.0, 0.0]))
        world.set_pose("follower_left", np.array([0.5, 1.0, 1.0, 0.0, 0.0, 0.0]))
        world.step(1)
        block.publish(world)
        assert reader.read() and not reader.read()
        ours, theirs = reader.data, world.data
        assert np.allclose(ours.body("cube").xpos, theirs.qpos[-7:-4], atol=1e-4)
        assert np.allclose(ours.site("follower_left/tcp_site").xpos, _tool(world), atol=1e-6)
        assert np.linalg.norm(ours.camera("wrist_left").xpos - _tool(world)) < 0.3
        assert np.allclose(reader.base("follower_left")[0], [0.0, 0.25, 0.0]) and reader.base("leader_left") is None


def _tool(world):
    q = [world.data.qpos[address] for address in world.joint_addresses("follower_left")]
    return YamKinematics("yam", "linear_4310").fk(np.array(q))[:3, 3] + [0.0, 0.25, 0.0]


def test_contacts_are_those_of_arms_with_themselves_and_with_things():
    with shown() as (world, block, reader):

        def touching():
            world.step(1)
            block.publish(world)
            reader.read()
            return {other for arm, other, _ in reader.contacts() if arm.startswith("follower_left/")}

        assert touching() == {"follower_left/link5"}  # folded, it lies on itself; the cube on its table is no arm's
        world.set_pose("follower_left", np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0]))
        assert touching() == set()
        world.put(
            "cube", reader.data.body("follower_left/link2").xpos + [0.0, 0.0, 0.02], np.array([1.0, 0.0, 0.0, 0.0])
        )
        assert touching() == {"cube"}


def test_a_scene_of_a_file_is_found_from_anywhere(tmp_path, monkeypatch):
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump({"extends": "bimanual_table", "name": "mine"}))
    monkeypatch.chdir(tmp_path)
    tell_scene("mine", "mine.yaml", OPTIONS)
    monkeypatch.chdir("/")
    try:
        scene = told_scene("mine")
    finally:
        rig_path("mine", "scene").unlink()
    assert (scene.name, scene.channels, scene.options.seed) == ("mine", ("follower_left",), 3)


def test_a_rig_of_another_version_is_refused():
    rig_path("later", "scene").write_text('{"later": 1}')
    try:
        with pytest.raises(RigError, match="does not say what it simulates .*scene.*; start it anew"):
            told_scene("later")
    finally:
        rig_path("later", "scene").unlink()


def test_no_rig_and_one_that_tells_another_scene_are_refused():
    with pytest.raises(RigError, match="does not say what it simulates"):
        RigWorld("nobody")
    with shown() as (_, _, reader):
        tell_scene("shown", None, {"arms": ["follower_left", "leader_left"]})
        with pytest.raises(StaleStateError):
            RigWorld("shown")
        assert reader.current


@pytest.fixture
def pictures():
    pictures = RenderedPictures("drawn")
    yield pictures
    pictures.close()


def opened(camera, width, height):
    """What the renderer has of an open camera, and a way to have it draw a grey picture."""
    dtype = frame_dtype(width, height)
    block = SharedBlock(frame_path("drawn", camera, width, height, 30), dtype, create=True)

    def draw(grey):
        record = np.zeros((), dtype)
        record["rgb"] = grey
        block.write(record)

    return block, draw


def test_each_picture_is_given_once_and_no_wider_than_a_frustum_needs(pictures):
    block, draw = opened("top", 640, 480)
    pictures.look()
    assert pictures.is_open("top") and pictures.newest("top") is None
    draw(100)
    picture = pictures.newest("top")
    assert picture.shape == (240, 320, 3) and (picture == 100).all()
    assert pictures.newest("top") is None
    draw(50)
    assert (pictures.newest("top") == 50).all()
    block.close()


def test_a_camera_that_is_closed_is_forgotten_and_one_of_a_similar_name_is_another(pictures):
    block, draw = opened("wrist-left", 32, 24)
    draw(1)
    pictures.look()
    assert pictures.is_open("wrist-left") and not pictures.is_open("wrist")
    block.close()
    pictures.look()
    assert not pictures.is_open("wrist-left") and pictures.newest("wrist-left") is None
