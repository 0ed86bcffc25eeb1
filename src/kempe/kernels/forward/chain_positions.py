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
    are_all_between,
    compute_square_root,
    gather_lanes,
    spread_lanes,
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
from kempe.kernels.forward.table_rows import add_offset, make_rotation

SMALLEST_SQUARE = 1e-200
LARGEST_SQUARE = 1e200
"""Squared norms of quaternions that lanes normalise without scaling."""


@device
def compute_row_sincos(floats, k, theta):
    """Return sine and cosine of the turn of the row at floats[k:] by theta plus its offset."""
    s, c = sincos(theta)
    if floats[k + SIN_OFFSET] != 0.0 or floats[k + COS_OFFSET] != 1.0:
        s, c = add_offset(floats, k, s, c)
    return s, c


@device
def read_unit_quaternions(q, index, nq, inverse):
    """Return whether the lanes can be normalised, and the unit quaternions at q[index:], inverted
    for a reversed joint.
    """
    w = gather_lanes(q, index, nq)
    x = gather_lanes(q, index + 1, nq)
    y = gather_lanes(q, index + 2, nq)
    z = gather_lanes(q, index + 3, nq)
    square = w * w + x * x + y * y + z * z
    scale = 1.0 / compute_square_root(square)
    sign = -scale if inverse < 0.0 else scale
    return are_all_between(SMALLEST_SQUARE, square, LARGEST_SQUARE), (
        w * scale,
        x * sign,
        y * sign,
        z * sign,
    )


@device
def read_tip_position(ints, floats):
    """Return the position of the output on the last row."""
    k = ROW_FLOATS * ints[N_ROWS]
    return spread_lanes(floats[k + 3]), spread_lanes(floats[k + 7]), spread_lanes(floats[k + 11])


@device
def move_point_by_number(ints, floats, row, theta, p):
    """Return the point p moved by a row that turns or slides by theta, and by its placement."""
    x, y, z = p
    if ints[HEADER + ROW_INTS * row + KIND] == TURN:
        s, c = compute_row_sincos(floats, ROW_FLOATS * row, theta)
        x, y = c * x - s * y, s * x + c * y
    else:
        z = z + theta
    return place_point(ints, floats, row, x, y, z)


@device
def move_point_by_quaternion(ints, floats, row, unit, p):
    """Return the point p moved by a row that turns by a unit quaternion, and by its placement."""
    r = make_rotation(unit[0], unit[1], unit[2], unit[3])
    (x, y, z) = p
    return place_point(
        ints,
        floats,
        row,
        r[0] * x + (r[1] * y + r[2] * z),
        r[3] * x + (r[4] * y + r[5] * z),
        r[6] * x + (r[7] * y + r[8] * z),
    )


@device
def place_point(ints, floats, row, x, y, z):
    """Return the point (x, y, z) moved by the placement of a row."""
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
def sweep_positions(ints, floats, q, start, nq):
    """Return whether all lanes can be swept, and the positions (x, y, z) at the configurations
    q[start:].
    """
    n_rows = ints[N_ROWS]
    p = read_tip_position(ints, floats)
    near = True
    far = spread_lanes(0.0)
    for i in range(n_rows):
        row = n_rows - 1 - i
        kind = ints[HEADER + ROW_INTS * row + KIND]
        index = start + ints[HEADER + ROW_INTS * row + Q_INDEX]
        multiplier = floats[ROW_FLOATS * row + MULTIPLIER]
        if kind == BALL:
            sound, unit = read_unit_quaternions(q, index, nq, multiplier)
            near &= sound
            p = move_point_by_quaternion(ints, floats, row, unit, p)
        else:
            theta = multiplier * gather_lanes(q, index, nq)
            far = far + abs(theta)
            p = move_point_by_number(ints, floats, row, theta, p)
    return near and are_all_between(0.0, far, REACH), p


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
