"""Closed configurations at which two functions have the values of a lattice, found from node to
node.

Each configuration that is found at a node leads by Newton's method to those of its neighbours, from
many random ones on. What is found is closed and has the values of its node; that nothing else
exists is evidence, not proof.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from kempe.analysis.spaces.configuration.manifold import CLOSED, Manifold
from kempe.kinematics.common.gauss_newton import gauss_newton_of_many
from kempe.solvers.assembly.idle import not_spun, spin_rates
from kempe.solvers.common.clock import BROKEN_OFF, TimeLimit, TimeUp
from kempe.spatial import Array
from kempe.status import Status

MOST = 64
"""Configurations of one node, at most."""
SAME = 1e-4
"""Difference, in radians and characteristic lengths, up to which configurations of one node are
one."""
NEAR = 3.0
"""How far configurations of neighbours may be apart, in parts of a turn along the lattice, to be of
one sheet."""
DAMPING = 1e-13
"""What is added to normal equations, as a part of their trace."""
TRIES = 10
FIRST = 40
LONGEST = 0.4
"""Steps of Newton's method, those from where nothing is known yet, and the longest."""
FOLLOWED = 0.5
"""How far apart neighbours on a line are at most, in radians and characteristic lengths."""
AT_ONCE = 1 << 14
"""Configurations that are solved for at once."""

Missing = Callable[[Array, np.ndarray], tuple[Array, Array]]
"""What two functions miss (k, m) at configurations (k, nq), at nodes of numbers (k,), and
derivatives (k, m, nv)."""


class Lattice(NamedTuple):
    """Configurations `q` (n, k, nq) of the nodes, which there are (`mask` (n, k)), and what broke
    the search off.
    """

    q: Array
    mask: np.ndarray
    broken: Status | None = None


class NodeSolver:
    """Closed configurations at which two functions have given values, which are isolated but for
    idle spins.

    What spins idly is left as it is, and configurations that differ by that only are one.
    """

    def __init__(self, manifold: Manifold):
        self.manifold = manifold
        self.counts = not_spun(manifold.system)
        self.spins = not self.counts.all()

    def solved(
        self, missing: Missing, q: Array, node: np.ndarray, tries: int = TRIES
    ) -> tuple[Array, np.ndarray]:
        """Where Newton's method leads from q (k, nq), and whether (k,) nothing is `missing` there
        at the node (k,).
        """
        M = self.manifold

        def equations(x: Array, at: np.ndarray) -> tuple[Array, Array]:
            (F, J) = M.equations(x)
            (f, j) = missing(x, node[at])
            still = spin_rates(M.system, x) if self.spins else J[:, :0]
            zero = np.zeros(still.shape[:2])
            return np.concatenate([F, f, zero], axis=1), np.concatenate(
                [J, j, still * M.scale], axis=1
            )

        x = gauss_newton_of_many(
            equations, q, tries, step=_step, met=1e-3 * CLOSED, longest=LONGEST, move=M.move
        )
        sound = np.isfinite(x).all(axis=1)
        x[~sound] = q[~sound]
        size = np.abs(equations(x, np.arange(len(x)))[0]).max(axis=1, initial=0.0)
        return x, sound & (size < CLOSED)

    def apart(self, q: Array, to: Array) -> Array:
        """How far (...) configurations (..., nq) are from others."""
        return self.manifold.metric.distances(q, to, self.counts)

    def same(self, q: Array, to: Array) -> np.ndarray:
        """Whether (...) configurations (..., nq) are the same as others."""
        return self.apart(q, to) < SAME

    def different(self, q: Array) -> Array:
        """Those of configurations (k, nq) that are no repetition of one before."""
        keep: list[Array] = []
        for x in q:
            if not keep or not self.same(x[None], np.array(keep)).any():
                keep.append(x)
        return np.array(keep).reshape(-1, q.shape[1])


def _step(r: Array, J: Array) -> Array:
    """Gauss-Newton steps (k, n), damped so little that only those of singular equations are other
    ones.
    """
    Jt = np.swapaxes(J, -1, -2)
    G = Jt @ J
    n = G.shape[-1]
    G[:, np.arange(n), np.arange(n)] += (DAMPING * np.einsum("kii->k", G) + 1e-300)[:, None]
    return np.asarray(-np.linalg.solve(G, Jt @ r[..., None])[..., 0], dtype=float)


def flooded(
    solver: NodeSolver,
    missing: Missing,
    shape: tuple[int, int],
    q: Array,
    node: np.ndarray,
    clock: TimeLimit,
    progress: Callable[[int, int], Any] | None = None,
) -> Lattice:
    """The configurations of a lattice of `shape` that are found from q (k, nq) near the nodes of
    numbers (k,).

    `progress` is called with the number of nodes that have some, and that of all.
    """
    found = np.full((shape[0] * shape[1], 4, q.shape[1]), np.nan)
    count = np.zeros(shape[0] * shape[1], dtype=int)
    broken = None
    tries = FIRST
    swept = False
    near = NEAR * 2.0 * np.pi / max(shape)
    try:
        while len(q):
            new = list[tuple[np.ndarray, np.ndarray]]()
            for i in range(0, len(q), AT_ONCE):
                clock.check()
                x, ok = solver.solved(missing, q[i : i + AT_ONCE], node[i : i + AT_ONCE], tries)
                found = _added(solver, found, count, x[ok], node[i : i + AT_ONCE][ok], new)
            at, slot = (
                np.concatenate([x[k] for x in new]).astype(int) if new else np.zeros(0, dtype=int)
                for k in (0, 1)
            )
            if progress is not None:
                progress(int((count > 0).sum()), len(count))
            tries = TRIES
            swept = swept and not len(at)
            q, node = _to_neighbours(solver, shape, found, count, at, slot, near)
            if not len(q) and not swept:  # all that have more than a neighbour, once more
                at, slot = np.nonzero(np.arange(found.shape[1]) < count[:, None])
                q, node = _to_neighbours(solver, shape, found, count, at, slot, 0.0)
                swept = True
    except BROKEN_OFF as error:
        broken = Status.OUT_OF_TIME if isinstance(error, TimeUp) else Status.INTERRUPTED
    most = max(int(count.max(initial=0)), 1)
    return Lattice(found[:, :most], np.arange(most) < count[:, None], broken)


