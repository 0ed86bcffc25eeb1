"""Branches of a curve over one coordinate: each exists where certain functions are positive.

The functions are given for planar mechanisms of dyads and for spatial loops of four joints.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.assemble.dyad_decomposition import NOWHERE, Decomposition, operations, parts_of
from kempe.assemble.dyads import CLOSED, Plan, closed_form
from kempe.assemble.modes import assembly_modes
from kempe.equations.judge import motion
from kempe.equations.one_sided import one_sided_rows
from kempe.first_order.constraint_graph import structure
from kempe.joints import P, Q, R
from kempe.kernels.dyads import dyads_layout as K
from kempe.model.configurations import circles, mid, q_dict
from kempe.model.model import kept
from kempe.numerics.enclosures import UNIT, Enclosure, constant, cos_sin
from kempe.spaces.only_loop import loop_of, pin, primitives_of
from kempe.spatial import Array, inverse

if TYPE_CHECKING:
    from kempe.description.parts import Joint
    from kempe.model.model import Model

LIMIT = -1
SOUND = -2
"""Kinds of functions beside the numbers of the signs that flip where they are zero: a limit, and
what is never zero."""
Function = tuple[Enclosure, int]
"""A function that is positive where a branch exists, and its kind."""


@dataclass(frozen=True, eq=False)
class BranchFunctions:
    """The branches of a mechanism over one coordinate `name` from `low` to `high`, which meet if it
    `closes`.

    `signs` is the number of their signs, `functions(x, signs)` are those that are positive where
    branches exist, for the coordinate as an enclosure of n intervals, and signs (n, signs).
    """

    system: Model
    name: str
    low: float
    high: float
    closes: bool
    signs: int
    functions: Callable[[Enclosure, Array], list[Function]] = field(repr=False)
    at: Callable[[Array, Array], Array] = field(repr=False)
    """Configurations (n, nq) for values (n,) of the coordinate and signs (n, signs)."""
    signs_of: Callable[[Array], Array] = field(repr=False)
    """Signs (n, signs) of configurations (n, nq); 0 where two branches meet, nearly."""

    @property
    def place(self) -> int:
        """The place of the coordinate in q."""
        return self.system.coordinate_names.index(self.name)


def within_turn(angle: tuple[Enclosure, Enclosure], low: float, high: float) -> list[Function]:
    """What is positive where an angle is between two limits less than a turn apart."""
    if not (math.isfinite(low) or math.isfinite(high)):
        return []
    mid = 0.5 * (low + high)
    half = 0.5 * (high - low)
    edge = constant(np.array([math.cos(half)]), len(angle[0].mid) - 1, UNIT)
    return [(angle[0] * math.cos(mid) + angle[1] * math.sin(mid) - edge, LIMIT)]


def within(value: Enclosure, low: float, high: float) -> list[Function]:
    """What is positive where a length is between two limits."""
    return [
        (x, LIMIT)
        for x, bound in ((value - low, low), (high - value, high))
        if math.isfinite(bound)
    ]


# ---- planar mechanisms of dyads

# The dyads of a closed form (`kempe.assemble.dyads`) are walked with enclosures in place of
# numbers. Each of them has two roots, which exist where its circles, or its line and circle, meet:
# where functions of the coordinate are positive. Where one of them is zero the two roots are one.
# Limits of the other coordinates are such functions, too.

MOST_SIGNS = 8
"""Branch signs up to which all branches are followed."""
MEETING = 1e-7
"""Height of a dyad, as a part of the mechanism's size, up to which its sign is not sure."""
Vector = tuple[Enclosure, Enclosure]


