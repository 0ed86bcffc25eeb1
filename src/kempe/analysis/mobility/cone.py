"""What active one-sided constraints leave to velocities: the cone {v : E v = 0, G v >= 0}, by
linear programming.

Columns are scaled velocities (slides in lengths of a link), so that rows of turns and slides
compare. Facts used: a one-sided row is zero on the whole cone where it takes part in a nonnegative
combination of rows that vanishes (Stiemke, 1915); where no row is, and E has full rank, the cone is
what curves of the set {e = 0, g >= 0} leave with (Mangasarian and Fromovitz, 1967); otherwise it
says to first order what may move.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations
from math import comb
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from kempe.singular_values import svd
from kempe.spatial import Array

NOTHING = 1e-6
"""Rows, components and openings below this part of what they are measured against count as zero: at
a configuration that is 1e-14 from a singular one, where equations are quadratic, rows that vanish
there are 1e-7."""
MOST = 3000
"""Sets of rows that are tried for extreme rays; where there are more the rays are not listed."""
PRECISE = 1e-10
"""Tolerances of the linear programs."""


class ConeDirections(NamedTuple):
    """Whether a quantity may fall and may rise, to first order."""

    down: bool
    up: bool

    def __str__(self) -> str:
        return _WORDS[self.up][self.down]


_WORDS = (("neither up nor down", "down but not up"), ("up but not down", "up and down"))


@dataclass(frozen=True, eq=False)
class Cone:
    """The velocities v (n,) with E v = 0 and G v >= 0; rows of G are named by their places.

    `dimension` is that of the cone, `lineality` that of the velocities whose opposite is allowed,
    too, with the basis `free` (lineality, n). `implicit` rows are zero at all allowed velocities
    though E v = 0 does not say so (opposite contacts, a wedge that has closed), `implied` ones
    because E v = 0 says so; `vanishing` rows are zero themselves: they say nothing to first order.
    `redundant` rows follow from the others. `rays` (k, n) are the extreme ones (unit vectors,
    across `free`), None where they are too many. `exact`: each of these velocities begins a motion.
    """

    size: int
    dimension: int
    lineality: int
    implicit: tuple[int, ...]
    implied: tuple[int, ...]
    vanishing: tuple[int, ...]
    redundant: tuple[int, ...]
    exact: bool
    rays: Array | None = field(repr=False)
    free: Array = field(repr=False)
    across: Array = field(repr=False)
    """Basis (dimension - lineality, n) of the cone's span across `free`."""
    rows: Array = field(repr=False)
    """The rows that are needed, in that basis: the cone across `free` is where they are not
    negative."""

    def ways(self, row: ArrayLike) -> ConeDirections:
        """Whether `row` @ v may be below and above zero, of a quantity with the gradient `row`
        (n,).
        """
        row = np.asarray(row, dtype=float)
        size = float(np.linalg.norm(row))
        if size == 0.0:
            return ConeDirections(False, False)
        if np.linalg.norm(self.free @ row) > NOTHING * size:
            return ConeDirections(True, True)
        if self.rays is not None:
            rates = self.rays @ row
            return ConeDirections(
                bool(np.any(rates < -NOTHING * size)), bool(np.any(rates > NOTHING * size))
            )
        own = self.across @ row / size
        return ConeDirections(_least(own, self.rows) < -NOTHING, _least(-own, self.rows) < -NOTHING)


def tangent_cone(equal: Array, one_sided: Array, ignore: float = NOTHING) -> Cone:
    """The cone of the velocities v (n,) with `equal` (m, n) @ v = 0 and `one_sided` (k, n) @ v >=
    0.

    Rows below `ignore` count as zero, one-sided ones that are not finite, too; others are scaled to
    unit length.
    """
    E = np.asarray(equal, dtype=float)
    G = np.asarray(one_sided, dtype=float)
    G = np.where(np.isfinite(G).all(axis=1, keepdims=True), G, 0.0)
    n = E.shape[1]
    rank, N = _null_space(_unit(E, ignore)[0])
    full = rank == len(E)
    G, sizes = _unit(G, ignore)
    vanishing = sizes <= ignore
    inner = G @ N.T
    inner, left = _unit(inner, NOTHING)
    implied = ~vanishing & (left <= NOTHING)
    used = np.flatnonzero(~vanishing & ~implied)
    cut = inner[used]
    depth, free = _null_space(cut)
    across = _complement(cut, depth)
    B = _unit(cut @ across.T, 0.0)[0]
    closed = _closed(B)
    redundant = []
    if depth < len(used):
        redundant = _redundant(B)
    wide, across = _kernel_in(B[closed], across)
    open_rows = [i for i in range(len(used)) if i not in closed and i not in redundant]
    C = _unit(cut[open_rows] @ across.T, 0.0)[0]
    rays = _rays(C)
    names = used.tolist()
    return Cone(
        n,
        len(free) + wide,
        len(free),
        tuple(names[i] for i in closed),
        tuple(np.flatnonzero(implied).tolist()),
        tuple(np.flatnonzero(vanishing).tolist()),
        tuple(names[i] for i in redundant),
        bool(full and not closed and not vanishing.any() and not implied.any()),
        None if rays is None else rays @ across @ N,
        free @ N,
        across @ N,
        C,
    )


