"""Proof, by the theorem of Newton and Kantorovich, that equations have a solution near a point, and
a regular one.

Kantorovich, 1948; Ortega, Rheinboldt, 1970, section 12.6. It needs three numbers: how far the
equations are from zero, the smallest singular value of their Jacobian, and a bound of their second
derivatives.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kempe.spatial import Array

UNIT = float(np.finfo(float).eps)
OPERATIONS = 16.0
"""Roundings for each joint on the way to a number, with a margin."""


class Certificate(NamedTuple):
    """What is proven of the solutions near a point.

    `regular`: whether the Jacobian keeps its full rank up to every solution within `radius`, so
    that solutions are a manifold there, or isolated; with at most as many equations as unknowns an
    exact one exists within `radius`. `smallest` bounds the smallest singular value from below.
    """

    regular: bool
    smallest: float
    radius: float


def certify(
    values: Array, shape: tuple[int, int], residual: float, bend: float, entry: float, entries: int
) -> Certificate:
    """The `Certificate` of equations with these singular `values` (descending) and this `shape` (m,
    n) of the Jacobian.

    `residual` is the norm of the equations, `bend` bounds the norm of their second derivative
    around the point, `entry` the rounding error of each of the `entries` of the Jacobian that are
    not zero, and of each equation.
    """
    m, n = shape
    if not m or not n:
        return Certificate(True, np.inf, 0.0)
    rounding = entry * np.sqrt(entries) + UNIT * max(m, n) * float(values[0])
    smallest = float(values[min(m, n) - 1]) - rounding
    if smallest <= 0.0:
        return Certificate(False, 0.0, np.inf)
    off = residual + entry * np.sqrt(m)
    return Certificate(2.0 * off * bend < smallest**2, smallest, 2.0 * off / smallest)


def rounding(joints: int, reach: float) -> float:
    """Bound of the rounding error of a number that comes from a chain of `joints`, `reach` lengths
    from the origin.
    """
    return UNIT * OPERATIONS * (1.0 + joints) * (1.0 + reach)
