"""What YamArm offers beside targets: timed moves, replays, live gains, limp motors, records, and what it says."""

import contextlib

import numpy as np
import pytest

from lerobot_robot_yam.arm.config import ArmConfig
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.errors import ActionError, ConfigError, LifeCycleError, YamError
from lerobot_robot_yam.session.arm_client import ArmClient
from lerobot_robot_yam.session.state_recorder import StateRecorder
from lerobot_robot_yam.session.trajectory import Trajectory
from lerobot_robot_yam.state.modes import Mode
from scripts import recorders
from tests.support.landed import MOST_M, moved_after_cut_m
from tests.support.rigged import arm_on, lockstep_rig

FOLLOWER = "follower_left"
POSE = [0.1, 0.7, 0.7, -0.2, 0.1, 0.1]
THERE = [0.0, 0.9, 0.8, 0.0, -0.1, -0.1]
SOFT_KP, SOFT_KD = [30.0, 30.0, 30.0, 5.0, 5.0, 5.0], [3.0, 3.0, 3.0, 1.0, 1.0, 1.0]

rig = lockstep_rig(FOLLOWER)


@contextlib.contextmanager
def rigless():
    """The caller's end of an arm that nobody drives."""
    client = ArmClient(ResolvedArm(ArmConfig(name="left", channel="a")))
    yield client
    client.close()


@pytest.fixture
def arm(rig):
    """A follower in the air; it is thrown away."""
    rig.set_pose(FOLLOWER, POSE, 0.5)
    arm = arm_on(rig, FOLLOWER).connect()
    yield arm
    arm._session.discard()


def true_q(rig):
    return np.array(rig.state()["arms"][FOLLOWER]["q"])[:6]


def torques(rig, arm, seconds):
    """The motors' true torques (k, 6) from now on, a row per millisecond."""
    recorders.truth_start(rig, FOLLOWER, seconds)
    arm.clock.sleep(seconds)
    return recorders.truth(rig, FOLLOWER)["torque_nm"][:, :6]


def gives(rig, arm):
    """How far joint 4 gives way to a push."""
    before = true_q(rig)[3]
    rig.push(FOLLOWER, "tool", [0.0, 0.0, -10.0], 0.8)
    arm.clock.sleep(0.6)
    after = true_q(rig)[3]
    arm.clock.sleep(1.2)
    return abs(after - before)


def test_a_timed_move_takes_its_time_and_says_what_it_takes_at_least(rig, arm):
    way = np.abs(np.array(THERE) - POSE).max()
    begun = arm.clock.now()
    arm.move_joints(THERE, 1.5, gripper=0.8)
    assert 1.45 < arm.clock.now() - begun < 2.2
    np.testing.assert_allclose(true_q(rig), THERE, atol=0.015)  # friction of the wrist
    assert arm.observe().gripper == pytest.approx(0.8, abs=0.02)
    before, least = arm.observe().setpoint_q, np.pi / 2 * way / 1.5
    with pytest.raises(
        ActionError, match=rf"it takes {least:.2f} s at least, not 0\.1: give time_s more; nothing moves"
    ):
        arm.move_joints(POSE, 0.1)
    with pytest.raises(ActionError, match=r"q\[1\] is nan"):
        arm.move_joints([0.0, np.nan, 0.0, 0.0, 0.0, 0.0], 2.0)
    with pytest.raises(ActionError, match="joint_2 cannot go to -0.50 rad"):
        arm.move_joints([0.0, -0.5, 0.0, 0.0, 0.0, 0.0], 2.0)
    with pytest.raises(ActionError, match="time_s is nan"):
        arm.move_joints(POSE, np.nan)
    arm.clock.sleep(0.1)
    np.testing.assert_allclose(arm.observe().setpoint_q, before, atol=0.001)  # it comes to rest


@pytest.mark.long
def test_gains_change_without_a_jump_of_torque(rig, arm):
    arm.clock.sleep(1.0)
    held = torques(rig, arm, 0.2).mean(axis=0)
    stiff = gives(rig, arm)
    arm.update_kp_kd(SOFT_KP, SOFT_KD)
    torque = torques(rig, arm, 0.8)
    assert np.abs(torque - held).max() < 0.3 and np.abs(np.diff(torque, axis=0)).max() < 0.05
    np.testing.assert_array_equal([arm.info().kp, arm.info().kd], [SOFT_KP, SOFT_KD])
    assert gives(rig, arm) > 1.4 * stiff
    held = torques(rig, arm, 0.2).mean(axis=0)
    arm.update_kp_kd([80.0] * 3 + [10.0] * 3, [5.0] * 3 + [1.5] * 3)
    assert np.abs(torques(rig, arm, 0.8) - held).max() < 0.3
    assert gives(rig, arm) < 1.2 * stiff


@pytest.mark.parametrize(
    ("kp", "kd", "said"),
    [
        (SOFT_KP[:5], SOFT_KD, r"kp must have shape \(6,\)"),
        ([np.nan, *SOFT_KP[1:]], SOFT_KD, r"kp\[0\] is nan"),
        ([600.0, *SOFT_KP[1:]], SOFT_KD, r"kp .* is not within 1 … \[500"),
        ([0.0, *SOFT_KP[1:]], SOFT_KD, r"kp .* is not within 1 … \[500"),
        (SOFT_KP, [0.1, *SOFT_KD[1:]], "kd .* is not within"),
    ],
)
def test_gains_that_no_configuration_may_have_are_refused(kp, kd, said):
    with rigless() as client, pytest.raises((ActionError, ConfigError), match=said):
        client.change_gains(kp, kd)


