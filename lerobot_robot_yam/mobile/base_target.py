"""Target of the base, as callers give it: a twist in one of two frames, or a pose."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np


class Frame(IntEnum):
    """Frame of a target."""

    LOCAL = 0  # the body's
    GLOBAL = 1  # the odometry's


@dataclass(frozen=True)
class Target:
    """Target of the base.

    Attributes:
        values: (3,) twist in m/s, m/s, rad/s, or pose in m, m, rad.
        frame: frame of a twist; poses are in the global frame.
        pose: whether `values` is a pose.
    """

    values: np.ndarray
    frame: Frame = Frame.LOCAL
    pose: bool = False


REST = Target(np.zeros(3))
