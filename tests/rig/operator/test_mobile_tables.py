"""The scene of two tables and a mobile base: what the operator sees and asks for, and the rig's verdict."""

import numpy as np
import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.operator.hands import sight_of
from lerobot_robot_yam.rig.operator.task_scripts import make_script
from lerobot_robot_yam.rig.scene.scene import load_scene
from tests.support.rigged import lockstep_rig
from tests.support.stand_in import StandIn, described

TASK = "mobile_tables"
ARMS = {"arms": ["follower_left", "follower_right"]}

rig = lockstep_rig("follower_left", scene=TASK)


def test_the_operator_drives_to_a_stand_and_sees_things_from_the_mount():
    scene = load_scene(TASK, ARMS)
    world = StandIn(scene)
    script = make_script(world, described(scene), TASK)
    script.drive("first")
    sight = world.look()
    assert sight.base == pytest.approx(script.setup.stands["first"], abs=0.012)
    block, (x, y, _) = world.world.data.body("block").xpos, sight.base
    assert sight.things["block"].position_m == pytest.approx(block - [x + 0.10, y, 0.0], abs=0.01)
    script.drive("between")
    sight = world.look()
    assert sight.base == pytest.approx(script.setup.stands["between"], abs=0.015)
    ahead = sight.things["second_table"]  # seen along the base's new heading
    assert ahead.position_m[:2] == pytest.approx([1.05, 0.0], abs=0.02) and ahead.yaw_rad == pytest.approx(0, abs=0.02)


def test_a_wish_to_drive_ends_by_itself_and_moves_nothing(rig):
    before = rig.state()["base"]["pose"]
    rig.ask_drive([0.3, 0.0, -0.5])
    rig.sleep(0.25)
    assert rig.asked_drive()["velocity"] == [0.3, 0.0, -0.5]
    rig.sleep(0.1)
    assert rig.asked_drive()["velocity"] == [0.0, 0.0, 0.0]
    assert rig.state()["base"]["pose"] == pytest.approx(before, abs=1e-4)
    with pytest.raises(ConfigError, match="expected 3 finite numbers"):
        rig.ask_drive([0.3, float("nan"), 0.0])


def test_an_arm_on_a_base_that_is_off_is_not_led(rig):
    assert not sight_of(rig.state(brief=True), ["left"]).willing


@pytest.mark.parametrize(
    ("at", "success"), [((-0.75, 0.95, 0.03), True), ((0.6, 0.0, 0.03), False)], ids=["second", "first"]
)
def test_only_the_second_table_counts(rig, at, success):
    rig.task(TASK, 3)
    x, y, _ = rig.state()["props"]["block"]["pos"]
    rig.place("block", [x, y, 0.12])
    rig.sleep(0.01)
    assert rig.task_state()["stage"] == 1
    rig.place("block", list(at))
    rig.sleep(0.6)
    assert rig.task_state()["success"] is success


def test_a_block_on_the_floor_is_lost(rig):
    rig.task(TASK, 3)
    rig.place("block", [-0.1, 0.7, 0.0])
    rig.sleep(0.5)
    assert rig.task_state()["reason"] == "the block fell off the table"


def test_cameras_ride_with_the_base(rig):
    world = rig.device.world
    before = world.data.camera("base").xpos.copy()
    world.data.joint("base").qpos[0] += 0.5
    rig.sleep(0.01)
    assert world.data.camera("base").xpos - before == pytest.approx(np.array([0.5, 0.0, 0.0]), abs=2e-3)


def test_the_rig_tells_the_episode_of_who_reads_the_wish(rig):
    assert not rig.drive_reader()["reads"]
    rig.asked_drive(True, 12.5)
    rig.sleep(0.5)
    rig.asked_drive()  # who only looks is no reader
    assert rig.drive_reader() == {"reads": True, "episode": 12.5}
    rig.asked_drive(True)
    assert rig.drive_reader() == {"reads": True, "episode": None}
    rig.sleep(1.1)
    assert not rig.drive_reader()["reads"]
