"""Configurations at which a matrix loses rank, for closed loops.

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

from kempe.assemble.idle_freedoms import compute_idle_rates, find_idle_coordinates
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
    """Equations of the configurations of `system` at which `matrices` have rank less than `rank`.

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
    def has_closure(self) -> bool:
        """Whether there are loops or relations."""
        return len(closure_rows.list_row_names(self.system)) > 0

    @cached_property
    def counted_columns(self) -> np.ndarray:
        """Velocity coordinates (nv,) that no idle freedom moves, as truth values."""
        return ~find_idle_coordinates(self.system)

    @cached_property
    def has_idle_spins(self) -> bool:
        """Whether there is an idle freedom."""
        return not self.counted_columns.all()

    def evaluate_closure(self, q: Array, with_jacobian: bool = True) -> tuple[Array, Array]:
        """Evaluate residuals (k, c) of loops and further equations at q (k, nq). The derivatives
        are (k, c, nv).
        """
        rows = np.zeros((len(q), 0)), np.zeros((len(q), 0, self.system.nv))
        if self.has_closure:
            rows = closure_rows.evaluate_constraints(self.system, q, with_jacobian, scaled=True)
            if self.has_idle_spins:
                still = compute_idle_rates(self.system, q) * self.unit
                F = np.concatenate([rows[0], np.zeros(still.shape[:2])], axis=1)
                rows = F, np.concatenate([rows[1], still], axis=1) if with_jacobian else rows[1]
        if self.further is None:
            return rows
        F, dF = self.further(q)
        both = np.concatenate([rows[1], dF], axis=1) if with_jacobian else rows[1]
        return np.concatenate([rows[0], F], axis=1), both

    def move_configurations(self, q: Array, y: Array) -> Array:
        """Move configurations q (k, nq) by steps (k, nv)."""
        return self.system.structure.layout.integrate_velocity(q, y * self.unit)

    def compute_steps(self, q: Array, other: Array) -> Array:
        """Compute the steps (k, nv) from q to other configurations."""
        return self.system.structure.layout.compute_difference(q, other) / self.unit

    def _orient_matrices(self, A: Array) -> Array:
        """Return the matrices, or their transposes if these have the smaller null space."""
        return A if A.shape[-1] <= A.shape[-2] else np.swapaxes(A, -1, -2)

    def compute_null_vectors(self, q: Array) -> Array:
        """Compute orthonormal null vectors V (k, n, d) of the matrices at q (k, nq). They belong to
        the least singular values.
        """
        A = self._orient_matrices(self.matrices(q))
        return np.swapaxes(Spectrum(A).right[:, self.rank - 1 :], 1, 2)

    def _evaluate_products(self, q: Array, V: Array, steps: Array) -> Array:
        """Evaluate the matrices at small steps from q (k, nq), times V (k, n, d): (k, nv, m, d)."""
        n = self.system.nv
        k = len(q)
        A = self._orient_matrices(
            self.matrices(self.move_configurations(np.repeat(q, n, axis=0), np.tile(steps, (k, 1))))
        )
        return A.reshape(k, n, *A.shape[1:]) @ V[:, None]

    def evaluate_equations(
        self, q: Array, V: Array, frame: Array, sharp: bool = True
    ) -> tuple[Array, Array]:
        """Evaluate residuals (k, e) at q (k, nq) and V (k, n, d), and derivatives (k, e, nv + n d).
        See the class.

        With `sharp` derivatives are central differences, else of one side, which Newton's method is
        content with.
        """
        k = len(q)
        nv = self.system.nv
        C, dC = self.evaluate_closure(q)
        A = self._orient_matrices(self.matrices(q))
        steps = STEP * np.eye(nv)
        above = self._evaluate_products(q, V, steps)
        below = self._evaluate_products(q, V, -steps) if sharp else (A @ V)[:, None]
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

    def find_singular(self, q: Array, home: Array | None = None) -> Array:
        """Find singular configurations from starts q (k, nq) by Newton's method, NaN where it
        fails.

        With a `home` (nq,) they are led towards what is nearest to it, too.
        """
        if not len(q):
            return q
        q = np.array(q, dtype=float)
        if home is not None:
            q = self._solve_steps(q, np.broadcast_to(home, q.shape))
        q = self._solve_steps(q, None)
        good = np.asarray(np.isfinite(q).all(axis=1))
        good[good] = self.is_singular(q[good])
        q[~good] = np.nan
        return q

    def _solve_steps(self, q: Array, home: Array | None) -> Array:
        """Solve the equations by Gauss-Newton steps from q (k, nq), pulled to `home` if that is
        given.
        """
        nq = self.system.nq
        nv = self.system.nv
        frame = self.compute_null_vectors(q)
        shape = frame.shape[1:]

        def evaluate_equations(x: Array, at: np.ndarray) -> tuple[Array, Array]:
            F, J = self.evaluate_equations(
                x[:, :nq], x[:, nq:].reshape(len(x), *shape), frame[at], False
            )
            if home is None:
                return F, J
            pull = np.zeros((len(x), nv, J.shape[2]))
            pull[:, np.arange(nv), np.arange(nv)] = PULL
            off = PULL * self.compute_steps(home[at], x[:, :nq])
            return np.concatenate([F, off], axis=1), np.concatenate([J, pull], axis=1)

        def move_unknowns(x: Array, y: Array) -> Array:
            return np.concatenate(
                [self.move_configurations(x[:, :nq], y[:, :nv]), x[:, nq:] + y[:, nv:]], axis=1
            )

        start = np.concatenate([q, frame.reshape(len(q), -1)], axis=1)
        return run_many_gauss_newton(
            evaluate_equations,
            start,
            STEPS,
            met=1e-14,
            last=1e-13,
            longest=LONGEST,
            move=move_unknowns,
        )[:, :nq]

    def is_singular(self, q: Array) -> np.ndarray:
        """Whether (k,) loops are closed and the rank is lost at q (k, nq)."""
        if not len(q):
            return np.zeros(0, dtype=bool)
        C = self.evaluate_closure(q, False)[0]
        return np.asarray(
            (self.compute_least_values(q) <= Level.GENERIC)
            & (np.abs(C).max(axis=1, initial=0.0) < HELD)
        )

    @property
    def has_determinant(self) -> bool:
        """Whether the matrices are square. Then their determinant is zero only at singular
        configurations.
        """
        m, n = self.matrices(self.system.neutral[None]).shape[1:]
        return m == n == self.rank

    def compute_determinant_sign(self, q: Array) -> Array:
        """Compute the signs (k,) of the determinants at q (k, nq)."""
        return np.asarray(np.linalg.slogdet(self.matrices(q))[0])

    def compute_least_values(self, q: Array) -> Array:
        """Compute the singular values (k,) at q (k, nq) that vanish with the rank. They are
        fractions of the largest.
        """
        spectrum = Spectrum(self.matrices(q))
        return (
            spectrum.values[:, self.rank - 1] / spectrum.largest if self.rank else np.zeros(len(q))
        )

    def compute_tangents(self, q: Array) -> Array:
        """Compute an orthonormal basis (nv, k) of the tangents of the singular set at q (nq,).
        Irrelevant coordinates are included.

        It is exact where the set is smooth and its equations are regular.
        """
        nv = self.system.nv
        V = self.compute_null_vectors(q[None])
        J = self.evaluate_equations(q[None], V, V)[1][0]
        null_space = Spectrum(J, 1.0).compute_null_space(Level.ROUGH)[:nv]
        return Spectrum(null_space, 1.0).compute_column_space(Level.ROUGH)


def compute_generic_rank(A: Array) -> int:
    """Compute the largest rank of matrices (k, m, n)."""
    return int(Spectrum(A).compute_ranks(Level.GENERIC).max(initial=0))