@kept
def dyad_branches(system: Model) -> tuple[BranchFunctions, ...] | str:
    """The branches over each coordinate from which all others follow by dyads, or why there are
    none.
    """
    parts = parts_of(system)
    if parts.trouble:
        return parts.trouble
    if one_sided_rows(system).declared or parts.misfit > 0.0:
        return "it has one-sided constraints, or fixed joints that close a loop"
    aside = _aside(system)
    slots = [link.slot for link in parts.links if link.slot != NOWHERE]
    if Decomposition(system, parts, []).freedom() - len(slots) + len({*slots}) != 1 + len(aside):
        return "by counting, its loops have not one freedom"
    turns = circles(system)
    layout = system.structure.layout
    out: list[tuple[bool, BranchFunctions]] = []
    places = zip(map(int, layout.vector_q), map(int, layout.vector_v), strict=True)
    for iq, iv in places:
        name: str = system.coordinate_names[iq]
        low, high = map(float, system.structure.limits[iv])
        plan = closed_form(system, (name, *aside)) if name not in aside else None
        if (
            isinstance(plan, Plan)
            and plan.signs <= MOST_SIGNS
            and (turns[iv] or math.isfinite(high - low))
        ):
            walk = Walk(system, plan)
            if walk.sound:
                ends = (0.1 - math.pi, 0.1 + math.pi + 1e-15) if turns[iv] else (low, high)
                found = BranchFunctions(
                    system,
                    name,
                    *ends,
                    bool(turns[iv]),
                    plan.signs,
                    walk,
                    _solved(plan),
                    _signs(plan),
                )
                out.append((bool(turns[iv]), found))
    out.sort(key=lambda x: (not x[0], x[1].signs))
    return tuple(x for _, x in out) or "no coordinate that is bounded gives all others by dyads"


def _aside(system: Model) -> list[str]:
    """Coordinates of joints that are in no loop: they are what they are, whatever loops do."""
    moved = {v for c in structure(system).clusters for v in c.velocities}
    layout = system.structure.layout
    pairs = zip(layout.vector_q.tolist(), layout.vector_v.tolist(), strict=True)
    return [system.coordinate_names[iq] for iq, iv in pairs if iv not in moved]


def _solved(plan: Plan) -> Callable[[Array, Array], Array]:
    rest = q_dict(plan.system, mid(plan.system))

    def at(x: Array, signs: Array) -> Array:
        others = [np.full_like(x, rest[name]) for name in plan.known[1:]]
        return plan.solve(np.stack([x, *others], axis=1), signs)[0]

    return at


def _signs(plan: Plan) -> Callable[[Array], Array]:
    least = MEETING / CLOSED * plan.tolerance

    def signs_of(q: Array) -> Array:
        h = plan.heights(q)
        return np.where(np.abs(h) > least, np.sign(h), 0.0)

    return signs_of


