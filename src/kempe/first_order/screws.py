"""Joints as screws: the twists of all joints of a system at one configuration.

All twists are [v; w] of the child relative to the parent, in axes of the ground, at one reference
point in the middle of the mechanism, with lengths in units of a typical link: so ranks and
self-stresses depend neither on the cut nor on units, nor do singular values fade with the number of
links.
A closed loop says that the twists around it add up to zero (Davies, 1981); what multiplies that
equation is the wrench that runs around the loop, and the wrench in a joint is the sum of those of
the loops through it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from kempe import spatial
from kempe.constraints.base import COUNTS, Op, Row, list_position_rows
from kempe.description.parts import Declared
from kempe.equations.closure_rows import pack_full_loops
from kempe.first_order.constraint_graph import Edge, build_constraint_graph
from kempe.forward.fk import fk
from kempe.joints import P, Q
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model


@dataclass(frozen=True, eq=False)
class Screws:
    """The screws of all edges of the constraint graph at a closed configuration.

    `twists[i]` (6, columns of edge i), scaled as the module says; `F`, `M` (n, 4, 4) are the frames
    in the ground.
    """

    twists: tuple[Array, ...]
    F: Array
    M: Array
    center: Array
    length: float
    cross: dict[int, Array] = field(repr=False)
    """Rotation after the first turn of the joints whose constraint directions it carries
    (crosses)."""

    @cached_property
    def reach(self) -> float:
        """Largest distance of a frame from the reference point, in characteristic lengths."""
        d = np.concatenate([self.F[:, :3, 3], self.M[:, :3, 3]]) - self.center
        return float(np.sqrt(np.max(np.sum(d * d, axis=1), initial=0.0))) / self.length

    def compute_wrench_rows(self, edge: int, of: Declared, dim: int) -> Array:
        """Compute the rows (k, 6) that map a relative twist to the rates of a declared constraint."""
        rows = (r for r in list_position_rows(of.of, dim) if r.op not in (Op.TAPE, Op.CALL))
        return np.concatenate([self._compute_rate_rows(edge, r, dim) for r in rows])

    def _compute_rate_rows(self, edge: int, row: Row, dim: int) -> Array:
        """Compute the rows (k, 6) that map the twist of M relative to F to the rates of `row`."""
        p = self.M[edge, :3, 3]
        R = self.F[edge, :3, :3]
        S = self.M[edge, :3, :3]
        d = p - self.F[edge, :3, 3]
        if row.op in (Op.ROTATION, Op.TILT):
            turns = np.hstack([np.zeros((3, 3)), R.T])
            return (
                turns[-COUNTS[row.op][dim] :]
                if row.op is Op.ROTATION
                else turns[: COUNTS[row.op][dim]]
            )
        # z of M keeps to -d: v / |d| + w x z across it; in the plane x of M is the normal
        if row.op is Op.LOOK:
            across = S[:, 2 - COUNTS[row.op][dim] : 2].T
            along = across * (self.length / (float(np.linalg.norm(d)) or 1.0))
            return np.hstack(
                [
                    along,
                    np.cross(S[:, 2], across) + np.cross((p - self.center) / self.length, along),
                ]
            )
        along = R[:, row.args[0]] if row.op is Op.POINT else d / (float(np.linalg.norm(d)) or 1.0)
        return np.hstack([along, np.cross((p - self.center) / self.length, along)])[None]

    def compute_point_rows(self, edge: int, dim: int) -> Array:
        """Compute the rows (dim, 6) that map a twist to the velocity of the origin of frame M."""
        r = (self.M[edge, :3, 3] - self.center) / self.length
        return np.hstack([np.eye(3), -spatial.skew(r)])[:dim]

    def build_shift_matrices(self, edges: Sequence[int]) -> Array:
        """Build matrices (n, 6, 6) that move twists to the origins of the frames M of edges."""
        out = np.zeros((len(edges), 6, 6))
        out[:, range(6), range(6)] = 1.0
        x, y, z = ((self.M[list(edges), :3, 3] - self.center) / self.length).T
        out[:, 0, 4] = z
        out[:, 0, 5] = -y
        out[:, 1, 5] = x
        out[:, 1, 3] = -z
        out[:, 2, 3] = y
        out[:, 2, 4] = -x
        return out


def compute_screws(system: Model, q: Array) -> Screws:
    """Compute the screws of all joints at a closed configuration `q` (nq,)."""
    s = build_constraint_graph(system)
    bodies = fk(system, q)
    F = bodies[s.parent] @ s.X_PF
    M = bodies[s.child] @ s.X_CM
    points = M[:, :3, 3]
    center = points.mean(axis=0) if len(points) else np.zeros(3)
    length = pack_full_loops(system, True).length
    twists: list[Array] = []
    cross: dict[int, Array] = {}
    values = q.tolist()
    for i, edge in enumerate(s.edges):
        if not edge.is_joint:
            twists.append(np.zeros((6, 0)))
        elif len(edge.primitives) == 1 and edge.primitives[0].kind != Q:
            axis = F[i, :3, "xyz".index(edge.primitives[0].axis)] * edge.primitives[0].multiplier
            twists.append(
                _compute_twist(edge.primitives[0].kind, axis, (F[i, :3, 3] - center) / length)[
                    :, None
                ]
            )
        else:
            twists.append(_compute_joint_twists(edge, F[i], M[i], values, center, length, cross, i))
    return Screws(tuple(twists), F, M, center, length, cross)


def _compute_twist(kind: int, axis: Array, r: Array) -> Array:
    """Compute the scaled twist (6,) of a rotation about, or a slide along, an axis through r."""
    out = np.zeros(6)
    if kind == P:
        out[:3] = axis
    else:
        x, y, z = axis.tolist()
        a, b, c = r.tolist()
        out[:] = b * z - c * y, c * x - a * z, a * y - b * x, x, y, z
    return out


def _compute_joint_twists(
    edge: Edge,
    F: Array,
    M: Array,
    q: list[float],
    center: Array,
    length: float,
    cross: dict[int, Array],
    i: int,
) -> Array:
    """Compute the twists (6, columns) of a joint with several primitives, beginning at frame F."""
    X = F.copy()
    out = np.zeros((6, len(edge.columns)))
    last = len(edge.primitives) - 1
    for k, (p, column) in enumerate(zip(edge.primitives, edge.drives, strict=True)):
        r = (X[:3, 3] - center) / length
        if p.kind == Q:
            out[:3, column : column + 3] = spatial.skew(r) @ M[:3, :3]
            out[3:, column : column + 3] = M[:3, :3]
            continue
        axis = X[:3, "xyz".index(p.axis)].copy()
        unit = (
            p.multiplier / length
            if p.kind == P and not edge.columns[column].slides
            else p.multiplier
        )
        out[:, column] += _compute_twist(p.kind, axis * unit, r)
        if k < last:
            index, factor, offset = edge.values[p.coordinate]
            value = p.multiplier * ((factor * q[index] if index >= 0 else 0.0) + offset)
            if p.kind == P:
                X[:3, 3] += value * axis
            else:
                X[:3, :3] = X[:3, :3] @ spatial.make_rotation(value, p.axis)
                cross.setdefault(i, X[:3, :3].copy())
    return out
