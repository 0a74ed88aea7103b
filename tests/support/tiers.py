"""Which cases of a test are in the default tier: a spread; the others run with `-m long`."""

from collections.abc import Iterable
from typing import Any

import pytest


def spread(cases: Iterable[Any], *short: int) -> list[Any]:
    """The cases of a `parametrize`; only those of the places `short`, counted from 0, are in the default tier."""
    rows = [case if isinstance(case, tuple) else (case,) for case in cases]
    return [pytest.param(*row, marks=() if place in short else pytest.mark.long) for place, row in enumerate(rows)]
