"""Every configuration that reaches a target, one target after the other: the careful path, which takes any plan."""

from __future__ import annotations

import math

import numpy as np
from numba import types

from kempe.kernels._jit import F1, F2, F3, I1, OUT3, OUTI1, device, kernel, routine
from kempe.kernels.analytic_layout import (
    CODE,
    FACTOR,
    GAUGE,
    INFO,
    INNER,
    INSIDE_BIT,
    JOINT_FLOATS,
    LENGTH,
    LINES,
    MEASURE,
    MODE,
    MULTIPLICITY_UNIT,
    N_JOINTS,
    N_LINES,
    OPTION,
    ORDER,
    ORIGIN,
    PLAN_HEADER,
    REST,
    ROLES,
    SLOT_UNIT,
    TASK,
    TIP,
    UNUSED,
    WEAK_BIT,
    WHAT,
)
from kempe.kernels.analytic_layout import ERROR as ERROR_AT
from kempe.kernels.closed import CANDIDATE, MOST_CANDIDATES, SAMPLE, SCRATCH, closed_candidates
from kempe.kernels.closed import SLOT as CANDIDATE_SLOT
from kempe.kernels.distinct import (
    ERROR,
    MOST_SOLUTIONS,
    SIGNS,
    SOLUTION,
    TURNS,
    WEAKEST,
    Found,
    add,
    arrange,
    coordinates,
)
from kempe.kernels.layout import SLIDE
from kempe.kernels.lines import (
    LINE_STRIDE,
    dot,
    follow,
    identity,
    mapped,
    minus,
    rotated,
    three,
    translation,
    write3,
)
from kempe.kernels.polish import Model, model_scratch
from kempe.kernels.scratch import beyond
from kempe.kernels.vectors import keep, raw

OFF_ZERO = 0.2
"""How far from zero a joint that must rest there may be in a candidate: polishing may still bring it to a solution."""

WEAK = 1e-6
"""Bound of the smallest singular value squared below which a solution is near a singularity."""

ROTATION_TOLERANCE = 1e-6
"""Largest entry of R^T R - 1 that a target's rotation may have."""


@routine
def take_target(targets, k, floats, out):
    """Whether the 4x4 pose at targets[k:] is sound; writes its rows, seen from the plan's origin in its length."""
    sound = True
    for i in range(3):
        for j in range(4):
            out[4 * i + j] = targets[k + 4 * i + j]
        out[4 * i + 3] = (out[4 * i + 3] - floats[ORIGIN + i]) / floats[LENGTH]
        sound = sound and abs(out[4 * i + 3]) < 1e100
    for i in range(3):
        for j in range(3):
            product = out[i] * out[j] + out[4 + i] * out[4 + j] + out[8 + i] * out[8 + j]
            sound = sound and abs(product - (1.0 if i == j else 0.0)) <= ROTATION_TOLERANCE
    z = out[0] * out[5] - out[1] * out[4]
    det = out[10] * z + out[6] * (out[1] * out[8] - out[0] * out[9]) + out[2] * (out[4] * out[9] - out[5] * out[8])
    return sound and det > 0.0


@device
def goal_of(target, tip, goal):
    """Write G = T M^-1."""
    for i in range(3):
        row = three(target, 4 * i)
        for j in range(3):
            goal[4 * i + j] = dot(row, three(tip, 4 * j))
    p = minus(translation(target), rotated(goal, translation(tip)))
    goal[3], goal[7], goal[11] = p[0], p[1], p[2]


@routine
def six_lines(ints, floats, moves, theta, goal, shift, six, kinds):
    """Nothing; the six lines of the plan with the locked joints at their values, and the goal without these.

    A locked joint carries all lines that follow it: E_1 E_l E_2 = E_1 (E_l E_2 E_l^-1) E_l.
    """
    n = ints[N_JOINTS]
    identity(shift)
    for i in range(ints[N_LINES]):
        at = LINES + LINE_STRIDE * i
        h, o = three(floats, at), three(floats, at + 4)
        if i < n and moves[i] == 0:
            slides = ints[PLAN_HEADER + i] == SLIDE
            follow(shift, h, o, slides, theta[i], math.cos(theta[i]), math.sin(theta[i]))
            continue
        for k in range(6):
            if ints[ORDER + k] == i:
                kinds[k] = ints[PLAN_HEADER + i]
                write3(six, LINE_STRIDE * k, rotated(shift, h))
                write3(six, LINE_STRIDE * k + 4, mapped(shift, o))
    # goal A^-1: its rotation R A_R^T, and what is left of its translation
    p = translation(goal)
    for i in range(3):
        row = three(goal, 4 * i)
        for j in range(3):
            goal[4 * i + j] = dot(row, three(shift, 4 * j))
    p = minus(p, rotated(goal, translation(shift)))
    goal[3], goal[7], goal[11] = p[0], p[1], p[2]


@routine
def take_candidates(found, ints, order, candidates, n_candidates, fixed, theta, count):
    """New number of solutions after all candidates of one target."""
    n = found.model.n
    for k in range(n_candidates):
        row = beyond(candidates, CANDIDATE * k)
        for i in range(n):
            theta[i] = fixed[i]
        sound = True
        for i in range(6):
            j = order[i]
            if j < n:
                theta[j] = row[i]
            elif ints[ROLES + i] == REST:
                sound = sound and abs(row[i]) <= OFF_ZERO
            sound = sound and abs(row[i]) < 1e15
        if sound:
            count = add(found, count, theta, row[CANDIDATE_SLOT], row[SAMPLE] != 0.0)
    return count


