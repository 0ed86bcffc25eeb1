"""Lyapunov-Schmidt reduction of the constraint equations at a closed configuration.

Let N span the null space of the Jacobian J at q0 and U its left null space. Curves q(t) = q0 (+) (N
s(t) + w(t)), w normal to the null space, fulfil all equations but U^T phi, order by order, if w_k =
-J^+ phi_k; what is left, g(s) = U^T phi, has as many unknowns as the null space has dimensions, and
its zeros are the solution set near q0 (Golubitsky, Schaeffer, 1985, chapter VII). All g_k being
zero, every null vector is a velocity and the set is a manifold of that dimension.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kempe.mobility.local_equations import Equations
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

LEAST = 0.1
"""What the largest singular value counts as at least: equations are scaled, and where all vanish it
is rounding."""
ZERO = 1e-9
"""Taylor coefficients below this count as zero; curves are scaled so that their own coefficients
are at most one."""
NOT_ZERO = 1e-6
"""Taylor coefficients above this count as not zero; between the two nothing is certain."""
DISTURBANCE = 1e-8
ROUNDING = 1e-10
"""Size of the disturbance that shows how errors grow, and of the errors themselves, with a
margin."""


@dataclass(frozen=True, eq=False)
class Split:
    """A configuration q (nq,) with the singular value decomposition of the scaled Jacobian there."""

    q: Array
    sigma: Array
    null_space: Array
    """Orthonormal basis (nv, delta) of the null space, in scaled coordinates."""
    cokernel: Array
    """Orthonormal basis (m, corank) of the left null space: self-stresses."""
    inverse: Array
    """Pseudo-inverse (nv, m) of rank r."""

    @property
    def delta(self) -> int:
        """Nullity of the Jacobian: dimension of its null space."""
        return self.null_space.shape[1]

    @property
    def corank(self) -> int:
        """Number of rows less the rank."""
        return self.cokernel.shape[1]

    @property
    def rank(self) -> int:
        """Rank of the Jacobian."""
        return len(self.null_space) - self.delta

    @property
    def gap(self) -> float:
        """Ratio of the smallest singular value above the rank tolerance to the largest below.

        It is infinite where none is below.
        """
        if self.rank == 0:
            return np.inf
        rest = self.sigma[self.rank :]
        floor = 1e-16 * float(self.sigma[0])
        return (
            float(self.sigma[self.rank - 1]) / max(float(rest[0]), floor) if len(rest) else np.inf
        )


def split_equations(equations: Equations, q: Array, level: float = Level.GENERIC) -> Split:
    """Split the equations at q (nq,): singular value decomposition of their Jacobian."""
    return split_jacobian(q, equations.linearise_equations(q)[1][0], level)


def split_jacobian(q: Array, J: Array, level: float = Level.GENERIC) -> Split:
    """Split a Jacobian (m, nv), with its rank at this level."""
    return split_jacobians(q[None], J[None], level)[0]


def split_jacobians(q: Array, J: Array, level: float = Level.GENERIC) -> list[Split]:
    """Split Jacobians (N, m, nv) at many configurations (N, nq)."""
    return [
        Split(
            p,
            x.values,
            x.compute_null_space(level),
            x.compute_left_null_space(level),
            x.compute_pseudo_inverse(level),
        )
        for p, x in zip(q, Spectrum(J, LEAST), strict=True)
    ]


def sample_unit_vectors(rng: np.random.Generator, n: int, dim: int) -> Array:
    """Sample random unit vectors (n, dim)."""
    d = rng.normal(size=(n, dim))
    return d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-300)


def sample_axes(rng: np.random.Generator, dim: int) -> Array:
    """Sample unit vectors (2 dim, dim), both ways along the axes of a random frame."""
    d = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    return np.concatenate([d, -d])


@dataclass(frozen=True, eq=False)
class Obstruction:
    """Sizes (order + 1,) of the coefficients of the reduced equations, and their errors."""

    size: Array
    noise: Array

    @property
    def order(self) -> int | None:
        """First order whose coefficients are not zero; None if there is none."""
        found = np.flatnonzero(self.size > np.maximum(NOT_ZERO, self.noise))
        return int(found[0]) if found.size else None

    @property
    def doubt(self) -> float:
        """Largest coefficient below that order that is not surely zero; 0 if there is none."""
        size = self.size[: self.order]
        noise = self.noise[: self.order]
        return float(np.max(size[size > np.maximum(ZERO, noise)], initial=0.0))


def measure_obstruction(
    equations: Equations, at: Split, order: int, rng: np.random.Generator
) -> Obstruction:
    """Measure the reduced equations, order by order, along random curves of the null space.

    Half of the curves are straight lines. A form that vanishes in one random direction vanishes,
    with probability one, so the lines alone test all of g; the others are there because a second
    computation of the same catches a slip.

    Errors grow from order to order, near another singular point quickly: by how much is seen from a
    second run with w disturbed at every order.
    """
    n = at.delta + 4
    s = make_lines(sample_unit_vectors(rng, 2 * n, at.delta), order)
    for k in range(2, order + 1):
        s[n:, k] = 0.5**k * rng.normal(size=(n, at.delta))
    g, slow = _solve_coefficients(equations, at, s, None)
    across = rng.normal(size=(len(s), order + 1, equations.nv))
    across -= across @ at.null_space @ at.null_space.T
    across *= DISTURBANCE / np.maximum(np.linalg.norm(across, axis=2, keepdims=True), 1e-300)
    disturbed, _ = _solve_coefficients(equations, at, s, across)
    rest = at.sigma[at.rank : at.rank + 1]
    error = ROUNDING + (float(rest[0]) if rest.size else 0.0)
    return Obstruction(
        _compute_largest_norms(g / slow),
        _compute_largest_norms((disturbed - g) / slow) * error / DISTURBANCE,
    )


def _compute_largest_norms(g: Array) -> Array:
    """Compute the largest norm (order + 1,) of coefficients g over all curves."""
    return np.max(np.linalg.norm(g, axis=2), axis=0, initial=0.0)


def _solve_coefficients(
    equations: Equations, at: Split, s: Array, across: Array | None
) -> tuple[Array, Array]:
    """Solve for coefficients g_k (n, order + 1, corank) of the reduced equations along curves.

    The curves s (n, order + 1, delta) are in the null space; the scale of the coefficients follows.

    Divided by the scale (n, order + 1, 1) they belong to curves slowed down until none of their
    coefficients, those of w included, is over one. s[:, 0] is unused.
    """
    n: int
    depth: int
    n, depth = s.shape[:2]
    series = equations.make_series(at.q, n, depth - 1)
    g = np.zeros((n, depth, at.corank))
    fastest = np.ones(n)
    for k in range(1, depth):
        x = s[:, k] @ at.null_space.T
        series.set_coefficients(k, x)
        phi = series.compute_values(k - 1, k)
        g[:, k] = phi @ at.cokernel
        x = x - phi @ at.inverse.T
        if across is not None:
            x = x + across[:, k]
        series.set_coefficients(k, x)
        fastest = np.maximum(fastest, np.linalg.norm(x, axis=1) ** (1.0 / k))
    return g, (fastest[:, None] ** np.arange(depth, dtype=float))[..., None]


def make_lines(directions: Array, order: int) -> Array:
    """Make curves (n, order + 1, delta) straight along directions (n, delta)."""
    s = np.zeros((len(directions), order + 1, directions.shape[1]))
    s[:, 1] = directions
    return s


def find_lineality(equations: Equations, at: Split, k: int, rng: np.random.Generator) -> Array:
    """Find a basis (delta, l) of the directions along which the leading form is constant.

    The form is that of order k.

    The derivative of a form G of degree k along u, at random d: the linear coefficient of G(d + tau
    u) in tau, by interpolation in k + 1 points. Where the solution set is a manifold that the
    equations describe with multiplicity (they touch it), these are the only directions that can be
    tangent to it.
    """
    delta = at.delta
    n = at.delta + 2
    tau = np.cos(np.pi * (np.arange(k + 1) + 0.5) / (k + 1))
    pick = np.linalg.inv(np.vander(tau, increasing=True))[1]
    d = sample_unit_vectors(rng, n, delta)
    # (n, delta, k + 1, delta)
    points = d[:, None, None, :] + tau[:, None] * np.eye(delta)[:, None, :]
    flat = points.reshape(-1, delta)
    size = np.linalg.norm(flat, axis=1)
    g = (
        _solve_coefficients(equations, at, make_lines(flat / size[:, None], k), None)[0][:, k]
        * (size**k)[:, None]
    )
    gradient = np.einsum("ndtc,t->ncd", g.reshape(n, delta, k + 1, at.corank), pick).reshape(
        -1, delta
    )
    return Spectrum(gradient).compute_null_space(Level.ROUGH)
