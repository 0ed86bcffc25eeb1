"""Positions of the last frame of a chain at random configurations, and how many fall into each
cell.

Random configurations are a function of keys and the number of the sample: coordinate i of sample k
is from number k of the sequence from keys[i], uniform between low[i] and low[i] + range[i]; a
quaternion at i takes the sequences i, i + 1 and i + 2 (Shoemake 1992).
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device, kernel
from kempe.kernels.base.declare import INT, OUT, OUTI, F, I
from kempe.kernels.base.trig import sincos
from kempe.kernels.base.vectors import LANES, keep, raw, spread_lanes, square_root, store, where
from kempe.kernels.forward.chain_positions import by_number, by_quaternion, store_points, tip
from kempe.kernels.forward.lane_counts import count_one, rounded_down, units, will_count
from kempe.kernels.forward.table_layout import (
    BALL,
    HEADER,
    KIND,
    MULTIPLIER,
    N_ROWS,
    Q_INDEX,
    ROW_FLOATS,
    ROW_INTS,
)

BLOCK = 256
"""Samples whose cells are found before they are counted, so that memory has time to come near."""


@device
def drawn_position(ints, floats, keys, bounds, counter):
    """The positions (x, y, z) of the samples from `counter` on, one a lane."""
    n_rows = ints[N_ROWS]
    p = tip(ints, floats)
    for i in range(n_rows):
        row = n_rows - 1 - i
        index = ints[HEADER + ROW_INTS * row + Q_INDEX]
        multiplier = floats[ROW_FLOATS * row + MULTIPLIER]
        u = units(keys[index], counter)
        if ints[HEADER + ROW_INTS * row + KIND] == BALL:
            sa, ca = sincos(2.0 * math.pi * units(keys[index + 1], counter))
            sb, cb = sincos(2.0 * math.pi * units(keys[index + 2], counter))
            small = square_root(1.0 - u)
            large = square_root(u)
            sign = math.copysign(1.0, multiplier)
            unit = small * sa, sign * (small * ca), sign * (large * sb), sign * (large * cb)
            p = by_quaternion(ints, floats, row, unit, p)
        else:
            theta = multiplier * (bounds[2 * index] + bounds[2 * index + 1] * u)
            p = by_number(ints, floats, row, theta, p)
    return p


@kernel(I("_"), F("_"), I("_"), F("_", 2), INT, OUT("N", 3), returns=False)
def random_positions(ints, floats, keys, bounds, first, out):
    """Write the positions (N, 3) of the samples from number `first` on; `bounds` are (low, range) a
    coordinate.
    """
    n = out.shape[0]
    scratch = np.empty(4 * LANES)
    i_ = raw(ints)
    f_ = raw(floats)
    out_ = raw(out)
    spare = raw(scratch)
    keys_ = raw(keys)
    bounds_ = raw(bounds)
    for start in range(0, n, LANES):
        p = drawn_position(i_, f_, keys_, bounds_, first + start)
        store_points(out_, 3 * start, n - start, p, spare)
    keep(scratch)


@kernel(I("_"), F("_"), I("_"), F("_", 2), INT, INT, F(3, 3), OUTI("_"), returns=False)
def count_cells(ints, floats, keys, bounds, first, n, grid, counts):
    """Count the samples `first` to `first` + n by the cells that the frame's positions fall into.

    `grid` holds for each axis the lower end of the box, cells a metre, and the number of cells.
    `counts` holds 32-bit numbers, two in each entry: of each cell, the last axis fastest, and after
    them of what falls outside.
    """
    scratch = np.empty(BLOCK)
    i_ = raw(ints)
    f_ = raw(floats)
    keys_ = raw(keys)
    bounds_ = raw(bounds)
    counts_ = raw(counts)
    cells = raw(scratch)
    low_x = grid[0, 0]
    low_y = grid[1, 0]
    low_z = grid[2, 0]
    by_x = grid[0, 1]
    by_y = grid[1, 1]
    by_z = grid[2, 1]
    nx = grid[0, 2]
    ny = grid[1, 2]
    nz = grid[2, 2]
    outside = spread_lanes(nx * ny * nz)
    for start in range(0, n, BLOCK):
        stop = min(BLOCK, n - start)
        for lane in range(0, stop, LANES):
            x, y, z = drawn_position(i_, f_, keys_, bounds_, first + start + lane)
            x = rounded_down((x - low_x) * by_x)
            y = rounded_down((y - low_y) * by_y)
            z = rounded_down((z - low_z) * by_z)
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
