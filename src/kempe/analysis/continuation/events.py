"""What happens along a curve: steps through crossings, limits, the way back to the start, extremes,
singular points.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from kempe.analysis.continuation.continuation import Closure
from kempe.analysis.continuation.crossings import (
    AHEAD,
    SingularNode,
    branches_at,
    crossing,
    locate,
    passage,
    singular_node,
)
from kempe.analysis.continuation.deflation import rank_held
from kempe.kinematics.common.gauss_newton import LARGE
from kempe.kinematics.common.roots import sign_change
from kempe.solvers.common import tracing
from kempe.solvers.common.tracing import BEND, Node, bend, flipped, inside, node, step
from kempe.spatial import Array

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
HOME = 1e-7
"""Distance from the start at which a curve has returned to it, if it also arrives in the same
direction."""
HOME_CROSSING = 1e-4
"""The same where the start is a crossing: points beside it are known less well."""
ARRIVED = 0.999
"""Cosine between the directions of departure and arrival."""


@dataclass(frozen=True)
class WalkEnd:
    """Why a walk ends: a sentence."""

    reason: str


def walk(equations: Closure, a: Node, longest: float, periods: Array) -> Iterator[Node | WalkEnd]:
    """Nodes of the curve after `a`, crossings among them, then perhaps a `WalkEnd`; straight on
    through crossings.

    At a cusp the curve arrives at one node and leaves from another one, at the same point.
    `periods` (nv,) are 0 for coordinates that do not come back by turning on.
    """

    def taken(a: Node, h: float) -> list[Node] | None:
        b = step(equations, a, h)
        if b is not None and b.sigma < AWKWARD:
            b = step(equations, a, 1.3 * h) or b
        return checked(equations, a, b)

    h = 0.25 * longest
    known = [a.germ] if isinstance(a, SingularNode) else []
    while True:
        if isinstance(a, SingularNode):
            there = a.germ.first(equations, a.half)
            h = min(longest, 0.5 * float(np.linalg.norm(equations.between(a.x, there.x))))
            a = there
            yield a
        last = deque([a.x], maxlen=RECENT)
        singular = None
        sigma = a.sigma
        for b in tracing.walk(a, taken, longest, h):
            before = last[-1]
            last.append(b.x)
            if (
                b.sigma < min(HIDDEN, sigma) and b.lines is None
            ):  # nearer to a point where rounding hides the curve
                singular = passage(equations, last, known, periods)
                way = equations.between(before, b.x if singular is None else singular.x)
                along = float(way @ equations.between(before, b.x))
                if singular is not None and along > 0.0:  # else the walk leaves it
                    if along < way @ way:
                        yield b  # not beyond it
                    break
                singular = None
            yield b
            sigma = b.sigma
        else:
            singular = passage(equations, last, known, periods) if len(last) > 1 else None
        if singular is None:
            yield WalkEnd("a point where the curve is not smooth")
            return
        known.append(singular.germ)
        yield from singular.arrival()
        yield singular
        a = singular


def checked(equations: Closure, a: Node, b: Node | None) -> list[Node] | None:
    """A step from `a` to `b` with the crossing in between, if any; None where it may have changed
    the branch.
    """
    if b is None:
        return None
    turned = sides_change(equations, a, b)
    if not turned:
        return None if turned is None or _touches(equations, a, b) else [b]
    middle = crossing(equations, a, b)
    if isinstance(
        middle, SingularNode
    ):  # the step may have led to another one of the branches that touch there
        return [middle, middle.germ.first(equations, middle.half)]
    return None if middle is None else [middle, b]


def _touches(equations: Closure, a: Node, b: Node) -> bool:
    """Whether a step may have led past a singular point at which branches touch, to another branch
    or round a cusp.
    """
    if max(a.sigma, b.sigma) > NEARLY or a.lines is not None:
        return False
    y = equations.between(a.x, b.x)
    h = float(np.linalg.norm(y))
    x = locate(equations, equations.move(a.x, 0.5 * y), 2, h) if equations.n > 1 else None
    germ = None if x is None else branches_at(equations, x)[1]
    if germ is None:
        return False
    along = float(equations.between(a.x, germ.x) @ y) / h
    first, second = (germ.half_of(equations, [n.x]) for n in (a, b))
    return 0.0 < along < h and first is not None and second not in (None, germ.partner[first])


def sides_change(equations: Closure, a: Node, b: Node) -> bool | None:
    """`flipped`, with derivatives of the same equations at both nodes.

    What holds the rank changes its bases on the way, and equations in other bases have determinants
    of other signs.
    """
    if rank_held(equations) and a.nullity == 1:
        here = node(equations, a.x, a.t)
        a = replace(a, matrix=here.matrix, image=here.image)
    return flipped(a, b)


def root(
    equations: Closure,
    a: Node,
    b: Node,
    function: Callable[[Node], float],
    low: float = 0.0,
    high: float | None = None,
) -> Node | None:
    """The node between two neighbours where `function` of it, of different signs at both ends, is
    zero.
    """
    end = float(a.t @ equations.between(a.x, b.x)) if high is None else high
    found: dict[float, Node] = {}
    large = equations.rows > LARGE

    def at(distance: float) -> float:
        here = inside(equations, a, b, distance, False)
        if here is None:
            return 0.0  # rounding only: a point between two neighbours always exists
        found[distance] = here
        value = function(here)
        return 0.0 if large and abs(value) < NOISE else value

    distance = sign_change(at, low, end)
    if distance is None:
        here = min(found.values(), key=lambda n: abs(function(n)), default=None)
    else:
        here = found.get(distance) or inside(equations, a, b, distance)
    return here if here is None or here.matrix.size else node(equations, here.x, here.t)


def home(equations: Closure, a: Node, b: Node, start: Node, periods: Array) -> Node | None:
    """The start again, whole turns away, if the curve returns to it between two neighbours in the
    same direction.

    `periods` (nv,) are 0 for coordinates that do not come back by turning on.
    """
    shift = periods * np.round(_ratio(equations.between(b.x, start.x) * equations.unit, periods))
    there = equations.system.structure.layout.integrate(start.x, -shift)
    if isinstance(start, SingularNode):
        moved = [equations.system.structure.layout.integrate(n.x, shift) for n in (a, b)]
        if not start.may_be(equations, moved):
            return None
    if np.linalg.norm(equations.between(b.x, there)) < (
        HOME if start.lines is None else HOME_CROSSING
    ):
        return replace(start, x=there) if start.t @ b.t > ARRIVED else None
    z = equations.between(a.x, there)
    chord = equations.between(a.x, b.x)
    along = float(a.t @ z)
    if not 1e-9 < along <= float(a.t @ chord) or np.linalg.norm(z) > 2.0 * np.linalg.norm(chord):
        return None
    here = inside(equations, a, b, along)
    if here is None or start.t @ here.t < ARRIVED:
        return None
    gap = float(np.linalg.norm(equations.between(here.x, there)))
    return (
        replace(start, x=there) if gap < (HOME if start.lines is None else HOME_CROSSING) else None
    )


def _ratio(x: Array, periods: Array) -> Array:
    return np.divide(x, periods, out=np.zeros_like(x), where=periods > 0.0)


def turns(nodes: list[Node], closed: bool, indices: list[int]) -> list[tuple[int, int, int]]:
    """Where velocities of coordinates change their sign: (node before, node after, coordinate),
    along the curve.
    """
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


def extreme(equations: Closure, nodes: list[Node], k: int, m: int, i: int) -> Node | None:
    """The node at which coordinate i turns back between the nodes k and m, one of `turns`, or None
    where it rests.
    """
    if m == k + 1 and np.linalg.norm(equations.between(nodes[k].x, nodes[m].x)) < SAME_NODE:
        return nodes[m]  # a cusp
    if m == k + 1:
        return root(equations, nodes[k], nodes[m], lambda n: float(n.t[i]))
    if m == k + 2 or m < k:
        return nodes[(k + 1) % len(nodes)]  # it rests exactly at a node
    return None  # it rests for a while


def hidden_crossings(equations: Closure, nodes: list[Node]) -> list[Node]:
    """The nodes, and between them those singular points that no determinant shows: where two things
    vanish at once.
    """
    out = [nodes[0]]
    for k in range(1, len(nodes) - 1):
        a, m, b = nodes[k - 1 : k + 2]
        if not (m.sigma <= a.sigma and m.sigma <= b.sigma) or any(
            n.lines is not None for n in (a, m, b)
        ):
            out.append(m)
            continue
        before = equations.between(a.x, m.x)
        after = equations.between(m.x, b.x)
        h = max(float(np.linalg.norm(before)), float(np.linalg.norm(after)))
        found = None
        if m.sigma < 2.0 * max(a.sigma - m.sigma, b.sigma - m.sigma):
            x = next(
                (
                    x
                    for n in (2, 3, 4)
                    if n <= equations.n and (x := locate(equations, m.x, n, 2.0 * h)) is not None
                ),
                None,
            )
            found = None if x is None else singular_node(equations, x, m.t, a.x)
        if found is None:
            out.append(m)
            continue
        y = equations.between(m.x, found.x)
        size = float(np.linalg.norm(y))
        along = float(y @ m.t)
        if size < 1e-6:
            out.append(found)
        elif abs(along) < AHEAD * size or size > 1.5 * h or bend(m, found) > BEND:
            out.append(m)
        else:
            out += [m, found] if along > 0.0 else [found, m]
    return out + nodes[-1:] if len(nodes) > 1 else out
