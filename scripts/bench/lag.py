"""How a follower's true motion follows its leader's: lag, jerk, and what is left of the difference."""

from typing import NamedTuple

import numpy as np

_SMOOTH_S = 0.02  # window of the mean that differences are taken of, for the jerk
_LAG_MOST_S = 0.15


class Likeness(NamedTuple):
    """Per joint (n,).

    Attributes:
        lag_s: of the best cross-correlation.
        jerk_ratio: RMS jerk of the follower, a share of the leader's.
        error_rad: RMS of the difference, lag taken out.
    """

    lag_s: np.ndarray
    jerk_ratio: np.ndarray
    error_rad: np.ndarray


def likeness(stamps_s: np.ndarray, leader: np.ndarray, follower: np.ndarray) -> Likeness:
    """Compare q of leader and follower (k, n) at the same times (k,), equally spaced, rad."""
    step_s = float(np.median(np.diff(stamps_s)))
    found = [_of_joint(step_s, leader[:, joint], follower[:, joint]) for joint in range(leader.shape[1])]
    return Likeness(*(np.array(column) for column in zip(*found, strict=True)))


def _of_joint(step_s: float, leader: np.ndarray, follower: np.ndarray) -> tuple[float, float, float]:
    most = round(_LAG_MOST_S / step_s)
    errors = np.array([_rms(follower[shift:] - leader[: len(leader) - shift]) for shift in range(most)])
    best = int(errors.argmin())
    lag = float(best)
    if 0 < best < most - 1:  # the vertex of a parabola
        before, here, after = errors[best - 1 : best + 2] ** 2
        lag += 0.5 * (before - after) / (before - 2.0 * here + after)
    ratio = _rms(_jerk(follower, step_s)) / _rms(_jerk(leader, step_s))
    return lag * step_s, ratio, float(errors[best])


def _jerk(q: np.ndarray, step_s: float) -> np.ndarray:
    window = np.ones(max(round(_SMOOTH_S / step_s), 1))
    window /= len(window)
    smooth = np.convolve(np.convolve(q, window, "valid"), window, "valid")
    jerk: np.ndarray = np.diff(smooth, 3) / step_s**3
    return jerk


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
