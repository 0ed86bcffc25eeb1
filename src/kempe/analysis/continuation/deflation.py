"""Curves along which the equations touch: the Jacobian has a larger null space all along than the
curve has tangents.

There the curve is where the equations hold and the small singular values of the Jacobian vanish,
too. These equations together are regular if the null space is cut down to a tangent to second order
(deflation: Leykin, Verschelde, Zhao, *Theor. Comput. Sci.* 359, 2006).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kempe.analysis.continuation.continuation import Closure
from kempe.analysis.continuation.crossings import PROBE, second_order
from kempe.singular_values import svd
from kempe.solvers.common.tracing import RANK, Node, step
from kempe.spatial import Array

ALIGNED = 0.7
"""Least singular value of the product of two bases from which one need not follow the other."""


class RankEquations:
    """Equations that hold the rank of those before at what it is at a point:
    ``left.T @ J @ null_space = 0``.

    The bases of the two null spaces are those of the point itself, as near as may be to the last
    ones used, so that the equations change continuously.
    """

    def __init__(self, equations: Closure, x: Array):
        J = equations.matrix(x)[: equations.real]
        U, s, Vt = svd(J)
        self.nullity = J.shape[1] - int(np.sum(s > RANK * s.max(initial=1e-300)))
        rank = J.shape[1] - self.nullity
        self._left = U[:, rank:]
        self._null_space = Vt[rank:].T
        self._before = len(equations.more)

    @property
    def count(self) -> int:
        """How many equations there are."""
        return self._left.shape[1] * self.nullity

    def write(
        self, equations: Closure, x: Array, F: Array, J: Array, at: int, with_matrix: bool
    ) -> None:
        """Write the residuals of these equations and their derivatives into F and J (., n) from row
        `at` on.
        """
        own = J[:at] if with_matrix else equations.both(x, True, self._before)[1][:at]
        U, _, Vt = svd(own)
        rank = own.shape[1] - self.nullity
        here = slice(at, at + self.count)
        left = self._near(U[:, rank:], self._left)
        null_space = self._near(Vt[rank:].T, self._null_space)
        if min(_least(left.T @ self._left), _least(null_space.T @ self._null_space)) < ALIGNED:
            self._left = left
            self._null_space = null_space
        F[here] = (left.T @ own @ null_space).ravel()
        if with_matrix:
            padded = np.zeros((equations.rows, left.shape[1]))
            padded[:at] = left
            before = _Before(equations, self._before)
            J[here] = (
                second_order(before, x, padded, null_space)
                .transpose(1, 2, 0)
                .reshape(self.count, -1)
            )

    @staticmethod
    def _near(basis: Array, to: Array) -> Array:
        """The basis of the same space that is nearest to another (Procrustes)."""
        U, _, Vt = svd(basis.T @ to)
        return basis @ (U @ Vt)


class _Before(Closure):
    """Equations without the further ones from a number on."""

    def __init__(self, equations: Closure, further: int):
        vars(self).update(vars(equations))
        self._equations = equations
        self._further_ones = further

    def matrix(self, x: Array) -> Array:
        """Derivative (rows, n) of these equations at `x`."""
        return self._equations.both(x, True, self._further_ones)[1]


def hold_rank(
    equations: Closure, x: Array, curve: Callable[[], tuple[Closure, Node]], length: float = PROBE
) -> bool:
    """Hold the rank at a point (nq,) from here on, if the equations then leave a curve through it;
    True if they do.

    `curve` gives the equations of the curve, these or equations made of them, and its node at the
    point. The curve must have this `length` on both sides: branches that touch closely look like
    one of low rank near by.
    """
    low = RankEquations(equations, x)
    if not low.count or rank_held(equations):
        return False
    equations.add(low)
    along, here = curve()
    if here.nullity == 1 and all(_goes_on(along, n, length) for n in (here, here.reversed())):
        return True
    equations.leave_out(low)
    return False


def _goes_on(curve: Closure, a: Node, length: float) -> bool:
    """Whether the curve can be followed from a node over a length, by steps that double."""
    h = PROBE
    gone = 0.0
    here = a
    while gone < length:
        there = step(curve, here, h)
        if there is None:
            return False
        h, gone, here = 2.0 * h, gone + h, there
    return True


def rank_held(equations: Closure) -> bool:
    """Whether the equations hold the rank."""
    return any(isinstance(m, RankEquations) for m in equations.more)


def _least(A: Array) -> float:
    """The least singular value."""
    return float(svd(A, compute_uv=False).min(initial=1.0))
