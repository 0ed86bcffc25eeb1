"""Continuous motions between two configurations: straight, along curves, or by random trees."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.answer import Configurations
from kempe.arguments import explain_errors, explain_method_errors, make_generator, raise_interrupted
from kempe.arrays import is_real
from kempe.assemble.idle_freedoms import find_idle_coordinates
from kempe.budget import Budget, TimeUp, Usual
from kempe.equations.judge import judge_configurations
from kempe.errors import InputError
from kempe.forward.limits import with_limits
from kempe.mobility.mobility import mobility
from kempe.model.configurations import has_loops, read_finite_q, sample_configurations
from kempe.motion.trace import trace
from kempe.numerics.clock import BROKEN_OFF, TIME_LIMIT, TimeLimit, find_time_limit, limit_time
from kempe.spaces.components import SAME, Component
from kempe.spaces.four_joints import find_four_joints
from kempe.spaces.manifold import CLOSED, Manifold
from kempe.spaces.polygons import find_polygon
from kempe.spatial import Array
from kempe.status import Status

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- random trees

# Two trees grow towards one another on the closed configurations, and meet. Sources: Kuffner,
# LaValle, "RRT-Connect", ICRA 2000; Berenson, Srinivasa, Ferguson, Kuffner, "Manipulation planning
# on constraint manifolds", ICRA 2009: each step towards a sample is led back onto the manifold.

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
    """A tree of configurations `q` (n, nq), each reached from its `parent`."""

    def __init__(self, manifold: Manifold, root: Array):
        self.manifold = manifold
        self.q = root[None]
        self.parent = [-1]

    def find_nearest(self, q: Array) -> int:
        """Return the number of the configuration in the tree that is nearest to q (nq,)."""
        return int(
            np.argmin(self.manifold.compute_distances(self.q, np.broadcast_to(q, self.q.shape)))
        )

    def grow_tree(self, aim: Array, step: float, time: TimeLimit) -> int:
        """Add configurations step by step towards the aim (nq,), and return the number of the last
        one.
        """
        at = self.find_nearest(aim)
        for q in step_towards_aims(self.manifold, self.q[at][None], aim[None], step, time)[0]:
            self.q, at = np.concatenate([self.q, q[None]]), self._add_node(at)
        return at

    def _add_node(self, parent: int) -> int:
        """Add a node with this parent and return its number."""
        self.parent.append(parent)
        return len(self.parent) - 1

    def list_way(self, at: int) -> list[Array]:
        """Return the configurations from the root of the tree to a node."""
        out: list[Array] = []
        while at >= 0:
            out.append(self.q[at])
            at = self.parent[at]
        return out[::-1]


def step_towards_aims(
    manifold: Manifold, q: Array, aims: Array, step: float, time: TimeLimit, most: Any = np.inf
) -> list[list[Array]]:
    """Step on the manifold, within limits, from each q (k, nq) towards its aim (k, nq).

    It ends where more than `most` steps would be needed, even straight.
    """
    out: list[list[Array]] = [[] for _ in q]
    at = np.array(q)
    left = manifold.compute_distances(q, aims)
    most = np.broadcast_to(most, len(q)) + 1e-9
    on = np.flatnonzero((left > MET) & (left / step <= most))
    while len(on):
        time.check_time()
        before = at[on]
        aim = aims[on]
        far = left[on] > step
        way = manifold.compute_steps(before, aim)
        if manifold.dim < manifold.system.nv and far.any():
            T = manifold.compute_frames(before[far]).tangent
            way[far] = np.einsum("kip,kp->ki", T, np.einsum("kip,ki->kp", T, way[far]))
        size = np.linalg.norm(way, axis=1)
        x, ok = manifold.close_configurations(
            manifold.move_configurations(
                before, way * np.minimum(1.0, step / np.maximum(size, 1e-300))[:, None]
            )
        )
        gone = manifold.compute_distances(before, x)
        rest = manifold.compute_distances(x, aim)
        ok &= (
            manifold.are_allowed(x)
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


def join_configurations_by_trees(
    manifold: Manifold,
    a: Array,
    b: Array,
    step: float,
    rng: np.random.Generator,
    most: int,
    time: TimeLimit,
) -> tuple[Array | None, int]:
    """Find a way (n, nq) from a to b on the manifold by two random trees, or None. Also return the
    size of the trees.
    """
    coarse = 2.0 * step
    trees = [Tree(manifold, a), Tree(manifold, b)]
    for k in range(most):
        time.check_time()
        one = trees[k % 2]
        other = trees[1 - k % 2]
        aim = other.q[0] if k < 2 else sample_configurations(manifold.system, rng)
        here = one.grow_tree(aim, coarse, time)
        there = other.grow_tree(one.q[here], coarse, time)
        if manifold.compute_distances(one.q[here][None], other.q[there][None])[0] < MET:
            ways = one.list_way(here), other.list_way(there)
            first, second = ways if k % 2 == 0 else ways[::-1]
            rough = [*first, *second[::-1][1:]]
            fine = _refine_way(
                manifold, _shorten_way(manifold, rough, coarse, rng, time), step, time
            )
            if fine is None:
                fine = _refine_way(manifold, rough, step, time)
            if fine is not None:
                return fine, len(one.q) + len(other.q)
            trees = [Tree(manifold, a), Tree(manifold, b)]
    return None, sum(len(t.q) for t in trees)


def _shorten_way(
    manifold: Manifold, way: list[Array], step: float, rng: np.random.Generator, time: TimeLimit
) -> list[Array]:
    """Shorten a way by shortcuts: in each round those that save most and do not overlap."""
    for _ in range(ROUNDS):
        if len(way) < 3:
            break
        ends = np.unique(np.sort(rng.integers(len(way), size=(SHORTCUTS, 2)), axis=1), axis=0)
        ends = ends[ends[:, 1] - ends[:, 0] > 1]
        points = np.array(way)
        i = ends[:, 0]
        j = ends[:, 1]
        cuts = step_towards_aims(manifold, points[i], points[j], step, time, j - i - 1)
        pairs: list[tuple[int, int]] = ends.tolist()
        better = [
            (len(cut) - (b - a), a, b, cut)
            for (a, b), cut in zip(pairs, cuts, strict=True)
            if cut and manifold.compute_distances(cut[-1][None], way[b][None])[0] < MET
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


def _refine_way(manifold: Manifold, way: list[Array], step: float, time: TimeLimit) -> Array | None:
    """Refine a way to steps of at most `step`, each checked by halving; return None if there is a
    jump.
    """
    q = np.array(way)
    for _ in range(DEEPEST):
        time.check_time()
        far = manifold.compute_distances(q[:-1], q[1:])
        half, ok = manifold.close_configurations(
            manifold.move_configurations(q[:-1], 0.5 * manifold.compute_steps(q[:-1], q[1:]))
        )
        parts = manifold.compute_distances(q[:-1], half) + manifold.compute_distances(half, q[1:])
        if not (ok & manifold.are_allowed(half) & (parts <= BENT * far + 1e-12)).all():
            return None
        long = far > step
        if not long.any():
            return q
        q = np.insert(q, np.flatnonzero(long) + 1, half[long], axis=0)
    return None


# ---- the answer and the verb

STEP = 0.1
"""Longest step of the motion unless the caller says otherwise, in radians and characteristic
lengths."""
USUAL = Usual("path", step=STEP, rng=0, iterations=4000, time_limit=TIME_LIMIT)


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Connection(Configurations):
    """Continuous motion between two configurations, or the reason why there is none.

    Attributes
    ----------
    q
        Configurations (n, nq) in steps of at most `step`; empty without a motion. Angles without
        limits may end whole turns away from the goal.
    code
        `NONE_EXISTS` if the two configurations are proven to be on different components,
        `OUTSIDE_LIMITS` if one of them is outside the limits.
    length
        Length of the motion in radians and characteristic lengths.
    """

    is_motion = True
    _entries = ("length", "step", "interrupted", "late")

    q: Array
    outcome: Status
    reason: str
    step: float
    system: Model
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
        """Length of the motion, in radians and characteristic lengths."""
        manifold = Manifold(self.system, 1)
        return (
            float(manifold.compute_distances(self.q[:-1], self.q[1:]).sum())
            if len(self.q) > 1
            else 0.0
        )


@explain_errors
@raise_interrupted
@limit_time(USUAL)
def find_connection(system: Model, q0: Any, q1: Any, *, budget: Budget | None = None) -> Connection:
    """Find a continuous motion from q0 to q1 (nq,) within limits and on all constraints.

    Otherwise return the reason why there is none.

    Where only limits bound the coordinates it is a straight line in them. With one freedom it
    follows the traced curve through q0, across bifurcations if need be. Otherwise two random trees
    grow on the closed configurations until they meet (Berenson, Srinivasa, Ferguson, Kuffner,
    2009), and the path is shortened and refined: the midpoint of any two neighbouring points was
    projected to a closed configuration, too, which lay between them. Of the `budget` are read: step
    (0.1 of arc length between two points, at most), rng (0), iterations (4000 branches), time_limit
    (120 s). Errors: `InputError` where q0 or q1 is no single configuration, or is not closed.
    """
    spend = USUAL.complete_budget(budget)
    if not is_real(spend.step) or not 1e-4 <= spend.step <= 1.0:
        raise InputError(
            f"step is {spend.step!r}; it must be between 1e-4 and 1, in radians and characteristic "
            "lengths"
        )
    time = find_time_limit(USUAL, budget)
    step = float(spend.step)
    rng = make_generator(spend.rng)
    try:
        a = _read_end(system, q0, "q0")
        b = _read_end(system, q1, "q1")
        manifold = Manifold(system, system.nv)
        for name, q in (("the start q0", a), ("the goal q1", b)):
            if not manifold.are_allowed(q[None])[0]:
                rows = manifold.one_sided
                which = ", ".join(
                    repr(rows.names[k]) for k in np.flatnonzero(rows.compute_excess(q) > 0.0)
                )
                why = f"{name} is outside the limits of {which}"
                return Connection(_make_empty_way(system), Status.OUTSIDE_LIMITS, why, step, system)
        if has_loops(system):
            return _connect_closed_loops(system, a, b, step, rng, spend, time)
        found = _make_straight_way(manifold, a, b, step)
        if manifold.are_allowed(found).all():
            return Connection(found, Status.SOLVED, "the straight way", step, system)
        return _connect_by_trees(manifold, a, b, step, rng, spend, time)
    except BROKEN_OFF as error:
        code = Status.OUT_OF_TIME if isinstance(error, TimeUp) else Status.INTERRUPTED
        return Connection(
            _make_empty_way(system),
            code,
            f"not found: {time.describe_end_reason(error)} came",
            step,
            system,
            isinstance(error, KeyboardInterrupt),
            isinstance(error, TimeUp),
        )


def _read_end(system: Model, q: Any, name: str) -> Array:
    """Read a configuration (nq,) that must be closed and allowed. Errors: `InputError`."""
    q = read_finite_q(system, q, name)
    judged = judge_configurations(system, q)
    if not judged:
        raise InputError(f"{name} is not closed, {judged}; assemble closes it")
    return q


def _make_empty_way(system: Model) -> Array:
    """Make a way (0, nq) without configurations."""
    return np.empty((0, system.nq))


def _make_straight_way(manifold: Manifold, a: Array, b: Array, step: float) -> Array:
    """Make the straight way from a to b in steps of at most `step`."""
    way = manifold.compute_steps(a[None], b[None])[0]
    n = max(1, int(np.ceil(np.linalg.norm(way) / step)))
    return manifold.move_configurations(
        np.repeat(a[None], n + 1, axis=0), np.linspace(0.0, 1.0, n + 1)[:, None] * way
    )


def _connect_closed_loops(
    system: Model,
    a: Array,
    b: Array,
    step: float,
    rng: np.random.Generator,
    spend: Budget,
    time: TimeLimit,
) -> Connection:
    """Connect two configurations of a system with loops, if possible along curves."""
    free = (
        with_limits(system, dict.fromkeys(system.coordinate_names)) if system.dim == 2 else system
    )
    ends = np.stack([a, b])
    for loop in (find_polygon(free), find_four_joints(system)):
        if isinstance(loop, str):
            continue
        label = loop.label_components(ends)
        if label[0] != label[1] and label.min() >= 0:
            why = f"they are on different components, proven: {loop.reason}"
            return Connection(_make_empty_way(system), Status.NONE_EXISTS, why, step, system)
    freedoms = mobility(system, a)
    exact, _ = Manifold(system, 1).close_configurations(ends)
    if freedoms.useful == 1:
        part = _find_component(system, exact[0], spend)
        if (why := _explain_separation(part, exact)) is not None:
            return Connection(
                _make_empty_way(system), why[0], why[1], step, system, False, part.paths[0].late
            )
        if not freedoms.idle:
            return _follow_curves(part, exact, step)
    unsure = freedoms.dof is None or freedoms.singular
    dim = freedoms.generic_rank_dof if unsure else freedoms.dof
    return _connect_by_trees(Manifold(system, dim or 1), exact[0], exact[1], step, rng, spend, time)


# ---- the verb: along traced curves


def _find_component(system: Model, a: Array, spend: Budget) -> Component:
    """Trace the component that contains the configuration a, as far as possible."""
    first = trace(system, start=a, ways="branches", budget=Budget(time_limit=spend.time_limit))
    return Component((first, *first.others), find_idle_coordinates(system, a))


def _explain_separation(part: Component, ends: Array) -> tuple[Status, str] | None:
    """Explain why the curve through the first of two configurations misses the other. Also return
    the outcome.
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


