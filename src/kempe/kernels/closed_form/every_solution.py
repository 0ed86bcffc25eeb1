"""Every configuration that reaches a target, one target after the other: the careful path, which
takes any plan.
"""

from __future__ import annotations

import numpy as np

from kempe.kernels.base._jit import device, kernel
from kempe.kernels.base.declare import FLOAT, INT, OUT, OUTI, F, I
from kempe.kernels.base.scratch import beyond
from kempe.kernels.base.vectors import keep, raw
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
    closed_candidates,
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
    listed,
    split,
)
from kempe.kernels.closed_form.one_target import (
    begin,
    end,
    take_candidates,
    target_scratch,
    target_scratch_size,
)


@device
def led_nowhere(d, candidates, count):
    """Whether a joint was free, or nearly, but the values that were tried lead to no singular
    solution.

    Or to samples on target within the tolerance only: then there are roots somewhere.
    """
    tried = False
    singular = False
    exact = True
    for k in range(candidates):
        tried = tried or d.candidates[CANDIDATE * k + SAMPLE] > REPEATED
    for k in range(count):
        row = beyond(d.found.rows, (SOLUTION + d.n) * k)
        if row[TURNS] == 0.0:
            exact = exact and max(row[ERROR], row[ERROR + 1]) <= UNSURE
        elif row[WEAKEST] < MERGED:
            singular = True
    sampled = listed(d.found, count) < count
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
def closed(ints, floats, targets, near, locked, tol_linear, tol_angular, sort, which, out, counts):
    """Find all solutions by closed form of the targets whose numbers are in `which`.

    ints, floats: plan, see `analytic_layout`. targets: (N, 4, 4). near: (1 or N, n), of each angle
    the turn nearest to it is given. locked: (1 or N, n) coordinates of which those of locked joints
    are read. tol_linear [m], tol_angular: largest errors of a solution. sort: 1 for rows in order,
    nearest first, else each is in the row of its slot. out: (N, K, n + INFO) coordinates, error,
    code. counts: (N, 2) rows in use, -1 for a target that is no pose, and whether in doubt.
    """
    n = ints[N_JOINTS]
    slots = out.shape[1]
    block = np.empty(target_scratch_size(n) + SCRATCH)
    flags = np.empty(6 + slots, np.int64)
    d = target_scratch(raw(ints), raw(floats), raw(block), raw(flags), tol_linear, tol_angular)
    scratch = beyond(raw(block), target_scratch_size(n))
    for i in which:
        close_to = beyond(raw(near), n * i if near.shape[0] > 1 else 0)
        held = beyond(raw(locked), n * i if locked.shape[0] > 1 else 0)
        sound = begin(d, beyond(raw(targets), 16 * i), close_to, held)
        count = 0
        doubt = False
        if sound:
            k, doubt = closed_candidates(
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
            count = take_candidates(d, beyond(d.ints, ORDER), 0, k, ROOT, 0)
            doubt = doubt or led_nowhere(d, k, count)
            count = split(d.found, count)
            doubt = (
                doubt
                or listed(d.found, count) > slots
                or count == MOST_SOLUTIONS
                or k == MOST_CANDIDATES
            )
        written = end(d, count, close_to, beyond(raw(out), slots * (n + INFO) * i), slots, sort)
        counts[i, 0] = written if sound else -1
        counts[i, 1] = int(doubt)
    keep(block)
    keep(flags)
