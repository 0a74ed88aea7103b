"""How often a property is tried: a short spread always, many cases with `-m long`; and values that break things.

    @for_all(number=numbers())
    def test_x(number): ...

is two tests, `test_x[short]` and `test_x[long]`. Fixtures are ordinary parameters and shared by all cases. The short
tier tries the same cases every time; the long one tries new ones and prints how to repeat a failure.
"""

import copy
import functools
import inspect
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

SHORT, LONG = 100, 10_000  # cases in the default tier, always the same ones, and in the long tier
SPECIAL = [math.nan, math.inf, -math.inf, 0, 0.0, -1, -1.0, 5e-324, 1e308, -1e308, 2**64, 10**400]

_COMMON: dict[str, Any] = {
    "deadline": None,  # noisy machines
    "database": None,  # nothing is written into the tree
    "suppress_health_check": list(HealthCheck),
    "print_blob": True,
}
TIERS = {
    "short": settings(max_examples=SHORT, derandomize=True, **_COMMON),
    "long": settings(max_examples=LONG, **_COMMON),
}


def for_all(
    *, short: int = SHORT, **strategies: st.SearchStrategy
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A test of a property over `strategies` by parameter name, in both tiers; costly ones try fewer in the `short`."""

    def decorate(check: Callable[..., None]) -> Callable[..., None]:
        fixtures = [name for name in inspect.signature(check).parameters if name not in strategies]

        @pytest.mark.parametrize(
            "tier", ["short", pytest.param("long", marks=[pytest.mark.long, pytest.mark.timeout(3600)])]
        )
        @functools.wraps(check)
        def test(tier: str, **values: Any) -> None:
            tried = 0
            tier_settings = settings(TIERS[tier], max_examples=short) if tier == "short" else TIERS[tier]

            def case(**drawn: Any) -> None:
                nonlocal tried
                tried += 1
                check(**values, **drawn)

            tier_settings(given(**strategies)(case))()
            assert tried >= tier_settings.max_examples, f"only {tried} cases; widen the strategies"

        parameters = [inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY) for name in ["tier", *fixtures]]
        test.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        return test

    return decorate


def finite(limit: float = 1e308) -> st.SearchStrategy[float]:
    """Finite floats, denormals and both zeros among them."""
    return st.floats(-limit, limit)


def numbers() -> st.SearchStrategy[Any]:
    """Whatever Python and numpy call a number, not finite and not storable ones too."""
    return st.one_of(
        st.sampled_from(SPECIAL),
        st.sampled_from(SPECIAL),
        st.floats(),
        st.integers(-3, 3),
        st.integers(),
        st.floats(width=32).map(np.float32),
        st.floats(width=16).map(np.float16),
        st.integers(-128, 127).map(np.int8),
        st.integers(0, 2**64 - 1).map(np.uint64),
    )


def junk() -> st.SearchStrategy[Any]:
    """What is no number, or not one alone."""
    return st.one_of(
        st.none(),
        st.booleans(),
        st.text(max_size=5),
        st.sampled_from(["1.0", "nan", "inf", "1e3", "0x10", b"1", 1j, np.complex128(1), np.str_("2"), object(), ...]),
        st.binary(max_size=4),
        st.lists(st.floats(), max_size=3),
        st.dictionaries(st.text(max_size=2), st.integers(), max_size=2),
    )


@functools.cache
def workspaces() -> st.SearchStrategy[Any]:
    """A workspace as a YAML file says it, with anything in place of some of its numbers."""
    point = st.lists(st.floats(-1, 1), min_size=3, max_size=3) | st.lists(st.floats(), max_size=4) | documents()
    number = st.floats(0, 0.2) | documents()
    box = st.fixed_dictionaries(
        {}, optional={"name": st.text(max_size=3) | documents(), "center_m": point, "size_m": point, "yaw_rad": number}
    )
    return st.fixed_dictionaries(
        {},
        optional={
            "base_position_m": point,
            "base_yaw_rad": number,
            "floor_z_m": number,
            "keep_out": st.lists(box, max_size=2) | documents(),
            "collision_margin_m": number,
            "celing": number,
        },
    )


@functools.cache
def documents() -> st.SearchStrategy[Any]:
    """What a YAML or JSON file may hold: scalars, lists and mappings, nested."""
    scalars = st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=6), st.dates(), st.just(10**400)
    )
    keys = st.one_of(st.text(max_size=4), st.integers(-2, 2), st.booleans(), st.none())
    return st.recursive(
        scalars, lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(keys, inner, max_size=4))
    )


@functools.cache
def replacements() -> st.SearchStrategy[Any]:
    """What may stand in a file in place of something else."""
    return st.one_of(st.sampled_from(SPECIAL), numbers(), st.floats(-10, 10), st.integers(-2, 9), documents())


@st.composite
def mutations(draw: st.DrawFn, document: Any) -> Any:
    """The document with one to three places changed: dropped, doubled, renamed, swapped, or another value."""
    document = copy.deepcopy(document)
    for _ in range(draw(st.sampled_from([1, 1, 1, 2, 3]))):
        parent: Any = None
        key: Any = None
        place = document
        while isinstance(place, dict | list) and place and (parent is None or draw(st.integers(0, 3))):
            parent = place
            key = draw(st.sampled_from(sorted(place, key=str) if isinstance(place, dict) else range(len(place))))
            place = place[key]
        if parent is None:
            continue
        action = draw(st.sampled_from(["value", "value", "value", "drop", "double", "rename"]))
        if action == "value":
            parent[key] = draw(replacements())
        elif action == "drop":
            del parent[key]
        elif action == "double" and isinstance(parent, list):
            parent.append(copy.deepcopy(place))
        elif isinstance(parent, dict):
            parent[draw(st.text(max_size=4) | st.integers() | st.none())] = parent.pop(key)
    return document
