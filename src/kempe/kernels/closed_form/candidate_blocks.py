"""Closed forms of arms with six turning joints, `LANES` targets side by side: eight slots a target,
no branches.

It is `find_closed_form_solutions` for the plans that most robots have, in straight lines: one joint
of the outer three comes from one equation, both roots of each of three quadratics are carried
along, and no function
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
    add_scaled,
    append_motion,
    combine_three,
    dot,
    find_foot_point,
    read_translation,
    read_vector,
    rotate_about_axis,
    rotate_vector,
    subtract_vectors,
    transform_point,
    transform_point_back,
    unrotate_vector,
    write_identity,
    write_vector,
)
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.trig import ROUND, atan2
from kempe.kernels.base.vectors import (
    LANES,
    compute_square_root,
    extract_entry,
    gather_lanes,
    get_pointer,
    keep_alive,
    load_lanes,
    select_where,
    spread_lanes,
    store_columns,
    store_value,
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
from kempe.kernels.closed_form.candidates import find_ball_centre
from kempe.kernels.closed_form.merging import sort_rows
from kempe.kernels.closed_form.subproblems import (
    compute_orbit,
    compute_triangle_discriminant,
    find_aligning_turn,
    find_cone_turns,
    find_precise_trig_roots,
    find_trig_roots,
)
from kempe.kernels.closed_form.wrist_part import find_perpendicular
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
def load_triple(p, k):
    """Read the three vectors that begin at p[k]."""
    return load_lanes(p, k * LANES), load_lanes(p, (k + 1) * LANES), load_lanes(p, (k + 2) * LANES)


@device
def store_triple(p, k, v):
    """Write three vectors from p[k] on."""
    one = spread_lanes(1.0)
    store_value(p, k * LANES, one * v[0])
    store_value(p, (k + 1) * LANES, one * v[1])
    store_value(p, (k + 2) * LANES, one * v[2])


@device
def load_goal(p):
    """Read the twelve entries of the goal poses, a vector each."""
    a = load_triple(p, GOAL)
    b = load_triple(p, GOAL + 3)
    c = load_triple(p, GOAL + 6)
    d = load_triple(p, GOAL + 9)
    return a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2], d[0], d[1], d[2]


@device
def write_side(p, at, what, m, u, w, sign, oy, o, constant, h):
    """Write one side from its orbit: m a point of the orbit's centre, or the normal's mean; all in
    y's frame.
    """
    if what == POINT:
        m = subtract_vectors(m, oy)
        second = (dot(m, m) + dot(u, u), 2.0 * dot(m, u), 2.0 * sign * dot(m, w))
    else:
        d = subtract_vectors(oy, o)
        second = (dot(m, d) + constant, dot(u, d), sign * dot(w, d))
    store_triple(p, at + M, m)
    store_triple(p, at + U, u)
    store_triple(p, at + W, (sign * w[0], sign * w[1], sign * w[2]))
    store_triple(p, at + MEASURE_2, second)
    store_triple(p, at + AXIS, h)


@device
def compute_line_orbit(what, h, o, p, n):
    """Return the orbit of a point or normal that turns about the line: centre and two radii."""
    if what == POINT:
        m, u, w = compute_orbit(h, subtract_vectors(p, o))
        return add_scaled(m, 1.0, o), u, w
    return compute_orbit(h, n)


@device
def read_joint_line(lines, i):
    """Read the direction and the point of the line of joint i."""
    return read_vector(lines, LINE_STRIDE * i), read_vector(lines, LINE_STRIDE * i + 4)


@routine
def write_sides(lines, k, what, n, p, oy, lanes):
    """Write both sides for the goals in the lanes. k: place of the first inner joint; (n, p) what
    it keeps.

    The goal stands before x (k = 3), between x and y (2), between y and z (1) or after z (0); y's
    frame is that of its own neighbour on the side where the goal is not.
    """
    x = (k + 3) % 6
    z = (k + 5) % 6
    hx, ox = read_joint_line(lines, x)
    hz, oz = read_joint_line(lines, z)
    g = load_goal(lanes)
    if k == 3:  # E_y E_z e = E_x^-1 (G e)
        q = transform_point(g, p)
        v = rotate_vector(g, n)
        if what == POINT:
            m, u, w = compute_orbit(hx, subtract_vectors(q, ox))
            m = add_scaled(m, 1.0, ox)
        else:
            m, u, w = compute_orbit(hx, v)
        write_side(lanes, X_SIDE, what, m, u, w, -1.0, oy, ox, dot(v, subtract_vectors(ox, q)), hx)
        m1, u1, w1 = compute_line_orbit(what, hz, oz, p, n)
        write_side(
            lanes, Z_SIDE, what, m1, u1, w1, 1.0, oy, oz, dot(n, subtract_vectors(oz, p)), hz
        )
    elif k == 0:  # E_y E_z (G^-1 e) = E_x^-1 e
        q = transform_point_back(g, p)
        v = unrotate_vector(g, n)
        if what == POINT:
            m, u, w = compute_orbit(hz, subtract_vectors(q, oz))
            m = add_scaled(m, 1.0, oz)
        else:
            m, u, w = compute_orbit(hz, v)
        write_side(lanes, Z_SIDE, what, m, u, w, 1.0, oy, oz, dot(v, subtract_vectors(oz, q)), hz)
        m1, u1, w1 = compute_line_orbit(what, hx, ox, p, n)
        write_side(
            lanes, X_SIDE, what, m1, u1, w1, -1.0, oy, ox, dot(n, subtract_vectors(ox, p)), hx
        )
    elif k == 1:  # E_y G^-1 (E_z e) = E_x^-1 e
        m1, u1, w1 = compute_line_orbit(what, hx, ox, p, n)
        write_side(
            lanes, X_SIDE, what, m1, u1, w1, -1.0, oy, ox, dot(n, subtract_vectors(ox, p)), hx
        )
        m2, u2, w2 = compute_line_orbit(what, hz, oz, p, n)
        centre = transform_point_back(g, m2) if what == POINT else unrotate_vector(g, m2)
        write_side(
            lanes,
            Z_SIDE,
            what,
            centre,
            unrotate_vector(g, u2),
            unrotate_vector(g, w2),
            1.0,
            oy,
            transform_point_back(g, oz),
            dot(n, subtract_vectors(oz, p)),
            unrotate_vector(g, hz),
        )
    else:  # E_y E_z e = G (E_x^-1 e)
        m1, u1, w1 = compute_line_orbit(what, hz, oz, p, n)
        write_side(
            lanes, Z_SIDE, what, m1, u1, w1, 1.0, oy, oz, dot(n, subtract_vectors(oz, p)), hz
        )
        m2, u2, w2 = compute_line_orbit(what, hx, ox, p, n)
        centre = transform_point(g, m2) if what == POINT else rotate_vector(g, m2)
        write_side(
            lanes,
            X_SIDE,
            what,
            centre,
            rotate_vector(g, u2),
            rotate_vector(g, w2),
            -1.0,
            oy,
            transform_point(g, ox),
            dot(n, subtract_vectors(ox, p)),
            rotate_vector(g, hx),
        )


@device
def compute_side_term(lanes, side, hy, j):
    """Return constant, cosine and sine factor of measure j of one side."""
    if j == 1:
        return load_triple(lanes, side + MEASURE_2)
    return (
        dot(hy, load_triple(lanes, side + M)),
        dot(hy, load_triple(lanes, side + U)),
        dot(hy, load_triple(lanes, side + W)),
    )


@device
def find_orbit_point(lanes, side, c, s):
    """Return the point or normal of one side at the angle with cosine c and sine s."""
    return combine_three(
        load_triple(lanes, side + M),
        spread_lanes(1.0),
        load_triple(lanes, side + U),
        c,
        load_triple(lanes, side + W),
        s,
    )


@device
def mark_clear_roots(d2, size):
    """Return 1 in lanes where both roots are clearly separate: the discriminant is neither nearly
    zero nor NaN, and the amplitude is not zero; else 0.
    """
    return select_where(
        abs(d2) > CLEAR * size, select_where(size > FAR * FAR, 1.0, spread_lanes(0.0)), 0.0
    )


@routine
def find_side_angles(lanes, side, sign, hy, what, j, known, w):
    """Return both angles of one side for which measure j has the value `known`, as (c0, s0, c1, s1,
    valid, clear); w: a normal that has this value.
    """
    a = compute_side_term(lanes, side, hy, j)
    if what == PLANE and j == 0:
        n = add_scaled(load_triple(lanes, side + M), 1.0, load_triple(lanes, side + U))
        h = load_triple(lanes, side + AXIS)
        c0, s0, c1, s1, d2 = find_cone_turns(hy, h, n, w)
        s0 = sign * s0
        s1 = sign * s1
    else:
        c0, s0, c1, s1, d2 = find_trig_roots(a[1], a[2], known - a[0])
    size = a[1] * a[1] + a[2] * a[2]
    return (
        c0,
        s0,
        c1,
        s1,
        select_where(d2 > 0.0, 1.0, spread_lanes(0.0)),
        mark_clear_roots(d2, size),
    )


@device
def write_cos_sin(lanes, joint, c, s):
    """Write cosine and sine of a joint to the scratch."""
    store_value(lanes, (CS + 2 * joint) * LANES, c)
    store_value(lanes, (CS + 2 * joint + 1) * LANES, s)


@device
def undo_joint_motion(lines, joint, v, lanes, of_point):
    """Move a direction or a point by the inverse of a joint's motion."""
    h, o = read_joint_line(lines, joint)
    c = load_lanes(lanes, (CS + 2 * joint) * LANES)
    s = load_lanes(lanes, (CS + 2 * joint + 1) * LANES)
    if of_point:
        return add_scaled(rotate_about_axis(h, subtract_vectors(v, o), c, -s), 1.0, o)
    return rotate_about_axis(h, v, c, -s)


