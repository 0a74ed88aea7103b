"""A gripper that presses on something for long eases off and keeps it: the law, then the shipped driver on the rig."""

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.profile_files import load_gripper
from lerobot_robot_yam.control.gripper.force_limiter import HOLD_SHARE, GripForce
from lerobot_robot_yam.control.gripper.gripper import Gripper
from tests.support.rigged import LIVE, STOPS, arm_on, rig_of

TICK_S = 0.004


class Squeeze:
    """Drives a `GripForce` tick by tick; closed on an object at 0.4 unless told otherwise."""

    def __init__(self):
        self.grip = GripForce()
        self.now = 100.0
        self.factors = []

    def go_on(self, seconds, u_set=0.0, u=0.4, rate=0.0, tau=-1.0):
        noticed = 0
        for _ in range(round(seconds / TICK_S)):
            self.now += TICK_S
            noticed += self.grip.update(self.now, u_set, u, rate, tau)
            self.factors.append(self.grip.factor)
        return noticed


def test_pressing_for_a_second_halves_the_force_within_half_a_second_and_without_steps():
    squeeze = Squeeze()
    assert squeeze.go_on(0.9) == 0 and squeeze.grip.factor == 1.0
    assert squeeze.go_on(1.0) == 1  # said once
    assert squeeze.grip.stalled and squeeze.grip.factor == HOLD_SHARE
    assert squeeze.grip.press_nm == pytest.approx(1.0)
    steps = np.diff(squeeze.factors)
    assert steps.max() <= 0.0 and steps.min() > -1.5 * (1.0 - HOLD_SHARE) * TICK_S / 0.5
    squeeze.go_on(5.0, tau=-0.3)  # the lower torque that follows is no reason to press harder again
    assert squeeze.grip.stalled and squeeze.grip.factor == HOLD_SHARE


@pytest.mark.parametrize(
    "harmless",
    [{"tau": -0.3}, {"rate": -0.2}, {"tau": 1.0}, {"u": 0.0, "tau": 0.0}],
    ids=["weak", "still closing", "pushed open", "closed on nothing"],
)
def test_what_is_no_stall(harmless):
    squeeze = Squeeze()
    squeeze.go_on(5.0, **harmless)
    assert not squeeze.grip.stalled and set(squeeze.factors) == {1.0}


@pytest.mark.parametrize("motor_rad", [-3.3, -1.0, 0.5, 2.4])
@pytest.mark.parametrize("tau_nm", [-0.51, 0.51, 2.0])
def test_a_gripper_that_is_taken_over_while_it_presses_is_not_kicked(motor_rad, tau_nm):
    axis = Gripper(ArmConfig(channel="x", name="left"), load_gripper("linear_4310"), 20.0, 0.5)
    axis.adopt(*STOPS)
    u = (motor_rad - STOPS[0]) / (STOPS[1] - STOPS[0])
    row = np.array([0.0, 0.0, 20.0, 0.5, 0.0])
    axis.command(row, 100.0, max(u - 0.2, 0.0), 0.0, motor_rad, 0.0, tau_nm)
    assert abs(20.0 * (row[0] - motor_rad) - tau_nm) < 2.6  # Nm; 50 N are 2.3 Nm at this motor


def test_force_comes_back_when_the_command_lets_go_or_the_object_is_gone():
    for change in ({"u_set": 0.6}, {"u": 0.3, "rate": -0.5}):
        squeeze = Squeeze()
        squeeze.go_on(2.0)
        assert squeeze.grip.stalled
        squeeze.go_on(TICK_S, **change)
        assert not squeeze.grip.stalled and squeeze.grip.factor == 1.0


def test_single_readings_neither_begin_nor_end_a_stall():
    squeeze = Squeeze()
    for _ in range(30):
        squeeze.go_on(0.096)
        squeeze.go_on(TICK_S, tau=0.0)
    assert squeeze.grip.stalled
    idle = Squeeze()
    for _ in range(30):
        idle.go_on(0.096, tau=0.0)
        idle.go_on(TICK_S, tau=-5.0)
    assert not idle.grip.stalled


def test_a_gap_between_questions_begins_anew():
    squeeze = Squeeze()
    squeeze.go_on(0.9)
    squeeze.now += 1.0  # floated meanwhile
    squeeze.go_on(0.9)
    assert not squeeze.grip.stalled


def test_heat_takes_force_away_down_to_three_tenths():
    grip = GripForce()
    factors = []
    for level in (-1.0, 0.0, 0.25, 0.5, 1.0, 2.0):
        grip.derate(level)
        factors.append(grip.factor)
    assert factors == pytest.approx([1.0, 1.0, 0.825, 0.65, 0.3, 0.3])


