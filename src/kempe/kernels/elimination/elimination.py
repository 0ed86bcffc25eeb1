"""All postures of a chain of six joints that reach a pose: the complete solver for general
geometry.

`eliminate` solves E_1 ... E_6 = G by one of 36 formulations: equations without the removed joint
and without the pair (`elimination_loop`), a 16x16 or 24x24 matrix whose eigenvalues are the hidden
joint's values (`elimination_pencil`), null vectors that give the other two joints of the triple
(`elimination_null`), then the pair and the removed joint (`elimination_pair`), and a few Newton
steps (`elimination_polish`).

What special geometry does to a formulation: two postures may share the hidden joint's value (the
null space is a plane, and `split` finds both), roots without postures may appear, or the equations
may become dependent, so that it is useless. `elimination_score` tells which formulations suit a
chain.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.eigen import EIGEN_SCRATCH, balance, eigenvalues, hessenberg, shifted_qr
from kempe.kernels.base.row_reduction import total
from kempe.kernels.base.scratch import beyond
from kempe.kernels.base.trig import sincos
from kempe.kernels.base.vectors import LANES, load_lanes, store
from kempe.kernels.elimination.elimination_loop import (
    EQUATIONS,
    FANS_SIZE,
    IS_SLIDE,
    LINE_STRIDE,
    LOOP_SIZE,
    NUMBER,
    PAIR,
    SAMPLE_STRIDE,
    SOURCE,
    TARGET,
    TRIPLE,
    arrange,
    fan,
    fourteen,
    hidden_of,
    line_of,
    remove_pair,
    removed_of,
    sample,
)
from kempe.kernels.elimination.elimination_pencil import (
    FLOOR,
    FORMS,
    LOST,
    ROW,
    SIZE,
    STRIDE,
    WIDE,
    angles_of,
    assemble,
    clear,
    companion,
    entry_of_a,
    entry_of_b,
    largest_entry,
    lead,
    matrix_at,
    null_at_i,
    null_vectors,
    pivot_ratio,
    split,
    vector,
)
from kempe.kernels.elimination.elimination_polish import (
    CLAIMED,
    FOUND,
    JACOBIAN,
    KNOWN,
    RAW_ERROR,
    START,
    TWIST,
    accept,
    compare,
    disturb,
    is_singular,
    trace,
    twin,
    wrapped,
)

# ---- elimination pair

# The pair and the removed joint once the triple is known.


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


# ---- elimination cluster

# Several postures that share the hidden joint's value: their null vectors, from the whole null
# space at once.
#
# At a value that m roots share the null space of the 12x12 matrix has up to m dimensions, and its
# vectors are mixtures of those of the postures. On the postures' own vectors v it holds that W v = x
# U v, where U and W are the u and the w part of joint a (or b) and x = w/u its value there: so in the
# null space N the matrix (U N)^+ W N has the values as eigenvalues and the postures' mixtures as
# eigenvectors. A combination of the two joints' matrices tells postures apart that share one of the
# values (Moeller and Stetter 1995, "Multivariate polynomial equations with multiple zeros solved by
# matrix eigenproblems").


MOST = 8
"""Dimensions of a null space at most."""

PLACES = 3
"""Zeros of a joint that are tried: none of the values may be at infinity."""

MIX = 0.7548776662466927
"""What the second joint's matrix is weighed with: no special number."""

CLUSTER_REAL = 1e-4
"""Imaginary part of an eigenvalue, relative to its size, up to which the real part is tried."""

_SPACE = 0
_CLUSTER_MATRIX = MOST * ROW
_CLUSTER_WORK = _CLUSTER_MATRIX + 2 * MOST * ROW
_VALUES = _CLUSTER_WORK + 3 * MOST * ROW
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
    matrix = beyond(scratch, _CLUSTER_MATRIX)
    work = beyond(scratch, _CLUSTER_WORK)
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
        if not size <= CLUSTER_REAL:
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


# ---- elimination roots

