"""Motor shafts: interface of the motors to the physics."""

import math

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.world.world import World
from lerobot_robot_yam.rig.world.world_model import FIRM_FRICTION

_CONTROL_MAX = 1e9  # control limit: above 1e10 MuJoCo drops all controls; forces are limited far below
_JAMMED = 1e5  # damping of a jammed shaft, Nm s/rad: 10 Nm rotate it by 0.1 mrad/s
_INERTIA_KG_M2 = 0.05  # inertia of a loose shaft, between an arm's shoulder (0.2) and wrist (0.005); our choice
_DAMPING_NM_S_RAD = 0.2  # damping of a loose shaft's gear and bearings; our choice
_CATCH_UP_S = 2.0  # maximum time that a loose shaft catches up at once, s; any time beyond this is skipped


class Drive:
    """Shaft of one actuator of the world: angle u = base + Σ coefficient · q over one or two joints.

    actuator, joints: names in the arm. base_rad: shaft angle at joint value 0. coefficient: rad per joint value.
    """

    def __init__(
        self, world: World, channel: str, actuator: str, joints: tuple[str, ...], base_rad: float, coefficient: float
    ):
        model = world.model
        if not 1 <= len(joints) <= 2:
            raise ConfigError(f"actuator {channel}/{actuator} must move one or two joints, not {joints}")
        self._world, self.actuator = world, model.actuator(f"{channel}/{actuator}").id
        self.q = [int(model.joint(f"{channel}/{joint}").qposadr[0]) for joint in joints]
        self.v = [int(model.joint(f"{channel}/{joint}").dofadr[0]) for joint in joints]
        self._single = len(joints) == 1
        self.base_rad, self.coefficient, self.gains = base_rad, coefficient, (0.0, 0.0)
        self._bias = model.actuator_biasprm[self.actuator]
        self._damping = model.dof_damping[self.v].copy()
        self._friction = model.dof_frictionloss[self.v].copy()
        self._impedance = model.dof_solimp[self.v, :2].copy()

    def angle(self) -> float:
        """Return the shaft angle, rad."""
        q = self._world.qpos
        own = self.q
        return self.base_rad + self.coefficient * (q[own[0]] if self._single else q[own[0]] + q[own[1]])

    def velocity(self) -> float:
        """Return the shaft velocity, rad/s."""
        v = self._world.qvel
        own = self.v
        return self.coefficient * (v[own[0]] if self._single else v[own[0]] + v[own[1]])

    def torque(self) -> float:
        """Return the shaft torque of the last step, Nm."""
        return self._world.force[self.actuator]

    def command(self, angle: float, velocity: float, kp: float, kd: float, torque: float) -> None:
        """Servo from now on with  kp (angle − u) + kd (velocity − u̇) + torque.  Units: rad, rad/s, Nm."""
        if (kp, kd) != self.gains:
            self.set_gains(kp, kd)
        control = kp * (angle - self.base_rad) + kd * velocity + torque
        most = _CONTROL_MAX
        self._world.ctrl[self.actuator] = most if control > most else -most if control < -most else control

    def set_gains(self, kp: float, kd: float) -> None:
        """Change only the gains of the servo."""
        self._bias[1], self._bias[2] = -kp, -kd
        self.gains = kp, kd

    def load(self, torque_nm: float) -> None:
        """Apply an external torque to the shaft from now on; the actuator does not report this torque."""
        self._world.data.qfrc_applied[self.v] = self.coefficient * torque_nm

    def jam(self, jammed: bool) -> None:
        """Jam the shaft so that it barely rotates, or release it."""
        jam = _JAMMED * self.coefficient**2
        self._world.model.dof_damping[self.v] = jam if jammed else self._damping

    def rub(self, friction_nm: float) -> None:
        """Set dry friction in addition to that of the profile."""
        model = self._world.model
        model.dof_frictionloss[self.v] = self._friction + abs(self.coefficient) * friction_nm
        model.dof_solimp[self.v, :2] = FIRM_FRICTION if friction_nm else self._impedance


class LooseShaft(Drive):
    """Shaft of a second arm's motor, without gravity:  I ω̇ = clip(kp (u* − u) + kd (u̇* − ω) + tau) − b ω.

    The world has no actuator for this shaft: each call simulates the shaft up to now, starting at rest at `angle_rad`.
    The shaft cannot be loaded, jammed or rubbed, because faults act on the first arm's motors.
    """

    def __init__(self, world: World, angle_rad: float, torque_max_nm: float):
        self._world, self._limit = world, torque_max_nm
        self._angle, self._rate, self._torque = angle_rad, 0.0, 0.0
        self._command = (0.0, 0.0, 0.0, 0.0, 0.0)
        self._sim_s = world.sim_s

    def angle(self) -> float:
        self._catch_up()
        return self._angle

    def velocity(self) -> float:
        self._catch_up()
        return self._rate

    def torque(self) -> float:
        self._catch_up()
        return self._torque

    def command(self, angle: float, velocity: float, kp: float, kd: float, torque: float) -> None:
        self._catch_up()
        self._command = (angle, velocity, kp, kd, torque)

    def _catch_up(self) -> None:
        step_s, now_s = self._world.timestep_s, self._world.sim_s
        if now_s - self._sim_s < 0.5 * step_s:
            return
        for _ in range(round(min(now_s - self._sim_s, _CATCH_UP_S) / step_s)):
            self._step(step_s)
        self._sim_s = now_s

    def _step(self, step_s: float) -> None:
        """Integrate one step, implicitly in the velocity, as the world does."""
        angle, velocity, kp, kd, torque = self._command
        push, gain = kp * (angle - self._angle) + torque, step_s / _INERTIA_KG_M2
        rate = (self._rate + gain * (push + kd * velocity)) / (1.0 + gain * (kd + _DAMPING_NM_S_RAD))
        self._torque = push + kd * (velocity - rate)
        if abs(self._torque) > self._limit:
            self._torque = math.copysign(self._limit, self._torque)
            rate = (self._rate + gain * self._torque) / (1.0 + gain * _DAMPING_NM_S_RAD)
        self._rate = rate
        self._angle += rate * step_s
