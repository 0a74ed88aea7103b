"""The base over CAN frames, in lock-step with its rig: life cycle, driving, lost commands, faults, stops."""

import contextlib
import math

import numpy as np
import pytest

from lerobot_robot_yam.errors import ActionError, ConfigError, LifeCycleError, MotorError
from lerobot_robot_yam.mobile.base_profile import CASTERS, FLIP_RAD_S, BaseProfile
from lerobot_robot_yam.mobile.casters import Casters
from lerobot_robot_yam.mobile.odometry import Odometry
from lerobot_robot_yam.rig.lockstep.lockstep_rig import LockstepRig
from lerobot_robot_yam.session.yam_base import YamBase
from lerobot_robot_yam.state.emergency_stop import EmergencyStop
from lerobot_robot_yam.state.modes import Mode
from tests.support.tiers import spread


@pytest.fixture
def rig():
    with contextlib.closing(LockstepRig("mobile")) as rig:
        yield rig


@pytest.fixture
def base(rig):
    base = made(rig)
    with base:
        yield base


def made(rig, **fields):
    return YamBase(
        channel="base", interface="yam_lockstep", can_options={"rig": rig.name}, isolation="lockstep", **fields
    )


def drive(base, velocity, seconds, frame="local", look=lambda: None):
    for _ in range(round(seconds / 0.05)):
        base.set_target_velocity(velocity, frame)
        base.clock.sleep(0.05)
        look()


def truth(rig):
    return np.array(rig.state()["base"]["pose"])


def enabled(rig):
    return [motor["enabled"] for motor in rig.state()["base"]["motors"].values()]


class Rolled(Odometry):
    """Where the base would be if its true wheels, read from the world at each of its steps, had not slipped."""

    def __init__(self, rig):
        super().__init__()
        data = rig.device.world.data
        self._joints = [data.joint(f"base/{name}_{kind}") for name in CASTERS for kind in ("steer", "drive")]
        self._casters, self._q = Casters(BaseProfile()), self._angles()
        rig.device.each_advance.append(self._roll)

    def _angles(self):
        return np.array([joint.qpos[0] for joint in self._joints])

    def _roll(self):
        before, self._q = self._q, self._angles()
        middle = (before[0::2] + self._q[0::2]) / 2.0
        self.step(self._casters.twist(middle, self._q - before), 1.0)


def test_it_stands_drives_brakes_and_is_off_at_the_end(rig):
    with made(rig) as base:
        assert base.observe().mode is Mode.HOLD and all(enabled(rig))
        drive(base, [0.4, 0.0, 0.0], 4.0)
        assert base.observe().mode is Mode.TRACK
        assert base.odometry().body_twist == pytest.approx([0.4, 0.0, 0.0], abs=0.02)
        base.clock.sleep(0.25 + 0.4 / 0.25 + 0.1)  # time-out and planned braking
        state = base.observe()
        assert state.mode is Mode.HOLD and np.abs(state.twist).max() < 0.01
        assert state.pose == pytest.approx(truth(rig), abs=0.02)
        drive(base, [0.4, 0.0, 0.0], 2.0)
    assert not any(enabled(rig))


def test_a_base_that_rolls_is_not_energised(rig):
    data = rig.device.world.data
    data.joint("base").qvel[0] = 0.5
    for name in CASTERS:
        data.joint(f"base/{name}_drive").qvel[0] = 0.5 / BaseProfile().radius_m
    with pytest.raises(MotorError, match="it rolls, and would be stopped with a jerk; hold it still"):
        made(rig, skip_listen=True).connect()
    assert not any(enabled(rig)) and truth(rig)[0] > 0.0


def test_odometry_agrees_with_the_world_after_all_kinds_of_motion(rig, base):
    for velocity in ([0.4, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 1.0], [-0.3, 0.2, -0.5]):
        drive(base, velocity, 3.0)
    base.clock.sleep(3.0)
    away = base.odometry().pose - truth(rig)
    assert math.hypot(*away[:2]) < 0.05 and abs(math.remainder(away[2], math.tau)) < 0.05


def test_the_global_frame_stays_while_the_base_turns(rig, base):
    base.reset_odometry()
    drive(base, [0.2, 0.0, 0.5], 4.0, "global")
    pose = base.odometry().pose
    assert pose[0] > 0.6 and abs(pose[1]) < 0.05 and pose[2] > 1.4


def test_a_pose_is_reached(rig, base):
    for _ in range(160):
        base.set_target_pose([0.5, -0.3, 1.0])
        base.clock.sleep(0.05)
    assert base.odometry().pose == pytest.approx([0.5, -0.3, 1.0], abs=0.01)
    goal = base.set_target_pose([0.1, 0.0, 0.0], "local")
    assert goal == pytest.approx([0.5 + 0.1 * math.cos(1.0), -0.3 + 0.1 * math.sin(1.0), 1.0], abs=0.02)


def test_low_limits_let_no_base_roll_on_without_torque(rig):
    """Braking from 0.4 m/s by 0.05 m/s² would take 8 s: longer than the end of a session waits."""
    with made(rig, acceleration_limit=[0.05, 0.05, 0.05]) as base:
        drive(base, [0.4, 0.0, 0.0], 9.0)
        assert base.odometry().body_twist[0] > 0.38
    there = truth(rig)
    rig.sleep(0.5)
    assert truth(rig) == pytest.approx(there, abs=5e-3) and not any(enabled(rig))


