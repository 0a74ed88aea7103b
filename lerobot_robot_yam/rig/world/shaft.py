"""A motor's shaft in the simulated world: angle, velocity, torque, and what can be wrong with its mechanics."""

from typing import TYPE_CHECKING, Protocol

import numpy as np

from lerobot_robot_yam.errors import ConfigError

if TYPE_CHECKING:
    from lerobot_robot_yam.rig.world.world import World

_CONTROL_MAX = 1e9  # MuJoCo drops all controls of the world when one exceeds 1e10; forces are limited far below
_STIFF = 0.999  # impedance under which a shaft that friction holds creeps by 5 mrad/s; by default it is 0.5 rad/s
_JAMMED = 1e5  # Nm s/rad: 10 Nm turn a jammed shaft by 0.1 mrad/s


class Shaft(Protocol):
    """What a motor turns: a `Drive` of the world, or a `LooseShaft`."""

    actuator: int

    def angle(self) -> float: ...
    def velocity(self) -> float: ...
    def torque(self) -> float: ...
    def command(self, angle: float, velocity: float, kp: float, kd: float, torque: float) -> None: ...
    def load(self, torque_nm: float) -> None: ...
    def jam(self, jammed: bool) -> None: ...
    def rub(self, friction_nm: float) -> None: ...


class Drive:
    """One actuator, seen from its shaft: angle u = base + Σ coefficient · q of one or two joints.

    Args:
        world: model and state.
        actuator: its name in the model.
        joints: names of its one or two joints.
        base_rad: shaft angle at joint value 0.
        coefficient: shaft angle per joint value.
    """

    def __init__(self, world: "World", actuator: str, joints: tuple[str, ...], base_rad: float, coefficient: float):
        model = world.model
        self.actuator = model.actuator(actuator).id
        self._world = world
        if not 1 <= len(joints) <= 2:
            raise ConfigError(f"actuator {actuator} must move one or two joints, not {joints}")
        self.q = [int(model.joint(j).qposadr[0]) for j in joints]
        self.v = [int(model.joint(j).dofadr[0]) for j in joints]
        self._single = len(joints) == 1
        self.base_rad = base_rad
        self.coefficient = coefficient
        self.gains = (0.0, 0.0)
        self._bias = model.actuator_biasprm[self.actuator]
        self._ctrl = world.data.ctrl
        self._damping = model.dof_damping[self.v].copy()
        self._friction = model.dof_frictionloss[self.v].copy()
        self._impedance = model.dof_solimp[self.v, :2].copy()

    def angle(self) -> float:
        """Shaft angle in rad."""
        q = self._world.qpos
        own = self.q
        return self.base_rad + self.coefficient * (q[own[0]] if self._single else q[own[0]] + q[own[1]])

    def velocity(self) -> float:
        """Shaft velocity in rad/s."""
        v = self._world.qvel
        own = self.v
        return self.coefficient * (v[own[0]] if self._single else v[own[0]] + v[own[1]])

    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angles (k,) in rad and velocities (k,) in rad/s in other states (k, nq), (k, nv) of the world."""
        turned = self.base_rad + self.coefficient * qpos[:, self.q].sum(axis=1)
        return turned, self.coefficient * qvel[:, self.v].sum(axis=1)

    def torque(self) -> float:
        """Shaft torque of the last step in Nm."""
        return self._world.force[self.actuator]

    def command(self, angle: float, velocity: float, kp: float, kd: float, torque: float) -> None:
        """From now on  kp (angle − u) + kd (velocity − u̇) + torque.  Units: rad, rad/s, Nm."""
        if (kp, kd) != self.gains:
            self.set_gains(kp, kd)
        control = kp * (angle - self.base_rad) + kd * velocity + torque
        self._ctrl[self.actuator] = min(max(control, -_CONTROL_MAX), _CONTROL_MAX)

    def set_gains(self, kp: float, kd: float) -> None:
        """Change the servo's gains alone."""
        self._bias[1], self._bias[2] = -kp, -kd
        self.gains = kp, kd

    def load(self, torque_nm: float) -> None:
        """From now on a torque from outside acts on the shaft; the actuator does not report it."""
        self._world.data.qfrc_applied[self.v] = self.coefficient * torque_nm

    def jam(self, jammed: bool) -> None:
        """Make the shaft hardly turn at all, whatever pulls, or free it."""
        jam = _JAMMED * self.coefficient**2
        self._world.model.dof_damping[self.v] = jam if jammed else self._damping

    def rub(self, friction_nm: float) -> None:
        """From now on the shaft has so much more dry friction than the profile says."""
        model = self._world.model
        model.dof_frictionloss[self.v] = self._friction + abs(self.coefficient) * friction_nm
        model.dof_solimp[self.v, :2] = _STIFF if friction_nm else self._impedance
