"""Merging of candidates: each solution of one target is polished, judged, listed once, and turned
into coordinates.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.closed_form.analytic_layout import (
    CODE,
    FACTOR,
    HIGH,
    INFO,
    JOINT_FLOATS,
    LOW,
    OFFSET,
)
from kempe.kernels.closed_form.polish import (
    AT_AXES,
    Model,
    compute_error,
    compute_orthogonal_step,
    find_smallest_pivot,
    find_tangent,
    polish_solution,
    sharpen_solution,
    write_columns,
)
from kempe.kernels.forward.table_layout import SLIDE

EQUAL = 1e-9
SAME = 1e-6
NEAR = 2e-3
INDISTINCT = 1e-15
"""Solutions nearer than SAME are one, and those nearer than NEAR whose midpoint solves the target
to INDISTINCT: roots that merge cannot be distinguished at the square root of rounding. Their mean
stands for both, unless they are EQUAL."""

MERGED = 1e-8
CLOSE = 1e-4
UNSURE = 1e-12
STUCK = 1e-13
"""Bound of the smallest singular value squared of a solution in which roots may have merged, or
that lies near a curve of solutions; error up to which such a candidate is worth undamped steps, for
the damped ones may have been too short; error from which it may still be on its way along the
curve; and from which it may be stuck halfway between two roots, if one of them is there."""

MOST_SOLUTIONS = 48
ERROR = 0
TURNS = 2
SIGNS = 3
WEAKEST = 4
SOLUTION = 6
"""A solution: errors (2), multiplicity, slot, bound of the smallest singular value squared, then
the variables."""

ROOT = 0
AGAIN = 1
SAMPLED = 2
OPENED = 3
"""Kinds of candidates: a root; one of another formulation, where it may be a root met before; from
a free joint; from a joint that is nearly free: a sample if it is on target as it is, else it may
lead to a root."""

EDGE = 1e-10
"""How far beyond a limit rounding may push a coordinate: it is put on the limit. Where roots merge
rounding may push it by up to SAME: there the solution is led back to the limit if it reaches the
target so."""

TWO_PI = 2.0 * math.pi


class FoundSolutions(NamedTuple):
    """The solutions found so far: `rows` of SOLUTION + n numbers, with scratch for one more, and
    the tolerances.
    """

    model: Model
    rows: object
    linear: float
    angular: float


@device
def compute_gap(slides, a, b):
    """Return the difference a - b; of angles the shortest one."""
    d = a - b
    if slides:
        return d
    return d - TWO_PI * math.floor(d / TWO_PI + 0.5)


@routine
def compute_largest_gap(m, a, b):
    """Return the largest difference of a joint between two configurations."""
    size = 0.0
    for i in range(m.n):
        size = max(size, abs(compute_gap(m.kinds[i] == SLIDE, a[i], b[i])))
    return size


@device
def has_sample(found, count, slot):
    """Return whether the family of solutions of this slot has a sample already."""
    for k in range(count):
        row = advance_pointer(found.rows, (SOLUTION + found.model.n) * k)
        if row[TURNS] == 0.0 and row[SIGNS] == slot:
            return True
    return False


@routine
def polish_candidate(found, theta, kind):
    """Polish a candidate in place; return its errors (linear, angular), a bound of the smallest
    singular value squared, and its kind.

    Errors are infinite for one that is still on its way.
    """
    m = found.model
    linear, angular = polish_solution(m, theta)
    if not max(linear, angular) <= max(CLOSE, found.linear, found.angular):
        return math.inf, math.inf, 0.0, kind
    weak = find_smallest_pivot(m)
    if kind == OPENED:
        kind = SAMPLED if max(linear, angular) <= UNSURE else AGAIN
    if weak < MERGED:
        linear, angular = sharpen_solution(m, theta)
        weak = find_smallest_pivot(m)
    if kind == AGAIN and weak < MERGED and max(linear, angular) > UNSURE:
        return math.inf, math.inf, 0.0, kind
    if (
        kind == SAMPLED and weak > MERGED
    ):  # a free joint that was not free after all: polishing has found its value
        kind = AGAIN
    return linear, angular, weak, kind


@routine
def add_solution(found, count, theta, slot, kind):
    """Polish and judge a candidate, and add it to the solutions; return their new number.

    kind: ROOT, each counts towards the multiplicity of a solution; AGAIN, roots that were counted
    before; SAMPLED.
    """
    m = found.model
    stride = SOLUTION + found.model.n
    linear, angular, weak, kind = polish_candidate(found, theta, kind)
    if not (linear <= found.linear and angular <= found.angular):
        return count
    spare = advance_pointer(found.rows, stride * MOST_SOLUTIONS)
    k = -1
    while k + 1 < count:
        k += 1
        row = advance_pointer(found.rows, stride * k)
        other = advance_pointer(row, SOLUTION)
        d = compute_largest_gap(m, theta, other)
        if d > NEAR:
            continue
        this = max(linear, angular)
        that = max(row[ERROR], row[ERROR + 1])
        if d > EQUAL and this > max(STUCK, 10.0 * that):
            return count
        if d > EQUAL and that > max(STUCK, 10.0 * this):
            drop_solution(found, count, k)
            count -= 1
            k -= 1
            continue
        if d > EQUAL:
            for i in range(m.n):
                spare[i] = other[i] + 0.5 * compute_gap(m.kinds[i] == SLIDE, theta[i], other[i])
            middle_linear, middle_angular = compute_error(m, spare)
            if d > SAME and max(middle_linear, middle_angular) > max(INDISTINCT, 2.0 * that):
                continue
            if kind != ROOT:  # what was met before moves nothing
                return count
            share = 1.0 / (row[TURNS] + 1.0)
            for i in range(m.n):
                spare[i] = other[i] + share * compute_gap(m.kinds[i] == SLIDE, theta[i], other[i])
            row[ERROR], row[ERROR + 1] = compute_error(m, spare)
            for i in range(m.n):
                other[i] = spare[i]
        if (
            kind == ROOT and min(weak, row[WEAKEST]) < MERGED
        ):  # where the Jacobian is regular a root is simple
            row[TURNS] += 1.0
        return count
    if count >= MOST_SOLUTIONS or (kind == SAMPLED and has_sample(found, count, slot)):
        return count
    row = advance_pointer(found.rows, stride * count)
    row[ERROR] = linear
    row[ERROR + 1] = angular
    row[TURNS] = 0.0 if kind == SAMPLED else 1.0
    row[SIGNS] = slot
    row[WEAKEST] = weak
    for i in range(m.n):
        row[SOLUTION + i] = theta[i]
    return count + 1


@routine
def unite_solutions(found, count):
    """Unite solutions that have become equal, as means of merging roots were moved; return the new
    number of solutions.
    """
    m = found.model
    stride = SOLUTION + found.model.n
    k = 1
    while k < count:
        row = advance_pointer(found.rows, stride * k)
        same = -1
        for j in range(k if row[WEAKEST] < MERGED else 0):
            if (
                compute_largest_gap(
                    m,
                    advance_pointer(row, SOLUTION),
                    advance_pointer(found.rows, stride * j + SOLUTION),
                )
                <= SAME
            ):
                same = j
        if same < 0:
            k += 1
            continue
        found.rows[stride * same + TURNS] += row[TURNS]
        drop_solution(found, count, k)
        count -= 1
    return count


@device
def count_listed_solutions(found, count):
    """Count the solutions that an answer must have room for; samples of curves may be left out."""
    rows = 0
    for k in range(count):
        rows += int(advance_pointer(found.rows, (SOLUTION + found.model.n) * k)[TURNS] > 0.0)
    return rows


@device
def drop_solution(found, count, k):
    """Drop solution k; the last solution takes its place."""
    stride = SOLUTION + found.model.n
    for i in range(stride):
        found.rows[stride * k + i] = found.rows[stride * (count - 1) + i]


@device
def choose_coordinate(slides, theta, numbers, near, edge):
    """Choose the coordinate of a variable among its whole turns: inside the limits, and nearest to
    `near`; return it and whether it is inside.

    What is beyond a limit by no more than `edge` is put on it; slides of a chain that is longer
    than 1 by as much more as the chain is longer, since rounding is.
    """
    q = (theta - numbers[OFFSET]) / numbers[FACTOR]
    low = numbers[LOW]
    high = numbers[HIGH]
    if slides:
        edge *= max(1.0, 1.0 / abs(numbers[FACTOR]))
        if not low - edge <= q <= high + edge:
            return q, False
    else:
        period = TWO_PI / abs(numbers[FACTOR])
        q += period * math.floor((near - q) / period + 0.5)
        if q > high + edge:
            q -= period * math.ceil((q - high - edge) / period)
        elif q < low - edge:
            q += period * math.ceil((low - edge - q) / period)
        if not low - edge <= q <= high + edge:  # no turn fits: the one nearest to `near`
            q += period * math.floor((near - q) / period + 0.5)
            return q, False
    return min(max(q, low), high), True


@routine
def write_row_coordinates(m, joints, row, near, edge, q):
    """Write the coordinates of one solution; return whether all are inside the limits, or beyond by
    at most `edge`.
    """
    inside = True
    for i in range(m.n):
        slides = m.kinds[i] == SLIDE
        numbers = advance_pointer(joints, JOINT_FLOATS * i)
        q[i], fits = choose_coordinate(slides, row[SOLUTION + i], numbers, near[i], edge)
        inside = inside and fits
    return inside


@routine
def move_to_limits(found, joints, row, near, q, out):
    """Return whether a double root nearer than SAME to the limits reaches the target inside them;
    write this solution to `out`.

    The tip does not feel a motion along its tangent: along it goes what is farthest beyond its
    limit, all the way.
    """
    m = found.model
    theta = advance_pointer(out, SOLUTION)
    if not write_row_coordinates(m, joints, row, near, SAME, q):
        return False
    compute_error(m, advance_pointer(row, SOLUTION))
    if not find_tangent(m, theta):
        return False
    farthest = 0.0
    way = 0.0
    for i in range(m.n):
        limit = joints[JOINT_FLOATS * i + FACTOR] * q[i] + joints[JOINT_FLOATS * i + OFFSET]
        d = compute_gap(m.kinds[i] == SLIDE, limit, row[SOLUTION + i])
        if abs(d) > farthest and abs(theta[i]) > SAME:
            farthest = abs(d)
            way = d / theta[i]
    for i in range(m.n):
        theta[i] = row[SOLUTION + i] + way * theta[i]
    linear, angular = compute_error(m, theta)
    out[ERROR] = linear
    out[ERROR + 1] = angular
    return (
        linear <= found.linear
        and angular <= found.angular
        and write_row_coordinates(m, joints, out, near, EDGE, q)
    )


@routine
def write_coordinates(found, joints, row, near, q):
    """Write the coordinates of one solution; return whether all are inside the limits."""
    m = found.model
    spare = advance_pointer(found.rows, (SOLUTION + found.model.n) * MOST_SOLUTIONS)
    if write_row_coordinates(m, joints, row, near, EDGE, q):
        return True
    if row[WEAKEST] < MERGED and move_to_limits(found, joints, row, near, q, spare):
        row[ERROR] = spare[ERROR]
        row[ERROR + 1] = spare[ERROR + 1]
        return True
    return write_row_coordinates(m, joints, row, near, EDGE, q)


@device
def is_row_before(n, joints, near, a, b):
    """Return whether row a of an answer comes before row b: inside the limits first, then nearer to
    `near`.
    """
    inside_a = int(a[n + CODE]) % 2
    inside_b = int(b[n + CODE]) % 2
    if inside_a != inside_b:
        return inside_a > inside_b
    da = db = 0.0
    for i in range(n):
        unit = joints[JOINT_FLOATS * i + FACTOR]
        da += (unit * (a[i] - near[i])) ** 2
        db += (unit * (b[i] - near[i])) ** 2
    return da < db


@routine
def sort_rows(n, joints, near, out, slots):
    """Sort the rows in use and put them first; return their number."""
    width = n + INFO
    used = 0
    for k in range(slots):
        if out[width * k + n + CODE] < 0.0:
            continue
        swap_rows(out, width, used, k)
        at = used
        used += 1
        while at > 0 and is_row_before(
            n,
            joints,
            near,
            advance_pointer(out, width * at),
            advance_pointer(out, width * (at - 1)),
        ):
            swap_rows(out, width, at, at - 1)
            at -= 1
    return used


@device
def swap_rows(out, width, a, b):
    """Exchange rows a and b."""
    if a != b:
        for i in range(width):
            out[width * a + i], out[width * b + i] = out[width * b + i], out[width * a + i]


# ---- folds

# Solutions where two roots nearly meet and polishing stopped between them: distinguished.


SETTLED = 1e-14
STEPS = 24
ASIDE = 1e-3
"""Error, in lengths of the chain, up to which a singular solution may be a double root; undamped
steps from so far aside along its tangent, each of which halves the distance to a root on that
side."""

BETTER = 0.1
"""By how much the error of a root on one side must be smaller than between the two."""


@routine
def polish_from_side(m, start, sign, theta):
    """Polish from a point beside `start` by undamped steps, written to `theta`; return the error,
    infinite where the steps diverge.
    """
    compute_error(m, start)
    if not find_tangent(m, theta):
        return math.inf
    step = advance_pointer(m.scratch, AT_AXES + 12 * m.n + m.n * m.n)
    for i in range(m.n):
        theta[i] = start[i] + sign * ASIDE * theta[i]
    for _ in range(STEPS):
        compute_error(m, theta)
        n = write_columns(m)
        k = 0
        size = 0.0
        if not compute_orthogonal_step(m, n, False):
            break
        for i in range(n):
            size = max(size, abs(step[i]))
        if not size < 2.0 * ASIDE:
            return math.inf
        for i in range(m.n):
            if m.moves[i] != 0:
                theta[i] += step[k]
                k += 1
    linear, angular = compute_error(m, theta)
    return math.hypot(linear, angular)


@routine
def split_merged_roots(found, count):
    """Replace each solution that stands between two roots by both roots; return the new number of
    solutions.
    """
    m = found.model
    stride = SOLUTION + found.model.n
    first = count
    spare = advance_pointer(found.rows, stride * MOST_SOLUTIONS)
    for k in range(first):
        row = advance_pointer(found.rows, stride * k)
        roots = 0
        error = math.hypot(row[ERROR], row[ERROR + 1])
        if (
            row[WEAKEST] > MERGED
            or row[TURNS] == 0.0
            or error <= SETTLED
            or count == MOST_SOLUTIONS
        ):
            continue
        other = advance_pointer(found.rows, stride * count)
        for side in range(2):
            theta = advance_pointer(other if side == 0 else spare, SOLUTION)
            roots += int(
                polish_from_side(m, advance_pointer(row, SOLUTION), 1.0 - 2.0 * side, theta)
                < BETTER * error
            )
        if (
            roots < 2
            or compute_largest_gap(
                m, advance_pointer(other, SOLUTION), advance_pointer(spare, SOLUTION)
            )
            <= SAME
        ):
            continue
        for i in range(SOLUTION):
            other[i] = row[i]
        other[TURNS] = max(1.0, math.floor(0.5 * row[TURNS]))
        row[TURNS] = max(1.0, row[TURNS] - other[TURNS])
        for i in range(m.n):
            row[SOLUTION + i] = spare[SOLUTION + i]
        row[ERROR], row[ERROR + 1] = compute_error(m, advance_pointer(row, SOLUTION))
        other[ERROR], other[ERROR + 1] = compute_error(m, advance_pointer(other, SOLUTION))
        count += 1
    return count
