"""Poses and Jacobians from a primitive table (`table_layout`), one configuration at a time.

A 3x4 matrix is held as its three rows, vectors of four columns. Coordinates that are NaN or
infinite, and quaternions without a norm, give NaN in all that depends on them.
"""

from __future__ import annotations

import numpy as np

from kempe.kernels.base._jit import device, kernel
from kempe.kernels.base.declare import INT, OUT, F, I
from kempe.kernels.base.trig import compute_sincos
from kempe.kernels.base.vectors import (
    extract_entry,
    get_pointer,
    keep_alive,
    pack_four,
    store_value,
)
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
    add_offset,
    count_sweep_scratch,
    locate_poses,
    prepend_ball,
    prepend_placement,
    prepend_slide,
    prepend_turn,
    read_placement,
    read_unit_quaternion,
    write_row_poses,
)


@device
def write_pose(out, k, a, b, c, particle):
    """Write a pose as 4x4 matrix to out[k:]; return 1 if it is bad (NaN), else 0."""
    bad = extract_entry(a, 0) != extract_entry(a, 0)
    if particle:
        zero = extract_entry(a, 0) * 0.0  # or NaN
        a = pack_four(1.0 + zero, zero, zero, extract_entry(a, 3))
        b = pack_four(zero, 1.0 + zero, zero, extract_entry(b, 3))
        c = pack_four(zero, zero, 1.0 + zero, extract_entry(c, 3))
    store_value(out, k, a)
    store_value(out, k + 4, b)
    store_value(out, k + 8, c)
    store_value(out, k + 12, pack_four(0.0, 0.0, 0.0, 1.0))
    return int(bad)


# ------------------------------------------------------ one frame: from the tip to the root, no
# scratch


@device
def compute_turn_velocity(a, b):
    """Return the velocity of the frame's origin, in its axes, under a turn from the axis of row a
    to that of row b.
    """
    return extract_entry(a, 3) * b - extract_entry(b, 3) * a


@device
def add_column(columns, k, nv, v, w):
    """Add the twist (v, w) to the column of a (6, nv) matrix that begins at columns[k]."""
    for i in range(3):
        columns[k + i * nv] += extract_entry(v, i)
        columns[k + (3 + i) * nv] += extract_entry(w, i)


@device
def add_ball_columns(columns, k, nv, a, b, c, sign):
    """Add the columns of a ball; a, b, c: rows of the frame's pose seen from the axes of rotation."""
    add_column(columns, k, nv, sign * compute_turn_velocity(b, c), sign * a)
    add_column(columns, k + 1, nv, sign * compute_turn_velocity(c, a), sign * b)
    add_column(columns, k + 2, nv, sign * compute_turn_velocity(a, b), sign * c)


@device
def climb_chain(ints, floats, q, start, with_columns, columns, first):
    """Return the rows of the pose of output 0 at q[start:]; add its body Jacobian to
    columns[first:], if requested.

    With X_RF the pose of the frame F in the axes of row R, the column of a turn about z of R is, in
    axes of F and at its origin, R_RF^T (z x p_RF) and R_RF^T z: combinations of the rows of X_RF.
    """
    n_rows = ints[N_ROWS]
    nv = ints[NV]
    row = ints[HEADER + ROW_INTS * n_rows + ROW]
    a, b, c = read_placement(floats, ROW_FLOATS * n_rows)
    while row >= 0:
        k = HEADER + ROW_INTS * row
        kx = ROW_FLOATS * row
        kind = ints[k + KIND]
        index = start + ints[k + Q_INDEX]
        column = first + ints[k + V_INDEX]
        multiplier = floats[kx + MULTIPLIER]
        if kind == TURN:
            if with_columns:
                add_column(
                    columns, column, nv, multiplier * compute_turn_velocity(a, b), multiplier * c
                )
            s, co = compute_sincos(multiplier * q[index])
            s, co = add_offset(floats, kx, s, co)
            a, b = prepend_turn(s, co, a, b)
        elif kind == SLIDE:
            if with_columns:
                add_column(columns, column, nv, multiplier * c, 0.0 * c)
            c = prepend_slide(multiplier * q[index], c)
        else:
            w, x, y, z = read_unit_quaternion(q, index, multiplier)
            if with_columns and multiplier > 0.0:
                add_ball_columns(columns, column, nv, a, b, c, 1.0)
            a, b, c = prepend_ball(w, x, y, z, a, b, c)
            if with_columns and multiplier < 0.0:
                add_ball_columns(columns, column, nv, a, b, c, -1.0)
        a, b, c = prepend_placement(floats, kx, a, b, c)
        row = ints[k + PARENT]
    return a, b, c


@device
def evaluate_pose(ints, floats, q, start, out, k):
    """Write the pose of output 0 to out[k:]; return 1 if the configuration q[start:] is bad, else
    0.
    """
    a, b, c = climb_chain(ints, floats, q, start, False, out, 0)
    return write_pose(out, k, a, b, c, ints[HEADER + ROW_INTS * ints[N_ROWS] + PARTICLE])


