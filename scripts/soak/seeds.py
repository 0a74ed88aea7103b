"""Set-points that have jumped onto the arm: whether the arm was truly there, and truly came free where that is said.

A state record cannot tell: what it says of the arm may be what was wrong.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

AROUND_S = 0.06  # from the sample that a record tells to the set-point that rests on it, at most: some late ticks
_AFTER_S = 0.012  # a record's stamp may be before the tick that moved its set-point
_SLOWER = 0.97  # of the speed above which a joint is taken to have come free: it brakes while that is noticed


@dataclass(frozen=True)
class Seed:
    """A jump that a record explains.

    Attributes:
        at_s: stamp of the record.
        why: what the record says.
        free: it says that a joint came free.
        joints: (n,) bool, those that jumped.
        setpoint: (n,) rad, where to.
        within_rad: (n,) how far from the arm that may be.
        age_s: (n,) of the samples that the record tells, s.
    """

    at_s: float
    why: str
    free: bool
    joints: np.ndarray
    setpoint: np.ndarray
    within_rad: np.ndarray
    age_s: np.ndarray

    @property
    def since_s(self) -> float:
        """From when on the truth is asked for."""
        return self.at_s - float(np.nan_to_num(self.age_s[self.joints]).max(initial=0.0)) - AROUND_S


def judge_seed(seed: Seed, truth: Mapping[str, np.ndarray], free_speed: np.ndarray) -> str:
    """What is wrong with a seed, empty if nothing is.

    Args:
        seed: what the record says.
        truth: of `RigControl.truth`, around it; nothing is judged that it does not cover.
        free_speed: (n,) rad/s, above which a joint may be said to have come free.
    """
    stamps = truth["stamp_s"]
    during = (stamps > seed.since_s) & (stamps < seed.at_s + _AFTER_S)
    if not during.any():
        return ""
    for joint in np.flatnonzero(seed.joints):
        q, dq = truth["q"][during, joint], truth["dq"][during, joint]
        beside = float(np.abs(q - seed.setpoint[joint]).min())
        if beside > seed.within_rad[joint]:
            goal = f"{seed.setpoint[joint]:.3f} rad, {beside:.3f} from where it is"
            return f"{seed.why}: joint_{joint + 1} is sent to {goal}"
        fastest = float(np.abs(dq).max())
        if seed.free and fastest < _SLOWER * free_speed[joint]:
            return f"joint_{joint + 1} is said to have come free, and moved at {fastest:.2f} rad/s at most"
    return ""
