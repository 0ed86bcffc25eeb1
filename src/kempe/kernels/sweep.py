"""Poses and Jacobians from a primitive table (`layout`), one configuration at a time.

A 3x4 matrix is held as its three rows, vectors of four columns. Coordinates that are NaN or infinite, and
quaternions without a norm, give NaN in all that depends on them.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from kempe.kernels._jit import F1, F2, I1, OUT3, OUT4, device, kernel, routine
from kempe.kernels.layout import (
    BODY,
    HEADER,
    OUTPUT_FLOATS,
    OUTPUT_INTS,
    ROW_FLOATS,
    ROW_INTS,
    SLIDE,
    TURN,
    WORLD,
)
from kempe.kernels.trig import REACH, sincos, sincos_any
from kempe.kernels.vectors import (
    LANES,
    all_between,
    entry,
    keep,
    last_of,
    load4,
    load_lanes,
    pack4,
    rarely,
    raw,
    store,
    swapped,
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
    """The unit quaternion at q[k : k + 4], conjugated for a reversed joint; NaN for norms below 1e-307."""
    w, x, y, z = q[k], q[k + 1], q[k + 2], q[k + 3]
    size = max(max(abs(w), abs(x)), max(abs(y), abs(z)))  # scaled, for squares neither overflow nor vanish
    w, x, y, z = w / size, x / size, y / size, z / size
    scale = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    sign = math.copysign(scale, multiplier)
    return w * scale, x * sign, y * sign, z * sign


@device
def placed(floats, k, a, b, c):
    """The rows of X @ [a; b; c; 0 0 0 1], X the 3x4 placement at floats[k:]."""
    x, y, z = load4(floats, k), load4(floats, k + 4), load4(floats, k + 8)
    return (
        entry(x, 0) * a + (entry(x, 1) * b + (entry(x, 2) * c + last_of(x))),
        entry(y, 0) * a + (entry(y, 1) * b + (entry(y, 2) * c + last_of(y))),
        entry(z, 0) * a + (entry(z, 1) * b + (entry(z, 2) * c + last_of(z))),
    )


@device
def gauged(floats, k, s, c):
    """Sine and cosine of the turn of the row at floats[k:], the gauge angle added."""
    cos_gauge, sin_gauge = floats[k + 12], floats[k + 13]
    return s * cos_gauge + c * sin_gauge, c * cos_gauge - s * sin_gauge


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
    return r[0] * a + r[1] * b + r[2] * c, r[3] * a + r[4] * b + r[5] * c, r[6] * a + r[7] * b + r[8] * c


@device
def placement(floats, k):
    """The rows of the 3x4 placement at floats[k:]."""
    return load4(floats, k), load4(floats, k + 4), load4(floats, k + 8)


@device
def write_pose(out, k, a, b, c, particle):
    """1 if the pose is bad (NaN), else 0; writes it as 4x4 matrix to out[k:]."""
    bad = entry(a, 0) != entry(a, 0)
    if particle:
        zero = entry(a, 0) * 0.0  # or NaN
        a = pack4(1.0 + zero, zero, zero, entry(a, 3))
        b = pack4(zero, 1.0 + zero, zero, entry(b, 3))
        c = pack4(zero, zero, 1.0 + zero, entry(c, 3))
    store(out, k, a)
    store(out, k + 4, b)
    store(out, k + 8, c)
    store(out, k + 12, pack4(0.0, 0.0, 0.0, 1.0))
    return int(bad)


# ------------------------------------------------------ one frame: from the tip to the root, no scratch


@device
def around(a, b):
    """Velocity of the frame's origin, in its axes, under a turn from the axis of row a to that of row b."""
    return entry(a, 3) * b - entry(b, 3) * a


@device
def add_column(columns, k, nv, v, w):
    """Add the twist (v, w) to the column of a (6, nv) matrix that begins at columns[k]."""
    for i in range(3):
        columns[k + i * nv] += entry(v, i)
        columns[k + (3 + i) * nv] += entry(w, i)


@device
def add_ball_columns(columns, k, nv, a, b, c, sign):
    """Add the columns of a ball; a, b, c: rows of the frame's pose seen from the axes of rotation."""
    add_column(columns, k, nv, sign * around(b, c), sign * a)
    add_column(columns, k + 1, nv, sign * around(c, a), sign * b)
    add_column(columns, k + 2, nv, sign * around(a, b), sign * c)


