"""Solutions of equations: Gauss-Newton steps, and proofs that a solution is near.

A Gauss-Newton step is the least change that the linear equations ask, by the pseudo-inverse without
its small singular values. Equations may be more or fewer than the unknowns, or dependent.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from kempe.budget import check_for_stop
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

# ---- proof of a solution near a point, by the theorem of Newton and Kantorovich

# It proves that there is a solution, and a regular one (Kantorovich, 1948; Ortega, Rheinboldt,
# 1970, section 12.6). It needs three numbers: how far the equations are from zero, the smallest
# singular value of their Jacobian, and a bound of their second derivatives.

UNIT = float(np.finfo(float).eps)
OPERATIONS = 16.0
"""Roundings for each joint on the way to a number, with a margin."""


class Certificate(NamedTuple):
    """Proof about solutions of equations near a point.

    `regular`: whether the Jacobian keeps its full rank up to every solution within `radius`, so
    that solutions are a manifold there, or isolated; with at most as many equations as unknowns an
    exact one exists within `radius`. `smallest` bounds the smallest singular value from below.
    """

    regular: bool
    smallest: float
    radius: float


def make_certificate(
    values: Array, shape: tuple[int, int], residual: float, bend: float, entry: float, entries: int
) -> Certificate:
    """Make the `Certificate` of equations from the singular values of their Jacobian (m, n).

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


def bound_rounding_error(joints: int, reach: float) -> float:
    """Bound the rounding error of a number that comes from a chain of `joints`.

    `reach` is the distance from the origin in lengths of the chain.
    """
    return UNIT * OPERATIONS * (1.0 + joints) * (1.0 + reach)


# ---- Gauss-Newton steps

# Sources: Ben-Israel, "A Newton-Raphson method for the solution of systems of equations", J. Math.
# Anal. Appl. 15 (1966); Bjorck, *Numerical Methods for Least Squares Problems*, 1996, chapter 9.

LAST = 1e-8
"""A step up to this length is the last one: where convergence is quadratic, the next would be
rounding."""
NOTHING = 1e-15
"""A step up to this length is rounding: it is not taken."""
LARGE = 60
"""Equations from which on normal equations are solved in place of singular value decompositions,
where both will do."""
SMALL = 1000
"""Entries up to which many matrices are decomposed at once: a call for each takes far longer."""
WORK = 2e8
"""Products of numbers between two looks at the clock, about 0.1 s."""
WELL = 1e7
"""Size of a solution of normal equations with a right-hand side of size 1 below which they are far
from singular."""

Equations = Callable[[Array], tuple[Array, Array]]
"""What is missing (m,) at x, and its derivative (m, n) by small changes of x."""


class GaussNewtonEnd(NamedTuple):
    """End of a Gauss-Newton iteration: the point, the residual there, and its derivative."""

    x: Array
    r: Array
    J: Array

    @property
    def size(self) -> float:
        """Largest entry of the residual; NaN where an entry is NaN."""
        return float(np.abs(self.r).max(initial=0.0))


def solve_least_squares(A: Array, b: Array, level: float = Level.CLOSED) -> Array:
    """Find the shortest y (n,) that minimises |A y - b|.

    Singular values below `level` of the largest one count as zero.
    """
    return (
        solve_many_least_squares(A[None], b[None], level)[0]
        if len(b) > LARGE
        else _solve_by_singular_values(A, b, level)
    )


def _solve_by_singular_values(A: Array, b: Array, level: float) -> Array:
    return np.asarray(np.linalg.lstsq(A, b, rcond=level)[0], dtype=float)


