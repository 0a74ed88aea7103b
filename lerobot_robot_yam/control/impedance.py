"""The impedance of one arm: from set-point and measured state to MIT commands, without life cycle or clock."""

from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.config_checks import PAYLOAD_MOST_KG
from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.joint_map import RANGE_TOLERANCE_RAD
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.control.gripper.gripper import Gripper
from lerobot_robot_yam.control.laws import mit_laws
from lerobot_robot_yam.control.laws.live_gains import LiveGains
from lerobot_robot_yam.control.laws.set_point import SetPoint
from lerobot_robot_yam.state.faults import MOST_RAD_S2
from lerobot_robot_yam.state.records import Limited
from lerobot_robot_yam.system.few_values import all_of, largest

# The integral that makes up for sag, per Nm/rad of stiffness, so that every joint behaves alike.
_SAG_RATE_PER_S = 1.5  # ki / kp: sag shrinks with a time constant of 1 / 1.5 s
_TRACK_RATES_PER_S = 4.0, 8.0  # the same of stiff and of soft joints that track: stable while kd > rate · inertia
_SAG_RAD = 0.05  # most sag that is made up for; YAM's joints 3 and 4 settle about 0.03 rad low
_TOO_FAR_RAD = 0.1  # larger errors are no sag: a hand holds the arm
# The same while an arm lands.
_LAND_RATE_PER_S = 2.0
_LAND_SHARE = 0.4  # of the torque limits: 11 Nm of a DM4340 and 4 of a DM4310: an unknown 3 kg at 0.35 m
_LAND_TOO_FAR_RAD = 0.35  # of a soft wrist; a stiff joint is stuck before
_DEADBAND_RAD = 0.002  # several steps of the reading (0.38 mrad)
_TRACK_DEADBAND_RAD = 0.0015
_LEAK_S = 0.5  # time constant

_SOFT_NM_RAD, _SOFT_FADE_S = 20.0, 0.3
_STILL_RAD_S = 1e-3
_WORTH_SAYING_RAD = 0.01  # rest lies on a limit for some joints
_RUBS = 0.05  # of the torque limit, 1.4 Nm of a DM4340: what friction holds back
_MOST_KD = 5.0  # Nm s/rad, the most that the motors take: what is still unsupported sinks slowly
_PLANNED_SHARE = 0.9  # of the torque limit, for the set-point; the rest is for what models do not know
_LEAST_SHARE = 0.2  # of the acceleration: a set-point must always be able to brake
_AHEAD_TICKS = 1.5  # from a sample to the middle of the tick during which its command holds


class HoldIntegral:
    """The torque that the gravity model misses while an arm holds still, of n joints.

        tau += ki e' dt,  |tau| ≤ limit,  e' = the part of e = q_set − q outside the deadband

    It works only while the set-point rests, unless `track_integral` is set. When the set-point moves, or the arm floats
    or lands, the torque fades away (`_LEAK_S`): what was missing in one pose is not what is missing in the next, and a
    sudden end would be a knock.
    While the torque clip acts, or where the error is too large for sag, it does not grow. The deadband keeps it from
    hunting: against dry friction an integral without one creeps to and fro for ever.

    Args:
        ki: (n,) Nm/(rad s).
        limit_nm: (n,) bound of the torque.
        too_far_rad: larger errors are not sag.
        deadband_rad: smaller errors are left.
    """

    def __init__(
        self,
        ki: np.ndarray,
        limit_nm: np.ndarray,
        too_far_rad: float = _TOO_FAR_RAD,
        deadband_rad: float = _DEADBAND_RAD,
    ):
        self._ki, self._limit, self._too_far, self._deadband = ki, limit_nm, too_far_rad, deadband_rad
        self.tau: np.ndarray = np.zeros(len(ki))

    @classmethod
    def for_stiffness(cls, kp: np.ndarray, tracks: bool = False) -> "HoldIntegral":
        """With ki and limit in proportion to the position gains kp (n,), Nm/rad; quicker for an arm that tracks."""
        if not tracks:
            return cls(_SAG_RATE_PER_S * kp, _SAG_RAD * kp)
        stiff, soft = _TRACK_RATES_PER_S
        rates = np.where(kp < _SOFT_NM_RAD, soft, stiff)
        return cls(rates * kp, _SAG_RAD * kp, deadband_rad=_TRACK_DEADBAND_RAD)

    @classmethod
    def for_landing(cls, kp: np.ndarray, torque_limit_nm: np.ndarray) -> "HoldIntegral":
        """Of an arm that must come down whatever is wrong with its model: quicker, and much stronger, all (n,)."""
        kp = np.maximum(kp, 1.0)
        return cls(_LAND_RATE_PER_S * kp, _LAND_SHARE * torque_limit_nm, _LAND_TOO_FAR_RAD)

    def advance(self, error: np.ndarray, dt: float, holding: bool, clipped: bool = False) -> np.ndarray:
        """Torque (n,) Nm to feed forward in this tick of `dt` s.

        Args:
            error: (n,) rad, q_set − q.
            holding: the arm holds and its set-point rests.
            clipped: the last commands were held back by the torque clip.
        """
        if not holding:
            self.tau *= max(0.0, 1.0 - dt / _LEAK_S)
            return self.tau
        beyond = error - np.minimum(np.maximum(error, -self._deadband), self._deadband)
        step = np.where(np.abs(error) < self._too_far, self._ki * beyond * dt, 0.0)
        if clipped:
            step = np.where(step * self.tau > 0.0, 0.0, step)
        self.tau = np.minimum(np.maximum(self.tau + step, -self._limit), self._limit)
        return self.tau

    def reset(self) -> None:
        """Forget everything at once."""
        self.tau = np.zeros(len(self._ki))


