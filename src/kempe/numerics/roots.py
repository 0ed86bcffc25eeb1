"""Roots of a function of one variable, between places where its signs are different."""

from __future__ import annotations

import math
from collections.abc import Callable

ROUNDING = 1e-15
"""Distance of two points, absolute and as a part of their size, between which a function is not
looked at again."""


def find_sign_change(f: Callable[[float], float], low: float, high: float) -> float | None:
    """Find where f changes its sign between low and high, to rounding.

    None where f has the same sign at both ends.

    What is returned is a place where f was evaluated: the one of the last two with the smaller
    value. Inverse quadratic interpolation where it is safe, else bisection. Source: T. R.
    Chandrupatla, "A new hybrid quadratic/bisection algorithm for finding the zero of a nonlinear
    function without using derivatives", Advances in Engineering Software 28 (1997), 145-149.
    """
    b = low
    a = high
    fb = f(b)
    fa = f(a)
    if fa == 0.0 or fb == 0.0:
        return b if fb == 0.0 else a
    if (fa > 0.0) == (fb > 0.0) or math.isnan(fa + fb):
        return None
    part = 0.5
    while True:
        x = a + part * (b - a)
        fx = f(x)
        if (fx > 0.0) == (fa > 0.0):
            c = a
            fc = fa
        else:
            b, fb, c, fc = a, fa, b, fb
        a = x
        fa = fx
        best, least = (a, fa) if abs(fa) < abs(fb) else (b, fb)
        margin = ROUNDING * (1.0 + 2.0 * abs(best)) / abs(b - a)
        if least == 0.0 or margin > 0.5:
            return best
        xi = (a - b) / (c - b)
        phi = (fa - fb) / (fc - fb)
        part = 0.5
        if phi * phi < xi and (1.0 - phi) ** 2 < 1.0 - xi:
            part = fa / (fb - fa) * fc / (fb - fc) + (c - a) / (b - a) * fa / (fc - fa) * fb / (
                fc - fb
            )
        part = min(max(part, margin), 1.0 - margin)
