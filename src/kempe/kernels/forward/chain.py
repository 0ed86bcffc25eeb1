"""Poses of the last frame of a chain, `LANES` configurations side by side.

What a row costs depends on the form of its placement: GENERAL is any, RX is [Rx(alpha) | p], and RX_FLAT
moreover has p_y = 0 (Denavit and Hartenberg 1955, modified as by Craig 1986); `model.tree.gauge` makes such rows.
The pose stays in twelve registers, one for each entry, named as three matrix rows (x, y, z, p).
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device, kernel
from kempe.kernels.base.declare import OUT, F, I
from kempe.kernels.base.trig import REACH, sincos
from kempe.kernels.base.vectors import (
    LANES,
    all_between,
    gather,
    keep,
    load_lanes,
    rarely,
    raw,
    spread_lanes,
    square_root,
    store,
    store_columns,
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
from kempe.kernels.forward.table_rows import rotation, with_offset
from kempe.kernels.forward.table_sweep import pose_at

SMALLEST_SQUARE, LARGEST_SQUARE = 1e-200, 1e200
"""Squared norms of quaternions that lanes normalise without scaling."""


@device
def spread_row(floats, k):
    """A matrix row of a placement in all lanes."""
    return (
        spread_lanes(floats[k]),
        spread_lanes(floats[k + 1]),
        spread_lanes(floats[k + 2]),
        spread_lanes(floats[k + 3]),
    )


@device
def times_general(t, f, k):
    """Row t of T @ X, X any placement at f[k:]."""
    x, y, z, p = t
    return (
        x * f[k] + (y * f[k + 4] + z * f[k + 8]),
        x * f[k + 1] + (y * f[k + 5] + z * f[k + 9]),
        x * f[k + 2] + (y * f[k + 6] + z * f[k + 10]),
        x * f[k + 3] + (y * f[k + 7] + (z * f[k + 11] + p)),
    )


@device
def times_rx(t, f, k):
    """Row t of T @ [Rx | p]."""
    x, y, z, p = t
    p = x * f[k + 3] + (y * f[k + 7] + (z * f[k + 11] + p))
    return x, y * f[k + 5] + z * f[k + 9], y * f[k + 6] + z * f[k + 10], p


@device
def times_rx_flat(t, f, k):
    """Row t of T @ [Rx | px 0 pz]."""
    x, y, z, p = t
    p = x * f[k + 3] + (z * f[k + 11] + p)
    return x, y * f[k + 5] + z * f[k + 9], y * f[k + 6] + z * f[k + 10], p


@device
def times_turn(t, s, c):
    """Row t of T @ Rz."""
    x, y, z, p = t
    return c * x + s * y, c * y - s * x, z, p


@device
def times_slide(t, theta):
    """Row t of T @ Tz."""
    x, y, z, p = t
    return x, y, z, p + z * theta


@device
def times_ball(t, r):
    """Row t of T @ R, r the nine entries of R."""
    x, y, z, p = t
    return (
        x * r[0] + (y * r[3] + z * r[6]),
        x * r[1] + (y * r[4] + z * r[7]),
        x * r[2] + (y * r[5] + z * r[8]),
        p,
    )


@device
def times_placement(form, u, v, w, f, k):
    """The rows of T @ X."""
    if form == RX_FLAT:
        return times_rx_flat(u, f, k), times_rx_flat(v, f, k), times_rx_flat(w, f, k)
    if form == RX:
        return times_rx(u, f, k), times_rx(v, f, k), times_rx(w, f, k)
    return times_general(u, f, k), times_general(v, f, k), times_general(w, f, k)


@device
def count_variables(ints):
    """Numbers that `read_variables` keeps of a configuration: a turn has two, a slide one, a ball four."""
    total = 0
    for row in range(ints[N_ROWS]):
        kind = ints[HEADER + ROW_INTS * row + KIND]
        total += 4 if kind == BALL else 2 if kind == TURN else 1
    return total


@device
def read_variables(ints, floats, q, start, nq, variables):
    """Whether all lanes can be swept; `variables` gets sine and cosine, slide, or quaternion of each row."""
    near = True
    k = 0
    for row in range(ints[N_ROWS]):
        kind, index = ints[HEADER + ROW_INTS * row + KIND], start + ints[HEADER + ROW_INTS * row + Q_INDEX]
        kx = ROW_FLOATS * row
        multiplier = floats[kx + MULTIPLIER]
        first = gather(q, index, nq)
        if kind == TURN:
            theta = multiplier * first
            near &= all_between(-REACH, theta, REACH)
            s, c = sincos(theta)
            s, c = with_offset(floats, kx, s, c)
            store(variables, k, s)
            store(variables, k + LANES, c)
            k += 2 * LANES
        elif kind == SLIDE:
            theta = multiplier * first
            near &= all_between(-REACH, theta, REACH)
            store(variables, k, theta)
            k += LANES
        else:
            x, y, z = gather(q, index + 1, nq), gather(q, index + 2, nq), gather(q, index + 3, nq)
            square = first * first + x * x + y * y + z * z
            near &= all_between(SMALLEST_SQUARE, square, LARGEST_SQUARE)
            scale = 1.0 / square_root(square)
            sign = math.copysign(1.0, multiplier) * scale
            store(variables, k, first * scale)
            store(variables, k + LANES, x * sign)
            store(variables, k + 2 * LANES, y * sign)
            store(variables, k + 3 * LANES, z * sign)
            k += 4 * LANES
    return near


@device
def strays(ints, floats, q, start):
    """Whether a coordinate of q[start:] makes `read_variables` refuse the lane."""
    for row in range(ints[N_ROWS]):
        index = start + ints[HEADER + ROW_INTS * row + Q_INDEX]
        if ints[HEADER + ROW_INTS * row + KIND] == BALL:
            w, x, y, z = q[index], q[index + 1], q[index + 2], q[index + 3]
            if not SMALLEST_SQUARE <= w * w + x * x + y * y + z * z <= LARGEST_SQUARE:
                return True
        elif not abs(floats[ROW_FLOATS * row + MULTIPLIER] * q[index]) <= REACH:
            return True
    return False


@device
def sweep_lanes(ints, floats, variables, out, first):
    """Write LANES poses from out[first:] on."""
    n_rows = ints[N_ROWS]
    u, v, w = spread_row(floats, 0), spread_row(floats, 4), spread_row(floats, 8)
    row = k = 0
    while True:
        kind = ints[HEADER + ROW_INTS * row + KIND]
        a = load_lanes(variables, k)
        if kind == TURN:
            c = load_lanes(variables, k + LANES)
            k += 2 * LANES
            u, v, w = times_turn(u, a, c), times_turn(v, a, c), times_turn(w, a, c)
        elif kind == SLIDE:
            k += LANES
            u, v, w = times_slide(u, a), times_slide(v, a), times_slide(w, a)
        else:
            x, y = load_lanes(variables, k + LANES), load_lanes(variables, k + 2 * LANES)
            r = rotation(a, x, y, load_lanes(variables, k + 3 * LANES))
            k += 4 * LANES
            u, v, w = times_ball(u, r), times_ball(v, r), times_ball(w, r)
        row += 1
        if row == n_rows:
            break
        form = ints[HEADER + ROW_INTS * row + FORM]
        u, v, w = times_placement(form, u, v, w, floats, ROW_FLOATS * row)
    u, v, w = times_placement(GENERAL, u, v, w, floats, ROW_FLOATS * n_rows)
    zero, one = spread_lanes(0.0), spread_lanes(1.0)
    if ints[HEADER + ROW_INTS * n_rows + PARTICLE]:
        u, v, w = (one, zero, zero, u[3]), (zero, one, zero, v[3]), (zero, zero, one, w[3])
    store_columns(out, first, 16, u[0], u[1], u[2], u[3])
    store_columns(out, first + 4, 16, v[0], v[1], v[2], v[3])
    store_columns(out, first + 8, 16, w[0], w[1], w[2], w[3])
    store_columns(out, first + 12, 16, zero, zero, zero, one)


@kernel(I("_"), F("_"), F("N", "_"), OUT("N", 4, 4))
def chain_poses(ints, floats, q, out):
    """Number of bad configurations; writes the poses (N, 4, 4) of a chain's one output at q (N, nq).

    A last block that is not full begins earlier and repeats some. One at a time go: fewer configurations than
    lanes, and those with a coordinate beyond the polynomials' reach. No lane depends on the others.
    """
    n, nq = q.shape
    scratch = np.empty(count_variables(ints) * LANES)
    i_, f_, q_, out_, variables = raw(ints), raw(floats), raw(q), raw(out), raw(scratch)
    side_by_side = n >= LANES and ints[N_ROWS] > 0
    strayed = 0 if not side_by_side else n  # where to begin to look for those that go alone
    if side_by_side:
        for block in range(0, n, LANES):
            start = min(block, n - LANES)
            near = read_variables(i_, f_, q_, start * nq, nq, variables)
            sweep_lanes(i_, f_, variables, out_, start * 16)
            if rarely(not near):
                strayed = min(strayed, start)
    bad = 0
    for i in range(strayed, n):
        if not side_by_side or strays(i_, f_, q_, i * nq):
            bad += pose_at(i_, f_, q_, i * nq, out_, 16 * i)
    keep(scratch)
    return bad
