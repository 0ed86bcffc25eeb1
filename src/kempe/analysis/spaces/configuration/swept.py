"""The components of a curve whose branches are known over one coordinate: circles and arcs, by proof.

Branches are joined where intervals touch (`branch_intervals`), and where they meet: where the function of a sign is
zero, the curve goes on with the other sign; where that of a limit is, it ends. Where a sign's function only touches
zero, four branches meet, or one point lies alone. Where something is open, as where several functions vanish at once,
all branches of which nothing is known may be joined: the number of components is a lower bound then.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from kempe.analysis.spaces.configuration.branch_intervals import (
    ALIVE,
    DEAD,
    LEFT,
    OPEN,
    POINT,
    RIGHT,
    TOUCH,
    Cells,
    Decider,
)
from kempe.analysis.spaces.configuration.dyad_branches import LIMIT, Branches
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.solvers.common.clock import TimeLimit

AT_LEFT, AT_RIGHT = (ALIVE, LEFT, TOUCH, OPEN), (ALIVE, RIGHT, TOUCH, OPEN)
"""States with which a branch is there, or may be, at the left and right ends of an interval."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """A curve of k branches with `signs` (k, m) over n intervals, its `cells`.

    `label` (n, k) is the number of the component of each branch on each interval, from 0 to `count` - 1, or -1; `ends`
    (count,) is how many ends each component has: 2 if it is an arc.
    """

    branches: Branches
    signs: Array
    cells: Cells
    label: np.ndarray
    count: int
    ends: np.ndarray

    @property
    def complete(self) -> bool:
        """Whether the number of components is proven, not only a lower bound."""
        return not bool(self.cells.open.any())

    @cached_property
    def starts(self) -> Array:
        """A configuration (count, nq) on each component, in the middle of its widest interval."""
        wide = np.where(self.cells.state == ALIVE, (self.cells.high - self.cells.low)[:, None], 0.0)
        middle = 0.5 * (self.cells.low + self.cells.high)
        x, which = np.empty(self.count), np.empty(self.count, dtype=int)
        for c in range(self.count):
            i, which[c] = np.unravel_index(int(np.argmax(np.where(self.label == c, 1.0 + wide, 0.0))), wide.shape)
            place = self.cells.place[i, which[c]]
            x[c] = middle[i] if np.isnan(place) else place
        return self.branches.at(x, self.signs[which])

    @cached_property
    def crossings(self) -> Array:
        """Configurations (j, nq) at which branches touch."""
        i, k = np.nonzero((self.cells.state == TOUCH) | (self.cells.state == POINT))
        once = self.signs[k, self.cells.kind[i, k]] > 0.0
        return self.branches.at(self.cells.place[i, k][once], self.signs[k[once]])

    def labels(self, q: Array) -> np.ndarray:
        """The components (n,) of configurations (n, nq); -1 where it is not certain."""
        b, out = self.branches, np.full(len(q), -1)
        for i, row in enumerate(q):
            x = row[b.place] - (2.0 * np.pi * np.floor((row[b.place] - b.low) / (2.0 * np.pi)) if b.closes else 0.0)
            cell = int(np.clip(np.searchsorted(self.cells.low, x, side="right") - 1, 0, len(self.label) - 1))
            near = b.signs_of(row[None])[0]
            same = np.all((self.signs == near) | (near == 0.0), axis=1) & (self.cells.state[cell] != DEAD)
            found = {*self.label[cell, same].tolist()}
            out[i] = found.pop() if len(found) == 1 else -1
        return out


def swept(branches: Branches, time: TimeLimit) -> Sweep:
    """The components of a curve."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    run = Decider(branches, time)
    cells = run.cells()
    (n, k), node = cells.state.shape, np.arange(cells.state.size).reshape(cells.state.shape)
    following = np.roll(node, -1, axis=0)[: n if branches.closes else n - 1]
    here, there = node[: len(following)], following
    joined = np.isin(cells.state, AT_RIGHT)[: len(here)] & np.isin(np.roll(cells.state, -1, axis=0), AT_LEFT)[: len(here)]
    pairs = [(here[joined], there[joined])]
    flipped = np.array([[_number(s * np.where(np.arange(len(s)) == m, -1.0, 1.0)) for m in range(branches.signs)]
                        for s in run.signs]).reshape(k, -1)  # fmt: skip
    i, j = np.nonzero(np.isin(cells.state, (LEFT, RIGHT, TOUCH, POINT)) & (cells.kind >= 0))
    pairs.append((node[i, j], node[i, flipped[j, cells.kind[i, j]]]))
    for row in np.flatnonzero(cells.open):
        some = node[row][cells.state[row] == OPEN]
        pairs.append((some[:-1], some[1:]))
    a, b = (np.concatenate(x) for x in zip(*pairs, strict=True))
    group = connected_components(coo_matrix((np.ones(len(a)), (a, b)), shape=(n * k, n * k)), directed=False)[1]
    known = (cells.state != DEAD) & (cells.state != OPEN)
    present = np.unique(group[known.ravel()])
    label = np.where(cells.state.ravel() == DEAD, -1, np.searchsorted(present, group).clip(max=max(len(present) - 1, 0)))
    label = np.where(np.isin(group, present), label, -1).reshape(n, k)
    ends = np.zeros(len(present), dtype=int)
    stops = label[np.isin(cells.state, (LEFT, RIGHT)) & (cells.kind == LIMIT)]
    if not branches.closes:
        first, last = (label[c][np.isin(cells.state[c], there)] for c, there in ((0, AT_LEFT), (-1, AT_RIGHT)))
        stops = np.concatenate([stops, first, last])
    np.add.at(ends, stops[stops >= 0], 1)
    return Sweep(branches, run.signs, cells, label, len(present), ends)


def _number(signs: Array) -> int:
    """Place of a branch among all, + before -."""
    return int(sum(2 ** (len(signs) - 1 - m) for m, s in enumerate(signs) if s < 0.0))
