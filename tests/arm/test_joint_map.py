"""Joint angles and motor angles: which turn a motor is on, and that no reading puts a joint where it is not."""

import contextlib
import math

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from lerobot_robot_yam.arm.joint_map import RANGE_TOLERANCE_RAD, TURN, JointMap, resolve_turn
from lerobot_robot_yam.arm.profile_files import ARMS, load_arm
from lerobot_robot_yam.control.arm_status import ArmStatus
from lerobot_robot_yam.errors import LifeCycleError, MotorError
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.yam_arm import YamArm
from lerobot_robot_yam.state.modes import TRANSITIONS, Mode

EXAMPLES = settings(max_examples=300, deadline=None)
JOINTS = [
    (f"{arm}/{motor.name}", motor.direction, *limits.tolist())
    for arm in ARMS
    for motor, limits in zip(load_arm(arm).motors, load_arm(arm).joint_limits_rad, strict=True)
]
joints = st.sampled_from(JOINTS)
share = st.floats(0.0, 1.0)


def read_on_turn(direction, true_rad, turns):
    """The map and motor reading of a joint whose motor counts `turns` motor turns too many."""
    return JointMap(np.array([direction]), np.zeros(1)), np.array([true_rad * direction + turns * TURN])


@EXAMPLES
@given(joint=joints, at=share, turns=st.integers(-1, 1))
def test_within_its_limits_a_joint_is_found_on_whatever_turn_its_motor_counts(joint, at, turns):
    name, direction, low, high = joint
    true = low + at * (high - low)
    chart, motor = read_on_turn(direction, true, turns)
    chart.shift(0, resolve_turn("left", name, chart.position(motor)[0], low, high))
    assert chart.position(motor)[0] == pytest.approx(true, abs=1e-9)


@EXAMPLES
@given(joint=joints, beyond=st.floats(0.0, RANGE_TOLERANCE_RAD * 0.999), upper=st.booleans(), turns=st.integers(-1, 1))
def test_a_little_outside_its_limits_a_joint_is_found_or_refused_but_never_on_another_turn(joint, beyond, upper, turns):
    name, direction, low, high = joint
    true = high + beyond if upper else low - beyond
    chart, motor = read_on_turn(direction, true, turns)
    gap = TURN - (high - low)
    try:
        chart.shift(0, resolve_turn("left", name, chart.position(motor)[0], low, high))
    except MotorError:
        assert turns and gap < 1.0  # joint 1 alone comes near its other end
        return
    assert chart.position(motor)[0] == pytest.approx(true, abs=1e-9)


@EXAMPLES
@given(joint=joints, at=share, turns=st.sampled_from([-4, -3, -2, 2, 3, 4]))
def test_more_than_one_turn_is_not_believed(joint, at, turns):
    """The wire's 25 rad are 0.13 rad short of four turns: measured on the rig, two turns off read 0.132 rad wrong."""
    name, direction, low, high = joint
    chart, motor = read_on_turn(direction, low + at * (high - low), turns)
    with pytest.raises(MotorError, match=f"{name} reads .* turns off its range .* power off and on"):
        resolve_turn("left", name, chart.position(motor)[0], low, high)


@EXAMPLES
@given(joint=joints, reading=st.floats(allow_nan=True, allow_infinity=True))
def test_any_reading_ends_inside_the_range_or_in_an_error_that_names_the_joint(joint, reading):
    name, _, low, high = joint
    try:
        shift = resolve_turn("left", name, reading, low, high)
    except MotorError as error:
        assert str(error).startswith(f"left: {name} ")
        return
    assert shift in (-TURN, 0.0, TURN)
    assert low - RANGE_TOLERANCE_RAD - 1e-9 <= reading + shift <= high + RANGE_TOLERANCE_RAD + 1e-9


def test_a_reading_outside_every_turn_is_refused_with_a_remedy():
    with pytest.raises(
        MotorError, match="left: joint_2 reads -1.0.*by hand.*yam-zero --channel CHANNEL --joint joint_2"
    ):
        resolve_turn("left", "joint_2", -1.0, 0.0, 3.66519)


def test_an_ambiguous_reading_is_refused():
    with pytest.raises(MotorError, match="2 turns.*by hand"):
        resolve_turn("left", "joint_1", math.pi, -math.pi, math.pi)


def test_a_slipped_zero_at_one_end_is_not_taken_for_the_other_end():
    """At its upper stop, zero off by 0.4 rad: taken to be at the lower one, joint 1 would drive into a stop."""
    low, high = load_arm("yam").joint_limits_rad[0]
    with pytest.raises(MotorError, match="joint_1 reads 3.5.*either just outside its range .* or one turn off"):
        resolve_turn("left", "joint_1", high + 0.4, low, high)


