"""Self-motions of a chain with one freedom to spare: curves, cut into arcs over a joint.

Each curve is followed by predictor and corrector from solutions at many values of the parameter.
A curve that lives between two of the values is missed: hence "not exact", however small the errors
are.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.targets import TASKS, is_axis_task, make_rotations_along
from kempe.budget import TimeUp, check_for_stop
from kempe.inverse.closed_forms.chain_lines import Lines
from kempe.kernels.compiled import chain_curves
from kempe.kernels.forward.table_layout import SLIDE, get_tip_placement
from kempe.model.model import keep_answers
from kempe.numerics.clock import TimeLimit
from kempe.numerics.curves import ACROSS, BEND, BLUNT, IDEAL_BEND, LEAST_STEP
from kempe.numerics.intervals import SAME_ANGLE, unite_intervals
from kempe.numerics.newton import LAST
from kempe.numerics.rank import Level
from kempe.numerics.roots import find_sign_change
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

LONGEST = 0.15
"""The longest step along a curve [rad, lengths of the chain]."""

CORRECTIONS = 8
"""Steps of a correction at most."""

SAME = 1e-4
"""Distance below which the end of a curve is a solution that is known."""

CONVERGED = 1e-13
HELD = 1e-11
"""Error of a configuration that is corrected no further, and of one that is taken for good."""

RULES = np.array(
    [CONVERGED, HELD, LAST, Level.CLOSED, BLUNT, LONGEST, ACROSS, BEND, IDEAL_BEND, LEAST_STEP]
)
"""What the kernels of `chain_curves` ask of points and steps."""

PIECE = 1024
ROOM = 32
"""Points and curves between two looks at the clock, and points of a curve for which there is room at
first."""

TWO_PI = 2.0 * math.pi


@keep_answers
def _pack_chain(
    system: Model, frame: str, axis: tuple[float, float, float] | None
) -> tuple[Array, np.ndarray, Array]:
    """Pack the chain of a frame, turned by the rotation (3, 3) that leads z to the axis; return this
    rotation, and the table.
    """
    tool = np.eye(3) if axis is None else make_rotations_along(np.array(axis))
    ints, floats = system.structure.table.pack_arrays(
        [frame], system.structure.table.find_path(frame)
    )
    floats = floats.copy()
    tip = get_tip_placement(ints, floats)
    tip[:, :3] = tip[:, :3] @ tool
    return tool, ints, floats


@dataclass(frozen=True, eq=False)
class ChainMotion:
    """A chain that keeps its task at a target, with one freedom: joints `free` of the chain move,
    that at `p` of these is the parameter, the others stay as in `base` (nq,). x are the free
    coordinates, slides in lengths of the chain.
    """

    system: Model
    frame: str
    lines: Lines
    task: str
    axis: tuple[float, float, float]
    target: Array = field(repr=False)
    base: Array = field(repr=False)
    free: tuple[int, ...]
    p: int

    @property
    def n(self) -> int:
        """Number of joints that move."""
        return len(self.free)

    @cached_property
    def unit(self) -> Array:
        """Unit (nf,) of each free coordinate x in the system's units."""
        free = list(self.free)
        return np.where(self.lines.kinds[free] == SLIDE, self.lines.length, 1.0)

    @cached_property
    def period(self) -> Array:
        """Period (nf,) of each free coordinate: a turn; infinite for slides."""
        free = list(self.free)
        return np.where(
            self.lines.kinds[free] == SLIDE, np.inf, TWO_PI / np.abs(self.lines.multiplier[free])
        )

    @cached_property
    def limits(self) -> Array:
        """Limits (2, nf) of x."""
        return np.ascontiguousarray(self.lines.limits[:, list(self.free)] / self.unit)

    def make_configurations(self, x: Array) -> Array:
        """Make configurations (..., nq) of free coordinates x (..., nf)."""
        out = np.array(np.broadcast_to(self.base, (*x.shape[:-1], len(self.base))), order="C")
        out[..., self._places] = x * self.unit
        return out

    @cached_property
    def _places(self) -> np.ndarray:
        """Places (nf,) in q of the joints that move."""
        return self.lines.q_index[list(self.free)]

    def read_coordinates(self, q: Array) -> Array:
        """Read the free coordinates (..., nf) of configurations (..., nq)."""
        return q[..., self._places] / self.unit

    @cached_property
    def packed(self) -> tuple[Any, ...]:
        """The chain and its target, as the kernels of `chain_curves` take them.

        The tip's z axis is turned into the tool's axis.
        """
        pointed = is_axis_task(self.task)
        tool, ints, floats = _pack_chain(self.system, self.frame, self.axis if pointed else None)
        target = np.column_stack([self.target[:3, :3] @ tool, self.target[:3, 3]])
        planar = self.system.dim == 2 and self.task == "pose"
        rows = np.array((1, 1, 0, 0, 0, 1) if planar else TASKS[self.task], dtype=float)
        weights = rows * np.repeat([1.0 / self.lines.length, 1.0], 3)
        goal = np.concatenate([target.ravel(), weights, [float(pointed)]])
        places = np.array([self._places, self.lines.v_index[list(self.free)]], dtype=np.int64)
        return ints, floats, places, goal, self.unit, self.base, RULES

    def correct_points(
        self, x: Array, across: Array, rounds: int = CORRECTIONS
    ) -> tuple[Array, Array, np.ndarray]:
        """Find points (m, nf) of the curve in planes through x (m, nf), their unit tangents, and
        which exist (m,).

        The planes are normal to the directions `across` (m, nf), to which the tangents are nearest.
        """
        x = np.array(x, order="C")
        t = np.empty_like(x)
        error = np.empty(len(x))
        for i in range(0, len(x), PIECE):
            check_for_stop()
            some = slice(i, i + PIECE)
            chain_curves.correct_points(
                *self.packed, across[some], rounds, x[some], t[some], error[some]
            )
        return x, t, error < HELD

    def follow_curves(
        self, x: Array, t: Array, low: Array, high: Array
    ) -> list[list[tuple[Array, Array]]]:
        """Follow curves from points x (m, nf) along tangents t until the parameter leaves intervals.

        Returns nodes and tangents of the parts of each between folds. The last node is on the end
        `low` or `high` (m,) of the interval. Where the curve has no tangent, or is too long, the
        last node is inside. A curve that leads from one point to another has parts at one of them
        only.
        """
        out: list[list[tuple[Array, Array]]] = []
        bounds = np.column_stack([low, high])
        room = ROOM * min(len(x), PIECE)
        while len(out) < len(x):
            check_for_stop()
            some = slice(len(out), len(out) + PIECE)
            points, tangents = np.empty((2, room, self.n))
            fold = np.empty(room, dtype=np.int64)
            last = np.empty(len(x[some]), dtype=np.int64)
            done = chain_curves.follow_curves(
                *self.packed,
                x[some],
                t[some],
                bounds[some],
                self.p,
                self.period,
                SAME,
                points,
                tangents,
                fold,
                last,
            )
            first = 0
            folds = np.flatnonzero(fold[: last[done - 1]] if done else fold[:0]).tolist()
            for end in last[:done].tolist():
                cuts = [first, *(k for k in folds if first < k < end), end - 1]
                out.append(
                    [
                        (points[i : j + 1], tangents[i : j + 1])
                        for i, j in itertools.pairwise(cuts if first < end else [])
                    ]
                )
                first = end
            if not done:
                room *= 2
        return out

    def compute_short_difference(self, x: Array, y: Array) -> Array:
        """Compute y - x (..., nf), with angles the short way."""
        d = y - x
        period = self.period
        with np.errstate(invalid="ignore"):
            return np.where(np.isfinite(period), d - period * np.round(d / period), d)

    def is_inside_limits(self, x: Array) -> np.ndarray:
        """Whether (...) x (..., nf) is inside the limits in some turn, except the parameter."""
        (low, high) = self.limits
        period = self.period
        with np.errstate(invalid="ignore"):
            up = np.where(np.isfinite(period) & np.isfinite(low), low + np.mod(x - low, period), x)
            only = np.isfinite(period) & ~np.isfinite(low) & np.isfinite(high)
            up = np.where(only, high - np.mod(high - x, period), up)
        good = (up >= low) & (up <= high)
        good[..., self.p] = True
        return good.all(axis=-1)


