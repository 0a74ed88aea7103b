"""Torque that the gravity model misses, learnt while an arm holds still, and while it lands."""

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.state.modes import Mode

SOFT_NM_RAD = 20.0
"""Joints with less stiffness are soft."""
# Rates of the integral that makes up for sag, per Nm/rad of stiffness, so that every joint behaves alike.
_SAG_RATE_PER_S = 1.5  # ki / kp: sag shrinks with a time constant of 1 / 1.5 s
_TRACK_RATES_PER_S = 4.0, 8.0  # ki / kp of stiff and of soft joints that track: stable while kd > rate · inertia
_SAG_RAD = 0.05  # largest sag that is made up for; YAM's joints 3 and 4 settle about 0.03 rad low
_TOO_FAR_RAD = 0.1  # error from which there is no sag: a hand holds the arm
_DEADBAND_RAD = 0.002  # errors below are left: several steps of the reading (0.38 mrad)
_TRACK_DEADBAND_RAD = 0.0015
_LEAK_S = 0.5  # time constant with which the torque fades
# Rate, bound and largest error while an arm lands.
_LAND_RATE_PER_S = 2.0
_LAND_SHARE = 0.4  # share of the torque limits: 11 Nm of a DM4340, 4 of a DM4310, for an unknown 3 kg at 0.35 m
_LAND_TOO_FAR_RAD = 0.35  # how far a soft wrist may hang off; a stiff joint is stuck before


class HoldIntegral:
    """Torque of n joints that the gravity model misses while an arm holds still.

        tau += ki e' dt,  |tau| ≤ limit,  e' = the part of e = q_set − q outside the deadband

    It works only while the set-point rests, unless `track_integral` is set. When the set-point moves, or the arm floats
    or lands, the torque fades away (`_LEAK_S`): what was missing in one pose is not what is missing in the next, and a
    sudden end would be a knock.
    While the torque clip acts, or the error is too large for sag, the torque does not grow. The deadband keeps it from
    hunting: against dry friction an integral without one creeps to and fro for ever.

    Args:
        ki: (n,) gain, Nm/(rad s).
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
        """Make an integral with ki and limit in proportion to stiffness kp (n,), Nm/rad; quicker if the arm tracks."""
        if not tracks:
            return cls(_SAG_RATE_PER_S * kp, _SAG_RAD * kp)
        stiff, soft = _TRACK_RATES_PER_S
        rates = np.where(kp < SOFT_NM_RAD, soft, stiff)
        return cls(rates * kp, _SAG_RAD * kp, deadband_rad=_TRACK_DEADBAND_RAD)

    @classmethod
    def for_landing(cls, kp: np.ndarray, torque_limit_nm: np.ndarray) -> "HoldIntegral":
        """Make a quicker and much stronger one, of (n,), for an arm that must come down however wrong its model is."""
        kp = np.maximum(kp, 1.0)
        return cls(_LAND_RATE_PER_S * kp, _LAND_SHARE * torque_limit_nm, _LAND_TOO_FAR_RAD)

    def advance(self, error: np.ndarray, dt: float, holding: bool, clipped: bool = False) -> np.ndarray:
        """Compute the torque (n,), Nm, to feed forward in this tick of `dt` s.

        Args:
            error: (n,) q_set − q, rad.
            holding: whether the arm holds and its set-point rests.
            clipped: whether the last commands were held back by the torque clip.
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


class Sag:
    """Torque that the model of one arm misses: while it holds, if its configuration says so, and while it lands."""

    def __init__(self, hardware: ResolvedArm):
        config, j = hardware.config, slice(hardware.joints)
        self._kp, self._limit_nm = hardware.kp[j], hardware.torque_limit_nm[j]
        self._hold: HoldIntegral | None = None
        if config.hold_integral or config.track_integral:
            self._hold = HoldIntegral.for_stiffness(self._kp, config.track_integral)
        self._land: HoldIntegral | None = None

    @property
    def nm(self) -> np.ndarray:
        """Missed torque (joints,) that the arm carries, Nm."""
        zero = np.zeros(len(self._kp))
        return sum((part.tau for part in (self._hold, self._land) if part is not None), zero)

    def while_holding(self, mode: Mode, error: np.ndarray, dt: float, still: bool, clipped: bool) -> np.ndarray | float:
        """Compute the torque (joints,), Nm, in this tick of an arm that holds `still`, or does not.

        During an emergency stop the torque stays, since more torque would move the arm.
        """
        if self._hold is None:
            return 0.0
        return self._hold.advance(error, 0.0 if mode is Mode.STOPPED else dt, still, clipped)

    def while_landing(
        self, mode: Mode, error: np.ndarray, dt: float, learns: bool, clipped: bool
    ) -> np.ndarray | float:
        """Compute the torque (joints,), Nm, that a landing arm `learns` while it hangs off its set-point.

        An arm that lands, or is stopped on its way, keeps what it has learnt. Else the torque fades away.
        """
        if learns:
            self._land = self._land or HoldIntegral.for_landing(self._kp, self._limit_nm)
        if self._land is None:
            return 0.0
        goes_on = mode in (Mode.BRING_UP, Mode.HOLD, Mode.TRACK)
        return self._land.advance(error, dt if learns or goes_on else 0.0, not goes_on, clipped)

    def forget(self) -> None:
        """Forget everything: the arm floats. A hand that pulls looks like sag, and would be thrown off."""
        self._land = None
        if self._hold is not None:
            self._hold.tau = np.zeros(len(self._kp))
