"""The components of a curve whose branches are known over one coordinate: circles and arcs, by
proof.

Branches are joined where intervals touch (`branch_intervals`), and where they meet: where the
function of a sign is zero, the curve goes on with the other sign; where that of a limit is, it
ends. Where a sign's function only touches zero, four branches meet, or one point lies alone. Where
something is open, as where several functions vanish at once, all branches of which nothing is known
may be joined: the number of components is a lower bound then.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kempe.analysis.spaces.curves.branch_functions import LIMIT, BranchFunctions
from kempe.analysis.spaces.curves.branch_intervals import (
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
from kempe.analysis.spaces.curves.dyad_branches import dyad_branches
from kempe.analysis.spaces.curves.skew_branches import skew_branches
from kempe.model.kept import kept
from kempe.spatial import Array
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.model.system import System
    from kempe.solvers.common.clock import TimeLimit

TRIES = 4
"""Coordinates over which is swept at most."""
AT_LEFT = (ALIVE, LEFT, TOUCH, OPEN)
AT_RIGHT = (ALIVE, RIGHT, TOUCH, OPEN)
"""States with which a branch is there, or may be, at the left and right ends of an interval."""


@dataclass(frozen=True, eq=False)
class CurveSweep:
    """A curve of k branches with `signs` (k, m) over n intervals, its `cells`.

    `label` (n, k) is the number of the component of each branch on each interval, from 0 to `count`
    - 1, or -1; `ends` (count,) is how many ends each component has: 2 if it is an arc.
    """

    branches: BranchFunctions
    signs: Array
    cells: Cells
    label: np.ndarray
    count: int
    ends: np.ndarray

    @property
    def complete(self) -> bool:
        """Whether the number of components is proven, not only a lower bound."""
        return not bool(self.cells.open.any())

    @property
    def reason(self) -> str:
        """What was proven, and how."""
        k = len(self.signs)
        name = self.branches.name
        over = (
            f"{k} branch{'es' * (k > 1)} over {name!r}, bounded on "
            f"{counted(len(self.label), 'interval')}"
        )
        touching = counted(len(self.crossings), "place") if len(self.crossings) else ""
        over += f"; they touch in {touching}, to rounding" if touching else ""
        return over if self.complete else f"{over}, and open where several of them meet"

    @cached_property
    def starts(self) -> Array:
        """A configuration (count, nq) on each component, in the middle of its widest interval."""
        wide = np.where(self.cells.state == ALIVE, (self.cells.high - self.cells.low)[:, None], 0.0)
        middle = 0.5 * (self.cells.low + self.cells.high)
        x = np.empty(self.count)
        which = np.empty(self.count, dtype=int)
        for c in range(self.count):
            i, which[c] = np.unravel_index(
                int(np.argmax(np.where(self.label == c, 1.0 + wide, 0.0))), wide.shape
            )
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
        b = self.branches
        out = np.full(len(q), -1)
        for i, row in enumerate(q):
            x = float(row[b.place])
            x -= 2.0 * np.pi * np.floor((x - b.low) / (2.0 * np.pi)) if b.closes else 0.0
            cell = int(
                np.clip(
                    np.searchsorted(self.cells.low, x, side="right") - 1, 0, len(self.label) - 1
                )
            )
            near = b.signs_of(row[None])[0]
            same = np.all((self.signs == near) | (near == 0.0), axis=1) & (
                self.cells.state[cell] != DEAD
            )
            found = {*self.label[cell, same].tolist()}
            out[i] = found.pop() if len(found) == 1 else -1
        return out


def swept(branches: BranchFunctions, time: TimeLimit) -> CurveSweep:
    """The components of a curve."""
    run = Decider(branches, time)
    cells = run.cells()
    group = _joined(branches, run.signs, cells)
    present = np.unique(group[(cells.state != DEAD) & (cells.state != OPEN)])
    label = np.where(
        np.isin(group, present) & (cells.state != DEAD), np.searchsorted(present, group), -1
    )
    stops = [label[np.isin(cells.state, (LEFT, RIGHT)) & (cells.kind == LIMIT)]]
    if not branches.closes:
        stops += [
            label[c][np.isin(cells.state[c], there)] for c, there in ((0, AT_LEFT), (-1, AT_RIGHT))
        ]
    ends = np.bincount(np.concatenate(stops) + 1, minlength=len(present) + 1)[1:]
    return CurveSweep(branches, run.signs, cells, label, len(present), ends)


def _joined(branches: BranchFunctions, signs: Array, cells: Cells) -> np.ndarray:
    """The numbers (n, k) of what is joined, of each branch on each interval."""
    from scipy.sparse import coo_matrix, csgraph

    (n, k) = cells.state.shape
    node = np.arange(cells.state.size).reshape(cells.state.shape)
    last = n if branches.closes else n - 1
    goes_on = np.isin(cells.state, AT_RIGHT) & np.roll(np.isin(cells.state, AT_LEFT), -1, axis=0)
    pairs = [(node[:last][goes_on[:last]], np.roll(node, -1, axis=0)[:last][goes_on[:last]])]
    i, j = np.nonzero(np.isin(cells.state, (LEFT, RIGHT, TOUCH, POINT)) & (cells.kind >= 0))
    digit = 2 ** (branches.signs - 1 - cells.kind[i, j])
    pairs.append(
        (node[i, j], node[i, j + np.where(signs[j, cells.kind[i, j]] > 0.0, digit, -digit)])
    )
    for row in np.flatnonzero(cells.open):
        some = node[row][cells.state[row] == OPEN]
        pairs.append((some[:-1], some[1:]))
    a, b = (np.concatenate(x) for x in zip(*pairs, strict=True))
    graph: Any = coo_matrix((np.ones(len(a)), (a, b)), shape=(n * k, n * k))
    label: np.ndarray = cast(Any, csgraph).connected_components(graph)[1]
    return label.reshape(n, k)


@kept
def _found(_system: System) -> list[CurveSweep | str]:
    """Where what was found of a system is kept."""
    return []


def sweep_of(system: System, time: TimeLimit) -> CurveSweep | str:
    """The sweep that proves most, over the coordinates that can be used; or why there is none."""
    found = _found(system)
    if not found:
        branches = dyad_branches(system) if system.dim == 2 else skew_branches(system)
        best: CurveSweep | str = branches if isinstance(branches, str) else ""
        for way in branches[:TRIES] if not isinstance(branches, str) else ():
            sweep = swept(way, time)
            better = isinstance(best, str) or (sweep.complete, sweep.count) > (
                best.complete,
                best.count,
            )
            best = sweep if better else best
            if sweep.complete:
                break
        found.append(best)
    return found[0]