@device
def rotate_vector(a, b, c, x, y, z):
    """Return R @ (x, y, z), R the rotation in the rows a, b, c."""
    return (
        extract_entry(a, 0) * x + extract_entry(a, 1) * y + extract_entry(a, 2) * z,
        extract_entry(b, 0) * x + extract_entry(b, 1) * y + extract_entry(b, 2) * z,
        extract_entry(c, 0) * x + extract_entry(c, 1) * y + extract_entry(c, 2) * z,
    )


@device
def express_jacobian(columns, first, nv, frame, particle, a, b, c):
    """Turn the body Jacobian at columns[first:] to ground axes; for WORLD move it to the ground's
    origin.

    A particle has no orientation: its angular rows are zero and its axes are the ground's in all
    frames.
    """
    px = extract_entry(a, 3)
    py = extract_entry(b, 3)
    pz = extract_entry(c, 3)
    for j in range(first, first + nv):
        vx, vy, vz = rotate_vector(a, b, c, columns[j], columns[j + nv], columns[j + 2 * nv])
        wx, wy, wz = rotate_vector(
            a, b, c, columns[j + 3 * nv], columns[j + 4 * nv], columns[j + 5 * nv]
        )
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
def evaluate_jacobian(ints, floats, q, start, frame, with_pose, out, k, columns, first):
    """Write the Jacobian of output 0 and, if requested, its pose; return 1 if the configuration
    q[start:] is bad, else 0.
    """
    nv = ints[NV]
    particle = ints[HEADER + ROW_INTS * ints[N_ROWS] + PARTICLE]
    for i in range(first, first + 6 * nv):
        columns[i] = 0.0
    a, b, c = climb_chain(ints, floats, q, start, True, columns, first)
    bad = int(extract_entry(a, 0) != extract_entry(a, 0))
    if with_pose:
        write_pose(out, k, a, b, c, particle)
    if bad:
        for i in range(first, first + 6 * nv):
            columns[i] = np.nan
    elif frame != BODY or particle:
        express_jacobian(columns, first, nv, frame, particle, a, b, c)
    return bad


@kernel(I("_"), F("_"), F("N", "_"), INT, OUT("N", 4, 4), OUT("N", 6, "_"))
def compute_jacobians(ints, floats, q, frame, pose, columns):
    """Write poses (N, 4, 4) and Jacobians (N, 6, nv) of the first output; return the number of bad
    configurations.
    """
    nq = q.shape[1]
    size = 6 * ints[NV]
    i_ = get_pointer(ints)
    f_ = get_pointer(floats)
    q_ = get_pointer(q)
    pose_ = get_pointer(pose)
    columns_ = get_pointer(columns)
    bad = 0
    for i in range(q.shape[0]):
        bad += evaluate_jacobian(i_, f_, q_, i * nq, frame, True, pose_, 16 * i, columns_, i * size)
    return bad


# ------------------------------------------------------ all frames of a tree: from the root to the
# tips


@device
def descend_tree(ints, floats, q, start, out, first, scratch):
    """Write the poses of all outputs to out[first:]; return 1 if one is bad at the configuration
    q[start:], else 0.
    """
    n_rows = ints[N_ROWS]
    n_out = ints[N_OUT]
    poses = locate_poses(n_rows)
    write_row_poses(ints, floats, q, start, scratch)
    bad = 0
    for i in range(n_out):
        k = HEADER + ROW_INTS * n_rows + OUTPUT_INTS * i
        row = ints[k + ROW]
        particle = ints[k + PARTICLE]
        a, b, c = read_placement(floats, ROW_FLOATS * n_rows + OUTPUT_FLOATS * i)
        if row >= 0:
            a, b, c = prepend_placement(scratch, poses + OUTPUT_FLOATS * row, a, b, c)
        bad |= write_pose(out, first + 16 * i, a, b, c, particle)
    return bad


@kernel(I("_"), F("_"), F("_"), OUT("_", 4, 4), nogil=False)
def compute_single_poses(ints, floats, q, out):
    """Write the poses (n_out, 4, 4) of all outputs at q (nq,); return the number of bad
    configurations, 0 or 1.
    """
    scratch = np.empty(count_sweep_scratch(ints[N_ROWS]))
    bad = descend_tree(
        get_pointer(ints),
        get_pointer(floats),
        get_pointer(q),
        0,
        get_pointer(out),
        0,
        get_pointer(scratch),
    )
    keep_alive(scratch)
    return bad


@kernel(I("_"), F("_"), F("N", "_"), OUT("N", "_", 4, 4))
def compute_poses(ints, floats, q, out):
    """Write the poses (N, n_out, 4, 4) of all outputs at q (N, nq); return the number of bad
    configurations.
    """
    nq = q.shape[1]
    size = 16 * ints[N_OUT]
    scratch = np.empty(count_sweep_scratch(ints[N_ROWS]))
    i_ = get_pointer(ints)
    f_ = get_pointer(floats)
    q_ = get_pointer(q)
    out_ = get_pointer(out)
    scratch_ = get_pointer(scratch)
    bad = 0
    for i in range(q.shape[0]):
        bad += descend_tree(i_, f_, q_, i * nq, out_, i * size, scratch_)
    keep_alive(scratch)
    return bad
