"""Events along a curve: crossings, limits, turning points, singular points, the start again."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from kempe.equations.closure import Closure
from kempe.equations.one_sided import OneSided, pack_one_sided_rows
from kempe.motion.crossings import (
    AHEAD,
    SingularNode,
    find_crossing,
    find_passage,
    find_touching_branches,
    is_rank_held,
    locate_singular_point,
    make_singular_node,
)
from kempe.numerics import curves
from kempe.numerics.curves import (
    BEND,
    Node,
    compute_bend_angle,
    find_next_node,
    find_node_between,
    guess_point_between,
    is_determinant_flipped,
    make_node,
)
from kempe.numerics.newton import LARGE
from kempe.numerics.rank import Level, Spectrum
from kempe.numerics.roots import find_sign_change
from kempe.spatial import Array
from kempe.words import InWords

AWKWARD = 1e-5
"""Relative singular value below which a step had better land elsewhere: rounding is blown up
there."""
HIDDEN = 1e-5
"""Relative singular value, falling, below which a curve may come to a point near which rounding
hides it."""
NEARLY = 1e-3
"""Relative singular value at both ends of a step below which it may lead past a point where
branches touch."""
RESTING = 1e-9
"""Rates below this count as zero."""
NOISE = 1e-12
"""Rates below this count as zero where each look at one costs milliseconds; places then are known
to as many digits."""
SAME_NODE = 1e-9
"""Distance between neighbours below which they are one point, at which the curve arrives and from
which it leaves."""
RECENT = 100
"""Points of a walk that are kept, to tell on which half-branch it came to a singular point."""
STEPS = 32
"""Steps that are taken at once."""
MOST_SKIPPED = 16
"""Single steps at most before many are tried again."""
STRAIGHT = 1e-9
"""Rates of the equations along a tangent below which they are rounding."""
HOME = 1e-7
"""Distance from the start at which a curve has returned to it, if it also arrives in the same
direction."""
HOME_CROSSING = 1e-4
"""The same where the start is a crossing: points beside it are known less well."""


# ---- steps and special points


@dataclass(frozen=True)
class WalkEnd:
    """The end of a walk along a curve, with the reason as a sentence."""

    reason: str


def walk_curve(
    equations: Closure, a: Node, longest: float, periods: Array
) -> Iterator[Node | WalkEnd]:
    """Iterate over the nodes of the curve after `a`, straight on through crossings.

    Crossings are among them; the last one may be a `WalkEnd`.

    At a cusp the curve arrives at one node and leaves from another one, at the same point.
    `periods` (nv,) are 0 for coordinates that do not come back by turning on.
    """

    def take_step(a: Node, h: float) -> list[Node] | None:
        """Return the nodes of one step, or None where it failed."""
        b = find_next_node(equations, a, h)
        if b is not None and b.sigma < AWKWARD:
            b = find_next_node(equations, a, 1.3 * h) or b
        return accept_step(equations, a, b)

    h = 0.25 * longest
    regular = RegularWalk(equations, longest)
    known = [a.germ] if isinstance(a, SingularNode) else []
    while True:
        if isinstance(a, SingularNode):
            there = a.germ.make_first_node(equations, a.half)
            h = min(
                longest, 0.5 * float(np.linalg.norm(equations.compute_difference(a.x, there.x)))
            )
            a = there
            yield a
        last = deque([a.x], maxlen=RECENT)
        singular = None
        sigma = a.sigma
        for b in curves.walk_curve(a, take_step, longest, h, many=regular.take_steps):
            before = last[-1]
            last.append(b.x)
            # nearer to a point where rounding hides the curve
            if b.sigma < min(HIDDEN, sigma) and b.lines is None:
                singular = find_passage(equations, last, known, periods)
                way = equations.compute_difference(before, b.x if singular is None else singular.x)
                along = float(way @ equations.compute_difference(before, b.x))
                if singular is not None and along > 0.0:  # else the walk leaves it
                    if along < way @ way:
                        yield b  # not beyond it
                    break
                singular = None
            yield b
            sigma = b.sigma
        else:
            singular = find_passage(equations, last, known, periods) if len(last) > 1 else None
        if singular is None:
            yield WalkEnd("a point where the curve is not smooth")
            return
        known.append(singular.germ)
        yield from singular.list_arrival_nodes()
        yield singular
        a = singular


# Away from singular points a kernel takes the steps, one after the other as `find_next_node` does.
# What `accept_step` asks of both ends of a step is then verified for all of them at once; the first
# that fails is left to single steps.


class Patience:
    """Single steps that come before many at once are tried again.

    After each failure in a row there are twice as many and one more, `MOST_SKIPPED` at most.
    """

    def __init__(self):
        self.waiting = 0
        self.skipped = 0

    def count_step(self) -> bool:
        """Count a step; return whether it may be one of many."""
        is_over = not self.waiting
        self.waiting = max(self.waiting - 1, 0)
        return is_over

    def record_trial(self, success: bool) -> None:
        """Record whether many steps were taken."""
        self.skipped = 0 if success else min(2 * self.skipped + 1, MOST_SKIPPED)
        self.waiting = self.skipped


class RegularWalk:
    """Steps of a walk away from singular points, many at a time."""

    def __init__(self, equations: Closure, longest: float):
        self.equations = equations
        self.longest = longest
        self.patience = Patience()

    def take_steps(self, a: Node, h: float) -> tuple[list[Node], float]:
        """Take steps from a node, the first of length `h`.

        Returned are the nodes, none where the next step is left to single steps, and the length of
        the next step. Only the last node has its matrices.
        """
        regular = self.equations.follows_by_kernel and a.nullity == 1 and a.lines is None
        if not self.patience.count_step() or not regular:
            return [], h
        points, tangents, lengths = self.equations.follow_regular_curve(
            a.x, a.t, h, self.longest, STEPS
        )
        x = np.concatenate([a.x[None], points])
        t = np.concatenate([a.t[None], tangents])
        nodes = self._verify_steps(x, t) if len(points) else []
        self.patience.record_trial(bool(nodes))
        return nodes, float(lengths[len(nodes) - 1]) if nodes else h

    def _verify_steps(self, x: Array, t: Array) -> list[Node]:
        """Return the nodes of the first steps between points (k, nq) that are regular.

        `t` (k, n) are the tangents.
        """
        equations = self.equations
        J = equations.evaluate_many_points(x)[1]
        s = Spectrum(J, equations.least)
        sigma = s.values[:, equations.n - 2] / s.largest if equations.n > 1 else np.ones(len(x))
        good = (s.compute_ranks(Level.CLOSED) == equations.n - 1) & (sigma > NEARLY)
        good &= np.abs(J @ t[..., None]).max(axis=(1, 2)) < STRAIGHT
        same = curves.are_sides_same(np.concatenate([J, t[:, None]], axis=1))
        taken = int(np.argmin(np.append(good[:-1] & good[1:] & same, False)))
        nodes = [
            Node(x[i], t[i], float(sigma[i]), 1, curves.NONE, curves.NONE)
            for i in range(1, taken + 1)
        ]
        if nodes:
            nodes[-1] = make_node(equations, x[taken], t[taken], J[taken])
        return nodes


def accept_step(equations: Closure, a: Node, b: Node | None) -> list[Node] | None:
    """Return the nodes of a step from `a` to `b`, with the crossing between them, if any.

    None is returned where the step may have changed the branch.
    """
    if b is None:
        return None
    turned = is_side_changed(equations, a, b)
    if not turned:
        return None if turned is None or _may_pass_touching_branches(equations, a, b) else [b]
    middle = find_crossing(equations, a, b)
    # the step may have led to another one of the branches that touch there
    if isinstance(middle, SingularNode):
        return [middle, middle.germ.make_first_node(equations, middle.half)]
    return None if middle is None else [middle, b]


def _may_pass_touching_branches(equations: Closure, a: Node, b: Node) -> bool:
    """Tell whether a step may have passed a singular point at which branches touch.

    It may have led to another branch, or round a cusp.
    """
    if max(a.sigma, b.sigma) > NEARLY or a.lines is not None:
        return False
    y = equations.compute_difference(a.x, b.x)
    h = float(np.linalg.norm(y))
    x = (
        locate_singular_point(equations, equations.move_point(a.x, 0.5 * y), 2, h)
        if equations.n > 1
        else None
    )
    germ = None if x is None else find_touching_branches(equations, x)
    if germ is None:
        return False
    along = float(equations.compute_difference(a.x, germ.x) @ y) / h
    first, second = (germ.find_half_branch(equations, [n.x]) for n in (a, b))
    return 0.0 < along < h and first is not None and second not in (None, germ.partner[first])


def is_side_changed(equations: Closure, a: Node, b: Node) -> bool | None:
    """Tell whether an odd number of crossings is between two nodes, by `flipped`.

    Derivatives at both nodes are of the same equations.

    What holds the rank changes its bases on the way, and equations in other bases have determinants
    of other signs. The first node may lack its matrices.
    """
    if a.nullity == 1 and (is_rank_held(equations) or not a.matrix.size):
        here = make_node(equations, a.x, a.t)
        a = replace(a, matrix=here.matrix, image=here.image)
    return is_determinant_flipped(a, b)


def find_root(
    equations: Closure,
    a: Node,
    b: Node,
    function: Callable[[Node], float],
    low: float = 0.0,
    high: float | None = None,
) -> Node | None:
    """Find the node between two neighbours where a function of the node is zero.

    The function has different signs at both ends.
    """
    end = float(a.t @ equations.compute_difference(a.x, b.x)) if high is None else high
    found: dict[float, Node] = {}
    large = equations.rows > LARGE
    regular = min(a.sigma, b.sigma) > NEARLY

    def find_between(distance: float) -> Node | None:
        """Find the node at a distance from `a`, by the kernel where the curve is regular."""
        here = None
        if regular:
            guess = guess_point_between(equations, a, b, distance)
            here = equations.find_regular_node(guess, a.t)
        return here or find_node_between(equations, a, b, distance, False)

    def evaluate_distance(distance: float) -> float:
        """Evaluate the function at a distance from `a`."""
        here = find_between(distance)
        if here is None:
            return 0.0  # rounding only: a point between two neighbours always exists
        found[distance] = here
        value = function(here)
        return 0.0 if large and abs(value) < NOISE else value

    distance = find_sign_change(evaluate_distance, low, end)
    if distance is None:
        here = min(found.values(), key=lambda n: abs(function(n)), default=None)
    else:
        here = found.get(distance) or find_node_between(equations, a, b, distance)
    return here if here is None or here.matrix.size else make_node(equations, here.x, here.t)


def find_return(equations: Closure, a: Node, b: Node, start: Node, periods: Array) -> Node | None:
    """Return the start, whole turns away, if the curve returns to it between two neighbours.

    It must arrive in the direction in which it left.

    `periods` (nv,) are 0 for coordinates that do not come back by turning on.
    """
    layout = equations.system.structure.layout
    away = equations.compute_difference(b.x, start.x)
    shift = periods * np.round(_divide_by_periods(away * equations.unit, periods))
    there = start
    if shift.any():
        x = start.x.copy()
        x[layout.vector_q] -= shift[layout.vector_v]
        there = replace(start, x=x)
    near = HOME if start.lines is None else HOME_CROSSING
    if not curves.has_returned(equations, a, b, there, near):
        return None
    if isinstance(start, SingularNode):
        moved = [layout.integrate_velocity(n.x, shift) for n in (a, b)]
        if not start.may_contain_points(equations, moved):
            return None
    return there


def _divide_by_periods(x: Array, periods: Array) -> Array:
    """Divide by periods (nv,); the ratio is 0 where there is no period."""
    return np.divide(x, periods, out=np.zeros_like(x), where=periods > 0.0)


def list_turns(nodes: list[Node], closed: bool, indices: list[int]) -> list[tuple[int, int, int]]:
    """List where velocities of coordinates change sign: (node before, node after, coordinate)."""
    out: list[tuple[int, int, int]] = []
    rates = np.array([n.t for n in nodes])
    count = len(nodes)
    for i in indices:
        if np.abs(rates[:, i]).max() < 1e-7:
            continue  # it rests
        moving = np.flatnonzero(np.abs(rates[:, i]) > RESTING).tolist()
        pairs = list(zip(moving, moving[1:], strict=False))
        if closed and moving[0] > 0 and moving[-1] == count - 1 - moving[0]:
            pairs.append((moving[-1], moving[0]))
        out += [(k, m, i) for k, m in pairs if rates[k, i] * rates[m, i] <= 0.0]
    return sorted(out)


def find_extreme(equations: Closure, nodes: list[Node], k: int, m: int, i: int) -> Node | None:
    """Find the node at which coordinate i turns back between the nodes k and m.

    k, m, i are one of `list_turns`. It is None where the coordinate rests.
    """
    if (
        m == k + 1
        and np.linalg.norm(equations.compute_difference(nodes[k].x, nodes[m].x)) < SAME_NODE
    ):
        return nodes[m]  # a cusp
    if m == k + 1:
        return find_root(equations, nodes[k], nodes[m], lambda n: float(n.t[i]))
    if m == k + 2 or m < k:
        return nodes[(k + 1) % len(nodes)]  # it rests exactly at a node
    return None  # it rests for a while


def insert_hidden_crossings(equations: Closure, nodes: list[Node]) -> list[Node]:
    """Insert singular points between nodes that no determinant shows.

    There two singular values vanish at once.
    """
    out = [nodes[0]]
    for k in range(1, len(nodes) - 1):
        a, m, b = nodes[k - 1 : k + 2]
        if not (m.sigma <= a.sigma and m.sigma <= b.sigma) or any(
            n.lines is not None for n in (a, m, b)
        ):
            out.append(m)
            continue
        before = equations.compute_difference(a.x, m.x)
        after = equations.compute_difference(m.x, b.x)
        h = max(float(np.linalg.norm(before)), float(np.linalg.norm(after)))
        found = None
        if m.sigma < 2.0 * max(a.sigma - m.sigma, b.sigma - m.sigma):
            x = next(
                (
                    x
                    for n in (2, 3, 4)
                    if n <= equations.n
                    and (x := locate_singular_point(equations, m.x, n, 2.0 * h)) is not None
                ),
                None,
            )
            found = None if x is None else make_singular_node(equations, x, m.t, a.x)
        if found is None:
            out.append(m)
            continue
        y = equations.compute_difference(m.x, found.x)
        size = float(np.linalg.norm(y))
        along = float(y @ m.t)
        if size < 1e-6:
            out.append(found)
        elif abs(along) < AHEAD * size or size > 1.5 * h or compute_bend_angle(m, found) > BEND:
            out.append(m)
        else:
            out += [m, found] if along > 0.0 else [found, m]
    return out + nodes[-1:] if len(nodes) > 1 else out


# ---- ends by one-sided constraints

# Limits of coordinates, and declared one-sided constraints, end a walk along a curve.

TOUCH = 1e-12
"""Radians or metres beyond a bound that are rounding."""
OUTSIDE = 1e-9
"""How far, as a part of 1 and the bound, a start may be beyond a bound."""


@dataclass(frozen=True, eq=False)
class OneSidedEnd(InWords):
    """A bound of a one-sided constraint or coordinate.

    `sign` is +1 for an upper bound and -1 for a lower one.
    """

    name: str
    limit: float
    sign: float
    of: int | None
    """The velocity coordinate that it limits, None for a declared row."""

    def compute_excess(self, x: Array) -> float:
        """Compute how far the bounded quantity is beyond its bound at x; negative inside."""
        return self.sign * (self.compute_value(x) - self.limit)

    def compute_value(self, x: Array) -> float:
        """Compute the bounded quantity at x."""
        raise NotImplementedError

    def compute_rate(self, n: Node) -> float:
        """Compute the rate of the bounded quantity along the curve, positive outwards."""
        raise NotImplementedError

    def describe_violation(self, over: float) -> str:
        """Return a sentence, without its end, that the bound is violated by `over`."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class CoordinateBound(OneSidedEnd):
    """A limit of a coordinate at `place` in q."""

    place: int

    def compute_value(self, x: Array) -> float:
        """Return the value of the coordinate."""
        return float(x[self.place])

    def compute_rate(self, n: Node) -> float:
        """Return the rate of the coordinate along the curve, positive outwards."""
        return self.sign * float(n.t[self.of])

    def describe_violation(self, over: float) -> str:
        """Return a sentence, without its end, that the coordinate is outside its limits."""
        return f"{self.name!r} is outside its limits"

    def __str__(self) -> str:
        return (
            f"the {'upper' if self.sign > 0 else 'lower'} limit {self.limit:.9g} of {self.name!r}"
        )


