"""How far the tip of a chain is from its goal: the error, and its Jacobian, of one configuration.

The error is e = W [p* - p; log(R* R^T)] in ground axes, the geometric Jacobian then gives the exact gradient of
E = |e|^2 / 2: dE/dv = -J^T W e (the logarithm is its own gradient: Bullo and Murray 1995). W holds 0 or 1 for each
row of the task, divided by the chain's length L in the linear rows, so lengths weigh against angles whatever the unit.
Slides move in multiples of L for the same reason: column i of the Jacobian belongs to v[i] / scale[i].
"""

from __future__ import annotations

import math
from typing import NamedTuple

from kempe.kernels._jit import device, routine
from kempe.kernels.trig import atan2, sincos_any

HEADER, ROW_INTS, ROW_FLOATS = 8, 6, 16
TURN, SLIDE, BALL = 0, 1, 2

AXIS, POINT, FACTOR, AXES_STRIDE = 0, 3, 6, 8
"""A column of the chain, in `Chain.axes`: its axis times FACTOR, a point on it, FACTOR (multiplier times scale)."""

OWNER, TURNS, COLUMN_INTS = 0, 1, 2
"""A column of the chain, in `Chain.notes`: index of its velocity coordinate; 1 if it turns, 0 if it slides."""

PLACE, ROUND, PLACE_INTS = 0, 1, 2
"""A velocity coordinate, in `Chain.notes` after the columns: index in q; 1 if it is one of the three of a ball."""

LOW, HIGH, SCALE, BOX_STRIDE = 0, 1, 2, 4
"""A velocity coordinate, in `Chain.box`: the limits that the solver keeps, and its unit."""

FREE, STEP, JACOBIAN_STRIDE = 6, 7, 8
"""A velocity coordinate, in `Chain.jacobian`: six rows of its column, whether it may move, the step."""

WEIGHTS = 12
"""Where the six weights follow the 3x4 pose in `Chain.goal`."""


class Chain(NamedTuple):
    """A chain's table with the scratch of its solver; everything but the numbers is a pointer."""

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
def product(a, b):
    """The 3x3 matrix a b; matrices are tuples of nine numbers, row by row."""
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
        a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
        a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
        a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
        a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
        a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
        a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
        a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )


@device
def ball_rotation(q, k, multiplier):
    """The rotation by the quaternion wxyz at q[k : k + 4], normalised on reading; its inverse for a reversed joint."""
    w, x, y, z = q[k], q[k + 1], q[k + 2], q[k + 3]
    s = 2.0 / (w * w + x * x + y * y + z * z)
    if multiplier < 0.0:
        w = -w
    return (
        1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y),
        s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x),
        s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y),
    )  # fmt: skip


@device
def write_axis(axes, column, x, y, z, point):
    """Write one column's axis and point."""
    k = AXES_STRIDE * column
    axes[k], axes[k + 1], axes[k + 2] = x, y, z
    axes[k + 3], axes[k + 4], axes[k + 5] = point


@device
def placed(floats, k, r, p):
    """Rotation and position of (r, p) X, X the 3x4 placement at floats[k:]."""
    f = floats
    x, y, z = f[k + 3], f[k + 7], f[k + 11]
    p = (
        p[0] + (r[0] * x + r[1] * y + r[2] * z),
        p[1] + (r[3] * x + r[4] * y + r[5] * z),
        p[2] + (r[6] * x + r[7] * y + r[8] * z),
    )
    x_rotation = (f[k], f[k + 1], f[k + 2], f[k + 4], f[k + 5], f[k + 6], f[k + 8], f[k + 9], f[k + 10])
    return product(r, x_rotation), p


@routine
def trace(chain):
    """Rotation and position of the chain's tip at q; writes axes and points of all columns."""
    n, floats, axes = chain.ints[0], chain.floats, chain.axes
    r = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    p = (0.0, 0.0, 0.0)
    column = 0
    for row in range(n):
        k, f = HEADER + ROW_INTS * row, ROW_FLOATS * row
        kind, index, m = chain.ints[k], chain.ints[k + 2], floats[f + 14]
        r, p = placed(floats, f, r, p)
        if kind == BALL:
            after = product(r, ball_rotation(chain.q, index, m))
            # the axes of a reversed ball are those before its motion, reversed
            b = after if m > 0.0 else (-r[0], -r[1], -r[2], -r[3], -r[4], -r[5], -r[6], -r[7], -r[8])
            write_axis(axes, column, b[0], b[3], b[6], p)
            write_axis(axes, column + 1, b[1], b[4], b[7], p)
            write_axis(axes, column + 2, b[2], b[5], b[8], p)
            r = after
            column += 3
            continue
        factor = axes[AXES_STRIDE * column + FACTOR]
        write_axis(axes, column, factor * r[2], factor * r[5], factor * r[8], p)
        column += 1
        theta = m * chain.q[index]
        if kind == TURN:
            s, c = sincos_any(theta)
            s, c = s * floats[f + 12] + c * floats[f + 13], c * floats[f + 12] - s * floats[f + 13]
            r = (
                c * r[0] + s * r[1], c * r[1] - s * r[0], r[2],
                c * r[3] + s * r[4], c * r[4] - s * r[3], r[5],
                c * r[6] + s * r[7], c * r[7] - s * r[6], r[8],
            )  # fmt: skip
        else:
            p = (p[0] + theta * r[2], p[1] + theta * r[5], p[2] + theta * r[8])
    return placed(floats, ROW_FLOATS * n, r, p)


