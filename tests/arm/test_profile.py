"""Profiles load strictly: wrong names, keys, types and lengths are named; overrides replace any field."""

import numpy as np
import pytest
import yaml

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.profile_files import ARMS, GRIPPERS, NO_ARM, load_arm, load_gripper
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.damiao.tables import motor_type
from lerobot_robot_yam.errors import ConfigError
from tests.support.paths import ROOT

TOY = ROOT / "tests" / "support" / "profiles" / "toy_gripper.yaml"


@pytest.mark.parametrize("name", ARMS)
def test_arm_is_complete_and_consistent_with_its_motors(name):
    arm = load_arm(name)
    assert arm.name == name and arm.joint_count == 6
    assert [m.can_id for m in arm.motors] == [1, 2, 3, 4, 5, 6]
    assert [m.name for m in arm.motors] == [f"joint_{i}" for i in range(1, 7)]
    for i, motor in enumerate(arm.motors):
        row = motor_type(motor.type)
        assert motor.direction in (-1, 1)
        assert arm.torque_limit_nm[i] <= row.torque_max_nm
        assert arm.kp[i] <= row.kp_max and arm.kd[i] <= row.kd_max
        assert arm.speed_limit_rad_s[i] < row.velocity_max_rad_s
    assert (arm.joint_limits_rad[:, 0] < arm.joint_limits_rad[:, 1]).all()
    for rest in (arm.rest_q(load_gripper(gripper)) for gripper in GRIPPERS):
        assert (arm.joint_limits_rad[:, 0] <= rest).all() and (rest <= arm.joint_limits_rad[:, 1]).all()


@pytest.mark.parametrize("name", GRIPPERS)
def test_gripper_is_complete(name):
    gripper = load_gripper(name)
    assert gripper.name == name
    assert gripper.handle_encoder == (name == "yam_teaching_handle")
    if gripper.motor is None:
        assert gripper.calibration is gripper.limiter is gripper.finger_range_m is None
        assert gripper.finger_joints == () and gripper.stroke_rad == 0.0
        return
    row = motor_type(gripper.motor.type)
    closed, opened = gripper.calibration.nominal_stops_rad
    assert (closed > opened) == gripper.calibration.closed_is_larger
    assert gripper.calibration.min_span_rad < gripper.stroke_rad < gripper.calibration.max_span_rad
    assert max(abs(closed), abs(opened)) < row.position_max_rad
    assert gripper.motor.speed_limit_per_s * gripper.stroke_rad < row.velocity_max_rad_s
    assert ResolvedArm(ArmConfig(channel="any", gripper=name)).speed_limit[-1] == gripper.motor.speed_limit_per_s
    assert ResolvedArm(ArmConfig(channel="any", gripper=name, gripper_speed_limit=1.0)).speed_limit[-1] == 1.0
    assert gripper.finger_joints == ("joint7", "joint8")
    assert gripper.finger_range_m[0] == 0.0 < gripper.finger_range_m[1] < 0.06


def test_facts_that_contradict_older_documents():
    """Values that changed between releases of the maker; the newest holds (facts, README of v1.2.4)."""
    assert load_arm("yam").kp[3] == 10.0 and load_arm("yam_pro").kp[3] == 40.0
    assert [m.direction for m in load_arm("big_yam").motors] == [1, -1, 1, 1, 1, 1]
    assert load_arm("big_yam").gravity_factor.tolist() == [1.0, 1.2, 1.0, 1.1, 1.0, 1.0]
    assert [m.type for m in load_arm("yam_ultra_2").motors] == ["DM4340"] * 4 + ["DM4310"] * 2
    assert load_arm("yam_ultra_2").kd[3] == 3.0 and load_arm("yam_ultra").kd[3] == 1.5
    assert load_arm("yam").joint_limits_rad[2].tolist() == [0.0, 3.14159]
    assert load_gripper("flexible_4310").motor.direction == -1


def test_no_arm_has_no_joints():
    arm = load_arm(NO_ARM)
    assert arm.joint_count == 0 and arm.kp.shape == (0,) and arm.joint_limits_rad.shape == (0, 2)


