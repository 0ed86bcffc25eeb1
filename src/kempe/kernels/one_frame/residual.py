"""The error of one configuration: how far the tip of a chain is from its goal, and the Jacobian of
the error.

The error is e = W [p* - p; log(R* R^T)] in ground axes. The geometric Jacobian then gives the exact
gradient of E = |e|^2 / 2: dE/dv = -(W J)^T e, for the logarithm's own Jacobian leaves the logarithm
alone (Bullo and Murray 1995). Where only the direction of the tip's z axis counts, the rotation
error is the shortest one that corrects it, and J lacks what turns about that axis. W holds 0 or 1
for each row of the task, divided by the chain's length L in the linear rows, so that lengths weigh
against angles whatever the unit. For the same reason slides move in multiples of L: column i of the
Jacobian belongs to v[i] / scale[i].
"""

from __future__ import annotations

import math
from typing import NamedTuple

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.lines import add_scaled, cross, dot
from kempe.kernels.base.rotations import compute_rotation_vector
from kempe.kernels.base.trig import atan2, compute_sincos
from kempe.kernels.base.vectors import (
    compute_square_root,
    extract_entry,
    pack_four,
    select_where,
    store_value,
)
from kempe.kernels.forward.table_layout import (
    BALL,
    COS_OFFSET,
    HEADER,
    KIND,
    MULTIPLIER,
    N_ROWS,
    Q_INDEX,
    ROW_FLOATS,
    ROW_INTS,
    SIN_OFFSET,
    TURN,
)

AXIS = 0
POINT = 4
FACTOR = 8
AXES_STRIDE = 9
"""A column, in `Chain.axes`: its axis times FACTOR, a point on it, FACTOR (multiplier times
scale)."""

OWNER = 0
TURNS = 1
COLUMN_INTS = 2
"""A column, in `Chain.notes`: its velocity coordinate; 1 if it turns, 0 if it slides."""

PLACE = 0
ROUND = 1
PLACE_INTS = 2
"""A velocity coordinate, in `Chain.notes` after the columns: index in q (-1 if unread); 1 if of a
ball."""

LOW = 0
HIGH = 1
SCALE = 2
BOX_STRIDE = 4
"""A velocity coordinate, in `Chain.box`: the limits that the solver keeps, and its unit."""

FREE = 6
STEP = 7
JACOBIAN_STRIDE = 8
"""A velocity coordinate, in `Chain.jacobian`: six rows of its column, whether it may move, the
step."""

WEIGHTS = 12
POINTS = 18
GOAL_SIZE = 19
"""Places in `Chain.goal`, after the 3x4 pose: six weights; 1 if of rotations only the direction of
z counts."""


class ChainScratch(NamedTuple):
    """A chain's table with the scratch of its solver; all fields but the numbers are pointers."""

    ints: object
    floats: object
    notes: object
    axes: object
    box: object
    jacobian: object
    q: object
    goal: object
    columns: int
    nq: int
    nv: int
    length: float


@device
def combine_three(x, a, y, b, z, c):
    """Return x a + y b + z c for three numbers x, y, z and three 3-vectors a, b, c."""
    return x * a + (y * b + z * c)


@device
def compute_ball_rotation(q, k, multiplier):
    """Return the rotation (9 numbers, row by row) by the quaternion wxyz at q[k : k + 4], which is
    normalised.

    Its inverse for a reversed joint, which a negative multiplier marks.
    """
    w = q[k]
    x = q[k + 1]
    y = q[k + 2]
    z = q[k + 3]
    s = 2.0 / (w * w + x * x + y * y + z * z)
    if multiplier < 0.0:
        w = -w
    return (
        1.0 - s * (y * y + z * z),
        s * (x * y - w * z),
        s * (x * z + w * y),
        s * (x * y + w * z),
        1.0 - s * (x * x + z * z),
        s * (y * z - w * x),
        s * (x * z - w * y),
        s * (y * z + w * x),
        1.0 - s * (x * x + y * y),
    )


@device
def write_axis(axes, column, axis, point):
    """Write one column's axis and point."""
    store_value(axes, AXES_STRIDE * column + AXIS, axis)
    store_value(axes, AXES_STRIDE * column + POINT, point)


@device
def append_placement(f, k, a, b, c, p):
    """Return the columns of [a b c p] X, X the 3x4 placement at f[k:]."""
    return (
        combine_three(f[k], a, f[k + 4], b, f[k + 8], c),
        combine_three(f[k + 1], a, f[k + 5], b, f[k + 9], c),
        combine_three(f[k + 2], a, f[k + 6], b, f[k + 10], c),
        combine_three(f[k + 3], a, f[k + 7], b, f[k + 11], c) + p,
    )


@routine
def trace_chain(chain):
    """Return the pose of the tip at q, three columns of its rotation and its position; write axes
    and points.
    """
    n = chain.ints[N_ROWS]
    floats = chain.floats
    axes = chain.axes
    a = pack_four(1.0, 0.0, 0.0, 0.0)
    b = pack_four(0.0, 1.0, 0.0, 0.0)
    c = pack_four(0.0, 0.0, 1.0, 0.0)
    p = pack_four(0.0, 0.0, 0.0, 0.0)
    column = 0
    for row in range(n):
        k = HEADER + ROW_INTS * row
        f = ROW_FLOATS * row
        kind = chain.ints[k + KIND]
        index = chain.ints[k + Q_INDEX]
        m = floats[f + MULTIPLIER]
        a, b, c, p = append_placement(floats, f, a, b, c, p)
        if kind == BALL:
            r = compute_ball_rotation(chain.q, index, m)
            x = combine_three(r[0], a, r[3], b, r[6], c)
            y = combine_three(r[1], a, r[4], b, r[7], c)
            z = combine_three(r[2], a, r[5], b, r[8], c)
            # the axes of a reversed ball are those before its motion, reversed
            write_axis(axes, column, x if m > 0.0 else -a, p)
            write_axis(axes, column + 1, y if m > 0.0 else -b, p)
            write_axis(axes, column + 2, z if m > 0.0 else -c, p)
            a = x
            b = y
            c = z
            column += 3
            continue
        write_axis(axes, column, axes[AXES_STRIDE * column + FACTOR] * c, p)
        column += 1
        theta = m * chain.q[index]
        if kind == TURN:
            s, t = compute_sincos(theta)
            s, t = (
                s * floats[f + COS_OFFSET] + t * floats[f + SIN_OFFSET],
                t * floats[f + COS_OFFSET] - s * floats[f + SIN_OFFSET],
            )
            a, b = t * a + s * b, t * b - s * a
        else:
            p = p + theta * c
    return append_placement(floats, ROW_FLOATS * n, a, b, c, p)


