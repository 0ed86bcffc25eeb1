"""Which formulations suit a chain: each is tried on a few postures that are known."""

from __future__ import annotations

import math

import numpy as np
from numba import types

from kempe.kernels._jit import F2, I1, OUT1, device, kernel, routine
from kempe.kernels.elimination import (
    CANDIDATES,
    ELIMINATION_SCRATCH,
    FOUND,
    FOUNDLINGS,
    RAW_ERROR,
    eliminate,
)
from kempe.kernels.elimination_loop import FORMULATIONS, hidden_of, removed_of
from kempe.kernels.elimination_polish import POLISH_SIZE, POSE, trace, wrapped
from kempe.kernels.layout import SLIDE
from kempe.kernels.random import mix, unit
from kempe.kernels.scratch import beyond
from kempe.kernels.vectors import keep, raw

FIRST, SECOND, BEST = 5, 20, 8
"""Postures that every formulation is tried on; more of them, for the BEST formulations only."""

FAVOUR, HASTY = 0.9, 0.5
"""Factors of scores: with an eigenproblem of 24 rows; of formulations tried on the first few postures only."""

DIGITS = 14.0
"""Digits of the error before Newton's steps that earn full credit."""

SAME = 1e-4
"""Coordinates that differ by less are the posture sought."""


@device
def _credit(kinds, theta, w, count):
    """0 if the posture theta is not among the candidates, else by the digits that it had before Newton's steps."""
    best = 0.0
    for k in range(count):
        p, far = FOUNDLINGS + FOUND * k, 0.0
        for j in range(6):
            d = w[p + j] - theta[j]
            far = max(far, abs(d if kinds[j] == SLIDE else wrapped(d)))
        if far < SAME:
            best = min(max(-math.log10(w[p + RAW_ERROR] + 1e-300) / DIGITS, 0.05), 1.0)
    return best


@routine
def credit_of(kinds, lines, formulation, first, last, w, out):
    """Sum of the credits for postures first to last - 1; a suspect answer earns half, a second miss ends it with 0."""
    sum_, misses = 0.0, 0
    goal = beyond(out, 6 * CANDIDATES)
    theta = beyond(goal, 12)
    work = beyond(theta, 6)
    for i in range(first, last):
        key = mix(mix(np.uint64(0), np.uint64(i)), np.uint64(0))
        for j in range(6):
            x = 2.0 * unit(mix(key, np.uint64(j))) - 1.0
            theta[j] = x if kinds[j] == SLIDE else math.pi * x
        trace(kinds, lines, theta, work)
        for j in range(12):
            goal[j] = work[POSE + j]
        count, suspect = eliminate(kinds, lines, goal, formulation, w, out)
        credit = _credit(kinds, theta, w, count)
        misses += int(credit == 0.0)
        if misses > 1:
            return 0.0
        sum_ += credit if suspect == 0 else 0.5 * credit
    return sum_


@kernel(types.int64(I1, F2, OUT1))
def score(kinds, lines, scores):
    """Number of formulations with a score above 0.

    kinds: (6,). lines: (6, LINE_STRIDE). scores: (FORMULATIONS,), 0 (useless) to 1.
    """
    block = np.zeros(ELIMINATION_SCRATCH + 6 * CANDIDATES + 18 + POLISH_SIZE)
    w, k, h = raw(block), raw(kinds), raw(lines)
    out = beyond(w, ELIMINATION_SCRATCH)
    for f in range(FORMULATIONS):
        useless = kinds[removed_of(f)] == SLIDE
        scores[f] = 0.0 if useless else credit_of(k, h, f, 0, FIRST, w, out) / FIRST
        scores[f] *= 1.0 if hidden_of(f) == 0 else FAVOUR
    for _ in range(BEST):
        f = 0
        for i in range(1, FORMULATIONS):
            if scores[i] > scores[f]:
                f = i
        if not scores[f] > 0.0:
            break
        more = credit_of(k, h, f, FIRST, FIRST + SECOND, w, out)
        more *= 1.0 if hidden_of(f) == 0 else FAVOUR
        # negative: tried on all
        scores[f] = -(scores[f] * FIRST + more) / (FIRST + SECOND) if more > 0.0 else 0.0
    useful = 0
    for f in range(FORMULATIONS):
        scores[f] = -scores[f] if scores[f] < 0.0 else HASTY * scores[f]
        useful += int(scores[f] > 0.0)
    keep(block)
    return useful