class Walk:
    """Walks the program of a plan with enclosures; `sound` says whether it holds what is understood
    here, only.
    """

    def __init__(self, system: Model, plan: Plan):
        ints: list[int] = plan.program[0].tolist()
        given, self.ops = operations(plan.program)
        self.registers = ints[K.N_REGISTERS]
        self.first = ints[K.COORDINATES]
        self.signs = ints[K.SIGNS]
        self.known, *aside = (self.first + slot for slot in given)
        middle = mid(system)
        self.aside = {place: float(middle[place - self.first]) for place in aside}
        layout = system.structure.layout
        bounds = system.structure.limits[layout.vector_v].tolist()
        self.limits = dict(zip(layout.vector_q.tolist(), bounds, strict=True))
        self.turns = dict(
            zip(layout.vector_q.tolist(), circles(system)[layout.vector_v].tolist(), strict=True)
        )
        self.sound = all(self._understood(i, f) for i, f in self.ops)

    def _understood(self, i: list[int], f: list[float]) -> bool:
        code = i[0]
        if code in (K.READ_TURN, K.READ_SLIDE):
            slot = i[3] - self.first
            if i[5] or slot < 0:
                return not i[5]
            if code == K.READ_SLIDE:
                return True
            return abs(f[2]) == 1.0 and (
                self.turns[slot] or f[6] - f[5] < 2.0 * math.pi * (1.0 - 1e-9)
            )
        if code in (K.TURN, K.SLIDE):
            given = i[3] == self.known or i[3] in self.aside
            return given or (code == K.TURN and abs(f[0]) == 1.0)
        return code in (K.DIVIDE, K.CARRY, K.REBASE, K.CIRCLES, K.LINE_CIRCLE, K.LINES)

    def __call__(self, x: Enclosure, signs: Array) -> list[Function]:
        """The functions of all branches with these signs (n, signs) on the intervals x."""
        order = len(x.mid) - 1
        none, unit = (constant(np.array([value]), order) for value in (0.0, 1.0))
        poses: dict[int, Any] = {
            K.REGISTERS + 4 * k: (unit, none, none, none) for k in range(self.registers)
        }
        angles: dict[int, Vector] = {}
        given = {self.known: x} | {
            k: constant(np.array([value]), order) for k, value in self.aside.items()
        }
        out: list[Function] = []
        for i, f in self.ops:
            code = i[0]
            if code == K.TURN:
                c, s = (
                    _scaled(angles[i[3]], f[0]) if i[3] in angles else cos_sin(given[i[3]] * f[0])
                )
                a = times(times(poses[i[2]], f[1:5]), (c, s, 0.0, 0.0))
                poses[i[1]] = times(a, f[5:9])
            elif code == K.SLIDE:
                poses[i[1]] = times(
                    times(times(poses[i[2]], f[1:5]), (1.0, 0.0, given[i[3]] * f[0], 0.0)), f[5:9]
                )
            elif code == K.DIVIDE:
                poses[i[1]] = times(poses[i[1]], inverted(poses[i[2]]))
            elif code == K.CARRY:
                poses[i[1]] = times(poses[i[2]], poses[i[1]])
            elif code == K.REBASE:
                back = inverted(poses[i[1]])
                poses[i[3]], poses[i[4]] = back, times(back, poses[i[2]])
            elif code == K.READ_TURN:
                if i[3] >= self.first:
                    angles[i[3]] = _read_turn(poses, i, f)
                    out += within_turn(angles[i[3]], f[5], f[6])
            elif code == K.READ_SLIDE:
                if i[3] >= self.first:
                    out += within(_read_slide(poses, i, f), *self.limits[i[3] - self.first])
            else:
                group = {K.CIRCLES: _circles, K.LINE_CIRCLE: _line_circle, K.LINES: _lines}[code]
                number = i[7] - self.signs
                out += group(poses, i, f, number, 1.0 if code == K.LINES else signs[:, number])
        return out


# ---- dyads: poses and groups, as the kernel has them


def times(a: Any, b: Any) -> Any:
    """The pose a b."""
    c, s, x, y = a
    return (
        c * b[0] - s * b[1],
        s * b[0] + c * b[1],
        x + (c * b[2] - s * b[3]),
        y + (s * b[2] + c * b[3]),
    )


def inverted(a: Any) -> Any:
    """The inverse of a pose."""
    c, s, x, y = a
    return c, -s, -(c * x + s * y), s * x - c * y


def _pin(pose: Any, f: list[float]) -> Vector:
    c, s, x, y = pose
    return x + (c * f[0] - s * f[1]), y + (s * f[0] + c * f[1])


def _rail(pose: Any, f: list[float]) -> tuple[Enclosure, Enclosure, Enclosure, Enclosure]:
    c, s, *_ = pose
    return *_pin(pose, f), c * f[2] - s * f[3], s * f[2] + c * f[3]


def _to(a: Vector, b: Vector) -> Vector:
    return b[0] - a[0], b[1] - a[1]


def _square(v: Vector) -> Enclosure:
    return v[0] * v[0] + v[1] * v[1]


def _turned(v: Vector, w: Vector) -> Vector:
    """Cosine and sine, times both lengths, of the angle from w to v."""
    return v[0] * w[0] + v[1] * w[1], v[1] * w[0] - v[0] * w[1]


def _brought(a: Vector, turn: Vector, b: Vector) -> Any:
    """The pose with this turn that brings the body's point b to a."""
    c, s = turn
    return c, s, a[0] - (c * b[0] - s * b[1]), a[1] - (s * b[0] + c * b[1])


