"""Correction torque for errors of the gravity model, learnt while an arm holds still and while the arm lands."""

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.state.modes import Mode

SOFT_NM_RAD = 20.0
"""Stiffness below which a joint counts as soft."""
# Rates of the integral that compensates sag, per Nm/rad of stiffness, so that all joints behave alike.
_SAG_RATE_PER_S = 1.5  # ki / kp: sag shrinks with a time constant of 1 / 1.5 s
_TRACK_RATES_PER_S = 4.0, 8.0  # ki / kp of stiff and of soft joints while tracking: stable while kd > rate · inertia
_SAG_RAD = 0.05  # maximum sag that is compensated; YAM's joints 3 and 4 settle about 0.03 rad low
_TOO_FAR_RAD = 0.1  # error from which the cause is not sag: a hand holds the arm
_DEADBAND_RAD = 0.002  # error below which nothing is corrected: several encoder steps (0.38 mrad)
_TRACK_DEADBAND_RAD = 0.0015
_LEAK_S = 0.5  # time constant with which the torque fades out
# Rate, bound and maximum error while an arm lands.
_LAND_RATE_PER_S = 2.0
_LAND_SHARE = 0.4  # share of the torque limit: 11 Nm of a DM4340, 4 Nm of a DM4310, for an unknown 3 kg at 0.35 m
_LAND_TOO_FAR_RAD = 0.35  # maximum sag of a soft wrist; a stiff joint counts as stuck at a smaller error


class HoldIntegral:
    """Integral term for n joints that corrects the gravity model while an arm holds still.

        tau += ki e' dt,  |tau| ≤ limit,  e' = the part of e = q_set − q outside the deadband

    The integral grows only while the set-point rests, unless `track_integral` is set. When the set-point moves, or the
    arm floats or lands, the torque fades out (`_LEAK_S`): the model's error differs from pose to pose, and a sudden end
    would be a jolt.
    While the torque clip acts, or the error is too large for sag, the torque does not grow. The deadband prevents
    hunting: against dry friction an integral without a deadband oscillates slowly for ever.

    Args:
        ki: (n,) gain, Nm/(rad s).
        limit_nm: (n,) maximum torque.
        too_far_rad: error above which the cause is not sag.
        deadband_rad: error below which nothing is corrected.
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
        """Create an integral with ki and limit proportional to kp (n,), Nm/rad; a faster one if `tracks`."""
        if not tracks:
            return cls(_SAG_RATE_PER_S * kp, _SAG_RAD * kp)
        stiff, soft = _TRACK_RATES_PER_S
        rates = np.where(kp < SOFT_NM_RAD, soft, stiff)
        return cls(rates * kp, _SAG_RAD * kp, deadband_rad=_TRACK_DEADBAND_RAD)

    @classmethod
    def for_landing(cls, kp: np.ndarray, torque_limit_nm: np.ndarray) -> "HoldIntegral":
        """Create a faster and much stronger integral (n,), for an arm that must land however wrong its model is."""
        kp = np.maximum(kp, 1.0)
        return cls(_LAND_RATE_PER_S * kp, _LAND_SHARE * torque_limit_nm, _LAND_TOO_FAR_RAD)

    def advance(self, error: np.ndarray, dt: float, holding: bool, clipped: bool = False) -> np.ndarray:
        """Compute the feedforward torque (n,), Nm, for one tick of `dt` s.

        Args:
            error: (n,) q_set − q, rad.
            holding: whether the arm holds and its set-point rests.
            clipped: whether the torque clip changed the last commands.
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
    """Correction of one arm's gravity model: while the arm holds, if configured, and while the arm lands."""

    def __init__(self, hardware: ResolvedArm):
        config, j = hardware.config, slice(hardware.joints)
        self._kp, self._limit_nm = hardware.kp[j], hardware.torque_limit_nm[j]
        self._hold: HoldIntegral | None = None
        if config.hold_integral or config.track_integral:
            self._hold = HoldIntegral.for_stiffness(self._kp, config.track_integral)
        self._land: HoldIntegral | None = None

    @property
    def nm(self) -> np.ndarray:
        """Present correction torque (joints,), Nm."""
        zero = np.zeros(len(self._kp))
        return sum((part.tau for part in (self._hold, self._land) if part is not None), zero)

    def while_holding(self, mode: Mode, error: np.ndarray, dt: float, still: bool, clipped: bool) -> np.ndarray | float:
        """Compute the torque (joints,), Nm, for one tick. still: whether the arm holds and its set-point rests.

        During an emergency stop the torque stays constant, since more torque would move the arm.
        """
        if self._hold is None:
            return 0.0
        return self._hold.advance(error, 0.0 if mode is Mode.STOPPED else dt, still, clipped)

    def while_landing(
        self, mode: Mode, error: np.ndarray, dt: float, learns: bool, clipped: bool
    ) -> np.ndarray | float:
        """Compute the torque (joints,), Nm, which grows while a landing arm `learns`, sagging below its set-point.

        Without learning, the torque fades out in BRING_UP, HOLD and TRACK, and stays constant in all other modes.
        """
        if learns:
            self._land = self._land or HoldIntegral.for_landing(self._kp, self._limit_nm)
        if self._land is None:
            return 0.0
        goes_on = mode in (Mode.BRING_UP, Mode.HOLD, Mode.TRACK)
        return self._land.advance(error, dt if learns or goes_on else 0.0, not goes_on, clipped)

    def forget(self) -> None:
        """Forget all torques because the arm floats: a pulling hand looks like sag, and would be pushed away."""
        self._land = None
        if self._hold is not None:
            self._hold.tau = np.zeros(len(self._kp))
