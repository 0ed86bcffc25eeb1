"""The outer problem of `arm_part` for six turning joints and `LANES` targets side by side.

One number of all lanes is a vector; those that outlive a function are kept in rows of scratch.
"""

from __future__ import annotations

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.lines import (
    LINE_STRIDE,
    dot,
    mapped,
    minus,
    mix3,
    plus,
    rotated,
    three,
    turned,
    unmapped,
    unrotated,
)
from kempe.kernels.base.vectors import LANES, load_lanes, spread_lanes, store, where
from kempe.kernels.closed_form.analytic_layout import PLANE, POINT
from kempe.kernels.closed_form.subproblems import cone_roots, orbit, trig_roots

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
