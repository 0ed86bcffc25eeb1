"""The rows of a primitive table: elementary motions on 3x4 matrices, and the poses of all rows of a
configuration.

A 3x4 matrix is held as its three rows, vectors of four columns. Nothing here is an entry point, so
that whoever needs these motions does not compile the forward model with them.
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.trig import REACH, compute_sincos, sincos
from kempe.kernels.base.vectors import (
    LANES,
    are_all_between,
    expect_false,
    extract_entry,
    last_of,
    load4,
    load_lanes,
    pack_four,
    store_value,
    swapped,
)
from kempe.kernels.forward.table_layout import (
    COS_OFFSET,
    HEADER,
    KIND,
    MULTIPLIER,
    N_ROWS,
    OUTPUT_FLOATS,
    PARENT,
    Q_INDEX,
    ROW_FLOATS,
    ROW_INTS,
    SIN_OFFSET,
    SLIDE,
    TURN,
)


@device
def make_rotation(w, x, y, z):
    """Return the nine entries, row by row, of the rotation by a unit quaternion; of floats or
    vectors.
    """
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )


@device
def read_unit_quaternion(q, k, multiplier):
    """Return the unit quaternion at q[k : k + 4], conjugated for a reversed joint; NaN for norms
    below 1e-307.
    """
    w = q[k]
    x = q[k + 1]
    y = q[k + 2]
    z = q[k + 3]
    size = max(
        max(abs(w), abs(x)), max(abs(y), abs(z))
    )  # scaled, for squares neither overflow nor vanish
    w = w / size
    x = x / size
    y = y / size
    z = z / size
    scale = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    sign = math.copysign(scale, multiplier)
    return w * scale, x * sign, y * sign, z * sign


@device
def prepend_placement(floats, k, a, b, c):
    """Return the rows of X @ [a; b; c; 0 0 0 1], X the 3x4 placement at floats[k:]."""
    x = load4(floats, k)
    y = load4(floats, k + 4)
    z = load4(floats, k + 8)
    return (
        extract_entry(x, 0) * a
        + (extract_entry(x, 1) * b + (extract_entry(x, 2) * c + last_of(x))),
        extract_entry(y, 0) * a
        + (extract_entry(y, 1) * b + (extract_entry(y, 2) * c + last_of(y))),
        extract_entry(z, 0) * a
        + (extract_entry(z, 1) * b + (extract_entry(z, 2) * c + last_of(z))),
    )


@device
def add_offset(floats, k, s, c):
    """Return sine and cosine of the turn of the row at floats[k:], its offset added."""
    cos_offset = floats[k + COS_OFFSET]
    sin_offset = floats[k + SIN_OFFSET]
    return s * cos_offset + c * sin_offset, c * cos_offset - s * sin_offset


@device
def prepend_turn(s, c, a, b):
    """Return the first two rows of Rz @ [a; b; ...]."""
    return c * a - s * b, s * a + c * b


@device
def prepend_slide(theta, c):
    """Return the third row of Tz @ [...; c; 0 0 0 1]; all NaN if theta is not finite."""
    bad = theta - theta
    return c + pack_four(bad, bad, bad, theta + bad)


@device
def prepend_ball(w, x, y, z, a, b, c):
    """Return the rows of R(quaternion) @ [a; b; c]."""
    r = make_rotation(w, x, y, z)
    return (
        r[0] * a + r[1] * b + r[2] * c,
        r[3] * a + r[4] * b + r[5] * c,
        r[6] * a + r[7] * b + r[8] * c,
    )


@device
def read_placement(floats, k):
    """Return the rows of the 3x4 placement at floats[k:]."""
    return load4(floats, k), load4(floats, k + 4), load4(floats, k + 8)


@device
def append_turn(row, s, c):
    """Return the row `row` of a matrix times Rz; all NaN if s is."""
    bad = s - s
    return row * pack_four(c, c, 1.0 + bad, 1.0 + bad) + swapped(row) * pack_four(s, -s, bad, bad)


@device
def append_slide(row, theta):
    """Return the row `row` of a matrix times Tz; all NaN if theta is not finite."""
    bad = theta - theta
    return row + extract_entry(row, 2) * pack_four(bad, bad, bad, theta + bad)


@device
def count_sweep_scratch(n_rows):
    """Return how many floats `descend_tree` needs as scratch: angles, sines, cosines (padded to
    full vectors), poses.
    """
    return 3 * (n_rows + LANES) + OUTPUT_FLOATS * n_rows


@device
def locate_poses(n_rows):
    """Return the index at which the poses of the rows begin in the scratch of `descend_tree`."""
    return 3 * ((n_rows + LANES - 1) // LANES * LANES)


@routine
def write_row_poses(ints, floats, q, start, scratch):
    """Write the poses of all rows at the configuration q[start:] to scratch[locate_poses(n_rows):]."""
    n_rows = ints[N_ROWS]
    sine = (n_rows + LANES - 1) // LANES * LANES
    cosine = 2 * sine
    poses = 3 * sine
    for row in range(n_rows):
        scratch[row] = (
            floats[ROW_FLOATS * row + MULTIPLIER]
            * q[start + ints[HEADER + ROW_INTS * row + Q_INDEX]]
        )
    for row in range(n_rows, sine):
        scratch[row] = 0.0
    near = True
    for row in range(0, n_rows, LANES):
        theta = load_lanes(scratch, row)
        s, c = sincos(theta)
        store_value(scratch, sine + row, s)
        store_value(scratch, cosine + row, c)
        near &= are_all_between(-REACH, theta, REACH)
    if expect_false(not near):
        for row in range(n_rows):
            scratch[sine + row], scratch[cosine + row] = compute_sincos(scratch[row])
    for row in range(n_rows):
        k = HEADER + ROW_INTS * row
        kx = ROW_FLOATS * row
        kind = ints[k + KIND]
        parent = ints[k + PARENT]
        a, b, c = read_placement(floats, kx)
        if kind == TURN:
            s, co = add_offset(floats, kx, scratch[sine + row], scratch[cosine + row])
            a = append_turn(a, s, co)
            b = append_turn(b, s, co)
            c = append_turn(c, s, co)
        elif kind == SLIDE:
            theta = scratch[row]
            a = append_slide(a, theta)
            b = append_slide(b, theta)
            c = append_slide(c, theta)
        else:
            w, x, y, z = read_unit_quaternion(q, start + ints[k + Q_INDEX], floats[kx + MULTIPLIER])
            a = pack_four(1.0, 0.0, 0.0, 0.0)
            b = pack_four(0.0, 1.0, 0.0, 0.0)
            c = pack_four(0.0, 0.0, 1.0, 0.0)
            a, b, c = prepend_ball(w, x, y, z, a, b, c)
            a, b, c = prepend_placement(floats, kx, a, b, c)
        if parent >= 0:
            a, b, c = prepend_placement(scratch, poses + OUTPUT_FLOATS * parent, a, b, c)
        k = poses + OUTPUT_FLOATS * row
        store_value(scratch, k, a)
        store_value(scratch, k + 4, b)
        store_value(scratch, k + 8, c)