def _circles(poses: Any, i: list[int], f: list[float], number: int, sign: Any) -> list[Function]:
    a, c, a1, b1, b2, end = (_pin(poses[i[k + 1]], f[2 * k :]) for k in range(6))
    way = _to(a, c)
    w1 = _to(a1, b1)
    w2 = _to(end, b2)
    d = _square(way)
    r1 = _square(w1)
    r2 = _square(w2)
    total = r1.root() + r2.root()
    less = r1.root() - r2.root()
    far = total * total - d
    near = d - less * less
    along = (d + (r1 - r2)) / (d * 2.0)
    high = far.root() * near.root() / (d * 2.0) * sign
    to = way[0] * along - way[1] * high, way[1] * along + way[0] * high
    c1, s1 = (x / r1 for x in _turned(to, w1))
    c2, s2 = (x / r2 for x in _turned(_to(way, to), w2))
    poses[i[8]] = _brought(a, (c1, s1), a1)
    poses[i[9]] = _brought(c, (c2, s2), end)
    return [(r1, SOUND), (r2, SOUND), (d, SOUND), (far, number), (near, number)]


def _line_circle(
    poses: Any, i: list[int], f: list[float], number: int, sign: Any
) -> list[Function]:
    px, py, dx, dy = _rail(poses[i[1]], f)
    qx, qy, ex, ey = _rail(poses[i[2]], f[4:])
    b1, b2, a2, a = (_pin(poses[i[k + 3]], f[8 + 2 * k :]) for k in range(4))
    turn = _turned((dx, dy), (ex, ey))
    w = b1[0] - qx, b1[1] - qy
    g = px + (turn[0] * w[0] - turn[1] * w[1]) - a[0], py + (turn[1] * w[0] + turn[0] * w[1]) - a[1]
    along = g[0] * dx + g[1] * dy
    h = dx * g[1] - dy * g[0]
    arm = _to(a2, b2)
    square = _square(arm)
    r = square.root()
    t = (r - h).root() * (r + h).root() * sign
    slid = t - along
    c2, s2 = (x / square for x in _turned((t * dx - h * dy, t * dy + h * dx), arm))
    poses[i[8]] = _brought((px + slid * dx, py + slid * dy), turn, (qx, qy))
    poses[i[9]] = _brought(a, (c2, s2), a2)
    return [(square, SOUND), (r - h, number), (r + h, number)]


def _lines(poses: Any, i: list[int], f: list[float], number: int, sign: Any) -> list[Function]:
    p1x, p1y, d1x, d1y = _rail(poses[i[1]], f)
    q1x, q1y, e1x, e1y = _rail(poses[i[2]], f[4:])
    p2x, p2y, d2x, d2y = _rail(poses[i[3]], f[8:])
    q2x, q2y, e2x, e2y = _rail(poses[i[4]], f[12:])
    b1 = _pin(poses[i[5]], f[16:])
    b2 = _pin(poses[i[6]], f[18:])
    one = _turned((d1x, d1y), (e1x, e1y))
    two = _turned((d2x, d2y), (e2x, e2y))
    u = (b1[0] - q1x, b1[1] - q1y)
    w = (b2[0] - q2x, b2[1] - q2y)
    gx = p2x + (two[0] * w[0] - two[1] * w[1]) - p1x - (one[0] * u[0] - one[1] * u[1])
    gy = p2y + (two[1] * w[0] + two[0] * w[1]) - p1y - (one[1] * u[0] + one[0] * u[1])
    det = d1x * d2y - d1y * d2x
    t1 = (gx * d2y - gy * d2x) / det
    t2 = (gx * d1y - gy * d1x) / det
    poses[i[7]] = _brought((p1x + t1 * d1x, p1y + t1 * d1y), one, (q1x, q1y))
    poses[i[8]] = _brought((p2x + t2 * d2x, p2y + t2 * d2y), two, (q2x, q2y))
    return [(det * det, SOUND)]


# ---- dyads: coordinates and their limits


def _read_turn(poses: Any, i: list[int], f: list[float]) -> Vector:
    """Cosine and sine of a coordinate that turns."""
    a = poses[i[1]]
    b = poses[i[2]]
    c = a[0] * b[0] + a[1] * b[1]
    s = a[0] * b[1] - a[1] * b[0]
    c, s = _scaled((c * f[0] - s * f[1], s * f[0] + c * f[1]), f[2])
    co = math.cos(f[3])
    so = math.sin(f[3])
    return c * co - s * so, s * co + c * so


