"""Gains that change while an arm is energised: in a straight line, and damping keeps its share all the way."""

import numpy as np

from lerobot_robot_yam.control.impedance import LiveGains

TICK_S = 0.004
KP, KD = np.array([80.0, 10.0]), np.array([5.0, 1.5])


def run(gains, seconds):
    """The gains (k, 2, n) of each tick."""
    seen = []
    for _ in range(round(seconds / TICK_S)):
        gains.advance(TICK_S)
        seen.append((gains.kp, gains.kd))
    return np.array(seen)


def test_they_go_over_within_half_a_second_in_small_steps():
    gains = LiveGains(KP, KD)
    gains.change(np.array([20.0, np.nan]), np.array([0.5, np.nan]))
    seen = run(gains, 0.6)
    np.testing.assert_array_equal(seen[-1], [[20.0, 10.0], [0.5, 1.5]])
    assert not gains.advance(TICK_S)
    assert np.abs(np.diff(seen, axis=0)).max() < 60.0 / 0.5 * TICK_S * 1.01
    assert (seen[:, 1] >= 0.02 * seen[:, 0]).all()  # of which a configuration has to give so much


def test_a_change_in_the_middle_goes_on_from_there():
    gains = LiveGains(KP, KD)
    gains.change(np.array([20.0, 10.0]), KD)
    half = run(gains, 0.25)[-1]
    gains.change(KP, KD)
    seen = run(gains, 0.6)
    assert 40.0 < half[0, 0] < 60.0 and np.all(np.diff(seen[:, 0, 0]) >= 0.0)
    np.testing.assert_array_equal(seen[-1], [KP, KD])


def test_a_reset_is_at_once():
    gains = LiveGains(KP, KD)
    gains.change(KP / 2, KD / 2)
    run(gains, 1.0)
    gains.reset()
    np.testing.assert_array_equal([gains.kp, gains.kd], [KP, KD])
    assert not gains.advance(TICK_S)
