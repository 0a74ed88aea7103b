"""The picture of a tuning."""

from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.arm.resolved_arm import ResolvedArm
from lerobot_robot_yam.commands.lib.tune.tune_fit import Fit
from lerobot_robot_yam.commands.lib.tune.tune_motion import Holds
from lerobot_robot_yam.commands.lib.tune.tune_report import friction_rad, worst
from lerobot_robot_yam.errors import ConfigError


def require_plot() -> Any:
    """matplotlib's pyplot, drawing into files. Raises ConfigError: it is missing."""
    try:
        import matplotlib
    except ImportError as error:
        raise ConfigError('--plot needs matplotlib: pip install -e ".[bench]"') from error
    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def save_plot(path: Path, hardware: ResolvedArm, found: Fit, before: Holds, after: Holds) -> None:
    """Save it: what the weight misses before and after, friction over speed, and hold errors.

    Raises:
        ConfigError: matplotlib is missing, or the file cannot be written.
    """
    pyplot = require_plot()
    n, tuned = hardware.joints, found.tuning
    figure = pyplot.figure(figsize=(2.6 * n, 7.0), layout="constrained")
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
    bars = [(worst(before), "profile"), (worst(after), "tuned"), (friction_rad(hardware, found), "friction may hold")]
    for place, (values, label) in enumerate(bars):
        axes.bar(np.arange(n) + 0.25 * (place - 1), 1e3 * values, 0.22, label=label)
    axes.set_xticks(range(n), hardware.joint_names)
    axes.set(ylabel="largest hold error, mrad")
    axes.legend(fontsize=8)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=80)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path} cannot be written: {error}") from error
    finally:
        pyplot.close(figure)