@dataclass(frozen=True, eq=False)
class Arcs:
    """Arcs of curves over which the parameter rises: nodes x (k, nf) and unit tangents t (k, nf) of
    one arc after the other; arc i has the nodes first[i] to last[i].
    """

    motion: ChainMotion
    x: Array
    t: Array
    first: np.ndarray
    last: np.ndarray

    def __len__(self) -> int:
        return len(self.first)

    @cached_property
    def values(self) -> Array:
        """Parameter values (k,) of the nodes."""
        return np.ascontiguousarray(self.x[:, self.motion.p])

    def guess_points(self, k: np.ndarray, s: Array) -> Array:
        """Estimate points (m, nf) at fractions s (m,) of steps k (m,), by cubics."""
        return interpolate_hermite(self.x[k], self.t[k], self.x[k + 1], self.t[k + 1], s)

    def compute_points(self, k: np.ndarray, s: Array) -> Array:
        """Compute points (m, nf) of the curve at fractions s (m,) of steps k (m,)."""
        across = self.x[k + 1] - self.x[k]
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        return self.motion.correct_points(self.guess_points(k, s), across)[0]

    def find_points(self, values: Array, arc: np.ndarray) -> tuple[Array, np.ndarray]:
        """Find points (m, nf) of arcs (m,) at parameter values (m,), and which exist (m,)."""
        out = np.empty((len(values), self.motion.n))
        there = np.empty(len(values), dtype=np.int64)
        for i in range(0, len(values), PIECE):
            check_for_stop()
            some = slice(i, i + PIECE)
            chain_curves.find_points(
                *self.motion.packed,
                self.x,
                self.t,
                self.first,
                self.last,
                self.motion.p,
                values[some],
                arc[some],
                out[some],
                there[some],
            )
        return out, there > 0

    def find_intervals(self, limited: bool = True) -> list[list[tuple[float, float]]]:
        """Find the intervals of the parameter in which each arc is inside the limits.

        Without `limited`, return all of it.
        """
        if not limited:
            ends = self.values[self.first].tolist(), self.values[self.last].tolist()
            return [[pair] for pair in zip(*ends, strict=True)]
        own = np.arange(len(self), dtype=np.int64)
        crossed, places, values = self._find_crossings()
        arc: np.ndarray = np.concatenate([own, own, crossed])
        place = np.concatenate([self.first, self.last, places])
        value = np.concatenate([self.values[self.first], self.values[self.last], values])
        order = np.lexsort((value, place, arc))
        arc, place, value = arc[order], place[order], value[order]
        pairs = np.flatnonzero((arc[1:] == arc[:-1]) & (np.diff(place) > 1e-11))
        arc = arc[pairs]
        middle = 0.5 * (place[pairs] + place[pairs + 1])
        k = np.clip(middle.astype(np.int64), self.first[arc], self.last[arc] - 1)
        inside = self.motion.is_inside_limits(self.compute_points(k, middle - k))
        parts: list[list[tuple[float, float]]] = [[] for _ in range(len(self))]
        for i, a, b in zip(
            arc[inside].tolist(),
            value[pairs[inside]].tolist(),
            value[pairs[inside] + 1].tolist(),
            strict=True,
        ):
            parts[int(i)].append((a, b))
        return [list(unite_intervals(part, slack=SAME_ANGLE)) for part in parts]

    def _find_crossings(self) -> tuple[np.ndarray, Array, Array]:
        """Find where other joints pass their limits: arcs, places in the steps and parameters (m,)."""
        m = self.motion
        steps: np.ndarray = np.delete(np.arange(len(self.x)), self.last)
        room = len(steps) + 1
        while True:
            found = np.empty((room, 2), dtype=np.int64)
            places = np.empty((room, 4))
            count: int = chain_curves.find_crossings(
                self.x, self.t, steps, m.limits, m.period, m.p, found, places
            )
            if count <= room:
                break
            room = count
        at: np.ndarray = found[:count, 0]
        joint = found[:count, 1]
        level, part, before, after = places[:count].T
        rows = np.arange(count)
        first = self.guess_points(at, part)
        first[rows, joint] = level
        x, _, good = m.correct_points(first, np.eye(m.n)[joint])
        size = np.linalg.norm(self.x[at + 1] - self.x[at], axis=-1)
        good &= np.linalg.norm(x - first, axis=-1) < 0.05 * size + 1e-9
        for r in np.flatnonzero(~good):  # the joint only grazes its limit: found step by step
            step = at[[r]]

            def compute_offset(s: float, r: Any = r, step: np.ndarray = step) -> float:
                return float(self.compute_points(step, np.array([s]))[0, joint[r]] - level[r])

            s = find_sign_change(compute_offset, float(before[r]), float(after[r]))
            if s is not None:
                part[r] = s
                x[r] = self.compute_points(step, np.array([s]))[0]
                good[r] = True
        at = at[good]
        arc = np.asarray(np.searchsorted(self.last, at))
        ends = self.values[self.first[arc]], self.values[self.last[arc]]
        return arc, at + part[good], np.clip(x[good, m.p], *ends)


