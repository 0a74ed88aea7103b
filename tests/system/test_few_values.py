"""Reductions of few values: numpy's results, but NaNs are skipped wherever they stand."""

import numpy as np
import pytest

from lerobot_robot_yam.system.few_values import all_of, any_of, largest

NAN = float("nan")


@pytest.mark.parametrize(
    ("values", "expected"), [([NAN, 3, 1], 3), ([1, NAN, -5], 5), ([3, NAN], 3), ([NAN], 0), ([], 0)]
)
def test_nan_hides_no_larger_value(values, expected):
    assert largest(np.array(values, dtype=float)) == expected


def test_masks():
    assert (
        any_of(np.array([False, True])) and not any_of(np.zeros(2, dtype=bool)) and not any_of(np.zeros(0, dtype=bool))
    )
    assert all_of(np.ones(2, dtype=bool)) and not all_of(np.array([False, True])) and all_of(np.zeros(0, dtype=bool))
