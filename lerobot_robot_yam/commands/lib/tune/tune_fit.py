"""From samples of slow sweeps to what an arm weighs and how it rubs. Pure: no files, no clock.

While joint j turns,

    τ_j = g_j(q) + Y_j(q) x + a_j sign(dq_j) + b_j dq_j + (C dq + M ddq)_j

with the profile's weight g, its derivatives Y by the moments x (`gravity_terms`) or by the payload, Coulomb friction a
and viscous friction b. Ways are gone there and back, so friction cannot pass for weight. C and M are the model's, and
are computed anew with what was found.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lerobot_robot_yam.arm.config_checks import PAYLOAD_MOST_KG
from lerobot_robot_yam.arm.dynamics import GravityModel
from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.arm.tuning.gravity_terms import PAYLOAD_TERMS, GravityTerms
from lerobot_robot_yam.arm.tuning.tuning import Payload, Tuning
from lerobot_robot_yam.commands.lib.tune.least_squares import Solution, solve
from lerobot_robot_yam.commands.lib.tune.tune_motion import Samples
from lerobot_robot_yam.damiao.codec import torque_step_nm
from lerobot_robot_yam.errors import ConfigError

LEAST_RAD_S = 0.03  # a joint that is slower may stick
_PASSES = 3
_MOMENT_MOST_KG_M = 2.0  # 3 kg at 0.6 m
_COULOMB_MOST_NM, _VISCOUS_MOST_NM_S = 5.0, 5.0
# Half an interval beyond which a parameter is not known:
_WIDE_NM = 0.1  # Coulomb friction
_WIDE_NM_S = 0.3  # viscous friction
_WIDE_SHARE, _WIDE_STEPS = 0.05, 6  # moments: of the most that the joint carries, and steps of its torque
_G_M_S2 = 9.81
_POSES = 300
_WEIGHS_NM = 0.1  # rms over the workspace: a joint that carries less has no factor
_NORMAL_95 = 1.96


class Name(NamedTuple):
    """A parameter: of which joint (from 0), and what."""

    joint: int
    what: str


class NotToldError(ConfigError):
    """Samples do not tell some parameters of an arm.

    Attributes:
        joints: (from 0) whose.
    """

    def __init__(self, hardware: ResolvedArm, names: Sequence[Name]):
        self.joints = sorted({name.joint for name in names})
        told = [
            f"{hardware.joint_names[j]} ({', '.join(name.what for name in names if name.joint == j)})"
            for j in self.joints
        ]
        super().__init__(f"{hardware.name}: the data do not tell {', '.join(told)}")


class Fit(NamedTuple):
    """What the samples say. p parameters, k samples, n joints.

    Attributes:
        names: (p,) weights first, then friction.
        solution: their values.
        tuning: the arm with them.
        samples: which.
        missed_nm: (k, n) what the profile misses of the weight; rest_nm: (k, n) what the tuning does. NaN where a joint
            does not turn.
    """

    names: list[Name]
    solution: Solution
    tuning: Tuning
    samples: Samples
    missed_nm: np.ndarray
    rest_nm: np.ndarray


def torque_steps(hardware: ResolvedArm) -> np.ndarray:
    """(n,) Nm, the steps in which the joints' motors tell their torque."""
    return np.array([torque_step_nm(motor.type) for motor in hardware.motors[: hardware.joints]])


