"""Table and figure of a tuning."""

from pathlib import Path

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.commands.lib.dialogue import table
from lerobot_robot_yam.commands.lib.plot_file import plot_file
from lerobot_robot_yam.commands.lib.tune.tune_fit import Fit

_HEAD = [
    *("joint", "weight / profile's", "missed Nm", "left Nm", "Coulomb Nm", "viscous Nm s/rad"),
    *("hold mrad: before", "after", "friction may hold"),
]


def report(hardware: ResolvedArm, found: Fit, before: np.ndarray, after: np.ndarray) -> str:
    """Return a table of the fit with 95 % intervals, and of hold errors before and after, without hold integral.

    Columns `missed` and `left`: rms error of the gravity torque with the profile and with the tuning.
    """
    tuned, rows = found.tuning, []
    holds = [1e3 * rad for rad in (_worst(before), _worst(after), _friction_rad(hardware, found))]
    for j, name in enumerate(hardware.joint_names):
        factor = _with(tuned.gravity_factor[j], tuned.gravity_factor_95[j], 3) if tuned.gravity_factor_95[j] else "–"
        missed, left = (f"{np.sqrt(np.nanmean(torque[:, j] ** 2)):.3f}" for torque in (found.missed_nm, found.rest_nm))
        rubs = _with(tuned.coulomb_nm[j], tuned.coulomb_nm_95[j], 3)
        drags = _with(tuned.viscous_nm_s[j], tuned.viscous_nm_s_95[j], 3)
        rows.append([name, factor, missed, left, rubs, drags, *(f"{mrad[j]:.1f}" for mrad in holds)])
    lines = [table(_HEAD, rows)]
    load = tuned.payload
    if load.mass_kg:
        centre = ", ".join(_with(1e3 * x, 1e3 * w, 1) for x, w in zip(load.com_m, load.com_m_95, strict=True))
        lines.append(f"payload: {_with(load.mass_kg, load.mass_kg_95, 3)} kg, centre [{centre}] mm from the tcp")
    return "\n".join(lines)


def save_plot(path: Path, hardware: ResolvedArm, found: Fit, before: np.ndarray, after: np.ndarray) -> None:
    """Save a figure: gravity torque errors before and after, friction over speed, and hold errors.

    Raises:
        ConfigError: matplotlib is missing, or the file cannot be written.
    """
    n, tuned = hardware.joints, found.tuning
    with plot_file(path, (2.6 * n, 7.0), dpi=80) as figure:
        grid = figure.add_gridspec(3, n)
        for joint, name in enumerate(hardware.joint_names):
            axes = figure.add_subplot(grid[0, joint])
            for values, label in ((found.missed_nm, "profile"), (found.rest_nm, "tuned")):
                axes.plot(found.samples.q[:, joint], values[:, joint], ".", markersize=2, label=label)
            axes.set(title=name, xlabel="q, rad", ylabel="missed weight, Nm" if joint == 0 else "")
            axes = figure.add_subplot(grid[1, joint])
            speed = found.samples.dq[:, joint]
            rubs = tuned.coulomb_nm[joint] * np.sign(speed) + tuned.viscous_nm_s[joint] * speed
            order = np.argsort(speed)
            axes.plot(speed, rubs + found.rest_nm[:, joint], ".", markersize=2, color="tab:grey")
            axes.plot(speed[order], rubs[order], color="tab:red", linewidth=1.0)
            axes.set(xlabel="dq, rad/s", ylabel="friction, Nm" if joint == 0 else "")
        figure.axes[0].legend(fontsize=8)
        axes = figure.add_subplot(grid[2, :])
        rubs = _friction_rad(hardware, found)
        bars = [(_worst(before), "profile"), (_worst(after), "tuned"), (rubs, "friction may hold")]
        for place, (values, label) in enumerate(bars):
            axes.bar(np.arange(n) + 0.25 * (place - 1), 1e3 * values, 0.22, label=label)
        axes.set_xticks(range(n), hardware.joint_names)
        axes.set(ylabel="largest hold error, mrad")
        axes.legend(fontsize=8)


def _worst(errors_rad: np.ndarray) -> np.ndarray:
    """Return the largest deviations (n,) from the set-point, rad."""
    largest: np.ndarray = np.abs(errors_rad).max(axis=0)
    return largest


def _friction_rad(hardware: ResolvedArm, found: Fit) -> np.ndarray:
    """Return the deviations (n,) from the set-point at which Coulomb friction can hold a joint, rad."""
    off: np.ndarray = found.tuning.coulomb_nm / np.maximum(hardware.kp[: hardware.joints], 1e-9)
    return off


def _with(value: float, half: float, places: int) -> str:
    return f"{value:.{places}f} ± {half:.{places}f}"
