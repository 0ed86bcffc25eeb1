"""Where a function changes its sign: closed forms, ends, steps, flat functions, and values that are
no numbers.
"""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kempe.numerics.roots import find_sign_change

CASES = {
    "line": (lambda x: x - 0.3, -1.0, 2.0, 0.3),
    "sine": (math.sin, 2.0, 4.0, math.pi),
    "exponential": (lambda x: math.exp(x) - 2.0, 0.0, 50.0, math.log(2.0)),
    "seventh power": (lambda x: (x - 1.0) ** 7, 0.0, 3.0, 1.0),
    "nearly flat": (lambda x: x**21, -1.0, 0.7, 0.0),
    "small numbers": (lambda x: 1e-300 * (x - 0.25), 0.0, 1.0, 0.25),
    "large numbers": (lambda x: 1e300 * (x - 0.25), 0.0, 1.0, 0.25),
    "pole": (lambda x: 1.0 / (x - 0.5) if x != 0.5 else math.inf, 0.0, 1.0, 0.5),
    "step": (lambda x: 1.0 if x > 0.125 else -1.0, 0.0, 1.0, 0.125),
    "far away": (lambda x: x - 1e9, 0.0, 4e9, 1e9),
}


@pytest.mark.parametrize("name", CASES)
def test_known_places(name):
    f, low, high, expected = CASES[name]
    counted: list[float] = []

    def g(x: float) -> float:
        counted.append(x)
        return f(x)

    for a, b in ((low, high), (high, low)):
        found = find_sign_change(g, a, b)
        wide = 1e-6 if name in ("seventh power", "nearly flat") else 4e-15 * (1.0 + abs(expected))
        wide = 0.03 if name == "nearly flat" else wide
        assert found is not None and abs(found - expected) <= wide and found in counted
    assert len(counted) < 400 and min(counted) >= low and max(counted) <= high


def test_ends_and_no_change():
    assert (
        find_sign_change(lambda x: x, 0.0, 1.0) == 0.0
        and find_sign_change(lambda x: x - 1.0, 0.0, 1.0) == 1.0
    )
    assert find_sign_change(lambda x: x * x + 1.0, -1.0, 1.0) is None
    for nan in (lambda x: math.nan, lambda x: math.nan if x > 0.5 else -1.0):
        assert find_sign_change(nan, 0.0, 1.0) is None
    # ends all the same
    assert find_sign_change(lambda x: math.nan if 0.3 < x < 0.7 else x - 0.5, 0.0, 1.0) is not None


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=5, unique=True))
def test_a_polynomial_changes_its_sign_at_a_root(roots):
    def f(x: float) -> float:
        return math.prod(x - r for r in roots)

    found = find_sign_change(f, -2.0, 2.0)
    if len(roots) % 2:
        assert found is not None and abs(f(found)) <= 1e-14
    else:
        assert found is None


def test_a_root_at_an_end_is_found():
    for at in (0.0, 1.0):
        assert find_sign_change(lambda s, at=at: s - at, 0.0, 1.0) == at
