"""Null vectors of the 12x12 matrix at a root, and the angles of the two joints that they stand for."""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.scratch import beyond
from kempe.kernels.base.vectors import LANES, load_lanes, store
from kempe.kernels.elimination.elimination_pencil import (
    FLOOR,
    ROOT_1_2,
    ROOT_1_3,
    ROW,
    SIZE,
    largest_entry,
)

ALIKE = 1e-6
"""Pivots below this, relative to the first, count as zero where a second null vector is looked
for."""


@device
def clear(m, row, column):
    """Divide a row by its pivot and clear the pivot's column in the others."""
    over = 1.0 / m[row * ROW + column]
    for c in range(0, ROW, LANES):
        store(m, row * ROW + c, over * load_lanes(m, row * ROW + c))
    for i in range(SIZE):
        if i != row:
            f = m[i * ROW + column]
            for c in range(0, ROW, LANES):
                store(m, i * ROW + c, load_lanes(m, i * ROW + c) - f * load_lanes(m, row * ROW + c))


@device
def vector(m, order, steps, column, x):
    """Write the vector that m, reduced by `steps` pivots, takes to zero: 1 at `column`, 0 at the
    others left over.
    """
    for j in range(ROW):
        x[j] = 0.0
    x[column] = 1.0
    for k in range(steps):
        x[int(order[2 * k])] = -m[int(order[2 * k + 1]) * ROW + column]


@routine
def null_vectors(m, mask, order, x):
    """(vectors, third last pivot, last but one), over the first; writes one null vector, or two at
    x and x + ROW.

    Gauss-Jordan elimination with complete pivoting of m (12 rows of stride ROW, lost). The matrix
    is known to be singular: a second vector is written where the last but one pivot is below ALIKE.
    mask: 2 ROW numbers. order: 2 SIZE numbers.
    """
    for j in range(ROW):
        mask[j] = 1.0 if j < SIZE else 0.0
        mask[ROW + j] = 1.0
    first = third = second = 0.0
    vectors = 1
    for k in range(SIZE - 1):
        best, row, column = largest_entry(m, m, mask)
        size = math.sqrt(max(best, 0.0))
        if k == 0:
            first = max(size, FLOOR)
        third = second
        second = size
        if k == SIZE - 2 and not size > ALIKE * first:
            vectors = 2
            break
        if not size > 0.0:
            return 0, 0.0, 0.0
        order[2 * k] = float(column)
        order[2 * k + 1] = float(row)
        mask[column] = 0.0
        mask[ROW + row] = 0.0
        clear(m, row, column)
    left = 0
    for c in range(SIZE):
        if mask[c] != 0.0 and left < vectors:
            vector(m, order, SIZE - vectors, c, beyond(x, ROW * left))
            left += 1
    return vectors, third / first, second / first


@routine
def angles_of(x):
    """(angle of a, angle of b, defect) that the null vector x stands for; slides as 2 atan d.

    x[3 i + j] is (u^3, sqrt(3) u^2 w, sqrt(3) u w^2, w^3)_i of joint a times (u^2, sqrt(2) u w,
    w^2)_j of joint b. Of vectors (u, w) along one line with a = sum u u, b = sum u w and d = sum w
    w, (a - d, 2 b) points to twice the line's angle. So all ratios count and none is divided out: a
    joint at pi is as good as any other. The defect is how far the vectors are from one line, 0 to
    1/2: that of a posture is 0.
    """
    a = b = d = 0.0
    for j in range(3):
        m0 = x[j]
        m1 = ROOT_1_3 * x[3 + j]
        m2 = ROOT_1_3 * x[6 + j]
        m3 = x[9 + j]
        a += m0 * m0 + 2.0 * m1 * m1 + m2 * m2
        b += m0 * m1 + 2.0 * m1 * m2 + m2 * m3
        d += m1 * m1 + 2.0 * m2 * m2 + m3 * m3
    first = math.atan2(2.0 * b, a - d)
    across = (a * d - b * b) / ((a + d) * (a + d) + FLOOR)
    a = b = d = 0.0
    for i in range(4):
        n0 = x[3 * i]
        n1 = ROOT_1_2 * x[3 * i + 1]
        n2 = x[3 * i + 2]
        a += n0 * n0 + n1 * n1
        b += n0 * n1 + n1 * n2
        d += n1 * n1 + n2 * n2
    across = max(across, (a * d - b * b) / ((a + d) * (a + d) + FLOOR))
    return first, math.atan2(2.0 * b, a - d), math.sqrt(max(across, 0.0))


@device
def entry_of_a(x, i, j):
    """(u part, w part) of null vector x at place i < 3 of joint a's cubic form, j < 3 of b's
    quadratic form.
    """
    left = x[3 * i + j] if i == 0 else ROOT_1_3 * x[3 * i + j]
    right = x[3 * i + 3 + j] if i == 2 else ROOT_1_3 * x[3 * i + 3 + j]
    return left, right


@device
def entry_of_b(x, i, j):
    """(u part, w part) of null vector x at place i < 4 of joint a's cubic form, j < 2 of b's
    quadratic form.
    """
    left = x[3 * i] if j == 0 else ROOT_1_2 * x[3 * i + 1]
    right = ROOT_1_2 * x[3 * i + 1] if j == 0 else x[3 * i + 2]
    return left, right


