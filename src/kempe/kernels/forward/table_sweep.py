"""Poses and Jacobians from a primitive table (`table_layout`), one configuration at a time.

A 3x4 matrix is held as its three rows, vectors of four columns. Coordinates that are NaN or
infinite, and quaternions without a norm, give NaN in all that depends on them.
"""

from __future__ import annotations

import numpy as np

from kempe.kernels.base._jit import device, kernel
from kempe.kernels.base.declare import INT, OUT, F, I
from kempe.kernels.base.trig import sincos_any
from kempe.kernels.base.vectors import entry, keep, pack4, raw, store
from kempe.kernels.forward.table_layout import (
    BODY,
    HEADER,
    KIND,
    MULTIPLIER,
    N_OUT,
    N_ROWS,
    NV,
    OUTPUT_FLOATS,
    OUTPUT_INTS,
    PARENT,
    PARTICLE,
    Q_INDEX,
    ROW,
    ROW_FLOATS,
    ROW_INTS,
    SLIDE,
    TURN,
    V_INDEX,
    WORLD,
)
from kempe.kernels.forward.table_rows import (
    balled,
    placed,
    placement,
    poses_at,
    row_poses,
    scratch_size,
    slid,
    turned,
    unit_quaternion,
    with_offset,
)


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


# ------------------------------------------------------ one frame: from the tip to the root, no
# scratch


@device
def around(a, b):
    """Velocity of the frame's origin, in its axes, under a turn from the axis of row a to that of
    row b.
    """
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
    """The rows of the pose of output 0 at q[start:]; adds its body Jacobian to columns[first:], if
    wanted.

    With X_RF the pose of the frame F in the axes of row R, the column of a turn about z of R is, in
    axes of F and at its origin, R_RF^T (z x p_RF) and R_RF^T z: combinations of the rows of X_RF.
    """
    n_rows = ints[N_ROWS]
    nv = ints[NV]
    row = ints[HEADER + ROW_INTS * n_rows + ROW]
    a, b, c = placement(floats, ROW_FLOATS * n_rows)
    while row >= 0:
        k = HEADER + ROW_INTS * row
        kx = ROW_FLOATS * row
        kind = ints[k + KIND]
        index = start + ints[k + Q_INDEX]
        column = first + ints[k + V_INDEX]
        multiplier = floats[kx + MULTIPLIER]
        if kind == TURN:
            if with_columns:
                add_column(columns, column, nv, multiplier * around(a, b), multiplier * c)
            s, co = sincos_any(multiplier * q[index])
            s, co = with_offset(floats, kx, s, co)
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
        row = ints[k + PARENT]
    return a, b, c


@device
def pose_at(ints, floats, q, start, out, k):
    """1 if the configuration q[start:] is bad, else 0; writes the pose of output 0 to out[k:]."""
    a, b, c = climb(ints, floats, q, start, False, out, 0)
    return write_pose(out, k, a, b, c, ints[HEADER + ROW_INTS * ints[N_ROWS] + PARTICLE])


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
    """Turn the body Jacobian at columns[first:] to ground axes; for WORLD move it to the ground's
    origin.

    A particle has no orientation: its angular rows are zero and its axes are the ground's in all
    frames.
    """
    px = entry(a, 3)
    py = entry(b, 3)
    pz = entry(c, 3)
    for j in range(first, first + nv):
        vx, vy, vz = rotated(a, b, c, columns[j], columns[j + nv], columns[j + 2 * nv])
        wx, wy, wz = rotated(a, b, c, columns[j + 3 * nv], columns[j + 4 * nv], columns[j + 5 * nv])
        if particle:
            wx = 0.0
            wy = 0.0
            wz = 0.0
        if frame == WORLD:
            vx = vx + (py * wz - pz * wy)
            vy = vy + (pz * wx - px * wz)
            vz = vz + (px * wy - py * wx)
        columns[j] = vx
        columns[j + nv] = vy
        columns[j + 2 * nv] = vz
        columns[j + 3 * nv] = wx
        columns[j + 4 * nv] = wy
        columns[j + 5 * nv] = wz


@device
def jacobian_at(ints, floats, q, start, frame, with_pose, out, k, columns, first):
    """1 if the configuration q[start:] is bad, else 0; writes the Jacobian of output 0 and, if
    requested, its pose.
    """
    nv = ints[NV]
    particle = ints[HEADER + ROW_INTS * ints[N_ROWS] + PARTICLE]
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


@kernel(I("_"), F("_"), F("N", "_"), INT, OUT("N", 4, 4), OUT("N", 6, "_"))
def jacobian(ints, floats, q, frame, pose, columns):
    """Number of bad configurations; writes poses (N, 4, 4) and Jacobians (N, 6, nv) of the first
    output.
    """
    nq = q.shape[1]
    size = 6 * ints[NV]
    i_ = raw(ints)
    f_ = raw(floats)
    q_ = raw(q)
    pose_ = raw(pose)
    columns_ = raw(columns)
    bad = 0
    for i in range(q.shape[0]):
        bad += jacobian_at(i_, f_, q_, i * nq, frame, True, pose_, 16 * i, columns_, i * size)
    return bad


# ------------------------------------------------------ all frames of a tree: from the root to the
# tips


@device
def descend(ints, floats, q, start, out, first, scratch):
    """1 if an output is bad at the configuration q[start:], else 0; writes all poses to
    out[first:].
    """
    n_rows = ints[N_ROWS]
    n_out = ints[N_OUT]
    poses = poses_at(n_rows)
    row_poses(ints, floats, q, start, scratch)
    bad = 0
    for i in range(n_out):
        k = HEADER + ROW_INTS * n_rows + OUTPUT_INTS * i
        row = ints[k + ROW]
        particle = ints[k + PARTICLE]
        a, b, c = placement(floats, ROW_FLOATS * n_rows + OUTPUT_FLOATS * i)
        if row >= 0:
            a, b, c = placed(scratch, poses + OUTPUT_FLOATS * row, a, b, c)
        bad |= write_pose(out, first + 16 * i, a, b, c, particle)
    return bad


@kernel(I("_"), F("_"), F("_"), OUT("_", 4, 4), nogil=False)
def poses1(ints, floats, q, out):
    """Number of bad configurations, 0 or 1; writes the poses (n_out, 4, 4) of all outputs at q
    (nq,).
    """
    scratch = np.empty(scratch_size(ints[N_ROWS]))
    bad = descend(raw(ints), raw(floats), raw(q), 0, raw(out), 0, raw(scratch))
    keep(scratch)
    return bad


@kernel(I("_"), F("_"), F("N", "_"), OUT("N", "_", 4, 4))
def poses(ints, floats, q, out):
    """Number of bad configurations; writes the poses (N, n_out, 4, 4) of all outputs at q (N, nq)."""
    nq = q.shape[1]
    size = 16 * ints[N_OUT]
    scratch = np.empty(scratch_size(ints[N_ROWS]))
    i_ = raw(ints)
    f_ = raw(floats)
    q_ = raw(q)
    out_ = raw(out)
    scratch_ = raw(scratch)
    bad = 0
    for i in range(q.shape[0]):
        bad += descend(i_, f_, q_, i * nq, out_, i * size, scratch_)
    keep(scratch)
    return bad
