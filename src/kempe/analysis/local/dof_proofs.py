"""Proofs of degrees of freedom: for each cluster of loops a theorem whose hypotheses are checked in
numbers.

What is zero to rounding counts as exactly zero: axes that are parallel to the last digit are
parallel. Dimensions of clusters add up, for clusters share no unknowns. The theorems, in the order
in which they are tried:

- *Regular*: the loop equations, reduced to the group of motions that the joints of each loop
  generate (Herve, 1978), have a Jacobian of full rank, beyond rounding and the error of the
  configuration (`kempe.kinematics.common.newton_certificate`). Then the closed configurations are a
  manifold of as many dimensions as its null space has (implicit function theorem).
- *Two groups*: a loop whose joints part into two chains, each of which fills a group of motions:
  what both groups share moves, and the number is the same everywhere.
- *Families*: a motion in closed form keeps all loops closed (`kempe.analysis.local.known_motions`).
- *Forms*: what the reduction of Lyapunov and Schmidt leaves has leading forms that decide
  (`kempe.analysis.local.leading_forms`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.analysis.first_order.constraint_graph import (
    Cluster,
    ConstraintGraph,
    LoopSizes,
    structure,
)
from kempe.analysis.first_order.counting import fills_group, group_basis
from kempe.analysis.first_order.rank import Rank
from kempe.analysis.first_order.screws import Screws, screws
from kempe.analysis.local import known_motions, leading_forms
from kempe.analysis.local.local_equations import Equations
from kempe.kinematics.common.newton_certificate import Certificate, certify, rounding
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

SAME = 1e-12
"""Parts of a unit screw below this are rounding: the screw lies in the group of motions of the
others."""
LONG = 12
"""Joints of a loop up to which it is parted into two chains."""


class Part(NamedTuple):
    """The equations of one cluster: a basis (m, k) of rows that suffice for each of its loops and
    laws.

    `columns` are the velocities of the cluster, `uses` those of each loop or law.
    """

    cluster: Cluster
    rows: list[Array]
    columns: np.ndarray
    uses: list[np.ndarray]


@dataclass(frozen=True)
class Proof:
    """A dimension that is proven, in how many branches (None: not known), and by what."""

    dim: int
    branches: int | None
    why: str


# ---- ranks beyond rounding


def regular(system: System, rank: Rank, residual: float) -> bool:
    """Whether every cluster provably has full rank at the closed configuration near by."""
    s = structure(system)
    at = rank.screws
    return all(
        _certified(s, at, c.cluster, c.values * c.size, c.jacobian, residual, True).regular
        for c in rank.clusters
    )


def _certified(
    s: ConstraintGraph,
    at: Screws,
    c: Cluster,
    values: Array,
    J: Array,
    residual: float,
    short: bool,
) -> Certificate:
    """The certificate of equations of a cluster, of `short` loops or those of the tree, with
    singular values of J.
    """
    if c.bent:  # of whose second derivatives no bound is known
        return Certificate(False, 0.0, np.inf)
    size = c.size_of_loops(s, short)
    reach = at.reach
    residual *= len(c.loops) * (1.0 + reach) + 1.0  # loops are sums of others, and read elsewhere
    out = certify(
        values,
        J.shape,
        residual,
        _bend(size, at, 2.0 * reach),
        rounding(size.joints, reach),
        J.size,
    )
    if out.regular or not len(c.loops):
        return out
    spans = [  # large mechanisms have small loops
        _reach(np.concatenate([at.F[i, :3, 3], at.M[i, :3, 3]]), at.M[i[0], :3, 3])
        for i in c.paths(s, short)
    ]
    bend = _bend(size, at, 2.0 * max(spans) / at.length)
    return certify(
        values, J.shape, residual, bend, rounding(size.joints, reach), int(np.count_nonzero(J))
    )


def _reach(points: Array, center: Array) -> float:
    d = points - center
    return float(np.sqrt(np.max(np.sum(d * d, axis=1), initial=0.0)))


def _bend(size: LoopSizes, at: Screws, D: float) -> float:
    """A bound of the norm of the second derivatives of the equations of loops whose joints are D
    lengths apart.

    Two unit turns change the pose at the end of a chain by at most its reach, and by 1 as a
    rotation; a slide counts one length more. So a loop of n joints has second derivatives of norm n
    sqrt((D + 1)^2 + 1) at most, and loops that share no joint do not add up.
    """
    bend = float(np.hypot(D + 1.0, 1.0))
    if len(size.rods):
        rods = (
            np.linalg.norm(at.M[size.rods, :3, 3] - at.F[size.rods, :3, 3], axis=1).min()
            / at.length
        )
        bend = max(bend, (D + 1.0) * (D + 1.0 + rods) / max(rods, 1e-300))
    return size.most * bend


# ---- one proof for all clusters


class Prover:
    """Proofs of dimensions at one closed configuration q (nq,)."""

    def __init__(self, system: System, equations: Equations, q: Array):
        self.system = system
        self.equations = equations
        self.q = q
        self.structure = structure(system)
        self.at = screws(system, q)
        self.value, self.jacobian = (x[0] for x in equations.linearise(q))
        self.parts = _parts(system, self.structure, self.at, equations, self.jacobian)
        self.manifolds: dict[int, Proof | _Open | None] = {}

    def manifold(self) -> Proof | None:
        """The dimension, if it is proven to be a manifold of as many dimensions as the null space
        has; else None.
        """
        found: list[Proof] = []
        for k in range(len(self.parts)):
            proof = self._manifold(k)
            if not isinstance(proof, Proof):
                return None
            found.append(proof)
        return self._sum(found)

    def dimension(self, order: int, tangents: Sequence[Array]) -> Proof | None:
        """The dimension, if it can be proven, by forms too; `tangents` (nv, k), in scaled
        coordinates, span motions that were found: where to look.
        """
        rng = np.random.default_rng(0)  # what is proven depends on no seed
        found: list[Proof] = []
        for k, part in enumerate(self.parts):
            proof = self._manifold(k)
            if isinstance(proof, _Open):
                proof = _by_forms(self.equations, self.q, part, proof, order, rng, tangents)
            if proof is None:
                return None
            found.append(proof)
        return self._sum(found)

    def _manifold(self, k: int) -> Proof | _Open | None:
        """The proof for one cluster, what it leaves open, or None where nothing can be proven;
        found once.
        """
        if k not in self.manifolds:
            self.manifolds[k] = _prove(
                self.structure,
                self.at,
                self.equations,
                self.q,
                self.parts[k],
                self.value,
                self.jacobian,
            )
        return self.manifolds[k]

    def _sum(self, found: Sequence[Proof]) -> Proof:
        return _sum(
            [Proof(self.system.nv - sum(len(p.columns) for p in self.parts), 1, ""), *found]
        )


def _sum(found: Sequence[Proof]) -> Proof:
    """Dimensions add up, and numbers of branches multiply."""
    total = sum(p.dim for p in found)
    counts = [1 if p.branches == 0 else p.branches for p in found]  # what rests multiplies none
    count = (
        None
        if None in counts
        else int(np.prod([n for n in counts if n is not None]))
        if total
        else 0
    )
    return Proof(total, count, "; ".join(dict.fromkeys(p.why for p in found if p.why)))


def _parts(
    system: System, s: ConstraintGraph, at: Screws, equations: Equations, J: Array
) -> list[Part]:
    """The equations of each cluster, reduced loop by loop to what its group of motions leaves."""
    edges = equations.rows_of
    out: list[Part] = []
    for c in s.clusters:
        rows: list[Array] = []
        uses: list[np.ndarray] = []
        for k in c.loops:
            path = [i for i, _ in s.loops[k].path]
            own = edges[s.edges[s.loops[k].edge].name]
            rows.append(
                _rows(equations.m, own, _group(system, s, at, k, path, J[own], equations.length))
            )
            uses.append(
                np.unique([col.index for i in path for col in s.edges[i].columns if col.index >= 0])
            )
        for law in (s.laws[k] for k in c.laws):
            rows.append(_rows(equations.m, np.array(law.places), np.eye(law.rows)))
            uses.append(np.array(law.support, dtype=np.int64))
        out.append(Part(c, rows, c.velocities, uses))
    return out


def _rows(m: int, at: np.ndarray, mix: Array) -> Array:
    out = np.zeros((m, mix.shape[1]))
    out[at] = mix
    return out


def _group(
    system: System, s: ConstraintGraph, at: Screws, k: int, path: list[int], J: Array, length: float
) -> Array:
    """Combinations (rows, d) of the rows of a loop that suffice, for its joints generate a group of
    d dimensions.

    The rows of a closing joint read, to first order, the twist of its frame M; so in these
    coordinates the algebra of the group is what rows can become, and nothing else.
    """
    edge = s.edges[s.loops[k].edge]
    rows = s.loops[k].rows
    if not edge.joint or edge.particle:
        return np.eye(rows)
    basis = group_basis(np.concatenate([at.twists[i] for i in path], axis=1), SAME)
    if basis.shape[1] >= rows:
        return np.eye(rows)
    there = at.moved([s.loops[k].edge])[0] @ basis
    R = at.M[s.loops[k].edge, :3, :3]
    there = np.concatenate([R.T @ there[:3] * (at.length / length), R.T @ there[3:]])
    U = np.linalg.qr(there if system.dim == 3 else there[[0, 1, 5]])[0]
    return U if np.abs(J - U @ (U.T @ J)).max(initial=0.0) < 1e-10 else np.eye(rows)


class _Open(NamedTuple):
    """A cluster that is not proven to be a manifold, with a dimension that is proven from below."""

    here: leading_forms.Here
    lower: int


def _prove(
    s: ConstraintGraph,
    at: Screws,
    equations: Equations,
    q: Array,
    part: Part,
    value: Array,
    J: Array,
) -> Proof | _Open | None:
    """The dimension of one cluster, if it is a manifold; None where nothing can be proven."""
    here = leading_forms.split_of(q, J, np.hstack(part.rows), part.columns)
    A = here.matrix
    delta = here.split.delta
    corank = here.split.corank
    own = here.basis.T @ value
    if (
        min(A.shape)
        and _certified(
            s, at, part.cluster, here.values, A, float(np.linalg.norm(own)), False
        ).regular
    ):
        why = "all constraints are independent in the groups of motions of their loops"
        return Proof(
            max(A.shape[1] - A.shape[0], 0),
            1,
            why if delta else "no velocity keeps the loops closed",
        )
    if not corank or not delta:
        return None if len(A) else Proof(delta, 1, "")
    if not here.clear:
        return None
    if here.exact and _two_groups(s, at, part.cluster):
        return Proof(delta, 1, "both chains of the loop fill a group of motions")
    lower = known_motions.dimension(equations, q, [here.split.null_space])
    if lower == delta:
        return Proof(delta, 1, "angles in fixed ratios keep all loops closed")
    if delta == 1 and _half_angles(s, at, equations, q, part.cluster, here.split.null_space[:, 0]):
        return Proof(1, 1, "tangents of half angles in fixed ratios keep the loop closed")
    return _Open(here, lower)


def _by_forms(
    equations: Equations,
    q: Array,
    part: Part,
    known: _Open,
    order: int,
    rng: np.random.Generator,
    tangents: Sequence[Array],
) -> Proof | None:
    """The dimension of one cluster, if leading forms decide."""
    lower = max(
        known.lower,
        known_motions.dimension(equations, q, [_within(t, part.columns) for t in tangents]),
    )
    found = leading_forms.decide(
        equations, known.here, part.rows, part.uses, lower, order, rng, tangents
    )
    return None if found is None else Proof(*found)


def _within(T: Array, columns: np.ndarray) -> Array:
    out = np.zeros_like(T)
    out[columns] = T[columns]
    return out


def _half_angles(
    s: ConstraintGraph, at: Screws, equations: Equations, q: Array, c: Cluster, null_space: Array
) -> bool:
    """Whether the only loop is of four hinges that move as Bennett's do."""
    if len(c.loops) != 1 or c.laws or c.shared or not s.edges[s.loops[c.loops[0]].edge].joint:
        return False
    path = [(i, sign) for i, sign in s.loops[c.loops[0]].path if at.twists[i].shape[1]]
    columns = [x for i, _ in path for x in s.edges[i].columns]
    if len(columns) != 4 or any(
        x.index < 0 or abs(x.multiplier) != 1.0 or x.slides for x in columns
    ):
        return False
    axes = np.stack([sign * at.twists[i][:, 0] for i, sign in path], axis=1)
    if np.abs(np.linalg.norm(axes[3:], axis=0) - 1.0).max() > SAME:
        return False
    return known_motions.half_angles(equations, q, axes, [x.index for x in columns], null_space)