@routine
def write_out(found, floats, joints, count, near, out, slots, placed):
    """Number of rows written: each solution in the row of its slot where that is free, else in the first free one."""
    m, stride, width = found.model, SOLUTION + found.model.n, found.model.n + INFO
    for k in range(slots):
        placed[k] = 0
        for i in range(m.n):
            out[width * k + i] = math.nan
        out[width * k + m.n + CODE] = UNUSED
    written = 0
    for sampled in range(2):  # samples of families come last, as far as there is room
        for k in range(count):
            row = beyond(found.rows, stride * k)
            if (row[TURNS] == 0.0) != (sampled == 1) or written == slots:
                continue
            at = int(row[SIGNS]) if sampled == 0 else 0
            if at < 0 or at >= slots:
                at = 0
            while placed[at] != 0:
                at = (at + 1) % slots
            placed[at] = 1
            q = beyond(out, width * at)
            inside = coordinates(m, joints, row, near, q)
            code = MULTIPLICITY_UNIT * row[TURNS] + SLOT_UNIT * (row[SIGNS] + 1.0 if sampled == 0 else 0.0)
            code += (INSIDE_BIT if inside else 0.0) + (WEAK_BIT if row[WEAKEST] < WEAK else 0.0)
            q[m.n + ERROR_AT] = math.hypot(row[ERROR] * floats[LENGTH], row[ERROR + 1])
            q[m.n + CODE] = code
            written += 1
    return written


@kernel(types.void(I1, F1, F3, F2, F2, types.float64, types.float64, types.int64, I1, OUT3, OUTI1))
def closed(ints, floats, targets, near, locked, tol_linear, tol_angular, sort, which, out, out_count):
    """Nothing; all solutions by closed form of the targets whose numbers are in `which`.

    ints, floats: plan, see `analytic_layout`. targets: (N, 4, 4). near: (1 or N, n), of each angle the turn nearest to
    it is given. locked: (1 or N, n) coordinates of which those of locked joints are read. tol_linear [m], tol_angular:
    largest errors of a solution. sort: 1 for rows in order, nearest first, else each is in the row of its slot. out:
    (N, K, n + INFO) coordinates, error, code. out_count: (N,) rows in use, -1 for a target that is no pose.
    """
    n, slots = ints[N_JOINTS], out.shape[1]
    stride = SOLUTION + n
    sizes = SCRATCH + CANDIDATE * MOST_CANDIDATES + stride * (MOST_SOLUTIONS + 1) + model_scratch(n) + 3 * n + 96
    block, flags = np.empty(sizes), np.empty(6 + slots, np.int64)
    table, numbers = raw(ints), raw(floats)
    goal = raw(block)
    target, shift, six = beyond(goal, 12), beyond(goal, 24), beyond(goal, 36)
    theta, fixed = beyond(goal, 96), beyond(goal, 96 + n)
    scratch = beyond(fixed, 2 * n)
    candidates = beyond(scratch, SCRATCH)
    rows = beyond(candidates, CANDIDATE * MOST_CANDIDATES)
    kinds, placed = raw(flags), beyond(raw(flags), 6)
    moves = beyond(table, PLAN_HEADER + ints[N_LINES])
    joints = beyond(numbers, LINES + LINE_STRIDE * ints[N_LINES])
    length = floats[LENGTH]
    model = Model(beyond(table, PLAN_HEADER), beyond(numbers, LINES), moves, beyond(numbers, TIP),
                  beyond(numbers, TASK), target, beyond(rows, stride * (MOST_SOLUTIONS + 1)), n)  # fmt: skip
    found = Found(model, rows, tol_linear / length, tol_angular)
    for i in which:
        first, lock = n * i if near.shape[0] > 1 else 0, n * i if locked.shape[0] > 1 else 0
        sound = take_target(raw(targets), 16 * i, numbers, target)
        for j in range(n):
            at = JOINT_FLOATS * j
            fixed[j] = joints[at + FACTOR] * raw(locked)[lock + j] + joints[at + GAUGE] if moves[j] == 0 else 0.0
            sound = sound and abs(fixed[j]) < 1e15 and abs(raw(near)[first + j]) < 1e15
        rows_out, count = beyond(raw(out), slots * (n + INFO) * i), 0
        if sound:
            goal_of(target, model.tip, goal)
            six_lines(table, numbers, moves, fixed, goal, shift, six, kinds)
            k = closed_candidates(kinds, six, goal, ints[INNER], ints[WHAT], ints[MODE], ints[MEASURE], ints[OPTION],
                                  scratch, candidates)  # fmt: skip
            count = take_candidates(found, table, beyond(table, ORDER), candidates, k, fixed, theta, 0)
        written = write_out(found, numbers, joints, count, beyond(raw(near), first), rows_out, slots, placed)
        if sort != 0:
            arrange(n, joints, beyond(raw(near), first), rows_out, slots)
        out_count[i] = written if sound else -1
    keep(block)
    keep(flags)
