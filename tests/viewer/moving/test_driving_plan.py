"""Which arms the page drives, and how."""

import pytest

from lerobot_robot_yam.arm.collision.workspace import KeepOut, WorkspaceConfig
from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.viewer.moving.driving_plan import MARGIN_M, plan_of, plan_of_arm, plan_of_file

RIG = """
robot:
  type: bi_yam_follower
  id: bench
  left_arm_config: {channel: can_follower_l}
  right_arm_config: {channel: can_follower_r}
teleop:
  type: bi_yam_leader
  left_arm_config: {channel: can_leader_l}
  right_arm_config: {channel: can_leader_r}
"""
LEADER = "teleop: {type: yam_leader, id: bench, channel: can_leader_l}"


def plan(tmp_path, *workspaces):
    configs = [ArmConfig(channel=f"can{i}", name=f"arm{i}", workspace=w) for i, w in enumerate(workspaces)]
    return plan_of(configs, tmp_path / "poses.json")


def margins(plan):
    return [config.workspace.collision_margin_m for config in plan.configs]


def test_the_followers_of_a_rig_are_driven_with_their_own_calibration(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)
    found = plan_of_file(path, None)
    assert [config.channel for config in found.configs] == ["can_follower_l", "can_follower_r"]
    assert found.poses == tmp_path / "rig.poses.json"
    assert found.configs[0].calibration_path.endswith("left_bench_gripper.json")


def test_leaders_are_driven_where_there_is_no_follower_and_they_hold(tmp_path):
    path = tmp_path / "leader.yaml"
    path.write_text(LEADER)
    (config,) = plan_of_file(path, None).configs
    assert (config.channel, config.gripper, config.start) == ("can_leader_l", "yam_teaching_handle", "hold")


def test_a_config_without_arms_is_refused(tmp_path):
    path = tmp_path / "empty.yaml"
    path.write_text("dataset: {repo_id: me/set}")
    with pytest.raises(ConfigError):
        plan_of_file(path, None)


def test_the_collision_check_is_switched_on_and_the_person_is_told():
    found = plan_of_arm(ArmConfig(channel="can0"))
    assert margins(found) == [MARGIN_M]
    assert any("yam-view sets 20 mm" in note for note in found.notes)


def test_a_margin_of_the_config_stays(tmp_path):
    found = plan(tmp_path, WorkspaceConfig(collision_margin_m=0.05))
    assert margins(found) == [0.05] and not found.notes


def test_arms_whose_places_are_unknown_are_kept_clear_of_themselves_only(tmp_path):
    found = plan(tmp_path, WorkspaceConfig(), WorkspaceConfig())
    assert margins(found) == [MARGIN_M] * 2
    first, second = (config.workspace.base_position_m for config in found.configs)
    assert abs(first[1] - second[1]) > 1.5
    assert any("kept clear of itself only" in note for note in found.notes)


def test_arms_with_boxes_and_without_places_are_left_as_they_are_and_the_person_is_told(tmp_path):
    box = KeepOut(center_m=[1.0, 0.0, 0.0], size_m=[0.1, 0.1, 0.1])
    found = plan(tmp_path, WorkspaceConfig(keep_out=[box]), WorkspaceConfig())
    assert margins(found) == [None, None]
    assert any("NO COLLISION CHECKING" in note for note in found.notes)