# The roots of the hidden joint one by one: which of them share a value, and whether each has a
# posture of its own.
#
# Roots and postures are matched one to one by the hidden joint's value. So where roots are close, or
# the same, their number counts, and it does not matter from which of them Newton's steps came to a
# posture.


ROOT = 3
ANGLE = 0
IMAGINARY = 1
STANDS_FOR = 2
"""Numbers of a root: value of the hidden joint, imaginary part (an angle each), what it stands
for."""

NONE = 0.0
OPTIONAL = 1.0
EXPECTED = 2.0
"""What a root stands for: no posture, at most one, one."""

REAL = 1e-7
DOUBT = 1e-3
NEARLY = 1e-2
"""Imaginary parts of angles: up to the first a root is real; up to the second a pair of postures
that are about to merge may hide behind it; up to the third it is tried, and a root belongs to a
posture whose value is so near."""

TOGETHER = 1e-6
"""Difference of roots, in radians, up to which three or more share a null space; and imaginary part
up to which a root must have a posture: the larger ones of ill-conditioned roots leave it open."""


FAR = 1e-5
"""Angle from pi at which a slide, whose angle is 2 atan d, is at infinity, where roots belong to no
posture."""


@device
def at_infinity(slides, angle):
    """Whether a joint's value is that of a slide at infinity."""
    return slides and abs(wrapped(angle - math.pi)) < FAR


@device
def write_roots(re, im, n, half, narrower, slides, roots):
    """Write n roots, with what they stand for by their imaginary parts, over `narrower`.

    re, im: the roots as the tangent of half their angle, zero at twice the angle `half`; NaN for
    one that is not known.
    """
    for i in range(n):
        t = re[i]
        root = beyond(roots, ROOT * i)
        root[IMAGINARY] = 2.0 * im[i] / (1.0 + t * t) / narrower
        size = abs(root[IMAGINARY])
        root[STANDS_FOR] = EXPECTED if size < TOGETHER else OPTIONAL if size < NEARLY else NONE
        root[ANGLE] = 2.0 * (half + math.atan2(t, 1.0)) if size < NEARLY else 0.0
        if at_infinity(slides, root[ANGLE]):
            root[STANDS_FOR] = NONE


@device
def is_with(roots, j, i):
    """Whether root j shares the value of root i, which is real."""
    d = roots[ROOT * j + ANGLE] - roots[ROOT * i + ANGLE]
    return abs(roots[ROOT * j + IMAGINARY]) < TOGETHER and abs(wrapped(d)) < TOGETHER


@device
def together(roots, n, i):
    """(number of roots that share the value of root i; whether one comes before it; mean difference
    from its value).
    """
    count = 0
    mean = 0.0
    met = False
    for j in range(n):
        if is_with(roots, j, i):
            count = count + 1
            mean = mean + wrapped(roots[ROOT * j + ANGLE] - roots[ROOT * i + ANGLE])
            met = met or j < i
    return count, met, mean / max(count, 1)


@device
def stand_for(roots, n, i, postures):
    """Mark the first `postures` of the roots that share the value of root i as EXPECTED, the others
    of them as NONE.
    """
    left = postures
    for j in range(n):
        if is_with(roots, j, i):
            roots[ROOT * j + STANDS_FOR] = EXPECTED if left > 0 else NONE
            left -= 1


@device
def expected(roots, n):
    """How many roots are expected to have a posture."""
    count = 0
    for i in range(n):
        count += int(roots[ROOT * i + STANDS_FOR] == EXPECTED)
    return count


@device
def matched(roots, n, angle):
    """Whether a root is left for a posture with this value of the hidden joint; the nearest is
    marked as used.
    """
    best = 0.0
    at = -1
    for i in range(n):
        what = roots[ROOT * i + STANDS_FOR]
        d = abs(wrapped(roots[ROOT * i + ANGLE] - angle))
        if what != NONE and d < NEARLY and what - d > best:
            best = what - d
            at = i
    if at < 0:
        return False
    roots[ROOT * at + STANDS_FOR] = NONE
    return True


