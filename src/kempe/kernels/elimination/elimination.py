"""All postures of a chain of six joints that reach a pose: the complete solver for general
geometry.

`eliminate_unknowns` solves E_1 ... E_6 = G by one of 36 formulations: equations without the removed
joint and without the pair (`elimination_loop`), a 16x16 or 24x24 matrix whose eigenvalues are the
hidden
joint's values (`elimination_pencil`), null vectors that give the other two joints of the triple
(`elimination_null`), then the pair and the removed joint (`elimination_pair`), and a few Newton
steps (`elimination_polish`).

What special geometry does to a formulation: two postures may share the hidden joint's value (the
null space is a plane, and `split_null_vectors` finds both), roots without postures may appear, or
the equations may become dependent, so that it is useless. `elimination_score` tells which
formulations suit a
chain.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.eigen import (
    EIGEN_SCRATCH,
    balance_matrix,
    compute_eigenvalues,
    find_hessenberg_eigenvalues,
    reduce_to_hessenberg,
)
from kempe.kernels.base.row_reduction import sum_entries
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.trig import sincos
from kempe.kernels.base.vectors import LANES, load_lanes, store_value
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
    arrange_loop,
    find_hidden_joint,
    find_removed_joint,
    remove_pair,
    sample_loop,
    write_fan,
    write_line,
    write_line_numbers,
)
from kempe.kernels.elimination.elimination_pencil import (
    FLOOR,
    FORMS,
    LOST,
    ROW,
    SIZE,
    STRIDE,
    WIDE,
    assemble_pencil,
    clear_column,
    compute_pivot_ratio,
    evaluate_pencil,
    find_largest_entry,
    find_null_vectors,
    find_vectors_at_i,
    read_a_entry,
    read_angles,
    read_b_entry,
    solve_leading_matrix,
    split_null_vectors,
    write_companion_matrix,
    write_null_vector,
)
from kempe.kernels.elimination.elimination_polish import (
    CLAIMED,
    FOUND,
    JACOBIAN,
    KNOWN,
    RAW_ERROR,
    START,
    TWIST,
    accept_candidate,
    accept_twin,
    compare_goal,
    disturb_goal,
    is_singular,
    trace_lines,
    wrap_angle,
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
def _move_line(line, theta, here):
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
def _split_samples(columns, slides, to, sign):
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
        store_value(columns, to * COLUMN + i, sign * b)
        store_value(columns, (to + 1) * COLUMN + i, sign * c)
        store_value(columns, 4 * COLUMN + i, load_lanes(columns, 4 * COLUMN + i) - sign * a)


@device
def _multiply_columns(columns, j, k):
    """Return the scalar product of columns j and k."""
    sum_ = load_lanes(columns, j * COLUMN) * load_lanes(columns, k * COLUMN)
    for i in range(LANES, COLUMN, LANES):
        sum_ = sum_ + load_lanes(columns, j * COLUMN + i) * load_lanes(columns, k * COLUMN + i)
    return sum_entries(sum_)


@routine
def _solve_four(columns, y):
    """Solve columns 0 to 3 against column 4 for four unknowns y; return the least sine between a
    column and those before it.

    Modified Gram-Schmidt. A column that is next to nothing beside the largest counts by its size
    instead.
    """
    least = 1.0
    largest = 0.0
    for k in range(4):
        y[4 + k] = _multiply_columns(columns, k, k)
        largest = max(largest, y[4 + k])
    for k in range(4):
        size = _multiply_columns(columns, k, k)
        if not size > 0.0:
            return 0.0
        least = min(least, size / (y[4 + k] if y[4 + k] > NOTHING * largest else largest))
        for j in range(k + 1, 5):
            f = _multiply_columns(columns, k, j) / size
            y[8 + 5 * k + j] = f
            for i in range(0, COLUMN, LANES):
                x = load_lanes(columns, j * COLUMN + i) - f * load_lanes(columns, k * COLUMN + i)
                store_value(columns, j * COLUMN + i, x)
    for back in range(4):
        k = 3 - back
        value = y[8 + 5 * k + 4]
        for j in range(k + 1, 4):
            value -= y[8 + 5 * k + j] * y[j]
        y[k] = value
    return math.sqrt(least)


@routine
def solve_pair(loop, theta, work):
    """Write the coordinates of the pair, given those of the triple; return how well they are
    determined, 0 to 1.

    Y_2 (X_1 X_2 X_3 source) = Y_1^-1 target: fourteen equations that are linear in cosines and
    sines.
    """
    here = work
    fans = advance_pointer(work, 8)
    columns = advance_pointer(work, 32)
    y = advance_pointer(columns, 8 * COLUMN)
    for i in range(8 * COLUMN):
        columns[i] = 0.0
    write_line(loop, SOURCE, here)
    for i in range(3):
        k = TRIPLE + LINE_STRIDE * (2 - i)
        _move_line(advance_pointer(loop, k), theta[int(loop[k + NUMBER])], here)
    for side in range(2):
        k = PAIR + LINE_STRIDE * (1 - side)
        if side == 1:
            write_line(loop, TARGET, here)
        sign = 1.0 - 2.0 * side
        write_fan(advance_pointer(loop, k), sign, here, fans)
        for i in range(3):
            write_line_numbers(
                advance_pointer(fans, 6 * i), advance_pointer(columns, (5 + i) * COLUMN), 1
            )
        _split_samples(columns, loop[k + IS_SLIDE] != 0.0, 2 * side, sign)
    quality = _solve_four(columns, y)
    for side in range(2):
        k = PAIR + LINE_STRIDE * (1 - side)
        a = y[2 * side]
        b = y[2 * side + 1]
        theta[int(loop[k + NUMBER])] = a if loop[k + IS_SLIDE] != 0.0 else math.atan2(b, a)
    return quality


@device
def compute_removed_turn(kinds, lines, goal, removed, theta, work):
    """Return the angle of the removed turn, given the other joints: D = E(h, angle), where h is the
    joint's present axis.
    """
    theta[removed] = 0.0
    trace_lines(kinds, lines, theta, work)
    _, trace_ = compare_goal(goal, work)
    sine = 0.0
    for i in range(3):
        sine += work[JACOBIAN * i + removed] * work[JACOBIAN * i + TWIST]
    return math.atan2(2.0 * sine, trace_ - 1.0)


# ---- elimination cluster

# Several postures that share the hidden joint's value: their null vectors, from the whole null
# space at once.
#
# At a value that m roots share the null space of the 12x12 matrix has up to m dimensions, and its
# vectors are mixtures of those of the postures. On the postures' own vectors v it holds that W v =
# x
# U v, where U and W are the u and the w part of joint a (or b) and x = w/u its value there: so in
# the
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
"""Numbers of scratch that `find_postures` needs."""


@routine
def compute_null_space(m, count, mask, order, x):
    """Write `count` null vectors, ROW numbers each; return the largest entry left over and the last
    pivot, both relative to the first pivot.

    Gauss-Jordan elimination with complete pivoting of m (12 rows of stride ROW, lost), SIZE - count
    steps. mask: 2 ROW numbers. order: 2 SIZE numbers.
    """
    for j in range(ROW):
        mask[j] = 1.0 if j < SIZE else 0.0
        mask[ROW + j] = 1.0
    first = last = 0.0
    for k in range(SIZE - count):
        best, row, column = find_largest_entry(m, m, mask)
        last = math.sqrt(max(best, 0.0))
        if k == 0:
            first = max(last, FLOOR)
        if not last > 0.0:
            return math.inf, 0.0
        order[2 * k] = float(column)
        order[2 * k + 1] = float(row)
        mask[column] = 0.0
        mask[ROW + row] = 0.0
        clear_column(m, row, column)
    best, _, _ = find_largest_entry(m, m, mask)
    left = 0
    for c in range(SIZE):
        if mask[c] != 0.0:
            write_null_vector(m, order, SIZE - count, c, advance_pointer(x, ROW * left))
            left += 1
    return math.sqrt(max(best, 0.0)) / first, last / first


@device
def _read_entry(x, joint, i, j):
    """Return the u part and the w part of an entry of the vector x, for joint a (0) or b (1)."""
    return read_a_entry(x, i, j) if joint == 0 else read_b_entry(x, i, j)


@routine
def _solve_matrix(a, b, n):
    """Replace b by a^-1 b (Gauss-Jordan; a has n rows of stride ROW and is lost); return the ratio
    of least to largest pivot.
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
def _write_value_matrix(space, n, joint, half, left, right):
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
                u, w = _read_entry(advance_pointer(space, ROW * p), joint, i, j)
                up = f * (c * u + s * w)
                for q in range(n):
                    u, w = _read_entry(advance_pointer(space, ROW * q), joint, i, j)
                    left[p * ROW + q] += up * (c * u + s * w)
                    right[p * ROW + q] += up * (c * w - s * u)
    return _solve_matrix(left, right, n)


