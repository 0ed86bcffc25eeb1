"""The rows of a primitive table: elementary motions on 3x4 matrices, and the poses of all rows of a
configuration.

A 3x4 matrix is held as its three rows, vectors of four columns. Nothing here is an entry point, so
that whoever needs these motions does not compile the forward model with them.
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.trig import REACH, sincos, sincos_any
from kempe.kernels.base.vectors import (
    LANES,
    all_between,
    entry,
    last_of,
    load4,
    load_lanes,
    pack4,
    rarely,
    store,
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
def rotation(w, x, y, z):
    """The nine entries, row by row, of the rotation by a unit quaternion; of floats or vectors."""
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
def unit_quaternion(q, k, multiplier):
    """The unit quaternion at q[k : k + 4], conjugated for a reversed joint; NaN for norms below
    1e-307.
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
def placed(floats, k, a, b, c):
    """The rows of X @ [a; b; c; 0 0 0 1], X the 3x4 placement at floats[k:]."""
    x = load4(floats, k)
    y = load4(floats, k + 4)
    z = load4(floats, k + 8)
    return (
        entry(x, 0) * a + (entry(x, 1) * b + (entry(x, 2) * c + last_of(x))),
        entry(y, 0) * a + (entry(y, 1) * b + (entry(y, 2) * c + last_of(y))),
        entry(z, 0) * a + (entry(z, 1) * b + (entry(z, 2) * c + last_of(z))),
    )


@device
def with_offset(floats, k, s, c):
    """Sine and cosine of the turn of the row at floats[k:], the offset added."""
    cos_offset = floats[k + COS_OFFSET]
    sin_offset = floats[k + SIN_OFFSET]
    return s * cos_offset + c * sin_offset, c * cos_offset - s * sin_offset


@device
def turned(s, c, a, b):
    """The first two rows of Rz @ [a; b; ...]."""
    return c * a - s * b, s * a + c * b


@device
def slid(theta, c):
    """The third row of Tz @ [...; c; 0 0 0 1]; all NaN if theta is not finite."""
    bad = theta - theta
    return c + pack4(bad, bad, bad, theta + bad)


@device
def balled(w, x, y, z, a, b, c):
    """The rows of R(quaternion) @ [a; b; c]."""
    r = rotation(w, x, y, z)
    return (
        r[0] * a + r[1] * b + r[2] * c,
        r[3] * a + r[4] * b + r[5] * c,
        r[6] * a + r[7] * b + r[8] * c,
    )


@device
def placement(floats, k):
    """The rows of the 3x4 placement at floats[k:]."""
    return load4(floats, k), load4(floats, k + 4), load4(floats, k + 8)


@device
def times_turn(row, s, c):
    """The row `row` of [...] @ Rz; all NaN if s is."""
    bad = s - s
    return row * pack4(c, c, 1.0 + bad, 1.0 + bad) + swapped(row) * pack4(s, -s, bad, bad)


@device
def times_slide(row, theta):
    """The row `row` of [...] @ Tz; all NaN if theta is not finite."""
    bad = theta - theta
    return row + entry(row, 2) * pack4(bad, bad, bad, theta + bad)


@device
def scratch_size(n_rows):
    """Numbers in the scratch block of `descend`: angles, sines, cosines (padded to full vectors),
    poses.
    """
    return 3 * (n_rows + LANES) + OUTPUT_FLOATS * n_rows


@device
def poses_at(n_rows):
    """Where the poses of the rows begin in the scratch block of `descend`."""
    return 3 * ((n_rows + LANES - 1) // LANES * LANES)


@routine
def row_poses(ints, floats, q, start, scratch):
    """Write the poses of all rows at the configuration q[start:] to scratch[poses_at(n_rows):]."""
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
        store(scratch, sine + row, s)
        store(scratch, cosine + row, c)
        near &= all_between(-REACH, theta, REACH)
    if rarely(not near):
        for row in range(n_rows):
            scratch[sine + row], scratch[cosine + row] = sincos_any(scratch[row])
    for row in range(n_rows):
        k = HEADER + ROW_INTS * row
        kx = ROW_FLOATS * row
        kind = ints[k + KIND]
        parent = ints[k + PARENT]
        a, b, c = placement(floats, kx)
        if kind == TURN:
            s, co = with_offset(floats, kx, scratch[sine + row], scratch[cosine + row])
            a = times_turn(a, s, co)
            b = times_turn(b, s, co)
            c = times_turn(c, s, co)
        elif kind == SLIDE:
            theta = scratch[row]
            a = times_slide(a, theta)
            b = times_slide(b, theta)
            c = times_slide(c, theta)
        else:
            w, x, y, z = unit_quaternion(q, start + ints[k + Q_INDEX], floats[kx + MULTIPLIER])
            a = pack4(1.0, 0.0, 0.0, 0.0)
            b = pack4(0.0, 1.0, 0.0, 0.0)
            c = pack4(0.0, 0.0, 1.0, 0.0)
            a, b, c = balled(w, x, y, z, a, b, c)
            a, b, c = placed(floats, kx, a, b, c)
        if parent >= 0:
            a, b, c = placed(scratch, poses + OUTPUT_FLOATS * parent, a, b, c)
        k = poses + OUTPUT_FLOATS * row
        store(scratch, k, a)
        store(scratch, k + 4, b)
        store(scratch, k + 8, c)