CANDIDATES = 24
"""Candidates at most; 16 postures are possible."""

(
    ODD,
    NEARLY_REAL,
    NO_EIGENVALUES,
    ILL_LEAD,
    ILL_NULL,
    ASTRAY,
    TWICE,
    UNUSABLE,
    SINGULAR,
    FREE,
    UNMATCHED,
    SHARED,
) = (2**k for k in range(12))
"""Bits of `suspect`: an odd number of candidates; a pair of roots so nearly real that two postures
may have been lost; eigenvalues not found; leading matrix nearly singular; fewer null vectors than
roots, some that cannot be distinguished, or too many candidates; a real root that led to no
posture; two that led to the same; no independent equations; a singular posture, where others may
merge with it or be connected with it by a self-motion; a hidden joint that is nearly free, as on a
self-motion, or near one, where the eigenvalues are those of noise; a real root without a posture of
its own that has its value of the hidden joint, or a posture without a root; a triple that does not
determine the pair, so that two postures may share it."""

DEGENERATE = NO_EIGENVALUES | ILL_LEAD | ILL_NULL | UNUSABLE
"""Bits of doubts that a goal nearby may not raise."""

UNSOUND = DEGENERATE | UNMATCHED | SHARED
"""Bits of doubts that do not vanish where another formulation finds the same."""

WIDER = 100.0
"""How much larger the imaginary parts of postures that merge are at a disturbed goal: as its
root."""

NEARLY_FREE = 1e-5
CLOSE = 0.1
"""Pivot ratio of the leading matrix below which all values of the hidden joint are roots, or
nearly; error before Newton's steps up to which a candidate that they lead astray is a stray."""

BLURRED = 1e-2
SURELY = 10.0
"""Error of a null space from which it means nothing; how many times that it must be away from
having more postures."""

DETERMINED = 1e-6
"""Least sine between columns of the pair's equations below which these have more than one
solution."""

NOISE = 1e-7
SIMPLE = 1e-5
"""Error of a matrix up to which its null vector may be that of a posture; last but one pivot of a
simple root."""

NULL = 1e-9
"""Third last pivot, relative to the first, below which there are more than two null vectors."""

SEPARATE = 1e-8
"""Separation below which two postures cannot be distinguished."""

NO_MATRIX = 1e-12
GOOD_LEAD = 1e-7
"""Pivot ratio of the leading matrix: below the first the equations are dependent, below the second
they are suspect."""

REFERENCES = 4
GOOD_REFERENCE = 1e-3
"""Zeros of the hidden joint that are tried, and the pivot ratio of the leading matrix that is good
enough."""

_LOOP = 0
_FANS = _LOOP + LOOP_SIZE
_TABLE = _FANS + FANS_SIZE
_FORMS = _TABLE + EQUATIONS * SAMPLE_STRIDE
_RE = _FORMS + FORMS
_IM = _RE + SIZE * ROW
_MASK = _IM + SIZE * ROW
_FREE = _MASK + 2 * ROW
_WIDE = _FREE + 2 * SIZE
_MATRIX = _WIDE + SIZE * WIDE
_REAL_PARTS = _MATRIX + STRIDE * STRIDE
_IMAGINARY_PARTS = _REAL_PARTS + STRIDE
_EIGEN = _IMAGINARY_PARTS + STRIDE
_VECTORS = _EIGEN + EIGEN_SCRATCH
_GOAL = _VECTORS + MOST * ROW
_WORK = _GOAL + 12
_CLUSTER = _WORK + PAIR_SIZE
_ROOTS = _CLUSTER + CLUSTER_SCRATCH
FOUNDLINGS = _ROOTS + ROOT * STRIDE
"""Place of the candidates in scratch."""
ELIMINATION_SCRATCH = FOUNDLINGS + FOUND * (CANDIDATES + 2)
"""Numbers of scratch that `eliminate` needs."""


