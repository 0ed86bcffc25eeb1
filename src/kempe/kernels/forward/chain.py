"""Poses of the last frame of a chain, or parts of them, `LANES` configurations side by side.

What a row costs depends on the form of its placement: GENERAL is any, RX is [Rx(alpha) | p], and
RX_FLAT moreover has p_y = 0 (Denavit and Hartenberg 1955, modified as by Craig 1986);
`model.gauge` makes such rows. The pose stays in twelve registers, one for each entry, named as
three matrix rows (x, y, z, p).
"""

from __future__ import annotations

import numpy as np

from kempe.kernels.base._jit import device, kernel
from kempe.kernels.base.declare import OUT, F, I
from kempe.kernels.base.trig import REACH
from kempe.kernels.base.vectors import (
    LANES,
    are_all_between,
    compute_square_root,
    expect_false,
    gather_lanes,
    get_pointer,
    keep_alive,
    load_lanes,
    select_where,
    spread_lanes,
    store_columns,
    store_value,
)
from kempe.kernels.forward.chain_positions import (
    LARGEST_SQUARE,
    SMALLEST_SQUARE,
    compute_row_sincos,
    read_unit_quaternions,
    store_points,
    sweep_positions,
)
from kempe.kernels.forward.table_layout import (
    BALL,
    FORM,
    GENERAL,
    HEADER,
    KIND,
    MULTIPLIER,
    N_ROWS,
    PARTICLE,
    Q_INDEX,
    ROW_FLOATS,
    ROW_INTS,
    RX,
    RX_FLAT,
    SLIDE,
    TURN,
)
from kempe.kernels.forward.table_rows import make_rotation
from kempe.kernels.forward.table_sweep import evaluate_pose

POSE = 16
ROWS = 12
POSITION_QUATERNION = 7
POSITION = 3
"""Numbers that are written of a pose: all, the upper three rows, position with quaternion wxyz,
position."""


@device
def spread_row(floats, k):
    """Return a matrix row of the placement at floats[k:], in all lanes."""
    return (
        spread_lanes(floats[k]),
        spread_lanes(floats[k + 1]),
        spread_lanes(floats[k + 2]),
        spread_lanes(floats[k + 3]),
    )


@device
def append_general_placement(t, f, k):
    """Return row t of T @ X, X any placement at f[k:]."""
    x, y, z, p = t
    return (
        x * f[k] + (y * f[k + 4] + z * f[k + 8]),
        x * f[k + 1] + (y * f[k + 5] + z * f[k + 9]),
        x * f[k + 2] + (y * f[k + 6] + z * f[k + 10]),
        x * f[k + 3] + (y * f[k + 7] + (z * f[k + 11] + p)),
    )


@device
def append_x_turn(t, f, k):
    """Return row t of T @ [Rx | p], Rx a turn about x."""
    x, y, z, p = t
    p = x * f[k + 3] + (y * f[k + 7] + (z * f[k + 11] + p))
    return x, y * f[k + 5] + z * f[k + 9], y * f[k + 6] + z * f[k + 10], p


@device
def append_flat_x_turn(t, f, k):
    """Return row t of T @ [Rx | px 0 pz], Rx a turn about x."""
    x, y, z, p = t
    p = x * f[k + 3] + (z * f[k + 11] + p)
    return x, y * f[k + 5] + z * f[k + 9], y * f[k + 6] + z * f[k + 10], p


@device
def append_turn(t, s, c):
    """Return row t of T @ Rz, Rz the turn about z with sine s and cosine c."""
    x, y, z, p = t
    return c * x + s * y, c * y - s * x, z, p


@device
def append_slide(t, theta):
    """Return row t of T @ Tz, Tz the slide along z by theta."""
    x, y, z, p = t
    return x, y, z, p + z * theta


@device
def append_ball(t, r):
    """Return row t of T @ R, r the nine entries of the rotation R, row by row."""
    x, y, z, p = t
    return (
        x * r[0] + (y * r[3] + z * r[6]),
        x * r[1] + (y * r[4] + z * r[7]),
        x * r[2] + (y * r[5] + z * r[8]),
        p,
    )


@device
def append_placement(form, u, v, w, f, k):
    """Return the three rows of T @ X, from rows u, v, w of T; the placement X at f[k:] is of this
    `form`.
    """
    if form == RX_FLAT:
        return append_flat_x_turn(u, f, k), append_flat_x_turn(v, f, k), append_flat_x_turn(w, f, k)
    if form == RX:
        return append_x_turn(u, f, k), append_x_turn(v, f, k), append_x_turn(w, f, k)
    return (
        append_general_placement(u, f, k),
        append_general_placement(v, f, k),
        append_general_placement(w, f, k),
    )


