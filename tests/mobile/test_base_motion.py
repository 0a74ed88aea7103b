"""The base's plan on casters that do as they are told: limits, frames, curves, flips, poses."""

import math

import numpy as np
import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.mobile.base_limits import BaseLimits
from lerobot_robot_yam.mobile.base_motion import BaseMotion
from lerobot_robot_yam.mobile.base_profile import FLIP_RAD_S, BaseProfile
from lerobot_robot_yam.mobile.base_target import REST, Frame, Target
from lerobot_robot_yam.mobile.rail_motion import RailMotion

DT = 0.004
USUAL = BaseLimits()


class Wheels:
    """Casters without mass: steering turns at the rate asked, and the odometry measures what was asked."""

    def __init__(self, limits=USUAL, steer=(0.0, 0.0, 0.0, 0.0)):
        self.motion, self.limits = BaseMotion(BaseProfile(), limits), limits
        self.steer, self.fastest, self.sharpest = np.array(steer, dtype=float), 0.0, np.zeros(3)

    def run(self, target, seconds, dt=DT, most_speed=1.0):
        for _ in range(round(seconds / dt)):
            before = self.motion.velocity
            rates = self.motion.advance(target, self.steer, dt, most_speed)
            self.fastest = max(self.fastest, np.abs(rates[0::2]).max())
            self.sharpest = np.maximum(self.sharpest, np.abs(self.motion.velocity - before) / dt)
            self.motion.measure(self.steer, rates, dt)
            self.steer = self.steer + rates[0::2] * dt

    @property
    def pose(self):
        return self.motion.odometry.pose

    def check(self):
        assert self.fastest <= FLIP_RAD_S + 1e-6
        assert (self.sharpest <= np.array(self.limits.acceleration) + 1e-9).all()


def test_a_velocity_is_reached_and_left_within_the_limits():
    wheels = Wheels()
    wheels.run(Target(np.array([0.4, 0.0, 0.0])), 1.6)
    assert wheels.motion.velocity == pytest.approx([0.4, 0.0, 0.0], abs=1e-6)
    wheels.run(REST, 1.6)
    assert wheels.pose == pytest.approx([0.4 * 1.6, 0.0, 0.0], abs=2e-3) and not wheels.motion.velocity.any()
    wheels.check()


def test_too_much_is_limited_in_its_own_direction():
    wheels = Wheels()
    wheels.run(Target(np.array([3.0, 1.5, 0.0])), 4.0)
    assert wheels.motion.velocity == pytest.approx([0.5, 0.25, 0.0], abs=1e-6)


def test_frames():
    local, world = Wheels(), Wheels()
    for wheels in (local, world):
        wheels.motion.odometry.pose[2] = math.pi / 2
    local.run(Target(np.array([0.2, 0.0, 0.0])), 3.0)
    world.run(Target(np.array([0.2, 0.0, 0.0]), Frame.GLOBAL), 3.0)
    assert local.pose[1] > 0.4 and abs(local.pose[0]) < 0.01
    assert world.pose[0] > 0.4 and abs(world.pose[1]) < 0.01


def test_a_curve_is_driven_as_one():
    """Its acceleration towards the middle is kept within the limits by going slower, not by leaving the curve."""
    wheels = Wheels()
    wheels.run(Target(np.array([0.5, 0.0, 1.2])), 10.0)
    body = wheels.motion.odometry.body_twist
    assert body[1] / body[0] == pytest.approx(0.0, abs=0.02) and body[2] / body[0] == pytest.approx(2.4, abs=0.05)
    assert body[0] * body[2] == pytest.approx(0.25, abs=0.01)
    wheels.check()


def test_a_reversal_flips_no_caster():
    wheels = Wheels(BaseLimits((1.0, 1.0, math.pi), (0.8, 0.8, 3.0)))
    wheels.run(Target(np.array([1.0, 0.0, 0.0])), 3.0)
    wheels.steer += 1e-3  # no caster trails exactly
    wheels.run(Target(np.array([-1.0, 0.0, 0.0])), 6.0)
    assert wheels.motion.velocity[0] == pytest.approx(-1.0, abs=1e-6)
    assert np.abs(np.abs(wheels.steer) - math.pi).max() < 1e-3  # all have turned round
    wheels.check()


