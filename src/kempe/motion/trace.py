"""The verb `trace`: the whole branch of a mechanism with one degree of freedom.

At a crossing the walk goes straight on, and the other branches are recorded; `trace_branches` follows
these, too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import explain_errors, raise_interrupted, read_flag
from kempe.arrays import is_mapping, is_whole
from kempe.assemble.idle_freedoms import find_spin_lock
from kempe.assemble.nearest_exact import answer_within_tolerance
from kempe.budget import Budget, TimeUp, Usual
from kempe.equations.closure import Closure
from kempe.equations.slip import find_first_slip
from kempe.errors import InputError
from kempe.geometry.clearance import watch_clearances
from kempe.geometry.path_clearance import PathGuard, read_clearances
from kempe.model.configurations import find_home, read_q
from kempe.motion.crossings import SingularNode, is_rank_held
from kempe.motion.events import (
    HOME_CROSSING,
    SAME_NODE,
    OneSidedEnds,
    WalkEnd,
    find_extreme,
    find_return,
    insert_hidden_crossings,
    is_side_changed,
    list_turns,
    walk_curve,
)
from kempe.motion.path import Event, Path, Track
from kempe.motion.start import (
    MOST_TURNS,
    SAME_RATIO,
    begin_motion,
    explain_open_loop,
    find_angle_or_slide,
    find_first_node,
    find_periods,
    list_wound_followers,
    read_longest_step,
    read_start_configuration,
)
from kempe.numerics.clock import BROKEN_OFF, TIME_LIMIT, TimeLimit, find_time_limit, limit_time
from kempe.numerics.curves import (
    Node,
    compute_bend_angle,
    estimate_arc_length,
    estimate_arc_lengths,
    find_next_node,
    make_node,
)
from kempe.spatial import Array
from kempe.words import make_plural

if TYPE_CHECKING:
    from kempe.argument_types import StartLike
    from kempe.constraints.base import Constraint
    from kempe.model.model import Model


# ---- motions without end

# Slides run away to infinity, or gears never bring all back to where it was. That a curve runs away
# is evidence, found by going on in longer and longer steps; so is a ratio of whole numbers that is
# missing: a computer's number is always a fraction. What is said is what was looked at.

FAR = 50.0
"""Characteristic lengths that a slide, and radians that a turn without return, is away before one
looks ahead."""
AHEAD = 1e4
"""How many of them one looks ahead."""
STRAIGHT = 1e-9
"""Change of the direction over `SOON` below which a curve counts as straight, and one looks ahead
at once."""
SAME_RATE = 1e-8
"""How near the ratio of two rates of a straight curve must be to one of whole numbers: rates are
computed, far from the origin with less digits."""
SOON = 8.0
"""Arc length after which that is checked."""
NO_RETURN = "a place like any other of a motion that does not come back"
"""How a reason begins that holds both ways."""
ROUNDS = 10
"""Turns after which a curve ends that a gear ratio keeps from closing."""
MOVES = 1e-9
"""Share of a direction below which a coordinate rests."""


class Endless:
    """A test of whether a walk from a first node on has no end.

    `limits` are the bounds that may still end it.
    """

    def __init__(self, equations: Closure, first: Node, periods: Array, limits: OneSidedEnds):
        self.equations = equations
        self.first = first
        self.periods = periods
        self.limits = limits
        system = equations.system
        self.away = np.array(
            [i for i in system.structure.layout.vector_v if not periods[i]], dtype=np.int64
        )
        self.place = equations.place[self.away]
        self.followers = list_wound_followers(system, limits.limits)
        self.next = FAR
        self.requested = False

    def explain_endless_curve(self, b: Node, length: float) -> str:
        """Explain why the curve has no end; "" as long as nothing speaks for that."""
        for f in self.followers:
            if f.turns and self._compute_turn(b, f.source) > 2.0 * math.pi * ROUNDS:
                return self._explain_unrelated_turns(f.name, f.factor, f.source)
        if not self.requested and length > SOON:
            self.requested = True
            if float(np.abs(b.t - self.first.t).max()) < STRAIGHT:
                return self._explain_straight_curve(b)
        if not self.away.size:
            return ""
        out = np.abs(b.x[self.place] - self.first.x[self.place]) / self.equations.unit[self.away]
        if float(out.max()) < self.next:
            return ""
        self.next *= 4.0
        return self._explain_endless_growth(b)

    def describe_return(self, b: Node) -> str:
        """Describe what is known about when a curve closes that was not followed so far."""
        whole = np.flatnonzero(self.periods > 7.0)
        i = max(whole.tolist(), key=lambda i: self._compute_turn(b, i), default=-1)
        if i < 0 or self._compute_turn(b, i) < 2.0 * math.pi:
            return ""
        name = self.equations.system.structure.velocity_names[i]
        turns = round(self.periods[i] / (2.0 * math.pi))
        done = f"{self._compute_turn(b, i) / (2.0 * math.pi):.4g}"
        after = f"{done} {make_plural(float(done), 'turn')} of {name!r}"
        return f", after {after}: by its gear ratios all is as before after {turns}"

    def _compute_turn(self, b: Node, i: int) -> float:
        """Compute how far coordinate i is from its value at first, in radians or metres."""
        at = self.equations.place[i]
        return abs(float(b.x[at] - self.first.x[at]))

    def _explain_straight_curve(self, b: Node) -> str:
        """Explain why a straight curve has no end: coordinates grow at constant rates."""
        moving = [
            int(i) for i in self.equations.system.structure.layout.vector_v if abs(b.t[i]) > MOVES
        ]
        for f in self.followers:
            if f.turns and f.source in moving:
                return self._explain_unrelated_turns(f.name, f.factor, f.source)
        if any(i in self.away for i in moving):
            return self._explain_endless_growth(b)
        lead = max(moving, key=lambda i: abs(b.t[i]) / self.periods[i], default=-1)
        for i in moving:
            factor = float(b.t[i] / b.t[lead])
            ratio = Fraction(factor * self.periods[lead] / self.periods[i]).limit_denominator(
                MOST_TURNS
            )
            if abs(float(ratio) * self.periods[i] / self.periods[lead] - factor) > SAME_RATE:
                return self._explain_unrelated_turns(
                    self.equations.system.structure.velocity_names[i], factor, lead, SAME_RATE
                )
        return ""

    def _explain_unrelated_turns(
        self, name: str, factor: float, source: int, within: float = SAME_RATIO
    ) -> str:
        """Explain that a coordinate and its source do not return together."""
        digits = round(-math.log10(within))
        of = self.equations.system.structure.velocity_names[source]
        return (
            f"{NO_RETURN} within {MOST_TURNS} turns of {of!r}: {name!r} turns "
            f"{abs(factor):.{digits}g} times as fast, which to {digits} digits is no ratio of "
            f"whole numbers up to {MOST_TURNS}"
        )

    def _explain_endless_growth(self, b: Node) -> str:
        """Explain which coordinates grow without end, by longer and longer steps ahead.

        The text is empty where one of them turns back, or the curve ends.
        """
        equations = self.equations
        h = 1.0
        gone = 0.0
        rest = [i for i in self.away if abs(b.t[i]) > 1e-3]
        if not rest or self.limits.may_reach_bound(b, rest):
            return ""
        a = b
        while gone < AHEAD:
            c = find_next_node(equations, a, h)
            if (
                c is None
                or compute_bend_angle(a, c) > 0.1
                or is_side_changed(equations, a, c)
                or np.any(c.t[rest] * b.t[rest] <= 0.0)
            ):
                if h <= 1e-2 * max(gone, 1.0):
                    return ""
                h *= 0.5
                continue
            gone = gone + h
            a = c
            h = min(2.0 * h, max(gone, 1.0))
        names = equations.system.structure.velocity_names
        shown = [
            f"{names[i]!r} = {a.x[equations.place[i]]:.3g}"
            for i in sorted(rest, key=lambda i: -abs(a.t[i]))[:3]
        ]
        return f"infinity: no end was found up to {', '.join(shown)}"


# ---- the verbs

# Pseudo-arclength continuation in all velocity coordinates (Keller, 1977; Allgower, Georg, 1990):
# the driver is not special, so dead points are ordinary points. Where branches touch or end in a
# cusp the walk goes on along the half-branch that is the other half of its own.

NONE = np.zeros((0, 0))
SAME_POINT = 1e-6
"""Distance below which two singular points are the same."""

LOW = "the rank is low all along, so that crossings with other branches may be passed unseen"
"""What is said of a path along which the equations touch."""
AGAIN = 4
"""How often a path is walked again, at most, with idle spins held by directions that are farther
from their lines."""
MOST_POINTS = 100_000
"""Points of a path unless the caller says otherwise."""
WAYS = ("both", "forward", "branches")
USUAL = Usual("trace", points=MOST_POINTS, step=None, time_limit=TIME_LIMIT, progress=None)

Progress = Callable[[int, float], Any]


@dataclass(frozen=True)
class _Options:
    """Options that all walks of one call share."""

    driver: str | None
    ways: str
    longest: float
    limits: bool
    most: int
    progress: Progress | None
    periods: Array
    time: TimeLimit
    guard: PathGuard | None = None


def _make_unstarted_path(
    time: TimeLimit,
    system: Model,
    driver: str | None = None,
    start: Any = None,
    *,
    hold: Mapping[str, float] | None = None,
    ways: str = "both",
    limits: bool = True,
    budget: Budget | None = None,
    **_: Any,
) -> Path:
    """Return the answer where the time was up before a closed configuration was known.

    The path stays where `start` is, or at home.
    """
    near = (
        find_home(system)
        if start is None or isinstance(start, str) or is_mapping(start)
        else read_q(system, start)
    )
    options = _read_options(system, driver, ways, limits, USUAL.complete_budget(budget))
    held = [*(hold or ())]
    equations = Closure(system, [find_angle_or_slide(system, n) for n in held], near)
    said = f"it was not followed: {time.describe_end_reason(TimeUp())} came before a closed configuration was known"
    return replace(_make_failed_path(equations, options, said, near), late=True)


@explain_errors
@raise_interrupted
@limit_time(USUAL, _make_unstarted_path)
@answer_within_tolerance()
def trace(
    system: Model,
    driver: str | None = None,
    start: StartLike | None = None,
    *,
    hold: Mapping[str, float] | None = None,
    toward: Mapping[str, float] | None = None,
    ways: str = "both",
    limits: bool = True,
    clearance: Constraint | Sequence[Constraint] | None = None,
    tolerance: float | str | None = None,
    budget: Budget | None = None,
) -> Path:
    """Trace the branch of a mechanism with one degree of freedom; see `System.trace`."""
    options = _read_options(system, driver, ways, limits, USUAL.complete_budget(budget))
    if clearance is not None:
        guard = PathGuard(system, watch_clearances(system, read_clearances(clearance)))
        options = replace(options, guard=guard)
    held = dict(hold or {})
    equations, q = begin_motion(system, start, held)
    if q is None:
        return _make_failed_path(
            equations,
            options,
            explain_open_loop(system, start, held),
            read_start_configuration(system, start, held),
        )
    if said := OneSidedEnds(equations, limits).describe_violation(q):
        return _make_failed_path(equations, options, f"{said} at the start", q)
    if options.guard and (met := options.guard.find_near_configuration(q[None])):
        return _make_failed_path(equations, options, f"{met.describe_bodies()} at the start", q)
    equations.budget = options.time
    try:
        return refuse_slip(_follow_path(equations, q, options, toward))
    except TimeUp as error:
        said = (
            f"it was not followed: {options.time.describe_end_reason(error)} came before the directions at its "
            "start were known"
        )
        return replace(_make_failed_path(equations, options, said, q), late=True)
    finally:
        equations.budget = TimeLimit(None)  # the path keeps them


def refuse_slip(path: Path) -> Path:
    """Return the path, marked as no success where it slips."""
    slip = find_first_slip(path.system, path.q)
    if slip is None:
        return path
    said = (
        f"before point {slip.index} it {slip.text}: positions were traced, drive and simulate "
        "follow what rolls"
    )
    return replace(path, success=False, remark="; ".join(filter(None, [path.remark, said])))


def _follow_path(
    equations: Closure, q: Array, options: _Options, toward: Mapping[str, float] | None
) -> Path:
    """Follow the path from a closed configuration on."""
    first = find_first_node(equations, q, options.driver, toward)
    if first is None:
        return _make_failed_path(
            equations, options, "it cannot move: no degree of freedom is left", q, True
        )
    path = _trace_branch(equations, first, options)
    lock = find_spin_lock(equations)
    for _ in range(AGAIN):
        if (
            lock is None
            or path.late
            or path.interrupted
            or not lock.replace_near_directions(path.q)
        ):
            break
        equations.set_lock(lock)  # by other directions, what spins turns less
        first = find_first_node(equations, q, options.driver, toward) or first
        path = _trace_branch(equations, first, options)
    if is_rank_held(equations):
        path = replace(path, remark="; ".join(filter(None, [path.remark, LOW])))
    if len(path) == 1 and path.success and path.ends[1].startswith("a point"):
        said = "it cannot move along a smooth curve: its first-order motion leads nowhere (shaky)"
        return _make_failed_path(equations, options, said, q, True)
    return _add_other_branches(equations, path, options) if options.ways == "branches" else path


def trace_branches(
    system: Model, driver: str | None = None, start: Any = None, **options: Any
) -> tuple[Path, ...]:
    """Trace all paths that meet at bifurcations, beginning with the path through `start`.

    Arguments are those of `trace`.
    """
    options["ways"] = "branches"
    path = trace(system, driver, start, **options)
    return (replace(path, others=()), *path.others)


# ---- where it begins


def _read_options(
    system: Model, driver: str | None, ways: str, limits: bool, spend: Budget
) -> _Options:
    """Read the options of a call of `trace`. Errors: `InputError`."""
    read_flag(limits, "limits")
    if ways not in WAYS:
        raise InputError(f"ways is {ways!r}; it must be one of {', '.join(map(repr, WAYS))}")
    if driver is not None:
        find_angle_or_slide(system, driver)
    longest = read_longest_step(spend.step)
    points = spend.points
    if not is_whole(points) or points < 2:
        raise InputError(f"points is {points!r}; it must be a whole number, at least 2")
    return _Options(
        driver,
        ways,
        longest,
        limits,
        int(points),
        spend.progress,
        find_periods(system, limits),
        find_time_limit(USUAL, spend),
    )


# ---- the walk


def _trace_branch(equations: Closure, first: Node, options: _Options) -> Path:
    """Trace the whole branch from its first node."""
    nodes, reason, closed, broken = _walk_clear_curve(equations, first, options, options.most)
    ends = ("the start", reason)
    left = options.most - len(nodes)
    if (
        options.ways != "forward"
        and not closed
        and broken is None
        and left > 1
        and not reason.startswith(NO_RETURN)
    ):
        singular = isinstance(first, SingularNode)
        back, other, around, broken = _walk_clear_curve(
            equations,
            first.make_opposite_node() if singular else first.reverse_direction(),
            options,
            left,
        )
        if around:  # its points lie elsewhere than those before bodies that are just too near
            back, other = _leave_out(equations, back, nodes), reason
        nodes = (
            [n.reverse_direction() for n in reversed(back[1:])]
            + (first.list_arrival_nodes() if singular else [])
            + nodes
        )
        ends = (other, reason)
    return _make_path(equations, nodes, options, closed, ends, broken)


def _walk_clear_curve(
    equations: Closure, first: Node, options: _Options, most: int
) -> tuple[list[Node], str, bool, BaseException | None]:
    """Walk one way from the first node, as far as bodies keep their clearances.

    Returned is what `_walk_half_curve` returns.
    """
    nodes, reason, closed, broken = _walk_half_curve(equations, first, options, most)
    if options.guard is None:
        return nodes, reason, closed, broken
    q: Array = np.array([n.x for n in nodes])
    checked, met = options.guard.check_in_time(q, options.time)
    if met is not None:
        said = f"the last point before {met.describe_bodies()}"
        return nodes[: max(met.clear, 1)], said, False, broken
    if checked < len(nodes):
        late = TimeUp()
        return nodes[:checked], options.time.describe_end_reason(late), False, late
    return nodes, reason, closed, broken


def _leave_out(equations: Closure, back: list[Node], nodes: list[Node]) -> list[Node]:
    """Return what is left of a way back around a closed curve, without the way there."""
    s = _compute_lengths(equations, back)
    there = float(_compute_lengths(equations, nodes)[-1])
    return back[: max(int(np.count_nonzero(s < s[-1] - there)), 1)]


def _walk_half_curve(
    equations: Closure, first: Node, options: _Options, most: int
) -> tuple[list[Node], str, bool, BaseException | None]:
    """Walk one way from the first node.

    Returned are the nodes, why they end, whether the curve returned to the start, and the exception
    that broke the walk off, if any.
    """
    nodes = [first]
    limits = OneSidedEnds(equations, options.limits)
    length = 0.0
    endless = Endless(equations, first, options.periods, limits)
    try:
        for b in walk_curve(equations, first, options.longest, options.periods):
            a = nodes[-1]
            if isinstance(b, WalkEnd):
                return nodes, b.reason, False, None
            hit = None if a.x is b.x else limits.find_first_bound(equations, a, b)
            back = find_return(equations, a, b, first, options.periods) if length > 0.0 else None
            if back is not None and (hit is None or _is_before(equations, a, back, hit[0])):
                return [*nodes, back], "the start", True, None
            if hit is not None:
                return nodes if hit[0] is a else [*nodes, hit[0]], hit[1], False, None
            nodes.append(replace(b, matrix=NONE, image=NONE))  # the walk keeps its last one whole
            length += estimate_arc_length(equations, a, b)
            if reason := endless.explain_endless_curve(b, length):
                return nodes, reason, False, None
            if options.progress is not None and len(nodes) % 16 == 0:
                options.progress(len(nodes), length)
            if len(nodes) >= most:
                return (
                    nodes,
                    f"the {options.most} points allowed{endless.describe_return(b)}",
                    False,
                    None,
                )
    except BROKEN_OFF as error:
        return nodes, options.time.describe_end_reason(error), False, error
    raise AssertionError("a walk ends only with a reason")


def _is_before(equations: Closure, a: Node, first: Node, second: Node) -> bool:
    """Tell whether one node comes before another on the curve after `a`."""
    return float(
        np.linalg.norm(
            equations.compute_difference(a.x, first.x) - equations.compute_difference(a.x, second.x)
        )
    ) < 1e-12 or (
        float(a.t @ equations.compute_difference(a.x, first.x))
        <= float(a.t @ equations.compute_difference(a.x, second.x))
    )


def _make_path(
    equations: Closure,
    nodes: list[Node],
    options: _Options,
    closed: bool,
    ends: tuple[str, str],
    broken: BaseException | None,
) -> Path:
    """Make the answer from the nodes of a branch."""
    system = equations.system
    remark = ""
    found: list[Event] = []
    options.time.release_reserved_time()
    indices = [int(i) for i in system.structure.layout.vector_v if i not in equations.held]
    s = None
    k = 0
    try:
        nodes = insert_hidden_crossings(equations, nodes)
        s = _compute_lengths(equations, nodes)
        for k, m, i in list_turns(nodes, closed, indices):
            if (n := find_extreme(equations, nodes, k, m, i)) is not None:
                name = system.structure.velocity_names[i]
                kind = "fold of the driver" if name == options.driver else "extreme"
                at = (
                    float(s[k]) + estimate_arc_length(equations, nodes[k], n)
                    if n is not nodes[0]
                    else 0.0
                )
                found.append(Event(n.x, at, kind, name, float(n.x[equations.place[i]])))
    except BROKEN_OFF as error:
        broken = broken or error
        s = _compute_lengths(equations, nodes) if s is None else s
        remark = f"where it turns back was looked for up to s = {s[k]:.6g} only"
    found.sort(key=lambda e: e.s)
    track = Track(equations, np.array([n.x for n in nodes]), s, np.array([n.t for n in nodes]))
    once = np.append(True, np.diff(s) > SAME_NODE)  # cusps are two nodes
    turning = tuple(e for e in found if options.driver is None or e.coordinate == options.driver)
    held = tuple(system.structure.velocity_names[i] for i in equations.held)
    singular = _list_singular_events(equations, nodes[:-1] if closed else nodes, s)
    return Path(
        track.q[once],
        s[once],
        closed,
        ends,
        turning,
        singular,
        tuple(found),
        options.driver,
        held,
        (),
        broken is None,
        isinstance(broken, KeyboardInterrupt),
        track,
        late=isinstance(broken, TimeUp),
        remark=remark,
    )


def _compute_lengths(equations: Closure, nodes: list[Node]) -> Array:
    """Compute the arc lengths (n,) of nodes."""
    x = np.array([n.x for n in nodes])
    return estimate_arc_lengths(equations, x, np.array([n.t for n in nodes]))


def _list_singular_events(equations: Closure, nodes: list[Node], s: Array) -> tuple[Event, ...]:
    """List the singular points among nodes at arc lengths `s`."""
    out: list[Event] = []
    for k, n in enumerate(nodes):
        if n.lines is not None:
            own = np.argmax(np.abs(n.lines @ n.t))
            order = [int(own), *(j for j in range(len(n.lines)) if j != own)]
            lines = n.lines[order] * equations.unit
            own = n if isinstance(n, SingularNode) else None
            cusp = own is not None and own.germ.is_cusp(own.half)
            kind = "bifurcation" if len(lines) > 1 else "cusp" if cusp else "singular"
            out.append(
                Event(
                    n.x,
                    float(s[k]),
                    kind,
                    nullity=n.nullity,
                    directions=lines,
                    complete=n.complete,
                    node=own,
                )
            )
    return tuple(out)


def _make_failed_path(
    equations: Closure, options: _Options, reason: str, q: Array, success: bool = False
) -> Path:
    """Return the path of one point that could not be left."""
    track = Track(equations, q[None], np.zeros(1), np.zeros((1, equations.n)))
    held = tuple(equations.system.structure.velocity_names[i] for i in equations.held)
    return Path(
        track.q,
        track.s,
        False,
        (reason, reason),
        (),
        (),
        (),
        options.driver,
        held,
        (),
        success,
        False,
        track,
    )


# ---- other branches


def _add_other_branches(equations: Closure, path: Path, options: _Options) -> Path:
    """Return the path with the branches that leave it at bifurcations, and those that leave these."""
    found = [path]
    waiting = list(path.singular_points)
    broken = None
    try:
        while waiting and all(found):
            event = waiting.pop(0)
            assert event.directions is not None
            for first in _list_branch_nodes(equations, event):
                if any(_has_branch(equations, p, first, options.periods) for p in found):
                    continue
                other = _trace_branch(equations, first, options)
                found.append(other)
                waiting += other.singular_points
    except BROKEN_OFF as error:
        broken = error
    listed = all(event.complete for p in found for event in p.singular_points)
    if broken is None and listed and all(found):
        return replace(path, others=tuple(found[1:]))
    late = isinstance(broken, TimeUp) or any(p.late for p in found)
    interrupted = isinstance(broken, KeyboardInterrupt) or any(p.interrupted for p in found)
    more = "; ".join(filter(None, [path.remark, "other branches were not all followed"]))
    return replace(
        path,
        others=tuple(found[1:]),
        success=False,
        interrupted=interrupted,
        late=late,
        remark=more,
    )


def _list_branch_nodes(equations: Closure, event: Event) -> list[Node]:
    """Return a node on each of the branches that meet at a singular point of a path."""
    if event.node is not None:
        germ = event.node.germ
        return [germ.make_node(i) for i, j in enumerate(germ.partner) if i < j]
    assert event.directions is not None
    at = make_node(equations, event.q)
    lines = event.directions / equations.unit
    return [
        Node(event.q, t, at.sigma, max(at.nullity, 2), at.matrix, at.image, lines) for t in lines
    ]


def _has_branch(equations: Closure, path: Path, first: Node, period: Array) -> bool:
    """Tell whether a path passes a singular point on the branch of the node `first`."""
    for event in path.singular_points:
        y = equations.compute_difference(event.q, first.x) * equations.unit
        turns = np.divide(y, period, out=np.zeros_like(y), where=period > 0.0)
        gap = np.linalg.norm((y - np.round(turns) * period) / equations.unit)
        if event.node is not None and isinstance(first, SingularNode):
            other = event.node
            own = equations.move_point(first.x, first.germ.samples[first.half, 1])
            back = equations.system.structure.layout.integrate_velocity(
                own, -np.round(turns) * period
            )
            if gap < HOME_CROSSING and other.germ.find_half_branch(equations, [back]) in (
                other.half,
                other.make_opposite_node().half,
            ):
                return True
        elif gap < SAME_POINT and event.directions is not None:
            own = event.directions[0] / equations.unit
            if abs(own @ first.t) > 0.999 * np.linalg.norm(own) * np.linalg.norm(first.t):
                return True
    return False