@routine
def compute_inner_direction(lines, k, lanes, v):
    """Return the direction into which the inner joints have to turn v: (E_0 ...)^-1 G (E_k+3
    ...)^-1 v.
    """
    one = spread_lanes(1.0)
    v = (one * v[0], one * v[1], one * v[2])
    for joint in range(k + 3, 6):
        v = undo_joint_motion(lines, joint, v, lanes, False)
    v = rotate_vector(load_goal(lanes), v)
    for joint in range(k):
        v = undo_joint_motion(lines, joint, v, lanes, False)
    return v


@routine
def compute_inner_point(lines, k, lanes, v):
    """Return the point to which the inner joints have to move v."""
    one = spread_lanes(1.0)
    v = (one * v[0], one * v[1], one * v[2])
    for joint in range(k + 3, 6):
        v = undo_joint_motion(lines, joint, v, lanes, True)
    v = transform_point(load_goal(lanes), v)
    for joint in range(k):
        v = undo_joint_motion(lines, joint, v, lanes, True)
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
    """Pointers and numbers that all targets of a call share."""

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
def choose_lane_coordinate(pr, joint, theta, near):
    """Return the coordinate of a joint at the angle `theta`, shifted by whole periods into the
    limits and near to `near`, and whether it is inside.

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
    moved = select_where(over > 0.0, down, select_where(under > 0.0, up, q))
    fits = select_where(
        moved > high + EDGE, 0.0, select_where(low - EDGE > moved, 0.0, spread_lanes(1.0))
    )
    q = select_where(fits > 0.5, moved, q)
    q = select_where(fits > 0.5, select_where(q > high, high, select_where(low > q, low, q)), q)
    return q, fits


@routine
def write_row(pr, at, slot, valid, error):
    """Write one slot of all lanes, from the coordinates in the scratch."""
    place = at * SLOTS * ROW + slot * ROW
    inside = load_lanes(pr.lanes, AT_FITS * LANES)
    for joint in range(1, 6):
        inside = inside * load_lanes(pr.lanes, (AT_FITS + joint) * LANES)
    code = select_where(
        valid > 0.5, MULTIPLICITY_UNIT + SLOT_UNIT * (slot + 1) + INSIDE_BIT * inside, UNUSED
    )
    q = load_triple(pr.lanes, AT_COORDINATES)
    last = load_triple(pr.lanes, AT_COORDINATES + 3)
    store_columns(pr.out, place, SLOTS * ROW, q[0], q[1], q[2], last[0])
    store_columns(pr.out, place + 4, SLOTS * ROW, last[1], last[2], error, code)


@device
def load_near_coordinate(pr, at, joint):
    """Read the value that the coordinate of a joint should be near to, for all lanes."""
    if pr.near_step == 0:
        return spread_lanes(pr.near[pr.order[joint]])
    return gather_lanes(pr.near, pr.near_step * at + pr.order[joint], pr.near_step)


@routine
def write_joint_angle(pr, at, joint, c, s):
    """Write cosine and sine of a joint, its coordinate, and whether the coordinate is inside the
    limits.
    """
    write_cos_sin(pr.lanes, joint, c, s)
    q, fits = choose_lane_coordinate(pr, joint, atan2(s, c), load_near_coordinate(pr, at, joint))
    store_value(pr.lanes, (AT_COORDINATES + joint) * LANES, q)
    store_value(pr.lanes, (AT_FITS + joint) * LANES, fits)


@routine
def compute_solution_error(pr, a, b, c, w, dr, dp, r):
    """Compute the error of one solution: how far a probe point and two directions, moved by the
    inner joints, are from where they should be.
    """
    ha, oa = read_joint_line(pr.lines, pr.k)
    hb, ob = read_joint_line(pr.lines, pr.k + 1)
    hc, oc = read_joint_line(pr.lines, pr.k + 2)
    p = add_scaled(oc, 1.0, rotate_about_axis(hc, subtract_vectors(pr.probe, oc), c[0], c[1]))
    p = add_scaled(ob, 1.0, rotate_about_axis(hb, subtract_vectors(p, ob), b[0], b[1]))
    p = add_scaled(oa, 1.0, rotate_about_axis(ha, subtract_vectors(p, oa), a[0], a[1]))
    x = rotate_about_axis(
        ha, rotate_about_axis(hb, rotate_about_axis(hc, r, c[0], c[1]), b[0], b[1]), a[0], a[1]
    )
    y = rotate_about_axis(ha, rotate_about_axis(hb, hc, b[0], b[1]), a[0], a[1])
    p = subtract_vectors(p, dp)
    x = subtract_vectors(x, dr)
    y = subtract_vectors(y, w)
    return compute_square_root(pr.length * pr.length * dot(p, p) + dot(x, x) + dot(y, y))


@routine
def write_inner_solutions(pr, at, slot, valid, clear):
    """Write both solutions of the inner joints for the outer angles in the scratch; return `clear`,
    updated.
    """
    ha, oa = read_joint_line(pr.lines, pr.k)
    hb, ob = read_joint_line(pr.lines, pr.k + 1)
    hc, oc = read_joint_line(pr.lines, pr.k + 2)
    r = find_perpendicular(hc)
    w = compute_inner_direction(pr.lines, pr.k, pr.lanes, hc)
    dr = compute_inner_direction(pr.lines, pr.k, pr.lanes, r)
    dp = compute_inner_point(pr.lines, pr.k, pr.lanes, pr.probe)
    one = spread_lanes(1.0)
    goal = w
    middle, u0, w0 = compute_orbit(hb, subtract_vectors(oc, ob))
    if pr.what == POINT:
        c0, s0, c1, s1, d2 = find_cone_turns(ha, hb, hc, w)
        sa = subtract_vectors(ha, add_scaled((0.0, 0.0, 0.0), dot(ha, hb), hb))
        sb = subtract_vectors(hc, add_scaled((0.0, 0.0, 0.0), dot(hc, hb), hb))
        size = one * (dot(sa, sa) * dot(sb, sb))
    else:
        q = subtract_vectors(compute_inner_point(pr.lines, pr.k, pr.lanes, oc), oa)
        goal = subtract_vectors(q, add_scaled((0.0, 0.0, 0.0), dot(hc, q), hc))
        fixed = subtract_vectors(add_scaled(middle, 1.0, ob), oa)
        fixed = subtract_vectors(fixed, add_scaled((0.0, 0.0, 0.0), dot(hc, fixed), hc))
        x = 2.0 * dot(fixed, u0)
        y = 2.0 * dot(fixed, w0)
        rho2 = dot(goal, goal)
        d2 = compute_triangle_discriminant(
            compute_square_root(dot(fixed, fixed)), compute_square_root(dot(u0, u0)), rho2
        )
        c0, s0, c1, s1, d2 = find_precise_trig_roots(
            one * x, one * y, rho2 - dot(fixed, fixed) - dot(u0, u0), d2
        )
        size = one * (x * x + y * y)
        middle = fixed
    there = select_where(d2 > 0.0, one, 0.0)
    clear = clear * select_where(valid > 0.5, mark_clear_roots(d2, size), 1.0)
    valid = valid * there
    for i in range(2):
        c = c0
        s = s0
        if i == 1:
            c = c1
            s = s1
        u = rotate_about_axis(hb, (one * hc[0], one * hc[1], one * hc[2]), c, s)
        if pr.what == PLANE:
            u = add_scaled(
                add_scaled((one * middle[0], one * middle[1], one * middle[2]), c, u0), s, w0
            )
        ca, sa_, size_a = find_aligning_turn(ha, u, goal)
        back = rotate_about_axis(hb, rotate_about_axis(ha, dr, ca, -sa_), c, -s)
        cc, sc, _ = find_aligning_turn(hc, r, back)
        write_joint_angle(pr, at, pr.k, ca, sa_)
        write_joint_angle(pr, at, pr.k + 1, c, s)
        write_joint_angle(pr, at, pr.k + 2, cc, sc)
        error = compute_solution_error(pr, (ca, sa_), (c, s), (cc, sc), w, dr, dp, r)
        fine = select_where(ROUNDING > error, select_where(size_a > FAR * FAR, one, 0.0), 0.0)
        clear = clear * select_where(valid > 0.5, fine, 1.0)
        write_row(pr, at, slot + i, valid, error)
    return clear


@routine
def write_second_solutions(pr, at, slot, c, s, valid, clear):
    """Write the four solutions that belong to one angle of the first joint; return `clear`,
    updated.
    """
    first, second = (X_SIDE, Z_SIDE) if pr.mode == X_FIRST else (Z_SIDE, X_SIDE)
    x = (pr.k + 3) % 6
    y = (pr.k + 4) % 6
    z = (pr.k + 5) % 6
    hy = read_vector(pr.lines, LINE_STRIDE * y)
    lanes = pr.lanes
    v = find_orbit_point(lanes, first, c, s)
    j = 1 - pr.measure
    known = dot(hy, v)
    if j == 1:
        t = compute_side_term(lanes, first, hy, 1)
        known = t[0] + t[1] * c + t[2] * s
    sign = 1.0 if pr.mode == X_FIRST else -1.0
    c0, s0, c1, s1, there, plain = find_side_angles(lanes, second, sign, hy, pr.what, j, known, v)
    clear = clear * select_where(valid > 0.5, plain, 1.0)
    valid = valid * there
    for i in range(2):
        c2 = c0
        s2 = s0
        if i == 1:
            c2 = c1
            s2 = s1
        other = find_orbit_point(lanes, second, c2, s2)
        if pr.mode == X_FIRST:
            cy, sy, size = find_aligning_turn(hy, other, v)
            write_joint_angle(pr, at, x, c, s)
            write_joint_angle(pr, at, z, c2, s2)
        else:
            cy, sy, size = find_aligning_turn(hy, v, other)
            write_joint_angle(pr, at, z, c, s)
            write_joint_angle(pr, at, x, c2, s2)
        write_joint_angle(pr, at, y, cy, sy)
        clear = clear * select_where(
            valid > 0.5, select_where(size > FAR * FAR, 1.0, spread_lanes(0.0)), 1.0
        )
        clear = write_inner_solutions(pr, at, slot + 2 * i, valid, clear)
    return clear


@routine
def solve_target_block(pr, at):
    """Write all slots of the targets from `at` on; return 1 in lanes whose target had no special
    case, else 0.
    """
    first, second = (X_SIDE, Z_SIDE) if pr.mode == X_FIRST else (Z_SIDE, X_SIDE)
    hy = read_vector(pr.lines, LINE_STRIDE * ((pr.k + 4) % 6))
    lanes = pr.lanes
    write_sides(pr.lines, pr.k, pr.what, pr.n, pr.p, pr.oy, lanes)
    known = compute_side_term(lanes, second, hy, pr.measure)[0]
    w = add_scaled(load_triple(lanes, second + M), 1.0, load_triple(lanes, second + U))
    sign = -1.0 if pr.mode == X_FIRST else 1.0
    c0, s0, c1, s1, valid, clear = find_side_angles(
        lanes, first, sign, hy, pr.what, pr.measure, known, w
    )
    clear = write_second_solutions(pr, at, 0, c0, s0, valid, clear)
    return write_second_solutions(pr, at, 4, c1, s1, valid, clear)


ROTATION_TOLERANCE = 1e-6
"""Largest entry of R^T R - 1 that a target's rotation may have."""

