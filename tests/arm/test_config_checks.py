"""What no arm can be driven with is refused before anything is energised, and says what would do."""

import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.profile_files import ARMS, GRIPPERS
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ConfigError


@pytest.mark.parametrize(
    "field, value, takes",
    [
        ("payload_mass_kg", 50.0, "within 0 … 3 kg"),
        ("payload_com_m", [5.0, 0.0, 0.0], "±0.5 m"),
        ("ee_inertia", [5.0, 0, 0, 1, 0, 0, 0, 0.1, 0.1, 0.1], "centre within ±0.5 m"),
        ("gravity_factor", [5.0] * 6, "within 0 … 2"),
        ("coulomb_friction_nm", [5.0] * 6, "within 0 … 1 Nm"),
        ("torque_limit_nm", [1000.0] * 6, r"\[2.8, .*\] … \[28.0"),
        ("torque_limit_nm", [0.0] * 6, r"\[2.8, .*\] … \[28.0"),
        ("kp", [0.0] * 6, "is not within 1 …"),
        ("kp", [501.0] * 6, "… .500"),
        ("kd", [0.0] * 6, r"is not within \[1.6"),
        ("kd", [5.1] * 6, r"… \[5.0"),
        ("gripper_kd", 0.0, " 0 is not within 0.4"),
        ("gripper_speed_limit", 100.0, "more than the motor's 4.58"),
        ("gripper_force_limit_n", 1e9, "within 1 … 200 N, or null"),
        ("speed_limit_rad_s", 100.0, "at most the motors'"),
        ("acceleration_limit_rad_s2", 1.0, "one number within 5 … 100 rad/s², or one per joint"),
        ("acceleration_limit_rad_s2", [30.0] * 5 + [101.0], "within 5 … 100"),
        ("acceleration_limit_rad_s2", [30.0] * 5, "takes 6 numbers"),
        ("teleop_speed", "quick", "'calm' or 'normal' or 'fast'"),
        ("float_speed_rad_s", 1e3, "within 0.5 … 10 rad/s"),
        ("float_speed_rad_s", 0.0, "within 0.5 … 10 rad/s"),
        ("command_timeout_s", 1e9, "within 0.02 … 10 s"),
        ("max_state_age_s", 1e9, "within 0.02 … 2 s"),
        ("base_tilt_rad", [90.0, 0.0], "±3.14"),
        ("base_tilt_rad", [0.0], "roll, pitch"),
        ("rest_q_rad", [9.0] * 6, "within the joints' limits"),
    ],
)
def test_what_cannot_be_meant_is_refused(field, value, takes):
    with pytest.raises(ConfigError, match=rf"(?s)left.*{field.removeprefix('gripper_').split('_')[0]}.*{takes}"):
        ResolvedArm(ArmConfig(name="left", channel="x", **{field: value}))


@pytest.mark.parametrize(
    "fields, speed, acceleration",
    [
        ({}, 1.5, 30.0),
        ({"teleop_speed": "fast"}, 4.0, 60.0),
        ({"teleop_speed": "fast", "speed_limit_rad_s": 0.5}, 0.5, 60.0),
        ({"teleop_speed": "normal", "acceleration_limit_rad_s2": [20.0] * 6}, 2.5, 20.0),
    ],
)
def test_a_limit_takes_the_place_of_that_of_teleop_speed(fields, speed, acceleration):
    arm = ResolvedArm(ArmConfig(name="left", channel="x", **fields))
    assert (arm.speed_limit[:6] == speed).all() and (arm.acceleration_limit == acceleration).all()


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("gripper", GRIPPERS)
def test_every_packaged_arm_is_within_the_bounds_with_room_to_both_sides(arm, gripper):
    packaged = ResolvedArm(ArmConfig(name="left", channel="x", arm=arm, gripper=gripper))
    for scale in (0.8, 1.0):
        fields = {key: (scale * getattr(packaged.arm, key)).tolist() for key in ("kp", "kd", "torque_limit_nm")}
        ResolvedArm(ArmConfig(name="left", channel="x", arm=arm, gripper=gripper, **fields))
