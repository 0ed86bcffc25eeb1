"""Every configuration that reaches a target, for chains of six joints without structure: by elimination."""

from __future__ import annotations

import numpy as np
from numba import types

from kempe.kernels._jit import F1, F2, F3, I1, OUT3, OUTI2, kernel, routine
from kempe.kernels.analytic_layout import FORMS, INFO, N_FORMS, N_JOINTS, ORDER, REST, ROLES
from kempe.kernels.closed import CANDIDATE, SAMPLE
from kempe.kernels.closed import SLOT as CANDIDATE_SLOT
from kempe.kernels.desk import begin, desk_of, desk_scratch, end, take_candidates
from kempe.kernels.distinct import AGAIN, ROOT, SOLUTION, TURNS, WEAKEST
from kempe.kernels.elimination import CANDIDATES, ELIMINATION_SCRATCH, eliminate
from kempe.kernels.scratch import beyond
from kempe.kernels.vectors import keep, raw

FOLD = 1e-4
"""Bound of the smallest singular value squared of a solution in which two roots may have merged."""


@routine
def eliminated(d, scratch, thetas):
    """(number of solutions, doubt): formulations are tried until the answer of one of them is beyond doubt."""
    count, doubt = 0, 1
    for f in range(d.ints[N_FORMS]):
        k, suspect = eliminate(d.kinds, d.six, d.goal, d.ints[FORMS + f], scratch, thetas)
        for i in range(k):
            row = beyond(d.candidates, CANDIDATE * i)
            for j in range(6):
                row[j] = thetas[6 * i + j]
            row[CANDIDATE_SLOT], row[SAMPLE] = -1.0, 0.0
        before = count
        count = take_candidates(d, beyond(d.ints, ORDER), k, ROOT if f == 0 else AGAIN, count)
        enough = count > 0 or f >= 2  # that there is no solution has to be said thrice
        if suspect == 0 and enough and (f == 0 or count == before):
            doubt = 0
            break
        if f > 0 and enough and count == before and count % 2 == 0:  # two formulations agree
            doubt = 0
            break
    return count, doubt


@routine
def mark_fold(d, count):
    """Whether an odd number of solutions is explained: one of them is where two roots have merged; it counts twice.

    Where lines must stay at rest, most roots are no solutions, and any number is right.
    """
    total, folds, at = 0.0, 0, 0
    for i in range(6):
        if d.ints[ROLES + i] == REST:
            return True
    for k in range(count):
        row = beyond(d.found.rows, (SOLUTION + d.n) * k)
        total += row[TURNS]
        if row[WEAKEST] < FOLD and row[TURNS] == 1.0:
            folds += 1
            at = k
    if total % 2.0 == 0.0:
        return True
    if folds != 1:
        return False
    beyond(d.found.rows, (SOLUTION + d.n) * at)[TURNS] = 2.0
    return True


@kernel(types.void(I1, F1, F3, F2, F2, types.float64, types.float64, types.int64, I1, OUT3, OUTI2))
def general(ints, floats, targets, near, locked, tol_linear, tol_angular, sort, which, out, counts):
    """Nothing; all solutions by elimination, arguments as of `all_solutions.closed`; counts[:, 1] is 1 in doubt."""
    n, slots = ints[N_JOINTS], out.shape[1]
    block = np.empty(desk_scratch(n) + ELIMINATION_SCRATCH + 6 * CANDIDATES)
    flags = np.empty(6 + slots, np.int64)
    d = desk_of(raw(ints), raw(floats), raw(block), raw(flags), tol_linear, tol_angular)
    scratch = beyond(raw(block), desk_scratch(n))
    for i in which:
        close_to = beyond(raw(near), n * i if near.shape[0] > 1 else 0)
        held = beyond(raw(locked), n * i if locked.shape[0] > 1 else 0)
        sound, count, doubt = begin(d, beyond(raw(targets), 16 * i), close_to, held), 0, 0
        if sound:
            count, doubt = eliminated(d, scratch, beyond(scratch, ELIMINATION_SCRATCH))
            if not mark_fold(d, count):
                doubt = 1
        written = end(d, count, close_to, beyond(raw(out), slots * (n + INFO) * i), slots, sort)
        counts[i, 0], counts[i, 1] = written if sound else -1, doubt
    keep(block)
    keep(flags)
