"""A random walk on the closed configurations whose limit is uniform: Metropolis's algorithm on a manifold.

Source: Zappa, Holmes-Cerfon, Goodman, "Monte Carlo on manifolds: sampling densities and integrating functions",
Comm. Pure Appl. Math. 71 (2018): a step along the tangent space, led back along the normals of where it began, is taken
only if the step back would be found, too. In rotations steps are exponentials; the determinants that compare the
volumes of the two steps are transposes of one another, as in flat space, because the measure is invariant on both
sides.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.analysis.spaces.configuration.manifold import Frames, Manifold

FIRST = 0.5
"""Standard deviation of the first steps in each tangent direction, in radians and characteristic lengths."""
WANTED = 0.45
"""Share of steps that shall be taken: the length of steps is fitted to it before anything is kept."""
BACK = 1e-6
"""How far the step back may miss where it came from."""
LEAST, LARGEST = 1e-3, 2.0


class Walkers:
    """Walkers on a manifold at q (k, nq), each by itself; `taken` is the share of the steps that were taken."""

    def __init__(self, manifold: Manifold, q: Array, rng: np.random.Generator):
        self.manifold, self.rng, self.sigma = manifold, rng, FIRST
        self.frames = manifold.frames(q)
        self.q = q[self.frames.regular]
        self.frames = self.frames._replace(**{
            "tangent": self.frames.tangent[self.frames.regular], "normal": self.frames.normal[self.frames.regular],
            "regular": self.frames.regular[self.frames.regular]})  # fmt: skip
        self.steps = self.moves = 0

    @property
    def taken(self) -> float:
        """Share of the steps that were taken since they are counted."""
        return self.moves / max(1, self.steps)

    def fit(self, steps: int, check: Callable[[], None]) -> None:
        """Take so many steps whose length is fitted; nothing of them is counted."""
        for _ in range(steps):
            check()
            share = self._step()
            self.sigma = float(np.clip(self.sigma * np.exp(0.5 * (share - WANTED)), LEAST, LARGEST))
        self.steps = self.moves = 0

    def walk(self, steps: int, check: Callable[[], None]) -> None:
        """Take so many steps of one length."""
        for _ in range(steps):
            check()
            self._step()

    def _step(self) -> float:
        m, q, f, k = self.manifold, self.q, self.frames, len(self.q)
        v = self.sigma * self.rng.normal(size=(k, m.dim))
        chance = np.log(np.maximum(self.rng.random(k), 1e-300))
        step, ok = m.lifted(q, _along(f.tangent, v), f.normal)
        y = m.move(q, np.where(ok[:, None], step, 0.0))
        there = m.frames(y)
        ok &= there.regular & m.inside(y)
        back = -np.einsum("kij,ki->kj", there.tangent, step)
        ok &= chance < (np.sum(v * v, axis=1) - np.sum(back * back, axis=1)) / (2.0 * self.sigma**2)
        who = np.flatnonzero(ok)
        if len(who):
            returned, found = m.lifted(y[who], _along(there.tangent[who], back[who]), there.normal[who])
            ok[who] = found & (np.linalg.norm(returned + step[who], axis=1) < BACK)
        self._take(y, there, ok)
        self.steps, self.moves = self.steps + k, self.moves + int(ok.sum())
        return float(ok.mean()) if k else 0.0

    def _take(self, y: Array, there: Frames, ok: np.ndarray) -> None:
        wide = ok[:, None, None]
        self.q = np.where(ok[:, None], y, self.q)
        f = self.frames
        self.frames = f._replace(tangent=np.where(wide, there.tangent, f.tangent),
                                 normal=np.where(wide, there.normal, f.normal))  # fmt: skip


def _along(basis: Array, v: Array) -> Array:
    return np.einsum("kij,kj->ki", basis, v)