def fit(hardware: ResolvedArm, samples: Samples, bare: Tuning | None = None) -> Fit:
    """Fit friction, and moments or a payload.

    Args:
        hardware: the arm, without a tuning.
        samples: of ways there and back.
        bare: tuning of the same arm without a payload: then a payload is fitted on top of it.

    Raises:
        NotToldError: the samples leave parameters unknown.
    """
    n, tilt = hardware.joints, hardware.tilt_rad
    profiles = hardware.arm, hardware.gripper
    terms = GravityTerms(*(profiles if bare is None else bare.tuned(*profiles)), load=hardware.load, tilt_rad=tilt)
    names = [Name(term.joint, f"moment {'xyz'[int(np.abs(term.axis).argmax())]}") for term in terms.terms]
    if bare is not None:
        names = [Name(n - 1, f"payload's {what}") for what in PAYLOAD_TERMS]
    weights = len(names)
    names += [Name(j, what) for what in ("Coulomb friction", "viscous friction") for j in range(n)]
    used = np.abs(samples.dq) > LEAST_RAD_S
    if not used.any():
        raise NotToldError(hardware, names)
    columns = _columns(terms, samples, bare is not None)
    tau = _mean_torque(hardware, samples)
    carries = np.array([terms.torque(q) for q in samples.q])
    armature = hardware.arm.armature_kg_m2
    model: GravityModel = terms
    noise = torque_steps(hardware)
    for _ in range(_PASSES):
        moving = [np.add(*model.torques(*row)[1:]) for row in zip(samples.q, samples.dq, samples.ddq, strict=True)]
        left = tau - carries - moving - armature * samples.ddq
        scale = np.broadcast_to(noise, used.shape)[used]
        found = solve(
            [str(name) for name in names],
            _bounds(names),
            columns[used] / scale[:, None],
            left[used] / scale,
        )
        rest = np.where(used, left - columns @ found.values, np.nan)
        found = _widened(found, rest / noise)
        if unknown := _unknown(hardware, terms, names, found):
            raise NotToldError(hardware, unknown)
        noise = np.maximum(np.sqrt(np.nanmean(rest**2, axis=0)), 0.25 * torque_steps(hardware))
        tuning = _tuning(hardware, terms, names, found, bare)
        model = GravityModel(*tuning.tuned(*profiles), load=tuning.load, tilt_rad=tilt)
    factor = hardware.arm.gravity_factor
    plain = GravityTerms(*profiles, load=hardware.load, tilt_rad=tilt)
    missed = rest + [terms.torque(q) - factor * plain.torque(q) for q in samples.q]
    missed += columns[..., :weights] @ found.values[:weights]
    return Fit(names, found, tuning, samples, missed, rest)


def _columns(terms: GravityTerms, samples: Samples, payload: bool) -> np.ndarray:
    """(k, n, p) derivatives of the torques by the parameters."""
    weights = np.array([terms.payload(q) if payload else terms.moments(q) for q in samples.q])
    each = np.eye(samples.q.shape[1])
    coulomb, viscous = np.sign(samples.dq)[..., None] * each, samples.dq[..., None] * each
    return np.concatenate([weights, coulomb, viscous], axis=2)


def _mean_torque(hardware: ResolvedArm, samples: Samples) -> np.ndarray:
    """(k, n) torques over a tick. A motor rounds its torque down, and tells it at the end of a tick, when the joint has
    moved on from what it was told."""
    rate, j = hardware.config.rate_hz, slice(hardware.joints)
    tau: np.ndarray = samples.tau + 0.5 * hardware.direction[j] * torque_steps(hardware)
    return tau + (0.5 / rate * hardware.kp[j] * samples.dq if rate else 0.0)


def _bounds(names: Sequence[Name]) -> np.ndarray:
    most = {
        "payload's mass": (0.0, PAYLOAD_MOST_KG),
        "Coulomb friction": (0.0, _COULOMB_MOST_NM),
        "viscous friction": (0.0, _VISCOUS_MOST_NM_S),
    }
    return np.array([most.get(name.what, (-_MOMENT_MOST_KG_M, _MOMENT_MOST_KG_M)) for name in names])


def _widened(found: Solution, rest: np.ndarray) -> Solution:
    """With intervals for as many independent rows as there are: neighbours in time have much of their error in common.

    rest: (k, n) in units of the noise.
    """
    alike = float(np.clip(np.nansum(rest[1:] * rest[:-1]) / np.nansum(rest**2), 0.0, 0.95))
    repeats = (1.0 + alike) / (1.0 - alike)
    return found._replace(half_95=found.half_95 * np.sqrt(repeats), covariance=found.covariance * repeats)


