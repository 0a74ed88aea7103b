"""Fit of an arm's weight and friction to samples of slow sweeps. Pure: no files, no clock.

While joint j turns,

    τ_j = g_j(q) + Y_j(q) x + a_j sign(dq_j) + b_j dq_j + (C dq + M ddq)_j

where g is the profile's gravity torque, Y its derivative with respect to the moments x (`gravity_terms`) or to the
payload, a Coulomb friction and b viscous friction. Sweeps in both directions separate friction from weight. C and M
come from the model, and are computed again with the fitted moments.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from mujoco import sysid

from lerobot_robot_yam.arm.config_checks import PAYLOAD_MOST_KG
from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.arm.tuning import Payload, Tuning
from lerobot_robot_yam.commands.lib.tune.gravity_terms import PAYLOAD_TERMS, GravityTerms
from lerobot_robot_yam.commands.lib.tune.tune_motion import Samples, torque_steps
from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.own_commands import install_extra

_LEAST_RAD_S = 0.03  # minimum speed of the samples used, rad/s: a slower joint may stick
_PASSES = 3
_MOMENT_MOST_KG_M = 2.0  # bound on a fitted moment, kg m: about 3 kg at 0.6 m
_COULOMB_MOST_NM, _VISCOUS_MOST_NM_S = 5.0, 5.0
# A parameter whose 95 % interval is wider than ± these limits is reported as unknown.
_WIDE_NM = 0.1  # limit for Coulomb friction, Nm
_WIDE_NM_S = 0.3  # limit for viscous friction, Nm s/rad
_WIDE_SHARE, _WIDE_STEPS = 0.05, 6  # limit for moments: share of the joint's maximum load, or torque steps if larger
_G_M_S2 = 9.81
_POSES = 300  # random poses that represent the workspace
_WEIGHS_NM = 0.1  # minimum load of a joint for fitting its gravity factor, rms over the workspace, Nm
_NORMAL_95 = 1.96


class Parameter(NamedTuple):
    """Parameter to fit: its joint (from 0), name, bounds, and the maximum width of its interval.

    Attributes:
        wide: maximum half width of the 95 % interval for which the parameter counts as known.
    """

    joint: int
    what: str
    low: float
    high: float
    wide: float


class NotToldError(ConfigError):
    """Error: the samples do not determine all parameters of an arm.

    Attributes:
        joints: indices, from 0, of the joints with unknown parameters.
    """

    def __init__(self, hardware: ResolvedArm, unknown: Sequence[Parameter]):
        self.joints = sorted({parameter.joint for parameter in unknown})
        told = [
            f"{hardware.joint_names[j]} ({', '.join(own.what for own in unknown if own.joint == j)})"
            for j in self.joints
        ]
        super().__init__(f"{hardware.name}: the data do not tell {', '.join(told)}")


class Solution(NamedTuple):
    """Fitted values of p parameters.

    Attributes:
        values: (p,) values, each in the unit of its parameter.
        half_95: (p,) half the width of each 95 % confidence interval; infinite where the samples give no information.
        covariance: (p, p) covariance; valid if all of `half_95` are finite.
    """

    values: np.ndarray
    half_95: np.ndarray
    covariance: np.ndarray


class Fit(NamedTuple):
    """Result of a fit to k samples of n joints.

    Attributes:
        tuning: tuning of the arm.
        samples: samples that were fitted.
        missed_nm: (k, n) error of the profile's gravity torque, Nm. NaN where a joint does not turn.
        rest_nm: (k, n) remaining error with the tuning, Nm. NaN in the same places.
    """

    tuning: Tuning
    samples: Samples
    missed_nm: np.ndarray
    rest_nm: np.ndarray


def require_engine() -> None:
    """Raise ConfigError if `mujoco.sysid` is incomplete: the module omits functions whose imports fail."""
    if not hasattr(sysid, "calculate_intervals"):
        raise ConfigError(f"yam-tune needs mujoco.sysid; {install_extra('sysid')}")


def fit(hardware: ResolvedArm, samples: Samples, bare: Tuning | None = None) -> Fit:
    """Fit friction and moments, or friction and a payload.

    Args:
        hardware: the arm, without a tuning.
        samples: samples of sweeps in both directions.
        bare: tuning of the same arm without a payload; if given, a payload is fitted on top of this tuning.

    Raises:
        NotToldError: the samples do not determine all parameters.
    """
    tilt, profiles = hardware.tilt_rad, (hardware.arm, hardware.gripper)
    plain = GravityTerms(*profiles, load=hardware.load, tilt_rad=tilt)
    terms = plain if bare is None else GravityTerms(*bare.tuned(*profiles), load=hardware.load, tilt_rad=tilt)
    parameters = _parameters(hardware, terms, bare is not None)
    used = np.abs(samples.dq) > _LEAST_RAD_S
    if not used.any():
        raise NotToldError(hardware, parameters)
    weights = np.array([_weights(terms, q, bare is not None) for q in samples.q])
    each = np.eye(hardware.joints)
    columns = np.concatenate([weights, np.sign(samples.dq)[..., None] * each, samples.dq[..., None] * each], axis=2)
    carries = np.array([terms.torque(q) for q in samples.q])
    felt = _mean_torque(hardware, samples) - carries - hardware.arm.armature_kg_m2 * samples.ddq
    model: GravityModel = terms
    steps = noise = torque_steps(hardware)
    for _ in range(_PASSES):
        moving = [np.add(*model.torques(*row)[1:]) for row in zip(samples.q, samples.dq, samples.ddq, strict=True)]
        left = felt - moving
        scale = np.broadcast_to(noise, used.shape)[used]
        found = _solve(parameters, columns[used] / scale[:, None], left[used] / scale)
        rest = np.where(used, left - columns @ found.values, np.nan)
        found = _widened(found, rest / noise)
        if unknown := [p for p, half in zip(parameters, found.half_95, strict=True) if not half <= p.wide]:
            raise NotToldError(hardware, unknown)
        noise = np.maximum(np.sqrt(np.nanmean(rest**2, axis=0)), 0.25 * steps)
        tuning = _tuning(hardware, plain, terms, found, bare)
        model = GravityModel(*tuning.tuned(*profiles), load=tuning.load, tilt_rad=tilt)
    profile = np.array([hardware.arm.gravity_factor * plain.torque(q) for q in samples.q])
    missed = rest + carries - profile + weights @ found.values[: weights.shape[2]]
    return Fit(tuning, samples, missed, rest)


def _parameters(hardware: ResolvedArm, terms: GravityTerms, payload: bool) -> list[Parameter]:
    """Return the parameters to fit: moments or payload first, then Coulomb and viscous friction of each joint."""
    n = hardware.joints
    carried = np.abs([terms.torque(q) for q in _poses(hardware)]).max(axis=0)
    wide = np.maximum(_WIDE_SHARE * carried, _WIDE_STEPS * torque_steps(hardware)) / _G_M_S2
    moments = [(term.joint, f"moment {'xyz'[int(np.abs(term.axis).argmax())]}") for term in terms.terms]
    mass: list[Parameter] = []
    if payload:
        mass = [Parameter(n - 1, f"payload's {PAYLOAD_TERMS[0]}", 0.0, PAYLOAD_MOST_KG, _WIDE_SHARE)]
        moments = [(n - 1, f"payload's {what}") for what in PAYLOAD_TERMS[1:]]
    return [
        *mass,
        *(Parameter(j, what, -_MOMENT_MOST_KG_M, _MOMENT_MOST_KG_M, wide[j]) for j, what in moments),
        *(Parameter(j, "Coulomb friction", 0.0, _COULOMB_MOST_NM, _WIDE_NM) for j in range(n)),
        *(Parameter(j, "viscous friction", 0.0, _VISCOUS_MOST_NM_S, _WIDE_NM_S) for j in range(n)),
    ]


def _weights(terms: GravityTerms, q: np.ndarray, payload: bool) -> np.ndarray:
    """Return the torques' derivatives (n, p) with respect to moments (Nm per kg m) or payload (mass: Nm/kg)."""
    return terms.payload(q) if payload else terms.moments(q)