@pytest.mark.long
def test_ten_metres_square_closes(rig, base):
    rolled = Rolled(rig)
    for corner in ((2.5, 0.0, 0.0), (2.5, 2.5, 0.0), (0.0, 2.5, 0.0), (0.0, 0.0, 0.0)):
        for _ in range(180):
            base.set_target_pose(corner)
            base.clock.sleep(0.05)
    measured, true = base.odometry().pose, truth(rig)
    assert math.hypot(*measured[:2]) < 0.005 and abs(measured[2]) < math.radians(0.5)
    assert math.hypot(*rolled.pose[:2]) < 0.005 and abs(rolled.pose[2]) < math.radians(0.5)  # without slip
    assert math.hypot(*true[:2]) < 0.02 and abs(true[2]) < math.radians(0.5)


def test_no_caster_flips_when_the_direction_reverses(base):
    fastest = []
    look = lambda: fastest.append(np.abs(base.observe().steer_rad_s).max())  # noqa: E731
    drive(base, [0.5, 0.0, 0.0], 3.0)
    drive(base, [-0.5, 0.01, 0.0], 6.0, look=look)
    assert base.odometry().body_twist[0] == pytest.approx(-0.5, abs=0.03)
    assert max(fastest) < 1.15 * FLIP_RAD_S


def test_a_stop_brakes_and_its_release_moves_nothing(rig, base, monkeypatch):
    drive(base, [0.5, 0.0, 0.0], 3.0)
    stop = EmergencyStop()
    stop.latch("a test")
    try:
        base.clock.sleep(0.5 / 0.8 + 0.2)
        assert base.observe().mode is Mode.STOPPED and np.abs(base.odometry().twist).max() < 0.02
        assert not base.set_target_velocity([0.5, 0.0, 0.0]).any()
        base.clock.sleep(0.2)
        there = truth(rig)
    finally:
        stop.release()
    base.clock.sleep(0.5)
    assert base.observe().mode is Mode.HOLD and truth(rig) == pytest.approx(there, abs=2e-3)


@pytest.mark.parametrize("motor", ["front_left_steer", "rear_right_drive"])
def test_a_silent_motor_stops_the_base_by_name(rig, base, motor):
    drive(base, [0.4, 0.0, 0.0], 3.0)
    rig.fault("base", motor, "silent", True)
    base.clock.sleep(2.0)
    with pytest.raises(MotorError, match=motor):
        base.observe()
    there = truth(rig)
    base.clock.sleep(0.5)
    assert truth(rig) == pytest.approx(there, abs=5e-3)
    with pytest.raises(MotorError, match=motor):
        base.set_target_velocity([0.1, 0.0, 0.0])
    rig.fault("base", motor, "silent", False)
    base.rearm()
    drive(base, [0.2, 0.0, 0.0], 2.0)
    assert base.odometry().body_twist[0] == pytest.approx(0.2, abs=0.02)


def test_a_caster_that_does_not_turn_is_named(rig, base):
    rig.fault("base", "front_left_steer", "stuck", True)
    with pytest.raises(MotorError, match="front_left_steer .* does not steer"):
        drive(base, [0.0, 0.5, 0.0], 4.0)


@pytest.mark.parametrize("velocity, damping", spread([(0.3, 1e3), (0.3, 0.0), (0.08, 1e3), (0.08, 0.0)], 1))
def test_a_base_that_pushes_against_something_stops(rig, base, velocity, damping):
    world = rig.device.world
    push_n = world.data.xfrc_applied[world.model.body("base").id]

    def wall():  # stiff; the base bounces off it, unless it is damped
        depth_m, speed = truth(rig)[0] - 0.2, world.data.qvel[world.model.joint("base").dofadr[0]]
        push_n[0] = min(-5e4 * depth_m - damping * speed, 0.0) if depth_m > 0.0 else 0.0

    rig.device.each_advance.append(wall)
    with pytest.raises(MotorError, match=r"_drive \(id \d\).* does not turn as commanded: something is in the way"):
        drive(base, [velocity, 0.0, 0.0], 5.0)
    there = truth(rig)
    base.clock.sleep(3.0)
    assert push_n[0] > -20.0 and truth(rig) == pytest.approx(there, abs=0.02)  # N; it pushed by 500
    rig.device.each_advance.remove(wall)
    push_n[0] = 0.0
    base.rearm()
    drive(base, [-0.2, 0.0, 0.0], 2.0)
    assert base.odometry().body_twist[0] == pytest.approx(-0.2, abs=0.02)


@pytest.mark.parametrize(
    "wrong", [[math.nan, 0.0, 0.0], [0.0, 0.0], ["fast", 0.0, 0.0], None], ids=["nan", "two", "text", "none"]
)
def test_a_velocity_that_is_none_moves_nothing(base, wrong):
    with pytest.raises(ActionError, match="base"):
        base.set_target_velocity(wrong)
    with pytest.raises(ActionError, match="frame is local or global, not 'body'"):
        base.set_target_velocity([0.1, 0.0, 0.0], "body")
    assert base.observe().mode is Mode.HOLD


def test_too_fast_is_limited_in_its_direction(base):
    assert base.set_target_velocity([2.0, 1.0, 0.0]) == pytest.approx([0.5, 0.25, 0.0])


def test_what_is_refused(rig, base):
    with pytest.raises(ConfigError, match="BaseConfig has no field"):
        made(rig, speed=3)
    with pytest.raises(ConfigError, match="rate_hz is 100 to 350, not 20"):
        made(rig, rate_hz=20)
    base.set_target_pose([0.5, 0.0, 0.0])
    base.clock.sleep(0.02)
    with pytest.raises(LifeCycleError, match="drives to a pose"):
        base.reset_odometry()
