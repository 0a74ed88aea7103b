"""Limits beyond the joint limits, through the shipped loop: soft wall, sag, workspace, heat."""

from pathlib import Path

import numpy as np
import pytest

from lerobot_robot_yam.arm import profile_files
from lerobot_robot_yam.arm.collision.workspace import KeepOut, WorkspaceConfig
from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from scripts import recorders
from tests.support.rigged import either_rig, leave, session_on, sim_config, track
from tests.support.tiers import spread

LEFT, RIGHT, LEADER = "follower_left", "follower_right", "leader_left"


rig = either_rig(LEFT, RIGHT, LEADER)


@pytest.fixture
def running(rig):
    sessions = []

    def start(*configs):
        session = session_on(rig, *configs)
        session.start()
        sessions.append(session)
        return session

    yield start
    for session in sessions:
        leave(rig, session)


@pytest.mark.long
def test_an_arm_that_is_pushed_beyond_a_limit_is_pushed_back_and_the_session_goes_on(rig, running, tmp_path):
    # The rig's own stops are where the profile's limits are; so this arm is told of a nearer limit.
    packaged = load_arm("yam")
    narrow = tmp_path / "narrow.yaml"
    text = (Path(profile_files.__file__).parent / "profiles" / "arms" / "yam.yaml").read_text()
    before = f"[{packaged.joint_limits_rad[0, 0]:g}, {packaged.joint_limits_rad[0, 1]:g}]"
    assert before in text
    narrow.write_text(text.replace(before, "[-1.0, 1.0]", 1))
    session = running(sim_config(rig, LEADER, arm=str(narrow)))
    session[LEADER].hold()
    track(session, {LEADER: [0.9, 0.8, 0.8, 0.0, 0.0, 0.0]}, 2.0)
    session[LEADER].float()
    sideways = 8.0 * np.array([-np.sin(1.0), np.cos(1.0), 0.0])
    rig.push(LEADER, "link5", sideways, 1.0)
    farthest = 0.0
    deadline = session.clock.now() + 1.0
    while session.clock.now() < deadline:
        farthest = max(farthest, session[LEADER].observe().q[0] - 1.0)
        session.clock.sleep(0.01)
    assert 0.02 < farthest < 0.5
    assert Limited.JOINT_LIMIT in session[LEADER].observe().limited
    session.clock.sleep(2.0)
    state = session[LEADER].observe()
    assert state.mode is Mode.FLOAT
    assert state.q[0] - 1.0 < min(0.05, farthest)


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 4])
def test_targets_that_jump_at_odd_times_do_not_drive_an_arm_into_its_stops(rig, running, seed):
    """From rest, where two joints lie on their stops: struck at full speed, these throw the wrist.

    The wrist lies on the shoulder motor. What pushes it off there is an obstacle, and makes it faster than 1.1 times.
    """
    session = running(sim_config(rig, LEFT, rate_hz=125))
    rest = session[LEFT].observe().setpoint_q
    gaps_s = np.maximum(np.random.default_rng(seed).exponential(1 / 30, 90), 1e-3)
    recorders.watch_start(rig, LEFT)
    for step, gap_s in enumerate(gaps_s):
        session[LEFT].write_target(rest + step % 2, 0.5)
        session.clock.sleep(gap_s)
    speed = np.array(recorders.watch(rig, LEFT)["max_speed_rad_s"][:6])
    assert np.all(speed > 1.0)
    allowed = np.array([1.1, 1.1, 1.1, 1.3, 1.1, 1.1])
    assert np.all(speed < allowed * ResolvedArm(sim_config(rig, LEFT)).speed_limit[:6]), speed


@pytest.mark.parametrize(
    "hold_integral, most_rad, least_rad",
    [(True, 0.006, 0.0), pytest.param(False, 0.06, 0.015, marks=pytest.mark.long)],
)
def test_what_the_gravity_model_misses_is_made_up_for_while_holding(rig, running, hold_integral, most_rad, least_rad):
    session = running(sim_config(rig, LEFT, hold_integral=hold_integral))
    goal = [0.0, 0.9, 0.9, 0.0, 0.0, 0.0]
    track(session, {LEFT: goal}, 1.5)
    session[LEFT].hold()
    rig.fault(LEFT, "joint_3", "torque_bias_nm", -2.4)  # 30 mrad of sag at 80 Nm/rad
    session.clock.sleep(4.0)
    error = abs(rig.state()["arms"][LEFT]["q"][2] - session[LEFT].observe().setpoint_q[2])
    assert least_rad <= error <= most_rad


@pytest.mark.long
def test_two_arms_keep_their_distance_and_come_apart_again(rig, running):
    # As the scene places them, 0.5 m apart.
    left = sim_config(rig, LEFT, workspace=WorkspaceConfig(base_position_m=[0.0, 0.25, 0.0], collision_margin_m=0.03))
    right = sim_config(
        rig, RIGHT, workspace=WorkspaceConfig(base_position_m=[0.0, -0.25, 0.0], collision_margin_m=0.03)
    )
    session = running(left, right)
    apart = {LEFT: [0.3, 1.0, 0.9, 0.0, 0.0, 0.0], RIGHT: [-0.3, 1.0, 0.9, 0.0, 0.0, 0.0]}
    track(session, apart, 2.0)
    track(session, {LEFT: [-0.9, 1.0, 0.9, 0.0, 0.0, 0.0], RIGHT: [0.9, 1.0, 0.9, 0.0, 0.0, 0.0]}, 2.5)
    states = [session[name].observe() for name in (LEFT, RIGHT)]
    assert any(Limited.WORKSPACE in state.limited for state in states)
    assert states[0].q[0] > -0.8 and states[1].q[0] < 0.8  # neither has got there
    tips = [np.array(rig.state()["arms"][name]["tcp_site"]["pos"]) for name in (LEFT, RIGHT)]
    assert tips[0][1] - tips[1][1] > 0.03
    track(session, apart, 2.0)
    assert session[LEFT].observe().q[0] == pytest.approx(0.3, abs=0.03)
    assert session[RIGHT].observe().q[0] == pytest.approx(-0.3, abs=0.03)