@routine
def _products(x, joint, out):
    """Write U^T U, U^T W and W^T W (2x2 each) of two null vectors' u and w parts, for joint a (0)
    or b (1).
    """
    y = beyond(x, ROW)
    for k in range(12):
        out[k] = 0.0
    for i in range(3 if joint == 0 else 4):
        for j in range(3 if joint == 0 else 2):
            if joint == 0:
                u0, w0 = entry_of_a(x, i, j)
                u1, w1 = entry_of_a(y, i, j)
                f = 2.0 if i == 1 else 1.0
            else:
                u0, w0 = entry_of_b(x, i, j)
                u1, w1 = entry_of_b(y, i, j)
                f = 1.0
            out[0] = out[0] + f * u0 * u0
            out[1] = out[1] + f * u0 * u1
            out[3] = out[3] + f * u1 * u1
            out[4] = out[4] + f * u0 * w0
            out[5] = out[5] + f * u0 * w1
            out[6] = out[6] + f * u1 * w0
            out[7] = out[7] + f * u1 * w1
            out[8] = out[8] + f * w0 * w0
            out[9] = out[9] + f * w0 * w1
            out[11] = out[11] + f * w1 * w1
    out[2] = out[1]
    out[10] = out[9]


@device
def _pencil(products, c, s, out):
    """Condition of the projection on (c U + s W); writes (c U + s W)^T U and (c U + s W)^T W, 2x2
    each.
    """
    for i in range(2):
        for j in range(2):
            uw = products[4 + 2 * i + j]
            wu = products[4 + 2 * j + i]
            out[2 * i + j] = c * products[2 * i + j] + s * wu
            out[4 + 2 * i + j] = c * uw + s * products[8 + 2 * i + j]
    # (c U + s W)^T (c U + s W)
    a = c * out[0] + s * out[4]
    b = c * out[1] + s * out[5]
    d = c * out[3] + s * out[7]
    return (a * d - b * b) / ((a + d) * (a + d) + FLOOR)


@routine
def split(x, work):
    """(vectors, separation): two null vectors become the real products of forms that lie in their
    plane, if any.

    In the plane of x and x + ROW lie the vectors of the two roots, y_0 x_0 + y_1 x_1 with w U y = u
    W y for joint a or b, where U and W are the vectors' u and w parts: a 2x2 pencil. Complex roots
    belong to no posture. The separation is the pencil's discriminant, over what it can be: near 0
    the two cannot be distinguished. work: 64 numbers.
    """
    best = -1.0
    separation = 0.0
    joint = 0
    for k in range(2):
        _products(x, k, work)
        for trial in range(3):
            half = 0.3 + trial * math.pi / 3.0
            condition = _pencil(work, math.cos(half), math.sin(half), beyond(work, 12))
            if condition > best or trial == 0:
                best = condition
                for i in range(8):
                    work[20 + 8 * k + i] = work[12 + i]
        alpha, beta, gamma = _quadratic(beyond(work, 20 + 8 * k))
        size = beta * beta + 2.0 * alpha * alpha + 2.0 * gamma * gamma + FLOOR
        value = (beta * beta - 4.0 * alpha * gamma) / size
        if abs(value) > abs(separation):
            separation = value
            joint = k
    if not separation > 0.0:
        return 0, -separation
    m = beyond(work, 20 + 8 * joint)
    alpha, beta, gamma = _quadratic(m)
    # alpha w^2 + beta u w + gamma u^2 = 0: (u, w) = (2 alpha, q) and (q, 2 gamma), without
    # cancellation
    root = math.sqrt(beta * beta - 4.0 * alpha * gamma)
    q = -beta - root if beta > 0.0 else -beta + root
    _combine(x, m, 2.0 * alpha, q, work)
    _combine(x, m, q, 2.0 * gamma, beyond(work, ROW + 24))
    for j in range(SIZE):
        x[j] = work[j]
        x[ROW + j] = work[ROW + 24 + j]
    return 2, separation


@device
def _quadratic(m):
    """Coefficients of w^2, u w and u^2 in the determinant of w m[0:4] - u m[4:8]."""
    return (
        m[0] * m[3] - m[1] * m[2],
        m[1] * m[6] + m[2] * m[5] - m[0] * m[7] - m[3] * m[4],
        m[4] * m[7] - m[5] * m[6],
    )


@device
def _combine(x, m, u, w, out):
    """Write y_0 x + y_1 (x + ROW), where (w m[0:4] - u m[4:8]) y = 0."""
    a = w * m[0] - u * m[4]
    b = w * m[1] - u * m[5]
    c = w * m[2] - u * m[6]
    d = w * m[3] - u * m[7]
    first = a * a + b * b > c * c + d * d
    y0, y1 = (-b, a) if first else (-d, c)
    size = math.sqrt(y0 * y0 + y1 * y1) + FLOOR
    y0 = y0 / size
    y1 = y1 / size
    for j in range(SIZE):
        out[j] = y0 * x[j] + y1 * x[ROW + j]
