"""Questions about arrays of the few joints of an arm, at loop rate: numpy's own reductions take 2 µs, a list 0.5."""

import numpy as np


def any_of(mask: np.ndarray) -> bool:
    """Whether any of (n,) bool is set."""
    return True in mask.tolist()


def all_of(mask: np.ndarray) -> bool:
    """Whether all of (n,) bool are set."""
    return False not in mask.tolist()


def largest(values: np.ndarray) -> float:
    """The largest |value| of (n,); 0 of none. NaN is not seen."""
    return max(map(abs, values.tolist()), default=0.0)
