"""Two grips of a hand on an arm: firm at each joint, or soft as a mass on a spring at the tool."""

import math
from abc import ABC, abstractmethod
from typing import NamedTuple

import mujoco
import numpy as np

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.rig.world.outer_forces import Ballast, OuterForces
from lerobot_robot_yam.rig.world.shafts import Drive
from lerobot_robot_yam.rig.world.world import World
from lerobot_robot_yam.rig.world.world_model import HAND_KD, HAND_KP, HAND_TORQUE_NM

_RESIST_NM = 2.5  # joint torque that counts as resistance; moving a floating leader takes less than 1 Nm
_RESIST_N = 25.0  # force at the tool that counts as resistance
_PULL_N, _TURN_NM = 60.0, 6.0  # limits of a soft hand's force and torque
FIST_M = 0.06  # lever arm that converts a hand's stiffness to rotation; also its radius of gyration
_STIFFNESS_N_M, _MASS_KG, _DAMPING_RATIO = (0.0, 5000.0), (0.05, 5.0), (0.0, 2.0)


class Softness(NamedTuple):
    """Parameters of a hand that is a mass fixed to the tool, on a damped spring to the hand's target.

    Damping of the spring:  c = 2 ζ √(k m).
    """

    stiffness_n_m: float = 1000.0
    mass_kg: float = 0.5
    damping_ratio: float = 0.7

    @property
    def damping_n_s_m(self) -> float:
        return 2.0 * self.damping_ratio * math.sqrt(self.stiffness_n_m * self.mass_kg)

    def check(self) -> "Softness":
        """Return this object. Raises ConfigError: a value is out of range."""
        for name, (low, high) in zip(self._fields, (_STIFFNESS_N_M, _MASS_KG, _DAMPING_RATIO), strict=True):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
                raise ConfigError(f"{name} of a hand is a number from {low:g} to {high:g}, not {value!r}")
        return self


class Grip(ABC):
    """Interaction between a hand and an arm."""

    @abstractmethod
    def take_hold(self, softness: Softness | None) -> None:
        """Begin to act, or continue with another softness, which a firm grip ignores."""

    @abstractmethod
    def aim(self, q_rad: list[float], rates_rad_s: list[float]) -> None:
        """Pull from now on towards joints (n,) that move at these rates."""

    @abstractmethod
    def step(self) -> None:
        """Apply the grip's forces for the next physics step."""

    @abstractmethod
    def strained(self) -> bool:
        """Return whether the arm works against the hand."""

    @abstractmethod
    def let_go(self) -> None:
        """Stop acting."""


class FirmGrip(Grip):
    """A stiff, damped spring at each joint, integrated with the physics.

    MuJoCo integrates damping implicitly, except for an actuator at its force limit. There a damper that reverses a
    light joint's velocity within one step would do so endlessly, at half the step rate. A joint at its limit therefore
    has a weaker damper, with which energy decays in every pose, regardless of other motion:

        kd < 2 I / dt,   with the joint's rotor inertia I, a lower bound of the moved inertia
    """

    def __init__(self, world: World, channel: str):
        self._world = world
        count = world.profiles[channel][0].joint_count
        self._drives = [Drive(world, channel, f"hand_{i + 1}", (f"joint{i + 1}",), 0.0, 1.0) for i in range(count)]
        self.actuators = [drive.actuator for drive in self._drives]
        inertia = world.model.dof_armature[world.joint_dofs(channel)]
        self._kd_at_limit = np.minimum(HAND_KD, inertia / world.timestep_s).tolist()

    def take_hold(self, softness: Softness | None) -> None:
        for drive in self._drives:
            drive.set_gains(HAND_KP, HAND_KD)

    def aim(self, q_rad: list[float], rates_rad_s: list[float]) -> None:
        qpos, qvel = self._world.qpos, self._world.qvel
        for drive, target, rate, kd_at_limit in zip(self._drives, q_rad, rates_rad_s, self._kd_at_limit, strict=True):
            asked = HAND_KP * (target - qpos[drive.q[0]]) + HAND_KD * (rate - qvel[drive.v[0]])
            kd = HAND_KD if abs(asked) < HAND_TORQUE_NM else kd_at_limit
            drive.command(target, rate, HAND_KP, kd, 0.0)

    def step(self) -> None:
        """Do nothing, because the physics integrates the springs."""

    def strained(self) -> bool:
        force = self._world.force
        return any([abs(force[actuator]) >= _RESIST_NM for actuator in self.actuators])

    def let_go(self) -> None:
        for drive in self._drives:
            drive.command(0.0, 0.0, 0.0, 0.0, 0.0)


