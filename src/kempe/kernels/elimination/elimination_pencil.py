"""The 12x12 matrix P u^2 + Q u w + R w^2 of the hidden joint, and the matrix whose eigenvalues are
its roots.

A turn by x stands as (u, w) = (cos x/2, sin x/2), a slide by d as w/u = d: in both cases a sample
is a quadratic form in (u, w), and nothing is lost at x = pi. The six equations are quadratic forms
in the other two joints a and b of the triple. Times u_a and times w_a they are twelve equations in
the twelve products of a cubic form in a and a quadratic one in b (dialytic elimination, Raghavan
and Roth 1990). With the bases u^3, sqrt(3) u^2 w, ... and u^2, sqrt(2) u w, w^2 a change of a
joint's zero turns the unknowns without stretching them.

With w = t u the roots are the eigenvalues of a 24x24 companion matrix (Manocha and Canny 1994,
"Efficient inverse kinematics for general 6R manipulators"). If the triple's outer joint (X_1) is
hidden and turns, t = i and t = -i belong to no posture and are there four times each: an invariant
subspace of dimension eight, known from the null space of a complex 12x12 matrix. The quotient by it
is a 16x16 matrix, which `write_companion_matrix` writes down at once. If another joint is hidden,
the eight roots too many are anywhere off the real axis, and the matrix keeps its 24 rows.
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.row_reduction import find_lane, find_maximum
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import (
    LANES,
    extract_entry,
    load_lanes,
    select_where,
    spread_lanes,
    store_value,
)
from kempe.kernels.elimination.elimination_loop import (
    EQUATIONS,
    IS_SLIDE,
    LINE_STRIDE,
    SAMPLE_STRIDE,
    TRIPLE,
)

SIZE = 12
ROW = 16
"""Rows of the matrix, and their stride."""

P = 0
Q = SIZE * ROW
R = 2 * SIZE * ROW
FORMS = 3 * SIZE * ROW
"""Places of the three matrices, and numbers of all."""

WIDE = 40
"""Stride of the leading matrix with its right-hand sides, which start at column ROW."""

STRIDE = 24
"""Stride of the companion matrix."""

LOST = 4
"""Null vectors at t = i of a hidden turn."""

LOST_FLOOR = 1e-6
"""Pivot ratio at t = i below which a vector counts as null."""

FLOOR = 1e-300
"""What pivots are compared with where all is zero."""

ROOT_1_3 = math.sqrt(1.0 / 3.0)
ROOT_2_3 = math.sqrt(2.0 / 3.0)
ROOT_1_2 = math.sqrt(0.5)


@device
def _convert_to_forms(t, k, step, slides, factor):
    """Turn the samples t[k], t[k + step], t[k + 2 step] of a joint into its quadratic form's
    coefficients, in place.
    """
    a = t[k]
    b = t[k + step]
    c = t[k + 2 * step]
    if slides:
        t[k + step] = 0.5 * (b - c) * factor
        t[k + 2 * step] = 0.5 * (b + c) - a
    else:
        t[k + step] = (2.0 * b - a - c) * factor


@device
def compute_power_of_three(k):
    """Return 3^k for k = 0, 1, 2."""
    return 1 + 2 * k + 2 * k * (k - 1)


@routine
def assemble_pencil(table, loop, hidden, forms):
    """Write P, Q, R (FORMS numbers): rows u_a, w_a times six equations, columns 3 i + j of cubic i,
    quadratic j.
    """
    a = 1 if hidden == 0 else 0
    b = 1 if hidden == 2 else 2
    hs = compute_power_of_three(hidden)
    as_ = compute_power_of_three(a)
    bs = compute_power_of_three(b)
    slides_h = loop[TRIPLE + LINE_STRIDE * hidden + IS_SLIDE] != 0.0
    slides_a = loop[TRIPLE + LINE_STRIDE * a + IS_SLIDE] != 0.0
    slides_b = loop[TRIPLE + LINE_STRIDE * b + IS_SLIDE] != 0.0
    for i in range(FORMS):
        forms[i] = 0.0
    for e in range(6):
        t = advance_pointer(table, (EQUATIONS - 6 + e) * SAMPLE_STRIDE)
        for i in range(3):
            for j in range(3):
                _convert_to_forms(t, i * as_ + j * bs, hs, slides_h, 1.0)
        for i in range(3):
            for j in range(3):
                _convert_to_forms(t, i * hs + j * bs, as_, slides_a, ROOT_1_2)
        for i in range(3):
            for j in range(3):
                _convert_to_forms(t, i * hs + j * as_, bs, slides_b, ROOT_1_2)
        for i in range(3):
            m = advance_pointer(forms, i * SIZE * ROW + e * ROW)
            for j in range(3):
                c0 = t[i * hs + j * bs]
                c1 = t[i * hs + as_ + j * bs]
                c2 = t[i * hs + 2 * as_ + j * bs]
                m[j], m[3 + j], m[6 + j] = c0, ROOT_2_3 * c1, ROOT_1_3 * c2
                n = 6 * ROW + j
                m[n + 3], m[n + 6], m[n + 9] = ROOT_1_3 * c0, ROOT_2_3 * c1, c2


@device
def evaluate_pencil(forms, u, w, out):
    """Write P u^2 + Q u w + R w^2 (12 rows of stride ROW)."""
    uu = u * u
    uw = u * w
    ww = w * w
    for i in range(0, SIZE * ROW, LANES):
        store_value(
            out,
            i,
            uu * load_lanes(forms, i)
            + uw * load_lanes(forms, Q + i)
            + ww * load_lanes(forms, R + i),
        )


@routine
def compute_pivot_ratio(m):
    """Return the ratio of least to largest pivot of the matrix m (12 rows of stride ROW), which is
    lost: 0 if it is singular.
    """
    least = math.inf
    largest = 0.0
    for k in range(SIZE):
        best = -1.0
        place = k
        for i in range(k, SIZE):
            size = abs(m[i * ROW + k])
            if size > best:
                best = size
                place = i
        if not best > 0.0:
            return 0.0
        least = min(least, best)
        largest = max(largest, best)
        if place != k:
            for c in range(0, ROW, LANES):
                x = load_lanes(m, k * ROW + c)
                store_value(m, k * ROW + c, load_lanes(m, place * ROW + c))
                store_value(m, place * ROW + c, x)
        over = 1.0 / m[k * ROW + k]
        for i in range(k + 1, SIZE):
            f = m[i * ROW + k] * over
            for c in range(0, ROW, LANES):
                store_value(
                    m, i * ROW + c, load_lanes(m, i * ROW + c) - f * load_lanes(m, k * ROW + c)
                )
    return least / largest


@routine
def find_vectors_at_i(forms, re, im, free, mask):
    """Reduce the matrix P - R + i Q to find its null vectors; return whether it has LOST of them.

    Gauss-Jordan elimination with complete pivoting, SIZE - LOST steps, on re and im (12 rows of
    stride ROW each). free: 2 * SIZE numbers: for each step its pivot's column and row, then the
    columns left over, then none. mask: ROW numbers. Afterwards x_column = - sum over free columns f
    of row[f] x_f: pivot rows have been divided.
    """
    for i in range(0, SIZE * ROW, LANES):
        store_value(re, i, load_lanes(forms, P + i) - load_lanes(forms, R + i))
        store_value(im, i, load_lanes(forms, Q + i))
    for j in range(ROW):
        mask[j] = 1.0 if j < SIZE else 0.0
        mask[ROW + j] = 1.0
    first = 0.0
    steps = SIZE - LOST
    for k in range(steps + 1):
        best, row, column = find_largest_entry(re, im, mask)
        if k == 0:
            first = max(best, FLOOR)
        if k == steps or not best > 0.0:
            j = k
            for c in range(SIZE):
                if mask[c] != 0.0 and j < SIZE:
                    free[2 * j] = float(c)
                    j += 1
            return k == steps and math.sqrt(best / first) < LOST_FLOOR
        free[2 * k] = float(column)
        free[2 * k + 1] = float(row)
        mask[column] = 0.0
        mask[ROW + row] = 0.0
        _divide_row(re, im, row, re[row * ROW + column], im[row * ROW + column])
        for i in range(SIZE):
            if i != row:
                fr = re[i * ROW + column]
                fi = im[i * ROW + column]
                for c in range(0, ROW, LANES):
                    pr = load_lanes(re, row * ROW + c)
                    pi = load_lanes(im, row * ROW + c)
                    store_value(re, i * ROW + c, load_lanes(re, i * ROW + c) - fr * pr + fi * pi)
                    store_value(im, i * ROW + c, load_lanes(im, i * ROW + c) - fr * pi - fi * pr)
    return False


@device
def _divide_row(re, im, row, x, y):
    """Divide a row by x + i y."""
    size = 1.0 / (x * x + y * y)
    x = x * size
    y = -y * size
    for c in range(0, ROW, LANES):
        a = load_lanes(re, row * ROW + c)
        b = load_lanes(im, row * ROW + c)
        store_value(re, row * ROW + c, x * a - y * b)
        store_value(im, row * ROW + c, x * b + y * a)


@device
def find_largest_entry(re, im, mask):
    """Return (squared size, row, column) of the largest entry in the rows and columns that the mask
    (2 ROW numbers) leaves.
    """
    best = spread_lanes(-1.0)
    place = spread_lanes(0.0)
    for i in range(SIZE):
        if mask[ROW + i] != 0.0:
            for c in range(0, ROW, LANES):
                x = load_lanes(re, i * ROW + c)
                y = load_lanes(im, i * ROW + c)
                size = (x * x + y * y) * load_lanes(mask, c)
                better = size > best
                best = select_where(better, size, best)
                place = select_where(better, float(i * ROW + c), place)
    size = find_maximum(best)
    lane = min(find_lane(best, size), LANES - 1)
    place = int(extract_entry(place, lane)) + lane
    return size, place // ROW, place % ROW


@routine
def solve_leading_matrix(forms, c, s, kept, count, wide):
    """Pivot ratio of the leading matrix with the joint's zero moved; writes H = -R'^-1 [P' Q']
    right of it.

    (u, w) = (c u' - s w', s u' + c w'). kept: `count` columns of P' and of Q', 2 numbers apart.
    wide: 12 rows of stride WIDE; H starts at column ROW.
    """
    cc = c * c
    cs = c * s
    ss = s * s
    for i in range(SIZE):
        for j in range(SIZE):
            k = i * ROW + j
            wide[i * WIDE + j] = forms[P + k] * ss - forms[Q + k] * cs + forms[R + k] * cc
        for j in range(count):
            k = i * ROW + int(kept[2 * j])
            p = forms[P + k]
            q = forms[Q + k]
            r = forms[R + k]
            wide[i * WIDE + ROW + j] = -(p * cc + q * cs + r * ss)
            wide[i * WIDE + ROW + count + j] = -(2.0 * cs * (r - p) + q * (cc - ss))
    width = ROW + 2 * count
    least = math.inf
    largest = FLOOR
    for k in range(SIZE):
        best = -1.0
        place = k
        for i in range(k, SIZE):
            size = abs(wide[i * WIDE + k])
            if size > best:
                best = size
                place = i
        if not best > 0.0:
            return 0.0
        least = min(least, best)
        largest = max(largest, best)
        if place != k:
            for j in range(0, width, LANES):
                x = load_lanes(wide, k * WIDE + j)
                store_value(wide, k * WIDE + j, load_lanes(wide, place * WIDE + j))
                store_value(wide, place * WIDE + j, x)
        over = 1.0 / wide[k * WIDE + k]
        for i in range(k + 1, SIZE):
            f = wide[i * WIDE + k] * over
            for j in range(k // LANES * LANES, width, LANES):
                store_value(
                    wide,
                    i * WIDE + j,
                    load_lanes(wide, i * WIDE + j) - f * load_lanes(wide, k * WIDE + j),
                )
    _substitute_back(wide, width)
    return least / largest


@device
def _substitute_back(wide, width):
    """Solve the triangular system in `wide` for the columns from ROW on."""
    for back in range(SIZE):
        k = SIZE - 1 - back
        over = 1.0 / wide[k * WIDE + k]
        for j in range(ROW, width, LANES):
            x = load_lanes(wide, k * WIDE + j) * over
            store_value(wide, k * WIDE + j, x)
            for i in range(k):
                store_value(
                    wide, i * WIDE + j, load_lanes(wide, i * WIDE + j) - wide[i * WIDE + k] * x
                )


@routine
def write_companion_matrix(wide, re, im, free, lost, a):
    """Write the companion matrix, 2 (12 - lost) rows of stride STRIDE, without the `lost` null
    vectors at t = i.

    On null vectors x + i y, unit at the `lost` free columns f and Z elsewhere, the matrix [0 1; H]
    has the invariant subspace spanned by [x; -y] and [y; x]. In the quotient an upper unknown n
    loses Re Z_n x_f + Im Z_n y_f, a lower one Re Z_n y_f - Im Z_n x_f: so all unknowns f vanish.
    """
    count = SIZE - lost
    for i in range(count):
        n = int(free[2 * i])
        row = int(free[2 * i + 1]) if lost > 0 else 0
        for j in range(0, 2 * count, LANES):
            upper = spread_lanes(0.0)
            lower = load_lanes(wide, n * WIDE + ROW + j)
            for m in range(count, SIZE):
                f = int(free[2 * m])
                h = load_lanes(wide, f * WIDE + ROW + j)
                upper = upper + im[row * ROW + f] * h
                lower = lower + re[row * ROW + f] * h
            store_value(a, i * STRIDE + j, upper)
            store_value(a, (count + i) * STRIDE + j, lower)
    for i in range(count):
        a[i * STRIDE + count + i] += 1.0


# ---- elimination null

# Null vectors of the 12x12 matrix at a root, and the angles of the two joints that they stand for.


ALIKE = 1e-6
"""Pivots below this, relative to the first, count as zero where a second null vector is looked
for."""


@device
def clear_column(m, row, column):
    """Divide a row by its pivot and clear the pivot's column in the others."""
    over = 1.0 / m[row * ROW + column]
    for c in range(0, ROW, LANES):
        store_value(m, row * ROW + c, over * load_lanes(m, row * ROW + c))
    for i in range(SIZE):
        if i != row:
            f = m[i * ROW + column]
            for c in range(0, ROW, LANES):
                store_value(
                    m, i * ROW + c, load_lanes(m, i * ROW + c) - f * load_lanes(m, row * ROW + c)
                )