def solve_many_least_squares(A: Array, b: Array, level: float = Level.CLOSED) -> Array:
    """Find the shortest y (k, n) that minimise |A y - b| for many A (k, m, n) and b (k, m).

    The normal equations are used where they are far from singular.

    Of the first kind, or of the second where there are fewer equations than unknowns. A second
    right-hand side, in no special direction, tells how near to singular they are. Of large ones a
    few are solved at a time.
    """
    k, m, n = A.shape
    most = max(1, int(WORK / max(1, m * n * min(m, n))))
    if k > most:
        return np.concatenate(
            [
                solve_many_least_squares(A[i : i + most], b[i : i + most], level)
                for i in range(0, k, most)
            ]
        )
    if m > LARGE:
        check_for_stop()
    At = np.swapaxes(A, -1, -2)
    wide = A.shape[-2] < A.shape[-1]
    G = A @ At if wide else At @ A
    n = G.shape[-1]
    right = np.empty((len(A), n, 2))
    right[..., 0] = b if wide else np.einsum("kmn,km->kn", A, b)
    right[..., 1] = np.cos(np.arange(n, dtype=float))
    scale = np.einsum("kii->k", G)
    bad = np.ones(len(A), dtype=bool)
    y = np.zeros((len(A), A.shape[-1]))
    with contextlib.suppress(np.linalg.LinAlgError):
        found = np.linalg.solve(G, right)
        bad = ~(np.linalg.norm(found[..., 1], axis=-1) * scale < WELL)
        y[:] = np.einsum("kmn,km->kn", A, found[..., 0]) if wide else found[..., 0]
    left = np.flatnonzero(bad)
    if m * A.shape[-1] > SMALL:
        for k in left:
            check_for_stop()
            y[k] = _solve_by_singular_values(A[k], b[k], level)
    elif len(left):
        inverse = Spectrum(A[left]).compute_pseudo_inverse(level)
        y[left] = np.einsum("knm,km->kn", inverse, b[left])
    return y


def solve_damped_least_squares(A: Array, b: Array, damping: float) -> Array:
    """Find the y (n,) that minimises |A y - b|^2 + damping |y|^2."""
    U, s, Vt = Spectrum(A).thin_decomposition
    return Vt.T @ (s / (s * s + damping) * (U.T @ b))


def run_gauss_newton(
    equations: Equations,
    x: Array,
    tries: int,
    *,
    step: Callable[[Array, Array, Array], Array] | None = None,
    level: float = Level.CLOSED,
    met: float = 0.0,
    last: float = LAST,
    longest: float = math.inf,
    halving: bool = False,
    move: Callable[[Array, Array], Array] = np.add,
) -> GaussNewtonEnd:
    """Run at most `tries` Gauss-Newton steps from `x`: point, residual and Jacobian.

    It ends where the residual is at most `met`, after a step up to `last`, before one that is zero
    or not finite, and with `halving` before one longer than half the one before. Steps are
    shortened to `longest`. `step` gives another step (n,) at (x, r, J) than `solve_least_squares`, `move`
    the point to which one leads.
    """
    before = math.inf
    k = 0
    while True:
        if len(x) > LARGE:
            check_for_stop()
        r, J = equations(x)
        if k == tries or before <= last or not met < float(np.abs(r).max(initial=0.0)) < math.inf:
            break
        y = solve_least_squares(J, -r, level) if step is None else step(x, r, J)
        size = math.hypot(*y.tolist())  # no overflow on the way
        if not NOTHING < size < math.inf or (halving and size > 0.5 * before):
            break
        x = move(x, y * (longest / size) if size > longest else y)
        before = size
        k = k + 1
    return GaussNewtonEnd(x, r, J)


def run_many_gauss_newton(
    equations: Callable[[Array, np.ndarray], tuple[Array, Array]],
    x: Array,
    tries: int,
    *,
    step: Callable[[Array, Array], Array] | None = None,
    level: float = Level.CLOSED,
    met: float = 0.0,
    last: float = LAST,
    longest: float = math.inf,
    move: Callable[[Array, Array], Array] = np.add,
) -> Array:
    """Run at most `tries` Gauss-Newton steps from each of many points (k, n).

    Each start goes on its own.

    `equations` gives residuals (j, m) and Jacobians (j, m, n) at points (j, n), those of the starts
    of indices (j,). `step` gives other steps (j, n), from these, than `solve_many_least_squares`.
    Options are those of `run_gauss_newton`, but the size of a step is its largest entry. A point
    becomes NaN where its residual is not finite.
    """
    x, left = np.array(x), np.arange(len(x))
    for _ in range(tries):
        check_for_stop()
        r, J = equations(x[left], left)
        size = np.abs(r).max(axis=1, initial=0.0)
        x[left[~np.isfinite(size)]] = np.nan
        go_on = size > met
        go_on &= np.isfinite(size)
        left, r, J = (left, r, J) if go_on.all() else (left[go_on], r[go_on], J[go_on])
        if not len(left):
            break
        y = solve_many_least_squares(J, -r, level) if step is None else step(r, J)
        size = np.abs(y).max(axis=1, initial=0.0)
        x[left] = move(
            x[left], y * (longest / np.maximum(size, longest))[:, None] if longest < math.inf else y
        )
        left = left[size > last]
    return x