def _mean_torque(hardware: ResolvedArm, samples: Samples) -> np.ndarray:
    """Return the mean torques over a tick (k, n), Nm.

    A motor rounds its torque down. It reports the torque at the end of a tick, when the joint has moved away from the
    commanded position.
    """
    rate, j = hardware.config.rate_hz, slice(hardware.joints)
    tau: np.ndarray = samples.tau + 0.5 * hardware.direction[j] * torque_steps(hardware)
    return tau + (0.5 / rate * hardware.kp[j] * samples.dq if rate else 0.0)


def _solve(parameters: Sequence[Parameter], rows: np.ndarray, measured: np.ndarray) -> Solution:
    """Solve rows (k, p) x = `measured` (k,) for x by least squares, within the parameters' bounds."""
    from scipy.optimize import lsq_linear  # a dependency of mujoco.sysid, see `require_engine`

    bounds = [p.low for p in parameters], [p.high for p in parameters]
    values = lsq_linear(rows, measured, bounds, method="bvls").x
    covariance, half = sysid.calculate_intervals([measured - rows @ values], rows)
    return Solution(values, half, covariance)


def _widened(found: Solution, rest: np.ndarray) -> Solution:
    """Widen the intervals: successive samples have correlated errors, so fewer rows are independent.

    `rest`: (k, n) residuals in units of the noise.
    """
    alike = float(np.clip(np.nansum(rest[1:] * rest[:-1]) / np.nansum(rest**2), 0.0, 0.95))
    repeats = (1.0 + alike) / (1.0 - alike)
    return found._replace(half_95=found.half_95 * np.sqrt(repeats), covariance=found.covariance * repeats)


