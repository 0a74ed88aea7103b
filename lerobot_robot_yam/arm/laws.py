"""Control laws: pure functions from state to MIT commands, (n, 5) rows q*, dq*, kp, kd, tau in joint coordinates.

The motor computes tau = kp (q* − q) + kd (dq* − dq) + tau_ff at its own rate.
"""

import numpy as np

Q, DQ, KP, KD, TAU = range(5)

_FRICTION_SPEED_RAD_S = 0.05  # width of the smooth sign in the friction term: no chatter about standstill


def friction(dq: np.ndarray, coulomb_nm: np.ndarray) -> np.ndarray:
    """Coulomb friction feed-forward, tau = c · tanh(dq / w): the sign of the motion without its jump."""
    return coulomb_nm * np.tanh(dq / _FRICTION_SPEED_RAD_S)


def follow(
    out: np.ndarray, q_set: np.ndarray, dq_set: np.ndarray, kp: np.ndarray, kd: np.ndarray, tau: np.ndarray
) -> None:
    """Hold and track: stiff about the set-point, feed-forward carries the weight."""
    out[:, Q], out[:, DQ], out[:, KP], out[:, KD], out[:, TAU] = q_set, dq_set, kp, kd, tau


def float_free(out: np.ndarray, q: np.ndarray, idle_kd: np.ndarray, tau: np.ndarray) -> None:
    """Free motion: no stiffness, idle damping, feed-forward carries the weight."""
    out[:, Q], out[:, DQ], out[:, KP], out[:, KD], out[:, TAU] = q, 0.0, 0.0, idle_kd, tau


def fade(out: np.ndarray, share: float, kd: np.ndarray) -> None:
    """Take `share` (1 … 0) of stiffness and feed-forward of the commands in `out`, with full damping."""
    out[:, KP] *= share
    out[:, TAU] *= share
    out[:, DQ] = 0.0
    out[:, KD] = kd


def clip_torque(out: np.ndarray, q: np.ndarray, dq: np.ndarray, limit_nm: np.ndarray) -> bool:
    """Shift tau_ff so that the torque the motor will compute stays within ±limit (n,). True when it had to."""
    tau = out[:, KP] * (out[:, Q] - q) + out[:, KD] * (out[:, DQ] - dq) + out[:, TAU]
    excess = tau - np.minimum(np.maximum(tau, -limit_nm), limit_nm)
    if not excess.any():
        return False
    out[:, TAU] -= excess
    return True