@device
def count_variables(ints):
    """Count the numbers that `read_variables` keeps of a configuration: two of a turn, one of a
    slide, four of a ball.
    """
    total = 0
    for row in range(ints[N_ROWS]):
        kind = ints[HEADER + ROW_INTS * row + KIND]
        total += 4 if kind == BALL else 2 if kind == TURN else 1
    return total


@device
def read_variables(ints, floats, q, start, nq, variables):
    """Write sine and cosine, slide, or quaternion of each row to `variables`; return whether all
    lanes can be swept.
    """
    near = True
    far = spread_lanes(0.0)
    k = 0
    for row in range(ints[N_ROWS]):
        kind = ints[HEADER + ROW_INTS * row + KIND]
        index = start + ints[HEADER + ROW_INTS * row + Q_INDEX]
        kx = ROW_FLOATS * row
        multiplier = floats[kx + MULTIPLIER]
        if kind == BALL:
            sound, (w, x, y, z) = read_unit_quaternions(q, index, nq, multiplier)
            near &= sound
            store_value(variables, k, w)
            store_value(variables, k + LANES, x)
            store_value(variables, k + 2 * LANES, y)
            store_value(variables, k + 3 * LANES, z)
            k += 4 * LANES
            continue
        theta = multiplier * gather_lanes(q, index, nq)
        far = far + abs(theta)
        if kind == TURN:
            s, c = compute_row_sincos(floats, kx, theta)
            store_value(variables, k, s)
            store_value(variables, k + LANES, c)
            k += 2 * LANES
        else:
            store_value(variables, k, theta)
            k += LANES
    return near and are_all_between(0.0, far, REACH)


@device
def has_stray_coordinate(ints, floats, q, start):
    """Return whether a coordinate of q[start:] makes `read_variables` refuse the lane."""
    for row in range(ints[N_ROWS]):
        index = start + ints[HEADER + ROW_INTS * row + Q_INDEX]
        if ints[HEADER + ROW_INTS * row + KIND] == BALL:
            w = q[index]
            x = q[index + 1]
            y = q[index + 2]
            z = q[index + 3]
            if not SMALLEST_SQUARE <= w * w + x * x + y * y + z * z <= LARGEST_SQUARE:
                return True
        elif not abs(floats[ROW_FLOATS * row + MULTIPLIER] * q[index]) <= REACH:
            return True
    return False


@device
def sweep_lanes(ints, floats, variables):
    """Return the matrix rows of LANES poses, from `variables` as `read_variables` writes them."""
    n_rows = ints[N_ROWS]
    u = spread_row(floats, 0)
    v = spread_row(floats, 4)
    w = spread_row(floats, 8)
    row = k = 0
    while True:
        kind = ints[HEADER + ROW_INTS * row + KIND]
        a = load_lanes(variables, k)
        if kind == TURN:
            c = load_lanes(variables, k + LANES)
            k += 2 * LANES
            u = append_turn(u, a, c)
            v = append_turn(v, a, c)
            w = append_turn(w, a, c)
        elif kind == SLIDE:
            k += LANES
            u = append_slide(u, a)
            v = append_slide(v, a)
            w = append_slide(w, a)
        else:
            x = load_lanes(variables, k + LANES)
            y = load_lanes(variables, k + 2 * LANES)
            r = make_rotation(a, x, y, load_lanes(variables, k + 3 * LANES))
            k += 4 * LANES
            u = append_ball(u, r)
            v = append_ball(v, r)
            w = append_ball(w, r)
        row += 1
        if row == n_rows:
            break
        form = ints[HEADER + ROW_INTS * row + FORM]
        u, v, w = append_placement(form, u, v, w, floats, ROW_FLOATS * row)
    u, v, w = append_placement(GENERAL, u, v, w, floats, ROW_FLOATS * n_rows)
    if ints[HEADER + ROW_INTS * n_rows + PARTICLE]:
        zero = spread_lanes(0.0)
        one = spread_lanes(1.0)
        u = (one, zero, zero, u[3])
        v = (zero, one, zero, v[3])
        w = (zero, zero, one, w[3])
    return u, v, w


@device
def compute_quaternion(u, v, w):
    """Return the unit quaternion wxyz, w >= 0, of the rotation in matrix rows, by the largest
    component (Shepperd 1978).
    """
    a = u[0]
    b = v[1]
    c = w[2]
    wx = w[1] - v[2]
    wy = u[2] - w[0]
    wz = v[0] - u[1]
    xy = v[0] + u[1]
    xz = u[2] + w[0]
    yz = w[1] + v[2]
    ww = 1.0 + a + b + c
    xx = 1.0 + a - b - c
    yy = 1.0 - a + b - c
    zz = 1.0 - a - b + c
    best, p, q, r, s = select_larger(xx, wx, xx, xy, xz, ww, ww, wx, wy, wz)
    best, p, q, r, s = select_larger(yy, wy, xy, yy, yz, best, p, q, r, s)
    best, p, q, r, s = select_larger(zz, wz, xz, yz, zz, best, p, q, r, s)
    scale = 0.5 / compute_square_root(best)
    scale = select_where(0.0 > p, -scale, scale)
    return p * scale, q * scale, r * scale, s * scale


