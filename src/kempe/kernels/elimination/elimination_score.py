"""Which formulations suit a chain: each is tried on a few postures that are known."""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import OUT, F, I
from kempe.kernels.base.random import mix_bits, to_unit_interval
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.closed_form.analytic_layout import FORMULATIONS
from kempe.kernels.elimination.elimination import (
    CANDIDATES,
    ELIMINATION_SCRATCH,
    FOUNDLINGS,
    eliminate_unknowns,
)
from kempe.kernels.elimination.elimination_loop import (
    LINE_STRIDE,
    find_hidden_joint,
    find_removed_joint,
)
from kempe.kernels.elimination.elimination_polish import (
    FOUND,
    POLISH_SIZE,
    POSE,
    RAW_ERROR,
    trace_lines,
    wrap_angle,
)
from kempe.kernels.forward.table_layout import SLIDE

FIRST = 5
SECOND = 20
BEST = 8
"""Postures that every formulation is tried on; more of them, for the BEST formulations only."""

SUSPECT = 0.1
FAVOUR = 0.9
HASTY = 0.5
"""Factors of credit for a suspect answer; for an eigenproblem of 24 rows; for what few postures
only have shown."""

DIGITS = 14.0
"""Digits of the error before Newton's steps that earn full credit."""

SAME = 1e-4
"""Coordinates that differ by less are the posture sought."""


@device
def _credit_posture(kinds, theta, w, count):
    """Return 0 if the posture theta is not among the candidates, else a credit for the digits that
    it had before Newton's steps.
    """
    best = 0.0
    for k in range(count):
        p = FOUNDLINGS + FOUND * k
        far = 0.0
        for j in range(6):
            d = w[p + j] - theta[j]
            far = max(far, abs(d if kinds[j] == SLIDE else wrap_angle(d)))
        if far < SAME:
            best = min(max(-math.log10(w[p + RAW_ERROR] + 1e-300) / DIGITS, 0.05), 1.0)
    return best


@routine
def _write_known_posture(kinds, lines, i, theta, goal, work):
    """Write posture i and the goal that it reaches."""
    key = mix_bits(mix_bits(np.uint64(0), np.uint64(i)), np.uint64(0))
    for j in range(6):
        x = 2.0 * to_unit_interval(mix_bits(key, np.uint64(j))) - 1.0
        theta[j] = x if kinds[j] == SLIDE else math.pi * x
    trace_lines(kinds, lines, theta, work)
    for j in range(12):
        goal[j] = work[POSE + j]


@device
def _choose_best_formulation(scores):
    """Return the formulation with the highest score."""
    best = 0
    for f in range(1, FORMULATIONS):
        if scores[f] > scores[best]:
            best = f
    return best


@kernel(I(6), F(6, LINE_STRIDE), OUT(FORMULATIONS))
def score_formulations(kinds, lines, scores):
    """Score the formulations by postures that are known; return the number of formulations with a
    score above 0.

    kinds: (6,). lines: (6, LINE_STRIDE). scores: (FORMULATIONS,), 0 (useless) to 1: the mean
    credit, where a suspect answer earns little, and a second miss ends the trial with 0.
    """
    block = np.zeros(ELIMINATION_SCRATCH + 6 * CANDIDATES + 18 + POLISH_SIZE)
    w = get_pointer(block)
    k = get_pointer(kinds)
    h = get_pointer(lines)
    s = get_pointer(scores)
    out = advance_pointer(w, ELIMINATION_SCRATCH)
    goal = advance_pointer(out, 6 * CANDIDATES)
    theta = advance_pointer(goal, 12)
    work = advance_pointer(goal, 18)
    for trial in range(FORMULATIONS + BEST):
        again = trial >= FORMULATIONS
        f = _choose_best_formulation(s) if again else trial
        if again and not s[f] > 0.0:
            break
        sum_ = 0.0
        misses = 2 if k[find_removed_joint(f)] == SLIDE else 0
        first, last = (FIRST, FIRST + SECOND) if again else (0, FIRST)
        for i in range(first, last):
            if misses > 1:
                break
            _write_known_posture(k, h, i, theta, goal, work)
            count, _, suspect = eliminate_unknowns(k, h, goal, f, w, out)
            credit = _credit_posture(k, theta, w, count)
            misses += int(credit == 0.0)
            sum_ += credit if suspect == 0 else SUSPECT * credit
        sum_ *= 0.0 if misses > 1 else (1.0 if find_hidden_joint(f) == 0 else FAVOUR)
        if again:  # negative: tried on all postures
            s[f] = -(s[f] * FIRST + sum_) / (FIRST + SECOND) if sum_ > 0.0 else 0.0
        else:
            s[f] = sum_ / FIRST
    useful = 0
    for f in range(FORMULATIONS):
        s[f] = -s[f] if s[f] < 0.0 else HASTY * s[f]
        useful += int(s[f] > 0.0)
    keep_alive(block)
    return useful