def _two_groups(s: ConstraintGraph, at: Screws, c: Cluster) -> bool:
    """Whether the only loop parts into two chains, each of which makes all motions of the group
    that it generates.
    """
    if len(c.loops) != 1 or c.laws or c.shared or not s.edges[s.loops[c.loops[0]].edge].joint:
        return False
    path = [i for i, _ in s.loops[c.loops[0]].path if at.twists[i].shape[1]]
    if len(path) > LONG or any(
        s.edges[i].particle or any(x.index < 0 for x in s.edges[i].columns) for i in path
    ):
        return False
    n = len(path)
    twists = np.concatenate([at.twists[i] for i in path], axis=1)
    first: list[int] = np.cumsum([0, *(at.twists[i].shape[1] for i in path)]).tolist()
    first += [first[-1] + x for x in first[1:]]
    columns = list(range(first[n])) * 2
    alike = [mask.tolist() for mask in _side_by_side(twists)]
    # from column i on, how many are alike in pairs
    runs = [max(_run(mask, columns, i) for mask in alike) for i in range(len(columns))]

    def may(i: int, k: int) -> bool:
        return first[k] - first[i] > 5 or runs[first[i]] >= first[k] - first[i]

    def fills(i: int, k: int) -> bool:
        return fills_group(twists[:, columns[first[i] : first[k]]], SAME, leading_forms.CLEAR)

    pairs = [(i, k) for i in range(n) for k in range(i + 1, n) if may(i, k) and may(k, i + n)]
    return any(fills(i, k) and fills(k, i + n) for i, k in pairs)


def _run(alike: list[list[bool]], columns: list[int], first: int) -> int:
    """How many columns from the first on are alike, each with itself and all others; more than five
    do not matter.
    """
    for k in range(first, min(first + 6, len(columns))):
        if not all(alike[columns[k]][columns[i]] for i in range(first, k + 1)):
            return k - first
    return 6


def _side_by_side(twists: Array) -> tuple[np.ndarray, np.ndarray]:
    """Which screws (6, n) have parallel turns, or slides, and which are reciprocal, as axes that
    meet: (n, n) masks.

    Fewer than six screws fill a group only if all have parallel turns, or all axes meet in one
    point.
    """
    v = twists[:3].T
    w = twists[3:].T
    turned = np.cross(w[:, None], w[None])
    return np.abs(turned).max(axis=2) < leading_forms.CLEAR, np.abs(
        v @ w.T + w @ v.T
    ) < leading_forms.CLEAR
