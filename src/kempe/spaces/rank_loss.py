"""Where a matrix that depends on the configuration has a smaller rank than almost everywhere, loops
closed.

The unknowns are the configuration q and a basis V of the null space, one dimension larger than in
general: C(q) = 0, A(q) V = 0, V fixed by a constant complement. These equations are regular at most
singular points, so that Newton's method converges to them quadratically; see Griewank, Reddien,
"Characterization and computation of generalized turning points", SIAM J. Numer. Anal. 21 (1984).
Turns are in radians, slides and positions in characteristic lengths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from kempe.assemble.generic_configurations import compute_idle_rates, find_idle_coordinates
from kempe.equations import closure_rows
from kempe.numerics.newton import run_many_gauss_newton
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

STEP = 1e-5
"""Step of the differences of the matrix."""
HELD = 1e-9
"""Residual up to which the equations hold: the differences leave no more."""
STEPS = 60
LONGEST = 0.5
PULL = 1e-3
"""Weight of the distance to a configuration, beside equations that hold."""

Matrices = Callable[[Array], Array]
"""The matrices (k, m, n) at configurations (k, nq), of which the ranks are looked at."""
Equations = Callable[[Array], tuple[Array, Array]]
"""What is missing (k, e) at configurations (k, nq), and the derivatives (k, e, nv) without unit."""


@dataclass(frozen=True, eq=False)
class RankLoss:
    """The equations of configurations of `system` at which `matrices` have rank less than `rank`.

    `columns` (n,) are the velocity coordinates to which the columns belong, `unit` (nv,) what
    counts as 1 of each.
    """

    system: Model
    matrices: Matrices
    rank: int
    columns: np.ndarray
    unit: Array
    further: Equations | None = None
    """Equations that hold besides the loops, and besides that nothing spins idly."""

    @cached_property
    def closed(self) -> bool:
        """Whether there are loops or relations that hold."""
        return len(closure_rows.list_row_names(self.system)) > 0

    @cached_property
    def counts(self) -> np.ndarray:
        """Which velocity coordinates (nv,) idle spins leave alone."""
        return ~find_idle_coordinates(self.system)

    @cached_property
    def spins(self) -> bool:
        """Whether something spins idly."""
        return not self.counts.all()

    def closure(self, q: Array, with_jacobian: bool = True) -> tuple[Array, Array]:
        """What the loops and further equations miss (k, c), and the derivatives (k, c, nv), at q
        (k, nq).
        """
        rows = np.zeros((len(q), 0)), np.zeros((len(q), 0, self.system.nv))
        if self.closed:
            rows = closure_rows.evaluate_constraints(self.system, q, with_jacobian, scaled=True)
            if self.spins:
                still = compute_idle_rates(self.system, q) * self.unit
                F = np.concatenate([rows[0], np.zeros(still.shape[:2])], axis=1)
                rows = F, np.concatenate([rows[1], still], axis=1) if with_jacobian else rows[1]
        if self.further is None:
            return rows
        F, dF = self.further(q)
        both = np.concatenate([rows[1], dF], axis=1) if with_jacobian else rows[1]
        return np.concatenate([rows[0], F], axis=1), both

    def move(self, q: Array, y: Array) -> Array:
        """The configurations (k, nq) a step (k, nv) from q (k, nq)."""
        return self.system.structure.layout.integrate_velocity(q, y * self.unit)

    def between(self, q: Array, other: Array) -> Array:
        """The steps (k, nv) from q to other configurations."""
        return self.system.structure.layout.compute_difference(q, other) / self.unit

    def _transposed(self, A: Array) -> Array:
        """The matrices, or their transposes where these have the smaller null space."""
        return A if A.shape[-1] <= A.shape[-2] else np.swapaxes(A, -1, -2)

    def null_vectors(self, q: Array) -> Array:
        """Orthonormal bases V (k, n, d) of what the matrices at q (k, nq) lead to the least."""
        A = self._transposed(self.matrices(q))
        return np.swapaxes(Spectrum(A).right[:, self.rank - 1 :], 1, 2)

    def _products(self, q: Array, V: Array, steps: Array) -> Array:
        """The matrices at steps (nv, nv) from q (k, nq), times V (k, n, d): (k, nv, m, d)."""
        n = self.system.nv
        k = len(q)
        A = self._transposed(
            self.matrices(self.move(np.repeat(q, n, axis=0), np.tile(steps, (k, 1))))
        )
        return A.reshape(k, n, *A.shape[1:]) @ V[:, None]

    def equations(
        self, q: Array, V: Array, frame: Array, sharp: bool = True
    ) -> tuple[Array, Array]:
        """What is missing (k, e) at q (k, nq) and V (k, n, d), and derivatives (k, e, nv + n d);
        see above.

        With `sharp` derivatives are central differences, else of one side, which Newton's method is
        content with.
        """
        k = len(q)
        nv = self.system.nv
        C, dC = self.closure(q)
        A = self._transposed(self.matrices(q))
        steps = STEP * np.eye(nv)
        above = self._products(q, V, steps)
        below = self._products(q, V, -steps) if sharp else (A @ V)[:, None]
        dA = (above - below) / (STEP + STEP * sharp)
        m = A.shape[1]
        n = A.shape[2]
        d = V.shape[2]
        fixed = np.swapaxes(frame, 1, 2) @ V - np.eye(d)
        F = np.concatenate([C, (A @ V).reshape(k, m * d), fixed.reshape(k, d * d)], axis=1)
        J = np.zeros((k, F.shape[1], nv + n * d))
        c = C.shape[1]
        J[:, :c, :nv] = dC
        J[:, c : c + m * d, :nv] = np.moveaxis(dA, 1, -1).reshape(k, m * d, nv)
        J[:, c : c + m * d, nv:] = np.einsum("kmn,de->kmdne", A, np.eye(d)).reshape(k, m * d, n * d)
        J[:, c + m * d :, nv:] = np.einsum("knd,ef->kdenf", frame, np.eye(d)).reshape(
            k, d * d, n * d
        )
        return F, J

    def led(self, q: Array, home: Array | None = None) -> Array:
        """Where Newton's method leads from q (k, nq): points of the set, NaN where it leads to
        none.

        With a `home` (nq,) they are led towards what is nearest to it, too.
        """
        if not len(q):
            return q
        q = np.array(q, dtype=float)
        if home is not None:
            q = self._steps(q, np.broadcast_to(home, q.shape))
        q = self._steps(q, None)
        good = np.asarray(np.isfinite(q).all(axis=1))
        good[good] = self.holds(q[good])
        q[~good] = np.nan
        return q

    def _steps(self, q: Array, home: Array | None) -> Array:
        nq = self.system.nq
        nv = self.system.nv
        frame = self.null_vectors(q)
        shape = frame.shape[1:]

        def equations(x: Array, at: np.ndarray) -> tuple[Array, Array]:
            F, J = self.equations(x[:, :nq], x[:, nq:].reshape(len(x), *shape), frame[at], False)
            if home is None:
                return F, J
            pull = np.zeros((len(x), nv, J.shape[2]))
            pull[:, np.arange(nv), np.arange(nv)] = PULL
            off = PULL * self.between(home[at], x[:, :nq])
            return np.concatenate([F, off], axis=1), np.concatenate([J, pull], axis=1)

        def move(x: Array, y: Array) -> Array:
            return np.concatenate([self.move(x[:, :nq], y[:, :nv]), x[:, nq:] + y[:, nv:]], axis=1)

        start = np.concatenate([q, frame.reshape(len(q), -1)], axis=1)
        return run_many_gauss_newton(
            equations, start, STEPS, met=1e-14, last=1e-13, longest=LONGEST, move=move
        )[:, :nq]

    def holds(self, q: Array) -> np.ndarray:
        """Whether (k,) loops are closed and the rank is lost at q (k, nq)."""
        if not len(q):
            return np.zeros(0, dtype=bool)
        C = self.closure(q, False)[0]
        return np.asarray(
            (self.least(q) <= Level.GENERIC) & (np.abs(C).max(axis=1, initial=0.0) < HELD)
        )

    @property
    def square(self) -> bool:
        """Whether the matrices have a determinant, which is zero in the set alone."""
        m, n = self.matrices(self.system.neutral[None]).shape[1:]
        return m == n == self.rank

    def sign(self, q: Array) -> Array:
        """The signs (k,) of the determinants at q (k, nq)."""
        return np.asarray(np.linalg.slogdet(self.matrices(q))[0])

    def least(self, q: Array) -> Array:
        """The singular values (k,) at q (k, nq) that are zero in the set, as parts of the largest."""
        spectrum = Spectrum(self.matrices(q))
        return (
            spectrum.values[:, self.rank - 1] / spectrum.largest if self.rank else np.zeros(len(q))
        )

    def tangents(self, q: Array) -> Array:
        """Orthonormal basis (nv, k) of the directions of the set at one of its points (nq,),
        irrelevant ones included.

        It is exact where the set is smooth and its equations are regular.
        """
        nv = self.system.nv
        V = self.null_vectors(q[None])
        J = self.equations(q[None], V, V)[1][0]
        null_space = Spectrum(J, 1.0).compute_null_space(Level.ROUGH)[:nv]
        return Spectrum(null_space, 1.0).compute_column_space(Level.ROUGH)


def generic_rank(A: Array) -> int:
    """The largest rank of matrices (k, m, n)."""
    return int(Spectrum(A).compute_ranks(Level.GENERIC).max(initial=0))
