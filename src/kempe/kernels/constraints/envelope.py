"""The matrix J J^T of packed loops within its envelope (Jennings, 1966), and its factors."""

from __future__ import annotations

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import extract_entry, load4, pack_four
from kempe.kernels.constraints import loop_layout as L


@device
def multiply_column(loops, v, y):
    """Return the product of column v of the scaled Jacobian with y."""
    plan = loops.plan
    total = 0.0
    at = plan[L.AT_VARS] + v
    for use in range(plan[at], plan[at + 1]):
        k = plan[L.AT_USES] + L.USE_INTS * use
        tie = plan[L.AT_TIES] + L.TIE_INTS * plan[k]
        rows = plan[tie + L.ROWS]
        first = plan[tie + L.FIRST_ROW]
        block = plan[tie + L.BLOCK] + rows * plan[k + 1]
        for i in range(rows):
            total += loops.blocks[block + i] * y[first + i]
    return total


@device
def add_product(loops, v, x, y, stride):
    """Add x times column v of the scaled Jacobian to every `stride`-th number of y; the others are
    not touched.
    """
    plan = loops.plan
    at = plan[L.AT_VARS] + v
    for use in range(plan[at], plan[at + 1]):
        k = plan[L.AT_USES] + L.USE_INTS * use
        tie = plan[L.AT_TIES] + L.TIE_INTS * plan[k]
        rows = plan[tie + L.ROWS]
        first = plan[tie + L.FIRST_ROW]
        block = plan[tie + L.BLOCK] + rows * plan[k + 1]
        for i in range(rows):
            y[stride * (first + i)] += loops.blocks[block + i] * x


@routine
def write_normal_matrix(loops, step, damping, a, column):
    """Write the lower triangle of J J^T + damping I, row by row within its envelope; without
    columns marked NaN.

    Each column is spread out first, so that the inner loop runs over neighbours.
    """
    plan = loops.plan
    blocks = loops.blocks
    for i in range(plan[L.ENVELOPE]):
        a[i] = 0.0
    rows_at = plan[L.AT_ROWS]
    ties_at = plan[L.AT_TIES]
    uses_at = plan[L.AT_USES]
    m = plan[L.N_ROWS]
    for i in range(m):
        column[i] = 0.0
        k = rows_at + L.ENVELOPE_INTS * i
        a[plan[k + 1] + i - plan[k]] = damping
    for v in range(loops.nv):
        if step[v] != step[v]:
            continue
        at = plan[L.AT_VARS] + v
        low = m
        high = 0
        for use in range(plan[at], plan[at + 1]):
            k = uses_at + L.USE_INTS * use
            tie = ties_at + L.TIE_INTS * plan[k]
            rows = plan[tie + L.ROWS]
            first = plan[tie + L.FIRST_ROW]
            block = plan[tie + L.BLOCK] + rows * plan[k + 1]
            for i in range(rows):
                column[first + i] = blocks[block + i]
            low = min(low, first)
            high = max(high, first + rows)
        for i in range(low, high):
            x = column[i]
            if x != 0.0:
                k = rows_at + L.ENVELOPE_INTS * i
                row = advance_pointer(a, plan[k + 1] + low - plan[k])
                there = advance_pointer(column, low)
                for j in range(i + 1 - low):
                    row[j] += x * there[j]
        for i in range(low, high):
            column[i] = 0.0


@device
def dot(a, b, n):
    """Return the scalar product of two arrays of n numbers, in four partial sums."""
    sums = pack_four(0.0, 0.0, 0.0, 0.0)
    whole = n & ~3
    for k in range(0, whole, 4):
        sums = sums + load4(a, k) * load4(b, k)
    total = (extract_entry(sums, 0) + extract_entry(sums, 1)) + (
        extract_entry(sums, 2) + extract_entry(sums, 3)
    )
    for k in range(whole, n):
        total += a[k] * b[k]
    return total


@routine
def factor_envelope(loops, a, least):
    """Overwrite the matrix by L and D, A = L D L^T; pivots below `least` are rounding and become
    it.
    """
    plan = loops.plan
    rows_at = plan[L.AT_ROWS]
    for i in range(plan[L.N_ROWS]):
        k = rows_at + L.ENVELOPE_INTS * i
        first = plan[k]
        row = plan[k + 1] - plan[k]
        for j in range(first + 1, i):
            k = rows_at + L.ENVELOPE_INTS * j
            start = max(first, plan[k])
            other = plan[k + 1] - plan[k]
            if start < j:  # L_ij D_j until the row is done
                a[row + j] -= dot(
                    advance_pointer(a, row + start), advance_pointer(a, other + start), j - start
                )
        d = a[row + i]
        for j in range(first, i):
            k = rows_at + L.ENVELOPE_INTS * j
            g = a[row + j]
            x = g / a[plan[k + 1] - plan[k] + j]
            a[row + j] = x
            d -= g * x
        a[row + i] = max(d, least)


@routine
def solve_envelope(loops, a, y):
    """Overwrite y by the solution of L D L^T x = y."""
    plan = loops.plan
    rows_at = plan[L.AT_ROWS]
    m = plan[L.N_ROWS]
    for i in range(m):
        k = rows_at + L.ENVELOPE_INTS * i
        first = plan[k]
        row = plan[k + 1] - plan[k]
        s = y[i]
        for j in range(first, i):
            s -= a[row + j] * y[j]
        y[i] = s
    for back_ in range(m):
        i = m - 1 - back_
        k = rows_at + L.ENVELOPE_INTS * i
        y[i] /= a[plan[k + 1] - plan[k] + i]
    for back_ in range(m):
        i = m - 1 - back_
        k = rows_at + L.ENVELOPE_INTS * i
        first = plan[k]
        row = plan[k + 1] - plan[k]
        s = y[i]
        for j in range(first, i):
            y[j] -= a[row + j] * s
