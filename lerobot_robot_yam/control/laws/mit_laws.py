"""Control laws: compute MIT commands from the state, (n, 5) rows q*, dq*, kp, kd, tau in joint coordinates.

The motor computes tau = kp (q* − q) + kd (dq* − dq) + tau_ff at its own rate.
"""

import numpy as np

from lerobot_robot_yam.system.few_values import all_of, any_of, largest

Q, DQ, KP, KD, TAU = range(5)

_FRICTION_SPEED_RAD_S = 0.05  # width of the smoothed sign function in the friction term: avoids chatter at standstill
_WALL_STIFFNESS = 0.3  # wall stiffness, as a share of the position gain
FELT_SHARE = 0.25  # maximum torque against a hand at a floating joint, as a share of the torque limit
_SOFT_SHARE = 0.125  # torque of a joint at an unknown position, per rad and per rad/s, as a share of the torque limit
_WALL_DAMPED_RAD = 0.03  # distance beyond a joint limit at which the wall reaches its full damping
_FULL = 0.25  # excess speed, as a share of the speed limit, from which the damping is full
_RELEASE_S = 0.1  # time in which the share of damping decays from 1 to 0
_RUNS_AWAY_S = 0.25  # time at the speed limit after which a joint is running away: hand motions are shorter or slower
_HAND_COUNTS = (
    0.4  # count of a second in which a hand pushes: 0.6 s in all, in which it crosses half of a joint's range
)
_PUSHED_S = 0.04  # time after which power proves a hand, s: ten ticks
_FORGET = 0.5  # decay of the time counted at the speed limit, s per second below the limit
_LEAST_KP = 1e-9  # minimum share of kp that the torque clip leaves: no torque, but not 0
_ABOUT = 0.9  # share of the speed limit above which a damped joint still counts as at the limit


def friction(dq: np.ndarray, coulomb_nm: np.ndarray) -> np.ndarray:
    """Compute the friction feedforward, tau = c · tanh(dq / w): Coulomb friction without a jump at dq = 0."""
    return coulomb_nm * np.tanh(dq / _FRICTION_SPEED_RAD_S)


def follow(
    out: np.ndarray, q_set: np.ndarray, dq_set: np.ndarray, kp: np.ndarray, kd: np.ndarray, tau: np.ndarray
) -> None:
    """Fill commands that hold or track: stiff around the set-point, with feedforward `tau` for the weight."""
    out[:, Q], out[:, DQ], out[:, KP], out[:, KD], out[:, TAU] = q_set, dq_set, kp, kd, tau


def float_free(out: np.ndarray, q: np.ndarray, idle_kd: np.ndarray, tau: np.ndarray) -> None:
    """Fill commands for free motion: no stiffness, idle damping, and feedforward `tau` for the weight."""
    out[:, Q], out[:, DQ], out[:, KP], out[:, KD], out[:, TAU] = q, 0.0, 0.0, idle_kd, tau


class FloatDamping:
    """Damping for n floating joints that move faster than most hands do, and detection of joints that run away.

        share = clip((v / limit − 1) / 0.25, 0, 1),  kd = share · maximum kd,  kd |dq| ≤ maximum torque

    v is the smaller |dq| of the last two ticks: a hand that grasps a light wrist moves the wrist at 4 rad/s for one
    tick. The share grows at once and decays slowly: a wrist is slowed down within one tick, so a share with a quick
    decay would release and catch the wrist at every other tick.

    Damping alone does not stop an arm whose model is wrong: the arm drifts to its mechanical stops. A joint that needs
    the damping in one direction for longer than a quick hand motion lasts is running away. Where the damping takes more
    power than a wrong weight can give, a hand pushes, and the time counts less: a hand ends at a joint's range.
    Call `damping` once per tick.

    Args:
        limit_rad_s: speed up to which no joint is damped.
        joints: number of joints, n.
    """

    def __init__(self, limit_rad_s: float, joints: int):
        self._limit = limit_rad_s
        self._before: np.ndarray = np.zeros(joints)  # |dq| at the last tick
        self._none: np.ndarray = np.zeros(joints)
        self._share, self._damped_s, self._damps = self._none, self._none, False
        self._way: np.ndarray = self._none  # direction of the counted motion
        self._pushed_s: np.ndarray = self._none  # time for which a hand pushed during the counted motion

    def reset(self) -> None:
        """Forget all speeds after the end of floating."""
        self._share = self._damped_s = self._way = self._pushed_s = self._none
        self._damps = False

    def damping(
        self, dq: np.ndarray, dt: float, most_kd: np.ndarray, most_nm: np.ndarray, wrong_nm: np.ndarray
    ) -> np.ndarray | None:
        """Compute the damping (n,), Nm s/rad, that each joint needs at `dq` (n,) rad/s in addition to its own.

        Return None if no joint needs damping, the usual case.

        Args:
            dt: tick period, s.
            most_kd, most_nm: (n,) maximum damping, and maximum torque of the damping.
            wrong_nm: (n,) torque that a wrong weight may add.
        """
        fast = np.abs(dq)
        speed, self._before = np.minimum(fast, self._before), fast
        if not self._damps and largest(speed) <= self._limit:
            return None
        needed = np.minimum(np.maximum((speed / self._limit - 1.0) / _FULL, 0.0), 1.0)
        self._share = np.maximum(needed, self._share - dt / _RELEASE_S)
        kd: np.ndarray = np.minimum(self._share * most_kd, most_nm / np.maximum(fast, 1e-9))
        counted = np.where(dq * self._way < 0.0, 0.0, self._damped_s)
        at_limit = speed > np.where(counted > 0.0, _ABOUT, 1.0) * self._limit
        pushed = kd * fast > wrong_nm
        self._pushed_s = np.where(counted > 0.0, self._pushed_s, 0.0) + pushed * dt
        passes = np.where(pushed, _HAND_COUNTS, 1.0) * dt
        self._damped_s = np.maximum(counted + np.where(at_limit, passes, -_FORGET * dt), 0.0)
        self._way = np.where(at_limit, dq, self._way)
        self._damps = any_of(self._damped_s > 0.0)
        return kd

    @property
    def runs_away(self) -> int | None:
        """Index of the joint that has been too fast for longer than a hand motion lasts; None: no joint has."""
        worst = int(self._damped_s.argmax()) if len(self._damped_s) else 0
        return worst if len(self._damped_s) and self._damped_s[worst] > _RUNS_AWAY_S else None

    def pushed(self, joint: int) -> bool:
        """Return whether a hand, and no wrong weight, has made the joint too fast."""
        return bool(self._pushed_s[joint] > _PUSHED_S)


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
    """Push floating joints gently back inside their limits; call after `float_free`. All n joints, without gripper.

        d = q − clip(q, lower, upper)
        tau_wall = −s (k d + c dq),  k = 0.3 kp,  c = (kd − idle kd) · min(1, |d| / 0.03),  |tau_wall| ≤ limit / 4

    s ≤ 1 enforces the torque bound. Spring and damper are sent as kp and kd around the limit and not as torque: a motor
    closes that loop at its own rate with a fresh position, whereas a torque would act one host tick later, and the
    delay would cancel part of the damping. Both terms grow from zero at the limit, without a step.

    Returns:
        Maximum distance of a joint beyond its limit, rad; 0: all joints are within their limits.
    """
    beyond = q - np.minimum(np.maximum(q, lower), upper)
    deepest = largest(beyond)
    if deepest == 0.0:
        return 0.0
    depth = np.abs(beyond)
    stiffness = np.where(depth > 0.0, _WALL_STIFFNESS * kp, 0.0)
    damping = np.maximum(kd - out[:, KD], 0.0) * np.minimum(depth / _WALL_DAMPED_RAD, 1.0)
    torque = np.abs(stiffness * beyond + damping * dq)
    share = np.minimum(FELT_SHARE * limit_nm / np.maximum(torque, 1e-9), 1.0)
    out[:, Q] = q - beyond
    out[:, KP] += share * stiffness
    out[:, KD] += share * damping
    return deepest