@routine
def _choose_value_matrix(space, n, joint, out, work):
    """Write the matrix of a joint's values, with the zero of the joint at which it is best
    determined; return the pivot ratio.
    """
    best = -1.0
    for k in range(PLACES):
        left = work
        right = advance_pointer(work, MOST * ROW)
        ratio = _write_value_matrix(space, n, joint, 0.3 + k * math.pi / PLACES, left, right)
        if ratio > best:
            best = ratio
            for i in range(n * ROW):
                out[i] = right[i]
    return best


@routine
def find_postures(m, count, mask, order, x, scratch):
    """Write a vector (ROW numbers) for each real posture among `count` roots at one value; return
    (vectors, error, margin).

    The error is that of a null space of `count` dimensions; the margin is the least imaginary part
    of a posture that is complex, relative to its size, 1 where there is none. m: the 12x12 matrix
    there (12 rows of stride ROW, lost). x: count ROW numbers. mask, order: as of
    `compute_null_space`. scratch: CLUSTER_SCRATCH numbers.
    """
    space = advance_pointer(scratch, _SPACE)
    matrix = advance_pointer(scratch, _CLUSTER_MATRIX)
    work = advance_pointer(scratch, _CLUSTER_WORK)
    for i in range(CLUSTER_SCRATCH):
        scratch[i] = 0.0
    residue, last = compute_null_space(m, count, mask, order, space)
    other = advance_pointer(matrix, MOST * ROW)
    if not residue < last:
        return 0, math.inf, 0.0
    error = residue / last
    margin = 1.0
    if not (
        _choose_value_matrix(space, count, 0, matrix, work) > 0.0
        and _choose_value_matrix(space, count, 1, other, work) > 0.0
    ):
        return 0, math.inf, 0.0
    for i in range(count * ROW):
        matrix[i] += MIX * other[i]
        work[i] = matrix[i]
    re = advance_pointer(scratch, _VALUES)
    im = advance_pointer(scratch, _VALUES + MOST)
    if (
        compute_eigenvalues(work, count, ROW, re, im, advance_pointer(scratch, _VALUES + 2 * MOST))
        > 0
    ):
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
        _combine_vectors(work, space, count, advance_pointer(x, ROW * vectors))
        vectors += 1
    return vectors, error, margin


