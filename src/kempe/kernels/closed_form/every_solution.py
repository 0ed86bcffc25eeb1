"""Closed-form search of every configuration that reaches a target, for any plan, one target after
the other.
"""

from __future__ import annotations

import numpy as np

from kempe.kernels.base._jit import device, kernel
from kempe.kernels.base.declare import FLOAT, INT, OUT, OUTI, F, I
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.closed_form.analytic_layout import (
    INFO,
    INNER,
    MEASURE,
    MODE,
    N_JOINTS,
    OPTION,
    ORDER,
    WHAT,
)
from kempe.kernels.closed_form.arm_part import REPEATED
from kempe.kernels.closed_form.candidates import (
    CANDIDATE,
    MOST_CANDIDATES,
    SAMPLE,
    SCRATCH,
    find_candidates,
)
from kempe.kernels.closed_form.merging import (
    ERROR,
    MERGED,
    MOST_SOLUTIONS,
    ROOT,
    SOLUTION,
    TURNS,
    UNSURE,
    WEAKEST,
    count_listed_solutions,
    split_merged_roots,
)
from kempe.kernels.closed_form.one_target import (
    add_candidates,
    begin_target,
    count_target_scratch,
    finish_target,
    make_target_scratch,
)


@device
def has_failed_samples(d, candidates, count):
    """Return whether a joint was free, or nearly free, but none of its sampled values led to a
    singular solution.

    Or to samples on target within the tolerance only: then there are roots somewhere.
    """
    tried = False
    singular = False
    exact = True
    for k in range(candidates):
        tried = tried or d.candidates[CANDIDATE * k + SAMPLE] > REPEATED
    for k in range(count):
        row = advance_pointer(d.found.rows, (SOLUTION + d.n) * k)
        if row[TURNS] == 0.0:
            exact = exact and max(row[ERROR], row[ERROR + 1]) <= UNSURE
        elif row[WEAKEST] < MERGED:
            singular = True
    sampled = count_listed_solutions(d.found, count) < count
    return tried and not singular and not (sampled and exact)


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
def find_closed_form_solutions(
    ints, floats, targets, near, locked, tol_linear, tol_angular, sort, which, out, counts
):
    """Find all solutions by closed form of the targets whose numbers are in `which`.

    ints, floats: plan, see `analytic_layout`. targets: (N, 4, 4). near: (1 or N, n), of each angle
    the turn nearest to it is given. locked: (1 or N, n) coordinates of which those of locked joints
    are read. tol_linear [m], tol_angular: largest errors of a solution. sort: 1 for rows in order,
    nearest first, else each is in the row of its slot. out: (N, K, n + INFO) coordinates, error,
    code. counts: (N, 2) rows in use, -1 for a target that is no pose, and whether in doubt.
    """
    n = ints[N_JOINTS]
    slots = out.shape[1]
    block = np.empty(count_target_scratch(n) + SCRATCH)
    flags = np.empty(6 + slots, np.int64)
    d = make_target_scratch(
        get_pointer(ints),
        get_pointer(floats),
        get_pointer(block),
        get_pointer(flags),
        tol_linear,
        tol_angular,
    )
    scratch = advance_pointer(get_pointer(block), count_target_scratch(n))
    for i in which:
        close_to = advance_pointer(get_pointer(near), n * i if near.shape[0] > 1 else 0)
        held = advance_pointer(get_pointer(locked), n * i if locked.shape[0] > 1 else 0)
        sound = begin_target(d, advance_pointer(get_pointer(targets), 16 * i), close_to, held)
        count = 0
        doubt = False
        if sound:
            k, doubt = find_candidates(
                d.kinds,
                d.six,
                d.goal,
                ints[INNER],
                ints[WHAT],
                ints[MODE],
                ints[MEASURE],
                ints[OPTION],
                scratch,
                d.candidates,
            )
            count = add_candidates(d, advance_pointer(d.ints, ORDER), 0, k, ROOT, 0)
            doubt = doubt or has_failed_samples(d, k, count)
            count = split_merged_roots(d.found, count)
            doubt = (
                doubt
                or count_listed_solutions(d.found, count) > slots
                or count == MOST_SOLUTIONS
                or k == MOST_CANDIDATES
            )
        written = finish_target(
            d,
            count,
            close_to,
            advance_pointer(get_pointer(out), slots * (n + INFO) * i),
            slots,
            sort,
        )
        counts[i, 0] = written if sound else -1
        counts[i, 1] = int(doubt)
    keep_alive(block)
    keep_alive(flags)
