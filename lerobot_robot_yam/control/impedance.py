"""Impedance control of one arm: computes MIT commands from set-point and measured state, without modes or clock."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from lerobot_robot_yam.arm.config_checks import PAYLOAD_MOST_KG
from lerobot_robot_yam.arm.joint_map import RANGE_TOLERANCE_RAD
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.gripper.gripper import Gripper
from lerobot_robot_yam.control.laws import mit_laws
from lerobot_robot_yam.control.laws.gravity_balance import range_nm, tolerance_nm
from lerobot_robot_yam.control.laws.sag import SOFT_NM_RAD, Sag
from lerobot_robot_yam.state.modes import Mode
from lerobot_robot_yam.state.records import Limited
from lerobot_robot_yam.system.few_values import all_of, largest

if TYPE_CHECKING:
    from lerobot_robot_yam.arm.dynamics import GravityModel

_GLIDE_S = 0.5  # transition time of a gain change, s
_SOFT_FADE_S = 0.3  # time in which the friction feedforward of soft joints fades in or out, s
_STILL_RAD_S = 1e-3  # speed below which a set-point counts as at rest, rad/s
_WORTH_SAYING_RAD = 0.01  # minimum distance beyond a joint limit that is reported, rad: some joints rest on a limit
_RUBS = 0.05  # maximum friction torque, as a share of the torque limit: 1.4 Nm for a DM4340
_MOST_KD = 5.0  # maximum damping accepted by the motors, Nm s/rad, so that unsupported parts sink slowly
_PLANNED_SHARE = 0.9  # share of the torque limit available to a set-point; the rest is for unmodelled torque
_LEAST_SHARE = 0.2  # minimum share of the acceleration: a set-point must always be able to brake
_WRONG_TIMES = 2.0  # tolerated errors of the weight beyond which a hand pushes: a weight is checked in one pose only
_POSES = 500  # number of random poses that find the largest weight to a few percent; takes 7 ms
_NEAR_RAD = 0.1  # maximum distance from the set-point at which weight is computed, rad: the arm lags by less
_LEAST_KP = 0.1  # stiffness below which that distance does not grow any more, Nm/rad
_AHEAD_TICKS = 1.5  # ticks from a sample to the middle of the tick in which the command computed from it acts


Assist = tuple[np.ndarray, np.ndarray]
"""Additional torque, Nm, and damping, Nm s/rad, for a floating arm, (joints,) each."""


class Inputs(NamedTuple):
    """Inputs for the commands of one tick.

    Attributes:
        now, dt: time, and time since the last tick, s.
        q, dq: (n,) joint-space motor positions and speeds, gripper in rad.
        gripper: the gripper's measured rate and torque, strokes/s and Nm.
        asked, asked_ddq: (2, n) position and speed of the set-point, (n,) acceleration of the set-point.
        mode: present mode of the arm.
        whole: whether all motors are reliable.
        feed_nm: (n,) feedforward torque, see `Impedance.feed_forward`; empty while the arm floats.
        learns: whether a landing arm learns a torque that corrects its gravity model.
        fade: remaining shares (joints,) of stiffness and feedforward, and shares (joints,) of the maximum damping,
            at the end of a landing; None: the arm's own gains.
        assist: torque and damping added to gravity compensation while the arm floats; None: none.
        grips: whether the gripper of a floating arm follows its set-point; else the gripper is free, too.
    """

    now: float
    dt: float
    q: np.ndarray
    dq: np.ndarray
    gripper: tuple[float, float]
    asked: np.ndarray
    asked_ddq: np.ndarray
    mode: Mode
    whole: bool
    feed_nm: np.ndarray = np.zeros(0)
    learns: bool = False
    fade: tuple[np.ndarray, np.ndarray] | None = None
    assist: Assist | None = None
    grips: bool = False


class LiveGains:
    """Gains of n motors that a caller may change while the arm is energised; changes are gradual, without torque jumps.

    kp(t) = kp0 + (kp1 - kp0) t / T, and kd likewise: damping suitable at both ends is also suitable in between.

    Args:
        kp, kd: (n,) configured gains, Nm/rad and Nm s/rad.

    Attributes:
        kp, kd: (n,) present gains.
    """

    def __init__(self, kp: np.ndarray, kd: np.ndarray):
        self._configured = np.array((kp, kd))
        self._now, self._goal = self._configured, self._configured
        self._step = np.zeros_like(self._now)  # per second

    @property
    def kp(self) -> np.ndarray:
        """Present stiffness (n,), Nm/rad."""
        stiffness: np.ndarray = self._now[0]
        return stiffness

    @property
    def kd(self) -> np.ndarray:
        """Present damping (n,), Nm s/rad."""
        damping: np.ndarray = self._now[1]
        return damping

    def change(self, kp: np.ndarray, kd: np.ndarray) -> None:
        """Begin a change to these gains (n,); NaN: as configured."""
        wanted = np.array((kp, kd))
        self._goal = np.where(np.isnan(wanted), self._configured, wanted)
        self._step = (self._goal - self._now) / _GLIDE_S

    def advance(self, dt: float) -> bool:
        """Advance the gains by `dt` s; return whether the gains have changed."""
        if self._now is self._goal:
            return False
        way, step = self._goal - self._now, self._step * dt
        there = np.abs(step) >= np.abs(way)
        self._now = self._goal if there.all() else np.where(there, self._goal, self._now + step)
        return True

    def reset(self) -> None:
        """Return to the configured gains at once."""
        self._now = self._goal = self._configured


class Impedance:
    """Computes one arm's commands, (n, 5) in joint coordinates, and the limits that act on them.

    Args:
        hardware: the arm.
        gravity: the arm's gravity model; None for a gripper without arm.
        gripper: the gripper's axis, or None if the gripper has no motor.

    Attributes:
        live: the arm's own gains, which a caller may change.
        weight_nm: (joints,) gravity torque by the model at the last commands.
        needed_nm: (joints,) torque by the model for gravity and the set-point's motion at the last commands.
        gentle: whether a hand may push the holding arm away: beside the weight it pulls with a quarter of its torque.
        coupled: whether the arm follows a leader at loop rate. While coupled, the profile's friction of soft joints is
            fed forward unless the configuration sets friction.
    """

    def __init__(self, hardware: ResolvedArm, gravity: "GravityModel | None", gripper: Gripper | None):
        self._hardware, self._gravity, self._gripper = hardware, gravity, gripper
        self.live = LiveGains(hardware.kp, hardware.kd)
        self.kp, self.kd = hardware.kp.copy(), hardware.kd.copy()
        self.own_gains = True  # whether the gains are as configured, not a target's
        self._of_target = False
        self._exact = hardware.config.track_integral
        self._sag = Sag(hardware)
        self._rubs = bool(hardware.coulomb_nm.any())
        # Friction keeps a soft joint 10 mrad off a moving target, and makes the joint stick where the target reverses.
        soft = hardware.kp[: hardware.joints] < SOFT_NM_RAD
        asked = hardware.config.coulomb_friction_nm is not None
        self._soft_nm = np.where(soft & (not asked), hardware.arm.coulomb_friction_nm, 0.0)
        self._soft_share = 0.0
        self.coupled = self.gentle = False
        # An arm with a gripper may lose a heavy object while it floats, and is damped with all its torque then.
        self._felt_nm = (1.0 if hardware.has_gripper else mit_laws.FELT_SHARE) * hardware.torque_limit_nm
        self._range_nm = range_nm(hardware)
        self._clipped = False
        # Bounds of all commanded positions; the gripper has its own stops.
        beyond = np.append(np.full(hardware.joints, RANGE_TOLERANCE_RAD), [np.inf] * hardware.has_gripper)
        self._lower, self._upper = hardware.lower - beyond, hardware.upper + beyond
        self.weight_nm: np.ndarray = np.zeros(hardware.joints)
        self.needed_nm: np.ndarray = self.weight_nm
        self.float_speed = mit_laws.FloatDamping(hardware.config.float_speed_rad_s, hardware.joints)

    def gains(self, kp: np.ndarray | None = None, kd: np.ndarray | None = None) -> None:
        """Use the gains (n,) of a target; NaN or None: the arm's own gains."""
        hw, own = self._hardware, self.live
        self.kp = own.kp if kp is None else np.where(np.isnan(kp), own.kp, kp)
        self.kd = own.kd if kd is None else np.where(np.isnan(kd), own.kd, kd)
        self._of_target = any(given is not None and not all_of(np.isnan(given)) for given in (kp, kd))
        self.own_gains = all_of(self.kp == hw.kp) and all_of(self.kd == hw.kd)

    @property
    def sag_nm(self) -> np.ndarray:
        """Torque (joints,), Nm, that compensates the error of the gravity model."""
        return self._sag.nm

    def explains(self, q: np.ndarray, error: np.ndarray) -> bool:
        """Return whether a wrong weight in the model can explain a position error of `error` (joints,) rad."""
        hw, j = self._hardware, slice(self._hardware.joints)
        missed = np.abs(self.kp[j] * error + self.sag_nm)
        return all_of(missed <= self._may_weigh_nm(q) + _RUBS * hw.torque_limit_nm[j])

    def carries(self, q: np.ndarray, joint: int) -> bool:
        """Return whether gravity acts on the joint at q (joints,), unlike on the base joint of an upright arm."""
        return bool(self._may_weigh_nm(q)[joint] > _RUBS * self._hardware.torque_limit_nm[joint])

    def _may_weigh_nm(self, q: np.ndarray) -> np.ndarray:
        """Return the maximum model error (joints,), Nm: the whole modelled torque plus that of the maximum load."""
        if self._gravity is None:
            return np.zeros(self._hardware.joints)
        load_nm: np.ndarray = PAYLOAD_MOST_KG * np.abs(self._gravity.torque_per_kg(q))
        return load_nm + np.abs(self._gravity.torque(q))

    def float_free(self, inputs: Inputs) -> tuple[np.ndarray, Limited]:
        """Compute commands that let the arm float with gravity compensation and soft walls at the joint limits."""
        hw, q, dq = self._hardware, inputs.q, inputs.dq
        out = np.zeros((hw.n, 5))
        j = slice(hw.joints)
        self._sag.forget()
        tau = self._weight(q)
        tau[j] += self._friction(dq[j])
        mit_laws.float_free(out, q, hw.idle_kd, tau)
        if inputs.assist is not None:
            tau[j] += inputs.assist[0]
            out[j, mit_laws.TAU] = tau[j]
            out[j, mit_laws.KD] += inputs.assist[1]
        most_kd = np.maximum(_MOST_KD - out[j, mit_laws.KD], 0.0)
        # The torque clip would turn a misread speed into a commanded one, so damping stays within the torque margin.
        room = np.minimum(np.maximum(hw.torque_limit_nm[j] - np.abs(tau[j]), 0.0), self._felt_nm[j])
        wrong_nm = _WRONG_TIMES * tolerance_nm(self._range_nm, self.weight_nm)
        kd = self.float_speed.damping(dq[j], inputs.dt, most_kd, room, wrong_nm)
        if kd is not None:
            out[j, mit_laws.KD] += kd
        wall = mit_laws.soft_wall(
            out[j], q[j], dq[j], hw.lower[j], hw.upper[j], hw.kp[j], hw.kd[j], hw.torque_limit_nm[j]
        )
        limited = Limited.JOINT_LIMIT if wall > _WORTH_SAYING_RAD else Limited.NOTHING
        if inputs.grips and self._gripper is not None:
            q_set, dq_set = inputs.asked[:, -1:]
            mit_laws.follow(out[-1:], q_set, dq_set, self.kp[-1:], self.kd[-1:], tau[-1:])
            limited |= self._grip(out, inputs)
        return self._clip(out, inputs, limited)

    def follow(self, inputs: Inputs) -> tuple[np.ndarray, Limited]:
        """Compute commands that make the arm hold or track the set-point."""
        hw, dt, mode = self._hardware, inputs.dt, inputs.mode
        out = np.zeros((hw.n, 5))
        j = slice(hw.joints)
        self.float_speed.reset()
        if self.live.advance(dt) and not self._of_target:
            self.gains()
        tau = inputs.feed_nm.copy()
        q_set, dq_set = inputs.asked
        holds = inputs.whole and (mode in (Mode.HOLD, Mode.STOPPED) or (self._exact and mode is Mode.TRACK))
        still = holds and (self._exact or largest(dq_set[j]) < _STILL_RAD_S)
        error = q_set[j] - inputs.q[j]
        beside = self._friction(dq_set[j])
        rubs = self.coupled or (self._exact and holds)
        if rubs or self._soft_share > 0.0:
            way = dt / _SOFT_FADE_S
            self._soft_share = min(max(self._soft_share + (way if rubs else -way), 0.0), 1.0)
            beside = beside + self._soft_share * mit_laws.friction(dq_set[j], self._soft_nm)
        tau[j] += beside + self._sag.while_holding(mode, error, dt, still, self._clipped)
        tau[j] += self._sag.while_landing(mode, error, dt, inputs.learns, self._clipped)
        mit_laws.follow(out, q_set, dq_set, self.kp, self.kd, tau)
        if inputs.fade is not None:
            share, damping = inputs.fade
            mit_laws.fade(out[j], share, damping * _MOST_KD)
        limited = Limited.NOTHING if self._gripper is None else self._grip(out, inputs)
        return self._clip(out, inputs, limited)

    def sink(self, commands: np.ndarray, joints: np.ndarray) -> None:
        """Reduce the commands for `joints`, (joints,) bool, to damping."""
        mit_laws.sink(commands[: self._hardware.joints], joints, _MOST_KD)

    def _grip(self, out: np.ndarray, inputs: Inputs) -> Limited:
        """Replace the gripper's row by a force-limited motor command."""
        assert self._gripper is not None
        u, u_rate = inputs.asked[:, -1].tolist()
        self._gripper.command(out[-1], inputs.now, u, u_rate, float(inputs.q[-1]), *inputs.gripper)
        return Limited.GRIPPER_FORCE if self._gripper.force_limited else Limited.NOTHING

    def most_weight_nm(self) -> np.ndarray:
        """Return the largest modelled weight (joints,), Nm, of many poses within the joint limits."""
        hw, j = self._hardware, slice(self._hardware.joints)
        poses = np.random.default_rng(0).uniform(hw.lower[j], hw.upper[j], (_POSES, hw.joints))
        torques = [np.zeros(hw.joints) if self._gravity is None else self._gravity.torque(q) for q in poses]
        most: np.ndarray = np.abs(torques).max(axis=0) * hw.arm.gravity_factor
        return most

    def _friction(self, dq: np.ndarray) -> np.ndarray | float:
        return mit_laws.friction(dq, self._hardware.coulomb_nm) if self._rubs else 0.0

    def _weight(self, q: np.ndarray) -> np.ndarray:
        """Return the torque (n,), Nm, that compensates gravity at rest."""
        hw = self._hardware
        tau = np.zeros(hw.n)
        if self._gravity is not None:
            self.weight_nm = self.needed_nm = self._gravity.torque(q[: hw.joints]) * hw.arm.gravity_factor
            tau[: hw.joints] = self.weight_nm
        return tau

    def feed_forward(self, inputs: Inputs) -> tuple[np.ndarray, float | None]:
        """Compute the feedforward torque (n,), Nm, for gravity and the set-point's speed and acceleration.

        Without speed and acceleration terms, an arm overshoots a quick start with up to twice the set-point's speed.
        A joint that reads far from its set-point counts as near it: if the reading is wrong, so would its weight be.

        Returns:
            The torque, and the share to which the set-point's acceleration must be reduced, so that the arm does not
            lag behind and rush to catch up later. None: the torque limits allow the full acceleration.
        """
        hw = self._hardware
        tau = np.zeros(hw.n)
        if self._gravity is None:
            return tau, None
        j = slice(hw.joints)
        ddq = np.minimum(np.maximum(inputs.asked_ddq[j], -hw.acceleration_limit), hw.acceleration_limit)
        dq = inputs.asked[1, j]
        goal = inputs.asked[0, j]
        most_rad = _NEAR_RAD * hw.kp[j] / np.maximum(self.kp[j], _LEAST_KP)
        near = np.minimum(np.maximum(inputs.q[j], goal - most_rad), goal + most_rad)
        ahead = near + _AHEAD_TICKS * inputs.dt * dq
        weight, turning, inertia = self._gravity.torques(ahead, dq, ddq)
        self.weight_nm = weight * hw.arm.gravity_factor
        steady, inertia = self.weight_nm + turning, inertia + hw.arm.armature_kg_m2 * ddq
        tau[j] = steady + inertia
        most = _PLANNED_SHARE * hw.torque_limit_nm[j]
        self.needed_nm = tau[j].copy()
        if all_of(np.abs(tau[j]) <= most):  # the usual case
            return tau, None
        room = most - steady * np.sign(inertia)
        share = max(float(np.min(room / np.maximum(np.abs(inertia), 1e-9), initial=1.0)), _LEAST_SHARE)
        tau[j] = self.needed_nm = steady + share * inertia
        return tau, share

    def _clip(self, out: np.ndarray, inputs: Inputs, limited: Limited) -> tuple[np.ndarray, Limited]:
        """Clip commands to torque limits and joint ranges.

        For the torque limits, a measured position beyond the joint's range counts as the end of the range, so that the
        clip does not move the command out of the range.
        """
        q = np.minimum(np.maximum(inputs.q, self._lower), self._upper)
        limit = self._hardware.torque_limit_nm
        if self.gentle:
            limit = np.minimum(limit, np.abs(out[:, mit_laws.TAU]) + mit_laws.FELT_SHARE * limit)
        self._clipped = mit_laws.clip_torque(out, q, inputs.dq, limit)
        out[:, mit_laws.Q] = np.minimum(np.maximum(out[:, mit_laws.Q], self._lower), self._upper)
        return out, limited | Limited.TORQUE if self._clipped else limited


def gravity_model(hardware: ResolvedArm) -> "GravityModel | None":
    """Create the gravity model of an arm; None for a gripper without arm."""
    if not hardware.joints:
        return None
    from lerobot_robot_yam.arm.dynamics import GravityModel  # late import of MuJoCo, which a base does not need

    return GravityModel(hardware.arm, hardware.gripper, load=hardware.load, tilt_rad=hardware.tilt_rad)