@device
def _combine_vectors(a, space, n, out):
    """Write the mixture of the space's vectors that the matrix a (n rows of stride ROW, lost) takes
    to zero.
    """
    y = advance_pointer(a, MOST * ROW)
    order = advance_pointer(a, MOST * ROW + ROW)
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
# Roots and postures are matched one to one by the hidden joint's value. So where roots are close,
# or
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
def is_at_infinity(slides, angle):
    """Return whether a joint's value stands for a slide at infinity."""
    return slides and abs(wrap_angle(angle - math.pi)) < FAR


@device
def write_roots(re, im, n, half, narrower, slides, roots):
    """Write n roots, with what they stand for by their imaginary parts, over `narrower`.

    re, im: the roots as the tangent of half their angle, zero at twice the angle `half`; NaN for
    one that is not known.
    """
    for i in range(n):
        t = re[i]
        root = advance_pointer(roots, ROOT * i)
        root[IMAGINARY] = 2.0 * im[i] / (1.0 + t * t) / narrower
        size = abs(root[IMAGINARY])
        root[STANDS_FOR] = EXPECTED if size < TOGETHER else OPTIONAL if size < NEARLY else NONE
        root[ANGLE] = 2.0 * (half + math.atan2(t, 1.0)) if size < NEARLY else 0.0
        if is_at_infinity(slides, root[ANGLE]):
            root[STANDS_FOR] = NONE


