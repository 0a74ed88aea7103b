"""Figures that commands draw with matplotlib and save to the file of their option `--plot`."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.own_commands import install_extra


def require_plot() -> Any:
    """Return matplotlib's pyplot, set up to draw to files. Raises ConfigError: matplotlib is missing."""
    try:
        import matplotlib
    except ImportError as error:
        raise ConfigError(f"--plot needs matplotlib; {install_extra('bench')}") from error
    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


@contextmanager
def plot_file(path: Path, size: tuple[float, float], dpi: int) -> Iterator[Any]:
    """Yield a figure of `size`, inches; save the figure after the block, in the format of `path`'s suffix.

    Raises:
        ConfigError: matplotlib is missing, or the file cannot be written.
    """
    pyplot = require_plot()
    figure = pyplot.figure(figsize=size, layout="constrained")
    try:
        yield figure
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            figure.savefig(path, dpi=dpi)
        except (OSError, ValueError) as error:
            raise ConfigError(f"{path} cannot be written: {error}") from error
    finally:
        pyplot.close(figure)