def scene(tmp_path, arm, zero_offset, q):
    path = tmp_path / "scene.yaml"
    placement = {
        "channel": "only",
        "role": "follower",
        "arm": arm,
        "gripper": "no_gripper",
        "position_m": [0, 0, 0],
        "q_rad": np.asarray(q).tolist(),
        "zero_offset_rad": np.asarray(zero_offset).tolist(),
    }
    path.write_text(yaml.safe_dump({"name": "one", "arms": [placement]}))
    return str(path)


def fields(rig, arm):
    return {
        "name": "left",
        "channel": "only",
        "interface": "yam_lockstep",
        "can_options": {"rig": rig.name},
        "arm": arm,
        "gripper": "no_gripper",
        "isolation": "lockstep",
    }


@pytest.mark.parametrize("arm", ["yam", "big_yam"])  # big_yam: joint 2 runs the other way
def test_the_shipped_driver_finds_the_turn_of_every_motor_and_moves_from_there(tmp_path, arm):
    turns = np.array([1, -1, 1, -1, 1, -1])
    start = load_arm(arm).rest_q_rad["no_gripper"] + [0.4, 0, 0, 0, 0.3, -0.5]
    rig = LockstepRig(scene(tmp_path, arm, turns * TURN, start))
    with contextlib.closing(rig), YamArm(**fields(rig, arm)) as left:
        assert np.abs(left.observe().q - rig.state()["arms"]["only"]["q"]).max() < 0.01
        goal = left.observe().setpoint_q + [-0.2, 0.4, 0.4, 0.3, -0.2, 0.2]
        left.move_to(goal)
        assert np.abs(np.array(rig.state()["arms"]["only"]["q"]) - goal).max() < 0.05


@pytest.mark.parametrize(
    ("offset", "message"),
    [
        (2 * TURN, "left: joint_1 reads .* 2 turns off"),
        (-2 * TURN, "left: joint_1 reads .* 2 turns off"),
        (3.4, "left: joint_1 reads 3.4.*outside its range .*by hand"),
        (3.55, "left: joint_1 reads 3.5.*either just outside"),
    ],
)
def test_the_shipped_driver_energises_nothing_on_an_unclear_turn(tmp_path, offset, message):
    rest = load_arm("yam").rest_q_rad["no_gripper"]
    with contextlib.closing(LockstepRig(scene(tmp_path, "yam", [offset, 0, 0, 0, 0, 0], rest))) as rig:
        with pytest.raises(MotorError, match=message):
            YamArm(**fields(rig, "yam")).connect()
        assert not [event for event in rig.events() if event["kind"] == "motor_enabled"]


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_shift_moves_the_joint_angle_whatever_the_direction(direction):
    """The maker's own correction ignores the direction and moves a reversed motor the wrong way."""
    chart = JointMap(np.array([direction]), np.array([0.3]))
    motor = np.array([1.1])
    before = chart.position(motor)
    chart.shift(0, TURN)
    assert chart.position(motor) == pytest.approx(before + TURN)


def test_commands_are_the_inverse_of_positions():
    chart = JointMap(np.array([1.0, -1.0]), np.array([0.2, -0.4]))
    command = np.array([[0.5, 0.1, 80.0, 5.0, 1.0], [0.7, -0.2, 10.0, 1.5, -2.0]])
    sent = chart.commands(command)
    assert chart.position(sent[:, 0]) == pytest.approx(command[:, 0])
    assert sent[:, 1] == pytest.approx([0.1, 0.2])
    assert sent[:, 4] == pytest.approx([1.0, 2.0])


def arm_in(*modes):
    """Status of an arm that has gone through these modes."""
    status = ArmStatus("left", floats=False)
    for mode in modes:
        status.enter(mode)
    return status


def test_torque_is_cut_only_when_landing_or_before_bring_up_has_ended_or_when_a_motor_failed():
    assert {mode for mode, following in TRANSITIONS.items() if Mode.OFF in following} == {
        Mode.OFFLINE,
        Mode.BRING_UP,
        Mode.LAND,
        Mode.FAULT,
    }
    with pytest.raises(LifeCycleError, match="left: cannot go from hold to off"):
        arm_in(Mode.BRING_UP, Mode.HOLD).check(Mode.OFF)


def test_a_landing_cannot_be_called_off():
    with pytest.raises(LifeCycleError, match="left: cannot go from land to hold"):
        arm_in(Mode.LAND).check(Mode.HOLD)