def _scaled(angle: Vector, factor: float) -> Vector:
    """Cosine and sine of an angle times 1 or -1."""
    return angle[0], angle[1] * factor


def _read_slide(poses: Any, i: list[int], f: list[float]) -> Enclosure:
    px, py, dx, dy = _rail(poses[i[1]], f)
    qx, qy, *_ = _rail(poses[i[2]], f[4:])
    return ((qx - px) * dx + (qy - py) * dy) * f[8] + f[9]


# ---- spatial loops of four joints

# The ends p and r of two cranks, or of a crank and a slide, on one body are a rod's length L apart:
# |p(a) - r(b)| = L. For a crank that is A cos b + B sin b + C = 0 with A, B and C of the first
# degree in cos a and sin a: b is real where D = A^2 + B^2 - C^2 >= 0 (Freudenstein, Kiss, "Type
# determination of skew four-bar mechanisms", J. Eng. Ind. 91, 1969). For a slide it is a quadratic
# equation. Four turns about axes through one point are such a loop, too: p and r are the directions
# of the axes of the coupler, on the unit sphere; and so are four turns about parallel axes, seen
# along them.

SAME = 1e-12
"""Part of the size up to which points are one and directions parallel."""
NEAR = 1e-7
"""Sign of a branch, of size 1 at most, up to which it is not sure."""


class Rod(NamedTuple):
    """A rod of a `length` between p = sum (1, cos a, sin a) p[k] and r, the same of b, or r[0] + b
    r[1] on a slide.
    """

    p: Array
    r: Array
    length: float
    slides: bool


@kept
def skew_branches(system: Model) -> tuple[BranchFunctions, ...] | str:
    """The branches over each crank whose neighbour is the other one, or a slide, or why there are
    none.
    """
    found = loop_of(system)
    if isinstance(found, str) or system.dim != 3:
        return found if isinstance(found, str) else "it is planar"
    bodies, names = found
    if one_sided_rows(system).declared or len(bodies) != 4:
        return "it has one-sided constraints, or other than four joints in its loop"
    out: list[BranchFunctions] = []
    for k in range(4):
        for order in ((0, 1, 2, 3), (0, -1, -2, -3)):
            at = [(k + i) % 4 for i in order]
            # joint k lies between bodies k and k + 1: going back, the bodies shift by one
            ring = [bodies[i if order[1] > 0 else (i + 1) % 4] for i in at]
            out += _over(system, ring, [system.structure.joints[names[i]] for i in at])
    return (
        tuple(out)
        or "it is not a rod between two cranks, or a crank and a slide, nor four turns of one sphere"
    )


def _over(system: Model, ring: list[str], joints: list[Joint]) -> list[BranchFunctions]:
    """The branches over the first of four joints, with the last one as the other: none where they
    do not fit.
    """
    first, ball, other, last = joints
    base, crank, rod, rocker = ring
    turns = dict(zip(system.structure.velocity_names, circles(system), strict=True))
    limits = _limits(system)
    given = first.name in limits and (
        turns[first.name] or math.isfinite(np.ptp(limits[first.name]))
    )
    if not given or any(
        n != first.name and n != last.name and _limited(system, n) for n in (ball.name, other.name)
    ):
        return []
    found = _rod(system, (base, crank, rod, rocker), joints)
    if found is None or last.name not in limits:
        return []
    low, high = limits[last.name]
    if not found.slides and not turns[last.name] and not high - low < 2.0 * math.pi * (1.0 - 1e-9):
        return []
    size = max(found.length, float(np.ptp(np.concatenate([found.p, found.r]), axis=0).max()))
    walk = RodWalk(
        Rod(found.p / size, found.r / size, found.length / size, found.slides), low, high, size
    )
    ends = (0.1 - math.pi, 0.1 + math.pi + 1e-15) if turns[first.name] else limits[first.name]
    a, b = (system.coordinate_names.index(j.name) for j in (first, last))

    def signs_of(q: Array) -> Array:
        s = walk.sign(q[:, a], q[:, b])
        return np.where(np.abs(s) > NEAR, np.sign(s), 0.0)[:, None]

    def at(x: Array, signs: Array) -> Array:
        out = np.full((len(x), system.nq), np.nan)
        for i, (value, sign) in enumerate(zip(x, signs, strict=True)):
            q = assembly_modes(system, {first.name: value}).q
            same = q[signs_of(q)[:, 0] * sign[0] >= 0.0]
            out[i] = same[0] if len(same) else np.nan
        return out

    return [
        BranchFunctions(system, first.name, *ends, bool(turns[first.name]), 1, walk, at, signs_of)
    ]


