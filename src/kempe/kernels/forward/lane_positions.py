"""Positions of the last frame of a chain: at given configurations, at random ones, and how many fall into each cell.

Random configurations are a function of keys and the number of the sample: coordinate i of sample k is from number k of
the sequence from keys[i], uniform between low[i] and low[i] + range[i]; a quaternion at i takes the sequences i, i + 1
and i + 2 (Shoemake 1992). The position is carried from the tip to the ground, three numbers in place of twelve.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device, kernel
from kempe.kernels.base.declare import INT, OUT, OUTI, F, I
from kempe.kernels.base.trig import sincos
from kempe.kernels.base.vectors import (
    LANES,
    keep,
    load_lanes,
    rarely,
    raw,
    spread_lanes,
    square_root,
    store,
    store_columns,
    where,
)
from kempe.kernels.forward.chain import count_variables, read_variables, strays
from kempe.kernels.forward.lane_counts import count_one, rounded_down, units, will_count
from kempe.kernels.forward.table_layout import (
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
    SLIDE,
    TURN,
)
from kempe.kernels.forward.table_rows import rotation, with_offset
from kempe.kernels.forward.table_sweep import pose_at

BLOCK = 256
"""Samples whose cells are found before they are counted, so that memory has time to come near."""


@device
def moved(form, f, k, x, y, z):
    """The point (x, y, z) under the placement at f[k:]."""
    if form == RX_FLAT:
        return x + f[k + 3], y * f[k + 5] + z * f[k + 6], y * f[k + 9] + (z * f[k + 10] + f[k + 11])
    if form == RX:
        return x + f[k + 3], y * f[k + 5] + (z * f[k + 6] + f[k + 7]), y * f[k + 9] + (z * f[k + 10] + f[k + 11])
    return (
        x * f[k] + (y * f[k + 1] + (z * f[k + 2] + f[k + 3])),
        x * f[k + 4] + (y * f[k + 5] + (z * f[k + 6] + f[k + 7])),
        x * f[k + 8] + (y * f[k + 9] + (z * f[k + 10] + f[k + 11])),
    )


@device
def position_lanes(ints, floats, variables, total):
    """The positions (x, y, z) of LANES configurations, of which `read_variables` kept `total` numbers a lane."""
    n_rows = ints[N_ROWS]
    k = ROW_FLOATS * n_rows
    x, y, z = spread_lanes(floats[k + 3]), spread_lanes(floats[k + 7]), spread_lanes(floats[k + 11])
    k = total * LANES
    for i in range(n_rows):
        row = n_rows - 1 - i
        kind, form = ints[HEADER + ROW_INTS * row + KIND], ints[HEADER + ROW_INTS * row + FORM]
        if kind == TURN:
            k -= 2 * LANES
            s, c = load_lanes(variables, k), load_lanes(variables, k + LANES)
            x, y = c * x - s * y, s * x + c * y
        elif kind == SLIDE:
            k -= LANES
            z = z + load_lanes(variables, k)
        else:
            k -= 4 * LANES
            b, c = load_lanes(variables, k + LANES), load_lanes(variables, k + 2 * LANES)
            r = rotation(load_lanes(variables, k), b, c, load_lanes(variables, k + 3 * LANES))
            x, y, z = (
                r[0] * x + (r[1] * y + r[2] * z),
                r[3] * x + (r[4] * y + r[5] * z),
                r[6] * x + (r[7] * y + r[8] * z),
            )
        form = GENERAL if row == 0 else form
        x, y, z = moved(form, floats, ROW_FLOATS * row, x, y, z)
    return x, y, z


@device
def draw_variables(ints, floats, keys, bounds, counter, variables):
    """Write what `read_variables` would of the samples from `counter` on."""
    k = 0
    for row in range(ints[N_ROWS]):
        kind, index = ints[HEADER + ROW_INTS * row + KIND], ints[HEADER + ROW_INTS * row + Q_INDEX]
        kx = ROW_FLOATS * row
        multiplier = floats[kx + MULTIPLIER]
        u = units(keys[index], counter)
        if kind == TURN:
            s, c = sincos(multiplier * (bounds[2 * index] + bounds[2 * index + 1] * u))
            s, c = with_offset(floats, kx, s, c)
            store(variables, k, s)
            store(variables, k + LANES, c)
            k += 2 * LANES
        elif kind == SLIDE:
            store(variables, k, multiplier * (bounds[2 * index] + bounds[2 * index + 1] * u))
            k += LANES
        else:
            sa, ca = sincos(2.0 * math.pi * units(keys[index + 1], counter))
            sb, cb = sincos(2.0 * math.pi * units(keys[index + 2], counter))
            small, large = square_root(1.0 - u), square_root(u)
            sign = math.copysign(1.0, multiplier)
            store(variables, k, small * sa)
            store(variables, k + LANES, sign * (small * ca))
            store(variables, k + 2 * LANES, sign * (large * sb))
            store(variables, k + 3 * LANES, sign * (large * cb))
            k += 4 * LANES


@device
def store_points(out, first, count, x, y, z, scratch):
    """Write the first `count` of LANES points to out[first:], three numbers each; `scratch` holds 4 LANES numbers."""
    if count > LANES:  # others follow, and write over the one number too many
        store_columns(out, first, 3, x, y, z, z)
        return
    store_columns(scratch, 0, 4, x, y, z, z)
    for lane in range(count):
        for i in range(3):
            out[first + 3 * lane + i] = scratch[4 * lane + i]


@kernel(I("_"), F("_"), F("N", "_"), OUT("N", 3))
def positions(ints, floats, q, out):
    """Number of bad configurations; writes the positions (N, 3) of a chain's one output at q (N, nq).

    As `chain.chain_poses`: no lane depends on the others.
    """
    n, nq = q.shape
    total = count_variables(ints)
    scratch = np.empty((total + 4) * LANES)
    alone = np.empty(16)
    i_, f_, q_, out_, variables, pose = raw(ints), raw(floats), raw(q), raw(out), raw(scratch), raw(alone)
    side_by_side = n >= LANES and ints[N_ROWS] > 0
    strayed = 0 if not side_by_side else n
    if side_by_side:
        spare = raw(scratch[total * LANES :])
        for block in range(0, n, LANES):
            start = min(block, n - LANES)
            near = read_variables(i_, f_, q_, start * nq, nq, variables)
            x, y, z = position_lanes(i_, f_, variables, total)
            store_points(out_, 3 * start, n - start, x, y, z, spare)
            if rarely(not near):
                strayed = min(strayed, start)
    bad = 0
    for i in range(strayed, n):
        if not side_by_side or strays(i_, f_, q_, i * nq):
            bad += pose_at(i_, f_, q_, i * nq, pose, 0)
            for k in range(3):
                out_[3 * i + k] = pose[4 * k + 3]
    keep(scratch)
    keep(alone)
    return bad


@kernel(I("_"), F("_"), I("_"), F("_", 2), INT, OUT("N", 3), returns=False)
def random_positions(ints, floats, keys, bounds, first, out):
    """Write the positions (N, 3) of the samples from number `first` on; `bounds` are (low, range) a coordinate."""
    n, total = out.shape[0], count_variables(ints)
    scratch = np.empty((total + 4) * LANES)
    i_, f_, out_, variables, keys_, bounds_ = (
        raw(ints), raw(floats), raw(out), raw(scratch), raw(keys), raw(bounds)
    )  # fmt: skip
    spare = raw(scratch[total * LANES :])
    for start in range(0, n, LANES):
        draw_variables(i_, f_, keys_, bounds_, first + start, variables)
        x, y, z = position_lanes(i_, f_, variables, total)
        store_points(out_, 3 * start, n - start, x, y, z, spare)
    keep(scratch)


@kernel(I("_"), F("_"), I("_"), F("_", 2), INT, INT, F(3, 3), OUTI("_"), returns=False)
def count_cells(ints, floats, keys, bounds, first, n, grid, counts):
    """Count the samples `first` to `first` + n by the cells that the frame's positions fall into.

    `grid` holds for each axis the lower end of the box, cells a metre, and the number of cells. `counts` holds 32-bit
    numbers, two in each entry: of each cell, the last axis fastest, and after them of what falls outside.
    """
    total = count_variables(ints)
    scratch = np.empty(total * LANES + BLOCK)
    i_, f_, variables, keys_, bounds_ = raw(ints), raw(floats), raw(scratch), raw(keys), raw(bounds)
    counts_, cells = raw(counts), raw(scratch[total * LANES :])
    low_x, low_y, low_z = grid[0, 0], grid[1, 0], grid[2, 0]
    by_x, by_y, by_z = grid[0, 1], grid[1, 1], grid[2, 1]
    nx, ny, nz = grid[0, 2], grid[1, 2], grid[2, 2]
    outside = spread_lanes(nx * ny * nz)
    for start in range(0, n, BLOCK):
        stop = min(BLOCK, n - start)
        for lane in range(0, stop, LANES):
            draw_variables(i_, f_, keys_, bounds_, first + start + lane, variables)
            x, y, z = position_lanes(i_, f_, variables, total)
            x, y, z = (
                rounded_down((x - low_x) * by_x), rounded_down((y - low_y) * by_y), rounded_down((z - low_z) * by_z)
            )  # fmt: skip
            cell = (x * ny + y) * nz + z
            # NaN is neither above nor below, and so outside
            cell = where(x > -0.5, where(nx - 0.5 > x, cell, outside), outside)
            cell = where(y > -0.5, where(ny - 0.5 > y, cell, outside), outside)
            cell = where(z > -0.5, where(nz - 0.5 > z, cell, outside), outside)
            store(cells, lane, cell)
        for k in range(stop):
            will_count(counts_, np.int64(cells[k]))
        for k in range(stop):
            count_one(counts_, np.int64(cells[k]))
    keep(scratch)
