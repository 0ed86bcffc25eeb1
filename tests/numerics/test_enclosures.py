"""Enclosures against the same expressions in fifty digits: whatever is computed lies within its
bounds.
"""

from __future__ import annotations

import mpmath
import numpy as np

from kempe.numerics.enclosures import constant, cos_sin, interval


def drawn(rng, depth, x, c, s):
    """A random expression: its enclosure, and a function of fifty digits."""
    kind = rng.integers(3) if depth == 0 else rng.integers(3, 8)
    if kind == 0:
        return x, lambda t: t
    if kind < 3:
        return (c, mpmath.cos) if kind == 1 else (s, mpmath.sin)
    (a, f) = drawn(rng, depth - 1, x, c, s)
    (b, g) = drawn(rng, depth - 1, x, c, s)
    if kind == 3:
        return a + b, lambda t: f(t) + g(t)
    if kind == 4:
        return a - b * 0.7, lambda t: f(t) - g(t) * mpmath.mpf(0.7)
    if kind == 5:
        return a * b, lambda t: f(t) * g(t)
    if kind == 6:
        return a / (b * b + 0.3), lambda t: f(t) / (g(t) * g(t) + mpmath.mpf(0.3))
    return (a * a + 0.1).root(), lambda t: mpmath.sqrt(f(t) * f(t) + mpmath.mpf(0.1))


def test_values_slopes_and_curvatures_lie_within_their_bounds(hunt):
    rng = hunt.rng()
    with mpmath.workdps(50):
        for _ in range(hunt.cases(40)):
            low = rng.uniform(-3.0, 3.0, 4)
            high = low + 10.0 ** rng.uniform(-14.0, -0.3, 4)
            x = interval(low, high, 2)
            found, f = drawn(rng, 3, x, *cos_sin(x))
            for i in range(4):
                for part in (0.0, rng.random(), 1.0):
                    t = mpmath.mpf(float(low[i])) + part * (
                        mpmath.mpf(float(high[i])) - mpmath.mpf(float(low[i]))
                    )
                    for k, value in enumerate(mpmath.taylor(f, t, 2)):
                        assert abs(value - mpmath.mpf(float(found.mid[k, i]))) <= mpmath.mpf(
                            float(found.rad[k, i])
                        )


def test_bounds_are_not_useless():
    """On an interval of width h they are of that order, and at a point of the order of rounding."""
    for h in (0.0, 1e-6, 1e-2):
        x = interval(np.array([0.7]), np.array([0.7 + h]), 1)
        c, s = cos_sin(x)
        y = ((x * c + 2.0).root() / (s + 3.0)) * x
        assert y.rad[0, 0] < 3.0 * h + 1e-13


def test_what_is_not_known_is_infinite():
    zero = interval(np.array([-1.0, 0.5]), np.array([1.0, 1.0]), 1)
    one = constant(np.ones(2), 1)
    assert np.array_equal(np.isinf((one / zero).rad[0]), [True, False])
    root = zero.root()
    assert np.array_equal(np.isinf(root.rad), [[False, False], [True, False]])
    assert root.low[0] <= 0.0 and root.high[0] >= 1.0
    assert np.isinf((root * root).rad[1, 0]) and np.isinf((root - root * 0.0).rad[1, 0])