@pytest.mark.long
def test_it_lands_with_the_gains_of_its_configuration(rig, arm):
    arm.update_kp_kd([2.0] * 6, [0.5] * 6)
    arm.clock.sleep(1.0)
    arm.land()
    assert moved_after_cut_m(rig, FOLLOWER) < MOST_M


def test_torque_is_cut_in_the_air_only_by_force(rig, arm):
    with pytest.raises(LifeCycleError, match="it would fall: it does not lie at rest. Land it"):
        arm.zero_torque()
    assert arm.observe().mode is Mode.HOLD
    arm.zero_torque(force=True)
    motors = rig.state()["arms"][FOLLOWER]["motors"].values()
    assert not any(motor["enabled"] for motor in motors)
    arm.zero_torque()  # it is off


def test_an_arm_that_does_not_answer_is_not_taken_to_lie(rig):
    with arm_on(rig, FOLLOWER) as arm:
        rig.fault(FOLLOWER, "joint_2", "silent")
        arm.clock.sleep(0.5)
        with pytest.raises(YamError, match="joint_2"):
            arm.zero_torque()
        assert arm._client.published().mode is Mode.FAULT


def test_an_arm_that_lies_at_rest_may_be_made_limp(rig):
    with arm_on(rig, FOLLOWER) as arm:
        arm.zero_torque()
        assert not any(motor["enabled"] for motor in rig.state()["arms"][FOLLOWER]["motors"].values())
    assert moved_after_cut_m(rig, FOLLOWER) < MOST_M


@pytest.mark.long
def test_what_a_hand_has_done_is_replayed_within_5_mrad(rig):
    """With the maker's gravity factors, which are wrong for the rig's arm; without the integral it is 45 mrad."""
    arm = arm_on(rig, FOLLOWER, track_integral=True, gravity_factor=None).connect()
    arm.float()
    rig.lift(FOLLOWER, POSE)
    arm.clock.sleep(2.0)
    recorder = StateRecorder([arm._client])
    for pose in (THERE, POSE):
        rig.lift(FOLLOWER, pose, 2.0)
        for _ in range(250):
            arm.clock.sleep(0.01)
            recorder.poll()
    rig.release(FOLLOWER)
    trajectory = recorder.trajectory()
    arm.move_to([0.0, 0.5, 0.5, 0.0, 0.0, 0.0])
    recorders.truth_start(rig, FOLLOWER, 30.0)
    arm.replay(trajectory)
    truth, begun_s = recorders.truth(rig, FOLLOWER), arm.clock.now() - trajectory.seconds

    def error(lag_s):
        times = begun_s + lag_s + trajectory.times_s
        there = [np.interp(times, truth["stamp_s"], truth["q"][:, joint]) for joint in range(6)]
        return np.abs(np.array(there).T - trajectory.positions[:, :6])

    nearest = min((error(lag_s) for lag_s in np.arange(-0.5, 0.1, 0.004)), key=np.sum)
    assert np.percentile(nearest, 99) < 0.005 and nearest.max() < 0.006, nearest.max(axis=0)
    np.testing.assert_allclose(true_q(rig), trajectory.positions[-1, :6], atol=0.005)
    arm._session.discard()


def test_a_trajectory_that_does_not_fit_moves_nothing(rig, arm):
    before = arm.observe().setpoint_q
    with pytest.raises(ActionError, match="is of other joints"):
        arm.replay(Trajectory(np.arange(2.0), np.array([POSE, THERE])))
    with pytest.raises(ActionError, match="joint_4 is at 3.000 in row 1"):
        arm.replay(Trajectory(np.arange(2.0), np.array([[*POSE, 0.5], [*POSE[:3], 3.0, 0.0, 0.0, 0.5]])))
    arm.clock.sleep(0.1)
    np.testing.assert_array_equal(arm.observe().setpoint_q, before)


def test_states_are_recorded_into_a_file(rig, arm, tmp_path):
    with arm.recording(tmp_path / "deep" / "states.npz"):
        arm.move_joints(THERE, 1.0)
    states = np.load(tmp_path / "deep" / "states.npz")
    assert states["names"].tolist() == [f"joint_{i}" for i in range(1, 7)] + ["gripper"]
    assert len(states["stamp_s"]) > 100 and np.all(np.diff(states["stamp_s"]) > 0.0)
    np.testing.assert_allclose(states["q"][-1, :6], THERE, atol=0.02)
    for name in ("dq", "tau_nm", "temp_mos_c", "temp_rotor_c"):
        assert states[name].shape == states["q"].shape
    with pytest.raises(ConfigError, match="cannot be written"), arm.recording(tmp_path / "deep" / "states.npz" / "x"):
        pass


def test_it_says_what_it_is(rig, arm):
    info = arm.info()
    assert (info.name, info.channel, info.arm, info.gripper) == (FOLLOWER, FOLLOWER, "yam", "linear_4310")
    assert len(info.joint_names) == 6 and len(info.motor_types) == 7 and info.has_gripper
    assert info.joint_limits_rad.shape == (6, 2) and info.firmware == {} and info.versions["mujoco"]
