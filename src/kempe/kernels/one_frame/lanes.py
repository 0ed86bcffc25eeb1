"""One step of the inverse kinematics for `LANES` starts side by side: chains of turns and slides.

It is the step of `residual` and `step`, in vectors: one number of all starts is one vector. Lengths
are parts of the chain's length and coordinates multiples of their unit (`residual`), so that no row
of the task needs a weight. A lane sees nothing of its neighbours: what becomes of a start does not
depend on which others run beside it.
"""

from __future__ import annotations

from typing import NamedTuple

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.lines import cross, dot, minus
from kempe.kernels.base.trig import atan2, sincos
from kempe.kernels.base.vectors import LANES, load_lanes, spread_lanes, square_root, store, where
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
from kempe.kernels.one_frame.residual import pointing_error

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
    """Starts side by side. All but numbers are pointers."""

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
def load3(p, k):
    """Three consecutive lanes."""
    return load_lanes(p, k * LANES), load_lanes(p, (k + 1) * LANES), load_lanes(p, (k + 2) * LANES)


@device
def store3(p, k, v):
    """Write three consecutive lanes."""
    store(p, k * LANES, v[0])
    store(p, (k + 1) * LANES, v[1])
    store(p, (k + 2) * LANES, v[2])


@device
def lane_row(row):
    """Place of a row in the lanes."""
    return ROWS + ROW_LANES * row


@device
def lane_coordinate(s, v):
    """Place of a coordinate in the lanes."""
    return ROWS + ROW_LANES * s.rows + COORDINATE_LANES * v


@device
def scaled(x, a):
    """x a for a triple."""
    return x * a[0], x * a[1], x * a[2]


@device
def summed(a, b):
    """a + b for triples."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@device
def combined(x, a, y, b):
    """The vector x a + y b for numbers x, y and vectors a, b of three components."""
    return x * a[0] + y * b[0], x * a[1] + y * b[1], x * a[2] + y * b[2]


@device
def least_of(a, b):
    """The smaller of each lane's two numbers."""
    return where(b > a, a, b)


@device
def greatest_of(a, b):
    """The larger of each lane's two numbers."""
    return where(a > b, a, b)


@device
def placed_lanes(f, k, general, a, b, c, p):
    """The columns of [a b c p] X, X the 3x4 placement at f[k:], a turn about x where it is not
    `general`.
    """
    p = summed(p, summed(scaled(f[k + 3], a), combined(f[k + 7], b, f[k + 11], c)))
    if general:
        x = summed(scaled(f[k], a), combined(f[k + 4], b, f[k + 8], c))
        y = summed(scaled(f[k + 1], a), combined(f[k + 5], b, f[k + 9], c))
        z = summed(scaled(f[k + 2], a), combined(f[k + 6], b, f[k + 10], c))
        return x, y, z, p
    return a, combined(f[k + 5], b, f[k + 9], c), combined(f[k + 10], c, f[k + 6], b), p


@routine
def trace_lanes(s):
    """Pose of the tips, three columns of the rotation and the position; writes axes and points."""
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
        a, b, c, p = placed_lanes(f, at, s.ints[k + FORM] == GENERAL, a, b, c, p)
        factor = f[at + FACTOR]
        store3(lanes, lane_row(row) + AXIS, scaled(factor, c))
        store3(lanes, lane_row(row) + POINT, p)
        theta = (
            factor * load_lanes(lanes, (lane_coordinate(s, s.ints[k + V_INDEX]) + U) * LANES)
            + f[at + OFFSET]
        )
        if s.ints[k + KIND] == TURN:
            sine, cosine = sincos(theta)
            a, b = combined(cosine, a, sine, b), combined(cosine, b, -sine, a)
        else:
            p = summed(p, scaled(theta, c))
    return placed_lanes(f, ROW_FLOATS * s.rows, True, a, b, c, p)


@device
def goal_row(lanes, i):
    """Row i of the goals' rotations."""
    return load3(lanes, GOAL + 4 * i)


