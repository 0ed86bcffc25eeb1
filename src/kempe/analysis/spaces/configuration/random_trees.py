"""Two random trees that grow towards one another on the closed configurations, and the way where they meet.

Sources: Kuffner, LaValle, "RRT-Connect", ICRA 2000; Berenson, Srinivasa, Ferguson, Kuffner, "Manipulation planning on
constraint manifolds", ICRA 2009: each step towards a sample is led back onto the manifold.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from kempe.kinematics.configuration import random
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.analysis.spaces.configuration.manifold import Manifold
    from kempe.solvers.common.clock import TimeLimit

FEWEST = 0.1
"""Part of a step that must be left of the distance to the aim, and of the step itself, to go on."""
SHORTCUTS = 60
"""Shortcuts that are tried."""
DEEPEST = 12
"""How often the way between two points is halved."""
BENT = 1.5
"""How much longer the two halves of a step may be than the step: else it is a jump."""


class Tree:
    """Configurations `q` (n, nq), each reached from that of its `parent`."""

    def __init__(self, manifold: Manifold, root: Array):
        self.manifold, self.q, self.parent = manifold, root[None], [-1]

    def nearest(self, q: Array) -> int:
        """The number of the configuration nearest to q (nq,)."""
        return int(np.argmin(self.manifold.apart(self.q, np.broadcast_to(q, self.q.shape))))

    def grow(self, aim: Array, step: float, time: TimeLimit) -> int:
        """The number of the configuration from which no step leads nearer to the aim (nq,), added step by step."""
        at = self.nearest(aim)
        for q in stepped(self.manifold, self.q[at], aim, step, time):
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
    manifold: Manifold, q: Array, aim: Array, step: float, time: TimeLimit, most: float = math.inf
) -> list[Array]:  # fmt: skip
    """Configurations on the manifold, within limits, by which one comes from q towards an aim (nq,).

    It ends where more than `most` steps would be needed, even straight.
    """
    left = float(manifold.apart(q[None], aim[None])[0])
    out: list[Array] = []
    while left > 1e-9 and len(out) + left / step <= most + 1e-9:
        time.check()
        way = manifold.between(q[None], aim[None])
        if manifold.dim < manifold.system.nv:
            tangent = manifold.frames(q[None]).tangent[0]
            way = (tangent @ (tangent.T @ way[0]))[None] if left > step else way
        size = float(np.linalg.norm(way))
        if size < FEWEST * step and left > step:
            break
        x, ok = manifold.closed(manifold.move(q[None], way * min(1.0, step / max(size, 1e-300))))
        gone, rest = float(manifold.apart(q[None], x)[0]), float(manifold.apart(x, aim[None])[0])
        if not ok[0] or not manifold.inside(x)[0] or gone > BENT * step or rest > left - FEWEST * min(step, left):
            break
        q, left = x[0], rest
        out.append(q)
    return out


def joined(
    manifold: Manifold, a: Array, b: Array, step: float, rng: np.random.Generator, most: int, time: TimeLimit
) -> tuple[Array | None, int]:  # fmt: skip
    """A way (n, nq) from a to b on the manifold, or None, and how many configurations the trees have."""
    coarse = 2.0 * step
    trees = [Tree(manifold, a), Tree(manifold, b)]
    for k in range(most):
        time.check()
        one, other = trees[k % 2], trees[1 - k % 2]
        aim = other.q[0] if k < 2 else random(manifold.system, rng)
        here = one.grow(aim, coarse, time)
        there = other.grow(one.q[here], coarse, time)
        if manifold.apart(one.q[here][None], other.q[there][None])[0] < 1e-9:
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
) -> list[Array]:  # fmt: skip
    """The way with shortcuts between points of it."""
    for _ in range(SHORTCUTS):
        if len(way) < 3:
            break
        i, j = map(int, np.sort(rng.choice(len(way), 2, replace=False)))
        cut = stepped(manifold, way[i], way[j], step, time, j - i - 1)
        if cut and len(cut) < j - i and manifold.apart(cut[-1][None], way[j][None])[0] < 1e-9:
            way = [*way[: i + 1], *cut, *way[j + 1 :]]
    return way


def _refined(manifold: Manifold, way: list[Array], step: float, time: TimeLimit) -> Array | None:
    """The way with no step longer than `step`, each once more halved without a jump; None where there is one."""
    out, waiting = [way[0]], [(q, 0) for q in way[:0:-1]]
    while waiting:
        time.check()
        q, depth = waiting.pop()
        far = float(manifold.apart(out[-1][None], q[None])[0])
        half = manifold.move(out[-1][None], 0.5 * manifold.between(out[-1][None], q[None]))
        middle, ok = manifold.closed(half)
        ends = np.stack([out[-1], q])
        parts = manifold.apart(np.repeat(middle, 2, axis=0), ends)
        if not ok[0] or not manifold.inside(middle)[0] or parts.sum() > BENT * far + 1e-12 or depth > DEEPEST:
            return None
        if far > step:
            waiting += [(q, depth + 1), (middle[0], depth + 1)]
        else:
            out.append(q)
    return np.array(out)
