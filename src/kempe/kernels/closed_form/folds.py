"""Solutions where two roots nearly meet and polishing stopped between them: distinguished."""

from __future__ import annotations

import math

from kempe.kernels.base._jit import routine
from kempe.kernels.base.scratch import beyond
from kempe.kernels.closed_form.merging import (
    ERROR,
    MERGED,
    MOST_SOLUTIONS,
    SAME,
    SOLUTION,
    TURNS,
    WEAKEST,
    distance,
)
from kempe.kernels.closed_form.polish import AT_AXES, columns_at, error_at, orthogonal_step, tangent

SETTLED = 1e-14
STEPS = 24
ASIDE = 1e-3
"""Error, in lengths of the chain, up to which a singular solution may be a double root; undamped
steps from so far aside along its tangent, each of which halves the distance to a root on that
side."""

BETTER = 0.1
"""By how much the error of a root on one side must be smaller than between the two."""


@routine
def one_side(m, start, sign, theta):
    """The error where undamped steps lead from a point aside of `start`, written to theta, infinite
    if they leave.
    """
    error_at(m, start)
    if not tangent(m, theta):
        return math.inf
    step = beyond(m.scratch, AT_AXES + 12 * m.n + m.n * m.n)
    for i in range(m.n):
        theta[i] = start[i] + sign * ASIDE * theta[i]
    for _ in range(STEPS):
        error_at(m, theta)
        n = columns_at(m)
        k = 0
        size = 0.0
        if not orthogonal_step(m, n, False):
            break
        for i in range(n):
            size = max(size, abs(step[i]))
        if not size < 2.0 * ASIDE:
            return math.inf
        for i in range(m.n):
            if m.moves[i] != 0:
                theta[i] += step[k]
                k += 1
    linear, angular = error_at(m, theta)
    return math.hypot(linear, angular)


@routine
def split(found, count):
    """New number of solutions: of those that stand between two roots, both roots."""
    m = found.model
    stride = SOLUTION + found.model.n
    first = count
    spare = beyond(found.rows, stride * MOST_SOLUTIONS)
    for k in range(first):
        row = beyond(found.rows, stride * k)
        roots = 0
        error = math.hypot(row[ERROR], row[ERROR + 1])
        if (
            row[WEAKEST] > MERGED
            or row[TURNS] == 0.0
            or error <= SETTLED
            or count == MOST_SOLUTIONS
        ):
            continue
        other = beyond(found.rows, stride * count)
        for side in range(2):
            theta = beyond(other if side == 0 else spare, SOLUTION)
            roots += int(
                one_side(m, beyond(row, SOLUTION), 1.0 - 2.0 * side, theta) < BETTER * error
            )
        if roots < 2 or distance(m, beyond(other, SOLUTION), beyond(spare, SOLUTION)) <= SAME:
            continue
        for i in range(SOLUTION):
            other[i] = row[i]
        other[TURNS] = max(1.0, math.floor(0.5 * row[TURNS]))
        row[TURNS] = max(1.0, row[TURNS] - other[TURNS])
        for i in range(m.n):
            row[SOLUTION + i] = spare[SOLUTION + i]
        row[ERROR], row[ERROR + 1] = error_at(m, beyond(row, SOLUTION))
        other[ERROR], other[ERROR + 1] = error_at(m, beyond(other, SOLUTION))
        count += 1
    return count