AT_LINES = 12
AT_JOINTS = AT_LINES + 6 * LINE_STRIDE
AT_SHIFT = AT_JOINTS + 6 * JOINT_FLOATS
SIX = AT_SHIFT + 13
"""Places in the numbers of the six unknowns: the tip's pose, lines, joints, a motion and an angle;
how many."""


@routine
def read_targets(targets, at, floats, tip, lanes):
    """Write the goals G = T M^-1 of the targets T; return 1 in lanes whose target is a valid pose,
    else 0.
    """
    r = (
        gather_lanes(targets, at, 16),
        gather_lanes(targets, at + 1, 16),
        gather_lanes(targets, at + 2, 16),
        gather_lanes(targets, at + 4, 16),
        gather_lanes(targets, at + 5, 16),
        gather_lanes(targets, at + 6, 16),
        gather_lanes(targets, at + 8, 16),
        gather_lanes(targets, at + 9, 16),
        gather_lanes(targets, at + 10, 16),
    )
    p = (
        gather_lanes(targets, at + 3, 16),
        gather_lanes(targets, at + 7, 16),
        gather_lanes(targets, at + 11, 16),
    )
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
    off = off + abs(gather_lanes(targets, at + 12, 16)) + abs(gather_lanes(targets, at + 13, 16))
    off = (
        off
        + abs(gather_lanes(targets, at + 14, 16))
        + abs(gather_lanes(targets, at + 15, 16) - 1.0)
    )
    for i in range(3):
        row = (r[3 * i], r[3 * i + 1], r[3 * i + 2])
        a = dot(row, read_vector(tip, 0))
        b = dot(row, read_vector(tip, 4))
        c = dot(row, read_vector(tip, 8))
        store_value(lanes, (GOAL + 4 * i) * LANES, a)
        store_value(lanes, (GOAL + 4 * i + 1) * LANES, b)
        store_value(lanes, (GOAL + 4 * i + 2) * LANES, c)
        t = read_translation(tip)
        store_value(lanes, (GOAL + 4 * i + 3) * LANES, p[i] - (a * t[0] + b * t[1] + c * t[2]))
    return select_where(ROTATION_TOLERANCE > off, 1.0, spread_lanes(0.0))