@pytest.mark.parametrize("name", ["crank_4310", "flexible_4310", "linear_3507", "linear_4310"])
@pytest.mark.parametrize("opening", [False, True])
@pytest.mark.parametrize("limit_n", [50.0, None])
def test_every_gripper_eases_off_in_either_direction(name, opening, limit_n):
    """Against something rigid: the motor's answer is kp (q* − q) + tau."""
    profile = load_gripper(name)
    motor = profile.motor
    stops = profile.calibration.nominal_stops_rad.tolist()
    axis = Gripper(ArmConfig(channel="x", gripper=name, gripper_force_limit_n=limit_n), profile, motor.kp, motor.kd)
    axis.adopt(*stops)
    closed, opened = stops
    position = closed + 0.5 * (opened - closed)
    row, tau, torques, effort = np.zeros(5), 0.0, [], []
    for tick in range(1250):
        row[:] = 0.0, 0.0, motor.kp, motor.kd, 0.0
        axis.command(row, 10.0 + tick * TICK_S, float(opening), 0.0, position, 0.0, tau)
        tau = float(np.clip(row[2] * (row[0] - position) + row[4], -motor.torque_limit_nm, motor.torque_limit_nm))
        torques.append(tau)
    effort = np.abs(torques)
    assert axis.stalled
    assert np.sign(tau) == np.sign((opened - closed) if opening else (closed - opened))  # it still presses
    before, after = effort[200:240].mean(), effort[-50:].mean()
    assert 0.3 < after / before < 0.7
    assert np.abs(np.diff(effort[200:])).max() < 0.05 * before  # smoothly
    axis.command(row, 10.0 + 1250 * TICK_S, 0.45 if opening else 0.55, 0.0, position, 0.0, tau)
    assert not axis.stalled


def test_a_warm_motor_presses_less_with_and_without_limiter():
    torques = {}
    for limit_n in (50.0, None):
        for level in (0.0, 1.0):
            profile = load_gripper("linear_4310")
            config = ArmConfig(channel="x", gripper_force_limit_n=limit_n)
            axis = Gripper(config, profile, profile.motor.kp, profile.motor.kd)
            axis.adopt(*STOPS)
            axis.derate(level)
            row, tau = np.zeros(5), 0.0
            for tick in range(150):
                row[:] = 0.0, 0.0, profile.motor.kp, profile.motor.kd, 0.0
                axis.command(row, 10.0 + tick * TICK_S, 0.0, 0.0, 0.0, 0.0, tau)
                tau = float(np.clip(row[2] * row[0] + row[4], -10.0, 10.0))
            torques[limit_n, level] = tau
    assert torques[50.0, 0.0] == pytest.approx(1.0306, abs=0.01)  # 50 N and 0.3 Nm of friction
    assert torques[50.0, 1.0] == pytest.approx(0.3 * 0.7306 + 0.3, abs=0.01)
    assert torques[None, 0.0] == pytest.approx(10.0)
    assert torques[None, 1.0] == pytest.approx(3.0)


@pytest.mark.parametrize("kind", ["lockstep", LIVE])
@pytest.mark.parametrize("limit_n", [50.0, pytest.param(None, marks=pytest.mark.long)])
def test_a_gripped_cube_is_held_with_less_torque_and_not_lost(limit_n, kind):
    channel = "follower_left"

    def cube_from_grasp():
        state = rig.state()
        return np.subtract(state["props"]["cube"]["pos"], state["arms"][channel]["grasp_site"]["pos"])

    with rig_of(kind, arms=[channel]) as rig, arm_on(rig, channel, gripper_force_limit_n=limit_n) as arm:
        pose = arm.move_to([0.0, 1.0, 1.0, 0.0, 0.0, 0.0], gripper=1.0).setpoint_q
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, np.array(rig.state()["arms"][channel]["grasp_site"]["mat"]))
        deadline = arm.clock.now() + 10.0
        pressing = 0
        while pressing < 10:  # fingers that are slow to start press on nothing for a moment
            assert arm.clock.now() < deadline, "the fingers never met the cube"
            rig.place("cube", rig.state()["arms"][channel]["grasp_site"]["pos"], quat)  # a hand holds it there
            arm.command(pose, gripper=0.0)
            state = arm.observe()
            meets = state.gripper_tau_nm > 0.6 and abs(state.gripper_rate) < 0.1  # closing is positive of this motor
            pressing = pressing + 1 if meets else 0
            arm.clock.sleep(0.01)
        start = rig.state()["sim_s"]
        samples = []
        while not samples or samples[-1][0] < 3.0:
            arm.command(pose, gripper=0.0)
            samples.append((rig.state()["sim_s"] - start, abs(arm.observe().gripper_tau_nm or 0.0)))
            arm.clock.sleep(0.01)
        times, torques = np.array(samples).T
        first = np.median(torques[(times > 0.4) & (times < 0.8)])
        last = np.median(torques[times > 2.5])
        assert last / first < 0.7
        grasp = cube_from_grasp()
        assert np.abs(grasp).max() < 0.03
        lifted = rig.state()["props"]["cube"]["pos"][2]
        higher = pose + np.array([0.4, -0.15, 0.1, 0.0, 0.0, 0.0])
        arm.move_to(higher, gripper=0.0)
        assert abs(rig.state()["props"]["cube"]["pos"][2] - lifted) > 0.01  # it came along
        assert np.abs(np.linalg.norm(cube_from_grasp()) - np.linalg.norm(grasp)) < 0.01
        assert arm.observe().gripper > 0.3
