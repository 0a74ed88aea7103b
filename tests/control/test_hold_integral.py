"""The integral while holding, on a simulated joint with dry friction, a quantised reading and a 4 ms tick."""

import math

import numpy as np
import pytest

from lerobot_robot_yam.control.laws.sag import HoldIntegral

TICK_S = 0.004
READING_RAD = 25.0 / 65535
KP, KD = 80.0, 5.0


def settle(integral, friction, inertia, load, kp=KP, kd=KD, stiction=1.0, seconds=12.0, holding=lambda now: True):
    """Positions of a joint whose set-point is 0, from where its spring carries `load` Nm; one per tick."""
    q, dq, path = -load / kp, 0.0, []
    for tick in range(round(seconds / TICK_S)):
        reading = math.floor(q / READING_RAD) * READING_RAD
        tau = float(integral.advance(np.array([-reading]), TICK_S, holding(tick * TICK_S))[0])
        for _ in range(16):
            drive = -kp * q - kd * dq + tau - load
            if dq == 0.0 and abs(drive) <= stiction * friction:
                break
            before = dq
            dq += (drive - math.copysign(friction, dq or drive)) / inertia * TICK_S / 16
            if before * dq < 0.0:
                dq = 0.0
            q += dq * TICK_S / 16
        path.append(q)
    return np.array(path)


@pytest.mark.parametrize("inertia", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("friction, stiction", [(0.0, 1.0), (0.3, 1.0), (1.0, 1.0), (0.6, 1.5), (1.0, 1.5)])
def test_thirty_milliradians_of_sag_are_gone_in_three_seconds_without_hunting(inertia, friction, stiction):
    integral = HoldIntegral.for_stiffness(np.array([KP]))
    path = settle(integral, friction, inertia, load=0.03 * KP, stiction=stiction)
    assert path[0] < -0.025
    assert np.abs(path[round(3.0 / TICK_S) :]).max() < 0.004
    assert path.max() < 0.2 * 0.03  # overshoot
    assert np.ptp(path[-round(5.0 / TICK_S) :]) < 0.0005  # and then it stands still


def test_a_wrist_behaves_like_a_shoulder():
    path = settle(HoldIntegral.for_stiffness(np.array([10.0])), 0.06, 0.02, load=0.3, kp=10.0, kd=1.5)
    assert np.abs(path[round(3.0 / TICK_S) :]).max() < 0.004 and path.max() < 0.006


def test_the_torque_is_bounded_and_what_it_cannot_carry_stays():
    integral = HoldIntegral(np.array([120.0]), np.array([2.0]))
    path = settle(integral, 0.1, 0.3, load=4.0, seconds=8.0)
    assert integral.tau[0] == 2.0
    assert path[-1] == pytest.approx(-2.0 / KP, abs=0.003)


def test_it_fades_when_the_arm_moves_and_comes_back_when_it_rests():
    integral = HoldIntegral.for_stiffness(np.array([KP]))
    path = settle(integral, 0.0, 0.3, load=2.4, seconds=10.0, holding=lambda now: not 5.0 <= now < 6.5)
    moving = path[round(5.0 / TICK_S) : round(6.5 / TICK_S)]
    assert moving[-1] == pytest.approx(-0.03 * (1 - math.exp(-1.5 / 0.5)), abs=0.003)
    assert np.abs(np.diff(moving)).max() < 0.03 / 0.5 * TICK_S * 1.2  # it sags slowly
    assert abs(path[-1]) < 0.003


def test_what_is_no_sag_is_left_alone():
    integral = HoldIntegral.for_stiffness(np.full(3, KP))
    for _ in range(500):
        integral.advance(np.array([0.3, 0.0015, -0.02]), TICK_S, True)  # held by somebody, in the deadband, sag
    assert integral.tau[0] == 0.0 and integral.tau[1] == 0.0 and integral.tau[2] < -1.0


def test_it_does_not_wind_up_against_the_torque_clip():
    integral = HoldIntegral.for_stiffness(np.array([KP]))
    for _ in range(250):
        integral.advance(np.array([0.02]), TICK_S, True)
    before = integral.tau.copy()
    for _ in range(250):
        integral.advance(np.array([0.02]), TICK_S, True, clipped=True)
    assert integral.tau[0] == before[0] > 0.0
    integral.advance(np.array([-0.02]), TICK_S, True, clipped=True)
    assert integral.tau[0] < before[0]  # the way out is free
