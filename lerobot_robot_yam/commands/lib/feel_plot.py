"""The picture of a feel report."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_robot_yam.commands.lib.feel_figures import Effort, Motion
from lerobot_robot_yam.errors import ConfigError


def plot(path: Path, motion: Motion, effort: Effort | None, periods_s: Mapping[str, np.ndarray]) -> None:
    """Save it, as the ending of `path` says: both arms and their difference, feedback, periods.

    Raises:
        ConfigError: matplotlib is missing, or the file cannot be written.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise ConfigError('--plot needs matplotlib: pip install -e ".[bench]"') from error
    matplotlib.use("Agg")
    from matplotlib import pyplot

    n = len(motion.names)
    rows = 2 + (effort is not None) + bool(periods_s)
    figure = pyplot.figure(figsize=(3.2 * n, 3.2 * rows), layout="constrained")
    grid = figure.add_gridspec(rows, n)
    for joint, name in enumerate(motion.names):
        axes: Any = figure.add_subplot(grid[0, joint])
        axes.plot(motion.times_s, motion.leader[:, joint], linewidth=1.0, label="leader")
        axes.plot(motion.times_s, motion.follower[:, joint], linewidth=1.0, label="follower")
        axes.set(title=name, xlabel="s", ylabel="rad" if joint == 0 else "")
        if joint == 0:
            axes.legend(fontsize=8)
        axes = figure.add_subplot(grid[1, joint])
        axes.plot(motion.times_s, (motion.follower - motion.leader)[:, joint] * 1e3, linewidth=0.7)
        axes.set(xlabel="s", ylabel="follower - leader, mrad" if joint == 0 else "")
        if effort is not None:
            axes = figure.add_subplot(grid[2, joint])
            axes.plot(effort.dq[:, joint], effort.feedback_nm[:, joint], ".", markersize=1.5)
            axes.set(xlabel="leader, rad/s", ylabel="feedback, Nm" if joint == 0 else "")
    if periods_s:
        axes = figure.add_subplot(grid[-1, :])
        for name, periods in periods_s.items():
            axes.hist(periods * 1e3, bins=100, histtype="step", log=True, label=name)
        axes.set(xlabel="period of the control loop, ms", ylabel="ticks")
        axes.legend(fontsize=8)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=100)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path} cannot be written: {error}") from error
    finally:
        pyplot.close(figure)