def _unknown(hardware: ResolvedArm, terms: GravityTerms, names: Sequence[Name], found: Solution) -> list[Name]:
    most = np.abs([terms.torque(q) for q in _poses(hardware)]).max(axis=0)
    wide_nm = np.maximum(_WIDE_SHARE * most, _WIDE_STEPS * torque_steps(hardware))
    limits = {"Coulomb friction": _WIDE_NM, "viscous friction": _WIDE_NM_S, "payload's mass": _WIDE_SHARE}
    return [
        name
        for name, half in zip(names, found.half_95, strict=True)
        if not half <= limits.get(name.what, wide_nm[name.joint] / _G_M_S2)
    ]


def _poses(hardware: ResolvedArm) -> np.ndarray:
    low, high = hardware.arm.joint_limits_rad.T
    return np.random.default_rng(0).uniform(low, high, size=(_POSES, hardware.joints))


def _tuning(
    hardware: ResolvedArm, terms: GravityTerms, names: Sequence[Name], found: Solution, bare: Tuning | None
) -> Tuning:
    n, values, half = hardware.joints, found.values, found.half_95
    of = [np.array([name.what == what for name in names]) for what in ("Coulomb friction", "viscous friction")]
    rubs = {
        "coulomb_nm": values[of[0]],
        "coulomb_nm_95": half[of[0]],
        "viscous_nm_s": values[of[1]],
        "viscous_nm_s_95": half[of[1]],
    }
    weights = len(names) - 2 * n
    factor, factor_95 = _factors(hardware, terms, found, weights, bare is not None)
    rubs |= {"gravity_factor": factor, "gravity_factor_95": factor_95}
    if bare is not None:
        return dataclasses.replace(bare, payload=_payload(values[:weights], half[:weights]), **rubs)
    moments, moments_95 = np.zeros((n, 3)), np.zeros((n, 3))
    for term, value, width in zip(terms.terms, values[:weights], half[:weights], strict=True):
        moments[term.joint] += value * term.axis
        moments_95[term.joint] += width * np.abs(term.axis)
    return Tuning(
        arm=hardware.arm.name,
        gripper=hardware.gripper.name,
        moment_kg_m=moments,
        moment_kg_m_95=moments_95,
        **rubs,
    )


def _payload(values: np.ndarray, half: np.ndarray) -> Payload:
    """Mass and centre = moment / mass; the centre's interval as if mass and moment erred independently."""
    mass, moment = max(float(values[0]), 1e-6), values[1:]
    centre = moment / mass
    return Payload(
        mass_kg=mass,
        mass_kg_95=float(half[0]),
        com_m=centre,
        com_m_95=np.hypot(half[1:], centre * half[0]) / mass,
    )


def _factors(
    hardware: ResolvedArm, terms: GravityTerms, found: Solution, weights: int, payload: bool
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) Σ τ τ₀ / Σ τ₀² over the workspace, with the profile's τ₀, and half their 95 % intervals."""
    plain = GravityModel(hardware.arm, hardware.gripper, load=hardware.load, tilt_rad=hardware.tilt_rad)
    poses = _poses(hardware)
    profile = np.array([plain.torque(q) for q in poses])
    base = np.array([terms.torque(q) for q in poses])
    columns = np.array([terms.payload(q) if payload else terms.moments(q) for q in poses])
    square = (profile**2).sum(axis=0)
    gains = np.einsum("kj,kjp->jp", profile, columns) / np.maximum(square, 1e-12)[:, None]
    factor = (profile * base).sum(axis=0) / np.maximum(square, 1e-12) + gains @ found.values[:weights]
    spread = np.einsum("jp,pr,jr->j", gains, found.covariance[:weights, :weights], gains)
    carries = square > _POSES * _WEIGHS_NM**2
    return np.where(carries, factor, 1.0), np.where(carries, _NORMAL_95 * np.sqrt(np.maximum(spread, 0.0)), 0.0)