@device
def write_null_vector(m, order, steps, column, x):
    """Write the vector that m, reduced by `steps` pivots, takes to zero: 1 at `column`, 0 at the
    others left over.
    """
    for j in range(ROW):
        x[j] = 0.0
    x[column] = 1.0
    for k in range(steps):
        x[int(order[2 * k])] = -m[int(order[2 * k + 1]) * ROW + column]


@routine
def find_null_vectors(m, mask, order, x):
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
        best, row, column = find_largest_entry(m, m, mask)
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
        clear_column(m, row, column)
    left = 0
    for c in range(SIZE):
        if mask[c] != 0.0 and left < vectors:
            write_null_vector(m, order, SIZE - vectors, c, advance_pointer(x, ROW * left))
            left += 1
    return vectors, third / first, second / first


@routine
def read_angles(x):
    """Return (angle of a, angle of b, defect) that the null vector x stands for; a slide d is the
    angle 2 atan d.

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
def read_a_entry(x, i, j):
    """Return (u part, w part) of null vector x at place i < 3 of joint a's cubic form, j < 3 of b's
    quadratic form.
    """
    left = x[3 * i + j] if i == 0 else ROOT_1_3 * x[3 * i + j]
    right = x[3 * i + 3 + j] if i == 2 else ROOT_1_3 * x[3 * i + 3 + j]
    return left, right


@device
def read_b_entry(x, i, j):
    """Return (u part, w part) of null vector x at place i < 4 of joint a's cubic form, j < 2 of b's
    quadratic form.
    """
    left = x[3 * i] if j == 0 else ROOT_1_2 * x[3 * i + 1]
    right = ROOT_1_2 * x[3 * i + 1] if j == 0 else x[3 * i + 2]
    return left, right


@routine
def _write_products(x, joint, out):
    """Write U^T U, U^T W and W^T W (2x2 each) of two null vectors' u and w parts, for joint a (0)
    or b (1).
    """
    y = advance_pointer(x, ROW)
    for k in range(12):
        out[k] = 0.0
    for i in range(3 if joint == 0 else 4):
        for j in range(3 if joint == 0 else 2):
            if joint == 0:
                u0, w0 = read_a_entry(x, i, j)
                u1, w1 = read_a_entry(y, i, j)
                f = 2.0 if i == 1 else 1.0
            else:
                u0, w0 = read_b_entry(x, i, j)
                u1, w1 = read_b_entry(y, i, j)
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
def _project_pencil(products, c, s, out):
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
def split_null_vectors(x, work):
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
        _write_products(x, k, work)
        for trial in range(3):
            half = 0.3 + trial * math.pi / 3.0
            condition = _project_pencil(
                work, math.cos(half), math.sin(half), advance_pointer(work, 12)
            )
            if condition > best or trial == 0:
                best = condition
                for i in range(8):
                    work[20 + 8 * k + i] = work[12 + i]
        alpha, beta, gamma = _expand_determinant(advance_pointer(work, 20 + 8 * k))
        size = beta * beta + 2.0 * alpha * alpha + 2.0 * gamma * gamma + FLOOR
        value = (beta * beta - 4.0 * alpha * gamma) / size
        if abs(value) > abs(separation):
            separation = value
            joint = k
    if not separation > 0.0:
        return 0, -separation
    m = advance_pointer(work, 20 + 8 * joint)
    alpha, beta, gamma = _expand_determinant(m)
    # alpha w^2 + beta u w + gamma u^2 = 0: (u, w) = (2 alpha, q) and (q, 2 gamma), without
    # cancellation
    root = math.sqrt(beta * beta - 4.0 * alpha * gamma)
    q = -beta - root if beta > 0.0 else -beta + root
    _combine_vectors(x, m, 2.0 * alpha, q, work)
    _combine_vectors(x, m, q, 2.0 * gamma, advance_pointer(work, ROW + 24))
    for j in range(SIZE):
        x[j] = work[j]
        x[ROW + j] = work[ROW + 24 + j]
    return 2, separation


@device
def _expand_determinant(m):
    """Return the coefficients of w^2, u w and u^2 in the determinant of w m[0:4] - u m[4:8]."""
    return (
        m[0] * m[3] - m[1] * m[2],
        m[1] * m[6] + m[2] * m[5] - m[0] * m[7] - m[3] * m[4],
        m[4] * m[7] - m[5] * m[6],
    )


@device
def _combine_vectors(x, m, u, w, out):
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
