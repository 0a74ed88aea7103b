"""Control laws: from state to MIT commands, (n, 5) rows q*, dq*, kp, kd, tau in joint coordinates.

The motor computes tau = kp (q* − q) + kd (dq* − dq) + tau_ff at its own rate.
"""

import numpy as np

from lerobot_robot_yam.system.few_values import all_of, any_of, largest

Q, DQ, KP, KD, TAU = range(5)

_FRICTION_SPEED_RAD_S = 0.05  # width of the smooth sign in the friction term: no chatter at standstill
_WALL_STIFFNESS = 0.3  # stiffness of the wall, as a share of the position gain
_WALL_TORQUE = 0.25  # largest torque of the wall, as a share of the torque limit
_WALL_DAMPED_RAD = 0.03  # way beyond a joint limit at which the wall has its full damping
_FULL = 0.25  # excess over the speed limit, as a share of it, that gets all the damping
_RELEASE_S = 0.1  # time in which the share of damping goes back
_RUNS_AWAY_S = 0.25  # time at the speed limit that means running away: a hand's quick moves are shorter, or slower
_FORGET = 0.5  # seconds at the limit that are forgotten in each second below it
_ABOUT = 0.9  # share of the limit that still counts as at it: a damped joint goes on there


def friction(dq: np.ndarray, coulomb_nm: np.ndarray) -> np.ndarray:
    """Compute friction feed-forward, tau = c · tanh(dq / w): the sign of the motion without its jump."""
    return coulomb_nm * np.tanh(dq / _FRICTION_SPEED_RAD_S)


def follow(
    out: np.ndarray, q_set: np.ndarray, dq_set: np.ndarray, kp: np.ndarray, kd: np.ndarray, tau: np.ndarray
) -> None:
    """Fill commands that hold or track: stiff about the set-point, while feed-forward carries the weight."""
    out[:, Q], out[:, DQ], out[:, KP], out[:, KD], out[:, TAU] = q_set, dq_set, kp, kd, tau


def float_free(out: np.ndarray, q: np.ndarray, idle_kd: np.ndarray, tau: np.ndarray) -> None:
    """Fill commands of free motion: no stiffness, idle damping, while feed-forward carries the weight."""
    out[:, Q], out[:, DQ], out[:, KP], out[:, KD], out[:, TAU] = q, 0.0, 0.0, idle_kd, tau


class FloatDamping:
    """Damping of n floating joints that are faster than hands, and detection of joints that run away all the same.

        share = (v / limit − 1) / 0.25 within 0 … 1,  kd = idle kd + share (most kd − idle kd)

    v is the lesser |dq| of the last two ticks: a hand that takes hold of a light wrist gives it 4 rad/s for one. The
    share grows at once and goes back slowly. A wrist is slowed down within one tick: a share that went back as quickly
    would let it go and catch it again at every other tick.

    Damping alone ends nothing: an arm whose model is wrong goes on to its stops. A joint that needs the damping for
    longer than a hand's quick move lasts runs away. Call `share` once per tick.

    Args:
        limit_rad_s: speed below which nothing is damped.
        joints: number of joints, n.
    """

    def __init__(self, limit_rad_s: float, joints: int):
        self._limit = limit_rad_s
        self._before: np.ndarray = np.zeros(joints)  # |dq| at the last tick
        self._none: np.ndarray = np.zeros(joints)
        self._share, self._damped_s, self._damps = self._none, self._none, False

    def reset(self) -> None:
        """Forget all speeds, since the arm does not float any more."""
        self._share = self._damped_s = self._none
        self._damps = False

    def share(self, dq: np.ndarray, dt: float) -> np.ndarray | None:
        """Compute the share (n,) of the largest damping that each joint needs at `dq` (n,) rad/s. dt: tick, s.

        Return None when no joint needs any, as nearly always.
        """
        fast = np.abs(dq)
        speed, self._before = np.minimum(fast, self._before), fast
        if not self._damps and largest(speed) <= self._limit:
            return None
        needed = np.minimum(np.maximum((speed / self._limit - 1.0) / _FULL, 0.0), 1.0)
        self._share = np.maximum(needed, self._share - dt / _RELEASE_S)
        at_limit = speed > np.where(self._damped_s > 0.0, _ABOUT, 1.0) * self._limit
        self._damped_s = np.maximum(self._damped_s + np.where(at_limit, dt, -_FORGET * dt), 0.0)
        self._damps = any_of(self._damped_s > 0.0)
        return self._share

    @property
    def runs_away(self) -> int | None:
        """Index of the joint that is too fast for longer than any hand; None when no joint is."""
        worst = int(self._damped_s.argmax()) if len(self._damped_s) else 0
        return worst if len(self._damped_s) and self._damped_s[worst] > _RUNS_AWAY_S else None


