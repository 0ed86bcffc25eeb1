"""How a configuration is made up, and its tangent vectors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.joints import Q
from kempe.reals import reals


@dataclass(frozen=True)
class Layout:
    """How an array `q` is made up: plain coordinates, and unit quaternions (w, x, y, z) whose
    velocities are angular.

    `vector_q[i]` is the coordinate whose velocity is `vector_v[i]`; a quaternion starts at
    `quaternion_q[k]`, its three angular velocities, in the axes of the turned frame, at
    `quaternion_v[k]`.
    """

    nq: int
    nv: int
    vector_q: np.ndarray
    vector_v: np.ndarray
    quaternion_q: np.ndarray
    quaternion_v: np.ndarray

    @cached_property
    def neutral(self) -> spatial.Array:
        """Zero coordinates and identity quaternions (nq,); read-only."""
        q = np.zeros(self.nq)
        q[self.quaternion_q] = 1.0
        q.setflags(write=False)
        return q

    def _quaternions(self, q: spatial.Array) -> spatial.Array:
        return q[..., self.quaternion_q[:, None] + np.arange(4)]

    def integrate(self, q: ArrayLike, v: ArrayLike) -> spatial.Array:
        """Configuration (..., nq) reached from `q` by the tangent vector `v` (..., nv) in one unit
        of time.
        """
        q = reals(q, "q")
        v = reals(v, "v")
        out = np.array(
            np.broadcast_to(q, (*np.broadcast_shapes(q.shape[:-1], v.shape[:-1]), self.nq))
        )
        out[..., self.vector_q] += v[..., self.vector_v]
        if self.quaternion_q.size:
            w = v[..., self.quaternion_v[:, None] + np.arange(3)]
            turned = spatial.quat_wxyz_multiply(
                spatial.unit(self._quaternions(q)), spatial.quat_wxyz_exp(w)
            )
            out[..., self.quaternion_q[:, None] + np.arange(4)] = spatial.unit(turned)
        return out

    def difference(self, q0: ArrayLike, q1: ArrayLike) -> spatial.Array:
        """Tangent vector (..., nv) that `integrate` needs to go from `q0` to `q1`; rotations go the
        short way.
        """
        q0 = reals(q0, "q0")
        q1 = reals(q1, "q1")
        out = np.zeros((*np.broadcast_shapes(q0.shape[:-1], q1.shape[:-1]), self.nv))
        out[..., self.vector_v] = q1[..., self.vector_q] - q0[..., self.vector_q]
        if self.quaternion_q.size:
            a = spatial.unit(self._quaternions(q0))
            b = spatial.unit(self._quaternions(q1))
            w = spatial.quat_wxyz_log(spatial.quat_wxyz_multiply(spatial.quat_wxyz_conjugate(a), b))
            out[..., self.quaternion_v[:, None] + np.arange(3)] = w
        return out

    def random_quaternions(
        self, q: spatial.Array, rng: np.random.Generator, order: np.ndarray | None = None
    ) -> None:
        """Fill the quaternions of `q` (..., nq), in place, with uniformly distributed rotations."""
        for k in range(self.quaternion_q.size) if order is None else order:
            i = self.quaternion_q[k]
            q[..., i : i + 4] = spatial.unit(rng.normal(size=(*q.shape[:-1], 4)))


def layout_of(primitives: list[tuple[int, int, int]], nq: int, nv: int) -> Layout:
    """`Layout` of (kind, first coordinate, first velocity) triples, one for each independent
    primitive.
    """
    vectors = [(iq, iv) for kind, iq, iv in primitives if kind != Q]
    balls = [(iq, iv) for kind, iq, iv in primitives if kind == Q]
    vector = np.array(vectors, dtype=np.int64).reshape(-1, 2)
    ball = np.array(balls, dtype=np.int64).reshape(-1, 2)
    for array in (vector, ball):
        array.setflags(write=False)
    return Layout(nq, nv, vector[:, 0], vector[:, 1], ball[:, 0], ball[:, 1])
