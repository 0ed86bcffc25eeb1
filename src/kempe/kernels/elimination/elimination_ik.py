"""Every configuration that reaches a target, for chains of six joints without structure: by
elimination.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import FLOAT, INT, OUT, OUTI, F, I
from kempe.kernels.base.random import mix, unit
from kempe.kernels.base.scratch import beyond
from kempe.kernels.base.vectors import keep, raw
from kempe.kernels.closed_form.analytic_layout import (
    FORMS,
    INFO,
    N_FORMS,
    N_JOINTS,
    ORDER,
    REST,
    ROLES,
)
from kempe.kernels.closed_form.candidates import CANDIDATE, SAMPLE
from kempe.kernels.closed_form.candidates import SLOT as CANDIDATE_SLOT
from kempe.kernels.closed_form.folds import split
from kempe.kernels.closed_form.merging import (
    AGAIN,
    CLOSE,
    MERGED,
    MOST_SOLUTIONS,
    ROOT,
    SOLUTION,
    TURNS,
    UNSURE,
    WEAKEST,
    add,
    distance,
    listed,
)
from kempe.kernels.closed_form.one_target import (
    begin,
    end,
    take_candidates,
    target_scratch,
    target_scratch_size,
)
from kempe.kernels.closed_form.polish import error_at, polish, tangent
from kempe.kernels.elimination.elimination import ELIMINATION_SCRATCH, FREE, UNSOUND, eliminate
from kempe.kernels.elimination.elimination_confirm import (
    ALONE,
    CONFIRM_SCRATCH,
    confirmed,
    kind_of,
    thinned,
)
from kempe.kernels.forward.table_layout import SLIDE

STARTS = 64
PACES = 40
PACE = 0.3
"""Starts where a joint is nearly free; steps of a walk along what is nearly a self-motion, and
their length."""

FOLD = 1e-4
"""Bound of the smallest singular value squared of a solution in which two roots may have merged."""

CROWDED = 16
"""More solutions than isolated ones are possible."""

EVEN = -1
UNEXPLAINED = -2
"""An even number of solutions; an odd one of which no solution is a double one."""


@routine
def searched(d, count):
    """New number of solutions after a few starts anywhere: it is hard to miss a self-motion."""
    for i in range(STARTS):
        row = beyond(d.candidates, CANDIDATE * i)
        key = mix(np.uint64(0), np.uint64(i))
        for j in range(6):
            x = 2.0 * unit(mix(key, np.uint64(j))) - 1.0
            row[j] = x if d.kinds[j] == SLIDE else math.pi * x
        row[CANDIDATE_SLOT] = -1.0
        row[SAMPLE] = 0.0
    return take_candidates(d, beyond(d.ints, ORDER), 0, STARTS, AGAIN, count)


@routine
def walked(d, count):
    """New number of solutions, those added that lie on the same nearly closed way of nearly
    singular postures.

    A goal next to one that has a curve of solutions has a few, anywhere along it: damped steps lead
    back to the curve, undamped ones along it. A true self-motion is left alone.
    """
    m = d.found.model
    k = 0
    here = d.candidates
    ahead = beyond(d.candidates, d.n)
    before = beyond(d.candidates, 2 * d.n)
    while k < count:
        row = beyond(d.found.rows, (SOLUTION + d.n) * k)
        k += 1
        for i in range(d.n if row[WEAKEST] < MERGED else 0):
            here[i] = row[SOLUTION + i]
            before[i] = 0.0
        for pace in range(PACES if row[WEAKEST] < MERGED else 0):
            error_at(m, here)
            if not tangent(m, ahead):
                break
            cosine = 0.0
            for i in range(d.n):
                cosine += ahead[i] * before[i]
            for i in range(d.n):
                before[i] = -ahead[i] if cosine < 0.0 else ahead[i]
                d.theta[i] = here[i] + PACE * before[i]
            linear, angular = polish(m, d.theta)
            moved = distance(m, d.theta, here)
            if not UNSURE < max(linear, angular) < CLOSE or not 0.2 * PACE < moved < 2.0 * PACE:
                break
            for i in range(d.n):
                here[i] = d.theta[i]
            count = add(d.found, count, d.theta, -1.0, AGAIN)
            if pace > 1 and distance(m, here, beyond(row, SOLUTION)) < 0.5 * PACE:
                break
    return count


@device
def rests(d):
    """Whether lines must stay at rest: then most roots are no solutions."""
    for i in range(6):
        if d.ints[ROLES + i] == REST:
            return True
    return False


@routine
def parity(d, count):
    """Place of the one solution where two roots have merged, which explains an odd number; or EVEN,
    or UNEXPLAINED.

    Where lines must stay at rest, most roots are no solutions, and any number is right.
    """
    total = 0.0
    folds = 0
    at = 0
    if rests(d):
        return EVEN
    for k in range(count):
        row = beyond(d.found.rows, (SOLUTION + d.n) * k)
        total += row[TURNS]
        if row[WEAKEST] < FOLD and row[TURNS] == 1.0 and kind_of(d, row) == ALONE:
            folds += 1
            at = k
    if total % 2.0 == 0.0:
        return EVEN
    return at if folds == 1 else UNEXPLAINED


@routine
def mark_fold(d, count):
    """Whether the number of solutions is even, or is explained: a solution where two roots have
    merged counts twice.
    """
    at = parity(d, count)
    if at >= 0:
        beyond(d.found.rows, (SOLUTION + d.n) * at)[TURNS] = 2.0
    return at != UNEXPLAINED


@routine
def eliminated(d, scratch, thetas):
    """(number of solutions, doubt): formulations are tried until the answer of one of them is
    beyond doubt.

    It is where each root of one formulation has a solution of its own, or of two, except for
    singular solutions.
    """
    count = 0
    doubt = 1
    free = False
    crowded = False
    witnesses = 0
    resting = rests(d)
    for f in range(d.ints[N_FORMS]):
        k, strays, suspect = eliminate(d.kinds, d.six, d.goal, d.ints[FORMS + f], scratch, thetas)
        for i in range(k + strays):
            row = beyond(d.candidates, CANDIDATE * i)
            for j in range(6):
                row[j] = thetas[6 * i + j]
            row[CANDIDATE_SLOT] = -1.0
            row[SAMPLE] = 0.0
        before = count
        free = free or suspect & FREE != 0
        count = take_candidates(d, beyond(d.ints, ORDER), 0, k, ROOT if f == 0 else AGAIN, count)
        count = take_candidates(d, beyond(d.ints, ORDER), k, k + strays, AGAIN, count)
        if count > CROWDED:
            crowded = True
            count = thinned(d, 0, count)
        enough = count > 0 or f >= 2  # that there is no solution has to be said thrice
        each = (
            resting or count == k
        )  # no two were the same in the end, and none was missed that is known
        clean = suspect == 0 or (
            count == 0 and suspect == FREE
        )  # far away the leading matrix is small
        if clean and enough and (f == 0 or count == before) and each:
            doubt = 0
            break
        witnesses = (witnesses if count == before else 0) + int(suspect & UNSOUND == 0 and each)
        if (
            witnesses > 1
            and not crowded
            and count == before
            and enough
            and each
            and parity(d, count) != UNEXPLAINED
        ):
            doubt = 0
            break
    count = walked(d, searched(d, count)) if free else count
    return count, doubt if count < MOST_SOLUTIONS else 1


@kernel(
    I("_"),
    F("_"),
    F("N", 4, 4),
    F("1|N", "n"),
    F("1|N", "n"),
    FLOAT,
    FLOAT,
    INT,
    I("_"),
    OUT("N", "_", f"n+{INFO}"),
    OUTI("N", 2),
    returns=False,
)
def general(ints, floats, targets, near, locked, tol_linear, tol_angular, sort, which, out, counts):
    """Find all solutions by elimination, arguments as of `every_solution.closed`; counts[:, 1] is 1
    in doubt.
    """
    n = ints[N_JOINTS]
    slots = out.shape[1]
    block = np.empty(target_scratch_size(n) + CONFIRM_SCRATCH)
    flags = np.empty(6 + slots, np.int64)
    d = target_scratch(raw(ints), raw(floats), raw(block), raw(flags), tol_linear, tol_angular)
    scratch = beyond(raw(block), target_scratch_size(n))
    for i in which:
        close_to = beyond(raw(near), n * i if near.shape[0] > 1 else 0)
        held = beyond(raw(locked), n * i if locked.shape[0] > 1 else 0)
        sound = begin(d, beyond(raw(targets), 16 * i), close_to, held)
        count = 0
        doubt = 0
        if sound:
            count, doubt = eliminated(d, scratch, beyond(scratch, ELIMINATION_SCRATCH))
            count = split(d.found, count)
            if not mark_fold(d, count):
                doubt = 1
            if doubt == 1 or listed(d.found, count) > slots:
                count = thinned(d, 0, count)
            if doubt == 1 and not rests(d):
                count, sure = confirmed(d, count, scratch, beyond(scratch, ELIMINATION_SCRATCH))
                doubt = 0 if sure else 1
            if listed(d.found, count) > slots:
                doubt = 1
        written = end(d, count, close_to, beyond(raw(out), slots * (n + INFO) * i), slots, sort)
        counts[i, 0] = written if sound else -1
        counts[i, 1] = doubt
    keep(block)
    keep(flags)
