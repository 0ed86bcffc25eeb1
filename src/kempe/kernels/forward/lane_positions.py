"""Positions of the last frame of a chain at random configurations, and how many fall into each
cell.

Random configurations are a function of keys and the number of the sample: coordinate i of sample k
is from number k of the sequence from keys[i], uniform between low[i] and low[i] + range[i]; a
quaternion at i takes the sequences i, i + 1 and i + 2 (Shoemake 1992).
"""

from __future__ import annotations

import math

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils

from kempe.kernels.base._jit import device, kernel
from kempe.kernels.base.declare import INT, OUT, OUTI, F, I
from kempe.kernels.base.trig import sincos
from kempe.kernels.base.vectors import (
    DOUBLE,
    LANES,
    Vec,
    compute_square_root,
    get_pointer,
    intrinsic,
    keep_alive,
    select_where,
    spread_lanes,
    store_value,
)
from kempe.kernels.forward.chain_positions import (
    move_point_by_number,
    move_point_by_quaternion,
    read_tip_position,
    store_points,
)
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

# ---- lane counts

# Lanes of random numbers, and counts of what falls into cells: the two ends of sampling in bulk.
#
# The numbers are those of `random`: a function of a key and a counter. Counts are 32-bit numbers in
# memory that several threads may share: each increment is one atomic instruction.


INT32 = ir.IntType(32)
INT64 = ir.IntType(64)
INTS = types.CPointer(types.int64)
STEP = 0x9E3779B97F4A7C15
MUL_A = 0xBF58476D1CE4E5B9
MUL_B = 0x94D049BB133111EB
"""The constants of SplitMix64 (Steele, Lea and Flood 2014)."""
ONE = 0x3FF0000000000000
"""The bits of 1.0: with 52 random bits behind them, a number in [1, 2)."""


def _spread_integer(builder, value):
    """The vector of LANES integers `value`."""
    vector = ir.Constant(ir.VectorType(INT64, LANES), ir.Undefined)
    for lane in range(LANES):
        vector = builder.insert_element(vector, value, ir.Constant(INT32, lane))
    return vector


@intrinsic
def draw_unit_numbers(typingctx, key, counter):
    """Return numbers in [0, 1), of 52 bits, one a lane: those of the sequence from `key` at
    counter, counter + 1, ...
    """

    def emit_code(context, builder, sig, args):
        vector = ir.VectorType(INT64, LANES)

        def make_constant(number):
            return ir.Constant(vector, [number] * LANES)

        key, counter = (_spread_integer(builder, x) for x in args)
        at = builder.add(counter, ir.Constant(vector, list(range(1, LANES + 1))))
        z = builder.add(key, builder.mul(at, make_constant(STEP)))
        z = builder.mul(builder.xor(z, builder.lshr(z, make_constant(30))), make_constant(MUL_A))
        z = builder.mul(builder.xor(z, builder.lshr(z, make_constant(27))), make_constant(MUL_B))
        z = builder.xor(z, builder.lshr(z, make_constant(31)))
        z = builder.or_(builder.lshr(z, make_constant(12)), make_constant(ONE))
        floats = ir.VectorType(DOUBLE, LANES)
        return builder.fsub(builder.bitcast(z, floats), ir.Constant(floats, [1.0] * LANES))

    return Vec(LANES)(types.int64, types.int64), emit_code


@intrinsic
def round_entries_down(typingctx, value):
    """Round each entry of a vector down to a whole number."""

    def emit_code(context, builder, sig, args):
        kind = args[0].type
        name = f"llvm.floor.v{kind.count}f64"
        floor = cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind]), name)
        return builder.call(floor, [args[0]])

    return value(value), emit_code


def _locate_count(builder, pointer, index):
    """Emit the address of the 32-bit number `index`."""
    return builder.gep(builder.bitcast(pointer, INT32.as_pointer()), [index])


@intrinsic
def prefetch_count(typingctx, pointer, index):
    """Ask the processor to load the memory of count `index` ahead of its use."""

    def emit_code(context, builder, sig, args):
        bytes_ = ir.IntType(8).as_pointer()
        call = ir.FunctionType(ir.VoidType(), [bytes_, INT32, INT32, INT32])
        prefetch = cgutils.get_or_insert_function(builder.module, call, "llvm.prefetch.p0")
        how = [ir.Constant(INT32, x) for x in (1, 3, 1)]  # to be written, often, data
        builder.call(prefetch, [builder.bitcast(_locate_count(builder, *args), bytes_), *how])
        return context.get_dummy_value()

    return types.void(INTS, types.int64), emit_code


