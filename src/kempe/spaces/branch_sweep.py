"""Components of a curve of configurations, proven by a sweep over one coordinate.

Intervals are cut until the branches on each are known; joined branches are circles or arcs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from kempe.model.model import kept
from kempe.numerics.enclosures import interval
from kempe.spaces.branch_functions import (
    LIMIT,
    SOUND,
    BranchFunctions,
    dyad_branches,
    skew_branches,
)
from kempe.spatial import Array
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.model.model import Model
    from kempe.numerics.clock import TimeLimit


# ---- branches on intervals

# Each interval is cut until on it every branch is proven to exist throughout, or nowhere, or to end
# once: where one of its functions has one simple root, which opposite signs at the ends of the
# interval and a slope that is not zero prove (Moore, Kearfott, Cloud, *Introduction to Interval
# Analysis*, 2009). A function that is convex on an interval, positive at its ends, and zero to
# rounding between them, only touches zero there, as at a change point of a parallelogram.

FIRST = 48
"""Intervals at the beginning."""
SPLIT = 0.4871
"""Where intervals are cut: not in the middle, so that roots at round numbers do not fall on their
ends."""
COARSE = 1e-6
FINE = 1e-13
"""Widths, as parts of the whole, at which functions that touch zero are looked for, and at which it
is given up."""
MOST = 16_000
"""Intervals, times branches, at most."""
TOUCHING = 4e-12
"""Size of a function, as a part of its largest, at which it counts as zero where it touches it."""
DEAD, ALIVE, LEFT, RIGHT, TOUCH, POINT, OPEN = range(7)
"""What is known of a branch on an interval: it exists nowhere; throughout; at its left, or right,
end; throughout, and touches another one; at one point only; nothing."""
NONE = -3
"""In place of a kind of function: none ends the branch."""


class Cells(NamedTuple):
    """Intervals from `low` (n,) to `high` (n,), in order; the states (n, k) of branches, and kinds
    of what ends them.

    Where a branch touches another one, `place` (n, k) is the coordinate.
    """

    low: Array
    high: Array
    state: np.ndarray
    kind: np.ndarray
    place: Array

    @property
    def open(self) -> np.ndarray:
        """Which (n,) are not decided."""
        return (self.state == OPEN).any(axis=1)

    def only(self, which: np.ndarray) -> Cells:
        """Some of them."""
        return Cells(*(x[which] for x in self))


class Decider:
    """Decides about the intervals of a curve; `signs` (k, m) are those of its branches."""

    def __init__(self, branches: BranchFunctions, time: TimeLimit):
        m = branches.signs
        self.branches = branches
        self.time = time
        self.left = MOST // 2**m
        self.signs = np.array(list(product((1.0, -1.0), repeat=m))).reshape(2**m, m)
        self.size = np.zeros(0)

    def cells(self) -> Cells:
        """All intervals, decided as far as can be."""
        edges = np.linspace(self.branches.low, self.branches.high, FIRST + 1)
        coarse = self._touched(self._refined(edges[:-1], edges[1:], COARSE))
        left = coarse.only(coarse.open)
        return _ordered([coarse.only(~coarse.open), self._refined(left.low, left.high, FINE)])

    def _values(self, low: Array, high: Array, order: int) -> tuple[Array, Array, np.ndarray]:
        """Middles and radii (order + 1, f, n, k) of Taylor coefficients of all functions on
        intervals; kinds (f,).
        """
        n = len(low)
        k = len(self.signs)
        x = interval(np.repeat(low, k), np.repeat(high, k), order)
        found = self.branches.functions(x, np.tile(self.signs, (n, 1)))
        mid, rad = (
            np.stack([np.broadcast_to(a, (order + 1, n * k)) for a in each], axis=1)
            for each in ([f.mid for f, _ in found], [f.rad for f, _ in found])
        )
        shape = order + 1, len(found), n, k
        return mid.reshape(shape), rad.reshape(shape), np.array([kind for _, kind in found])

    def _at(self, x: Array) -> tuple[Array, Array]:
        """Lower and upper bounds (f, n, k) of all functions at points (n,)."""
        mid, rad, _ = self._values(x, x, 0)
        return mid[0] - rad[0], mid[0] + rad[0]

    def _refined(self, low: Array, high: Array, least: float) -> Cells:
        """Intervals cut until they are decided, or down to a part `least` of the whole."""
        least *= self.branches.high - self.branches.low
        done = [
            Cells(
                low[:0],
                high[:0],
                *(np.zeros((0, len(self.signs)), dtype=t) for t in (int, int, float)),
            )
        ]
        while len(low):
            self.time.check()
            state, kind = self._decided(low, high)
            self.left -= len(low)
            end = ~(state == OPEN).any(axis=1) | (high - low <= least) | (self.left < 0)
            done.append(Cells(low, high, state, kind, np.full(state.shape, np.nan)).only(end))
            low = low[~end]
            high = high[~end]
            cut = low + SPLIT * (high - low)
            low = np.concatenate([low, cut])
            high = np.concatenate([cut, high])
        return _ordered(done)

    def _decided(self, low: Array, high: Array) -> tuple[np.ndarray, np.ndarray]:
        """States and kinds (n, k) on intervals, from values, slopes, and values at their middles
        and ends.
        """
        mid, rad, kinds = self._values(low, high, 1)
        (a, a_high), (c, c_high), (b, b_high) = (
            self._at(x) for x in (low, 0.5 * (low + high), high)
        )
        if not len(self.size):
            self.size = np.abs(c).max(axis=(1, 2), initial=1e-300)
        steep = (np.abs(mid[1]) + rad[1]) * (0.5 * (high - low) * (1.0 + 1e-9))[:, None]
        holds = np.maximum(mid[0] - rad[0], c - steep) > 0.0
        fails = np.minimum(mid[0] + rad[0], c_high + steep) < 0.0
        state, kind, single = _known(holds, kinds)
        for end, which in (
            (LEFT, (mid[1] < -rad[1]) & (a > 0.0) & (b_high < 0.0)),
            (RIGHT, (mid[1] > rad[1]) & (a_high < 0.0) & (b > 0.0)),
        ):
            state[single & (~holds & which).any(axis=0)] = end
        state[fails.any(axis=0)] = DEAD
        return state, kind

    def _touched(self, cells: Cells) -> Cells:
        """The intervals, open neighbours made one where branches only touch there."""
        out = [cells.only(~cells.open)]
        groups = np.split(
            np.flatnonzero(cells.open), np.flatnonzero(np.diff(np.flatnonzero(cells.open)) > 1) + 1
        )
        for group in groups if cells.open.any() else ():
            found = self._touch(cells.low[group[:1]], cells.high[group[-1:]])
            out.append(cells.only(group) if found.open[0] else found)
        return _ordered(out)

    def _touch(self, low: Array, high: Array) -> Cells:
        """One interval, on which functions may touch zero."""
        mid, rad, kinds = self._values(low, high, 2)
        (a, a_high) = self._at(low)
        (b, b_high) = self._at(high)
        state, kind, single = _known(mid[0] - rad[0] > 0.0, kinds)
        place = np.full(state.shape, np.nan)
        for k in np.flatnonzero(single[0] & (kind[0] >= 0)):
            j = int(np.argmin((mid[0] - rad[0] > 0.0)[:, 0, k]))
            centre = self._values(0.5 * (low + high), 0.5 * (low + high), 2)[0][:, j, 0, k]
            x = np.clip(0.5 * (low + high) - 0.5 * centre[1] / centre[2], low, high)
            least, most = (bound[j, 0, k] for bound in self._at(x))
            if max(-least, most) < TOUCHING * self.size[j]:
                up = mid[2, j, 0, k] > rad[2, j, 0, k] and a[j, 0, k] > 0.0 and b[j, 0, k] > 0.0
                down = (
                    mid[2, j, 0, k] < -rad[2, j, 0, k]
                    and a_high[j, 0, k] < 0.0
                    and b_high[j, 0, k] < 0.0
                )
                state[0, k] = TOUCH if up else POINT if down else OPEN
                place[0, k] = float(x[0])
        state[(mid[0] + rad[0] < 0.0).any(axis=0)] = DEAD
        return Cells(low, high, state, kind, place)


def _known(holds: np.ndarray, kinds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States (n, k), where functions are positive (f, n, k); kinds of what is not, and whether that
    is one that ends a branch.
    """
    kind = np.where(holds.all(axis=0), NONE, kinds[np.argmin(holds, axis=0)])
    single = ((~holds).sum(axis=0) == 1) & (kind != SOUND)
    return np.where(holds.all(axis=0), ALIVE, OPEN), kind, single


def _ordered(parts: list[Cells]) -> Cells:
    joined = [np.concatenate(x) for x in zip(*parts, strict=True)]
    order = np.argsort(joined[0])
    return Cells(*(x[order] for x in joined))


# ---- components of the curve

# Branches are joined where intervals touch, and where they meet: where the function of a sign is
# zero, the curve goes on with the other sign; where that of a limit is, it ends. Where a sign's
# function only touches zero, four branches meet, or one point lies alone. Where something is open,
# as where several functions vanish at once, all branches of which nothing is known may be joined:
# the number of components is a lower bound then.

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
def _found(_system: Model) -> list[CurveSweep | str]:
    """Where what was found of a system is kept."""
    return []


def sweep_of(system: Model, time: TimeLimit) -> CurveSweep | str:
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