@device
def is_same_value(roots, j, i):
    """Return whether root j has the same value as root i, which is real."""
    d = roots[ROOT * j + ANGLE] - roots[ROOT * i + ANGLE]
    return abs(roots[ROOT * j + IMAGINARY]) < TOGETHER and abs(wrap_angle(d)) < TOGETHER


@device
def count_sharing_roots(roots, n, i):
    """Return how many roots share the value of root i, whether one of them comes before it, and
    their mean difference from its value.
    """
    count = 0
    mean = 0.0
    met = False
    for j in range(n):
        if is_same_value(roots, j, i):
            count = count + 1
            mean = mean + wrap_angle(roots[ROOT * j + ANGLE] - roots[ROOT * i + ANGLE])
            met = met or j < i
    return count, met, mean / max(count, 1)


@device
def mark_expected_roots(roots, n, i, postures):
    """Mark the first `postures` of the roots that share the value of root i as EXPECTED, the others
    as NONE.
    """
    left = postures
    for j in range(n):
        if is_same_value(roots, j, i):
            roots[ROOT * j + STANDS_FOR] = EXPECTED if left > 0 else NONE
            left -= 1


@device
def count_expected_roots(roots, n):
    """Count the roots that are expected to have a posture."""
    count = 0
    for i in range(n):
        count += int(roots[ROOT * i + STANDS_FOR] == EXPECTED)
    return count


@device
def claim_nearest_root(roots, n, angle):
    """Mark the nearest free root with this value of the hidden joint as used by a posture; return
    whether there was one.
    """
    best = 0.0
    at = -1
    for i in range(n):
        what = roots[ROOT * i + STANDS_FOR]
        d = abs(wrap_angle(roots[ROOT * i + ANGLE] - angle))
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
"""Numbers of scratch that `eliminate_unknowns` needs."""


@routine
def write_root_matrix(kinds, lines, goal, formulation, w):
    """Write the matrix whose eigenvalues are the hidden joint's roots t; return (rows, half the
    angle of zero, pivot ratio).
    """
    table = advance_pointer(w, _TABLE)
    forms = advance_pointer(w, _FORMS)
    re = advance_pointer(w, _RE)
    im = advance_pointer(w, _IM)
    free = advance_pointer(w, _FREE)
    wide = advance_pointer(w, _WIDE)
    m = advance_pointer(w, _MATRIX)
    fans = advance_pointer(w, _FANS)
    arrange_loop(kinds, lines, goal, formulation, w)
    sample_loop(w, fans, table)
    remove_pair(table, fans)
    hidden = find_hidden_joint(formulation)
    assemble_pencil(table, w, hidden, forms)
    lost = 0
    if (
        hidden == 0
        and w[TRIPLE + IS_SLIDE] == 0.0
        and find_vectors_at_i(forms, re, im, free, advance_pointer(w, _MASK))
    ):
        lost = LOST
    for i in range(SIZE if lost == 0 else 0):
        free[2 * i] = float(i)
    half = 0.0
    best = -1.0
    for k in range(REFERENCES):
        angle = 0.35 + k * math.pi / REFERENCES
        evaluate_pencil(forms, -math.sin(angle), math.cos(angle), m)
        ratio = compute_pivot_ratio(m)
        if ratio > best:
            half = angle
            best = ratio
        if ratio > GOOD_REFERENCE:
            break
    ratio = solve_leading_matrix(forms, math.cos(half), math.sin(half), free, SIZE - lost, wide)
    if ratio > NO_MATRIX:
        write_companion_matrix(wide, re, im, free, lost, m)
    return 2 * (SIZE - lost), half, ratio


@device
def _convert_coordinate(w, place, angle):
    """Return the joint's coordinate: the angle, or the slide that the angle stands for."""
    return angle if w[place + IS_SLIDE] == 0.0 else math.tan(0.5 * angle)


@device
def _compute_eigenvalues(n, w):
    """Write the eigenvalues of the hidden joint's matrix; return how many were not found."""
    m = advance_pointer(w, _MATRIX)
    scratch = advance_pointer(w, _EIGEN)
    balance_matrix(m, n, STRIDE)
    reduce_to_hessenberg(m, n, STRIDE, scratch)
    return find_hessenberg_eigenvalues(
        m, n, STRIDE, advance_pointer(w, _REAL_PARTS), advance_pointer(w, _IMAGINARY_PARTS), scratch
    )