@dataclass(frozen=True, eq=False)
class RowBound(OneSidedEnd):
    """A bound of a declared row, the one at `index` of `rows`."""

    rows: OneSided
    index: int

    def compute_value(self, x: Array) -> float:
        """Compute the value of the row; for a driven curve x continues after the coordinates."""
        return float(self.rows.compute_values(x[: self.rows.system.nq], declared=True)[self.index])

    def compute_rate(self, n: Node) -> float:
        """Compute the rate of the row along the curve, positive outwards, in scaled units."""
        system = self.rows.system
        J = self.rows.compute_rates(n.x[: system.nq], declared=True)[1]
        return self.sign * float(J[self.index] @ n.t[: system.nv])

    def describe_violation(self, over: float) -> str:
        """Return a sentence, without its end, that the row is violated, and by how much."""
        return f"{self} is violated by {over:.6g} {self.rows.units[self.index]}".removesuffix(" 1")

    def __str__(self) -> str:
        return (
            f"the one-sided constraint {self.rows.format_bound_name(self.index, self.sign > 0)!r}"
        )


class OneSidedEnds:
    """One-sided constraints of a system that may end a walk along a curve.

    These are declared rows, and with `limits` those of its coordinates.
    """

    def __init__(self, equations: Closure, limits: bool = True):
        system = equations.system
        rows = pack_one_sided_rows(equations.system)
        self.limits = limits
        """Whether limits of coordinates count."""
        self.all: list[OneSidedEnd] = []
        place = equations.place
        for i in range(system.nv) if limits else ():
            if place[i] >= 0 and i not in equations.held:
                for bound, sign in zip(
                    system.structure.limits[i].tolist(), (-1.0, 1.0), strict=True
                ):
                    if np.isfinite(bound):
                        self.all.append(
                            CoordinateBound(
                                system.structure.velocity_names[i], bound, sign, i, int(place[i])
                            )
                        )
        for k in range(rows.declared):
            for bound, sign in ((rows.low[k], -1.0), (rows.high[k], 1.0)):
                if np.isfinite(bound):
                    self.all.append(RowBound(rows.names[k], float(bound), sign, None, rows, k))

    def describe_violation(self, x: Array) -> str:
        """Return a sentence, without its end, on a bound that is violated at `x`; "" if none is."""
        for bound in self.all:
            if (over := bound.compute_excess(x)) > OUTSIDE * (1.0 + abs(bound.limit)):
                return bound.describe_violation(over)
        return ""

    def may_reach_bound(self, n: Node, moving: list[int]) -> bool:
        """Tell whether a `moving` coordinate, or a declared row, goes towards a bound at a node."""
        return any(
            bound.compute_rate(n) > 0.0
            for bound in self.all
            if bound.of is None or bound.of in moving
        )

    def find_first_bound(self, equations: Closure, a: Node, b: Node) -> tuple[Node, str] | None:
        """Find the first node between two neighbours at which a bound is reached, and its name.

        It is None if there is none.
        """
        best: tuple[float, Node, str] | None = None
        for bound in self.all:
            reached = _find_bound_node(equations, a, b, bound)
            if reached is not None:
                distance = float(a.t @ equations.compute_difference(a.x, reached.x))
                if best is None or distance < best[0]:
                    best = (distance, reached, str(bound))
        return None if best is None else best[1:]