def interpolate_hermite(x0: Array, t0: Array, x1: Array, t1: Array, s: Array) -> Array:
    """Interpolate points (m, n) at fractions s (m,) between nodes with unit tangents (m, n)."""
    size = np.linalg.norm(x1 - x0, axis=-1, keepdims=True)
    s = s[:, None]
    return (
        x0
        + s * s * (3.0 - 2.0 * s) * (x1 - x0)
        + size * (s * (1.0 - s) ** 2 * t0 - s * s * (1.0 - s) * t1)
    )


# ---- arcs through solutions at many values of the parameter

STRAIGHT = 0.1
"""How far a step may be from the mean of the tangents at its ends, as a fraction of its length."""

Piece = tuple[Array, Array]


class Net:
    """Solutions at rising values of the parameter, and the pieces of curve between them.

    x, t (M, nf): solutions and unit tangents along which the parameter rises; first (m + 1,): the
    solutions first[i] to first[i + 1] are those of value i. `up` (M,) is the next node above each,
    or -1; `way[a]` is the piece from a to it, both inclusive, unless it is straight there; `head[a]`
    and `foot[a]` are pieces that end in a fold above a, or begin in one below; `loose` are arcs
    that no value meets.
    """

    def __init__(self, motion: ChainMotion, values: Array, x: Array, t: Array, first: np.ndarray):
        self.motion = motion
        self.values = values
        self.x = x
        self.t = t
        self.first = first
        self.up = np.full(len(x), -1, dtype=np.int64)
        self.below = np.zeros(len(x), dtype=bool)
        self.way: dict[int, Piece] = {}
        self.head: dict[int, Piece] = {}
        self.foot: dict[int, Piece] = {}
        self.loose: list[Piece] = []

    def join_nodes(self) -> None:
        """Join neighbouring nodes, and follow the curves from all ends that are left."""
        self._join_levels()
        top = self.first[-2]
        bottom = self.first[1]
        for sense, ended in ((1.0, self.head), (-1.0, self.foot)):
            left = np.flatnonzero(self.up[:top] < 0) if sense > 0.0 else self._list_lowest(bottom)
            left = np.array([a for a in left.tolist() if a not in ended], dtype=np.int64)
            self._keep_curves(left, sense, self._follow_curves(left, sense))

    def _list_lowest(self, first: int) -> np.ndarray:
        """List the nodes from `first` on that are not joined to one below."""
        return first + np.flatnonzero(~self.below[first:])

    def _is_joined(self, a: int, sense: float) -> bool:
        return bool(self.up[a] >= 0 if sense > 0.0 else self.below[a])

    def _join_levels(self) -> None:
        """Join nodes of neighbouring levels that only fit to each other."""
        rules = np.array([STRAIGHT, math.cos(BEND), 2.0 * LONGEST])
        for i in range(0, len(self.first) - 2, PIECE):
            check_for_stop()
            levels = np.ascontiguousarray(self.first[i : i + PIECE + 2])
            chain_curves.join_levels(self.x, self.t, levels, self.motion.period, rules, self.up)
        self.below[self.up[self.up >= 0]] = True

    def _follow_curves(self, nodes: np.ndarray, sense: float) -> list[list[Piece]]:
        """Follow the curves from nodes up (sense 1) or down (-1) to the next level, or back.

        Returns the parts of each between folds.
        """
        i = self._find_levels(nodes)
        here = self.values[i]
        there = self.values[i + int(sense)]
        return self.motion.follow_curves(
            self.x[nodes],
            sense * self.t[nodes],
            np.minimum(here, there),
            np.maximum(here, there),
        )

    def _find_levels(self, nodes: np.ndarray | int) -> Any:
        return np.searchsorted(self.first, nodes, side="right") - 1

    def _keep_curves(self, nodes: np.ndarray, sense: float, curves: list[list[Piece]]) -> None:
        """Keep the parts of curves from nodes."""
        some = [k for k, parts in enumerate(curves) if parts]
        ended = self.head if sense > 0.0 else self.foot
        ends = np.array([curves[k][-1][0][-1] for k in some]).reshape(-1, self.motion.n)
        here = self._find_levels(nodes[some])
        there = here + int(sense)
        value = ends[:, self.motion.p]
        back = np.abs(value - self.values[here]) < np.abs(value - self.values[there])
        found = np.empty(len(some), dtype=np.int64)
        chain_curves.find_nodes(
            self.x, self.first, self.motion.period, np.where(back, here, there), ends, SAME, found
        )
        for k, b, returns in zip(some, found.tolist(), back.tolist(), strict=True):
            a = int(nodes[k])
            if not self._is_joined(a, sense) and a not in ended:
                self._keep_curve(a, sense, curves[k], b if b >= 0 else None, returns)

    def _keep_curve(
        self, a: int, sense: float, parts: list[Piece], b: int | None, returns: bool
    ) -> None:
        """Keep the parts of a curve from node a to node b in `up`, `head`, `foot` and `loose`."""
        if len(parts) == 1:
            x, t = parts[0]
            if b is not None and not self._is_joined(b, -sense):
                low, high, piece = (a, b, (x, t)) if sense > 0.0 else (b, a, (x[::-1], -t[::-1]))
                self.up[low] = high
                self.below[high] = True
                self.way[low] = piece
            else:
                (self.head if sense > 0.0 else self.foot)[a] = (
                    (x, t) if sense > 0.0 else (x[::-1], -t[::-1])
                )
            return
        self._keep_fold_piece(a, sense, parts[0])
        if b is not None:
            x, t = parts[-1]
            self._keep_fold_piece(b, sense if returns else -sense, (x[::-1], -t[::-1]))
            parts.pop()
        self.loose += parts[1:]

    def _keep_fold_piece(self, a: int, sense: float, piece: Piece) -> None:
        """Keep a piece that leads from a node to a fold above or below it."""
        x, t = piece
        if sense > 0.0:
            self.head[a] = x, t
        else:
            self.foot[a] = x[::-1], -t[::-1]

    def list_arcs(self) -> Arcs:
        """List all arcs, in the order of their beginnings."""
        p = self.motion.p
        arcs: list[list[Piece]] = [
            [(x, t) if x[-1, p] > x[0, p] else (x[::-1], -t[::-1])] for x, t in self.loose
        ]
        arcs += self._list_chains()
        arcs = [parts for parts in arcs if len(parts) > 1 or len(parts[0][0]) > 1]
        if not arcs:
            none = np.zeros(0, dtype=np.int64)
            nothing = np.zeros((0, self.motion.n))
            return Arcs(self.motion, nothing, nothing, none, none)
        begins = np.array([parts[0][0][0] for parts in arcs]).round(6)
        arcs = [arcs[k] for k in np.lexsort((*begins.T[::-1], begins[:, p]))]
        # each piece begins with the last node of the one before
        pieces = [
            (x[int(k > 0) :], t[int(k > 0) :]) for parts in arcs for k, (x, t) in enumerate(parts)
        ]
        x, t = (np.concatenate([piece[k] for piece in pieces]) for k in (0, 1))
        sizes = np.array([1 + sum(len(x) - 1 for x, _ in parts) for parts in arcs])
        last = np.cumsum(sizes) - 1
        first = last - sizes + 1
        way = np.diff(x, axis=0)
        jumps = self.motion.compute_short_difference(x[:-1], x[1:]) - way
        jumps[last[:-1]] = 0.0
        turns = np.concatenate([np.zeros((1, self.motion.n)), np.cumsum(jumps, axis=0)])
        x += turns - np.repeat(turns[first], sizes, axis=0)
        return Arcs(self.motion, *_leave_out_falling_nodes(x, t, p, first, last))

    def _list_chains(self) -> list[list[Piece]]:
        """List the pieces of all arcs that meet a value."""
        order, last = np.empty((2, len(self.x)), dtype=np.int64)
        count = chain_curves.list_chains(self.up, order, last)
        x = self.x[order]
        t = self.t[order]
        place = np.empty(len(order), dtype=np.int64)
        place[order] = np.arange(len(order))
        cuts = sorted((int(place[a]), a) for a in self.way)
        out: list[list[Piece]] = []
        i = 0
        for j in last[:count].tolist():
            begin = int(order[i])
            end = int(order[j - 1])
            parts = [self.foot[begin]] if begin in self.foot else []
            while cuts and cuts[0][0] < j:
                k, a = cuts.pop(0)
                parts += [(x[i : k + 1], t[i : k + 1]), self.way[a]]
                i = k + 1
            parts.append((x[i:j], t[i:j]))
            if end in self.head:
                parts.append(self.head[end])
            out.append(parts)
            i = j
        return out