@routine
def matrix_of(kinds, lines, goal, formulation, w):
    """(rows, half the angle of zero, pivot ratio); writes the matrix with the hidden joint's roots
    t as eigenvalues.
    """
    table = beyond(w, _TABLE)
    forms = beyond(w, _FORMS)
    re = beyond(w, _RE)
    im = beyond(w, _IM)
    free = beyond(w, _FREE)
    wide = beyond(w, _WIDE)
    m = beyond(w, _MATRIX)
    fans = beyond(w, _FANS)
    arrange(kinds, lines, goal, formulation, w)
    sample(w, fans, table)
    remove_pair(table, fans)
    hidden = hidden_of(formulation)
    assemble(table, w, hidden, forms)
    lost = 0
    if (
        hidden == 0
        and w[TRIPLE + IS_SLIDE] == 0.0
        and null_at_i(forms, re, im, free, beyond(w, _MASK))
    ):
        lost = LOST
    for i in range(SIZE if lost == 0 else 0):
        free[2 * i] = float(i)
    half = 0.0
    best = -1.0
    for k in range(REFERENCES):
        angle = 0.35 + k * math.pi / REFERENCES
        matrix_at(forms, -math.sin(angle), math.cos(angle), m)
        ratio = pivot_ratio(m)
        if ratio > best:
            half = angle
            best = ratio
        if ratio > GOOD_REFERENCE:
            break
    ratio = lead(forms, math.cos(half), math.sin(half), free, SIZE - lost, wide)
    if ratio > NO_MATRIX:
        companion(wide, re, im, free, lost, m)
    return 2 * (SIZE - lost), half, ratio


@device
def _coordinate(w, place, angle):
    """The joint's coordinate: the angle, or the slide that it stands for."""
    return angle if w[place + IS_SLIDE] == 0.0 else math.tan(0.5 * angle)


@device
def _eigenvalues(n, w):
    """Eigenvalues of the hidden joint's matrix that were not found; writes the others."""
    m = beyond(w, _MATRIX)
    scratch = beyond(w, _EIGEN)
    balance(m, n, STRIDE)
    hessenberg(m, n, STRIDE, scratch)
    return shifted_qr(m, n, STRIDE, beyond(w, _REAL_PARTS), beyond(w, _IMAGINARY_PARTS), scratch)


@device
def _vectors_at(angle, alike, w):
    """(vectors, suspicion, proven, last but one pivot over the first); writes the null vectors of
    `alike` roots.

    Proven is that there are no more postures than vectors.
    """
    m = beyond(w, _MATRIX)
    x = beyond(w, _VECTORS)
    matrix_at(beyond(w, _FORMS), math.cos(0.5 * angle), math.sin(0.5 * angle), m)
    if alike > MOST:
        return 0, ILL_NULL, False, 0.0
    if alike > 2:
        vectors, error, margin = postures_at(
            m, alike, beyond(w, _MASK), beyond(w, _FREE), x, beyond(w, _CLUSTER)
        )
        return vectors, 0 if error < BLURRED else ILL_NULL, SURELY * error < margin, 0.0
    vectors, third, second = null_vectors(m, beyond(w, _MASK), beyond(w, _FREE), x)
    if vectors < 2:
        return vectors, 0 if vectors == 1 else ILL_NULL, False, second
    vectors, separation = split(x, beyond(w, _WORK))
    ill = 0 if third > NULL and separation > SEPARATE else ILL_NULL
    return vectors, ill, min(separation, 1.0) * third > SURELY * (second + NULL), second


@routine
def _posture(s, angle, k, theta):
    """(how far null vector k is from one of a posture, infinite at infinity; how well it determines
    the pair).

    Writes the six coordinates.
    """
    w = s.w
    work = beyond(s.w, _WORK)
    hidden = hidden_of(s.formulation)
    removed = removed_of(s.formulation)
    first, second, defect = angles_of(beyond(w, _VECTORS + ROW * k))
    for joint in range(3):
        place = TRIPLE + LINE_STRIDE * joint
        x = angle if joint == hidden else first if joint == (1 if hidden == 0 else 0) else second
        if at_infinity(w[place + IS_SLIDE] != 0.0, x):
            return math.inf, 1.0
        theta[int(w[place + NUMBER])] = _coordinate(w, place, x)
    quality = pair_of(w, theta, work)
    theta[removed] = removed_turn(s.kinds, s.lines, s.near, removed, theta, work)
    return defect, quality