@routine
def reduce_to_six(ints, floats, moves, locked, six):
    """Write the tip's pose, lines and joints of the six unknowns to `six` (SIX numbers), moved by
    the locked joints.
    """
    n = ints[N_JOINTS]
    order = advance_pointer(ints, ORDER)
    shift = advance_pointer(six, AT_SHIFT)
    theta = advance_pointer(six, AT_SHIFT + 12)
    joints = advance_pointer(floats, LINES + LINE_STRIDE * ints[N_LINES])
    write_identity(shift)
    for i in range(n):
        at = JOINT_FLOATS * i
        k = 0
        theta[0] = joints[at + FACTOR] * locked[i] + joints[at + OFFSET]
        h = read_vector(floats, LINES + LINE_STRIDE * i)
        o = read_vector(floats, LINES + LINE_STRIDE * i + 4)
        if moves[i] == 0:
            slides = ints[PLAN_HEADER + i] == SLIDE
            append_motion(shift, h, o, slides, theta[0], math.cos(theta[0]), math.sin(theta[0]))
            continue
        while order[k] != i:
            k += 1
        write_vector(six, AT_LINES + LINE_STRIDE * k, rotate_vector(shift, h))
        write_vector(six, AT_LINES + LINE_STRIDE * k + 4, transform_point(shift, o))
        for j in range(JOINT_FLOATS):
            six[AT_JOINTS + JOINT_FLOATS * k + j] = joints[at + j]
    tip = advance_pointer(floats, TIP)
    for j in range(3):
        column = rotate_vector(shift, (tip[j], tip[4 + j], tip[8 + j]))
        six[j] = column[0]
        six[4 + j] = column[1]
        six[8 + j] = column[2]
    p = transform_point(shift, read_translation(tip))
    six[3] = p[0]
    six[7] = p[1]
    six[11] = p[2]