@device
def rotation_vector(m):
    """Rotation vector of a 3x3 rotation (9 numbers, row by row), right at all angles.

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
    by_z = zz > greatest_of(xx, yy)
    x = where(by_y, xy, 1.0 + xx)
    y = where(by_y, 1.0 + yy, xy)
    z = where(by_y, yz, xz)
    w = where(by_y, wy, wx)
    x = where(by_z, xz, x)
    y = where(by_z, yz, y)
    z = where(by_z, 1.0 + zz, z)
    w = where(by_z, wz, w)
    by_w = ww > greatest_of(greatest_of(xx, yy), zz)
    x = where(by_w, wx, x)
    y = where(by_w, wy, y)
    z = where(by_w, wz, z)
    w = where(by_w, 1.0 + ww, w)
    size = square_root(x * x + y * y + z * z)
    tiny = 1e-300 > size
    factor = 2.0 * atan2(size, abs(w)) / where(tiny, 1.0, size)
    factor = where(0.0 > w, -factor, factor)
    return factor * x, factor * y, factor * z


@device
def turn_error(lanes, a, b, c):
    """Rotation vector from the tips' rotations to the goals'."""
    g = goal_row(lanes, 0)
    h = goal_row(lanes, 1)
    k = goal_row(lanes, 2)
    return rotation_vector(
        (
            dot(g, (a[0], b[0], c[0])), dot(g, (a[1], b[1], c[1])), dot(g, (a[2], b[2], c[2])),
            dot(h, (a[0], b[0], c[0])), dot(h, (a[1], b[1], c[1])), dot(h, (a[2], b[2], c[2])),
            dot(k, (a[0], b[0], c[0])), dot(k, (a[1], b[1], c[1])), dot(k, (a[2], b[2], c[2])),
        )
    )  # fmt: skip


@device
def error_lanes(s, a, b, c, p):
    """The six errors [linear; angular] of tips; those that the task leaves out are zero."""
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
        turn = turn_error(lanes, a, b, c)
    elif s.task == POINTING:
        goal = (
            load_lanes(lanes, (GOAL + 2) * LANES),
            load_lanes(lanes, (GOAL + 6) * LANES),
            load_lanes(lanes, (GOAL + 10) * LANES),
        )
        turn = pointing_error(a, c, goal)
    if s.task == SOME or s.task == POINTING:
        d = (w[0] * d[0], w[1] * d[1], w[2] * d[2])
        turn = (w[3] * turn[0], w[4] * turn[1], w[5] * turn[2])
    return d[0], d[1], d[2], turn[0], turn[1], turn[2]


@device
def column_lanes(lanes, k):
    """Column of the Jacobian of the coordinate at place k."""
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
def dot6(a, b):
    """The scalar product of six numbers each."""
    return (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3]) + (a[4] * b[4] + a[5] * b[5])


@device
def gathered(m, free, x):
    """The lower triangle m (21 numbers, row by row) plus x x^T in lanes where `free` is 1."""
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
def nothing():
    """21 zeros: the lower triangle of a symmetric 6x6 matrix, from which a sum begins."""
    o = spread_lanes(0.0)
    return o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o


@device
def row_column(lanes, row, slides, p):
    """Column of the Jacobian that a row alone gives, tips at p."""
    axis = load3(lanes, lane_row(row) + AXIS)
    zero = spread_lanes(0.0)
    if slides:
        return axis[0], axis[1], axis[2], zero, zero, zero
    o = load3(lanes, lane_row(row) + POINT)
    v = cross(axis, minus(p, o))
    return v[0], v[1], v[2], axis[0], axis[1], axis[2]


@device
def may_move(u, push, low, high):
    """1 unless the coordinate stands at a limit and `push` points outwards."""
    return where(
        push > 0.0, where(high > u, 1.0, 0.0), where(0.0 > push, where(u > low, 1.0, 0.0), 1.0)
    )


@routine
def fill_lanes(s, e, p):
    """J D J^T (lower triangle) at the configurations traced last; writes the columns and D, who may
    move.
    """
    lanes = s.lanes
    limits = s.limits
    m = nothing()
    for row in range(s.rows):
        k = HEADER + ROW_INTS * row
        v = s.ints[k + V_INDEX]
        at = lane_coordinate(s, v)
        x = row_column(lanes, row, s.ints[k + KIND] == SLIDE, p)
        if s.last[row] > 1:
            y = column_lanes(lanes, at)
            x = (x[0] + y[0], x[1] + y[1], x[2] + y[2], x[3] + y[3], x[4] + y[4], x[5] + y[5])
        store3(lanes, at + COLUMN, (x[0], x[1], x[2]))
        store3(lanes, at + COLUMN + 3, (x[3], x[4], x[5]))
        if s.last[row] % 2 == 1:
            free = may_move(
                load_lanes(lanes, (at + U) * LANES), dot6(x, e), limits[2 * v], limits[2 * v + 1]
            )
            store(lanes, (at + FREE) * LANES, free)
            m = gathered(m, free, x)
    return m


@routine
def refill_lanes(s):
    """J D J^T by the columns and D as they are."""
    m = nothing()
    for v in range(s.nv):
        at = lane_coordinate(s, v)
        m = gathered(m, load_lanes(s.lanes, (at + FREE) * LANES), column_lanes(s.lanes, at))
    return m