def _poses(hardware: ResolvedArm) -> np.ndarray:
    low, high = hardware.arm.joint_limits_rad.T
    return np.random.default_rng(0).uniform(low, high, size=(_POSES, hardware.joints))


def _tuning(
    hardware: ResolvedArm, plain: GravityModel, terms: GravityTerms, found: Solution, bare: Tuning | None
) -> Tuning:
    n = hardware.joints
    values, half = (np.split(numbers, [-2 * n, -n]) for numbers in (found.values, found.half_95))
    factor, factor_95 = _factors(hardware, plain, terms, found, bare is not None)
    rubs: dict[str, Any] = {
        "gravity_factor": factor,
        "gravity_factor_95": factor_95,
        "coulomb_nm": values[1],
        "coulomb_nm_95": half[1],
        "viscous_nm_s": values[2],
        "viscous_nm_s_95": half[2],
    }
    if bare is not None:
        mass = max(float(values[0][0]), 1e-6)
        centre = values[0][1:] / mass
        width = np.hypot(half[0][1:], centre * half[0][0]) / mass  # as if errors of mass and moment were independent
        payload = Payload(mass_kg=mass, mass_kg_95=float(half[0][0]), com_m=centre, com_m_95=width)
        return dataclasses.replace(bare, payload=payload, **rubs)
    moments, moments_95 = np.zeros((n, 3)), np.zeros((n, 3))
    for term, value, width in zip(terms.terms, values[0], half[0], strict=True):
        moments[term.joint] += value * term.axis
        moments_95[term.joint] += width * np.abs(term.axis)
    arm, gripper = hardware.arm.name, hardware.gripper.name
    return Tuning(arm=arm, gripper=gripper, moment_kg_m=moments, moment_kg_m_95=moments_95, **rubs)


def _factors(
    hardware: ResolvedArm, plain: GravityModel, terms: GravityTerms, found: Solution, payload: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return gravity factors (n,) and half their 95 % intervals.

    A factor is Σ τ τ₀ / Σ τ₀² over the workspace; τ: fitted torque, τ₀: the profile's torque.
    """
    poses = _poses(hardware)
    profile = np.array([plain.torque(q) for q in poses])
    columns = np.array([_weights(terms, q, payload) for q in poses])
    weights = columns.shape[2]
    torque = np.array([terms.torque(q) for q in poses]) + columns @ found.values[:weights]
    share = profile / np.maximum((profile**2).sum(axis=0), 1e-12)
    gains = np.einsum("kj,kjp->jp", share, columns)
    spread = np.einsum("jp,pr,jr->j", gains, found.covariance[:weights, :weights], gains)
    carries = (profile**2).mean(axis=0) > _WEIGHS_NM**2
    factor = np.where(carries, (share * torque).sum(axis=0), 1.0)
    return factor, np.where(carries, _NORMAL_95 * np.sqrt(np.maximum(spread, 0.0)), 0.0)
