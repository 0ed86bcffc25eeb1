"""Closed forms of arms with six turning joints, `LANES` targets side by side: eight slots a target,
no branches.

It is `closed` for the plans that most robots have, in straight lines: one joint of the outer three
comes from one equation, both roots of each of three quadratics are carried along, and no function
of the C library is called. Slots: 4 first + 2 second + inner. A target for which anything is not
plain (a root that is nearly double, an axis through the point that it should move, an error above
rounding) is marked, and left to the careful path.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import INT, OUT, OUTI, F, I
from kempe.kernels.base.lines import (
    LINE_STRIDE,
    dot,
    follow,
    foot,
    identity,
    mapped,
    minus,
    mix3,
    plus,
    rotated,
    three,
    translation,
    turned,
    unmapped,
    unrotated,
    write3,
)
from kempe.kernels.base.scratch import beyond
from kempe.kernels.base.trig import ROUND, atan2
from kempe.kernels.base.vectors import (
    LANES,
    entry,
    gather,
    keep,
    load_lanes,
    raw,
    spread_lanes,
    square_root,
    store,
    store_columns,
    where,
)
from kempe.kernels.closed_form.analytic_layout import (
    FACTOR,
    HIGH,
    INFO,
    INNER,
    INSIDE_BIT,
    JOINT_FLOATS,
    LENGTH,
    LINES,
    LOW,
    MEASURE,
    MODE,
    MULTIPLICITY_UNIT,
    N_JOINTS,
    N_LINES,
    OFFSET,
    OPTION,
    ORDER,
    ORIGIN,
    PLAN_HEADER,
    PLANE,
    POINT,
    SLOT_UNIT,
    TIP,
    UNUSED,
    WHAT,
    X_FIRST,
)
from kempe.kernels.closed_form.candidates import ball_centre
from kempe.kernels.closed_form.merging import arrange
from kempe.kernels.closed_form.subproblems import (
    align,
    cone_roots,
    orbit,
    triangle,
    trig_roots,
    trig_roots_of,
)
from kempe.kernels.closed_form.wrist_part import across
from kempe.kernels.forward.table_layout import SLIDE

# ---- candidate lanes

# The outer problem of `arm_part` for six turning joints and `LANES` targets side by side.
#
# One number of all lanes is a vector; those that outlive a function are kept in rows of scratch.


CLEAR = 1e-7
FAR = 1e-5
"""A discriminant, relative, that is clearly not zero; a distance from an axis that gives an
angle."""

M = 0
U = 3
W = 6
MEASURE_2 = 9
AXIS = 12
SIDE = 15
"""A side, lanes: orbit m + u cos + w sin of the point (from y's point) or normal; terms of the
second measure; axis."""

GOAL = 0
CS = 12
X_SIDE = 24
Z_SIDE = 39
"""Places in the lanes: the goal, cosine and sine of each joint, both sides."""

LANE_ROWS = 54


@device
def load3(p, k):
    """Three consecutive lanes."""
    return load_lanes(p, k * LANES), load_lanes(p, (k + 1) * LANES), load_lanes(p, (k + 2) * LANES)


@device
def store3(p, k, v):
    """Write three consecutive lanes."""
    one = spread_lanes(1.0)
    store(p, k * LANES, one * v[0])
    store(p, (k + 1) * LANES, one * v[1])
    store(p, (k + 2) * LANES, one * v[2])


@device
def goal_lanes(p):
    """The twelve entries of the goal."""
    a = load3(p, GOAL)
    b = load3(p, GOAL + 3)
    c = load3(p, GOAL + 6)
    d = load3(p, GOAL + 9)
    return a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2], d[0], d[1], d[2]


@device
def write_side(p, at, what, m, u, w, sign, oy, o, constant, h):
    """Write one side from its orbit: m a point of the orbit's centre, or the normal's mean; all in
    y's frame.
    """
    if what == POINT:
        m = minus(m, oy)
        second = (dot(m, m) + dot(u, u), 2.0 * dot(m, u), 2.0 * sign * dot(m, w))
    else:
        d = minus(oy, o)
        second = (dot(m, d) + constant, dot(u, d), sign * dot(w, d))
    store3(p, at + M, m)
    store3(p, at + U, u)
    store3(p, at + W, (sign * w[0], sign * w[1], sign * w[2]))
    store3(p, at + MEASURE_2, second)
    store3(p, at + AXIS, h)


@device
def static_orbit(what, h, o, p, n):
    """The orbit of a point or normal under a turn about the line."""
    if what == POINT:
        m, u, w = orbit(h, minus(p, o))
        return plus(m, 1.0, o), u, w
    return orbit(h, n)


@device
def joint_line(lines, i):
    """Direction and point of line i."""
    return three(lines, LINE_STRIDE * i), three(lines, LINE_STRIDE * i + 4)


@routine
def sides(lines, k, what, n, p, oy, lanes):
    """Write both sides for the goals in the lanes. k: place of the first inner joint; (n, p) what
    it keeps.

    The goal stands before x (k = 3), between x and y (2), between y and z (1) or after z (0); y's
    frame is that of its own neighbour on the side where the goal is not.
    """
    x = (k + 3) % 6
    z = (k + 5) % 6
    hx, ox = joint_line(lines, x)
    hz, oz = joint_line(lines, z)
    g = goal_lanes(lanes)
    if k == 3:  # E_y E_z e = E_x^-1 (G e)
        q = mapped(g, p)
        v = rotated(g, n)
        if what == POINT:
            m, u, w = orbit(hx, minus(q, ox))
            m = plus(m, 1.0, ox)
        else:
            m, u, w = orbit(hx, v)
        write_side(lanes, X_SIDE, what, m, u, w, -1.0, oy, ox, dot(v, minus(ox, q)), hx)
        m1, u1, w1 = static_orbit(what, hz, oz, p, n)
        write_side(lanes, Z_SIDE, what, m1, u1, w1, 1.0, oy, oz, dot(n, minus(oz, p)), hz)
    elif k == 0:  # E_y E_z (G^-1 e) = E_x^-1 e
        q = unmapped(g, p)
        v = unrotated(g, n)
        if what == POINT:
            m, u, w = orbit(hz, minus(q, oz))
            m = plus(m, 1.0, oz)
        else:
            m, u, w = orbit(hz, v)
        write_side(lanes, Z_SIDE, what, m, u, w, 1.0, oy, oz, dot(v, minus(oz, q)), hz)
        m1, u1, w1 = static_orbit(what, hx, ox, p, n)
        write_side(lanes, X_SIDE, what, m1, u1, w1, -1.0, oy, ox, dot(n, minus(ox, p)), hx)
    elif k == 1:  # E_y G^-1 (E_z e) = E_x^-1 e
        m1, u1, w1 = static_orbit(what, hx, ox, p, n)
        write_side(lanes, X_SIDE, what, m1, u1, w1, -1.0, oy, ox, dot(n, minus(ox, p)), hx)
        m2, u2, w2 = static_orbit(what, hz, oz, p, n)
        centre = unmapped(g, m2) if what == POINT else unrotated(g, m2)
        write_side(
            lanes,
            Z_SIDE,
            what,
            centre,
            unrotated(g, u2),
            unrotated(g, w2),
            1.0,
            oy,
            unmapped(g, oz),
            dot(n, minus(oz, p)),
            unrotated(g, hz),
        )
    else:  # E_y E_z e = G (E_x^-1 e)
        m1, u1, w1 = static_orbit(what, hz, oz, p, n)
        write_side(lanes, Z_SIDE, what, m1, u1, w1, 1.0, oy, oz, dot(n, minus(oz, p)), hz)
        m2, u2, w2 = static_orbit(what, hx, ox, p, n)
        centre = mapped(g, m2) if what == POINT else rotated(g, m2)
        write_side(
            lanes,
            X_SIDE,
            what,
            centre,
            rotated(g, u2),
            rotated(g, w2),
            -1.0,
            oy,
            mapped(g, ox),
            dot(n, minus(ox, p)),
            rotated(g, hx),
        )


@device
def term(lanes, side, hy, j):
    """Constant, cosine and sine factor of measure j of a side."""
    if j == 1:
        return load3(lanes, side + MEASURE_2)
    return (
        dot(hy, load3(lanes, side + M)),
        dot(hy, load3(lanes, side + U)),
        dot(hy, load3(lanes, side + W)),
    )


@device
def on_orbit(lanes, side, c, s):
    """The point or normal of a side at an angle."""
    return mix3(
        load3(lanes, side + M),
        spread_lanes(1.0),
        load3(lanes, side + U),
        c,
        load3(lanes, side + W),
        s,
    )


@device
def clear_of(d2, size):
    """1 in lanes where the discriminant is neither nearly zero nor NaN and the amplitude does not
    vanish, else 0.
    """
    return where(abs(d2) > CLEAR * size, where(size > FAR * FAR, 1.0, spread_lanes(0.0)), 0.0)


@routine
def roots_of(lanes, side, sign, hy, what, j, known, w):
    """(c0, s0, c1, s1, valid, clear): both angles of a side for which measure j is `known`; w: a
    normal that has it.
    """
    a = term(lanes, side, hy, j)
    if what == PLANE and j == 0:
        n = plus(load3(lanes, side + M), 1.0, load3(lanes, side + U))
        h = load3(lanes, side + AXIS)
        c0, s0, c1, s1, d2 = cone_roots(hy, h, n, w)
        s0 = sign * s0
        s1 = sign * s1
    else:
        c0, s0, c1, s1, d2 = trig_roots(a[1], a[2], known - a[0])
    size = a[1] * a[1] + a[2] * a[2]
    return c0, s0, c1, s1, where(d2 > 0.0, 1.0, spread_lanes(0.0)), clear_of(d2, size)


@device
def put_cs(lanes, joint, c, s):
    """Write cosine and sine of a joint."""
    store(lanes, (CS + 2 * joint) * LANES, c)
    store(lanes, (CS + 2 * joint + 1) * LANES, s)


@device
def unwind(lines, joint, v, lanes, of_point):
    """A direction or point moved by the inverse of a joint."""
    h, o = joint_line(lines, joint)
    c = load_lanes(lanes, (CS + 2 * joint) * LANES)
    s = load_lanes(lanes, (CS + 2 * joint + 1) * LANES)
    if of_point:
        return plus(turned(h, minus(v, o), c, -s), 1.0, o)
    return turned(h, v, c, -s)


@routine
def inner_direction(lines, k, lanes, v):
    """The direction v moved as the inner joints have to move it: (E_0 ...)^-1 G (E_k+3 ...)^-1."""
    one = spread_lanes(1.0)
    v = (one * v[0], one * v[1], one * v[2])
    for joint in range(k + 3, 6):
        v = unwind(lines, joint, v, lanes, False)
    v = rotated(goal_lanes(lanes), v)
    for joint in range(k):
        v = unwind(lines, joint, v, lanes, False)
    return v


@routine
def inner_point(lines, k, lanes, v):
    """The point v moved as the inner joints have to move it."""
    one = spread_lanes(1.0)
    v = (one * v[0], one * v[1], one * v[2])
    for joint in range(k + 3, 6):
        v = unwind(lines, joint, v, lanes, True)
    v = mapped(goal_lanes(lanes), v)
    for joint in range(k):
        v = unwind(lines, joint, v, lanes, True)
    return v


# ---- candidate branches

# All branches of a closed form for `LANES` targets side by side: eight slots, written as rows of
# the answer.
#
# Slots: 4 first + 2 second + inner. A target for which anything is not plain (a root that is nearly
# double, an axis through the point that it should move, an error above rounding) is marked.


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


ROTATION_TOLERANCE = 1e-6
"""Largest entry of R^T R - 1 that a target's rotation may have."""

AT_LINES = 12
AT_JOINTS = AT_LINES + 6 * LINE_STRIDE
AT_SHIFT = AT_JOINTS + 6 * JOINT_FLOATS
SIX = AT_SHIFT + 13
"""Places in the numbers of the six unknowns: the tip's pose, lines, joints, a motion and an angle;
how many."""


@routine
def take_targets(targets, at, floats, tip, lanes):
    """1 in lanes whose target is sound, else 0; writes the goals G = T M^-1."""
    r = (
        gather(targets, at, 16),
        gather(targets, at + 1, 16),
        gather(targets, at + 2, 16),
        gather(targets, at + 4, 16),
        gather(targets, at + 5, 16),
        gather(targets, at + 6, 16),
        gather(targets, at + 8, 16),
        gather(targets, at + 9, 16),
        gather(targets, at + 10, 16),
    )
    p = (gather(targets, at + 3, 16), gather(targets, at + 7, 16), gather(targets, at + 11, 16))
    scale = 1.0 / floats[LENGTH]
    p = (
        (p[0] - floats[ORIGIN]) * scale,
        (p[1] - floats[ORIGIN + 1]) * scale,
        (p[2] - floats[ORIGIN + 2]) * scale,
    )
    x = (r[0], r[3], r[6])
    y = (r[1], r[4], r[7])
    z = (r[2], r[5], r[8])
    normal = (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    off = abs(dot(x, x) - 1.0) + abs(dot(y, y) - 1.0) + abs(dot(x, y))
    off = off + abs(normal[0] - z[0]) + abs(normal[1] - z[1]) + abs(normal[2] - z[2])
    off = off + 0.0 * (p[0] + p[1] + p[2])
    off = off + abs(gather(targets, at + 12, 16)) + abs(gather(targets, at + 13, 16))
    off = off + abs(gather(targets, at + 14, 16)) + abs(gather(targets, at + 15, 16) - 1.0)
    for i in range(3):
        row = (r[3 * i], r[3 * i + 1], r[3 * i + 2])
        a = dot(row, three(tip, 0))
        b = dot(row, three(tip, 4))
        c = dot(row, three(tip, 8))
        store(lanes, (GOAL + 4 * i) * LANES, a)
        store(lanes, (GOAL + 4 * i + 1) * LANES, b)
        store(lanes, (GOAL + 4 * i + 2) * LANES, c)
        t = translation(tip)
        store(lanes, (GOAL + 4 * i + 3) * LANES, p[i] - (a * t[0] + b * t[1] + c * t[2]))
    return where(ROTATION_TOLERANCE > off, 1.0, spread_lanes(0.0))


@routine
def reduced(ints, floats, moves, locked, six):
    """Write to six (SIX numbers) the tip's pose, lines and joints of the unknowns, moved by the
    locked joints.
    """
    n = ints[N_JOINTS]
    order = beyond(ints, ORDER)
    shift = beyond(six, AT_SHIFT)
    theta = beyond(six, AT_SHIFT + 12)
    joints = beyond(floats, LINES + LINE_STRIDE * ints[N_LINES])
    identity(shift)
    for i in range(n):
        at = JOINT_FLOATS * i
        k = 0
        theta[0] = joints[at + FACTOR] * locked[i] + joints[at + OFFSET]
        h = three(floats, LINES + LINE_STRIDE * i)
        o = three(floats, LINES + LINE_STRIDE * i + 4)
        if moves[i] == 0:
            slides = ints[PLAN_HEADER + i] == SLIDE
            follow(shift, h, o, slides, theta[0], math.cos(theta[0]), math.sin(theta[0]))
            continue
        while order[k] != i:
            k += 1
        write3(six, AT_LINES + LINE_STRIDE * k, rotated(shift, h))
        write3(six, AT_LINES + LINE_STRIDE * k + 4, mapped(shift, o))
        for j in range(JOINT_FLOATS):
            six[AT_JOINTS + JOINT_FLOATS * k + j] = joints[at + j]
    tip = beyond(floats, TIP)
    for j in range(3):
        column = rotated(shift, (tip[j], tip[4 + j], tip[8 + j]))
        six[j] = column[0]
        six[4 + j] = column[1]
        six[8 + j] = column[2]
    p = mapped(shift, translation(tip))
    six[3] = p[0]
    six[7] = p[1]
    six[11] = p[2]


@device
def problem_of(ints, floats, six, lanes, out, near, near_step):
    """What the targets of a call share."""
    lines = beyond(six, AT_LINES)
    k = ints[INNER]
    what = ints[WHAT]
    x = (k + 3) % 6
    y = (k + 4) % 6
    z = (k + 5) % 6
    hy, oy = joint_line(lines, y)
    other = z if ints[OPTION] == 0 else x
    oy = foot(oy, hy, three(lines, LINE_STRIDE * other + 4), three(lines, LINE_STRIDE * other))
    normal = three(lines, LINE_STRIDE * k)
    p = ball_centre(lines, k) if what == POINT else three(lines, LINE_STRIDE * k + 4)
    return SharedTargets(
        lines,
        beyond(six, AT_JOINTS),
        lanes,
        out,
        near,
        near_step,
        beyond(ints, ORDER),
        k,
        what,
        ints[MODE],
        ints[MEASURE],
        oy,
        p,
        normal,
        translation(six),
        floats[LENGTH],
    )


@routine
def spread_rows(answers, n, order, moves, locked, count, out):
    """Write answers of six unknowns as those of n joints, with the values of the locked ones."""
    width = n + INFO
    for i in range(count * SLOTS):
        row = beyond(out, width * i)
        from_ = beyond(answers, ROW * i)
        for j in range(n):
            if moves[j] == 0:
                row[j] = locked[j]
        for j in range(6):
            row[order[j]] = from_[j]
        row[n], row[n + 1] = from_[6], from_[7]


@kernel(
    I("_"),
    F("_"),
    F("N", 4, 4),
    F("_", "n"),
    F("_", "n"),
    INT,
    OUT("N", "_", f"n+{INFO}"),
    OUTI("N"),
)
def closed_side_by_side(ints, floats, targets, near, locked, sort, out, left):
    """Number of targets left to the careful path, whose numbers are written to `left` (N,); the
    others are done.

    ints, floats: plan, see `analytic_layout`, of six unknown turning joints with an equation in one
    unknown. targets: (N, 4, 4). near: (1 or N, n), at least LANES rows if not one and locked is
    one. locked: (1 or N, n), of which the locked joints count. sort: 1 for rows in order; if none
    are left, -1 less the rows in use of the last target is returned. out: (N, SLOTS, n + INFO).
    """
    scratch = np.empty(ROWS * LANES + (16 + SLOTS * ROW) * LANES + SIX)
    n_targets = targets.shape[0]
    n = ints[N_JOINTS]
    lanes = raw(scratch)
    goals = beyond(lanes, ROWS * LANES)
    answers = beyond(lanes, (ROWS + 16) * LANES)
    six = beyond(answers, SLOTS * ROW * LANES)
    moves = beyond(raw(ints), PLAN_HEADER + ints[N_LINES])
    apart = locked.shape[0] > 1
    step = n if near.shape[0] > 1 else 0
    group = 1 if apart else n_targets  # targets of which the lines are the same
    few = group < LANES
    width = SLOTS * (n + INFO)
    direct = n == 6 and not few
    next_ = 0 if apart else step
    count = 0
    done = 0
    for first in range(0, n_targets, max(1, group)):
        wanted = beyond(raw(targets), 16 * first)
        rows = beyond(raw(out), width * first)
        held = beyond(raw(locked), n * first if apart else 0)
        reduced(raw(ints), raw(floats), moves, held, six)
        if few:  # the lanes are filled up with the last target
            for i in range(LANES):
                for j in range(16):
                    goals[16 * i + j] = wanted[16 * min(i, group - 1) + j]
        for i in range(0, group, LANES):
            at = 0 if few else min(i, group - LANES)
            pr = problem_of(
                raw(ints),
                raw(floats),
                six,
                lanes,
                beyond(rows, width * at) if direct else answers,
                beyond(raw(near), step * (first + at)),
                next_,
            )
            sound = take_targets(
                goals if few else beyond(wanted, 16 * at), 0, raw(floats), six, lanes
            )
            clear = sound * block(pr, 0)
            if not direct:
                spread_rows(
                    answers, n, pr.order, moves, held, min(LANES, group), beyond(rows, width * at)
                )
            for lane in range(i - at, min(LANES, group - at)):
                if not entry(clear, lane) > 0.5:
                    left[count] = first + at + lane
                    count += 1
    if sort != 0:
        joints = beyond(raw(floats), LINES + LINE_STRIDE * ints[N_LINES])
        for i in range(n_targets):
            used = arrange(
                n,
                joints,
                beyond(raw(near), step * i),
                beyond(raw(out), SLOTS * (n + INFO) * i),
                SLOTS,
            )
            if count == 0:
                done = -1 - used
    keep(scratch)
    return count if count > 0 else done