def soft_wall(
    out: np.ndarray,
    q: np.ndarray,
    dq: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    kp: np.ndarray,
    kd: np.ndarray,
    limit_nm: np.ndarray,
) -> float:
    """Push joints that float beyond their limits gently back; call after `float_free`. All n joints, gripper excluded.

        d = q − clip(q, lower, upper)
        tau_wall = −s (k d + c dq),  k = 0.3 kp,  c = (kd − idle kd) · min(1, |d| / 0.03),  |tau_wall| ≤ limit / 4

    s ≤ 1 keeps the bound. Spring and damper are sent as kp and kd about the limit and not as torque: a motor
    closes that loop at its own rate on a fresh position, whereas a torque would act one tick of the host later and take
    a part of the damping away. Both grow from zero at the limit: no step there, and next to nothing at rest on a limit.

    Returns:
        How far the farthest joint is beyond its limit, rad; 0 when no joint is.
    """
    beyond = q - np.minimum(np.maximum(q, lower), upper)
    deepest = largest(beyond)
    if deepest == 0.0:
        return 0.0
    depth = np.abs(beyond)
    stiffness = np.where(depth > 0.0, _WALL_STIFFNESS * kp, 0.0)
    damping = np.maximum(kd - out[:, KD], 0.0) * np.minimum(depth / _WALL_DAMPED_RAD, 1.0)
    torque = np.abs(stiffness * beyond + damping * dq)
    share = np.minimum(_WALL_TORQUE * limit_nm / np.maximum(torque, 1e-9), 1.0)
    out[:, Q] = q - beyond
    out[:, KP] += share * stiffness
    out[:, KD] += share * damping
    return deepest


def fade(out: np.ndarray, share: np.ndarray, kd: np.ndarray) -> None:
    """Scale stiffness and feed-forward of the commands in `out` by `share` (n,), 1 … 0, and set damping kd (n,)."""
    out[:, KP] *= share
    out[:, TAU] *= share
    out[:, DQ] = 0.0
    out[:, KD] = kd


def sink(out: np.ndarray, joints: np.ndarray, kd: float) -> None:
    """Reduce the commands of these joints, (n,) bool, in `out` to damping kd."""
    out[joints, DQ] = out[joints, KP] = out[joints, TAU] = 0.0
    out[joints, KD] = kd


def clip_torque(
    out: np.ndarray,
    q: np.ndarray,
    dq: np.ndarray,
    limit_nm: np.ndarray,
    before: tuple[np.ndarray, np.ndarray] | None = None,
) -> bool:
    """Keep the torque that the motor will compute within ±limit (n,); return whether a command was changed.

    The excess is taken from the position error first, by moving q* towards q, then from the damping, by moving
    dq* towards dq, and only the rest from tau: a far set-point, or a blow, asks for more than the frame's torque field
    could take back (kp = 80 Nm/rad and 1 rad: 80 of 28 Nm; kd = 1.5 Nm s/rad and 15 rad/s: 22 of 10 Nm).

    Args:
        out: (n, 5) commands, changed in place.
        q, dq: (n,) as measured.
        before: q and dq of the previous sample, NaN without one. A single wrong one must not move an arm, so only the
            excess that both samples show is taken away. A blow waits for its second sample; until then the motor damps
            it by itself.
    """
    spring, damping = out[:, KP] * (out[:, Q] - q), out[:, KD] * (out[:, DQ] - dq)
    tau = spring + damping + out[:, TAU]
    if all_of(np.abs(tau) <= limit_nm):  # nearly always
        return False
    excess = tau - np.minimum(np.maximum(tau, -limit_nm), limit_nm)
    if before is not None:
        earlier = out[:, KP] * (out[:, Q] - before[0]) + out[:, KD] * (out[:, DQ] - before[1]) + out[:, TAU]
        also = earlier - np.minimum(np.maximum(earlier, -limit_nm), limit_nm)
        excess = np.where(np.isnan(also), excess, _share(excess, also))
    from_spring = _share(excess, spring)
    from_damping = _share(excess - from_spring, damping)
    out[:, Q] -= from_spring / np.maximum(out[:, KP], 1e-9)
    out[:, DQ] -= from_damping / np.maximum(out[:, KD], 1e-9)
    out[:, TAU] -= excess - from_spring - from_damping
    return True


def _share(excess: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return the share of `excess` that can be taken from this part of it."""
    return np.where(excess * part > 0.0, np.copysign(np.minimum(np.abs(excess), np.abs(part)), excess), 0.0)
