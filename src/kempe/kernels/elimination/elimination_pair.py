"""The pair and the removed joint once the triple is known."""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.row_reduction import total
from kempe.kernels.base.scratch import beyond
from kempe.kernels.base.trig import sincos
from kempe.kernels.base.vectors import LANES, load_lanes, store
from kempe.kernels.elimination.elimination_loop import (
    IS_SLIDE,
    LINE_STRIDE,
    NUMBER,
    PAIR,
    SOURCE,
    TARGET,
    TRIPLE,
    fan,
    fourteen,
    line_of,
)
from kempe.kernels.elimination.elimination_polish import JACOBIAN, TWIST, compare, trace

COLUMN = 16
"""Stride of the pair's columns: fourteen numbers, two zeros."""

NOTHING = 1e-18
"""Square of the size of a column beside the largest below which it tells nothing."""

PAIR_SIZE = 32 + 8 * COLUMN + 32
"""Numbers of scratch that the pair needs."""


@device
def _carry(line, theta, here):
    """Move the line here (l, p) by the joint's motion, in place."""
    hx = line[0]
    hy = line[1]
    hz = line[2]
    if line[IS_SLIDE] != 0.0:
        here[3] = here[3] + theta * hx
        here[4] = here[4] + theta * hy
        here[5] = here[5] + theta * hz
        return
    s, c = sincos(theta)
    v = 1.0 - c
    x = here[0]
    y = here[1]
    z = here[2]
    along = v * (hx * x + hy * y + hz * z)
    here[0] = along * hx + c * x + s * (hy * z - hz * y)
    here[1] = along * hy + c * y + s * (hz * x - hx * z)
    here[2] = along * hz + c * z + s * (hx * y - hy * x)
    x = here[3] - line[4]
    y = here[4] - line[5]
    z = here[5] - line[6]
    along = v * (hx * x + hy * y + hz * z)
    here[3] = line[4] + along * hx + c * x + s * (hy * z - hz * y)
    here[4] = line[5] + along * hy + c * y + s * (hz * x - hx * z)
    here[5] = line[6] + along * hz + c * z + s * (hx * y - hy * x)


@device
def _split(columns, slides, to, sign):
    """Turn three samples in columns 5, 6, 7 into coefficients in columns `to` and `to + 1`, and the
    constant in 4.
    """
    for i in range(0, COLUMN, LANES):
        f0 = load_lanes(columns, 5 * COLUMN + i)
        f1 = load_lanes(columns, 6 * COLUMN + i)
        f2 = load_lanes(columns, 7 * COLUMN + i)
        if slides:
            a = f0
            b = 0.5 * (f1 - f2)
            c = 0.5 * (f1 + f2) - f0
        else:
            a = 0.5 * (f0 + f2)
            b = 0.5 * (f0 - f2)
            c = f1 - a
        store(columns, to * COLUMN + i, sign * b)
        store(columns, (to + 1) * COLUMN + i, sign * c)
        store(columns, 4 * COLUMN + i, load_lanes(columns, 4 * COLUMN + i) - sign * a)


@device
def _dot(columns, j, k):
    """Product of columns j and k."""
    sum_ = load_lanes(columns, j * COLUMN) * load_lanes(columns, k * COLUMN)
    for i in range(LANES, COLUMN, LANES):
        sum_ = sum_ + load_lanes(columns, j * COLUMN + i) * load_lanes(columns, k * COLUMN + i)
    return total(sum_)


@routine
def _four(columns, y):
    """Least sine between a column and those before it; y: the four unknowns of columns 0 to 3
    against column 4.

    Modified Gram-Schmidt. A column that is next to nothing beside the largest counts by its size
    instead.
    """
    least = 1.0
    largest = 0.0
    for k in range(4):
        y[4 + k] = _dot(columns, k, k)
        largest = max(largest, y[4 + k])
    for k in range(4):
        size = _dot(columns, k, k)
        if not size > 0.0:
            return 0.0
        least = min(least, size / (y[4 + k] if y[4 + k] > NOTHING * largest else largest))
        for j in range(k + 1, 5):
            f = _dot(columns, k, j) / size
            y[8 + 5 * k + j] = f
            for i in range(0, COLUMN, LANES):
                x = load_lanes(columns, j * COLUMN + i) - f * load_lanes(columns, k * COLUMN + i)
                store(columns, j * COLUMN + i, x)
    for back in range(4):
        k = 3 - back
        value = y[8 + 5 * k + 4]
        for j in range(k + 1, 4):
            value -= y[8 + 5 * k + j] * y[j]
        y[k] = value
    return math.sqrt(least)


@routine
def pair_of(loop, theta, work):
    """How well the pair is determined, 0 to 1; writes its coordinates, given those of the triple.

    Y_2 (X_1 X_2 X_3 source) = Y_1^-1 target: fourteen equations that are linear in cosines and
    sines.
    """
    here = work
    fans = beyond(work, 8)
    columns = beyond(work, 32)
    y = beyond(columns, 8 * COLUMN)
    for i in range(8 * COLUMN):
        columns[i] = 0.0
    line_of(loop, SOURCE, here)
    for i in range(3):
        k = TRIPLE + LINE_STRIDE * (2 - i)
        _carry(beyond(loop, k), theta[int(loop[k + NUMBER])], here)
    for side in range(2):
        k = PAIR + LINE_STRIDE * (1 - side)
        if side == 1:
            line_of(loop, TARGET, here)
        sign = 1.0 - 2.0 * side
        fan(beyond(loop, k), sign, here, fans)
        for i in range(3):
            fourteen(beyond(fans, 6 * i), beyond(columns, (5 + i) * COLUMN), 1)
        _split(columns, loop[k + IS_SLIDE] != 0.0, 2 * side, sign)
    quality = _four(columns, y)
    for side in range(2):
        k = PAIR + LINE_STRIDE * (1 - side)
        a = y[2 * side]
        b = y[2 * side + 1]
        theta[int(loop[k + NUMBER])] = a if loop[k + IS_SLIDE] != 0.0 else math.atan2(b, a)
    return quality


@device
def removed_turn(kinds, lines, goal, removed, theta, work):
    """Angle of the removed turn, the others given: D = E(h, angle) where h is its axis as it
    stands.
    """
    theta[removed] = 0.0
    trace(kinds, lines, theta, work)
    _, trace_ = compare(goal, work)
    sine = 0.0
    for i in range(3):
        sine += work[JACOBIAN * i + removed] * work[JACOBIAN * i + TWIST]
    return math.atan2(2.0 * sine, trace_ - 1.0)
