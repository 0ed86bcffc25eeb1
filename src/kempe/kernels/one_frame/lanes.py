"""One step of the inverse kinematics for `LANES` starts side by side: chains of turns and slides.

It is the step of `residual` and `step`, in vectors: one number of all starts is one vector. Lengths
are parts of the chain's length and coordinates multiples of their unit (`residual`), so that no row
of the task needs a weight. A lane sees nothing of its neighbours: what becomes of a start does not
depend on which others run beside it.
"""

from __future__ import annotations

from typing import NamedTuple

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.lines import cross, dot, subtract_vectors
from kempe.kernels.base.trig import atan2, sincos
from kempe.kernels.base.vectors import (
    LANES,
    compute_square_root,
    load_lanes,
    select_where,
    spread_lanes,
    store_value,
)
from kempe.kernels.forward.table_layout import (
    FORM,
    GENERAL,
    HEADER,
    KIND,
    ROW_FLOATS,
    ROW_INTS,
    SLIDE,
    TURN,
    V_INDEX,
)
from kempe.kernels.one_frame.residual import compute_pointing_error

FACTOR = 12
OFFSET = 13
"""A row of `Lanes.floats`, after its placement: factor and constant of its motion."""

WHOLE = 0
PLACE = 1
POINTING = 2
SOME = 3
"""Tasks: the pose; the position; a direction, with the position or alone; some of the six rows."""

GOAL = 0
BEST = 12
STALL = 13
COUNT = 14
FOUND = 15
ROWS = 16
"""Places in the lanes: goal; least energy, steps that hardly lowered it, steps, 1 if within
tolerance; the rows."""

AXIS = 0
POINT = 3
ROW_LANES = 6
"""A row: its axis times FACTOR (velocities by its coordinate), a point on it."""

U = 0
KEPT = 1
STEP = 2
FREE = 3
COLUMN = 4
COORDINATE_LANES = 10
"""A coordinate: its value, that of the least energy, the step, 1 if it may move, its column of the
Jacobian."""


class Lanes(NamedTuple):
    """Starts side by side; all fields but the numbers are pointers."""

    ints: object
    floats: object
    """The table with lengths in parts of the chain's."""
    limits: object
    """Low and high of each coordinate, in its unit."""
    last: object
    """For each row: 0 if its coordinate has later rows, else 1; 2 added if it has earlier ones."""
    weights: object
    """Six numbers 0 or 1: the rows of the task."""
    lanes: object
    rows: int
    nv: int
    task: int


@device
def load_triple(p, k):
    """Read the three vectors that begin at p[k]."""
    return load_lanes(p, k * LANES), load_lanes(p, (k + 1) * LANES), load_lanes(p, (k + 2) * LANES)


@device
def store_triple(p, k, v):
    """Write three vectors from p[k] on."""
    store_value(p, k * LANES, v[0])
    store_value(p, (k + 1) * LANES, v[1])
    store_value(p, (k + 2) * LANES, v[2])


@device
def locate_lane_row(row):
    """Return the index of a row in the lanes."""
    return ROWS + ROW_LANES * row


@device
def locate_lane_coordinate(s, v):
    """Return the index of a coordinate in the lanes."""
    return ROWS + ROW_LANES * s.rows + COORDINATE_LANES * v


@device
def scale_vector(x, a):
    """Return x a for a number x and a 3-vector a."""
    return x * a[0], x * a[1], x * a[2]


