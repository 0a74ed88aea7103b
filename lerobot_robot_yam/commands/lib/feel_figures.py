"""Metrics of how a leader and its follower feel, from their states or from a data set. Pure: no files, no clock."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.profile import ArmProfile, GripperProfile
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.state.modes import Mode

SPEED_RAD_S = 0.5  # joint speed at which the drag of the motors is reported, rad/s
_STEP_S = 0.002  # step of the common time grid for samples of leader and follower, s
_LEAST_S = 1.0  # minimum time overlap of the two records, s
_MOVED_RAD = 0.1  # minimum motion of a joint for fitting its drag, rad
_MOVES_RAD_S = 0.05
_SMOOTH_S = 0.04  # window of the mean, applied twice before the jerk, s: keeps motions that hand or camera can sense
_LAG_MOST_S = 0.15
_FOLLOWED_RAD = 0.05  # minimum motion of a joint for computing its lag, rad


class Motion(NamedTuple):
    """Joint angles of leader and follower at the same times.

    Attributes:
        names: (n,) names of the joints.
        times_s: (k,) equally spaced times, s.
        leader, follower: (k, n) joint angles, rad.
    """

    names: Sequence[str]
    times_s: np.ndarray
    leader: np.ndarray
    follower: np.ndarray


def motion(leader: np.ndarray, follower: np.ndarray) -> Motion:
    """Interpolate the recorded states of two arms to common times.

    Raises:
        ConfigError: the arms' joint counts differ or are 0, or the records overlap for at most `_LEAST_S`.
    """
    counts = [int(states["joints"][-1]) for states in (leader, follower)]
    if counts[0] != counts[1] or not counts[0]:
        raise ConfigError(f"leader and follower have {counts[0]} and {counts[1]} joints; give a pair of arms")
    n = counts[0]
    stamps = [states["motor_stamp_s"][:, :n] for states in (leader, follower)]
    begin, end = max(own[0].max() for own in stamps), min(own[-1].min() for own in stamps)
    if not end - begin > _LEAST_S:
        raise ConfigError(f"the states have less than {_LEAST_S:g} s in common; measure for longer")
    times = np.arange(begin, end, _STEP_S)
    columns = [
        np.stack([np.interp(times, own[:, j], states["q"][:, j]) for j in range(n)], axis=1)
        for own, states in zip(stamps, (leader, follower), strict=True)
    ]
    return Motion([f"joint_{joint + 1}" for joint in range(n)], times - begin, *columns)


class Effort(NamedTuple):
    """Torques of a floating leader's motors. NaN for joints that were not moved.

    Attributes:
        dq: (k, n) joint speeds, rad/s.
        feedback_nm: (k, n) feedback r as defined in `effort`, Nm.
        drag_nm: (n,) drag of the motors, a + b |dq| at `SPEED_RAD_S`, Nm; negative: the motors help.
        friction_nm: (n,) dry friction from the profile, Nm.
    """

    dq: np.ndarray
    feedback_nm: np.ndarray
    drag_nm: np.ndarray
    friction_nm: np.ndarray

    @property
    def backdrive_nm(self) -> np.ndarray:
        """Hand torque (n,) that moves each joint at `SPEED_RAD_S`, without the part for inertia, Nm."""
        return self.drag_nm + self.friction_nm


def effort(leader: np.ndarray, arm: ArmProfile, gripper: GripperProfile) -> Effort:
    """Fit the torques of a floating leader's motors to records of its states.

    The leader's motors apply τ = k g(q) − a sign(dq) − b dq + r. k, a and b are fitted for each joint by least squares.
    The hand has to overcome the motors' drag, a + b |dq|, in addition to friction, which motors do not measure. The
    remainder r is the feedback: the torque with which the follower pulls the leader.

    Raises:
        ConfigError: the profile's joint count differs from the leader's.
    """
    n = int(leader["joints"][-1])
    if n != arm.joint_count:
        raise ConfigError(f"the leader has {n} joints, the profile {arm.name} {arm.joint_count}; give --arm")
    floats = leader[leader["mode"] == Mode.FLOAT]
    q, dq, tau = (floats[field][:, :n] for field in ("q", "dq", "tau"))
    feedback, drag = np.full(q.shape, np.nan), np.full(n, np.nan)
    if len(q) and tau.any():  # a leader without motors has no torques
        gravity = GravityModel(arm, gripper)
        weights = np.array([gravity.torque(row) for row in q])
        for joint in np.flatnonzero(np.ptp(q, axis=0) > _MOVED_RAD):
            speed = dq[:, joint]
            sign = np.clip(speed / _MOVES_RAD_S, -1.0, 1.0)
            terms = np.stack([weights[:, joint], -sign, -speed], axis=1)
            fit, *_ = np.linalg.lstsq(terms, tau[:, joint], rcond=None)
            drag[joint] = fit[1] + fit[2] * SPEED_RAD_S
            feedback[:, joint] = tau[:, joint] - terms @ fit
    return Effort(dq, feedback, drag, arm.friction_nm)


def periods_s(states: np.ndarray) -> np.ndarray:
    """Return the times between successive ticks of a control loop, s. `states`: recorded states of the loop."""
    following = np.diff(states["tick"]) == 1
    return np.diff(states["stamp_s"])[following]


class Likeness(NamedTuple):
    """Comparison of a follower's n joints with its leader's. Lag and ratios are NaN for joints that did not move.

    Attributes:
        lag_s: (n,) delay of the follower that minimises the RMS difference, s.
        error_rad: (n,) RMS difference at that delay, rad.
        jerk_ratio: RMS jerk of the follower over all joints, divided by the leader's.
        joint_jerk_ratio: (n,) the same ratio per joint.
    """

    lag_s: np.ndarray
    error_rad: np.ndarray
    jerk_ratio: float
    joint_jerk_ratio: np.ndarray


def likeness(stamps_s: np.ndarray, leader: np.ndarray, follower: np.ndarray) -> Likeness:
    """Compare joint angles of leader and follower (k, n), rad, at equally spaced times (k,), s."""
    step_s = float(np.median(np.diff(stamps_s)))
    lags, errors = np.array([_lag(step_s, *pair) for pair in zip(leader.T, follower.T, strict=True)]).T
    led, follows = (np.array([_rms(_jerk(q, step_s)) for q in side.T]) for side in (leader, follower))
    still = np.ptp(leader, axis=0) < _FOLLOWED_RAD
    ratio = np.divide(follows, led, out=np.full(len(led), np.nan), where=~still)
    total = np.nan if still.all() else _rms(follows) / _rms(led)
    return Likeness(np.where(still, np.nan, lags), errors, total, ratio)


def _lag(step_s: float, leader: np.ndarray, follower: np.ndarray) -> tuple[float, float]:
    most = min(round(_LAG_MOST_S / step_s), len(leader) // 2)
    errors = np.array([_rms(follower[shift:] - leader[: len(leader) - shift]) for shift in range(most)])
    best = int(errors.argmin())
    lag = float(best)
    if 0 < best < most - 1:  # refine: vertex of the parabola through three squared errors
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
