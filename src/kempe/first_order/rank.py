"""Rank of the loop equations at a closed configuration, and the velocities they allow.

The rank is decided by a gap between singular values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from kempe.description.parts import Declared
from kempe.equations import closure_rows
from kempe.equations.closure import Closure
from kempe.equations.slip import compute_unit_rows, has_velocity_constraints
from kempe.errors import InputError, UnsupportedError
from kempe.first_order.constraint_graph import Cluster, ConstraintGraph, Law, build_constraint_graph
from kempe.first_order.screws import Screws, compute_screws
from kempe.numerics.rank import SPARSE, Level, Spectrum
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

CLEAR_GAP = 1e3
"""Ratio of the last singular value that counts to the first that does not, below which the rank is
doubtful."""
AROUND = 0.2
POINTS = 8
"""How far around a configuration, in scaled velocities, and at how many points the sizes of written
rows are looked at.
"""


@dataclass(frozen=True, eq=False)
class ClusterRank:
    """Rank of one cluster of loops, with singular values, self-stresses and null space.

    `values` are parts of the largest, or of what turns and slides do to frames: where rows of
    constraints all vanish, the largest is rounding.
    """

    cluster: Cluster
    jacobian: Array = field(repr=False)
    values: Array
    rank: int
    gap: float
    stresses: Array = field(repr=False)
    """Left null space (equations, k): the wrenches that can run around the loops with no load."""
    null_space: Array = field(repr=False)
    """Null space (velocities of the cluster, k), slides in lengths of a link."""
    size: float = 1.0
    """What `values` are parts of."""

    @property
    def nullity(self) -> int:
        """Number of freedoms to first order: velocities less rank."""
        return len(self.cluster.velocities) - self.rank

    @property
    def n_dependent(self) -> int:
        """Number of equations that depend on the others."""
        return len(self.jacobian) - self.rank


@dataclass(frozen=True, eq=False)
class Rank:
    """Rank of the loop equations of a whole system at the closed configuration `q` (nq,)."""

    q: Array
    clusters: tuple[ClusterRank, ...]
    screws: Screws = field(repr=False)
    units: Array = field(repr=False)
    """Units (nv,) of the scaled velocities: the length of a link for slides, 1 for turns."""

    @cached_property
    def rank(self) -> int:
        """Number of independent equations."""
        return sum(c.rank for c in self.clusters)

    @cached_property
    def nullity(self) -> int:
        """Freedoms to first order: velocities that keep all loops closed."""
        return len(self.units) - self.rank

    @cached_property
    def n_dependent(self) -> int:
        """Number of equations that depend on the others, to first order."""
        return sum(c.n_dependent for c in self.clusters)

    @property
    def gap(self) -> float:
        """Smallest ratio of the last singular value counted in the rank to the first neglected one.

        The smallest over all clusters.
        """
        return min((c.gap for c in self.clusters), default=np.inf)

    @property
    def doubtful(self) -> bool:
        """Whether the rank is uncertain: a small gap, or a singular value near the threshold."""
        return (
            self.gap < CLEAR_GAP
            or self.smallest_counted_value < 10.0 * Level.GENERIC
            or self.largest_neglected_value > 0.1 * Level.GENERIC
        )

    @property
    def largest_neglected_value(self) -> float:
        """Largest singular value not counted in a rank, relative to its cluster's largest; else 0."""
        found = [c.values[c.rank] for c in self.clusters if c.rank < len(c.values)]
        return float(max(found, default=0.0))

    @property
    def smallest_counted_value(self) -> float:
        """Smallest singular value counted in a rank, relative to its cluster's largest; else 1."""
        found = [c.values[c.rank - 1] for c in self.clusters if c.rank]
        return float(min(found, default=1.0))

    @cached_property
    def null_space(self) -> Array:
        """Orthonormal basis (nv, nullity) of the scaled velocities that keep all loops closed."""
        nv = len(self.units)
        out = np.zeros((nv, self.nullity))
        free = np.ones(nv, dtype=bool)
        k = 0
        for c in self.clusters:
            free[c.cluster.velocities] = False
            out[c.cluster.velocities, k : k + c.nullity] = c.null_space
            k += c.nullity
        out[np.flatnonzero(free), np.arange(k, self.nullity)] = 1.0
        return out


def compute_rank(system: Model, q: Array) -> Rank:
    """Compute the rank of the loop equations at a closed configuration `q` (nq,)."""
    s = build_constraint_graph(system)
    at = compute_screws(system, q)
    units = np.where(s.slides, at.length, 1.0)
    written = compute_written_rows(system, q)
    return Rank(
        q,
        tuple(_compute_cluster_rank(system, s, at, c, units, written) for c in s.clusters),
        at,
        units,
    )


def _compute_cluster_rank(
    system: Model,
    s: ConstraintGraph,
    at: Screws,
    c: Cluster,
    units: Array,
    written: Mapping[str, Array],
) -> ClusterRank:
    """Compute the rank of one cluster of loops."""
    J, size = _compute_cluster_jacobian(system, s, at, c, units, written)
    if not J.size:
        n = J.shape[1]
        return ClusterRank(c, J, np.zeros(0), 0, np.inf, np.eye(len(J)), np.eye(n))
    spectrum = Spectrum(J, size)
    stresses = spectrum.left
    r, gap = spectrum.find_clear_rank()
    size = float(spectrum.largest)
    null_space = spectrum.right[r:].T
    return ClusterRank(c, J, spectrum.values / size, r, gap, stresses[:, r:], null_space, size)


