"""Where arms stand in the scene."""

import numpy as np

from lerobot_robot_yam.arm.collision.workspace import WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.rig.scene.scene import load_scene
from lerobot_robot_yam.viewer.live.placement import APART_M, RIGS_APART_M, places


class Watched:
    """What `places` asks of an arm."""

    def __init__(self, channel="can0", rig=None, process="1", gripper="linear_4310", **workspace):
        config = ArmConfig(channel=channel, gripper=gripper, workspace=WorkspaceConfig(**workspace))
        self.hardware, self.rig, self.process = ResolvedArm(config), rig, process


class Rig:
    """What `places` asks of a rig."""

    def __init__(self, name):
        self.name = name
        self._arms = {row.channel: row.position_m for row in load_scene().arms}

    def base(self, channel):
        position = self._arms.get(channel)
        return None if position is None else (position, np.array([1.0, 0.0, 0.0, 0.0]))


def test_a_rig_knows_where_its_arms_stand_and_two_rigs_stand_apart():
    arms = {name: Watched("follower_left", name, base_position_m=[9.0, 9.0, 9.0]) for name in ("a", "b")}
    found = places(arms, {name: Rig(name) for name in ("a", "b")}, {})
    assert np.allclose(found["a"][0], [0.0, 0.25, 0.0]) and np.allclose(found["b"][0], [0.0, 0.25 - RIGS_APART_M, 0.0])


def test_a_workspace_says_where_a_real_arm_stands():
    arms = {"left": Watched(base_position_m=[0.0, 0.5, 0.1], base_yaw_rad=np.pi), "right": Watched()}
    found = places(arms, {}, {})
    assert np.allclose(found["left"][0], [0.0, 0.5, 0.1]) and np.allclose(found["left"][1], [0.0, 0.0, 0.0, 1.0])
    assert np.allclose(found["right"][0], 0.0)


def test_arms_that_say_the_same_stand_in_a_row():
    found = places({"a": Watched(), "b": Watched(floor_z_m=0.0), "c": Watched(rig="ended")}, {}, {})
    assert [found[key][0][1] for key in "abc"] == [0.0, -APART_M, -2 * APART_M]


def test_arms_ride_on_the_mount_of_the_base_that_their_process_drives_and_leaders_do_not():
    mount = np.array([2.0, 0.0, 0.7]), np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    arms = {
        "l": Watched(base_position_m=[0.0, 0.25, 0.0]),
        "r": Watched(base_position_m=[0.0, -0.25, 0.0]),
        "lead": Watched(gripper="yam_teaching_handle"),
        "other": Watched(process="2", base_position_m=[1.0, 0.0, 0.0]),
    }
    found = places(arms, {}, {"1": mount})
    assert np.allclose(found["l"][0], [1.75, 0.0, 0.7]) and np.allclose(found["r"][0], [2.25, 0.0, 0.7])
    assert np.allclose(found["l"][1], mount[1])
    assert np.allclose(found["lead"][0], 0.0) and np.allclose(found["other"][0], [1.0, 0.0, 0.0])