@device
def climb(ints, floats, q, start, with_columns, columns, first):
    """The rows of the pose of output 0 at q[start:]; adds its body Jacobian to columns[first:], if wanted.

    With X_RF the pose of the frame F in the axes of row R, the column of a turn about z of R is, in axes of F
    and at its origin, R_RF^T (z x p_RF) and R_RF^T z: combinations of the rows of X_RF.
    """
    n_rows, nv = ints[0], ints[3]
    row = ints[HEADER + ROW_INTS * n_rows]
    a, b, c = placement(floats, ROW_FLOATS * n_rows)
    while row >= 0:
        k, kx = HEADER + ROW_INTS * row, ROW_FLOATS * row
        kind, index, column = ints[k], start + ints[k + 2], first + ints[k + 3]
        multiplier = floats[kx + 14]
        if kind == TURN:
            if with_columns:
                add_column(columns, column, nv, multiplier * around(a, b), multiplier * c)
            s, co = sincos_any(multiplier * q[index])
            s, co = gauged(floats, kx, s, co)
            a, b = turned(s, co, a, b)
        elif kind == SLIDE:
            if with_columns:
                add_column(columns, column, nv, multiplier * c, 0.0 * c)
            c = slid(multiplier * q[index], c)
        else:
            w, x, y, z = unit_quaternion(q, index, multiplier)
            if with_columns and multiplier > 0.0:
                add_ball_columns(columns, column, nv, a, b, c, 1.0)
            a, b, c = balled(w, x, y, z, a, b, c)
            if with_columns and multiplier < 0.0:
                add_ball_columns(columns, column, nv, a, b, c, -1.0)
        a, b, c = placed(floats, kx, a, b, c)
        row = ints[k + 1]
    return a, b, c


@device
def pose_at(ints, floats, q, start, out, k):
    """1 if the configuration q[start:] is bad, else 0; writes the pose of output 0 to out[k:]."""
    a, b, c = climb(ints, floats, q, start, False, out, 0)
    return write_pose(out, k, a, b, c, ints[HEADER + ROW_INTS * ints[0] + 1])


@device
def rotated(a, b, c, x, y, z):
    """R @ (x, y, z), R being the rotation in the rows a, b, c."""
    return (
        entry(a, 0) * x + entry(a, 1) * y + entry(a, 2) * z,
        entry(b, 0) * x + entry(b, 1) * y + entry(b, 2) * z,
        entry(c, 0) * x + entry(c, 1) * y + entry(c, 2) * z,
    )


@device
def express(columns, first, nv, frame, particle, a, b, c):
    """Turn the body Jacobian at columns[first:] to ground axes; for WORLD move it to the ground's origin.

    A particle has no orientation: its angular rows are zero and its axes are the ground's in all frames.
    """
    px, py, pz = entry(a, 3), entry(b, 3), entry(c, 3)
    for j in range(first, first + nv):
        vx, vy, vz = rotated(a, b, c, columns[j], columns[j + nv], columns[j + 2 * nv])
        wx, wy, wz = rotated(a, b, c, columns[j + 3 * nv], columns[j + 4 * nv], columns[j + 5 * nv])
        if particle:
            wx, wy, wz = 0.0, 0.0, 0.0
        if frame == WORLD:
            vx, vy, vz = vx + (py * wz - pz * wy), vy + (pz * wx - px * wz), vz + (px * wy - py * wx)
        columns[j], columns[j + nv], columns[j + 2 * nv] = vx, vy, vz
        columns[j + 3 * nv], columns[j + 4 * nv], columns[j + 5 * nv] = wx, wy, wz


@device
def jacobian_at(ints, floats, q, start, frame, with_pose, out, k, columns, first):
    """1 if the configuration q[start:] is bad, else 0; writes the Jacobian of output 0 and, if asked, its pose."""
    nv = ints[3]
    particle = ints[HEADER + ROW_INTS * ints[0] + 1]
    for i in range(first, first + 6 * nv):
        columns[i] = 0.0
    a, b, c = climb(ints, floats, q, start, True, columns, first)
    bad = int(entry(a, 0) != entry(a, 0))
    if with_pose:
        write_pose(out, k, a, b, c, particle)
    if bad:
        for i in range(first, first + 6 * nv):
            columns[i] = np.nan
    elif frame != BODY or particle:
        express(columns, first, nv, frame, particle, a, b, c)
    return bad


