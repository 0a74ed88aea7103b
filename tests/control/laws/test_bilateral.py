"""The force at a leader: what a hand feels, what an arm without a hand does, and that nothing ever grows."""

import numpy as np
import pytest

from lerobot_robot_yam.arm.profile_files import load_arm
from lerobot_robot_yam.control.laws.bilateral import BilateralForce
from tests.support.held_leader import TICK_S, HeldLeader

POSE = np.array([0.0, 1.0, 1.0, -0.3, 0.0, 0.0])
SAG_NM = np.array([0.0, 2.0, 1.0, 0.2, 0.0, 0.0])
KP = np.array(load_arm("yam").kp)
LIMIT_NM = np.array(load_arm("yam").torque_limit_nm)
STEADY = 0.02  # rad/s: what the steps of readings make of an arm at rest


def force(gain=0.5):
    return BilateralForce(np.full(6, gain), KP, LIMIT_NM)


def test_no_gain_is_no_force():
    law = force(0.0)
    assert not law.works and not law.damping.any()
    assert not law.torque(np.full(6, 0.2), np.ones(6), np.zeros(6), TICK_S).any()


@pytest.mark.parametrize("weight_nm", [0.0, 8.0])
def test_engaging_is_gentle_and_never_yanks(weight_nm):
    law = force()
    law.engage()
    weight, taus = np.full(6, weight_nm), []
    for _ in range(1250):  # 5 s
        taus.append(law.torque(np.full(6, 0.5), np.zeros(6), weight, TICK_S))
    taus = np.abs(taus)
    assert taus[:125].max() <= max(1.0, 0.5 * weight_nm) + 1e-9
    assert taus[0].max() == 0.0 and np.diff(taus, axis=0).max() < 0.05
    assert taus[-1] == pytest.approx(np.minimum(0.5 * KP * 0.5, 0.25 * LIMIT_NM))


def test_the_force_is_bounded_well_within_the_torque_limits():
    law = force()
    for _ in range(2000):
        tau = law.torque(np.full(6, 3.0), np.zeros(6), np.zeros(6), TICK_S)
    assert (np.abs(tau) <= 0.25 * LIMIT_NM).all()


def test_a_hand_that_holds_still_feels_a_push_on_the_follower_all_the_time():
    pair = HeldLeader(POSE, 0.2, 2000.0, 1.0, 0.5)
    pair.run(0.8)
    pair.sag = SAG_NM
    _, _, tau = pair.run(3.0)
    assert tau[-1, 1] == pytest.approx(0.2 * SAG_NM[1], rel=0.05)


def test_a_push_is_felt_within_two_ticks_of_the_follower_moving():
    """A tenth of what it will be, when the follower has moved by 1 mrad or by a tenth, whichever is more."""
    pair = HeldLeader(POSE, 0.2, 2000.0, 1.0, 0.5)
    pair.run(0.8)
    pair.sag = SAG_NM
    moved, tau = [], []
    for _ in range(250):
        _, _, torque = pair.run(TICK_S)
        moved.append(pair.follower.q[1])
        tau.append(torque[-1, 1])
    first = int(np.argmax(np.abs(moved) > max(1e-3, 0.1 * np.abs(moved[-1]))))
    assert tau[first + 2] > 0.1 * tau[-1]


@pytest.mark.parametrize("gain", [0.2, 0.5])
def test_a_leader_let_go_comes_to_rest_where_an_ungated_one_wanders_off(gain):
    gated, plain = (HeldLeader(POSE, gain, 0.0, 0.1, 0.5, gated=gated, sag_nm=SAG_NM) for gated in (True, False))
    speeds, way, _ = gated.run(4.0)
    assert np.abs(speeds[-100:]).max() < STEADY
    assert np.abs(way[-1]).max() < 0.5
    speeds, way, _ = plain.run(4.0)
    assert np.abs(speeds[-100:]).max() > 1.0 and np.abs(way[-1]).max() > 3.0


def decays(seed):
    """A pair about a random pose, in a random hand, is jolted; the largest energy, J, by windows of 0.4 s.

    Speeds of joints pass from one to the other, and a spring gives back what it has taken: only energy tells growth.
    """
    rng = np.random.default_rng(seed)
    low, high = load_arm("yam").joint_limits_rad.T
    stiffness = 0.0 if rng.random() < 0.2 else rng.uniform(0.0, 2000.0)
    mass_kg = float(np.exp(rng.uniform(np.log(0.1), np.log(2.0))))
    gain = rng.choice([0.0, 0.1, 0.2, 0.35, 0.5])
    pair = HeldLeader(
        rng.uniform(low, high), gain, stiffness, mass_kg, rng.uniform(0.05, 1.0), blocked=rng.random() < 0.3
    )
    pair.run(0.6)  # until the force has faded in
    pair.leader.dq = rng.uniform(-0.5, 0.5, 6)
    pair.run(2.4)
    return np.array(pair.energies_j[-600:]).reshape(6, -1).max(axis=1)


def check_decays(seed):
    """An arm of which nothing but its joints' own damping takes energy away keeps three quarters of it in 2 s."""
    windows = decays(seed)
    assert (windows[1:] < windows[:-1] + 1e-3 * windows[0]).all(), windows  # the steps of readings move an arm at rest
    assert windows[-1] < 0.8 * windows[0], windows


@pytest.mark.parametrize("seed", range(8))
def test_a_jolt_decays(seed):
    check_decays(seed)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(8, 200))
def test_a_jolt_decays_in_any_hand_and_pose(seed):
    check_decays(seed)
