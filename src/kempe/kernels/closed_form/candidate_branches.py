"""All branches of a closed form for `LANES` targets side by side: eight slots, written as rows of
the answer.

Slots: 4 first + 2 second + inner. A target for which anything is not plain (a root that is nearly
double, an axis through the point that it should move, an error above rounding) is marked.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.lines import LINE_STRIDE, dot, minus, plus, three, turned
from kempe.kernels.base.trig import ROUND, atan2
from kempe.kernels.base.vectors import (
    LANES,
    gather,
    load_lanes,
    spread_lanes,
    square_root,
    store,
    store_columns,
    where,
)
from kempe.kernels.closed_form.analytic_layout import (
    FACTOR,
    HIGH,
    INSIDE_BIT,
    JOINT_FLOATS,
    LOW,
    MULTIPLICITY_UNIT,
    OFFSET,
    PLANE,
    POINT,
    SLOT_UNIT,
    UNUSED,
    X_FIRST,
)
from kempe.kernels.closed_form.candidate_lanes import (
    FAR,
    LANE_ROWS,
    X_SIDE,
    Z_SIDE,
    M,
    U,
    clear_of,
    inner_direction,
    inner_point,
    joint_line,
    load3,
    on_orbit,
    put_cs,
    roots_of,
    sides,
    term,
)
from kempe.kernels.closed_form.subproblems import align, cone_roots, orbit, triangle, trig_roots_of
from kempe.kernels.closed_form.wrist_part import across

ROUNDING = 1e-12
EDGE = 1e-10
"""The largest error that is left as it is; how far beyond a limit rounding may push a
coordinate."""

SLOTS = 8
ROW = 8
"""Slots of a target, and numbers of each: six coordinates, error, code."""

AT_COORDINATES = LANE_ROWS
AT_FITS = LANE_ROWS + 6
ROWS = LANE_ROWS + 12
"""Rows of scratch: those of `candidate_lanes`, the joints' coordinates, and whether these are
inside the limits."""


class SharedTargets(NamedTuple):
    """What all targets of a call share; pointers and numbers."""

    lines: object
    joints: object
    lanes: object
    out: object
    near: object
    near_step: int
    order: object
    k: int
    what: int
    mode: int
    measure: int
    oy: object
    p: object
    n: object
    probe: object
    length: float


@device
def coordinate(pr, joint, theta, near):
    """(q, inside): the coordinate of a joint at the angle `theta`, by as many periods as suit
    limits and `near`.

    Of the values q + k * period, the one inside the limits nearest to `near`, with inside 1; where
    none is inside, the one nearest to `near`, with inside 0. `pr` is the problem with the table of
    joints.
    """
    at = JOINT_FLOATS * joint
    low = pr.joints[at + LOW]
    high = pr.joints[at + HIGH]
    period = 2.0 * math.pi / abs(pr.joints[at + FACTOR])
    per = 1.0 / period
    q = (theta - pr.joints[at + OFFSET]) * (1.0 / pr.joints[at + FACTOR])
    q = q + period * (((near - q) * per + ROUND) - ROUND)
    # one period back inside is tried from either side; where none fits, q stays as it is and is
    # outside
    over = (q - (high + EDGE)) * per
    under = ((low - EDGE) - q) * per
    down = q - period * (((over + 0.5) + ROUND) - ROUND)
    up = q + period * (((under + 0.5) + ROUND) - ROUND)
    moved = where(over > 0.0, down, where(under > 0.0, up, q))
    fits = where(moved > high + EDGE, 0.0, where(low - EDGE > moved, 0.0, spread_lanes(1.0)))
    q = where(fits > 0.5, moved, q)
    q = where(fits > 0.5, where(q > high, high, where(low > q, low, q)), q)
    return q, fits


@routine
def write_row(pr, at, slot, valid, error):
    """Write one slot of all lanes, from the coordinates in the scratch."""
    place = at * SLOTS * ROW + slot * ROW
    inside = load_lanes(pr.lanes, AT_FITS * LANES)
    for joint in range(1, 6):
        inside = inside * load_lanes(pr.lanes, (AT_FITS + joint) * LANES)
    code = where(
        valid > 0.5, MULTIPLICITY_UNIT + SLOT_UNIT * (slot + 1) + INSIDE_BIT * inside, UNUSED
    )
    q = load3(pr.lanes, AT_COORDINATES)
    last = load3(pr.lanes, AT_COORDINATES + 3)
    store_columns(pr.out, place, SLOTS * ROW, q[0], q[1], q[2], last[0])
    store_columns(pr.out, place + 4, SLOTS * ROW, last[1], last[2], error, code)


@device
def near_of(pr, at, joint):
    """What the coordinate of a joint shall be near, in all lanes."""
    if pr.near_step == 0:
        return spread_lanes(pr.near[pr.order[joint]])
    return gather(pr.near, pr.near_step * at + pr.order[joint], pr.near_step)


@routine
def put_angle(pr, at, joint, c, s):
    """Write cosine and sine of a joint, its coordinate and whether that is inside the limits."""
    put_cs(pr.lanes, joint, c, s)
    q, fits = coordinate(pr, joint, atan2(s, c), near_of(pr, at, joint))
    store(pr.lanes, (AT_COORDINATES + joint) * LANES, q)
    store(pr.lanes, (AT_FITS + joint) * LANES, fits)


@routine
def error_of(pr, a, b, c, w, dr, dp, r):
    """The error of one solution: a probe point and two directions moved by the inner joints,
    against where they go.
    """
    ha, oa = joint_line(pr.lines, pr.k)
    hb, ob = joint_line(pr.lines, pr.k + 1)
    hc, oc = joint_line(pr.lines, pr.k + 2)
    p = plus(oc, 1.0, turned(hc, minus(pr.probe, oc), c[0], c[1]))
    p = plus(ob, 1.0, turned(hb, minus(p, ob), b[0], b[1]))
    p = plus(oa, 1.0, turned(ha, minus(p, oa), a[0], a[1]))
    x = turned(ha, turned(hb, turned(hc, r, c[0], c[1]), b[0], b[1]), a[0], a[1])
    y = turned(ha, turned(hb, hc, b[0], b[1]), a[0], a[1])
    p = minus(p, dp)
    x = minus(x, dr)
    y = minus(y, w)
    return square_root(pr.length * pr.length * dot(p, p) + dot(x, x) + dot(y, y))


@routine
def inner_pair(pr, at, slot, valid, clear):
    """`clear` after both solutions of the inner joints were written; the outer angles are in the
    scratch.
    """
    ha, oa = joint_line(pr.lines, pr.k)
    hb, ob = joint_line(pr.lines, pr.k + 1)
    hc, oc = joint_line(pr.lines, pr.k + 2)
    r = across(hc)
    w = inner_direction(pr.lines, pr.k, pr.lanes, hc)
    dr = inner_direction(pr.lines, pr.k, pr.lanes, r)
    dp = inner_point(pr.lines, pr.k, pr.lanes, pr.probe)
    one = spread_lanes(1.0)
    goal = w
    middle, u0, w0 = orbit(hb, minus(oc, ob))
    if pr.what == POINT:
        c0, s0, c1, s1, d2 = cone_roots(ha, hb, hc, w)
        sa = minus(ha, plus((0.0, 0.0, 0.0), dot(ha, hb), hb))
        sb = minus(hc, plus((0.0, 0.0, 0.0), dot(hc, hb), hb))
        size = one * (dot(sa, sa) * dot(sb, sb))
    else:
        q = minus(inner_point(pr.lines, pr.k, pr.lanes, oc), oa)
        goal = minus(q, plus((0.0, 0.0, 0.0), dot(hc, q), hc))
        fixed = minus(plus(middle, 1.0, ob), oa)
        fixed = minus(fixed, plus((0.0, 0.0, 0.0), dot(hc, fixed), hc))
        x = 2.0 * dot(fixed, u0)
        y = 2.0 * dot(fixed, w0)
        rho2 = dot(goal, goal)
        d2 = triangle(square_root(dot(fixed, fixed)), square_root(dot(u0, u0)), rho2)
        c0, s0, c1, s1, d2 = trig_roots_of(
            one * x, one * y, rho2 - dot(fixed, fixed) - dot(u0, u0), d2
        )
        size = one * (x * x + y * y)
        middle = fixed
    there = where(d2 > 0.0, one, 0.0)
    clear = clear * where(valid > 0.5, clear_of(d2, size), 1.0)
    valid = valid * there
    for i in range(2):
        c = c0
        s = s0
        if i == 1:
            c = c1
            s = s1
        u = turned(hb, (one * hc[0], one * hc[1], one * hc[2]), c, s)
        if pr.what == PLANE:
            u = plus(plus((one * middle[0], one * middle[1], one * middle[2]), c, u0), s, w0)
        ca, sa_, size_a = align(ha, u, goal)
        back = turned(hb, turned(ha, dr, ca, -sa_), c, -s)
        cc, sc, _ = align(hc, r, back)
        put_angle(pr, at, pr.k, ca, sa_)
        put_angle(pr, at, pr.k + 1, c, s)
        put_angle(pr, at, pr.k + 2, cc, sc)
        error = error_of(pr, (ca, sa_), (c, s), (cc, sc), w, dr, dp, r)
        fine = where(ROUNDING > error, where(size_a > FAR * FAR, one, 0.0), 0.0)
        clear = clear * where(valid > 0.5, fine, 1.0)
        write_row(pr, at, slot + i, valid, error)
    return clear


@routine
def second_pair(pr, at, slot, c, s, valid, clear):
    """`clear` after the four solutions were written that belong to one angle of the first joint."""
    first, second = (X_SIDE, Z_SIDE) if pr.mode == X_FIRST else (Z_SIDE, X_SIDE)
    x = (pr.k + 3) % 6
    y = (pr.k + 4) % 6
    z = (pr.k + 5) % 6
    hy = three(pr.lines, LINE_STRIDE * y)
    lanes = pr.lanes
    v = on_orbit(lanes, first, c, s)
    j = 1 - pr.measure
    known = dot(hy, v)
    if j == 1:
        t = term(lanes, first, hy, 1)
        known = t[0] + t[1] * c + t[2] * s
    sign = 1.0 if pr.mode == X_FIRST else -1.0
    c0, s0, c1, s1, there, plain = roots_of(lanes, second, sign, hy, pr.what, j, known, v)
    clear = clear * where(valid > 0.5, plain, 1.0)
    valid = valid * there
    for i in range(2):
        c2 = c0
        s2 = s0
        if i == 1:
            c2 = c1
            s2 = s1
        other = on_orbit(lanes, second, c2, s2)
        if pr.mode == X_FIRST:
            cy, sy, size = align(hy, other, v)
            put_angle(pr, at, x, c, s)
            put_angle(pr, at, z, c2, s2)
        else:
            cy, sy, size = align(hy, v, other)
            put_angle(pr, at, z, c, s)
            put_angle(pr, at, x, c2, s2)
        put_angle(pr, at, y, cy, sy)
        clear = clear * where(valid > 0.5, where(size > FAR * FAR, 1.0, spread_lanes(0.0)), 1.0)
        clear = inner_pair(pr, at, slot + 2 * i, valid, clear)
    return clear


@routine
def block(pr, at):
    """1 in lanes whose target was plain, else 0; writes all slots of the targets from `at` on."""
    first, second = (X_SIDE, Z_SIDE) if pr.mode == X_FIRST else (Z_SIDE, X_SIDE)
    hy = three(pr.lines, LINE_STRIDE * ((pr.k + 4) % 6))
    lanes = pr.lanes
    sides(pr.lines, pr.k, pr.what, pr.n, pr.p, pr.oy, lanes)
    known = term(lanes, second, hy, pr.measure)[0]
    w = plus(load3(lanes, second + M), 1.0, load3(lanes, second + U))
    sign = -1.0 if pr.mode == X_FIRST else 1.0
    c0, s0, c1, s1, valid, clear = roots_of(lanes, first, sign, hy, pr.what, pr.measure, known, w)
    clear = second_pair(pr, at, 0, c0, s0, valid, clear)
    return second_pair(pr, at, 4, c1, s1, valid, clear)