@device
def add_vectors(a, b):
    """Return a + b for two 3-vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@device
def combine_vectors(x, a, y, b):
    """Return x a + y b for numbers x, y and 3-vectors a, b."""
    return x * a[0] + y * b[0], x * a[1] + y * b[1], x * a[2] + y * b[2]


@device
def select_smaller(a, b):
    """Return the smaller of two numbers in each lane."""
    return select_where(b > a, a, b)


@device
def select_greater(a, b):
    """Return the larger of two numbers in each lane."""
    return select_where(a > b, a, b)


@device
def append_lane_placement(f, k, general, a, b, c, p):
    """Return the columns of [a b c p] X, X the 3x4 placement at f[k:], a turn about x where it is
    not `general`.
    """
    p = add_vectors(
        p, add_vectors(scale_vector(f[k + 3], a), combine_vectors(f[k + 7], b, f[k + 11], c))
    )
    if general:
        x = add_vectors(scale_vector(f[k], a), combine_vectors(f[k + 4], b, f[k + 8], c))
        y = add_vectors(scale_vector(f[k + 1], a), combine_vectors(f[k + 5], b, f[k + 9], c))
        z = add_vectors(scale_vector(f[k + 2], a), combine_vectors(f[k + 6], b, f[k + 10], c))
        return x, y, z, p
    return (
        a,
        combine_vectors(f[k + 5], b, f[k + 9], c),
        combine_vectors(f[k + 10], c, f[k + 6], b),
        p,
    )


@routine
def trace_lanes(s):
    """Return the poses of the tips, three columns of the rotation and the position; write axes and
    points.
    """
    f = s.floats
    lanes = s.lanes
    one = spread_lanes(1.0)
    zero = spread_lanes(0.0)
    a = (one, zero, zero)
    b = (zero, one, zero)
    c = (zero, zero, one)
    p = (zero, zero, zero)
    for row in range(s.rows):
        k = HEADER + ROW_INTS * row
        at = ROW_FLOATS * row
        a, b, c, p = append_lane_placement(f, at, s.ints[k + FORM] == GENERAL, a, b, c, p)
        factor = f[at + FACTOR]
        store_triple(lanes, locate_lane_row(row) + AXIS, scale_vector(factor, c))
        store_triple(lanes, locate_lane_row(row) + POINT, p)
        theta = (
            factor * load_lanes(lanes, (locate_lane_coordinate(s, s.ints[k + V_INDEX]) + U) * LANES)
            + f[at + OFFSET]
        )
        if s.ints[k + KIND] == TURN:
            sine, cosine = sincos(theta)
            a, b = combine_vectors(cosine, a, sine, b), combine_vectors(cosine, b, -sine, a)
        else:
            p = add_vectors(p, scale_vector(theta, c))
    return append_lane_placement(f, ROW_FLOATS * s.rows, True, a, b, c, p)


@device
def load_goal_row(lanes, i):
    """Read row i of the goals' rotations."""
    return load_triple(lanes, GOAL + 4 * i)


@device
def compute_rotation_vectors(m):
    """Return the rotation vector of a 3x3 rotation (9 vectors, row by row), accurate at all angles.

    By the quaternion whose largest entry is found first (Shepperd 1978).
    """
    xx = m[0] - m[4] - m[8]
    yy = m[4] - m[0] - m[8]
    zz = m[8] - m[0] - m[4]
    ww = m[0] + m[4] + m[8]
    wx = m[7] - m[5]
    wy = m[2] - m[6]
    wz = m[3] - m[1]
    xy = m[1] + m[3]
    xz = m[2] + m[6]
    yz = m[5] + m[7]
    by_y = yy > xx
    by_z = zz > select_greater(xx, yy)
    x = select_where(by_y, xy, 1.0 + xx)
    y = select_where(by_y, 1.0 + yy, xy)
    z = select_where(by_y, yz, xz)
    w = select_where(by_y, wy, wx)
    x = select_where(by_z, xz, x)
    y = select_where(by_z, yz, y)
    z = select_where(by_z, 1.0 + zz, z)
    w = select_where(by_z, wz, w)
    by_w = ww > select_greater(select_greater(xx, yy), zz)
    x = select_where(by_w, wx, x)
    y = select_where(by_w, wy, y)
    z = select_where(by_w, wz, z)
    w = select_where(by_w, 1.0 + ww, w)
    size = compute_square_root(x * x + y * y + z * z)
    tiny = 1e-300 > size
    factor = 2.0 * atan2(size, abs(w)) / select_where(tiny, 1.0, size)
    factor = select_where(0.0 > w, -factor, factor)
    return factor * x, factor * y, factor * z


@device
def compute_turn_error(lanes, a, b, c):
    """Return the rotation vector from the tips' rotations to the goals'."""
    g = load_goal_row(lanes, 0)
    h = load_goal_row(lanes, 1)
    k = load_goal_row(lanes, 2)
    return compute_rotation_vectors(
        (
            dot(g, (a[0], b[0], c[0])), dot(g, (a[1], b[1], c[1])), dot(g, (a[2], b[2], c[2])),
            dot(h, (a[0], b[0], c[0])), dot(h, (a[1], b[1], c[1])), dot(h, (a[2], b[2], c[2])),
            dot(k, (a[0], b[0], c[0])), dot(k, (a[1], b[1], c[1])), dot(k, (a[2], b[2], c[2])),
        )
    )  # fmt: skip


@device
def compute_lane_errors(s, a, b, c, p):
    """Return the six errors [linear; angular] of the tips; errors that the task leaves out are
    zero.
    """
    lanes = s.lanes
    w = s.weights
    d = (
        load_lanes(lanes, (GOAL + 3) * LANES) - p[0],
        load_lanes(lanes, (GOAL + 7) * LANES) - p[1],
        load_lanes(lanes, (GOAL + 11) * LANES) - p[2],
    )
    zero = spread_lanes(0.0)
    turn = (zero, zero, zero)
    if s.task == WHOLE or s.task == SOME:
        turn = compute_turn_error(lanes, a, b, c)
    elif s.task == POINTING:
        goal = (
            load_lanes(lanes, (GOAL + 2) * LANES),
            load_lanes(lanes, (GOAL + 6) * LANES),
            load_lanes(lanes, (GOAL + 10) * LANES),
        )
        turn = compute_pointing_error(a, c, goal)
    if s.task == SOME or s.task == POINTING:
        d = (w[0] * d[0], w[1] * d[1], w[2] * d[2])
        turn = (w[3] * turn[0], w[4] * turn[1], w[5] * turn[2])
    return d[0], d[1], d[2], turn[0], turn[1], turn[2]