class EliminationScratch(NamedTuple):
    """A chain with its goal, the goal whose roots are taken, the formulation, scratch and result;
    pointers.
    """

    kinds: object
    lines: object
    goal: object
    near: object
    w: object
    out: object
    formulation: int


@device
def _hidden_value(s, k):
    """The hidden joint's value in posture k as an angle."""
    place = TRIPLE + LINE_STRIDE * hidden_of(s.formulation)
    x = s.w[FOUNDLINGS + FOUND * k + int(s.w[place + NUMBER])]
    return x if s.w[place + IS_SLIDE] == 0.0 else 2.0 * math.atan2(x, 1.0)


@device
def _claimed_twice(s, k, angle):
    """Whether posture k is that of a root with this value of the hidden joint, and was that of
    another one before.
    """
    posture = beyond(s.w, FOUNDLINGS + FOUND * k)
    here = abs(wrapped(_hidden_value(s, k) - angle)) < NEARLY
    before = posture[CLAIMED] != 0.0
    posture[CLAIMED] = 1.0 if here else posture[CLAIMED]
    return here and before


@device
def _unmatched(s, n, count):
    """Whether a root that is expected to have a posture, or a posture, has no partner; a singular
    posture has two.
    """
    roots = beyond(s.w, _ROOTS)
    alone = False
    for again in range(2):
        for k in range(count):
            if again == 0:
                alone = alone or not matched(roots, n, _hidden_value(s, k))
            elif is_singular(beyond(s.w, FOUNDLINGS), k):
                matched(roots, n, _hidden_value(s, k))
    return alone or expected(roots, n) > 0


@routine
def _add(s, i, n, twins, count, strays):
    """(postures, strays, suspicion) with those of root i of n added.

    A stray is a start that was close, but Newton's steps led astray: written to `out`, from its
    end.
    """
    found = beyond(s.w, FOUNDLINGS)
    work = beyond(s.w, _WORK)
    roots = beyond(s.w, _ROOTS)
    imaginary = roots[ROOT * i + IMAGINARY]
    angle = roots[ROOT * i + ANGLE]
    none = 0
    alike, met, aside = together(roots, n, i) if imaginary < TOGETHER else (1, False, 0.0)
    if alike > 2 and met:
        return count, strays, 0
    angle += aside if alike > 2 else 0.0
    vectors, suspect, proven, second = _vectors_at(angle, alike, s.w)
    proven = suspect == 0 and imaginary < TOGETHER and (proven or vectors == 1)
    for k in range(vectors):
        if count == CANDIDATES:
            return count, strays, suspect | ILL_NULL
        theta = beyond(found, FOUND * count)
        defect, quality = _posture(s, angle, k, theta)
        other = vectors == 1 and second > SIMPLE and imaginary == 0.0 and defect * second > NOISE
        none += int(other or defect == math.inf)
        if defect == math.inf:
            continue
        state = accept(s.kinds, s.lines, s.goal, found, count, work)
        suspect |= SINGULAR if state > 0 and is_singular(found, count) else 0
        suspect |= SHARED if state >= 0 and quality < DETERMINED else 0
        if state < 0 and not other:
            suspect |= ASTRAY if imaginary < REAL else (NEARLY_REAL if imaginary < DOUBT else 0)
            if theta[RAW_ERROR] < CLOSE and strays < CANDIDATES:
                strays += 1
                for j in range(6):
                    s.out[6 * (CANDIDATES - strays) + j] = theta[START + j]
        if state < 0 or other:
            count += max(state, 0)
            continue
        again = _claimed_twice(s, int(theta[KNOWN]), angle) and twins
        merging = vectors == 1 and (imaginary > 0.0 or again)
        source = count
        count = count + state
        if merging and count < CANDIDATES:
            state = twin(s.kinds, s.lines, s.goal, found, source, count, work)
            suspect |= SINGULAR if state > 0 and is_singular(found, count) else 0
            suspect |= TWICE if state < 1 and imaginary < DOUBT else 0
            count += max(state, 0)
    if proven and (alike > 2 or none > 0 or vectors == 0):
        stand_for(roots, n, i, vectors - none)
    return count, strays, suspect