def _compute_cluster_jacobian(
    system: Model,
    s: ConstraintGraph,
    at: Screws,
    c: Cluster,
    units: Array,
    written: Mapping[str, Array],
) -> tuple[Array, float]:
    """Compute the scaled Jacobian (rows, velocities) of a cluster, and its largest twist."""
    n = len(c.velocities)
    around = np.zeros((len(c.loops), 6, n))
    if c.loops and len(c.local):
        twists = np.concatenate([at.twists[i] for i in c.edges], axis=1)[:, c.moving]
        own = np.where(c.sliding, at.length, 1.0)
        twists = twists * (c.factor * units[c.velocities[c.local]] / own)
        each = c.cells[:, None, c.owner] * twists
        if c.has_shared_velocities:
            for k, local in enumerate(c.local):
                around[:, :, local] += each[:, :, k]
        else:
            around[:, :, c.local] = each
    near = at.build_shift_matrices([s.loops[k].edge for k in c.loops]) @ around
    size = float(np.sqrt(np.max(np.sum(near * near, axis=1), initial=0.0)))
    closing = [s.edges[s.loops[k].edge] for k in c.loops]
    blocks: list[Array] = []
    for k, edge, twists, there in zip(c.loops, closing, around, near, strict=True):
        if edge.is_joint and not edge.particle:
            blocks.append(there if system.dim == 3 else there[_PLANE])
        else:
            blocks.append(compute_loop_rows(system, s, at, k) @ twists)
    blocks += [_compute_law_rows(system, s.laws[k], written, c.velocities, units) for k in c.laws]
    return np.concatenate(blocks) if blocks else np.zeros((0, n)), size


def _compute_law_rows(
    system: Model, law: Law, written: Mapping[str, Array], columns: np.ndarray, units: Array
) -> Array:
    """Compute the Jacobian (rows, velocities of the cluster) of a law."""
    if isinstance(law.of, Declared):
        return written[law.name][:, columns]
    row = np.zeros((1, system.nv))
    for name, m in ((law.of.of, -1.0), *law.of.sources.items()):
        v = system.structure.velocity_names.index(name)
        row[0, v] += m * units[v]
    return row[:, columns] / np.abs(row).max()


def compute_written_rows(system: Model, q: Array) -> dict[str, Array]:
    """Compute the scaled Jacobian (rows, nv) of each written constraint at q (nq,), by name.

    Each row is divided by its largest norm around q.

    So their size does not depend on units, and where they vanish they are small.
    """
    laws = [law for law in build_constraint_graph(system).laws if isinstance(law.of, Declared)]
    if not laws:
        return {}
    rng = np.random.default_rng(0)  # the same around each q
    scale = closure_rows.pack_full_loops(system, True).scale
    steps = np.concatenate(
        [np.zeros((1, system.nv)), AROUND * rng.normal(size=(POINTS, system.nv)) * scale]
    )
    there = system.structure.layout.integrate_velocity(
        np.broadcast_to(q, (len(steps), len(q))), steps
    )
    J = closure_rows.evaluate_constraints(system, there, True, True)[1]
    out: dict[str, Array] = {}
    for law in laws:
        size = np.linalg.norm(J[:, law.places], axis=2)
        largest = np.max(np.where(np.isfinite(size), size, 0.0), axis=0)
        out[law.name] = J[0, law.places] / np.where(largest > 0.0, largest, 1.0)[:, None]
    return out


_PLANE = [0, 1, 5]


def compute_loop_rows(system: Model, s: ConstraintGraph, at: Screws, loop: int) -> Array:
    """Compute the rows (k, 6) that map the twist around a loop to its closing equations.

    Their transpose maps multipliers to wrenches.

    They read the twist where the loop is closed, so that loops far away in a large mechanism are
    seen as others are.
    """
    i = s.loops[loop].edge
    edge = s.edges[i]
    if isinstance(edge.of, Declared):
        return at.compute_wrench_rows(i, edge.of, system.dim)
    if edge.particle:
        return at.compute_point_rows(i, system.dim)
    whole = at.build_shift_matrices([i])[0]
    return whole if system.dim == 3 else whole[_PLANE]


# ---- velocities that all constraints allow

OPEN = 1e-8
"""Residual, in radians and characteristic lengths, above which a configuration is not closed."""


def compute_allowed_velocities(closure: Closure, q: Array, inputs: Sequence[int] = ()) -> Array:
    """Compute an orthonormal basis (nv, k) of the velocities that all constraints allow at q.

    `q` (nq,) must be closed; velocities are scaled to be without unit.

    Where the `inputs` determine all other velocities of a large mechanism, it is found from theirs.
    """
    if inputs and closure.n >= SPARSE and not has_velocity_constraints(closure.system):
        F, J = closure.evaluate_loops(q)
        if float(np.abs(F).max(initial=0.0)) < OPEN:
            free = Spectrum(J).compute_sparse_null_space(inputs, Level.CLOSED)
            if free is not None:
                return free
    F, J = closure.evaluate_equations(q)
    gap = float(np.abs(F).max(initial=0.0))
    if not gap < OPEN:
        raise InputError(
            f"the loops are open by {gap:.3g} (radians or characteristic lengths); assemble q first"
        )
    if has_velocity_constraints(closure.system):
        A, b = compute_unit_rows(closure.system, q, closure.unit)
        if b.any():
            raise UnsupportedError(
                f"{closure.system.name}: a velocity constraint asks for a speed of its own (b is "
                "not zero), so velocities are not proportional to those of inputs"
            )
        J = np.concatenate([J, A])
    return Spectrum(J).compute_null_space(Level.CLOSED)