def test_ten_thousand_commands_respect_every_limit():
    rng = np.random.default_rng(53)
    for limits in (BaseLimits(), BaseLimits((1.0, 1.0, math.pi), (0.8, 0.8, 3.0))):
        wheels = Wheels(limits, rng.uniform(-math.pi, math.pi, 4))
        for _ in range(2_500):
            values = rng.uniform(-2.0, 2.0, 3) * rng.integers(0, 2, 3)
            wheels.run(Target(values, Frame(rng.integers(2))), rng.uniform(0.004, 0.02), rng.uniform(0.003, 0.012))
        for _ in range(2_500):
            wheels.run(
                Target(rng.uniform(-1.0, 1.0, 3), pose=True), rng.uniform(0.004, 0.02), rng.uniform(0.003, 0.012)
            )
        wheels.check()


@pytest.mark.parametrize("pose", [(1.0, -0.5, 1.5), (0.01, 0.0, 0.0), (0.0, 0.0, 3.0), (-0.7, 0.7, -3.0)], ids=str)
def test_a_pose_is_reached_and_kept(pose):
    wheels = Wheels()
    wheels.run(Target(np.array(pose), pose=True), 9.0)
    assert wheels.pose == pytest.approx(pose, abs=4e-3) and np.abs(wheels.motion.velocity).max() < 2e-3
    there = wheels.pose.copy()
    wheels.run(Target(np.array(pose), pose=True), 3.0)
    assert wheels.pose == pytest.approx(there, abs=1e-3)
    wheels.check()


def test_a_pose_is_approached_the_shorter_way_round():
    wheels = Wheels()
    wheels.motion.odometry.pose[2] = 3.0
    wheels.run(Target(np.array([0.0, 0.0, -3.0]), pose=True), 3.0)
    assert wheels.pose[2] == pytest.approx(2.0 * math.pi - 3.0, abs=4e-3)


def test_ten_metres_square_closes():
    wheels = Wheels()
    for corner in ((2.5, 0.0, 0.0), (2.5, 2.5, 0.0), (0.0, 2.5, 0.0), (0.0, 0.0, 0.0)):
        wheels.run(Target(np.array(corner), pose=True), 9.0)
    assert wheels.pose == pytest.approx([0.0, 0.0, 0.0], abs=2e-3)


def test_a_jerk_limit_makes_starts_soft():
    soft = BaseLimits(jerk=(0.5, 0.5, 1.5))
    wheels = Wheels(soft)
    before = 0.0
    for _ in range(500):
        last = wheels.motion.velocity[0]
        wheels.run(Target(np.array([0.4, 0.0, 0.0])), DT)
        acceleration = (wheels.motion.velocity[0] - last) / DT
        assert abs(acceleration - before) <= 0.5 * DT + 1e-9
        before = acceleration
    wheels.check()


def test_a_share_of_the_speed():
    wheels = Wheels()
    wheels.run(Target(np.array([0.5, 0.0, 0.0])), 3.0, most_speed=0.2)
    assert wheels.motion.velocity[0] == pytest.approx(0.1, abs=1e-6)
    wheels.run(Target(np.array([0.5, 0.0, 0.0]), pose=True), 1.0, most_speed=0.2)
    assert np.abs(wheels.motion.velocity).max() <= 0.1 + 1e-6


@pytest.mark.parametrize(
    "wrong",
    [
        {"velocity": (1.1, 0.5, 1.0)},
        {"velocity": (0.0, 0.5, 1.0)},
        {"acceleration": (0.1, math.nan, 1.0)},
        {"jerk": (1.0, 1.0)},
    ],
    ids=str,
)
def test_limits_that_are_none(wrong):
    with pytest.raises(ConfigError, match="base: "):
        BaseLimits(**wrong)


def test_a_way_that_braking_just_takes_is_braked():
    """There ruckig's solver finds no root, for some numbers; these stopped the base in a soak, or would have."""
    base = BaseMotion(BaseProfile(), USUAL)
    base.velocity = np.array([0.0, 0.0, 0.4410025596224707])
    base.advance(Target(np.array([0.0, 0.0, 0.1230906693630195]), Frame.GLOBAL, pose=True), np.full(4, 0.5), DT)
    assert base.velocity == pytest.approx([0.0, 0.0, 0.4410025596224707 - 0.79 * DT])
    rail = RailMotion()
    rail.restart(6.86765274124345, -12.34011103081948)
    rail.reach(2.307495994506752, 12.43693304737811, 16.69661249713893, DT)
    assert rail.velocity == pytest.approx(-12.34011103081948 + 16.69661249713893 * DT)