@device
def make_block_problem(ints, floats, six, lanes, out, near, near_step):
    """Collect the pointers and numbers that the targets of a call share."""
    lines = advance_pointer(six, AT_LINES)
    k = ints[INNER]
    what = ints[WHAT]
    x = (k + 3) % 6
    y = (k + 4) % 6
    z = (k + 5) % 6
    hy, oy = read_joint_line(lines, y)
    other = z if ints[OPTION] == 0 else x
    oy = find_foot_point(
        oy, hy, read_vector(lines, LINE_STRIDE * other + 4), read_vector(lines, LINE_STRIDE * other)
    )
    normal = read_vector(lines, LINE_STRIDE * k)
    p = find_ball_centre(lines, k) if what == POINT else read_vector(lines, LINE_STRIDE * k + 4)
    return SharedTargets(
        lines,
        advance_pointer(six, AT_JOINTS),
        lanes,
        out,
        near,
        near_step,
        advance_pointer(ints, ORDER),
        k,
        what,
        ints[MODE],
        ints[MEASURE],
        oy,
        p,
        normal,
        read_translation(six),
        floats[LENGTH],
    )


@routine
def spread_rows(answers, n, order, moves, locked, count, out):
    """Write answers of six unknowns as answers of n joints, with the values of the locked joints."""
    width = n + INFO
    for i in range(count * SLOTS):
        row = advance_pointer(out, width * i)
        from_ = advance_pointer(answers, ROW * i)
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
def find_plain_solutions(ints, floats, targets, near, locked, sort, out, left):
    """Find the solutions of all targets without special cases; return how many are left, whose
    numbers are written to `left` (N,).

    ints, floats: plan, see `analytic_layout`, of six unknown turning joints with an equation in one
    unknown. targets: (N, 4, 4). near: (1 or N, n), at least LANES rows if not one and locked is
    one. locked: (1 or N, n), of which the locked joints count. sort: 1 for rows in order; if none
    are left, -1 less the rows in use of the last target is returned. out: (N, SLOTS, n + INFO).
    """
    scratch = np.empty(ROWS * LANES + (16 + SLOTS * ROW) * LANES + SIX)
    n_targets = targets.shape[0]
    n = ints[N_JOINTS]
    lanes = get_pointer(scratch)
    goals = advance_pointer(lanes, ROWS * LANES)
    answers = advance_pointer(lanes, (ROWS + 16) * LANES)
    six = advance_pointer(answers, SLOTS * ROW * LANES)
    moves = advance_pointer(get_pointer(ints), PLAN_HEADER + ints[N_LINES])
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
        wanted = advance_pointer(get_pointer(targets), 16 * first)
        rows = advance_pointer(get_pointer(out), width * first)
        held = advance_pointer(get_pointer(locked), n * first if apart else 0)
        reduce_to_six(get_pointer(ints), get_pointer(floats), moves, held, six)
        if few:  # the lanes are filled up with the last target
            for i in range(LANES):
                for j in range(16):
                    goals[16 * i + j] = wanted[16 * min(i, group - 1) + j]
        for i in range(0, group, LANES):
            at = 0 if few else min(i, group - LANES)
            pr = make_block_problem(
                get_pointer(ints),
                get_pointer(floats),
                six,
                lanes,
                advance_pointer(rows, width * at) if direct else answers,
                advance_pointer(get_pointer(near), step * (first + at)),
                next_,
            )
            sound = read_targets(
                goals if few else advance_pointer(wanted, 16 * at),
                0,
                get_pointer(floats),
                six,
                lanes,
            )
            clear = sound * solve_target_block(pr, 0)
            if not direct:
                spread_rows(
                    answers,
                    n,
                    pr.order,
                    moves,
                    held,
                    min(LANES, group),
                    advance_pointer(rows, width * at),
                )
            for lane in range(i - at, min(LANES, group - at)):
                if not extract_entry(clear, lane) > 0.5:
                    left[count] = first + at + lane
                    count += 1
    if sort != 0:
        joints = advance_pointer(get_pointer(floats), LINES + LINE_STRIDE * ints[N_LINES])
        for i in range(n_targets):
            used = sort_rows(
                n,
                joints,
                advance_pointer(get_pointer(near), step * i),
                advance_pointer(get_pointer(out), SLOTS * (n + INFO) * i),
                SLOTS,
            )
            if count == 0:
                done = -1 - used
    keep_alive(scratch)
    return count if count > 0 else done