def _limits(system: Model) -> dict[str, tuple[float, float]]:
    """Limits of each coordinate that is alone in its joint."""
    own = {*system.coordinate_names}
    return {
        n: (float(a), float(b))
        for n, (a, b) in zip(system.structure.velocity_names, system.structure.limits, strict=True)
        if n in own
    }


def _limited(system: Model, joint: str) -> bool:
    """Whether a joint has limits of any kind."""
    return any(n == joint or n.startswith(f"{joint}.") for n in one_sided_rows(system).names)


def _rod(system: Model, ring: tuple[str, ...], joints: list[Joint]) -> Rod | None:
    """The rod, between points, between directions of axes through one point, or between parallel
    axes.
    """
    base, crank, rod, rocker = ring
    first, ball, other, last = joints
    kinds = [[p.kind for p in primitives_of(system, j)] for j in joints]
    if kinds[0] != [R] or kinds[3] not in ([R], [P]):
        return None
    ends = pin(system, ball, crank)[0], pin(system, other, rocker)[0]
    if kinds[1:3] == [[Q], [Q]]:
        length = float(np.linalg.norm(pin(system, ball, rod)[0] - pin(system, other, rod)[0]))
        p = _curve(system, first, base, ends[0], 1.0)
        r = _curve(system, last, base, ends[1], 1.0)
        return Rod(p, r, length, kinds[3] == [P])
    if kinds[1:] != [[R], [R], [R]]:
        return None
    axes = {
        (joints[k].name, b): _axis(system, joints[k], b)
        for k in range(4)
        for b in (ring[k], ring[(k + 1) % 4])
    }
    pairs = [[axes[joints[k - 1].name, b], axes[joints[k].name, b]] for k, b in enumerate(ring)]
    (_, u) = axes[ball.name, crank]
    (_, v) = axes[other.name, rocker]
    if _concurrent(pairs):
        length = float(np.linalg.norm(axes[ball.name, rod][1] - axes[other.name, rod][1]))
        p = _curve(system, first, base, u, 0.0)
        r = _curve(system, last, base, v, 0.0)
        return Rod(p, r, length, False) if SAME < 0.25 * length**2 < 1.0 - SAME else None
    if not _parallel(pairs):
        return None
    n = axes[first.name, base][1]
    (x, _) = axes[ball.name, rod]
    (y, m) = axes[other.name, rod]
    length = float(np.linalg.norm((y - x) - m * (m @ (y - x))))
    p = _curve(system, first, base, ends[0], 1.0)
    r = _curve(system, last, base, ends[1], 1.0)
    return Rod(p - (p @ n)[:, None] * n, r - (r @ n)[:, None] * n, length, False)


def _curve(system: Model, joint: Joint, base: str, point: Array, weight: float) -> Array:
    """Coefficients of 1, cos and sin, or of 1 and the slide, of a point (or, of weight 0, a
    direction) on a crank, seen from the base.
    """
    F = joint.X_PF.evaluate(system._mechanism.parameters)
    M = joint.X_CM.evaluate(system._mechanism.parameters)
    turns = primitives_of(system, joint)[0].kind == R
    at = 2.0 * np.pi / 3.0 * np.arange(3.0) if turns else np.array([0.0, 1.0])
    X = F @ motion(primitives_of(system, joint), at[:, None]) @ inverse(M)
    X = X if joint.parent == base else inverse(X)
    wave = (
        np.stack([np.ones(3), np.cos(at), np.sin(at)], axis=1)
        if turns
        else np.array([[1.0, 0.0], [1.0, 1.0]])
    )
    return np.asarray(np.linalg.solve(wave, (X @ np.append(point, weight))[:, :3]), dtype=float)