def _added(
    solver: NodeSolver,
    found: Array,
    count: np.ndarray,
    q: Array,
    node: np.ndarray,
    new: list[tuple[np.ndarray, np.ndarray]],
) -> Array:
    """Put those of configurations (k, nq) that their nodes (k,) lack into `found`; which these are
    goes to `new`.
    """
    order = np.argsort(node, kind="stable")
    q = q[order]
    node = node[order]
    first = np.searchsorted(node, node)
    rank = np.arange(len(node)) - first  # the several candidates of a node come one after another
    for k in range(int(rank.max(initial=-1)) + 1):
        x = q[rank == k]
        at = node[rank == k]
        known = np.zeros(len(at), dtype=bool)
        for slot in range(int(count[at].max(initial=0))):
            there = slot < count[at]
            known[there] |= solver.same(x[there], found[at[there], slot])
        x = x[~known & (count[at] < MOST)]
        at = at[~known & (count[at] < MOST)]
        if count[at].max(initial=0) >= found.shape[1]:
            found = np.concatenate([found, np.full_like(found, np.nan)], axis=1)
        found[at, count[at]] = x
        new.append((at, count[at].copy()))
        count[at] += 1
    return found


def _to_neighbours(
    solver: NodeSolver,
    shape: tuple[int, int],
    found: Array,
    count: np.ndarray,
    node: np.ndarray,
    slot: np.ndarray,
    near: float,
) -> tuple[Array, np.ndarray]:
    """Configurations, each as a start for those neighbours of its node that have fewer, or none so
    `near` to it.
    """
    i, j = np.divmod(node, shape[1])
    starts = [found[:0, 0]]
    nodes = [node[:0]]
    for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        ok = (0 <= i + di) & (i + di < shape[0]) & (0 <= j + dj) & (j + dj < shape[1])
        q = found[node[ok], slot[ok]]
        to = (i[ok] + di) * shape[1] + j[ok] + dj
        fewer = count[node[ok]]
        lacks = count[to] < fewer
        if near:
            lacks |= ~np.any(
                [
                    (k < count[to]) & (solver.apart(q, found[to, k]) < near)
                    for k in range(int(count[to].max(initial=1)))
                ],
                axis=0,
            )
        starts.append(q[lacks])
        nodes.append(to[lacks])
    return np.concatenate(starts), np.concatenate(nodes)


def in_order(solver: NodeSolver, q: Array, mask: np.ndarray) -> tuple[Array, np.ndarray]:
    """Configurations (n, k, nq) along a line, and which (n, k) there are, so ordered that each
    follows its like.
    """
    q = q.copy()
    mask = mask.copy()
    like: Array = q[0].copy()
    for i in range(len(q)):
        far = solver.apart(like[:, None], q[i][None])
        far = np.where(mask[i] & np.isfinite(far), far, np.pi)
        order = _matched(far)
        q[i] = q[i, order]
        mask[i] = mask[i, order]
        # what is too far to follow begins a line of its own
        mask[i] &= (far[np.arange(len(order)), order] < FOLLOWED) | (i == 0) | ~mask[i - 1]
        like = np.where((mask[i] | ~np.isfinite(like).all(axis=1))[:, None], q[i], like)
    return q, mask


def _matched(far: Array) -> np.ndarray:
    """For each of k rows of distances (k, k) a column of its own, the nearest pairs first."""
    out = np.full(len(far), -1)
    used = set[int]()
    for at in np.argsort(far, axis=None).tolist():
        row, column = divmod(at, len(far))
        if out[row] < 0 and column not in used:
            out[row] = column
            used.add(column)
    return out


def nodes_around(x: Array, y: Array, p: Array) -> np.ndarray:
    """Numbers (k, 4) of the corners of the cells of a lattice x (m,), y (n,) in which places p (k,
    2) are.
    """
    i, j = (
        np.clip(((p[:, k] - side[0]) // (side[1] - side[0])).astype(int), 0, len(side) - 2)
        for k, side in enumerate((x, y))
    )
    return np.stack([(i + a) * len(y) + j + b for a in (0, 1) for b in (0, 1)], axis=1)


def nearest_node(x: Array, y: Array, p: Array) -> np.ndarray:
    """Numbers (k,) of the nodes of a lattice x (m,), y (n,) that are nearest to places p (k, 2)."""
    i, j = (
        np.clip(np.rint((p[:, k] - side[0]) / (side[1] - side[0])), 0, len(side) - 1).astype(int)
        for k, side in enumerate((x, y))
    )
    return i * len(y) + j