def fade(out: np.ndarray, share: np.ndarray, kd: np.ndarray) -> None:
    """Scale stiffness and feedforward of the commands in `out` by `share` (n,), 1 … 0, and set damping kd (n,)."""
    out[:, KP] *= share
    out[:, TAU] *= share
    out[:, DQ] = 0.0
    out[:, KD] = kd


def sink(out: np.ndarray, joints: np.ndarray, kd: float) -> None:
    """Reduce the commands in `out` for `joints`, (n,) bool, to damping kd."""
    out[joints, DQ] = out[joints, KP] = out[joints, TAU] = 0.0
    out[joints, KD] = kd


def hold_softly(out: np.ndarray, joints: np.ndarray, limit_nm: np.ndarray) -> None:
    """Limit stiffness and damping of `joints`, (n,) bool, in `out`: limit / 8 for each rad, and for each rad/s."""
    gains = out[:, KP : KD + 1]
    gains[:] = np.where(joints[:, None], np.minimum(gains, _SOFT_SHARE * limit_nm[:, None]), gains)


def motor_torque(commands: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """Compute the torque (…, n), Nm, that motors at q, dq (n,) exert for commands (…, n, 5), without their limits."""
    nm: np.ndarray = (
        commands[..., KP] * (commands[..., Q] - q) + commands[..., KD] * (commands[..., DQ] - dq) + commands[..., TAU]
    )
    return nm


def clip_torque(out: np.ndarray, q: np.ndarray, dq: np.ndarray, limit_nm: np.ndarray) -> bool:
    """Clamp the torque that the motor will compute to ±limit (n,); return whether a command was changed.

    The excess is first removed from the spring, by reducing kp, then from the damping, by reducing kd, and only the
    rest from tau. A distant set-point, or a blow, causes more torque than the frame's torque field can cancel
    (kp = 80 Nm/rad and 1 rad: 80 of 28 Nm; kd = 1.5 Nm s/rad and 15 rad/s: 22 of 10 Nm).

    q* and dq* stay. If q or dq is wrong, and the joint still is at its set-point, the motor keeps the joint there,
    softly: a q* moved towards a wrong q would throw the joint, with kp times the error. A kp above 0 stays above 0:
    `Actuation.check` tells by it that the joint was held at q*.

    Args:
        out: (n, 5) commands, changed in place.
        q, dq: (n,) measured position and speed.
    """
    spring, damping = out[:, KP] * (out[:, Q] - q), out[:, KD] * (out[:, DQ] - dq)
    tau = spring + damping + out[:, TAU]
    if all_of(np.abs(tau) <= limit_nm):  # the usual case
        return False
    excess = tau - np.minimum(np.maximum(tau, -limit_nm), limit_nm)
    from_spring = _share(excess, spring)
    from_damping = _share(excess - from_spring, damping)
    out[:, KP] *= np.maximum(1.0 - from_spring / np.where(spring == 0.0, 1.0, spring), _LEAST_KP)
    out[:, KD] *= 1.0 - from_damping / np.where(damping == 0.0, 1.0, damping)
    out[:, TAU] -= excess - from_spring - from_damping
    return True


def _share(excess: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return the amount of `excess` that can be removed from the torque `part`."""
    return np.where(excess * part > 0.0, np.copysign(np.minimum(np.abs(excess), np.abs(part)), excess), 0.0)
