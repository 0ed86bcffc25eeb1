"""Several postures that share the hidden joint's value: their null vectors, from the whole null
space at once.

At a value that m roots share the null space of the 12x12 matrix has up to m dimensions, and its
vectors are mixtures of those of the postures. On the postures' own vectors v it holds that W v = x
U v, where U and W are the u and the w part of joint a (or b) and x = w/u its value there: so in the
null space N the matrix (U N)^+ W N has the values as eigenvalues and the postures' mixtures as
eigenvectors. A combination of the two joints' matrices tells postures apart that share one of the
values (Moeller and Stetter 1995, "Multivariate polynomial equations with multiple zeros solved by
matrix eigenproblems").
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.eigen import EIGEN_SCRATCH, eigenvalues
from kempe.kernels.base.scratch import beyond
from kempe.kernels.elimination.elimination_null import clear, entry_of_a, entry_of_b, vector
from kempe.kernels.elimination.elimination_pencil import FLOOR, ROW, SIZE, largest_entry

MOST = 8
"""Dimensions of a null space at most."""

PLACES = 3
"""Zeros of a joint that are tried: none of the values may be at infinity."""

MIX = 0.7548776662466927
"""What the second joint's matrix is weighed with: no special number."""

REAL = 1e-4
"""Imaginary part of an eigenvalue, relative to its size, up to which the real part is tried."""

_SPACE = 0
_MATRIX = MOST * ROW
_WORK = _MATRIX + 2 * MOST * ROW
_VALUES = _WORK + 3 * MOST * ROW
CLUSTER_SCRATCH = _VALUES + 2 * MOST + EIGEN_SCRATCH + ROW
"""Numbers of scratch that `postures_at` needs."""


@routine
def null_space(m, count, mask, order, x):
    """(largest entry left over, last pivot), over the first pivot; writes `count` null vectors, ROW
    numbers each.

    Gauss-Jordan elimination with complete pivoting of m (12 rows of stride ROW, lost), SIZE - count
    steps. mask: 2 ROW numbers. order: 2 SIZE numbers.
    """
    for j in range(ROW):
        mask[j] = 1.0 if j < SIZE else 0.0
        mask[ROW + j] = 1.0
    first = last = 0.0
    for k in range(SIZE - count):
        best, row, column = largest_entry(m, m, mask)
        last = math.sqrt(max(best, 0.0))
        if k == 0:
            first = max(last, FLOOR)
        if not last > 0.0:
            return math.inf, 0.0
        order[2 * k] = float(column)
        order[2 * k + 1] = float(row)
        mask[column] = 0.0
        mask[ROW + row] = 0.0
        clear(m, row, column)
    best, _, _ = largest_entry(m, m, mask)
    left = 0
    for c in range(SIZE):
        if mask[c] != 0.0:
            vector(m, order, SIZE - count, c, beyond(x, ROW * left))
            left += 1
    return math.sqrt(max(best, 0.0)) / first, last / first


@device
def _entry(x, joint, i, j):
    """(u part, w part) of the vector x for joint a (0) or b (1)."""
    return entry_of_a(x, i, j) if joint == 0 else entry_of_b(x, i, j)


@routine
def _solved(a, b, n):
    """Least over largest pivot of the matrix a (n rows of stride ROW, lost); b becomes a^-1 b.
    Gauss-Jordan.
    """
    least = math.inf
    largest = 0.0
    for k in range(n):
        best = -1.0
        place = k
        for i in range(k, n):
            if abs(a[i * ROW + k]) > best:
                best = abs(a[i * ROW + k])
                place = i
        if not best > 0.0:
            return 0.0
        least = min(least, best)
        largest = max(largest, best)
        for c in range(n):
            a[k * ROW + c], a[place * ROW + c] = a[place * ROW + c], a[k * ROW + c]
            b[k * ROW + c], b[place * ROW + c] = b[place * ROW + c], b[k * ROW + c]
        over = 1.0 / a[k * ROW + k]
        for c in range(n):
            a[k * ROW + c] = a[k * ROW + c] * over
            b[k * ROW + c] = b[k * ROW + c] * over
        for i in range(n):
            f = a[i * ROW + k]
            for c in range(n if i != k else 0):
                a[i * ROW + c] -= f * a[k * ROW + c]
                b[i * ROW + c] -= f * b[k * ROW + c]
    return least / largest