@kernel(types.int64(I1, F1, F2, types.int64, OUT3, OUT3))
def jacobian(ints, floats, q, frame, pose, columns):
    """Number of bad configurations; writes poses (N, 4, 4) and Jacobians (N, 6, nv) of the first output."""
    nq, size = q.shape[1], 6 * ints[3]
    i_, f_, q_, pose_, columns_ = raw(ints), raw(floats), raw(q), raw(pose), raw(columns)
    bad = 0
    for i in range(q.shape[0]):
        bad += jacobian_at(i_, f_, q_, i * nq, frame, True, pose_, 16 * i, columns_, i * size)
    return bad


# ------------------------------------------------------ all frames of a tree: from the root to the tips


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
    """Numbers in the scratch block of `descend`: angles, sines, cosines (padded to full vectors), poses."""
    return 3 * (n_rows + LANES) + OUTPUT_FLOATS * n_rows


@device
def poses_at(n_rows):
    """Where the poses of the rows begin in the scratch block of `descend`."""
    return 3 * ((n_rows + LANES - 1) // LANES * LANES)


@routine
def row_poses(ints, floats, q, start, scratch):
    """Write the poses of all rows at the configuration q[start:] to scratch[poses_at(n_rows):]."""
    n_rows = ints[0]
    sine = (n_rows + LANES - 1) // LANES * LANES
    cosine, poses = 2 * sine, 3 * sine
    for row in range(n_rows):
        scratch[row] = floats[ROW_FLOATS * row + 14] * q[start + ints[HEADER + ROW_INTS * row + 2]]
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
        k, kx = HEADER + ROW_INTS * row, ROW_FLOATS * row
        kind, parent = ints[k], ints[k + 1]
        a, b, c = placement(floats, kx)
        if kind == TURN:
            s, co = gauged(floats, kx, scratch[sine + row], scratch[cosine + row])
            a, b, c = times_turn(a, s, co), times_turn(b, s, co), times_turn(c, s, co)
        elif kind == SLIDE:
            theta = scratch[row]
            a, b, c = times_slide(a, theta), times_slide(b, theta), times_slide(c, theta)
        else:
            w, x, y, z = unit_quaternion(q, start + ints[k + 2], floats[kx + 14])
            a, b, c = pack4(1.0, 0.0, 0.0, 0.0), pack4(0.0, 1.0, 0.0, 0.0), pack4(0.0, 0.0, 1.0, 0.0)
            a, b, c = balled(w, x, y, z, a, b, c)
            a, b, c = placed(floats, kx, a, b, c)
        if parent >= 0:
            a, b, c = placed(scratch, poses + OUTPUT_FLOATS * parent, a, b, c)
        k = poses + OUTPUT_FLOATS * row
        store(scratch, k, a)
        store(scratch, k + 4, b)
        store(scratch, k + 8, c)


@device
def descend(ints, floats, q, start, out, first, scratch):
    """1 if an output is bad at the configuration q[start:], else 0; writes all poses to out[first:]."""
    n_rows, n_out = ints[0], ints[1]
    poses = poses_at(n_rows)
    row_poses(ints, floats, q, start, scratch)
    bad = 0
    for i in range(n_out):
        k = HEADER + ROW_INTS * n_rows + OUTPUT_INTS * i
        row, particle = ints[k], ints[k + 1]
        a, b, c = placement(floats, ROW_FLOATS * n_rows + OUTPUT_FLOATS * i)
        if row >= 0:
            a, b, c = placed(scratch, poses + OUTPUT_FLOATS * row, a, b, c)
        bad |= write_pose(out, first + 16 * i, a, b, c, particle)
    return bad


@kernel(types.int64(I1, F1, F1, OUT3), nogil=False)
def poses1(ints, floats, q, out):
    """Number of bad configurations, 0 or 1; writes the poses (n_out, 4, 4) of all outputs at q (nq,)."""
    scratch = np.empty(scratch_size(ints[0]))
    bad = descend(raw(ints), raw(floats), raw(q), 0, raw(out), 0, raw(scratch))
    keep(scratch)
    return bad


@kernel(types.int64(I1, F1, F2, OUT4))
def poses(ints, floats, q, out):
    """Number of bad configurations; writes the poses (N, n_out, 4, 4) of all outputs at q (N, nq)."""
    nq, size = q.shape[1], 16 * ints[1]
    scratch = np.empty(scratch_size(ints[0]))
    i_, f_, q_, out_, scratch_ = raw(ints), raw(floats), raw(q), raw(out), raw(scratch)
    bad = 0
    for i in range(q.shape[0]):
        bad += descend(i_, f_, q_, i * nq, out_, i * size, scratch_)
    keep(scratch)
    return bad
