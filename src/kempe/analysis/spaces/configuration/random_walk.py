"""A random walk on the closed configurations whose limit is uniform: Metropolis's algorithm on a
manifold.

Source: Zappa, Holmes-Cerfon, Goodman, "Monte Carlo on manifolds: sampling densities and integrating
functions", Comm. Pure Appl. Math. 71 (2018): a step along the tangent space, led back along the
normals of where it began, is taken only if the step back would be found, too. In rotations steps
are exponentials; the determinants that compare the volumes of the two steps are transposes of one
another, as in flat space, because the measure is invariant on both sides.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from kempe.analysis.spaces.configuration.manifold import Frames
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.analysis.spaces.configuration.manifold import Manifold

FIRST = 0.5
"""Standard deviation of the first steps in each tangent direction, in radians and characteristic
lengths."""
WANTED = 0.45
"""Share of steps that shall be taken: the length of steps is fitted to it before anything is
kept."""
BACK = 1e-6
"""How far the step back may miss where it came from."""
LEAST = 1e-3
LARGEST = 2.0


class Walkers:
    """Walkers on a manifold at q (k, nq), each by itself, with steps of standard deviation `sigma`."""

    def __init__(self, manifold: Manifold, q: Array, rng: np.random.Generator):
        self.manifold = manifold
        self.rng = rng
        self.sigma = FIRST
        frames = manifold.frames(q)
        self.q = q[frames.regular]
        self.frames = Frames(*(x[frames.regular] for x in frames))
        self.steps = self.moves = 0

    @property
    def taken(self) -> float:
        """Share of the steps that were taken since they are counted."""
        return self.moves / max(1, self.steps)

    def fit(self, steps: int, check: Callable[[], None]) -> None:
        """Take so many steps whose length `sigma` is fitted."""
        for _ in range(steps):
            check()
            share = self._step()
            self.sigma = float(np.clip(self.sigma * np.exp(0.5 * (share - WANTED)), LEAST, LARGEST))

    def walk(self, steps: int, check: Callable[[], None]) -> None:
        """Take so many steps of one length."""
        for _ in range(steps):
            check()
            self._step()

    def _step(self) -> float:
        m = self.manifold
        q = self.q
        f = self.frames
        k = len(self.q)
        v = self.sigma * self.rng.normal(size=(k, m.dim))
        chance = np.log(np.maximum(self.rng.random(k), 1e-300))
        step, ok = m.lifted(q, _along(f.tangent, v), f.normal)
        who = np.flatnonzero(ok)
        y = m.move(q[who], step[who])
        who, y = _some(m.inside(y), who, y)
        there = m.frames(y)
        back = -np.einsum("kij,ki->kj", there.tangent, step[who])
        likely = np.sum(v[who] ** 2, axis=1) - np.sum(back**2, axis=1)
        taken = there.regular & (chance[who] < likely / (2.0 * self.sigma**2))
        who, y, back, tangent, normal = _some(taken, who, y, back, there.tangent, there.normal)
        returned, found = m.lifted(y, _along(tangent, back), normal)
        found &= np.linalg.norm(returned + step[who], axis=1) < BACK
        who = who[found]
        self.q[who], f.tangent[who], f.normal[who] = _some(found, y, tangent, normal)
        self.steps = self.steps + k
        self.moves = self.moves + len(who)
        return len(who) / max(1, k)


def _some(which: np.ndarray, *arrays: np.ndarray) -> tuple[np.ndarray, ...]:
    return tuple(x[which] for x in arrays)


def _along(basis: Array, v: Array) -> Array:
    return np.einsum("kij,kj->ki", basis, v)
