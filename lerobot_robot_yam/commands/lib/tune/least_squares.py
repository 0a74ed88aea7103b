"""Least squares with bounds and confidence intervals, by `mujoco.sysid`."""

import io
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from mujoco import sysid

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.system.own_commands import install_extra

_OFF = 0.01  # of the range: how far from a bound the engine likes to begin


class Solution(NamedTuple):
    """Of p parameters and k rows.

    Attributes:
        values: (p,).
        half_95: (p,) half the width of each 95 % confidence interval; infinite where the rows do not tell.
        covariance: (p, p), where all are finite.
        rest: (k,) measured minus modelled.
    """

    values: np.ndarray
    half_95: np.ndarray
    covariance: np.ndarray
    rest: np.ndarray


def require_engine() -> None:
    """Raises ConfigError: `mujoco.sysid` lacks what it needs (it leaves out then what it cannot import)."""
    if not hasattr(sysid, "calculate_intervals"):
        raise ConfigError(f"yam-tune needs mujoco.sysid; {install_extra('sysid')}")


def solve(names: Sequence[str], bounds: np.ndarray, rows: np.ndarray, measured: np.ndarray) -> Solution:
    """The x within `bounds` (p, 2) that makes rows (k, p) x nearest to `measured` (k,); p different `names`."""
    low, high = bounds.T
    start = np.clip(0.0, low + _OFF * (high - low), high - _OFF * (high - low))
    first = {
        name: sysid.Parameter(name, value, low, high)
        for name, value, (low, high) in zip(names, start, bounds, strict=True)
    }

    def residual(x: np.ndarray, _: object) -> tuple[list[np.ndarray], None, None]:
        return [rows @ x - measured[:, None]], None, None  # the engine asks for several x (p, m) at once

    _, found = sysid.optimize(sysid.ParameterDict(first), residual, verbose=False, output=io.StringIO())
    values = np.asarray(found.x, dtype=float).ravel()
    rest = measured - rows @ values
    covariance, half = sysid.calculate_intervals([rest], rows)
    return Solution(values, half, covariance, rest)