@device
def load_column(lanes, k):
    """Read the column of the Jacobian of the coordinate at place k."""
    k = k + COLUMN
    return (
        load_lanes(lanes, k * LANES),
        load_lanes(lanes, (k + 1) * LANES),
        load_lanes(lanes, (k + 2) * LANES),
        load_lanes(lanes, (k + 3) * LANES),
        load_lanes(lanes, (k + 4) * LANES),
        load_lanes(lanes, (k + 5) * LANES),
    )


@device
def compute_dot_product(a, b):
    """Return the scalar product of two vectors of six numbers."""
    return (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3]) + (a[4] * b[4] + a[5] * b[5])


@device
def add_outer_product(m, free, x):
    """Return the lower triangle m (21 numbers, row by row) plus x x^T in lanes where `free` is 1."""
    f = (free * x[0], free * x[1], free * x[2], free * x[3], free * x[4], free * x[5])
    return (
        m[0] + f[0] * x[0],
        m[1] + f[1] * x[0], m[2] + f[1] * x[1],
        m[3] + f[2] * x[0], m[4] + f[2] * x[1], m[5] + f[2] * x[2],
        m[6] + f[3] * x[0], m[7] + f[3] * x[1], m[8] + f[3] * x[2], m[9] + f[3] * x[3],
        m[10] + f[4] * x[0], m[11] + f[4] * x[1], m[12] + f[4] * x[2], m[13] + f[4] * x[3], m[14] + f[4] * x[4],
        m[15] + f[5] * x[0], m[16] + f[5] * x[1], m[17] + f[5] * x[2], m[18] + f[5] * x[3], m[19] + f[5] * x[4],
        m[20] + f[5] * x[5],
    )  # fmt: skip


@device
def make_zero_triangle():
    """Return 21 zeros, the lower triangle of a symmetric 6x6 matrix."""
    o = spread_lanes(0.0)
    return o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o


@device
def compute_row_column(lanes, row, slides, p):
    """Return the column of the Jacobian for the motion of one row, the tips at p."""
    axis = load_triple(lanes, locate_lane_row(row) + AXIS)
    zero = spread_lanes(0.0)
    if slides:
        return axis[0], axis[1], axis[2], zero, zero, zero
    o = load_triple(lanes, locate_lane_row(row) + POINT)
    v = cross(axis, subtract_vectors(p, o))
    return v[0], v[1], v[2], axis[0], axis[1], axis[2]


@device
def can_move(u, push, low, high):
    """Return 1, or 0 where the coordinate stands at a limit and `push` points outwards."""
    return select_where(
        push > 0.0,
        select_where(high > u, 1.0, 0.0),
        select_where(0.0 > push, select_where(u > low, 1.0, 0.0), 1.0),
    )


@routine
def compute_normal_lanes(s, e, p):
    """Return J D J^T (lower triangle) at the configurations traced last; write the columns of J,
    and D, which marks free coordinates.
    """
    lanes = s.lanes
    limits = s.limits
    m = make_zero_triangle()
    for row in range(s.rows):
        k = HEADER + ROW_INTS * row
        v = s.ints[k + V_INDEX]
        at = locate_lane_coordinate(s, v)
        x = compute_row_column(lanes, row, s.ints[k + KIND] == SLIDE, p)
        if s.last[row] > 1:
            y = load_column(lanes, at)
            x = (x[0] + y[0], x[1] + y[1], x[2] + y[2], x[3] + y[3], x[4] + y[4], x[5] + y[5])
        store_triple(lanes, at + COLUMN, (x[0], x[1], x[2]))
        store_triple(lanes, at + COLUMN + 3, (x[3], x[4], x[5]))
        if s.last[row] % 2 == 1:
            free = can_move(
                load_lanes(lanes, (at + U) * LANES),
                compute_dot_product(x, e),
                limits[2 * v],
                limits[2 * v + 1],
            )
            store_value(lanes, (at + FREE) * LANES, free)
            m = add_outer_product(m, free, x)
    return m


@routine
def recompute_normal_lanes(s):
    """Return J D J^T for the present columns and D."""
    m = make_zero_triangle()
    for v in range(s.nv):
        at = locate_lane_coordinate(s, v)
        m = add_outer_product(m, load_lanes(s.lanes, (at + FREE) * LANES), load_column(s.lanes, at))
    return m