def _find_bound_node(equations: Closure, a: Node, b: Node, bound: OneSidedEnd) -> Node | None:
    """Find the node between two neighbours at which the bound is reached, or None."""

    def compute_excess(n: Node) -> float:
        """Compute how far a node is beyond the bound."""
        return bound.compute_excess(n.x)

    before = compute_excess(a)
    after = compute_excess(b)
    if before > -TOUCH:
        if (rate := bound.compute_rate(a)) > RESTING:
            return a
        if after <= TOUCH:
            return None
        if rate >= -RESTING:
            return a  # at rest on the bound, and then beyond it
    last = b
    low = 0.0
    if (
        before <= -TOUCH
        and after <= TOUCH
        and (bound.compute_rate(a) <= RESTING or bound.compute_rate(b) >= -RESTING)
    ):
        # inside at both ends, and no largest value in between; rates of what rests are rounding
        return None
    if after <= TOUCH or before > -TOUCH:
        turn = find_root(equations, a, b, bound.compute_rate)
        if turn is None or (after <= TOUCH and compute_excess(turn) <= TOUCH):
            return None
        if after <= TOUCH:
            last = turn
        else:
            low = float(a.t @ equations.compute_difference(a.x, turn.x))
    high = float(a.t @ equations.compute_difference(a.x, last.x))
    return find_root(equations, a, b, compute_excess, low, high)
