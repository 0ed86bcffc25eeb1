"""Positions of the last frame of a chain, `LANES` configurations side by side, from the tip to the
ground.

Three numbers are carried in place of the twelve of a pose, and a variable is used as soon as it is
read: while one point waits for its last turn, the sines of the next row are computed.
"""

from __future__ import annotations

from kempe.kernels.base._jit import device
from kempe.kernels.base.trig import REACH, sincos
from kempe.kernels.base.vectors import (
    LANES,
    all_between,
    gather,
    spread_lanes,
    square_root,
    store_columns,
)
from kempe.kernels.forward.table_layout import (
    BALL,
    COS_OFFSET,
    FORM,
    GENERAL,
    HEADER,
    KIND,
    MULTIPLIER,
    N_ROWS,
    Q_INDEX,
    ROW_FLOATS,
    ROW_INTS,
    RX,
    RX_FLAT,
    SIN_OFFSET,
    TURN,
)
from kempe.kernels.forward.table_rows import rotation, with_offset

SMALLEST_SQUARE = 1e-200
LARGEST_SQUARE = 1e200
"""Squared norms of quaternions that lanes normalise without scaling."""


@device
def sincos_of(floats, k, theta):
    """Sine and cosine of the turn of the row at floats[k:] by theta, the offset added where there
    is one.
    """
    s, c = sincos(theta)
    if floats[k + SIN_OFFSET] != 0.0 or floats[k + COS_OFFSET] != 1.0:
        s, c = with_offset(floats, k, s, c)
    return s, c


@device
def unit_quaternion(q, index, nq, inverse):
    """Whether lanes can be normalised, and the unit quaternion at q[index:], its inverse for a
    negative number.
    """
    w = gather(q, index, nq)
    x = gather(q, index + 1, nq)
    y = gather(q, index + 2, nq)
    z = gather(q, index + 3, nq)
    square = w * w + x * x + y * y + z * z
    scale = 1.0 / square_root(square)
    sign = -scale if inverse < 0.0 else scale
    return all_between(SMALLEST_SQUARE, square, LARGEST_SQUARE), (
        w * scale,
        x * sign,
        y * sign,
        z * sign,
    )


@device
def tip(ints, floats):
    """The position of the output on the last row."""
    k = ROW_FLOATS * ints[N_ROWS]
    return spread_lanes(floats[k + 3]), spread_lanes(floats[k + 7]), spread_lanes(floats[k + 11])


@device
def by_number(ints, floats, row, theta, p):
    """The point p under the motion of a row that turns or slides by theta, and its placement."""
    x, y, z = p
    if ints[HEADER + ROW_INTS * row + KIND] == TURN:
        s, c = sincos_of(floats, ROW_FLOATS * row, theta)
        x, y = c * x - s * y, s * x + c * y
    else:
        z = z + theta
    return placed(ints, floats, row, x, y, z)


@device
def by_quaternion(ints, floats, row, unit, p):
    """The point p under the motion of a row that turns by a unit quaternion, and its placement."""
    r = rotation(unit[0], unit[1], unit[2], unit[3])
    (x, y, z) = p
    return placed(
        ints,
        floats,
        row,
        r[0] * x + (r[1] * y + r[2] * z),
        r[3] * x + (r[4] * y + r[5] * z),
        r[6] * x + (r[7] * y + r[8] * z),
    )


@device
def placed(ints, floats, row, x, y, z):
    """The point (x, y, z) under the placement of a row."""
    form = ints[HEADER + ROW_INTS * row + FORM]
    f = floats
    k = ROW_FLOATS * row
    if row == 0:
        form = GENERAL
    if form == RX_FLAT:
        return x + f[k + 3], y * f[k + 5] + z * f[k + 6], y * f[k + 9] + (z * f[k + 10] + f[k + 11])
    if form == RX:
        return (
            x + f[k + 3],
            y * f[k + 5] + (z * f[k + 6] + f[k + 7]),
            y * f[k + 9] + (z * f[k + 10] + f[k + 11]),
        )
    return (
        x * f[k] + (y * f[k + 1] + (z * f[k + 2] + f[k + 3])),
        x * f[k + 4] + (y * f[k + 5] + (z * f[k + 6] + f[k + 7])),
        x * f[k + 8] + (y * f[k + 9] + (z * f[k + 10] + f[k + 11])),
    )


@device
def position_lanes(ints, floats, q, start, nq):
    """Whether all lanes can be swept, and the position (x, y, z) at the configurations q[start:]."""
    n_rows = ints[N_ROWS]
    p = tip(ints, floats)
    near = True
    far = spread_lanes(0.0)
    for i in range(n_rows):
        row = n_rows - 1 - i
        kind = ints[HEADER + ROW_INTS * row + KIND]
        index = start + ints[HEADER + ROW_INTS * row + Q_INDEX]
        multiplier = floats[ROW_FLOATS * row + MULTIPLIER]
        if kind == BALL:
            sound, unit = unit_quaternion(q, index, nq, multiplier)
            near &= sound
            p = by_quaternion(ints, floats, row, unit, p)
        else:
            theta = multiplier * gather(q, index, nq)
            far = far + abs(theta)
            p = by_number(ints, floats, row, theta, p)
    return near and all_between(0.0, far, REACH), p


@device
def store_points(out, first, count, p, scratch):
    """Write the first `count` of LANES points to out[first:], three numbers each; `scratch` holds 4
    LANES numbers.
    """
    x, y, z = p
    if count > LANES:  # others follow, and write over the one number too many
        store_columns(out, first, 3, x, y, z, z)
        return
    store_columns(scratch, 0, 4, x, y, z, z)
    for lane in range(count):
        for i in range(3):
            out[first + 3 * lane + i] = scratch[4 * lane + i]
