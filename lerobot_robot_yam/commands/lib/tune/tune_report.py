"""The table of a tuning."""

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.commands.lib.arm_command import table
from lerobot_robot_yam.commands.lib.tune.tune_fit import Fit
from lerobot_robot_yam.commands.lib.tune.tune_motion import Holds

_HEAD = (
    "joint",
    "weight / profile's",
    "missed Nm",
    "left Nm",
    "Coulomb Nm",
    "viscous Nm s/rad",
    "hold mrad: before",
    "after",
    "friction may hold",
)


def report(hardware: ResolvedArm, found: Fit, before: Holds, after: Holds) -> str:
    """What was found, with 95 % intervals, and how the arm held before and after, without the hold integral.

    missed, left: rms of the weight that the profile and the tuning do not tell.
    """
    tuned, rows = found.tuning, []
    may_rub = friction_rad(hardware, found)
    for j, name in enumerate(hardware.joint_names):
        factor = _with(tuned.gravity_factor[j], tuned.gravity_factor_95[j], 3) if tuned.gravity_factor_95[j] else "–"
        rows.append(
            [
                name,
                factor,
                f"{rms(found.missed_nm)[j]:.3f}",
                f"{rms(found.rest_nm)[j]:.3f}",
                _with(tuned.coulomb_nm[j], tuned.coulomb_nm_95[j], 3),
                _with(tuned.viscous_nm_s[j], tuned.viscous_nm_s_95[j], 3),
                *(f"{1e3 * value:.1f}" for value in (worst(before)[j], worst(after)[j], may_rub[j])),
            ]
        )
    lines = [table(_HEAD, rows)]
    load = tuned.payload
    if load.mass_kg:
        centre = ", ".join(_with(1e3 * x, 1e3 * w, 1) for x, w in zip(load.com_m, load.com_m_95, strict=True))
        lines.append(f"payload: {_with(load.mass_kg, load.mass_kg_95, 3)} kg, centre [{centre}] mm from the tcp")
    return "\n".join(lines)


def worst(holds: Holds) -> np.ndarray:
    """(n,) rad, the largest distance from the set-point."""
    largest: np.ndarray = np.abs(holds.error_rad).max(axis=0)
    return largest


def friction_rad(hardware: ResolvedArm, found: Fit) -> np.ndarray:
    """(n,) rad by which Coulomb friction can hold a joint off its set-point."""
    off: np.ndarray = found.tuning.coulomb_nm / np.maximum(hardware.kp[: hardware.joints], 1e-9)
    return off


def rms(values: np.ndarray) -> np.ndarray:
    """(n,) of (k, n) with NaN."""
    root: np.ndarray = np.sqrt(np.nanmean(values**2, axis=0))
    return root


def _with(value: float, half: float, places: int) -> str:
    return f"{value:.{places}f} ± {half:.{places}f}"
