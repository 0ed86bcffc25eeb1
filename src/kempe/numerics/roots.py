"""Roots of a function of one variable, between places where its signs are different."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from kempe.spatial import Array

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


def find_sign_changes(
    f: Callable[[Array, np.ndarray], Array], low: tuple[Array, Array], high: tuple[Array, Array]
) -> Array:
    """Find where functions change their signs, many (m,) at once; see `find_sign_change`.

    `f` gives values (k,) at places (k,) of the functions with numbers (k,). `low` and `high` are
    places (m,) and values (m,) there, of different signs.
    """
    b, fb = (x.copy() for x in low)
    a, fa = (x.copy() for x in high)
    part = np.full(len(a), 0.5)
    best = np.where(np.abs(fa) < np.abs(fb), a, b)
    left = np.flatnonzero((fa != 0.0) & (fb != 0.0))
    while len(left):
        a0, fa0, b0, fb0 = a[left], fa[left], b[left], fb[left]
        x = a0 + part[left] * (b0 - a0)
        fx = f(x, left)
        same = (fx > 0.0) == (fa0 > 0.0)
        c = np.where(same, a0, b0)
        fc = np.where(same, fa0, fb0)
        b0 = np.where(same, b0, a0)
        fb0 = np.where(same, fb0, fa0)
        a[left], fa[left], b[left], fb[left] = x, fx, b0, fb0
        nearer = np.abs(fx) < np.abs(fb0)
        best[left] = np.where(nearer, x, b0)
        least = np.where(nearer, fx, fb0)
        margin = ROUNDING * (1.0 + 2.0 * np.abs(best[left])) / np.maximum(np.abs(b0 - x), 1e-300)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            xi = (x - b0) / (c - b0)
            phi = (fx - fb0) / (fc - fb0)
            inverse = fx / (fb0 - fx) * fc / (fb0 - fc) + (c - x) / (b0 - x) * fx / (
                fc - fx
            ) * fb0 / (fc - fb0)
        safe = (phi * phi < xi) & ((1.0 - phi) ** 2 < 1.0 - xi)
        go_on = (least != 0.0) & (margin <= 0.5) & ~np.isnan(fx)
        part[left] = np.clip(np.where(safe, inverse, 0.5), margin, np.maximum(1.0 - margin, margin))
        left = left[go_on]
    return best