def _axis(system: Model, joint: Joint, body: str) -> tuple[Array, Array]:
    """A point and the direction of the axis of a turn, in the axes of one of its bodies."""
    X = pin(system, joint, body)[1]
    return X[:3, 3], X[:3, "xyz".index(primitives_of(system, joint)[0].axis)]


Axis = tuple[Array, Array]


def _concurrent(pairs: list[list[Axis]]) -> bool:
    """Whether the axes of each body (of joint k - 1 and k, by body) meet, and each is met at one
    place from both.
    """
    places: list[tuple[float, float]] = []
    for (x, u), (y, v) in pairs:
        c = float(u @ v)
        w = y - x
        det = 1.0 - c * c
        if det < SAME:
            return False
        s = float(w @ (u - c * v)) / det
        t = float(w @ (c * u - v)) / det
        if np.linalg.norm(x + s * u - y - t * v) > SAME * (1.0 + np.linalg.norm(w)):
            return False
        places.append((s, t))
    size = 1.0 + max(abs(x) for two in places for x in two)
    return all(abs(places[k][1] - places[(k + 1) % 4][0]) < SAME * size for k in range(4))


def _parallel(pairs: list[list[Axis]]) -> bool:
    """Whether the axes of each body are parallel, and the steps along them add up to nothing."""
    step = 0.0
    sense = 1.0
    size = 1.0
    for (x, u), (y, v) in pairs:
        if np.linalg.norm(np.cross(u, v)) > SAME:
            return False
        step = step + sense * float(u @ (y - x))
        sense = sense * float(u @ v)
        size = size + float(np.linalg.norm(y - x))
    return abs(step) < SAME * size and sense > 0.0


class RodWalk:
    """The functions of a rod between two cranks, or a crank and a slide from `low` to `high`."""

    def __init__(self, rod: Rod, low: float, high: float, size: float):
        self.rod = rod
        self.low = low
        self.high = high
        self.size = size

    def __call__(self, x: Enclosure, signs: Array) -> list[Function]:
        """What is positive where the branches with these signs (n, 1) exist, on intervals of the
        crank's angle.
        """
        p, r, length, slides = self.rod
        c, s = cos_sin(x)
        way = [c * p[1, i] + s * p[2, i] + (p[0, i] - r[0, i]) for i in range(3)]
        far = way[0] * way[0] + way[1] * way[1] + way[2] * way[2]
        if slides:
            along = way[0] * r[1, 0] + way[1] * r[1, 1] + way[2] * r[1, 2]
            size = float(r[1] @ r[1])
            D = along * along - (far - length**2) * size
            return [
                (D, 0),
                *within((along + D.root() * signs[:, 0]) * (1.0 / size), self.low, self.high),
            ]
        A, B = ((way[0] * r[k, 0] + way[1] * r[k, 1] + way[2] * r[k, 2]) * -2.0 for k in (1, 2))
        C = far + (float(r[1] @ r[1]) - length**2)
        square = A * A + B * B
        D = square - C * C
        if not (math.isfinite(self.low) or math.isfinite(self.high)):
            return [(D, 0)]
        high = D.root() * signs[:, 0]
        angle = -(C * A + B * high) / square, -(C * B - A * high) / square
        return [(D, 0), *within_turn(angle, self.low, self.high)]

    def sign(self, a: Array, b: Array) -> Array:
        """The sign of the branch (n,) on which two angles, or an angle and a slide, are; as a size
        up to about 1.
        """
        p, r, _, slides = self.rod
        way = np.stack([np.ones_like(a), np.cos(a), np.sin(a)], axis=1) @ p - r[0]
        if slides:
            return b * math.sqrt(float(r[1] @ r[1])) - (way @ r[1]) / math.sqrt(float(r[1] @ r[1]))
        A, B = (way @ r[k] * -2.0 for k in (1, 2))
        return (A * np.sin(b) - B * np.cos(b)) / np.maximum(np.hypot(A, B), 1e-300)