@device
def logarithm(m):
    """Rotation vector of the 3x3 rotation m, right at all angles from 0 to pi."""
    x, y, z = 0.5 * (m[7] - m[5]), 0.5 * (m[2] - m[6]), 0.5 * (m[3] - m[1])
    cosine = 0.5 * (m[0] + m[4] + m[8] - 1.0)
    square = x * x + y * y + z * z
    if cosine > -0.8:
        if square < 1e-5 and cosine > 0.0:  # the arcsine's series; the next term is below 1e-21
            factor = 1.0 + square * (1.0 / 6.0 + square * (3.0 / 40.0 + square * (15.0 / 336.0)))
        else:
            sine = math.sqrt(square)
            factor = atan2(sine, cosine) / sine
        return x * factor, y * factor, z * factor
    # Near pi the antisymmetric part fades: four times a quaternion, from its largest entry (Shepperd 1978).
    if m[0] >= m[4] and m[0] >= m[8]:
        x, y, z, w = 1.0 + m[0] - m[4] - m[8], m[1] + m[3], m[2] + m[6], m[7] - m[5]
    elif m[4] >= m[8]:
        x, y, z, w = m[1] + m[3], 1.0 - m[0] + m[4] - m[8], m[5] + m[7], m[2] - m[6]
    else:
        x, y, z, w = m[2] + m[6], m[5] + m[7], 1.0 - m[0] - m[4] + m[8], m[3] - m[1]
    size = math.sqrt(x * x + y * y + z * z)
    factor = math.copysign(2.0 * atan2(size, abs(w)) / size, w)
    return x * factor, y * factor, z * factor


@routine
def error(goal, r, p):
    """The six weighted errors [linear; angular] of a tip at (r, p)."""
    g, w = goal, WEIGHTS
    inverse = (r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8])
    wanted = (g[0], g[1], g[2], g[4], g[5], g[6], g[8], g[9], g[10])
    x, y, z = logarithm(product(wanted, inverse))
    return (
        g[w] * (g[3] - p[0]), g[w + 1] * (g[7] - p[1]), g[w + 2] * (g[11] - p[2]),
        g[w + 3] * x, g[w + 4] * y, g[w + 5] * z,
    )  # fmt: skip


@device
def energy(e):
    """Half the square of the weighted error."""
    return 0.5 * (e[0] * e[0] + e[1] * e[1] + e[2] * e[2] + e[3] * e[3] + e[4] * e[4] + e[5] * e[5])


@device
def distances(chain, e):
    """Linear and angular part of the weighted error, in units of length and radians."""
    linear = chain.length * math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
    return linear, math.sqrt(e[3] * e[3] + e[4] * e[4] + e[5] * e[5])


@device
def fill_jacobian(chain, p):
    """Write the weighted Jacobian at the configuration traced last, its tip at p; columns of one coordinate add up."""
    axes, notes, jacobian, w = chain.axes, chain.notes, chain.jacobian, chain.goal
    for v in range(chain.nv):
        for i in range(6):
            jacobian[JACOBIAN_STRIDE * v + i] = 0.0
    for column in range(chain.columns):
        k = AXES_STRIDE * column
        j = JACOBIAN_STRIDE * notes[COLUMN_INTS * column + OWNER]
        x, y, z = axes[k], axes[k + 1], axes[k + 2]
        if notes[COLUMN_INTS * column + TURNS] != 0:
            a, b, c = p[0] - axes[k + 3], p[1] - axes[k + 4], p[2] - axes[k + 5]
            jacobian[j + 3] += w[WEIGHTS + 3] * x
            jacobian[j + 4] += w[WEIGHTS + 4] * y
            jacobian[j + 5] += w[WEIGHTS + 5] * z
            x, y, z = y * c - z * b, z * a - x * c, x * b - y * a
        jacobian[j] += w[WEIGHTS] * x
        jacobian[j + 1] += w[WEIGHTS + 1] * y
        jacobian[j + 2] += w[WEIGHTS + 2] * z


@device
def along(jacobian, v, e):
    """The product of column v of the Jacobian with six numbers."""
    k = JACOBIAN_STRIDE * v
    return (
        (jacobian[k] * e[0] + jacobian[k + 1] * e[1])
        + (jacobian[k + 2] * e[2] + jacobian[k + 3] * e[3])
        + (jacobian[k + 4] * e[4] + jacobian[k + 5] * e[5])
    )