@routine
def _postures(s, n, half, disturbed, count, strays):
    """(postures, strays, suspicion) with those of the n roots added; of a pair of conjugates the
    first is enough.
    """
    suspect = 0
    roots = beyond(s.w, _ROOTS)
    narrower = 1.0 if disturbed == 0 else WIDER
    slides = s.w[TRIPLE + LINE_STRIDE * hidden_of(s.formulation) + IS_SLIDE] != 0.0
    write_roots(
        beyond(s.w, _REAL_PARTS), beyond(s.w, _IMAGINARY_PARTS), n, half, narrower, slides, roots
    )
    for i in range(n):
        if 0.0 <= roots[ROOT * i + IMAGINARY] < NEARLY and not at_infinity(
            slides, roots[ROOT * i + ANGLE]
        ):
            count, strays, doubt = _add(s, i, n, disturbed == 0, count, strays)
            suspect |= doubt
    lost = _unmatched(s, n, count) if disturbed == 0 else expected(roots, n) != count
    return count, strays, suspect | (UNMATCHED if lost else 0)


@routine
def eliminate(kinds, lines, goal, formulation, w, out):
    """(count, strays, suspect); writes `count` candidates, six coordinates each, angles in (-pi,
    pi].

    kinds, lines: the chain, LINE_STRIDE numbers a joint. goal: rows of G (12 numbers). w:
    ELIMINATION_SCRATCH numbers. out: room for CANDIDATES candidates. Each candidate fulfils the
    equation to ACCEPT, and no two are the same; after them follow `strays` starts near which
    Newton's steps found nothing, though more careful ones may. `suspect` is 0 or tells by its bits
    (ODD and others) why postures may be missing: then another formulation may find them. A chain or
    goal that is not finite gives no candidates.

    A goal can make the equations dependent, or give several postures the same hidden coordinate,
    though hardly any goal nearby does. Then a disturbed goal's postures are where Newton's steps
    begin.
    """
    found = beyond(w, FOUNDLINGS)
    count = 0
    strays = 0
    suspect = DEGENERATE
    least = 1.0
    for disturbed in range(2):
        if suspect & DEGENERATE == 0:
            break
        near = goal
        if disturbed == 1:
            near = beyond(w, _GOAL)
            disturb(goal, near)
        s = EliminationScratch(kinds, lines, goal, near, w, out, formulation)
        n, half, ratio = matrix_of(kinds, lines, near, formulation, w)
        suspect = UNUSABLE | suspect & SINGULAR
        least = min(least, ratio)
        if not ratio > NO_MATRIX:
            continue
        suspect = suspect & SINGULAR | (0 if ratio > GOOD_LEAD else ILL_LEAD)
        suspect |= NO_EIGENVALUES if _eigenvalues(n, w) > 0 else 0
        count, strays, doubt = _postures(s, n, half, disturbed, count, strays)
        suspect |= doubt
    strays = min(strays, CANDIDATES - count)
    for k in range(strays):  # those that came first stand last
        for j in range(6):
            found[FOUND * (count + k) + j] = out[6 * (CANDIDATES - 1 - k) + j]
    for k in range(count + strays):
        for j in range(6):
            out[6 * k + j] = found[FOUND * k + j]
    return (
        count,
        strays,
        suspect | (ODD if count % 2 == 1 else 0) | (FREE if least < NEARLY_FREE else 0),
    )
