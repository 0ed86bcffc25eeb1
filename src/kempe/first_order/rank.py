"""Rank of the loop equations at a closed configuration, and the velocities they allow.

The rank is decided by a gap between singular values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kempe.description.parts import Declared
from kempe.equations import closure_rows
from kempe.equations.closure import Closure
from kempe.equations.slip import compute_unit_rows, has_velocity_constraints
from kempe.errors import InputError, UnsupportedError
from kempe.first_order.constraint_graph import Cluster, ConstraintGraph, Law, build_constraint_graph
from kempe.first_order.screws import Screws, compute_screws
from kempe.numerics.rank import FLOOR, SPARSE, Level, Spectrum
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

CLEAR_GAP = 1e3
"""Ratio of the last singular value that counts to the first that does not, below which the rank is
doubtful."""
BANDED = 400
"""Velocities of a cluster from which on its equations are looked at as banded ones."""
NARROW = 0.1
"""Bandwidth, as a part of the equations, up to which that is worth while."""
CLEARLY = 10.0
"""How far above what counts the smallest singular value is where the rank is clearly full."""
PROJECTIONS = 4
"""Projections of random vectors on the null space: each reduces the error of the last."""
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
    found = _find_full_rank(J, size) if J.shape[1] >= BANDED else None
    if found is not None:
        values, null_space = found
        size = max(float(values[0]), size)
        values = values / size
        gap = float(values[-1]) / FLOOR
        return ClusterRank(c, J, values, len(J), gap, np.zeros((len(J), 0)), null_space, size)
    spectrum = Spectrum(J, size)
    stresses = spectrum.left
    r, gap = spectrum.find_clear_rank()
    size = float(spectrum.largest)
    null_space = spectrum.right[r:].T
    return ClusterRank(c, J, spectrum.values / size, r, gap, stresses[:, r:], null_space, size)


def _find_full_rank(J: Array, size: float) -> tuple[Array, Array] | None:
    """Return singular values and null space (n, n - m) of J (m, n) where its rank is clearly m.

    `J J^T` of many loops is banded where each shares velocities with few others. Its eigenvalues
    are the squares of the singular values, to half of the digits: enough above the level of what
    counts. The null space is what projections leave of random vectors. None where the band is wide,
    or the rank not clearly full.
    """
    m, n = J.shape
    if m > n:
        return None
    import scipy.linalg  # only here: they take long
    import scipy.sparse
    import scipy.sparse.csgraph

    library = cast(Any, scipy.sparse)
    rows = library.csr_matrix(J)
    gram = (rows @ rows.T).tocsr()
    order = library.csgraph.reverse_cuthill_mckee(gram, symmetric_mode=True)
    gram = gram[order][:, order].tocoo()
    width = int(np.max(gram.row - gram.col, initial=0))
    if width > NARROW * m:
        return None
    lower = gram.row >= gram.col
    band = np.zeros((width + 1, m))
    band[(gram.row - gram.col)[lower], gram.col[lower]] = gram.data[lower]
    linear = cast(Any, scipy.linalg)
    values = np.sqrt(np.maximum(linear.eigvals_banded(band, lower=True)[::-1], 0.0))
    if not values[-1] > CLEARLY * Level.GENERIC * max(float(values[0]), size):
        return None
    rows = rows[order]
    factor = linear.cholesky_banded(band, lower=True), True
    basis = np.random.default_rng(0).normal(size=(n, n - m))
    for _ in range(PROJECTIONS):
        basis -= rows.T @ linear.cho_solve_banded(factor, rows @ basis)
        basis = np.linalg.qr(basis)[0]
    return values, basis


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
    edges = [s.loops[k].edge for k in c.loops]
    shifts = at.build_shift_matrices(edges)
    loop, column, around = _compute_loop_twists(at, c, units)
    near = np.einsum("kij,kj->ki", shifts[loop], around)
    size = float(np.sqrt(np.max(np.sum(near * near, axis=1), initial=0.0)))
    ends = np.searchsorted(loop, np.arange(len(c.loops) + 1)).tolist()
    entries: list[Array] = []
    for i, k in enumerate(c.loops):
        own = slice(ends[i], ends[i + 1])
        edge = s.edges[edges[i]]
        if edge.is_joint and not edge.particle:
            entries.append(near[own].T if system.dim == 3 else near[own].T[_PLANE])
        else:
            entries.append(compute_loop_rows(system, s, at, k) @ around[own].T)
    laws = [_compute_law_rows(system, s.laws[k], written, c.velocities, units) for k in c.laws]
    J = np.zeros((sum(map(len, entries)) + sum(map(len, laws)), n))
    row = 0
    for i, values in enumerate(entries):
        J[row : row + len(values), column[ends[i] : ends[i + 1]]] = values
        row += len(values)
    for values in laws:
        J[row : row + len(values)] = values
        row += len(values)
    return J, size


def _compute_loop_twists(
    at: Screws, c: Cluster, units: Array
) -> tuple[np.ndarray, np.ndarray, Array]:
    """Compute the scaled twists (k, 6) that velocities of a cluster cause around its loops.

    Returned are the loops (k,), ascending, the columns (k,) of the velocities, and the twists, for
    all pairs of a loop and a velocity that moves it.
    """
    if not c.loops or not len(c.local):
        none = np.zeros(0, dtype=np.int64)
        return none, none, np.zeros((0, 6))
    twists = np.concatenate([at.twists[i] for i in c.edges], axis=1)[:, c.moving]
    own = np.where(c.sliding, at.length, 1.0)
    twists = twists * (c.factor * units[c.velocities[c.local]] / own)
    loop, edge = np.nonzero(c.cells)
    first = np.searchsorted(c.owner, np.arange(len(c.edges) + 1))
    count = np.diff(first)[edge]
    pair = np.repeat(np.arange(len(loop)), count)
    moving = first[edge[pair]] + np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count)
    each = c.cells[loop[pair], edge[pair]][:, None] * twists[:, moving].T
    n = len(c.velocities)
    key, place = np.unique(loop[pair] * n + c.local[moving], return_inverse=True)
    around = np.zeros((len(key), 6))
    np.add.at(around, place, each)
    return key // n, key % n, around


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


def refuse_open_loops(residual: Array) -> None:
    """Raise `InputError` where the `residual` of the scaled equations says that loops are open."""
    gap = float(np.abs(residual).max(initial=0.0))
    if not gap < OPEN:
        raise InputError(
            f"the loops are open by {gap:.3g} (radians or characteristic lengths); assemble q first"
        )


def compute_allowed_velocities(closure: Closure, q: Array, inputs: Sequence[int] = ()) -> Array:
    """Compute an orthonormal basis (nv, k) of the velocities that all constraints allow at q.

    `q` (nq,) must be closed; velocities are scaled to be without unit.

    Where the `inputs` determine all other velocities of a large mechanism, it is found from theirs.
    """
    if inputs and closure.n >= SPARSE and not has_velocity_constraints(closure.system):
        F, J, i, j = closure.evaluate_sparse_loops(q)
        if float(np.abs(F).max(initial=0.0)) < OPEN:
            free = Spectrum(J).compute_sparse_null_space(inputs, Level.CLOSED, (i, j))
            if free is not None:
                return free
    F, J = closure.evaluate_equations(q)
    refuse_open_loops(F)
    if has_velocity_constraints(closure.system):
        A, b = compute_unit_rows(closure.system, q, closure.unit)
        if b.any():
            raise UnsupportedError(
                f"{closure.system.name}: a velocity constraint asks for a speed of its own (b is "
                "not zero), so velocities are not proportional to those of inputs"
            )
        J = np.concatenate([J, A])
    return Spectrum(J).compute_null_space(Level.CLOSED)