def _unit(rows: Array, ignore: float) -> tuple[Array, Array]:
    """Rows of unit length, those up to `ignore` zero, and the lengths that they had."""
    sizes = np.linalg.norm(rows, axis=1)
    good = sizes > ignore
    return np.where(good[:, None], rows / np.where(good, sizes, 1.0)[:, None], 0.0), sizes


def _null_space(rows: Array) -> tuple[int, Array]:
    """The rank of unit rows, and an orthonormal basis (n - rank, n) of what they leave at zero."""
    if not rows.any():
        return 0, np.eye(rows.shape[1])
    _, values, Vt = svd(rows)
    rank = int(np.sum(values > NOTHING * values[0]))
    return rank, Vt[rank:]


def _complement(rows: Array, rank: int) -> Array:
    """An orthonormal basis (rank, n) of what rows span."""
    return svd(rows)[2][:rank] if rank else np.zeros((0, rows.shape[1]))


def _kernel_in(rows: Array, basis: Array) -> tuple[int, Array]:
    """Dimension and basis of what rows, written in a basis, leave at zero of its span."""
    rank, N = _null_space(rows)
    return len(basis) - rank, N @ basis


def _closed(B: Array) -> list[int]:
    """The rows of a pointed cone {B w >= 0} that are zero on all of it.

    One program: raise as many rows to 1 as can be at once, with w as long as the narrowest opening
    that counts needs.
    """
    k, r = B.shape
    if k == r:  # independent: each can be raised alone
        return []
    from scipy import optimize

    answer = cast(Any, optimize).linprog(
        np.concatenate([np.zeros(r), -np.ones(k)]),
        np.hstack([-B, np.eye(k)]),
        np.zeros(k),
        bounds=[(-1.0 / NOTHING, 1.0 / NOTHING)] * r + [(0.0, 1.0)] * k,
        **_METHOD,
    )
    return np.flatnonzero(answer.x[r:] < 0.5).tolist()


def _redundant(B: Array) -> list[int]:
    """Rows that follow from the others that are kept; of several that could go the last ones do."""
    kept = list(range(len(B)))
    for i in range(len(B) - 1, -1, -1):
        others = [j for j in kept if j != i]
        if _least(B[i], B[others]) >= -NOTHING:
            kept = others
    return [i for i in range(len(B)) if i not in kept]


def _least(row: Array, rows: Array) -> float:
    """The least of row @ w where rows @ w >= 0, for w within a box of unit size."""
    from scipy import optimize

    answer = cast(Any, optimize).linprog(
        row, -rows, np.zeros(len(rows)), bounds=[(-1.0, 1.0)] * len(row), **_METHOD
    )
    return float(answer.fun)


_METHOD: dict[str, Any] = {
    "method": "highs",
    "options": {"primal_feasibility_tolerance": PRECISE, "dual_feasibility_tolerance": PRECISE},
}


def _rays(C: Array) -> Array | None:
    """Unit vectors (k, r) along the edges of a cone {C w >= 0} of full dimension without a line;
    None: too many.

    Along an edge r - 1 independent rows are zero.
    """
    k, r = C.shape
    if r == 0:
        return np.zeros((0, 0))
    if k == r:
        edges = np.linalg.inv(C).T
        return edges / np.linalg.norm(edges, axis=1)[:, None]
    if comb(k, r - 1) > MOST:
        return None
    chosen = np.array([*combinations(range(k), r - 1)], dtype=np.int64)
    _, values, Vt = svd(C[chosen])
    alone = np.ones(len(chosen), dtype=bool) if r == 1 else values[:, -1] > NOTHING
    lines = Vt[alone, -1]
    both = np.concatenate([lines, -lines])
    inside = both[np.all(both @ C.T >= -NOTHING, axis=1)]
    out: list[Array] = []
    for ray in inside:
        if all(np.linalg.norm(ray - other) > NOTHING for other in out):
            out.append(ray)
    return np.array(out).reshape(-1, r)
