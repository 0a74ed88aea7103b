"""Steps of the tool add up to what the leader has moved since a person took over."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.errors import ConfigError
from lerobot_teleoperator_yam.config_yam_leader import BiYamLeaderConfig, YamLeaderConfig
from lerobot_teleoperator_yam.leader_options import LeaderArmConfig
from lerobot_teleoperator_yam.yam_leader import BiYamLeader, YamLeader

STEP_M = 0.02
START, END = np.array([0.0, 1.0, 1.0, -0.3, 0.0, 0.0]), np.array([0.5, 1.4, 1.2, -0.5, 0.1, 0.0])


@pytest.fixture
def steps(tmp_path):
    config = YamLeaderConfig(channel="can0", action_space="delta", step_m=STEP_M, calibration_dir=tmp_path)
    return YamLeader(config)._steps


def asked(steps, q, opening=1.0):
    action = steps.action(np.append(q, opening))
    return np.array([action[f"delta_{axis}"] for axis in "xyz"]), action["gripper"]


def test_steps_add_up_to_the_way_of_the_tool(steps):
    asked(steps, START)
    given = [asked(steps, START + (END - START) * share)[0] for share in np.linspace(0.0, 1.0, 5)]
    given += [asked(steps, END)[0] for _ in range(40)]
    kinematics = YamKinematics("yam", "linear_4310")
    way = kinematics.fk(END)[:3, 3] - kinematics.fk(START)[:3, 3]
    assert np.abs(given).max() == 1.0  # the way was too long for the steps on it,
    np.testing.assert_allclose(np.sum(given, axis=0) * STEP_M, way, atol=1e-9)  # and those behind it made up for that


def test_a_new_take_over_begins_where_the_leader_is(steps):
    asked(steps, START)
    steps.begin()
    assert not asked(steps, END)[0].any()


def test_the_gripper_goes_on_until_the_trigger_passes_the_middle(steps):
    assert [asked(steps, START, opening)[1] for opening in (0.2, 0.1, 0.7, 0.3)] == [0.0, 0.0, 0.0, 2.0]


def test_actions_are_described_as_lerobot_describes_its_gamepad(tmp_path):
    leader = YamLeader(YamLeaderConfig(channel="can0", action_space="delta", calibration_dir=tmp_path))
    names = {"delta_x": 0, "delta_y": 1, "delta_z": 2, "gripper": 3}
    assert leader.action_features == {"dtype": "float32", "shape": (4,), "names": names}
    assert list(leader.feedback_features)[0] == "joint_1.pos"


def test_what_has_no_single_gripper_is_refused(tmp_path):
    left, right = LeaderArmConfig(channel="can0"), LeaderArmConfig(channel="can1")
    config = BiYamLeaderConfig(
        left_arm_config=left, right_arm_config=right, action_space="delta", calibration_dir=tmp_path
    )
    with pytest.raises(ConfigError, match="one arm with a gripper"):
        BiYamLeader(config)
    with pytest.raises(ConfigError, match="one arm with a gripper"):
        YamLeader(
            YamLeaderConfig(channel="can0", action_space="delta", ee_gripper="no_gripper", calibration_dir=tmp_path)
        )
    with pytest.raises(ConfigError, match="step_m must be positive"):
        YamLeader(YamLeaderConfig(channel="can0", action_space="delta", step_m=0.0, calibration_dir=tmp_path))
