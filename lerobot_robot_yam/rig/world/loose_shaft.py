"""The shaft of a motor that belongs to no arm of the world: a second arm's, which only its answers show."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lerobot_robot_yam.rig.world.world import World

_INERTIA_KG_M2 = 0.05  # between an arm's shoulder (0.2) and its wrist (0.005); our choice
_DAMPING_NM_S_RAD = 0.2  # of gear and bearings; our choice
_CATCH_UP_S = 2.0  # left alone for longer, it is at rest


class LooseShaft:
    """One axis without gravity:  I ω̇ = clip(kp (u* − u) + kd (u̇* − ω) + tau) + load − b ω.

    It has a `Drive`'s methods, and is simulated when it is looked at.

    Args:
        world: for the simulated time.
        angle_rad: where it rests.
        torque_max_nm: what its motor can do.
    """

    actuator = -1  # of the world's; it has none

    def __init__(self, world: "World", angle_rad: float, torque_max_nm: float):
        self._world, self._limit = world, torque_max_nm
        self._angle, self._rate, self._torque = angle_rad, 0.0, 0.0
        self._command = (0.0, 0.0, 0.0, 0.0, 0.0)
        self._load = self._friction = 0.0
        self._jammed = False
        self._sim_s = world.sim_s

    def angle(self) -> float:
        """Shaft angle in rad."""
        self._catch_up()
        return self._angle

    def velocity(self) -> float:
        """Shaft velocity in rad/s."""
        self._catch_up()
        return self._rate

    def torque(self) -> float:
        """Shaft torque of the last step in Nm."""
        self._catch_up()
        return self._torque

    def command(self, angle: float, velocity: float, kp: float, kd: float, torque: float) -> None:
        """From now on  kp (angle − u) + kd (velocity − u̇) + torque.  Units: rad, rad/s, Nm."""
        self._catch_up()
        self._command = (angle, velocity, kp, kd, torque)

    def load(self, torque_nm: float) -> None:
        """From now on a torque from outside acts on the shaft."""
        self._catch_up()
        self._load = torque_nm

    def jam(self, jammed: bool) -> None:
        """Hold the shaft where it is, or free it."""
        self._catch_up()
        self._jammed = jammed

    def rub(self, friction_nm: float) -> None:
        """From now on the shaft has so much dry friction."""
        self._catch_up()
        self._friction = friction_nm

    def _catch_up(self) -> None:
        step_s, now_s = self._world.timestep_s, self._world.sim_s
        if now_s - self._sim_s < 0.5 * step_s:
            return
        for _ in range(round(min(now_s - self._sim_s, _CATCH_UP_S) / step_s)):
            self._step(step_s)
        self._sim_s = now_s

    def _step(self, step_s: float) -> None:
        """Implicit in the velocity, as the world's own integration is."""
        angle, velocity, kp, kd, torque = self._command
        push = kp * (angle - self._angle) + torque
        rate = (self._rate + step_s / _INERTIA_KG_M2 * (push + kd * velocity + self._load)) / (
            1.0 + step_s / _INERTIA_KG_M2 * (kd + _DAMPING_NM_S_RAD)
        )
        self._torque = push + kd * (velocity - rate)
        if abs(self._torque) > self._limit:
            self._torque = min(max(self._torque, -self._limit), self._limit)
            rate = (self._rate + step_s / _INERTIA_KG_M2 * (self._torque + self._load)) / (
                1.0 + step_s / _INERTIA_KG_M2 * _DAMPING_NM_S_RAD
            )
        braked = step_s / _INERTIA_KG_M2 * self._friction
        rate = max(0.0, abs(rate) - braked) * (1.0 if rate > 0.0 else -1.0)
        self._rate = 0.0 if self._jammed else rate
        self._angle += self._rate * step_s