def _leave_out_falling_nodes(
    x: Array, t: Array, p: int, first: np.ndarray, last: np.ndarray
) -> tuple[Array, Array, np.ndarray, np.ndarray]:
    """Leave out the nodes at which the parameter p is not larger than at all before on the arc."""
    keep = np.ones(len(x), dtype=bool)
    keep[1:] = np.diff(x[:, p]) > 0.0
    keep[first] = True
    if keep.all():
        return x, t, first, last
    for i, j in zip(first, last + 1, strict=True):
        keep[i + 1 : j] = np.diff(np.maximum.accumulate(x[i:j, p])) > 0.0
    number = np.cumsum(keep) - 1
    return x[keep], t[keep], number[first], number[last]


def trace_arcs(
    motion: ChainMotion, values: Array, x: Array, level: np.ndarray, time: TimeLimit
) -> Arcs:
    """Trace the arcs through solutions x (M, nf) at rising values (m,) of the parameter.

    `level` (M,) is the index of each solution's value, rising.

    Solutions at the values are joined to curves; from those that find no partner curves are
    followed.
    """
    x = x.copy()
    x[:, motion.p] = values[level]
    along = np.zeros_like(x)
    along[:, motion.p] = 1.0
    better, t, good = motion.correct_points(x, along)
    good &= np.abs(better - x).max(axis=-1, initial=0.0) < SAME
    bad = np.flatnonzero(~good)
    better[bad], t[bad], _ = motion.correct_points(x[bad], along[bad], 0)
    net = Net(motion, values, better, t, np.searchsorted(level, np.arange(len(values) + 1)))
    try:
        net.join_nodes()
    except TimeUp:  # the arcs that were joined by now
        if not time.spent:
            raise
    return net.list_arcs()
