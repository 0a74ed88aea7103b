"""Scenes and their options."""

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.damiao import registers
from lerobot_robot_yam.damiao.registers import Register
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.scene.scene import load_scene
from lerobot_robot_yam.rig.world.world_model import build_world
from tests.support.rig_desk import Desk


def test_the_default_scene_has_the_documented_channels():
    scene = load_scene()
    assert scene.name == "bimanual_table"
    assert scene.channels == ("follower_left", "follower_right", "leader_left", "leader_right")
    assert [row.role for row in scene.arms] == ["follower", "follower", "leader", "leader"]


def test_options_replace_arms_and_grippers_of_followers_only():
    scene = load_scene(options={"arm": "big_yam", "gripper": "crank_4310", "arms": "follower_left,leader_left"})
    assert [(row.channel, row.arm, row.gripper) for row in scene.arms] == [
        ("follower_left", "big_yam", "crank_4310"),
        ("leader_left", "yam", "yam_teaching_handle"),
    ]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"frictoin": 1}, "unknown keys.*frictoin"),
        ({"friction": -1}, "friction"),
        ({"friction": "a lot"}, "expected float"),
        ({"timestep_s": 0}, "timestep_s"),
        ({"serials": "off"}, "serials"),
        ({"arms": ["follower_middle"]}, "follower_middle"),
        ({"pictures": "pretty"}, "pictures must be one of .*full.*plain"),
        ({"randomise_look": 1.5}, "randomise_look"),
        ({"randomise_look": float("nan")}, "randomise_look"),
    ],
)
def test_a_wrong_option_is_named(options, text):
    with pytest.raises(ConfigError, match=text):
        load_scene(options=options)


@pytest.mark.parametrize("name", ["moon", "/nowhere/scene.yaml"])
def test_an_unknown_scene_is_refused(name):
    with pytest.raises(ConfigError, match=name):
        load_scene(name)


def test_an_arm_rides_on_the_base_only_where_there_is_one(tmp_path):
    path = tmp_path / "one.yaml"
    arm = "{channel: a, role: follower, arm: yam, gripper: no_gripper, position_m: [0.1, 0.2, 0], on_base: true}"
    path.write_text(f"name: one\narms: [{arm}]\n")
    with pytest.raises(ConfigError, match="a is on_base; add a base"):
        load_scene(path)
    path.write_text(f"name: one\narms: [{arm}]\nbase: {{channel: b, position_m: [1, 2], yaw_rad: 1.5708}}\n")
    model = build_world(load_scene(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mount = data.body("b/mount").xpos
    assert data.body("a/base").xpos - mount == pytest.approx([-0.2, 0.1, 0.0], abs=1e-3)


def test_a_scene_of_ones_own(tmp_path):
    path = tmp_path / "one.yaml"
    path.write_text(
        "name: one\n"
        "arms: [{channel: a, role: follower, arm: yam, gripper: no_gripper, position_m: [1, 2, 0], yaw_rad: 1.5708}]\n"
        "cameras: [{name: side, position_m: [2, 2, 0.5], target_m: [1, 2, 0]}]\n"
    )
    scene = load_scene(path)
    model = build_world(scene)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.body("a/base").xpos, [1, 2, 0], atol=1e-9)
    tool = data.site("a/tcp_site").xpos - data.body("a/base").xpos
    assert tool[1] > 0.08 and abs(tool[0]) < 0.01  # at zero pose the tool points along the base's x, here world y
    looks = -data.cam_xmat[0].reshape(3, 3)[:, 2]
    np.testing.assert_allclose(looks, np.array([-1, 0, -0.5]) / np.sqrt(1.25), atol=1e-6)


def test_a_scene_that_extends_another_replaces_cameras_by_name(tmp_path):
    rows = [f"{{name: {name}, position_m: [0, 0, 2], target_m: [0.1, 0, 0]}}" for name in ("side", "top")]
    (tmp_path / "x.yaml").write_text(f"name: x\nextends: bimanual_table\ncameras: [{', '.join(rows)}]\n")
    usual, found = load_scene().cameras, load_scene(tmp_path / "x.yaml").cameras
    assert [camera.name for camera in found] == [*(camera.name for camera in usual), "side"]
    moved = [camera.name for camera in found if camera.position_m.tolist() == [0, 0, 2]]
    assert moved == ["top", "side"]
    (tmp_path / "x.yaml").write_text("name: x\nextends: bimanual_table\ncameras: [top]\n")
    with pytest.raises(ConfigError, match="cameras"):
        load_scene(tmp_path / "x.yaml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: x\narms: []\n", "needs arms"),
        ("name: x\narms: [{channel: a, role: boss, arm: yam, gripper: no_gripper, position_m: [0,0,0]}]\n", "role"),
        ("name: x\narms: [{channel: a, role: leader, arm: yam, gripper: x, position_m: [0,0]}]\n", "position_m"),
    ],
)
def test_a_broken_scene_is_refused(tmp_path, text, message):
    path = tmp_path / "x.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        load_scene(path)


def test_an_unknown_gripper_is_refused():
    with pytest.raises(ConfigError, match="linear_9999"):
        build_world(load_scene(options={"gripper": "linear_9999"}))


def register(desk, can_id, number):
    (answer,) = desk.send((0x7FF, registers.encode_read(can_id, number)))
    return registers.decode_reply(answer.data).value


def serials(**options):
    desk = Desk(**options)
    found = [register(desk, motor.can_id, Register.SN) for motor in desk.channel.motors]
    others = [{k: v for k, v in motor._registers.items() if k != Register.SN} for motor in desk.channel.motors]
    desk.close()
    return found, others


def test_serial_numbers_are_unique_and_stable():
    by_channel = {channel: serials(channel=channel)[0] for channel in load_scene().channels}
    flat = [number for found in by_channel.values() for number in found]
    assert len(set(flat)) == len(flat) == 26
    assert serials(channel="follower_right")[0] == by_channel["follower_right"]


def test_arms_with_the_same_serial_numbers_have_equal_registers():
    left, right = (serials(channel=f"follower_{side}", serials="same") for side in ("left", "right"))
    assert left == right
    assert len(set(left[0])) == 7


def test_swapped_cables_bring_the_other_arm_with_its_serial_numbers():
    left, right = (serials(channel=f"follower_{side}")[0] for side in ("left", "right"))
    assert serials(channel="follower_left", swapped="follower_left,follower_right")[0] == right != left
    scene = load_scene(options={"swapped": ["follower_left", "leader_left"]})
    assert {row.channel: row.role for row in scene.arms}["follower_left"] == "leader"
    with pytest.raises(ConfigError, match="swapped"):
        load_scene(options={"swapped": ["follower_left"]})
    with pytest.raises(ConfigError, match="swapped names unknown.*can7"):
        load_scene(options={"swapped": ["follower_left", "can7"]})