def test_no_part_enters_a_keep_out_box(rig, running):
    box = KeepOut(name="camera mast", center_m=[0.0, 0.45, 0.3], size_m=[0.2, 0.2, 1.0])
    session = running(sim_config(rig, LEFT, workspace=WorkspaceConfig(keep_out=[box])))
    track(session, {LEFT: [0.2, 1.3, 1.2, 0.0, 0.0, 0.0]}, 2.0)
    track(session, {LEFT: [1.57, 1.3, 1.2, 0.0, 0.0, 0.0]}, 2.5)
    tip = np.array(rig.state()["arms"][LEFT]["tcp_site"]["pos"]) - [0.0, 0.25, 0.0]  # in the arm's base frame
    assert tip[1] < 0.36
    assert Limited.WORKSPACE in session[LEFT].observe().limited


@pytest.mark.parametrize("teleop_speed", spread(["normal", "fast"], 1))
def test_an_outstretched_arm_stops_above_the_floor(rig, running, teleop_speed):
    floor = WorkspaceConfig(floor_z_m=0.08)
    session = running(sim_config(rig, LEFT, teleop_speed=teleop_speed, workspace=floor))
    track(session, {LEFT: [0.0, 1.4, 1.9, 0.5, 0.0, 0.0]}, 1.6)
    heights = []
    for _ in range(60):
        track(session, {LEFT: [0.0, 2.9, 1.9, 0.5, 0.0, 0.0]}, 0.02)
        heights.append(rig.state()["arms"][LEFT]["tcp_site"]["pos"][2])
    assert Limited.WORKSPACE in session[LEFT].observe().limited
    assert 0.123 < min(heights) < 0.14  # at 0.3 rad/s it stops at 0.126


def test_a_warm_motor_halves_the_speed(rig, running):
    session = running(sim_config(rig, LEFT))
    track(session, {LEFT: [0.0, 0.8, 0.8, 0.0, 0.0, 0.0]}, 1.5)
    rig.fault(LEFT, "joint_3", "temperatures_c", [90, 60])
    session.clock.sleep(0.8)
    speeds = []
    begin = session.clock.now()
    last = session[LEFT].observe()
    while session.clock.now() < begin + 0.8:
        session[LEFT].write_target([1.5, 0.8, 0.8, 0.0, 0.0, 0.0], 0.5)
        session.clock.sleep(0.1)
        state = session[LEFT].observe()
        speeds.append((state.setpoint_q[0] - last.setpoint_q[0]) / (state.stamp_s - last.stamp_s))
        last = state
    limit = session.hardware(LEFT).speed_limit[0]
    assert max(speeds) < 0.6 * limit
    assert Limited.HEAT in state.limited


@pytest.mark.parametrize("after", spread(["track", "hold"], 1))
def test_a_joint_that_comes_free_does_not_spring_to_where_its_set_point_has_gone(rig, running, after):
    session = running(sim_config(rig, LEFT))
    near, far = [0.0, 1.0, 1.2, 0.0, 0.0, 0.0], [0.6, 1.0, 1.2, 0.0, 0.0, 0.0]
    track(session, {LEFT: near}, 1.5)
    rig.fault(LEFT, "joint_1", "stuck")
    track(session, {LEFT: far}, 1.0)
    if after == "hold":
        session[LEFT].hold()
    recorders.watch_start(rig, LEFT)
    rig.fault(LEFT, "joint_1", "stuck", False)
    told = False
    for _ in range(30):  # as often as a caller looks
        if after == "track":
            session[LEFT].write_target(far, 0.5)
        session.clock.sleep(1 / 30)
        state = session[LEFT].observe()
        told |= Limited.CAME_FREE in state.limited
    assert told and recorders.watch(rig, LEFT)["max_speed_rad_s"][0] < 2.9  # the limit is 1.5; else 6.3
    assert abs(state.q[0] - state.setpoint_q[0]) < 0.02
    assert after == "hold" or abs(state.q[0] - far[0]) < 0.02


@pytest.mark.long
def test_a_wrist_that_hooks_onto_its_own_arm_does_not_throw_it(rig, running):
    session = running(sim_config(rig, LEFT))
    goal = [0.3, 0.8, 0.9, -0.2, 0.0, 0.1]
    recorders.watch_start(rig, LEFT)
    track(session, {LEFT: goal}, 2.5)  # straight from rest: the wrist is in the way of the forearm
    assert max(recorders.watch(rig, LEFT)["max_speed_rad_s"][:6]) < 3.0  # else 6.5
    assert np.abs(session[LEFT].observe().q - goal).max() < 0.02