class SoftGrip(Grip):
    """A mass at the tool, on a damped spring to the tool pose at the target joints:

        F = k (x* − x) + c (ẋ* − ẋ) + m g,     T = FIST_M² · (k φ + c (ω* − ω)),  φ the rotation from tool to target.

    Each step computes the force from the state of the same step, because an older state would add energy.
    """

    def __init__(self, world: World, channel: str, forces: OuterForces, ballast: Ballast):
        self._world, self._forces, self._ballast = world, forces, ballast
        model = world.model
        self._site = int(model.site(f"{channel}/tcp_site").id)
        self._body = int(model.site_bodyid[self._site])
        self._addresses = world.joint_addresses(channel)
        self.source = f"hand on {channel}"
        self._softness = Softness()
        self._elsewhere: mujoco.MjData | None = None  # state with the arm at the target joints
        self._jacobian = np.zeros((2, 3, model.nv))
        self._aimed: tuple[np.ndarray, np.ndarray] | None = None
        self._rate, self._spin = np.zeros(3), np.zeros(3)
        self._aimed_s = 0.0

    def take_hold(self, softness: Softness | None) -> None:
        self._softness = softness or Softness()
        self._ballast.hold(self._softness.mass_kg, FIST_M)

    def aim(self, q_rad: list[float], rates_rad_s: list[float]) -> None:
        model = self._world.model
        if self._elsewhere is None:
            self._elsewhere = mujoco.MjData(model)
        data = self._elsewhere
        data.qpos[self._addresses] = q_rad
        mujoco.mj_kinematics(model, data)
        position, rotation = data.site_xpos[self._site].copy(), data.site_xmat[self._site].reshape(3, 3).copy()
        now_s = self._world.sim_s
        if self._aimed is not None and 0.0 < now_s - self._aimed_s < 0.1:
            elapsed = now_s - self._aimed_s
            self._rate = (position - self._aimed[0]) / elapsed
            self._spin = _turn(self._aimed[1], rotation) / elapsed
        self._aimed, self._aimed_s = (position, rotation), now_s

    def step(self) -> None:
        if self._aimed is None:
            return
        world, data = self._world, self._world.data
        mujoco.mj_jacSite(world.model, data, self._jacobian[0], self._jacobian[1], self._site)
        velocity, spin = self._jacobian @ data.qvel
        # MuJoCo's poses are from before the last step, its velocities from after the last step.
        dt, ahead_s = world.timestep_s, world.sim_s - self._aimed_s
        position = data.site_xpos[self._site] + velocity * dt
        away = self._aimed[0] + self._rate * ahead_s - position
        turn = _turn(data.site_xmat[self._site].reshape(3, 3), self._aimed[1]) + self._spin * ahead_s - spin * dt
        k, c = self._softness.stiffness_n_m, self._softness.damping_n_s_m
        pull = _within(k * away + c * (self._rate - velocity), _PULL_N)
        torque = _within(FIST_M**2 * (k * turn + c * (self._spin - spin)), _TURN_NM)
        self._forces.apply(self.source, self._body, pull + self._weight(), torque, self._site)

    def force_n(self) -> np.ndarray:
        """Return the force (3,), N, of the spring, in world axes."""
        return self._forces.force_n(self.source) - self._weight()

    def strained(self) -> bool:
        return bool(np.linalg.norm(self.force_n()) >= _RESIST_N)

    def _weight(self) -> np.ndarray:
        """Return the force (3,), N, that compensates the hand's weight."""
        return -self._softness.mass_kg * self._world.model.opt.gravity

    def let_go(self) -> None:
        self._forces.end(self.source)
        self._ballast.hold(0.0, FIST_M)
        self._aimed, self._rate, self._spin = None, np.zeros(3), np.zeros(3)


def _within(vector: np.ndarray, most: float) -> np.ndarray:
    size = float(np.linalg.norm(vector))
    return vector if size <= most else vector * (most / size)


def _turn(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return the rotation vector (3,), in world axes, that rotates `here` (3, 3) to `there`."""
    quat, vector = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quat, (there @ here.T).ravel())
    mujoco.mju_quat2Vel(vector, quat, 1.0)
    return vector