@device
def compute_pointing_error(a, c, goal):
    """Return the shortest rotation vector that turns direction c to the goal's, about a where they
    are opposite.

    For floats and vectors alike.
    """
    n = cross(c, goal)
    cosine = dot(c, goal)
    sine = compute_square_root(dot(n, n))
    vague = 1e-12 > sine
    factor = select_where(vague, 1.0, atan2(sine, cosine) / select_where(vague, 1.0, sine))
    opposite = select_where(vague, select_where(0.0 > cosine, math.pi, 0.0), 0.0)
    return add_scaled((factor * n[0], factor * n[1], factor * n[2]), opposite, a)


@device
def take_first_three(v):
    """Return the first three entries of a vector."""
    return extract_entry(v, 0), extract_entry(v, 1), extract_entry(v, 2)


@device
def compute_turn_error(g, a, b, c):
    """Return the rotation vector from the tip's rotation, by columns, to the goal's; of z alone
    where only its direction counts.
    """
    if g[POINTS] != 0.0:
        return compute_pointing_error(take_first_three(a), take_first_three(c), (g[2], g[6], g[10]))
    x = combine_three(g[0], a, g[1], b, g[2], c)
    y = combine_three(g[4], a, g[5], b, g[6], c)
    z = combine_three(g[8], a, g[9], b, g[10], c)
    return compute_rotation_vector(
        (
            extract_entry(x, 0),
            extract_entry(x, 1),
            extract_entry(x, 2),
            extract_entry(y, 0),
            extract_entry(y, 1),
            extract_entry(y, 2),
            extract_entry(z, 0),
            extract_entry(z, 1),
            extract_entry(z, 2),
        )
    )


@device
def compute_error(goal, tip):
    """Return the six weighted errors [linear; angular] of a tip pose from `trace_chain`."""
    g = goal
    w = WEIGHTS
    a, b, c, p = tip
    turn = compute_turn_error(g, a, b, c)
    return (
        g[w] * (g[3] - extract_entry(p, 0)),
        g[w + 1] * (g[7] - extract_entry(p, 1)),
        g[w + 2] * (g[11] - extract_entry(p, 2)),
        g[w + 3] * turn[0],
        g[w + 4] * turn[1],
        g[w + 5] * turn[2],
    )


@device
def compute_energy(e):
    """Return half the square of the weighted error."""
    return 0.5 * (e[0] * e[0] + e[1] * e[1] + e[2] * e[2] + e[3] * e[3] + e[4] * e[4] + e[5] * e[5])


@device
def compute_distances(chain, e):
    """Return the linear and angular part of the weighted error, in units of length and radians."""
    linear = chain.length * math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
    return linear, math.sqrt(e[3] * e[3] + e[4] * e[4] + e[5] * e[5])


@device
def compute_column(chain, number, tip):
    """Return the axis of a column, the velocity that it gives the tip, and whether it turns."""
    k = AXES_STRIDE * number
    a = chain.axes
    p = tip[3]
    x = a[k]
    y = a[k + 1]
    z = a[k + 2]
    if chain.notes[COLUMN_INTS * number + TURNS] == 0:
        return (x, y, z), (x, y, z), False
    u = extract_entry(p, 0) - a[k + POINT]
    v = extract_entry(p, 1) - a[k + POINT + 1]
    w = extract_entry(p, 2) - a[k + POINT + 2]
    return (x, y, z), (y * w - z * v, z * u - x * w, x * v - y * u), True


@device
def fill_jacobian(chain, tip):
    """Write the weighted Jacobian at the configuration traced last; shared coordinates add up."""
    jacobian = chain.jacobian
    g = chain.goal
    for v in range(chain.nv):
        for i in range(6):
            jacobian[JACOBIAN_STRIDE * v + i] = 0.0
    for number in range(chain.columns):
        k = JACOBIAN_STRIDE * chain.notes[COLUMN_INTS * number + OWNER]
        axis, velocity, turns = compute_column(chain, number, tip)
        for i in range(3):
            jacobian[k + i] += g[WEIGHTS + i] * velocity[i]
        if turns:
            if g[POINTS] != 0.0:
                c = take_first_three(tip[2])
                axis = add_scaled(axis, -dot(c, axis), c)
            for i in range(3):
                jacobian[k + 3 + i] += g[WEIGHTS + 3 + i] * axis[i]


@device
def multiply_column(jacobian, v, e):
    """Return the product of column v of the Jacobian with six numbers."""
    k = JACOBIAN_STRIDE * v
    return (
        (jacobian[k] * e[0] + jacobian[k + 1] * e[1])
        + (jacobian[k + 2] * e[2] + jacobian[k + 3] * e[3])
        + (jacobian[k + 4] * e[4] + jacobian[k + 5] * e[5])
    )