@device
def _find_null_vectors(angle, alike, w):
    """(vectors, suspicion, proven, last but one pivot over the first); writes the null vectors of
    `alike` roots.

    Proven is that there are no more postures than vectors.
    """
    m = advance_pointer(w, _MATRIX)
    x = advance_pointer(w, _VECTORS)
    evaluate_pencil(advance_pointer(w, _FORMS), math.cos(0.5 * angle), math.sin(0.5 * angle), m)
    if alike > MOST:
        return 0, ILL_NULL, False, 0.0
    if alike > 2:
        vectors, error, margin = find_postures(
            m,
            alike,
            advance_pointer(w, _MASK),
            advance_pointer(w, _FREE),
            x,
            advance_pointer(w, _CLUSTER),
        )
        return vectors, 0 if error < BLURRED else ILL_NULL, SURELY * error < margin, 0.0
    vectors, third, second = find_null_vectors(
        m, advance_pointer(w, _MASK), advance_pointer(w, _FREE), x
    )
    if vectors < 2:
        return vectors, 0 if vectors == 1 else ILL_NULL, False, second
    vectors, separation = split_null_vectors(x, advance_pointer(w, _WORK))
    ill = 0 if third > NULL and separation > SEPARATE else ILL_NULL
    return vectors, ill, min(separation, 1.0) * third > SURELY * (second + NULL), second


@routine
def _read_posture(s, angle, k, theta):
    """Read the values of the joint pair from null vector k; return its distance from a vector of a
    posture, infinite at infinity, and how well it is determined.

    Writes the six coordinates.
    """
    w = s.w
    work = advance_pointer(s.w, _WORK)
    hidden = find_hidden_joint(s.formulation)
    removed = find_removed_joint(s.formulation)
    first, second, defect = read_angles(advance_pointer(w, _VECTORS + ROW * k))
    for joint in range(3):
        place = TRIPLE + LINE_STRIDE * joint
        x = angle if joint == hidden else first if joint == (1 if hidden == 0 else 0) else second
        if is_at_infinity(w[place + IS_SLIDE] != 0.0, x):
            return math.inf, 1.0
        theta[int(w[place + NUMBER])] = _convert_coordinate(w, place, x)
    quality = solve_pair(w, theta, work)
    theta[removed] = compute_removed_turn(s.kinds, s.lines, s.near, removed, theta, work)
    return defect, quality


class EliminationScratch(NamedTuple):
    """Pointers to a chain with its goal, the goal whose roots are taken, the formulation, scratch
    and result.
    """

    kinds: object
    lines: object
    goal: object
    near: object
    w: object
    out: object
    formulation: int


@device
def _read_hidden_value(s, k):
    """Return the value of the hidden joint in posture k, as an angle."""
    place = TRIPLE + LINE_STRIDE * find_hidden_joint(s.formulation)
    x = s.w[FOUNDLINGS + FOUND * k + int(s.w[place + NUMBER])]
    return x if s.w[place + IS_SLIDE] == 0.0 else 2.0 * math.atan2(x, 1.0)


@device
def _is_claimed_twice(s, k, angle):
    """Return whether posture k belongs to a root with this value of the hidden joint, and to
    another root before.
    """
    posture = advance_pointer(s.w, FOUNDLINGS + FOUND * k)
    here = abs(wrap_angle(_read_hidden_value(s, k) - angle)) < NEARLY
    before = posture[CLAIMED] != 0.0
    posture[CLAIMED] = 1.0 if here else posture[CLAIMED]
    return here and before


@device
def _has_unmatched_root(s, n, count):
    """Return whether a root that is expected to have a posture, or a posture, has no partner; a
    singular posture has two.
    """
    roots = advance_pointer(s.w, _ROOTS)
    alone = False
    for again in range(2):
        for k in range(count):
            if again == 0:
                alone = alone or not claim_nearest_root(roots, n, _read_hidden_value(s, k))
            elif is_singular(advance_pointer(s.w, FOUNDLINGS), k):
                claim_nearest_root(roots, n, _read_hidden_value(s, k))
    return alone or count_expected_roots(roots, n) > 0


