"""Checks of set-points that jumped onto the arm: was the arm really there, and did a joint really come free?

A state record cannot prove either, because its description of the arm may be what was wrong.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

AROUND_S = 0.06  # maximum time from a recorded sample to the set-point based on that sample, s: some late ticks
_AFTER_S = 0.012  # a record's stamp may precede the tick that moved its set-point by this much
_SLOWER = 0.97  # factor on the come-free speed: the joint already brakes while coming free is detected


@dataclass(frozen=True)
class Seed:
    """A set-point jump that a record justifies.

    Attributes:
        at_s: stamp of the record.
        why: justification in the record.
        free: whether the record says that a joint came free.
        joints: (n,) bool, joints that jumped.
        setpoint: (n,) set-points after the jump, rad.
        within_rad: (n,) allowed distance between set-point and arm.
        age_s: (n,) age of the recorded samples, s.
        gap_s: time since the previous record that the judge has seen, s.
    """

    at_s: float
    why: str
    free: bool
    joints: np.ndarray
    setpoint: np.ndarray
    within_rad: np.ndarray
    age_s: np.ndarray
    gap_s: float

    @property
    def since_s(self) -> float:
        """Time from which the truth is needed."""
        oldest_s = float(np.nan_to_num(self.age_s[self.joints]).max(initial=0.0))
        return self.at_s - self.gap_s - oldest_s - AROUND_S


def judge_seed(seed: Seed, truth: Mapping[str, np.ndarray], free_speed: np.ndarray) -> str:
    """Return a description of what is wrong with a seed, empty if nothing is wrong.

    Args:
        seed: the jump and its justification.
        truth: result of `recorders.truth` around the seed; times that it does not cover are not judged.
        free_speed: (n,) rad/s, minimum speed of a joint that came free.
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
