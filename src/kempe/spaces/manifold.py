"""Closed configurations as a manifold in coordinate space: tangents, normals, and projection.

Lengths count in characteristic lengths, angles in radians: the coordinates of all joints with this
measure are the space around, and volumes on the manifold are those that it induces there (of
rotations: Haar's measure).
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.assemble.same_configuration import get_metric
from kempe.equations import closure_rows
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.model.configurations import find_free_angles, sample_configurations, shorten_turns
from kempe.numerics.newton import run_many_gauss_newton, solve_many_least_squares
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

CLOSED = 1e-9
"""Norm of the closure equations, in radians and characteristic lengths, up to which a configuration
is closed."""
TRIES = 30
STEEP = 0.5
"""Steps of a search for the manifold, and the longest: that of starts many lengths away is not
bounded."""
NEWTON = 8
EXACT = 1e-11
LONGEST = 10.0
NEARER = 0.7
"""Steps of Newton's method, the norm of the equations at which it ends, that from which it does not
begin, and the part of it that is left after a step, at most."""


class Frames(NamedTuple):
    """Orthonormal bases of tangents (k, nv, p) and normals (k, nv, nv - p). A mask (k,) tells
    whether points are regular.
    """

    tangent: Array
    normal: Array
    regular: np.ndarray


class Manifold:
    """The closed configurations of a system within its limits, where they have dimension `dim`."""

    def __init__(self, system: Model, dim: int):
        self.system = system
        self.dim = dim
        self.scale = closure_rows.compute_coordinate_units(system)
        self.layout = system.structure.layout
        self.circle = find_free_angles(system)
        self.one_sided = pack_one_sided_rows(system)
        self.metric = get_metric(system)

    def evaluate_equations(self, q: Array) -> tuple[Array, Array]:
        """Evaluate residuals (k, m) of the equations at q (k, nq), and their derivatives (k, m,
        nv).
        """
        return closure_rows.evaluate_constraints(self.system, q, True, True)

    def move_configurations(self, q: Array, y: Array) -> Array:
        """Move configurations q (k, nq) by tangent vectors y (k, nv)."""
        return self.layout.integrate_velocity(q, y * self.scale)

    def compute_steps(self, q: Array, to: Array) -> Array:
        """Compute the shortest steps (k, nv) from q (k, nq) to other configurations. Unlimited
        joints turn the short way.
        """
        return shorten_turns(self.layout.compute_difference(q, to), self.circle) / self.scale

    def compute_distances(self, q: Array, to: Array) -> Array:
        """Compute the lengths (k,) of the steps of `compute_steps`."""
        return np.linalg.norm(self.compute_steps(q, to), axis=-1)

    def are_allowed(self, q: Array) -> np.ndarray:
        """Whether (k,) limits and one-sided constraints hold at q (k, nq)."""
        return np.asarray((self.one_sided.compute_excess(q) <= 0.0).all(axis=-1))

    def close_configurations(self, q: Array, longest: float = STEEP) -> tuple[Array, np.ndarray]:
        """Find closed configurations (k, nq) near q (k, nq), by least steps. A mask (k,) tells
        whether they close.
        """
        out = run_many_gauss_newton(
            lambda x, _: self.evaluate_equations(x),
            q,
            TRIES,
            longest=longest,
            move=self.move_configurations,
        )
        return out, self._are_closed(out)

    def draw_configurations(self, rng: np.random.Generator, count: int) -> Array:
        """Draw closed configurations (k, nq) from random starts, without regard to limits."""
        starts = sample_configurations(self.system, rng, count)
        q, ok = self.close_configurations(starts)
        if not ok.any():
            q, ok = self.close_configurations(starts, np.inf)
        return q[ok]

    def compute_frames(self, q: Array) -> Frames:
        """Compute tangents and normals at closed q (k, nq)."""
        J = self.evaluate_equations(q)[1]
        rank = self.system.nv - self.dim
        if not rank:
            eye = np.broadcast_to(np.eye(self.system.nv), (len(q), self.system.nv, self.system.nv))
            return Frames(eye, eye[..., :0], np.ones(len(q), dtype=bool))
        if J.shape[1] == rank:
            Q, R = np.linalg.qr(np.swapaxes(J, -1, -2), mode="complete")
            size = np.abs(np.einsum("kii->ki", R[:, :rank]))
            return Frames(
                Q[..., rank:],
                Q[..., :rank],
                size.min(axis=1) > Level.GENERIC * np.maximum(size.max(axis=1), 1e-300),
            )
        spectrum = Spectrum(J)
        V = np.swapaxes(spectrum.right, -1, -2)
        return Frames(V[..., rank:], V[..., :rank], spectrum.compute_ranks(Level.GENERIC) == rank)

    def lift_steps(self, q: Array, y: Array, normal: Array) -> tuple[Array, np.ndarray]:
        """Lift tangent steps `y` (k, nv) at q (k, nq) onto the manifold, by normals. A mask (k,)
        tells whether that succeeds.

        By Newton's method from no normals at all, which is given up where it does not come much
        nearer at each step.
        """
        step = np.array(y)
        found = np.zeros(len(q), dtype=bool)
        left = np.arange(len(q))
        before = np.full(len(q), np.inf)
        for k in range(NEWTON):
            r, J = self.evaluate_equations(self.move_configurations(q[left], step[left]))
            size = np.linalg.norm(r, axis=1)
            met = size < EXACT
            found[left[met]] = True
            go_on = ~met & (size < NEARER * before if k else size < LONGEST)
            if not go_on.any():
                break
            left = left[go_on]
            before = size[go_on]
            N = normal[left]
            a = solve_least_squares(J[go_on] @ N, -r[go_on])
            step[left] += np.einsum("kij,kj->ki", N, a)
        return step, found

    def _are_closed(self, q: Array) -> np.ndarray:
        """Whether (k,) the equations hold at q (k, nq)."""
        out = np.asarray(np.isfinite(q).all(axis=-1))
        size = np.linalg.norm(
            closure_rows.evaluate_constraints(
                self.system, np.where(out[:, None], q, 0.0), False, True
            )[0],
            axis=-1,
        )
        return out & (size < CLOSED)


def solve_least_squares(A: Array, b: Array) -> Array:
    """Solve A y = b for y (k, n) by least squares, for A (k, m, n) of rank n and b (k, m)."""
    if A.shape[1] == A.shape[2]:
        with contextlib.suppress(np.linalg.LinAlgError):
            return np.asarray(np.linalg.solve(A, b[..., None])[..., 0], dtype=float)
    return solve_many_least_squares(A, b)