@routine
def _add_postures(s, i, n, twins, count, strays):
    """Add the postures of root i of n; return (postures, strays, suspicion).

    A stray is a start that was close, but Newton's steps led astray: written to `out`, from its
    end.
    """
    found = advance_pointer(s.w, FOUNDLINGS)
    work = advance_pointer(s.w, _WORK)
    roots = advance_pointer(s.w, _ROOTS)
    imaginary = roots[ROOT * i + IMAGINARY]
    angle = roots[ROOT * i + ANGLE]
    none = 0
    alike, met, aside = (
        count_sharing_roots(roots, n, i) if imaginary < TOGETHER else (1, False, 0.0)
    )
    if alike > 2 and met:
        return count, strays, 0
    angle += aside if alike > 2 else 0.0
    vectors, suspect, proven, second = _find_null_vectors(angle, alike, s.w)
    proven = suspect == 0 and imaginary < TOGETHER and (proven or vectors == 1)
    for k in range(vectors):
        if count == CANDIDATES:
            return count, strays, suspect | ILL_NULL
        theta = advance_pointer(found, FOUND * count)
        defect, quality = _read_posture(s, angle, k, theta)
        other = vectors == 1 and second > SIMPLE and imaginary == 0.0 and defect * second > NOISE
        none += int(other or defect == math.inf)
        if defect == math.inf:
            continue
        state = accept_candidate(s.kinds, s.lines, s.goal, found, count, work)
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
        again = _is_claimed_twice(s, int(theta[KNOWN]), angle) and twins
        merging = vectors == 1 and (imaginary > 0.0 or again)
        source = count
        count = count + state
        if merging and count < CANDIDATES:
            state = accept_twin(s.kinds, s.lines, s.goal, found, source, count, work)
            suspect |= SINGULAR if state > 0 and is_singular(found, count) else 0
            suspect |= TWICE if state < 1 and imaginary < DOUBT else 0
            count += max(state, 0)
    if proven and (alike > 2 or none > 0 or vectors == 0):
        mark_expected_roots(roots, n, i, vectors - none)
    return count, strays, suspect


@routine
def _collect_postures(s, n, half, disturbed, count, strays):
    """Add the postures of the n roots, one of each pair of conjugates; return (postures, strays,
    suspicion).
    """
    suspect = 0
    roots = advance_pointer(s.w, _ROOTS)
    narrower = 1.0 if disturbed == 0 else WIDER
    slides = s.w[TRIPLE + LINE_STRIDE * find_hidden_joint(s.formulation) + IS_SLIDE] != 0.0
    write_roots(
        advance_pointer(s.w, _REAL_PARTS),
        advance_pointer(s.w, _IMAGINARY_PARTS),
        n,
        half,
        narrower,
        slides,
        roots,
    )
    for i in range(n):
        if 0.0 <= roots[ROOT * i + IMAGINARY] < NEARLY and not is_at_infinity(
            slides, roots[ROOT * i + ANGLE]
        ):
            count, strays, doubt = _add_postures(s, i, n, disturbed == 0, count, strays)
            suspect |= doubt
    lost = (
        _has_unmatched_root(s, n, count)
        if disturbed == 0
        else count_expected_roots(roots, n) != count
    )
    return count, strays, suspect | (UNMATCHED if lost else 0)


@routine
def eliminate_unknowns(kinds, lines, goal, formulation, w, out):
    """Write candidates, six coordinates each with angles in (-pi, pi]; return (count, strays,
    suspect).

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
    found = advance_pointer(w, FOUNDLINGS)
    count = 0
    strays = 0
    suspect = DEGENERATE
    least = 1.0
    for disturbed in range(2):
        if suspect & DEGENERATE == 0:
            break
        near = goal
        if disturbed == 1:
            near = advance_pointer(w, _GOAL)
            disturb_goal(goal, near)
        s = EliminationScratch(kinds, lines, goal, near, w, out, formulation)
        n, half, ratio = write_root_matrix(kinds, lines, near, formulation, w)
        suspect = UNUSABLE | suspect & SINGULAR
        least = min(least, ratio)
        if not ratio > NO_MATRIX:
            continue
        suspect = suspect & SINGULAR | (0 if ratio > GOOD_LEAD else ILL_LEAD)
        suspect |= NO_EIGENVALUES if _compute_eigenvalues(n, w) > 0 else 0
        count, strays, doubt = _collect_postures(s, n, half, disturbed, count, strays)
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
