"""Closed configurations as a manifold in the space of all coordinates: tangents, normals, and the way back onto it.

Lengths count in characteristic lengths, angles in radians: the coordinates of all joints with this measure are the
space around, and volumes on the manifold are those that it induces there (of rotations: Haar's measure).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.kinematics import closure_rows
from kempe.kinematics.common.gauss_newton import gauss_newton_of_many
from kempe.kinematics.configuration import by_short_turns, circles, random
from kempe.kinematics.one_sided import one_sided_rows
from kempe.solvers.modes.same_configuration import metric_of
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

CLOSED = 1e-9
"""Norm of the closure equations, in radians and characteristic lengths, up to which a configuration is closed."""
REGULAR = 1e-6
"""Singular value, as a part of the largest, below which a constraint counts as dependent on others."""
TRIES, STEEP = 30, 0.5
"""Steps of a search for the manifold, and the longest."""


class Frames(NamedTuple):
    """Orthonormal bases of tangents (k, nv, p) and normals (k, nv, nv - p), and whether (k,) the point is regular."""

    tangent: Array
    normal: Array
    regular: np.ndarray


class Manifold:
    """The closed configurations of a system where they have dimension `dim`, within its limits."""

    def __init__(self, system: System, dim: int):
        self.system, self.dim = system, dim
        self.scale, self.layout = closure_rows.scales(system), system.structure.layout
        self.circle, self.one_sided, self.metric = circles(system), one_sided_rows(system), metric_of(system)

    def equations(self, q: Array) -> tuple[Array, Array]:
        """What is missing (k, m) in the equations at q (k, nq), and the derivatives (k, m, nv)."""
        return closure_rows.evaluate(self.system, q, True, True)

    def move(self, q: Array, y: Array) -> Array:
        """Configurations (k, nq) reached from q (k, nq) by y (k, nv)."""
        return self.layout.integrate(q, y * self.scale)

    def between(self, q: Array, to: Array) -> Array:
        """The shortest way (k, nv) from q (k, nq) to other configurations; what is not limited turns the short way."""
        return by_short_turns(self.layout.difference(q, to), self.circle) / self.scale

    def apart(self, q: Array, to: Array) -> Array:
        """Lengths (k,) of the ways `between`."""
        return np.linalg.norm(self.between(q, to), axis=-1)

    def inside(self, q: Array) -> np.ndarray:
        """Whether (k,) limits and one-sided constraints hold at q (k, nq)."""
        return np.asarray((self.one_sided.beyond(q) <= 0.0).all(axis=-1))

    def closed(self, q: Array) -> tuple[Array, np.ndarray]:
        """Closed configurations (k, nq) near q (k, nq), by steps of least size, and whether (k,) they are closed."""
        out = gauss_newton_of_many(lambda x, _: self.equations(x), q, TRIES, longest=STEEP, move=self.move)
        return out, self._met(out)

    def drawn(self, rng: np.random.Generator, count: int) -> Array:
        """Closed configurations (k, nq), those to which so many random ones lead; limits are not looked at."""
        q, ok = self.closed(random(self.system, rng, count))
        return q[ok]

    def frames(self, q: Array) -> Frames:
        """Tangents and normals at closed q (k, nq)."""
        J, rank = self.equations(q)[1], self.system.nv - self.dim
        if not rank:
            eye = np.broadcast_to(np.eye(self.system.nv), (len(q), self.system.nv, self.system.nv))
            return Frames(eye, eye[..., :0], np.ones(len(q), dtype=bool))
        _, s, Vt = np.linalg.svd(J, full_matrices=True)
        least = REGULAR * np.maximum(s[:, 0], 1e-300)
        regular = s[:, rank - 1] > least
        if s.shape[1] > rank:
            regular &= s[:, rank] < least
        V = np.swapaxes(Vt, -1, -2)
        return Frames(V[..., rank:], V[..., :rank], regular)

    def lifted(self, q: Array, y: Array, normal: Array) -> tuple[Array, np.ndarray]:
        """Steps (k, nv) from q (k, nq) onto the manifold: `y` (k, nv) and a combination of normals; whether (k,)."""

        def at(a: Array, who: np.ndarray) -> Array:
            return y[who] + np.einsum("kij,kj->ki", normal[who], a)

        def both(a: Array, who: np.ndarray) -> tuple[Array, Array]:
            r, J = self.equations(self.move(q[who], at(a, who)))
            return r, J @ normal[who]

        every = np.arange(len(q))
        a = gauss_newton_of_many(both, np.zeros(normal.shape[::2]), TRIES, longest=2.0 * STEEP)
        step = at(a, every)
        return step, self._met(self.move(q, step))

    def _met(self, q: Array) -> np.ndarray:
        out = np.asarray(np.isfinite(q).all(axis=-1))
        size = np.linalg.norm(
            closure_rows.evaluate(self.system, np.where(out[:, None], q, 0.0), False, True)[0], axis=-1
        )
        return out & (size < CLOSED)
