"""Point that glides to a goal with limited speed and acceleration, and a soft pull of an arm along such a point."""

import numpy as np

_STIFFNESS = 0.3  # spring stiffness, as a share of the position gain
_DAMPING = 0.2  # damping, as a share of the damping gain
_MOST_NM = 2.0
_ACCELERATION_RAD_S2 = 2.0


class Glide:
    """Point with n coordinates. Call `seed` before `advance`.

    Args:
        acceleration: (n,) maximum acceleration and deceleration, unit/s².

    Attributes:
        q, dq: (n,) present position and speed.
    """

    def __init__(self, acceleration: np.ndarray):
        self._acceleration = acceleration
        self.q: np.ndarray = np.zeros(len(acceleration))
        self.dq: np.ndarray = np.zeros(len(acceleration))

    def seed(self, q: np.ndarray, dq: np.ndarray | None = None) -> None:
        """Start at q (n,), at rest or with speed dq (n,)."""
        self.q = q.copy()
        self.dq = np.zeros(len(q)) if dq is None else dq.copy()

    def advance(self, goal: np.ndarray, speed: np.ndarray, dt: float) -> None:
        """Move towards goal (n,) with a maximum speed `speed` (n,), and |dq| ≤ sqrt(2 a |goal − q|)."""
        if dt <= 0.0:
            return
        gap = goal - self.q
        most = np.minimum(speed, np.minimum(np.sqrt(2.0 * self._acceleration * np.abs(gap)), np.abs(gap) / dt))
        step = self._acceleration * dt
        wanted = np.copysign(most, gap)
        self.dq = self.dq + np.minimum(np.maximum(wanted - self.dq, -step), step)
        self.q = self.q + self.dq * dt

    def keep_near(self, q: np.ndarray, reach: np.ndarray) -> None:
        """Clip the point to a maximum distance `reach` (n,) from q (n,)."""
        self.q = np.minimum(np.maximum(self.q, q - reach), q + reach)


class SoftPull:
    """Soft pull that moves a floating leader: home, back to its follower, or along with its follower.

        tau = clip(0.3 kp (q_ramp − q) + c dq_ramp, ±2 Nm),  c = 0.2 kd

    A hand that holds or lifts the leader feels at most 2 Nm: q_ramp stays close enough for a spring torque of 2 Nm.

    Args:
        kp, kd: (joints,) leader's gains, Nm/rad and Nm s/rad.
        acceleration_rad_s2: acceleration of the ramp.
    """

    def __init__(self, kp: np.ndarray, kd: np.ndarray, acceleration_rad_s2: float = _ACCELERATION_RAD_S2):
        self._stiffness, self._damping = _STIFFNESS * kp, _DAMPING * kd
        self._reach = _MOST_NM / np.maximum(self._stiffness, _MOST_NM)  # at most 1 rad
        self._ramp = Glide(np.full(len(kp), acceleration_rad_s2))

    def begin(self, q: np.ndarray) -> None:
        """Start at the measured position q (joints,)."""
        self._ramp.seed(q)

    def advance(self, goal: np.ndarray, speed_rad_s: float, q: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Compute torque and damping (joints,) for one tick of `dt` s on the path to goal (joints,)."""
        self._ramp.advance(goal, np.full(len(goal), speed_rad_s), dt)
        self._ramp.keep_near(q, self._reach)
        pull = self._stiffness * (self._ramp.q - q) + self._damping * self._ramp.dq
        return np.minimum(np.maximum(pull, -_MOST_NM), _MOST_NM), self._damping