@device
def select_larger(new, p, q, r, s, best, a, b, c, d):
    """Return the first five numbers where `new` is larger than `best`, else the others."""
    take = new > best
    return (
        select_where(take, new, best),
        select_where(take, p, a),
        select_where(take, q, b),
        select_where(take, r, c),
        select_where(take, s, d),
    )


@device
def write_lane_poses(width, u, v, w, out, first):
    """Write `width` numbers of each of LANES poses from out[first:] on."""
    if width == POSITION_QUATERNION:
        a, b, c, d = compute_quaternion(u, v, w)
        store_columns(out, first, width, u[3], v[3], w[3], a)
        store_columns(out, first + 3, width, a, b, c, d)
        return
    store_columns(out, first, width, u[0], u[1], u[2], u[3])
    store_columns(out, first + 4, width, v[0], v[1], v[2], v[3])
    store_columns(out, first + 8, width, w[0], w[1], w[2], w[3])
    if width == POSE:
        zero = spread_lanes(0.0)
        one = spread_lanes(1.0)
        store_columns(out, first + 12, width, zero, zero, zero, one)


@device
def write_one_pose(width, pose, out, first):
    """Write `width` numbers of one pose (4, 4) from out[first:] on."""
    if width >= ROWS:
        for k in range(width):
            out[first + k] = pose[k]
        return
    for k in range(3):
        out[first + k] = pose[4 * k + 3]
    if width == POSITION_QUATERNION:
        u = (pose[0], pose[1], pose[2], 0.0)
        v = (pose[4], pose[5], pose[6], 0.0)
        a, b, c, d = compute_quaternion(u, v, (pose[8], pose[9], pose[10], 0.0))
        out[first + 3] = a
        out[first + 4] = b
        out[first + 5] = c
        out[first + 6] = d


@kernel(I("_"), F("_"), F("N", "_"), OUT("N", "_"))
def compute_chain_poses(ints, floats, q, out):
    """Write w numbers of the pose of a chain's tip at each q (N, nq) to out (N, w); return the
    number of bad configurations.

    What these are w says: `POSE`, `ROWS`, `POSITION_QUATERNION`, `POSITION`. A last block that is
    not full begins earlier and repeats some; fewer configurations than lanes are repeated, too, so
    that no answer depends on the others. One at a time go those with a coordinate beyond the
    polynomials' reach.
    """
    n, nq = q.shape
    width = out.shape[1]
    total = count_variables(ints)
    few = 0 < n < LANES
    scratch = np.empty(total * LANES + 4 * LANES + POSE + (LANES * (nq + width) if few else 0))
    i_ = get_pointer(ints)
    f_ = get_pointer(floats)
    q_ = get_pointer(q)
    out_ = get_pointer(out)
    variables = get_pointer(scratch)
    spare = get_pointer(scratch[total * LANES :])
    alone = get_pointer(scratch[total * LANES + 4 * LANES :])
    held = get_pointer(scratch[total * LANES + 4 * LANES + POSE :])
    count = n
    if few:
        for i in range(LANES):
            for k in range(nq):
                held[i * nq + k] = q_[min(i, n - 1) * nq + k]
        q_ = held
        out_ = get_pointer(scratch[total * LANES + 4 * LANES + POSE + LANES * nq :])
        count = LANES
    side_by_side = ints[N_ROWS] > 0
    strayed = count if side_by_side else 0  # where to begin to look for those that go alone
    for block in range(0, strayed, LANES):
        start = min(block, count - LANES)
        if width == POSITION:
            near, p = sweep_positions(i_, f_, q_, start * nq, nq)
            store_points(out_, start * width, count - start, p, spare)
        else:
            near = read_variables(i_, f_, q_, start * nq, nq, variables)
            u, v, w = sweep_lanes(i_, f_, variables)
            write_lane_poses(width, u, v, w, out_, start * width)
        if expect_false(not near):
            strayed = min(strayed, start)
    bad = 0
    for i in range(strayed, n):
        if not side_by_side or has_stray_coordinate(i_, f_, q_, i * nq):
            bad += evaluate_pose(i_, f_, q_, i * nq, alone, 0)
            write_one_pose(width, alone, out_, i * width)
    if few:
        target = get_pointer(out)
        for k in range(n * width):
            target[k] = out_[k]
    keep_alive(scratch)
    return bad