class Grip(NamedTuple):
    """What the gripper of an arm that floats does: it keeps to its set-point.

    measured: its rate and torque, strokes/s and Nm.
    """

    now: float
    setpoint: SetPoint
    measured: tuple[float, float]


class Impedance:
    """Commands of one arm, (n, 5) in joint coordinates.

    Args:
        hardware: the arm.
        gravity: its model; None for a gripper alone.
        gripper: its gripper's axis, if it has a motor.

    Attributes:
        live: its own gains, which a caller may change.
        weight_nm: (joints,) what the model says that the arm weighs, as of the last commands.
        coupled: it follows a leader at loop rate. Then the friction of soft joints is fed forward, as the profile has
            it, unless the configuration says how much.
    """

    def __init__(self, hardware: ResolvedArm, gravity: GravityModel | None, gripper: Gripper | None):
        self._hardware, self._gravity, self._gripper = hardware, gravity, gripper
        self.commands = np.zeros((hardware.n, 5))
        self.live = LiveGains(hardware.kp, hardware.kd)
        self.kp, self.kd = hardware.kp.copy(), hardware.kd.copy()
        self.own_gains = True  # as configured, and not those of a target
        self._of_target = False
        self._exact = exact = hardware.config.track_integral
        holds = hardware.config.hold_integral or exact
        self._integral = HoldIntegral.for_stiffness(hardware.kp[: hardware.joints], exact) if holds else None
        self._landing: HoldIntegral | None = None  # torque that the gravity model misses while landing
        self._rubs = bool(hardware.coulomb_nm.any())
        # Friction takes a soft joint 10 mrad off a target that moves, and makes it stick where that turns.
        soft = hardware.kp[: hardware.joints] < _SOFT_NM_RAD
        asked = hardware.config.coulomb_friction_nm is not None
        self._soft_nm = np.where(soft & (not asked), hardware.arm.coulomb_friction_nm, 0.0)
        self._soft_share = 0.0
        self.coupled = False
        self._clipped = False
        # Nothing is sent beyond: the gripper keeps its own stops.
        beyond = np.append(np.full(hardware.joints, RANGE_TOLERANCE_RAD), [np.inf] * hardware.has_gripper)
        self._lower, self._upper = hardware.lower - beyond, hardware.upper + beyond
        self.before = np.full(hardware.n, np.nan), np.full(hardware.n, np.nan)  # q, dq of the sample before
        self.weight_nm: np.ndarray = np.zeros(hardware.joints)
        self.float_speed = mit_laws.FloatDamping(hardware.config.float_speed_rad_s, hardware.joints)

    def gains(self, kp: np.ndarray | None = None, kd: np.ndarray | None = None) -> None:
        """Use these gains (n,) of a target from now on; NaN or None means its own ones."""
        hw, own = self._hardware, self.live
        self.kp = own.kp if kp is None else np.where(np.isnan(kp), own.kp, kp)
        self.kd = own.kd if kd is None else np.where(np.isnan(kd), own.kd, kd)
        self._of_target = any(given is not None and not all_of(np.isnan(given)) for given in (kp, kd))
        self.own_gains = all_of(self.kp == hw.kp) and all_of(self.kd == hw.kd)

    @property
    def sag_nm(self) -> np.ndarray:
        """(joints,) Nm with which it carries what the gravity model misses."""
        zero = np.zeros(self._hardware.joints)
        return sum((part.tau for part in (self._integral, self._landing) if part is not None), zero)

    def explains(self, q: np.ndarray, error: np.ndarray) -> bool:
        """Whether a model that is wrong about the arm's weight can be why it hangs `error` (joints,) rad behind."""
        hw, j = self._hardware, slice(self._hardware.joints)
        missed = np.abs(self.kp[j] * error + self.sag_nm)
        return all_of(missed <= self._may_weigh_nm(q) + _RUBS * hw.torque_limit_nm[j])

    def carries(self, q: np.ndarray, joint: int) -> bool:
        """Whether the joint carries a weight at q (joints,): those upright arms turn on do not."""
        return bool(self._may_weigh_nm(q)[joint] > _RUBS * self._hardware.torque_limit_nm[joint])

    def _may_weigh_nm(self, q: np.ndarray) -> np.ndarray:
        """(joints,) Nm by which a model may be wrong: all that it says, and the heaviest load."""
        if self._gravity is None:
            return np.zeros(self._hardware.joints)
        load_nm: np.ndarray = PAYLOAD_MOST_KG * np.abs(self._gravity.torque_per_kg(q))
        return load_nm + np.abs(self._gravity.torque(q))

    def float_free(
        self,
        q: np.ndarray,
        dq: np.ndarray,
        dt: float,
        assist: tuple[np.ndarray, np.ndarray] | None = None,
        grip: Grip | None = None,
    ) -> Limited:
        """Gravity-compensated free motion, pushed back gently beyond the joint limits.

        Args:
            q, dq: (n,) of the motors, gripper in rad.
            dt: s.
            assist: more torque and damping (joints,), within the torque limits.
            grip: what the gripper does; None: it is free, too.
        """
        hw, out = self._hardware, self.commands
        j = slice(hw.joints)
        self._landing = None
        tau = self._weight(q)
        tau[j] += self._friction(dq[j])
        if self._integral is not None:
            self._integral.reset()  # a hand that pulls looks like sag, and would be thrown off
        mit_laws.float_free(out, q, hw.idle_kd, tau)
        if assist is not None:
            tau[j] += assist[0]
            out[j, mit_laws.TAU] = tau[j]
            out[j, mit_laws.KD] += assist[1]
        share = self.float_speed.share(dq[j], dt)
        if share is not None:
            # Within what the torque limit leaves: the clip would turn a speed that was read wrongly into a real one.
            room = np.maximum(hw.torque_limit_nm[j] - np.abs(tau[j]), 0.0) / np.maximum(np.abs(dq[j]), 1e-9)
            out[j, mit_laws.KD] = np.minimum(out[j, mit_laws.KD] + share * (_MOST_KD - hw.idle_kd[j]), room)
        wall = mit_laws.soft_wall(
            out[j], q[j], dq[j], hw.lower[j], hw.upper[j], hw.kp[j], hw.kd[j], hw.torque_limit_nm[j]
        )
        limited = Limited.JOINT_LIMIT if wall > _WORTH_SAYING_RAD else Limited.NOTHING
        if grip is not None and self._gripper is not None:
            q_set, dq_set = grip.setpoint.asked[:, -1:]
            mit_laws.follow(out[-1:], q_set, dq_set, self.kp[-1:], self.kd[-1:], tau[-1:])
            limited |= self._grip(grip.now, grip.setpoint, float(q[-1]), grip.measured)
        return limited | Limited.TORQUE if self._clip(q, dq) else limited

    def follow(
        self,
        now: float,
        dt: float,
        q: np.ndarray,
        dq: np.ndarray,
        setpoint: SetPoint,
        gripper: tuple[float, float],
        holding: bool,
        stopped: bool,
        learns: bool | None,
        fade: tuple[np.ndarray, np.ndarray] | None,
    ) -> Limited:
        """Hold or track the set-point.

        Args:
            now, dt: s.
            q, dq: (n,) of the motors, gripper in rad.
            gripper: measured rate and torque of the gripper, strokes/s and Nm.
            holding: the arm holds, with all its motors; no targets come, or `track_integral` is set.
            stopped: the emergency stop is latched: what is made up for sag stays, since more of it would move the arm.
            learns: the arm lands and hangs off its set-point: the model is wrong, and what it misses is learnt. False
                keeps what has been learnt, None lets it fade away.
            fade: (joints,) shares of stiffness with feed-forward, and of the landing's damping, that are left while
                landing ends; None: the arm's own.
        """
        hw, out = self._hardware, self.commands
        j = slice(hw.joints)
        self.float_speed.reset()
        if self.live.advance(dt) and not self._of_target:
            self.gains()
        limited = Limited.NOTHING
        tau, held_back = self._feed_forward(q, setpoint, dt)
        if held_back:
            limited |= Limited.TORQUE
        q_set, dq_set = setpoint.asked
        still = holding and (self._exact or largest(dq_set[j]) < _STILL_RAD_S)
        error = q_set[j] - q[j]
        beside = self._friction(dq_set[j])
        rubs = self.coupled or (self._exact and holding)
        if rubs or self._soft_share > 0.0:
            way = dt / _SOFT_FADE_S
            self._soft_share = min(max(self._soft_share + (way if rubs else -way), 0.0), 1.0)
            beside = beside + self._soft_share * mit_laws.friction(dq_set[j], self._soft_nm)
        if self._integral is not None:
            beside = beside + self._integral.advance(error, 0.0 if stopped else dt, still, self._clipped)
        tau[j] += beside
        if learns:
            self._landing = self._landing or HoldIntegral.for_landing(hw.kp[j], hw.torque_limit_nm[j])
        if self._landing is not None:
            passes_s = 0.0 if learns is False else dt
            tau[j] += self._landing.advance(error, passes_s, learns is not None, self._clipped)
        mit_laws.follow(out, q_set, dq_set, self.kp, self.kd, tau)
        if fade is not None:
            share, damping = fade
            mit_laws.fade(out[j], share, damping * _MOST_KD)
        if self._gripper is not None:
            limited |= self._grip(now, setpoint, float(q[-1]), gripper)
        return limited | Limited.TORQUE if self._clip(q, dq) else limited

    def sink(self, joints: np.ndarray) -> None:
        """Leave these joints, (joints,) bool, only damping of the commands that have just been made."""
        mit_laws.sink(self.commands[: self._hardware.joints], joints, _MOST_KD)

    def _grip(self, now: float, setpoint: SetPoint, motor_rad: float, measured: tuple[float, float]) -> Limited:
        """Turn the gripper's row into a command of its motor, with limited force."""
        assert self._gripper is not None
        u, u_rate = setpoint.asked[:, -1].tolist()
        self._gripper.command(self.commands[-1], now, u, u_rate, motor_rad, *measured)
        return Limited.GRIPPER_FORCE if self._gripper.force_limited else Limited.NOTHING

    def _friction(self, dq: np.ndarray) -> np.ndarray | float:
        return mit_laws.friction(dq, self._hardware.coulomb_nm) if self._rubs else 0.0

    def _weight(self, q: np.ndarray) -> np.ndarray:
        """(n,) Nm that carry the arm at rest."""
        hw = self._hardware
        tau = np.zeros(hw.n)
        if self._gravity is not None:
            self.weight_nm = self._gravity.torque(q[: hw.joints]) * hw.arm.gravity_factor
            tau[: hw.joints] = self.weight_nm
        return tau

    def _feed_forward(self, q: np.ndarray, setpoint: SetPoint, dt: float) -> tuple[np.ndarray, bool]:
        """(n,) Nm that carry the arm along the set-point, with its speed and acceleration; and whether it is held back.

        Without the latter two these gains answer a quick start with up to twice the set-point's speed. The set-point is
        held back where its acceleration takes more torque than there is: an arm that cannot follow would hurry after it
        later.
        """
        hw = self._hardware
        tau = np.zeros(hw.n)
        if self._gravity is None:
            return tau, False
        j = slice(hw.joints)
        ddq = np.minimum(np.maximum(setpoint.asked_ddq[j], -MOST_RAD_S2), MOST_RAD_S2)
        dq = setpoint.asked[1, j]
        weight, turning, inertia = self._gravity.torques(q[j] + _AHEAD_TICKS * dt * dq, dq, ddq)
        self.weight_nm = weight * hw.arm.gravity_factor
        steady, inertia = self.weight_nm + turning, inertia + hw.arm.armature_kg_m2 * ddq
        tau[j] = steady + inertia
        most = _PLANNED_SHARE * hw.torque_limit_nm[j]
        if all_of(np.abs(tau[j]) <= most):  # nearly always
            return tau, False
        room = most - steady * np.sign(inertia)
        share = max(float(np.min(room / np.maximum(np.abs(inertia), 1e-9), initial=1.0)), _LEAST_SHARE)
        setpoint.hold_back(np.append(np.full(hw.joints, share), [1.0] * hw.has_gripper))
        tau[j] = steady + share * inertia
        return tau, share < 1.0

    def _clip(self, q: np.ndarray, dq: np.ndarray) -> bool:
        """Within the torque limits and the joints' ranges: a reading beyond those takes no command along."""
        q, out = np.minimum(np.maximum(q, self._lower), self._upper), self.commands
        self._clipped = mit_laws.clip_torque(out, q, dq, self._hardware.torque_limit_nm, self.before)
        out[:, mit_laws.Q] = np.minimum(np.maximum(out[:, mit_laws.Q], self._lower), self._upper)
        return self._clipped