def _follow_curves(part: Component, ends: Array, step: float) -> Connection:
    """Return the way along the traced curves through both ends (2, nq)."""
    (a, b) = ends
    (which, s, _) = part.place(ends)
    system = part.paths[0].system
    legs = _find_route(part, (int(which[0]), float(s[0])), (int(which[1]), float(s[1])))
    pieces = [
        part.paths[k].at(np.linspace(x, y, max(2, int(np.ceil(abs(y - x) / step)) + 1)))
        for k, x, y in legs
    ]
    over = sum(k != j for (k, *_), (j, *_) in zip(legs, legs[1:], strict=False))
    q = np.concatenate([a[None], *pieces, b[None]])
    manifold = Manifold(system, 1)
    keep = np.append(True, manifold.compute_distances(q[:-1], q[1:]) > CLOSED)
    q = q[keep] if keep.sum() > 1 else q[[0, -1]]
    how = "along the traced curve" + (
        f", over {over} bifurcation{'s' * (over > 1)}" if over else ""
    )
    return Connection(q, Status.SOLVED, how, step, system)


def _find_route(
    part: Component, begin: tuple[int, float], end: tuple[int, float]
) -> list[tuple[int, float, float]]:
    """Find the legs (curve, from, to) of the shortest way between two places (Dijkstra, 1959). The
    curves meet at singular points; a `to` beyond the length of a closed curve goes on around.
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
                and metric.compute_distances(q[None], point[None])[0] < SAME
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


# ---- the verb: by random trees


def _connect_by_trees(
    manifold: Manifold,
    a: Array,
    b: Array,
    step: float,
    rng: np.random.Generator,
    spend: Budget,
    time: TimeLimit,
) -> Connection:
    """Connect two configurations by random trees on the manifold."""
    found, grown = join_configurations_by_trees(
        manifold, a, b, step, rng, int(spend.iterations or 1), time
    )
    if found is None:
        why = (
            f"two random trees of {grown} configurations did not meet, which is no proof that "
            "there is no way"
        )
        return Connection(
            _make_empty_way(manifold.system), Status.NOT_FOUND, why, step, manifold.system
        )
    how = f"found by two random trees of {grown} configurations together"
    return Connection(found, Status.SOLVED, how, step, manifold.system)
