"""A planar mechanism of dyads as functions of one coordinate: where each of its branches exists,
with bounds.

The dyads of a closed form (`solvers.dyads`) are walked with enclosures in place of numbers. Each of
them has two roots, which exist where its circles, or its line and circle, meet: where functions of
the coordinate are positive. Where one of them is zero the two roots are one. Limits of the other
coordinates are such functions, too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.analysis.first_order.constraint_graph import structure
from kempe.analysis.spaces.curves.branch_functions import (
    SOUND,
    BranchFunctions,
    Function,
    within,
    within_turn,
)
from kempe.kernels.dyads import dyads_layout as K
from kempe.kinematics.common.enclosures import Enclosure, constant, cos_sin
from kempe.kinematics.configuration import circles, mid, q_dict
from kempe.kinematics.one_sided import one_sided_rows
from kempe.model.kept import kept
from kempe.solvers.dyads.assur_groups import Decomposition
from kempe.solvers.dyads.decompose import NOWHERE, operations, parts_of
from kempe.solvers.dyads.dyads import CLOSED, Plan, closed_form
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

MOST_SIGNS = 8
"""Branch signs up to which all branches are followed."""
MEETING = 1e-7
"""Height of a dyad, as a part of the mechanism's size, up to which its sign is not sure."""
Vector = tuple[Enclosure, Enclosure]


@kept
def dyad_branches(system: System) -> tuple[BranchFunctions, ...] | str:
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


def _aside(system: System) -> list[str]:
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

    def __init__(self, system: System, plan: Plan):
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


# ---- poses and groups, as the kernel has them


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


# ---- coordinates and their limits


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
