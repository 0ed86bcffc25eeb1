"""Two random trees that grow towards one another on the closed configurations, and the way where
they meet.

Sources: Kuffner, LaValle, "RRT-Connect", ICRA 2000; Berenson, Srinivasa, Ferguson, Kuffner,
"Manipulation planning on constraint manifolds", ICRA 2009: each step towards a sample is led back
onto the manifold.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.kinematics.configuration import random
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.analysis.spaces.configuration.manifold import Manifold
    from kempe.solvers.common.clock import TimeLimit

FEWEST = 0.1
"""Part of a step that must be left of the distance to the aim, and of the step itself, to go on."""
ROUNDS = 4
SHORTCUTS = 30
"""Rounds of shortcuts, and how many are tried in each, at most."""
MET = 1e-9
"""Length up to which an aim counts as reached."""
DEEPEST = 12
"""How often the way between two points is halved."""
BENT = 1.5
"""How much longer the two halves of a step may be than the step: else it is a jump."""


class Tree:
    """Configurations `q` (n, nq), each reached from that of its `parent`."""

    def __init__(self, manifold: Manifold, root: Array):
        self.manifold = manifold
        self.q = root[None]
        self.parent = [-1]

    def nearest(self, q: Array) -> int:
        """The number of the configuration nearest to q (nq,)."""
        return int(np.argmin(self.manifold.apart(self.q, np.broadcast_to(q, self.q.shape))))

    def grow(self, aim: Array, step: float, time: TimeLimit) -> int:
        """The number of the configuration from which no step leads nearer to the aim (nq,), added
        step by step.
        """
        at = self.nearest(aim)
        for q in stepped(self.manifold, self.q[at][None], aim[None], step, time)[0]:
            self.q, at = np.concatenate([self.q, q[None]]), self._add(at)
        return at

    def _add(self, parent: int) -> int:
        self.parent.append(parent)
        return len(self.parent) - 1

    def way(self, at: int) -> list[Array]:
        """Configurations from the root to one of its own."""
        out: list[Array] = []
        while at >= 0:
            out.append(self.q[at])
            at = self.parent[at]
        return out[::-1]


def stepped(
    manifold: Manifold, q: Array, aims: Array, step: float, time: TimeLimit, most: Any = np.inf
) -> list[list[Array]]:
    """Configurations on the manifold, within limits, by which one comes from each q (k, nq) towards
    its aim (k, nq).

    It ends where more than `most` steps would be needed, even straight.
    """
    out: list[list[Array]] = [[] for _ in q]
    at = np.array(q)
    left = manifold.apart(q, aims)
    most = np.broadcast_to(most, len(q)) + 1e-9
    on = np.flatnonzero((left > MET) & (left / step <= most))
    while len(on):
        time.check()
        before = at[on]
        aim = aims[on]
        far = left[on] > step
        way = manifold.between(before, aim)
        if manifold.dim < manifold.system.nv and far.any():
            T = manifold.frames(before[far]).tangent
            way[far] = np.einsum("kip,kp->ki", T, np.einsum("kip,ki->kp", T, way[far]))
        size = np.linalg.norm(way, axis=1)
        x, ok = manifold.closed(
            manifold.move(before, way * np.minimum(1.0, step / np.maximum(size, 1e-300))[:, None])
        )
        gone = manifold.apart(before, x)
        rest = manifold.apart(x, aim)
        ok &= (
            manifold.inside(x)
            & (gone <= BENT * step)
            & (rest <= left[on] - FEWEST * np.minimum(step, left[on]))
        )
        ok &= ~far | (size >= FEWEST * step)
        on = on[ok]
        x = x[ok]
        rest = rest[ok]
        for k, i in enumerate(map(int, on)):
            out[i].append(x[k])
        at[on] = x
        left[on] = rest
        taken = np.array([len(out[i]) for i in map(int, on)], dtype=int)
        on = on[(rest > MET) & (taken + rest / step <= most[on])]
    return out


def joined(
    manifold: Manifold,
    a: Array,
    b: Array,
    step: float,
    rng: np.random.Generator,
    most: int,
    time: TimeLimit,
) -> tuple[Array | None, int]:
    """A way (n, nq) from a to b on the manifold, or None, and how many configurations the trees
    have.
    """
    coarse = 2.0 * step
    trees = [Tree(manifold, a), Tree(manifold, b)]
    for k in range(most):
        time.check()
        one = trees[k % 2]
        other = trees[1 - k % 2]
        aim = other.q[0] if k < 2 else random(manifold.system, rng)
        here = one.grow(aim, coarse, time)
        there = other.grow(one.q[here], coarse, time)
        if manifold.apart(one.q[here][None], other.q[there][None])[0] < MET:
            ways = one.way(here), other.way(there)
            first, second = ways if k % 2 == 0 else ways[::-1]
            rough = [*first, *second[::-1][1:]]
            fine = _refined(manifold, _shortened(manifold, rough, coarse, rng, time), step, time)
            if fine is None:
                fine = _refined(manifold, rough, step, time)
            if fine is not None:
                return fine, len(one.q) + len(other.q)
            trees = [Tree(manifold, a), Tree(manifold, b)]
    return None, sum(len(t.q) for t in trees)


def _shortened(
    manifold: Manifold, way: list[Array], step: float, rng: np.random.Generator, time: TimeLimit
) -> list[Array]:
    """The way with shortcuts between points of it: in each round those that save most, and do not
    overlap.
    """
    for _ in range(ROUNDS):
        if len(way) < 3:
            break
        ends = np.unique(np.sort(rng.integers(len(way), size=(SHORTCUTS, 2)), axis=1), axis=0)
        ends = ends[ends[:, 1] - ends[:, 0] > 1]
        points = np.array(way)
        i = ends[:, 0]
        j = ends[:, 1]
        cuts = stepped(manifold, points[i], points[j], step, time, j - i - 1)
        pairs: list[tuple[int, int]] = ends.tolist()
        better = [
            (len(cut) - (b - a), a, b, cut)
            for (a, b), cut in zip(pairs, cuts, strict=True)
            if cut and manifold.apart(cut[-1][None], way[b][None])[0] < MET
        ]
        kept: list[tuple[int, int, list[Array]]] = []
        for _, a, b, cut in sorted(better, key=lambda found: found[:3]):
            if all(b <= c or a >= d for c, d, _ in kept):
                kept.append((a, b, cut))
        if not kept:
            break
        for a, b, cut in sorted(kept, key=lambda found: found[0], reverse=True):
            way = [*way[: a + 1], *cut, *way[b + 1 :]]
    return way


def _refined(manifold: Manifold, way: list[Array], step: float, time: TimeLimit) -> Array | None:
    """The way with no step longer than `step`, each once more halved without a jump; None where
    there is one.
    """
    q = np.array(way)
    for _ in range(DEEPEST):
        time.check()
        far = manifold.apart(q[:-1], q[1:])
        half, ok = manifold.closed(manifold.move(q[:-1], 0.5 * manifold.between(q[:-1], q[1:])))
        parts = manifold.apart(q[:-1], half) + manifold.apart(half, q[1:])
        if not (ok & manifold.inside(half) & (parts <= BENT * far + 1e-12)).all():
            return None
        long = far > step
        if not long.any():
            return q
        q = np.insert(q, np.flatnonzero(long) + 1, half[long], axis=0)
    return None
