"""Casters and odometry against the vendor's own numbers, and against a model that does not share their formulas."""

import json
import math

import numpy as np
import pytest

from lerobot_robot_yam.mobile.base_profile import FLIP_RAD_S, BaseProfile
from lerobot_robot_yam.mobile.casters import Casters
from lerobot_robot_yam.mobile.odometry import Odometry, to_body, to_world
from tests.support.paths import ROOT

CASES = json.loads((ROOT / "tests" / "golden" / "flow_base.json").read_text())["cases"]
EXACT = dict(rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("case", CASES, ids=range(len(CASES)))
def test_golden(case):
    casters, steer = Casters(BaseProfile()), np.array(case["steer_angles"])
    columns = np.column_stack([casters.rates(steer, unit) for unit in np.eye(3)])
    np.testing.assert_allclose(columns, case["twist_to_rates"], **EXACT)
    columns = np.column_stack([casters.twist(steer, unit) for unit in np.eye(8)])
    np.testing.assert_allclose(columns, case["rates_to_twist"], **EXACT)
    rates = np.column_stack((case["steer_rates"], case["drive_rates"])).ravel()
    np.testing.assert_allclose(casters.twist(steer, rates), case["body_twist"], **EXACT)
    commanded = casters.rates(steer, np.array(case["commanded_twist"]))
    np.testing.assert_allclose(commanded, case["motor_rates_for_commanded_twist"], **EXACT)
    odometry = Odometry()
    odometry.pose = np.array(case["pose_before"])
    odometry.step(np.array(case["body_twist"]), case["dt"])
    np.testing.assert_allclose(odometry.pose, case["pose_after"], **EXACT)


def random_profile(rng):
    """A base of no maker's, so that no symmetry hides a wrong sign."""
    hx, hy = rng.uniform(0.1, 0.4, (2, 4)) * [[-1, 1, 1, -1], [1, 1, -1, -1]]
    return BaseProfile(tuple(hx), tuple(hy), rng.uniform(-0.1, -0.01), rng.uniform(-0.01, 0.01), rng.uniform(0.03, 0.1))


@pytest.mark.parametrize("seed", range(20))
def test_a_wheel_neither_slips_nor_slides(seed):
    """Geometry alone: where a caster's contact point goes, its wheel has rolled."""
    rng = np.random.default_rng(seed)
    profile = random_profile(rng)
    casters, steer, twist = Casters(profile), rng.uniform(-math.pi, math.pi, 4), rng.uniform(-1, 1, 3)
    rates = casters.rates(steer, twist)
    assert casters.twist(steer, rates) == pytest.approx(twist, abs=1e-12)
    for k in range(4):
        turn = np.array([[np.cos(steer[k]), -np.sin(steer[k])], [np.sin(steer[k]), np.cos(steer[k])]])
        arm = turn @ [profile.b_x_m, profile.b_y_m]
        point = np.array([profile.h_x_m[k], profile.h_y_m[k]]) + arm
        spin = np.array([[0.0, -1.0], [1.0, 0.0]])
        moves = twist[:2] + twist[2] * spin @ point + rates[2 * k] * spin @ arm
        rolls = profile.radius_m * rates[2 * k + 1] * turn @ [1.0, 0.0]
        assert moves == pytest.approx(rolls, abs=1e-12)


def test_least_squares_spread_what_does_not_fit():
    """A wheel that slips moves the estimate by its share, not by more."""
    casters, steer = Casters(BaseProfile()), np.zeros(4)
    rates = casters.rates(steer, np.array([0.5, 0.0, 0.0]))
    rates[1] *= 1.2
    assert casters.twist(steer, rates)[0] == pytest.approx(0.5 * 1.05, abs=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_casters_that_trail_slow_nothing(seed):
    rng = np.random.default_rng(seed)
    casters, twist = Casters(BaseProfile()), rng.uniform(-1, 1, 3) * [1.0, 1.0, math.pi]
    steer = rng.uniform(-math.pi, math.pi, 4)
    for _ in range(2000):
        steer = steer + 0.001 * casters.rates(steer, twist)[0::2]
    assert casters.slow_down(steer, twist) == 1.0


@pytest.mark.parametrize("seed", range(50))
def test_no_caster_flips_on_its_way(seed):
    """From any steering angles, at the slowed twist, none is ever faster than a flip."""
    rng = np.random.default_rng(seed)
    casters, asked = Casters(BaseProfile()), rng.uniform(-1, 1, 3) * [1.0, 1.0, math.pi]
    steer = rng.uniform(-math.pi, math.pi, 4)
    factors = []
    for _ in range(3000):
        factors.append(casters.slow_down(steer, asked))
        rates = casters.rates(steer, asked * factors[-1])
        assert np.abs(rates[0::2]).max() <= FLIP_RAD_S + 1e-9
        steer = steer + 0.001 * rates[0::2]
    assert factors[-1] == 1.0 and casters.slow_down(steer, np.zeros(3)) == 1.0


def test_frames_turn_back():
    twist = np.array([0.3, -0.2, 0.5])
    assert to_world(np.array([1.0, 0.0, 0.5]), math.pi / 2) == pytest.approx([0.0, 1.0, 0.5])
    assert to_body(to_world(twist, 1.1), 1.1) == pytest.approx(twist)


def test_a_circle_closes_whatever_the_steps():
    rng, odometry, left = np.random.default_rng(0), Odometry(), 2.0 * math.pi
    while left > 0.0:
        dt = min(rng.uniform(0.002, 0.006), left)
        odometry.step(np.array([0.5, 0.0, 1.0]), dt)
        left -= dt
    assert odometry.pose == pytest.approx([0.0, 0.0, 2.0 * math.pi], abs=1e-4)
    odometry.reset()
    assert not odometry.pose.any() and not odometry.twist.any()