@routine
def _values_of(space, n, joint, half, left, right):
    """Pivot ratio; `right` becomes the matrix of a joint's values w'/u', its zero moved by `half`:
    n rows of ROW.
    """
    c = math.cos(half)
    s = math.sin(half)
    for p in range(n):
        for q in range(n):
            left[p * ROW + q] = right[p * ROW + q] = 0.0
    for i in range(3 if joint == 0 else 4):
        for j in range(3 if joint == 0 else 2):
            f = 2.0 if joint == 0 and i == 1 else 1.0
            for p in range(n):
                u, w = _entry(beyond(space, ROW * p), joint, i, j)
                up = f * (c * u + s * w)
                for q in range(n):
                    u, w = _entry(beyond(space, ROW * q), joint, i, j)
                    left[p * ROW + q] += up * (c * u + s * w)
                    right[p * ROW + q] += up * (c * w - s * u)
    return _solved(left, right, n)


@routine
def _best_values(space, n, joint, out, work):
    """Pivot ratio; writes the matrix of a joint's values for the zero at which these are best
    determined.
    """
    best = -1.0
    for k in range(PLACES):
        left = work
        right = beyond(work, MOST * ROW)
        ratio = _values_of(space, n, joint, 0.3 + k * math.pi / PLACES, left, right)
        if ratio > best:
            best = ratio
            for i in range(n * ROW):
                out[i] = right[i]
    return best


@routine
def postures_at(m, count, mask, order, x, scratch):
    """(vectors, error, margin): writes a vector, ROW numbers, for each real posture among `count`
    roots at one value.

    The error is that of a null space of `count` dimensions; the margin is the least imaginary part
    of a posture that is complex, relative to its size, 1 where there is none. m: the 12x12 matrix
    there (12 rows of stride ROW, lost). x: count ROW numbers. mask, order: as of `null_space`.
    scratch: CLUSTER_SCRATCH numbers.
    """
    space = beyond(scratch, _SPACE)
    matrix = beyond(scratch, _MATRIX)
    work = beyond(scratch, _WORK)
    for i in range(CLUSTER_SCRATCH):
        scratch[i] = 0.0
    residue, last = null_space(m, count, mask, order, space)
    other = beyond(matrix, MOST * ROW)
    if not residue < last:
        return 0, math.inf, 0.0
    error = residue / last
    margin = 1.0
    if not (
        _best_values(space, count, 0, matrix, work) > 0.0
        and _best_values(space, count, 1, other, work) > 0.0
    ):
        return 0, math.inf, 0.0
    for i in range(count * ROW):
        matrix[i] += MIX * other[i]
        work[i] = matrix[i]
    re = beyond(scratch, _VALUES)
    im = beyond(scratch, _VALUES + MOST)
    if eigenvalues(work, count, ROW, re, im, beyond(scratch, _VALUES + 2 * MOST)) > 0:
        return 0, math.inf, 0.0
    vectors = 0
    for k in range(count):
        size = abs(im[k]) / (1.0 + abs(re[k]))
        if not size <= REAL:
            margin = min(margin, size)
            continue
        for i in range(count):
            for j in range(ROW):
                work[i * ROW + j] = matrix[i * ROW + j] if j < count else 0.0
            work[i * ROW + i] -= re[k]
        _combined(work, space, count, beyond(x, ROW * vectors))
        vectors += 1
    return vectors, error, margin


@device
def _combined(a, space, n, out):
    """Write the mixture of the space's vectors that the matrix a (n rows of stride ROW, lost) takes
    to zero.
    """
    y = beyond(a, MOST * ROW)
    order = beyond(a, MOST * ROW + ROW)
    for j in range(n):
        order[j] = -1.0
    taken = 0
    for _ in range(n - 1):
        best = 0.0
        row = -1
        column = -1
        for i in range(n):
            for j in range(n):
                size = abs(a[i * ROW + j])
                if order[j] < 0.0 and taken >> i & 1 == 0 and size > best:
                    best = size
                    row = i
                    column = j
        if row < 0:
            break
        order[column] = float(row)
        taken |= 1 << row
        over = 1.0 / a[row * ROW + column]
        for i in range(n):
            f = a[i * ROW + column] * over
            for j in range(n if i != row else 0):
                a[i * ROW + j] -= f * a[row * ROW + j]
    free = 0
    while free < n - 1 and order[free] >= 0.0:
        free += 1
    for j in range(n):
        row = int(order[j])
        y[j] = (1.0 if j == free else 0.0) if row < 0 else -a[row * ROW + free] / a[row * ROW + j]
    for j in range(SIZE):
        out[j] = 0.0
        for i in range(n):
            out[j] += y[i] * space[ROW * i + j]
