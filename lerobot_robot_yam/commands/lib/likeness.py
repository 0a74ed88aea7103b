"""How a follower's motion follows its leader's: lag, jerk, and what is left of the difference."""

from typing import NamedTuple

import numpy as np

_SMOOTH_S = 0.04  # a mean over this, twice, is differentiated for the jerk: what a hand feels, and a camera sees
_LAG_MOST_S = 0.15
_MOVED_RAD = 0.05  # a joint that moves less tells no lag


class Likeness(NamedTuple):
    """Of n joints. NaN where a joint has not moved.

    Attributes:
        lag_s: (n,) of the best fit.
        error_rad: (n,) RMS of the difference, lag taken out.
        jerk_ratio: RMS jerk of the follower over all joints, a share of the leader's.
        joint_jerk_ratio: (n,) the same of each.
    """

    lag_s: np.ndarray
    error_rad: np.ndarray
    jerk_ratio: float
    joint_jerk_ratio: np.ndarray


def likeness(stamps_s: np.ndarray, leader: np.ndarray, follower: np.ndarray) -> Likeness:
    """Compare q of leader and follower (k, n) at the same times (k,), equally spaced, rad."""
    step_s = float(np.median(np.diff(stamps_s)))
    joints = range(leader.shape[1])
    lags, errors = zip(*(_lag(step_s, leader[:, joint], follower[:, joint]) for joint in joints), strict=True)
    led, follows = (np.array([_rms(_jerk(q[:, joint], step_s)) for joint in joints]) for q in (leader, follower))
    still = np.ptp(leader, axis=0) < _MOVED_RAD
    ratio = np.divide(follows, led, out=np.full(len(led), np.nan), where=~still)
    total = np.nan if still.all() else _rms(follows) / _rms(led)
    return Likeness(np.where(still, np.nan, lags), np.array(errors), total, ratio)


def _lag(step_s: float, leader: np.ndarray, follower: np.ndarray) -> tuple[float, float]:
    most = min(round(_LAG_MOST_S / step_s), len(leader) // 2)
    errors = np.array([_rms(follower[shift:] - leader[: len(leader) - shift]) for shift in range(most)])
    best = int(errors.argmin())
    lag = float(best)
    if 0 < best < most - 1:  # the vertex of a parabola
        before, here, after = errors[best - 1 : best + 2] ** 2
        lag += 0.5 * (before - after) / (before - 2.0 * here + after)
    return lag * step_s, float(errors[best])


def _jerk(q: np.ndarray, step_s: float) -> np.ndarray:
    window = np.ones(max(round(_SMOOTH_S / step_s), 1))
    window /= len(window)
    smooth = np.convolve(np.convolve(q, window, "valid"), window, "valid")
    jerk: np.ndarray = np.diff(smooth, 3) / step_s**3
    return jerk


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
