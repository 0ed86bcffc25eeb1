"""Continuous motions between two configurations: straight ways, traced curves, random trees on the
manifold.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.analysis.mobility.mobility import mobility
from kempe.analysis.motion.motion import trace
from kempe.analysis.spaces.configuration.components import SAME, Component, moved_by_spins
from kempe.analysis.spaces.configuration.manifold import CLOSED, Manifold
from kempe.analysis.spaces.configuration.polygons import polygon_of
from kempe.analysis.spaces.configuration.random_trees import joined
from kempe.analysis.spaces.curves.swept import sweep_of
from kempe.budget import Budget, Usual
from kempe.calls import brief, explained, explained_methods, generator, interruptible
from kempe.errors import InputError
from kempe.kinematics.configuration import has_loops, one_finite
from kempe.kinematics.limits import with_limits
from kempe.kinematics.measure import judge
from kempe.reals import is_real
from kempe.solvers.common.answer import Configurations
from kempe.solvers.common.clock import (
    BROKEN_OFF,
    TIME_LIMIT,
    TimeLimit,
    TimeUp,
    time_limited,
    time_of,
)
from kempe.spatial import Array
from kempe.status import Status

if TYPE_CHECKING:
    from kempe.model.system import System

STEP = 0.1
"""Longest step of the motion unless the caller says otherwise, in radians and characteristic
lengths."""
USUAL = Usual("path", step=STEP, rng=0, iterations=4000, time_limit=TIME_LIMIT)


@explained_methods
@dataclass(frozen=True, eq=False)
class Connection(Configurations):
    """A continuous motion `q` (n, nq) between two configurations, in steps up to `step`; empty
    where none is found.

    The sentence says how it was found, or why not: `code` is `NONE_EXISTS` where it is proven that
    the two are on different components, `OUTSIDE_LIMITS` where one of them is outside. `length` is
    that of the motion, in radians and characteristic lengths. Angles without limits end up to whole
    turns at the goal.
    """

    is_motion = True
    __repr__ = brief

    also = ("length", "step", "interrupted", "late")

    q: Array
    outcome: Status
    reason: str
    step: float
    system: System = field(repr=False)
    interrupted: bool = False
    late: bool = False

    @property
    def success(self) -> bool:
        """Whether a motion was found."""
        return self.outcome is Status.SOLVED

    @property
    def code(self) -> Status:
        """The outcome, a `Status`."""
        return self.outcome

    @property
    def length(self) -> float:
        """Length of the motion."""
        manifold = Manifold(self.system, 1)
        return float(manifold.apart(self.q[:-1], self.q[1:]).sum()) if len(self.q) > 1 else 0.0


@explained
@interruptible
@time_limited(USUAL)
def path(system: System, q0: Any, q1: Any, *, budget: Budget | None = None) -> Connection:
    """A continuous motion from q0 to q1 (nq,) within limits and on all constraints, or why there is
    none.

    Where only limits bound the coordinates it is a straight line in them. With one freedom it
    follows the traced curve through q0, across bifurcations if need be. Otherwise two random trees
    grow on the closed configurations until they meet (Berenson, Srinivasa, Ferguson, Kuffner,
    2009), and the path is shortened and refined: the midpoint of any two neighbouring points was
    projected to a closed configuration, too, which lay between them. Of the `budget` are read: step
    (0.1 of arc length between two points, at most), rng (0), iterations (4000 branches), time_limit
    (120 s). Errors: `InputError` where q0 or q1 is no single configuration, or is not closed.
    """
    spend = USUAL.of(budget)
    if not is_real(spend.step) or not 1e-4 <= spend.step <= 1.0:
        raise InputError(
            f"step is {spend.step!r}; it must be between 1e-4 and 1, in radians and characteristic "
            "lengths"
        )
    time = time_of(USUAL, budget)
    step = float(spend.step)
    rng = generator(spend.rng)
    try:
        a = _end(system, q0, "q0")
        b = _end(system, q1, "q1")
        manifold = Manifold(system, system.nv)
        for name, q in (("the start q0", a), ("the goal q1", b)):
            if not manifold.inside(q[None])[0]:
                rows = manifold.one_sided
                which = ", ".join(repr(rows.names[k]) for k in np.flatnonzero(rows.beyond(q) > 0.0))
                why = f"{name} is outside the limits of {which}"
                return Connection(_no_way(system), Status.OUTSIDE_LIMITS, why, step, system)
        if has_loops(system):
            return _closed(system, a, b, step, rng, spend, time)
        found = _straight(manifold, a, b, step)
        if manifold.inside(found).all():
            return Connection(found, Status.SOLVED, "the straight way", step, system)
        return _by_trees(manifold, a, b, step, rng, spend, time)
    except BROKEN_OFF as error:
        code = Status.OUT_OF_TIME if isinstance(error, TimeUp) else Status.INTERRUPTED
        return Connection(
            _no_way(system),
            code,
            f"not found: {time.reason(error)} came",
            step,
            system,
            isinstance(error, KeyboardInterrupt),
            isinstance(error, TimeUp),
        )


def _end(system: System, q: Any, name: str) -> Array:
    q = one_finite(system, q, name)
    judged = judge(system, q)
    if not judged:
        raise InputError(f"{name} is not closed, {judged}; assemble closes it")
    return q


def _no_way(system: System) -> Array:
    return np.empty((0, system.nq))


def _straight(manifold: Manifold, a: Array, b: Array, step: float) -> Array:
    way = manifold.between(a[None], b[None])[0]
    n = max(1, int(np.ceil(np.linalg.norm(way) / step)))
    return manifold.move(
        np.repeat(a[None], n + 1, axis=0), np.linspace(0.0, 1.0, n + 1)[:, None] * way
    )


def _closed(
    system: System,
    a: Array,
    b: Array,
    step: float,
    rng: np.random.Generator,
    spend: Budget,
    time: TimeLimit,
) -> Connection:
    polygon = polygon_of(
        with_limits(system, dict.fromkeys(system.coordinate_names)) if system.dim == 2 else system
    )
    if not isinstance(polygon, str):
        sides = polygon.side(np.stack([a, b]))
        if sides[0] != sides[1]:
            why = f"they are on different components, proven: {polygon.reason}"
            return Connection(_no_way(system), Status.NONE_EXISTS, why, step, system)
    sweep = sweep_of(system, time)
    if (
        not isinstance(sweep, str)
        and (labels := sweep.labels(np.stack([a, b])))[0] != labels[1]
        and labels.min() >= 0
    ):
        why = f"they are on different components, proven: {sweep.reason}"
        return Connection(_no_way(system), Status.NONE_EXISTS, why, step, system)
    freedoms = mobility(system, a)
    exact, _ = Manifold(system, 1).closed(np.stack([a, b]))
    if freedoms.useful == 1:
        part = _curve(system, exact[0], spend)
        if (why := _elsewhere(part, exact)) is not None:
            return Connection(
                _no_way(system), why[0], why[1], step, system, False, part.paths[0].late
            )
        if not freedoms.idle:
            return _along_curves(part, exact, step)
    unsure = freedoms.dof is None or freedoms.singular
    dim = freedoms.generic_rank_dof if unsure else freedoms.dof
    return _by_trees(Manifold(system, dim or 1), exact[0], exact[1], step, rng, spend, time)


# ---- along curves


def _curve(system: System, a: Array, spend: Budget) -> Component:
    """The component of a, as far as it can be traced."""
    first = trace(system, start=a, ways="branches", budget=Budget(time_limit=spend.time_limit))
    return Component((first, *first.others), moved_by_spins(system, a))


def _elsewhere(part: Component, ends: Array) -> tuple[Status, str] | None:
    """The outcome and why, where the curve through the first of two configurations does not pass
    the other.
    """
    far = part.place(ends)[2]
    first = part.paths[0]
    if far[1] < SAME:
        return None
    whole = "was traced wholly" if first.success else f"was traced in part ({first.status})"
    return (
        Status.NOT_FOUND,
        f"the curve through q0 {whole} and does not pass q1, which is no proof that there is no "
        "way",
    )


def _along_curves(part: Component, ends: Array, step: float) -> Connection:
    """The way along the traced curves through both ends (2, nq)."""
    (a, b) = ends
    (which, s, _) = part.place(ends)
    system = part.paths[0].system
    legs = _route(part, (int(which[0]), float(s[0])), (int(which[1]), float(s[1])))
    pieces = [
        part.paths[k].at(np.linspace(x, y, max(2, int(np.ceil(abs(y - x) / step)) + 1)))
        for k, x, y in legs
    ]
    over = sum(k != j for (k, *_), (j, *_) in zip(legs, legs[1:], strict=False))
    q = np.concatenate([a[None], *pieces, b[None]])
    manifold = Manifold(system, 1)
    keep = np.append(True, manifold.apart(q[:-1], q[1:]) > CLOSED)
    q = q[keep] if keep.sum() > 1 else q[[0, -1]]
    how = "along the traced curve" + (
        f", over {over} bifurcation{'s' * (over > 1)}" if over else ""
    )
    return Connection(q, Status.SOLVED, how, step, system)


def _route(
    part: Component, begin: tuple[int, float], end: tuple[int, float]
) -> list[tuple[int, float, float]]:
    """Legs (curve, from, to) of the shortest way between two places on curves that meet at singular
    points (Dijkstra, 1959); a `to` beyond the length of a closed curve goes on around.
    """
    metric = Manifold(part.paths[0].system, 1).metric
    stops = [(*begin, None), (*end, None)]
    stops += [(k, e.s, e.q) for k, path in enumerate(part.paths) for e in path.singular_points]
    cost = {0: 0.0}
    queue = [(0.0, 0)]
    way: dict[int, tuple[int, tuple[int, float, float] | None]] = {}
    while queue:
        so_far, i = heapq.heappop(queue)
        if i == 1:
            break
        k, s, q = stops[i]
        for j, (to, at, point) in enumerate(stops):
            legs = []
            if to == k:
                legs = [at - s]
                if part.paths[k].closed:
                    legs.append(legs[0] - np.copysign(part.paths[k].length, legs[0]))
            elif (
                q is not None
                and point is not None
                and metric.distances(q[None], point[None])[0] < SAME
            ):
                legs = [0.0]
            for leg in legs:
                if so_far + abs(leg) < cost.get(j, np.inf):
                    cost[j] = so_far + abs(leg)
                    way[j] = (i, (k, s, s + leg) if to == k else None)
                    heapq.heappush(queue, (cost[j], j))
    out: list[tuple[int, float, float]] = []
    at = 1
    while at != 0:
        at, leg = way[at]
        out += [] if leg is None else [leg]
    return out[::-1]


# ---- by random trees


def _by_trees(
    manifold: Manifold,
    a: Array,
    b: Array,
    step: float,
    rng: np.random.Generator,
    spend: Budget,
    time: TimeLimit,
) -> Connection:
    found, grown = joined(manifold, a, b, step, rng, int(spend.iterations or 1), time)
    if found is None:
        why = (
            f"two random trees of {grown} configurations did not meet, which is no proof that "
            "there is no way"
        )
        return Connection(_no_way(manifold.system), Status.NOT_FOUND, why, step, manifold.system)
    how = f"found by two random trees of {grown} configurations together"
    return Connection(found, Status.SOLVED, how, step, manifold.system)