@pytest.mark.parametrize(("load", "known"), [(load_arm, ARMS), (load_gripper, GRIPPERS)], ids=["arm", "gripper"])
def test_unknown_name_lists_the_known_ones(load, known):
    with pytest.raises(ConfigError, match="typo") as error:
        load("typo")
    assert all(name in str(error.value) for name in known)


def test_overrides_replace_values_and_merge_mappings():
    arm = load_arm("yam", {"kp": [1, 2, 3, 4, 5, 6]})
    assert arm.kp.tolist() == [1, 2, 3, 4, 5, 6] and arm.kd.tolist() == load_arm("yam").kd.tolist()
    gripper = load_gripper("linear_4310", {"motor": {"kp": 7.0}, "limiter": {"max_force_n": 20.0}})
    assert gripper.motor.kp == 7.0 and gripper.motor.kd == 0.5
    assert gripper.limiter.max_force_n == 20.0 and gripper.limiter.force_map == "linear"
    assert load_gripper("linear_4310").motor.kp == 20.0  # packaged values are untouched


@pytest.mark.parametrize(
    ("overrides", "complaint"),
    [
        ({"kpp": [1.0] * 6}, "kpp"),
        ({"kp": [1.0] * 5}, "kp"),
        ({"kp": [1.0] * 5 + [float("nan")]}, "kp"),
        ({"kp": "much"}, "kp"),
        ({"joint_limits_rad": [[0, 1]] * 5}, "joint_limits_rad"),
        ({"rest_q_rad": {"linear_4310": [0.0]}}, "rest_q_rad.linear_4310"),
        ({"motors": 3}, "motors"),
        ({"motors": [{"name": "joint_1"}]}, "can_id"),
        ({"name": 5}, "name"),
    ],
)
def test_bad_overrides_are_named(overrides, complaint):
    with pytest.raises(ConfigError, match=complaint):
        load_arm("yam", overrides)


@pytest.mark.parametrize("travel_m", [[0.0, 5e-240], [0.04, 0.0], [0.0, 2.0]])
def test_fingers_that_hardly_move_are_refused(travel_m):
    with pytest.raises(ConfigError, match=r"fingers move over 0\.001 to 1 m"):
        load_gripper("linear_4310", {"finger_range_m": travel_m})


def test_arrays_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        load_arm("yam").kp[0] = 0.0


def test_own_profile_by_path(tmp_path):
    from lerobot_robot_yam.arm import profile_files

    document = yaml.safe_load((profile_files.PROFILES / "arms" / "yam.yaml").read_text())
    document["name"] = "mine"
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(document))
    mine = load_arm(path)
    assert mine.name == "mine" and np.array_equal(mine.kp, load_arm("yam").kp)
    with pytest.raises(ConfigError, match=r"absent\.yaml"):
        load_arm(tmp_path / "absent.yaml")
    path.write_text("- a list")
    with pytest.raises(ConfigError, match="mapping"):
        load_arm(str(path))


def test_a_rest_pose_is_the_arms_own_or_else_the_grippers():
    toy = load_gripper(TOY)
    assert load_arm("yam").rest_q(toy).tolist() == [0.0, 0.0, 0.0, -0.166, 0.0, 0.0]
    own = {"rest_q_rad": {"toy_gripper": [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]}}
    assert load_arm("yam", own).rest_q(toy)[0] == 0.1
    assert load_arm(NO_ARM).rest_q(toy).shape == (0,)
    with pytest.raises(ConfigError, match="no rest pose for gripper 'toy_gripper'.*add rest_q_rad.big_yam to the grip"):
        load_arm("big_yam").rest_q(toy)
    for rest in ([0.0] * 5, [9.0] + [0.0] * 5):
        with pytest.raises(ConfigError, match="gripper 'toy_gripper': rest_q_rad.yam .* is not within"):
            load_arm("yam").rest_q(load_gripper(TOY, {"rest_q_rad": {"yam": rest}}))