@intrinsic
def increment_count(typingctx, pointer, index):
    """Add 1 to the 32-bit count `index` atomically."""

    def emit_code(context, builder, sig, args):
        builder.atomic_rmw("add", _locate_count(builder, *args), ir.Constant(INT32, 1), "monotonic")
        return context.get_dummy_value()

    return types.void(INTS, types.int64), emit_code


BLOCK = 256
"""Samples whose cells are found before they are counted, so that memory has time to come near."""


@device
def draw_lane_positions(ints, floats, keys, bounds, counter):
    """Return the positions (x, y, z) of the samples from `counter` on, one a lane."""
    n_rows = ints[N_ROWS]
    p = read_tip_position(ints, floats)
    for i in range(n_rows):
        row = n_rows - 1 - i
        index = ints[HEADER + ROW_INTS * row + Q_INDEX]
        multiplier = floats[ROW_FLOATS * row + MULTIPLIER]
        u = draw_unit_numbers(keys[index], counter)
        if ints[HEADER + ROW_INTS * row + KIND] == BALL:
            sa, ca = sincos(2.0 * math.pi * draw_unit_numbers(keys[index + 1], counter))
            sb, cb = sincos(2.0 * math.pi * draw_unit_numbers(keys[index + 2], counter))
            small = compute_square_root(1.0 - u)
            large = compute_square_root(u)
            sign = math.copysign(1.0, multiplier)
            unit = small * sa, sign * (small * ca), sign * (large * sb), sign * (large * cb)
            p = move_point_by_quaternion(ints, floats, row, unit, p)
        else:
            theta = multiplier * (bounds[2 * index] + bounds[2 * index + 1] * u)
            p = move_point_by_number(ints, floats, row, theta, p)
    return p


@kernel(I("_"), F("_"), I("_"), F("_", 2), INT, OUT("N", 3), returns=False)
def sample_positions(ints, floats, keys, bounds, first, out):
    """Write the positions (N, 3) of the samples from number `first` on; `bounds` are (low, range) a
    coordinate.
    """
    n = out.shape[0]
    scratch = np.empty(4 * LANES)
    i_ = get_pointer(ints)
    f_ = get_pointer(floats)
    out_ = get_pointer(out)
    spare = get_pointer(scratch)
    keys_ = get_pointer(keys)
    bounds_ = get_pointer(bounds)
    for start in range(0, n, LANES):
        p = draw_lane_positions(i_, f_, keys_, bounds_, first + start)
        store_points(out_, 3 * start, n - start, p, spare)
    keep_alive(scratch)


@kernel(I("_"), F("_"), I("_"), F("_", 2), INT, INT, F(3, 3), OUTI("_"), returns=False)
def count_cells(ints, floats, keys, bounds, first, n, grid, counts):
    """Count the samples `first` to `first` + n by the cells that the frame's positions fall into.

    `grid` holds for each axis the lower end of the box, cells a metre, and the number of cells.
    `counts` holds 32-bit numbers, two in each entry: of each cell, the last axis fastest, and after
    them of what falls outside.
    """
    scratch = np.empty(BLOCK)
    i_ = get_pointer(ints)
    f_ = get_pointer(floats)
    keys_ = get_pointer(keys)
    bounds_ = get_pointer(bounds)
    counts_ = get_pointer(counts)
    cells = get_pointer(scratch)
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
            x, y, z = draw_lane_positions(i_, f_, keys_, bounds_, first + start + lane)
            x = round_entries_down((x - low_x) * by_x)
            y = round_entries_down((y - low_y) * by_y)
            z = round_entries_down((z - low_z) * by_z)
            cell = (x * ny + y) * nz + z
            # NaN is neither above nor below, and so outside
            cell = select_where(x > -0.5, select_where(nx - 0.5 > x, cell, outside), outside)
            cell = select_where(y > -0.5, select_where(ny - 0.5 > y, cell, outside), outside)
            cell = select_where(z > -0.5, select_where(nz - 0.5 > z, cell, outside), outside)
            store_value(cells, lane, cell)
        for k in range(stop):
            prefetch_count(counts_, np.int64(cells[k]))
        for k in range(stop):
            increment_count(counts_, np.int64(cells[k]))
    keep_alive(scratch)
