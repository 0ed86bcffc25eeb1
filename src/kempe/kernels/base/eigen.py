"""Eigenvalues of small real matrices: balancing, Hessenberg form, QR steps with two shifts.

Up to some thirty rows the calls of a library cost more than the arithmetic. A matrix lies row by
row at a stride that is a multiple of eight; what follows a row must be finite, is read and written,
and means nothing: so rows are whole vectors.
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.row_reduction import sum_entries
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import LANES, load_lanes, select_where, spread_lanes, store_value

EPS = 2.220446049250313e-16
"""Spacing of the numbers at 1."""

LIMIT = 200
"""QR steps that one eigenvalue, or pair, may take; two to four are usual."""

LARGEST_SIZE = 32
"""Rows at most."""

TINY = 1e-140
SMALL = 1e-60
LARGE = 1e60
HUGE = 1e140
"""Between the outer two, squares neither vanish nor overflow; between the inner two, products of
four."""

SWEEPS = 8
"""Rounds of balancing at most; two or three are usual."""


@routine
def balance_matrix(a, n, stride):
    """Scale rows and columns by powers of two until their norms are alike; the diagonal and the
    eigenvalues do not change.

    Parlett and Reinsch 1969, "Balancing a matrix for calculation of eigenvalues and eigenvectors".
    """
    for _ in range(SWEEPS):
        done = True
        for i in range(n):
            row = column = 0.0
            for j in range(n):
                row += abs(a[i * stride + j])
                column += abs(a[j * stride + i])
            size = abs(a[i * stride + i])
            row = row - size
            column = column - size
            if not (row > 0.0 and column > 0.0 and row < HUGE and column < HUGE):
                continue
            before = row + column
            factor = 1.0
            while column < 0.5 * row:
                factor = 2.0 * factor
                column = 2.0 * column
                row = 0.5 * row
            while column > 2.0 * row:
                factor = 0.5 * factor
                column = 0.5 * column
                row = 2.0 * row
            if row + column < 0.95 * before:
                done = False
                for j in range(n):
                    a[i * stride + j] /= factor
                    a[j * stride + i] *= factor
        if done:
            break


@routine
def reduce_to_hessenberg(a, n, stride, v):
    """Overwrite a with a similar matrix that is zero below the first subdiagonal (Householder
    1958).

    v: scratch of LARGEST_SIZE numbers.
    """
    for i in range(LARGEST_SIZE):
        v[i] = 0.0
    for k in range(n - 2):
        v[k] = 0.0
        first = a[(k + 1) * stride + k]
        rest = 0.0
        for i in range(k + 2, n):
            x = a[i * stride + k]
            v[i] = x
            rest += x * x
        if rest == 0.0:
            v[k + 1] = 0.0
            continue
        size = math.sqrt(first * first + rest)
        size = -size if first > 0.0 else size
        v[k + 1] = first - size
        # the reflection is 1 - v v^T / half, and takes the column to (size, 0, 0, ...)
        half = size * (size - first)
        start = (k + 1) // LANES * LANES
        _apply_reflection(a, n, stride, v, k, start, 1.0 / half)
        a[(k + 1) * stride + k] = size
        for i in range(k + 2, n):
            a[i * stride + k] = 0.0


@routine
def _apply_reflection(a, n, stride, v, k, start, scale):
    """Apply 1 - scale v v^T from both sides to the columns from `start` on, v being zero up to
    entry k.
    """
    w = advance_pointer(v, LARGEST_SIZE)
    for c in range(start, n, LANES):
        sum_ = spread_lanes(0.0)
        for i in range(k + 1, n):
            sum_ = sum_ + v[i] * load_lanes(a, i * stride + c)
        store_value(w, c, sum_ * scale)
    for i in range(n):
        dot = spread_lanes(0.0)
        x = v[i]
        for c in range(start, n, LANES):
            row = load_lanes(a, i * stride + c) - x * load_lanes(w, c)
            store_value(a, i * stride + c, row)
            dot = dot + row * load_lanes(v, c)
        y = sum_entries(dot) * scale
        for c in range(start, n, LANES):
            store_value(a, i * stride + c, load_lanes(a, i * stride + c) - y * load_lanes(v, c))


@device
def _make_reflection(p, q, r):
    """Return (x, y, z, u, v, size) of the Householder reflection 1 - (x, y, z)^T (1, u, v) that
    takes (p, q, r) to (size, 0, 0).
    """
    square = p * p + q * q + r * r
    if not TINY * TINY < square < HUGE * HUGE:
        largest = max(abs(p), max(abs(q), abs(r)))
        if not largest > 0.0:
            return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        p = p / largest
        q = q / largest
        r = r / largest
        size = math.sqrt(p * p + q * q + r * r)
        size = -size if p > 0.0 else size
        head = p - size
        back = 1.0 / size
        return -head * back, -q * back, -r * back, q / head, r / head, size * largest
    size = math.sqrt(square)
    size = -size if p > 0.0 else size
    head = p - size
    back = 1.0 / size
    over = 1.0 / head
    return -head * back, -q * back, -r * back, q * over, r * over, size


@routine
def _take_qr_step(a, stride, low, high, x, y, w, numbers):
    """Take an implicit QR step on rows low to high, with two shifts of sum x + y and product x y -
    w (Francis 1961).
    """
    m = high - 2
    p = q = r = 0.0
    while m >= low:
        z = a[m * stride + m]
        down = a[(m + 1) * stride + m]
        p = (x - z) * (y - z) - w + a[m * stride + m + 1] * down
        q = (a[(m + 1) * stride + m + 1] - x - y + z) * down
        r = a[(m + 2) * stride + m + 1] * down
        if m == low:
            break
        # two small subdiagonal entries in a row: the step can start below them
        u = abs(a[m * stride + m - 1]) * (abs(q) + abs(r))
        v = abs(p) * (abs(a[(m - 1) * stride + m - 1]) + abs(z) + abs(a[(m + 1) * stride + m + 1]))
        if u < EPS * v:  # false where both are lost to underflow
            break
        m -= 1
    before = a[m * stride + m - 1] if m > low else 0.0
    for k in range(m, high - 1):
        f, g, h, u, v, size = _make_reflection(p, q, r)
        p, q, r = _chase_bulge(a, stride, low, high, k, f, g, h, u, v, numbers)
        if k > low:
            a[k * stride + k - 1] = size if k > m else before * (1.0 - f)
            a[(k + 1) * stride + k - 1] = 0.0
            a[(k + 2) * stride + k - 1] = 0.0
    k = high - 1
    f, g, h, u, v, size = _make_reflection(p, q, 0.0)
    for c in range(k // LANES * LANES, high + 1, LANES):
        i = k * stride + c
        a0 = load_lanes(a, i)
        a1 = load_lanes(a, i + stride)
        s = a0 + u * a1
        store_value(a, i, a0 - f * s)
        store_value(a, i + stride, a1 - g * s)
    if k > low:
        a[k * stride + k - 1] = size
        a[high * stride + k - 1] = 0.0
    for i in range(low, high + 1):
        s = a[i * stride + k] * f + a[i * stride + k + 1] * g
        a[i * stride + k] -= s
        a[i * stride + k + 1] -= s * u


@device
def _chase_bulge(a, stride, low, high, k, f, g, h, u, v, numbers):
    """Apply the reflection 1 - (f, g, h)^T (1, u, v) at row k from both sides, and return the
    entries that the next reflection clears.

    Rows k to k + 3, which the next step reads as vectors, are written as vectors: a vector read
    from memory that was just written number by number would have to wait. So their part of the
    reflection from the right is computed beforehand, from the corner that it needs. Columns left of
    k are zero there or set by the caller, those right of `high` are of no use.
    """
    i0 = k * stride + k
    i1 = i0 + stride
    i2 = i0 + 2 * stride
    i3 = i0 + 3 * stride
    x0 = a[i1]
    x1 = a[i1 + 1]
    x2 = a[i1 + 2]
    y0 = a[i2]
    y1 = a[i2 + 1]
    y2 = a[i2 + 2]
    s0 = a[i0] + u * x0 + v * y0
    s1 = a[i0 + 1] + u * x1 + v * y1
    s2 = a[i0 + 2] + u * x2 + v * y2
    t0 = (a[i0] - f * s0) * f + (a[i0 + 1] - f * s1) * g + (a[i0 + 2] - f * s2) * h
    x0 = x0 - g * s0
    y0 = y0 - h * s0
    t1 = x0 * f + (x1 - g * s1) * g + (x2 - g * s2) * h
    t2 = y0 * f + (y1 - h * s1) * g + (y2 - h * s2) * h
    more = k + 3 <= high
    t3 = a[i3 + 2] * h if more else 0.0
    for c in range(k // LANES * LANES, high + 1, LANES):
        i = k * stride + c
        place = load_lanes(numbers, c) - k
        row = select_where(
            place == 0.0,
            1.0,
            select_where(place == 1.0, u, select_where(place == 2.0, v, 0.0 * place)),
        )
        a0 = load_lanes(a, i)
        a1 = load_lanes(a, i + stride)
        a2 = load_lanes(a, i + 2 * stride)
        s = a0 + u * a1 + v * a2
        store_value(a, i, a0 - f * s - t0 * row)
        store_value(a, i + stride, a1 - g * s - t1 * row)
        store_value(a, i + 2 * stride, a2 - h * s - t2 * row)
        if more:
            store_value(a, i + 3 * stride, load_lanes(a, i + 3 * stride) - t3 * row)
    for i in range(low, k):
        s = a[i * stride + k] * f + a[i * stride + k + 1] * g + a[i * stride + k + 2] * h
        a[i * stride + k] -= s
        a[i * stride + k + 1] -= s * u
        a[i * stride + k + 2] -= s * v
    return x0 - t1, y0 - t2, -t3


@device
def _compute_block_eigenvalues(x, y, w):
    """Compute the eigenvalues of a 2x2 block with diagonal y, x and product w of the other two
    entries: real parts, then imaginary parts.
    """
    p = 0.5 * (y - x)
    q = p * p + w
    z = math.sqrt(abs(q))
    if q >= 0.0:
        z = p + z if p >= 0.0 else p - z
        first = x + z
        return first, (x - w / z if z != 0.0 else first), 0.0, 0.0
    return x + p, x + p, z, -z


@routine
def find_hessenberg_eigenvalues(a, n, stride, re, im, numbers):
    """Write the eigenvalues of the Hessenberg matrix a, which is overwritten; return how many were
    not found, as a rule 0.

    Wilkinson's shifts, and exceptional ones after 10, 20 and 30 steps (Martin, Peters and Wilkinson
    1970, "The QR algorithm for real Hessenberg matrices"). Eigenvalues that were not found are NaN.
    """
    norm = 0.0
    for i in range(n):
        for j in range(max(i - 1, 0), n):
            norm += abs(a[i * stride + j])
        re[i] = im[i] = math.nan
    if not norm < HUGE:
        return n
    unit = 1.0 if SMALL < norm < LARGE or norm == 0.0 else norm
    if unit != 1.0:
        for i in range(n):
            for j in range(max(i - 1, 0), n):
                a[i * stride + j] /= unit
    high = n - 1
    steps = 0
    shift = 0.0
    for i in range(LARGEST_SIZE):
        numbers[i] = float(i)
    while high >= 0:
        low = high
        while low > 0:
            s = abs(a[(low - 1) * stride + low - 1]) + abs(a[low * stride + low])
            if abs(a[low * stride + low - 1]) <= EPS * (s if s > 0.0 else norm):
                a[low * stride + low - 1] = 0.0
                break
            low -= 1
        x = a[high * stride + high]
        if low == high:
            re[high] = unit * (x + shift)
            im[high] = 0.0
            high = high - 1
            steps = 0
            continue
        y = a[(high - 1) * stride + high - 1]
        w = a[high * stride + high - 1] * a[(high - 1) * stride + high]
        if low == high - 1:
            r0, r1, i0, i1 = _compute_block_eigenvalues(x, y, w)
            re[low] = unit * (r0 + shift)
            re[high] = unit * (r1 + shift)
            im[low] = unit * i0
            im[high] = unit * i1
            high = high - 2
            steps = 0
            continue
        if steps >= LIMIT:
            return high + 1
        if steps > 0 and steps % 10 == 0:
            shift += x
            for i in range(high + 1):
                a[i * stride + i] -= x
            s = abs(a[high * stride + high - 1]) + abs(a[(high - 1) * stride + high - 2])
            x = y = 0.75 * s
            w = -0.4375 * s * s
        steps += 1
        _take_qr_step(a, stride, low, high, x, y, w, numbers)
    return 0


EIGEN_SCRATCH = 2 * LARGEST_SIZE
"""Numbers of scratch that `compute_eigenvalues` needs."""


@routine
def compute_eigenvalues(a, n, stride, re, im, scratch):
    """Write the n eigenvalues of the matrix a, which is overwritten; return how many were not
    found, as a rule 0.

    Pairs of conjugates stand together, the positive imaginary part first. A matrix that is not
    finite gives NaN.
    """
    balance_matrix(a, n, stride)
    reduce_to_hessenberg(a, n, stride, scratch)
    return find_hessenberg_eigenvalues(a, n, stride, re, im, scratch)
