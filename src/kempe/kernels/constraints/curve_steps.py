"""Steps along a curve of closed configurations, one after the other, where it is regular.

A predictor along the tangent, and a corrector in the plane across it: with the tangent t, each step
of the corrector and the next tangent solve (J^T J + t t^T) y = b, which is positive definite where
the null space of J is a line that the plane crosses. What is special (singular points, limits, the
start again) is for the caller to look for (`kempe.motion.events`).
Source: Allgower, Georg, *Numerical Continuation Methods*, 1990, chapters 2, 3 and 6.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import FLOAT, INT, OUT, F, I
from kempe.kernels.base.linear import factor_matrix, substitute_back
from kempe.kernels.base.rotations import turn_quaternion
from kempe.kernels.base.scratch import advance_pointer, copy_numbers
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.constraint_rows import LoopScratch
from kempe.kernels.constraints.envelope import add_product, dot
from kempe.kernels.constraints.goals import fill_equations
from kempe.kernels.constraints.loop_coordinates import find_place, read_sort
from kempe.kernels.forward.table_layout import N_ROWS as TABLE_ROWS
from kempe.kernels.forward.table_layout import NQ, NV
from kempe.kernels.forward.table_rows import count_sweep_scratch, locate_poses, write_row_poses


class CurveScratch(NamedTuple):
    """Pointers to the scratch of a walk: Jacobian by columns, the matrix J^T J + t t^T, tangent,
    step, sum of the steps of a correction, residual; and the scales of rows and columns, with 1 for
    each held coordinate, the column of which is zero.
    """

    columns: object
    matrix: object
    tangent: object
    step: object
    total: object
    residual: object
    row_scale: object
    unit: object
    held: object


@routine
def evaluate_curve(loops, work):
    """Write residual, Jacobian and the matrix J^T J + t t^T at q; return the largest residual."""
    m = loops.plan[L.N_ROWS]
    nv = loops.nv
    write_row_poses(loops.ints, loops.floats, loops.q, 0, loops.scratch)
    fill_equations(loops, True)
    worst = 0.0
    for r in range(m):
        x = work.row_scale[r] * loops.error[r]
        work.residual[r] = x
        if abs(x) > worst or x != x:  # NaN stays
            worst = abs(x)
    for v in range(nv):
        column = advance_pointer(work.columns, m * v)
        for r in range(m):
            column[r] = 0.0
        if work.held[v] == 0.0:  # else it is left zero, and the coordinate rests exactly
            add_product(loops, v, 1.0, column, 1)
            for r in range(m):
                column[r] *= work.row_scale[r] * work.unit[v]
        for i in range(v + 1):
            x = dot(column, advance_pointer(work.columns, m * i), m)
            work.matrix[nv * v + i] = x + work.tangent[v] * work.tangent[i]
        work.matrix[nv * v + v] += work.held[v]
    return worst


@device
def compute_norm(y, n):
    """Return the norm of n numbers."""
    return math.sqrt(dot(y, y, n))


@routine
def move_along(loops, work, h, y):
    """Move q along h times the tangent vector y."""
    q = loops.q
    unit = work.unit
    for v in range(loops.nv):
        sort = read_sort(loops, v)
        i = find_place(loops, v)
        if sort == L.BALL_FIRST:
            a = h * unit[v]
            b = h * unit[v + 1]
            c = h * unit[v + 2]
            turn_quaternion(q, i, a * y[v], b * y[v + 1], c * y[v + 2])
        elif sort != L.BALL_MORE:
            q[i] += h * unit[v] * y[v]


@routine
def correct_point(loops, work, tries, last, least):
    """Lead q back to the curve in the plane across the tangent; return the largest residual.

    The Jacobian and the matrix, not factored, are those at the end; it is infinite where the matrix
    is not definite. There are at most `tries` steps; a step up to `last` is the last one, one up to
    `least` is not taken.
    """
    nv = loops.nv
    m = loops.plan[L.N_ROWS]
    for v in range(nv):
        work.total[v] = 0.0
    before = np.inf
    count = 0
    while True:
        worst = evaluate_curve(loops, work)
        if count == tries or before <= last or not 0.0 < worst < np.inf:
            return worst
        if not factor_matrix(work.matrix, nv):
            return np.inf
        for v in range(nv):
            work.step[v] = -dot(advance_pointer(work.columns, m * v), work.residual, m)
        substitute_back(work.matrix, nv, work.step)
        size = compute_norm(work.step, nv)
        if not least < size < np.inf or size > 0.5 * before:
            return evaluate_curve(loops, work)
        move_along(loops, work, 1.0, work.step)
        for v in range(nv):
            work.total[v] += work.step[v]
        before = size
        count += 1


@routine
def turn_tangent(loops, work):
    """Write the unit tangent at q to `step`, for the matrix written last; return the angle from the
    tangent before, infinite where there is none.
    """
    nv = loops.nv
    m = loops.plan[L.N_ROWS]
    if not factor_matrix(work.matrix, nv):
        return np.inf
    copy_numbers(work.step, work.tangent, 0, nv)
    substitute_back(work.matrix, nv, work.step)
    for r in range(m):  # once more, for what rounding left: J step should be zero
        work.residual[r] = 0.0
    for v in range(nv):
        column = advance_pointer(work.columns, m * v)
        for r in range(m):
            work.residual[r] += column[r] * work.step[v]
    for v in range(nv):
        work.total[v] = dot(advance_pointer(work.columns, m * v), work.residual, m)
    substitute_back(work.matrix, nv, work.total)
    for v in range(nv):
        work.step[v] -= work.total[v]
    size = compute_norm(work.step, nv)
    if not size > 0.0:
        return np.inf
    chord = 0.0
    for v in range(nv):
        work.step[v] /= size
        chord += (work.step[v] - work.tangent[v]) * (work.step[v] - work.tangent[v])
    return 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(chord)))


@kernel(
    I("_"),
    F("_"),
    I("_"),
    F("_"),
    F("m"),
    F("nv"),
    F("nv"),
    F("nq"),
    F("nv"),
    FLOAT,
    FLOAT,
    INT,
    F(7),
    OUT("N", "nq"),
    OUT("N", "nv"),
    OUT("N"),
)
def follow_curve(
    ints,
    floats,
    plan,
    weights,
    row_scale,
    unit,
    held,
    start,
    tangent,
    step,
    longest,
    tries,
    rules,
    out_q,
    out_t,
    out_step,
):
    """Follow a curve by up to N steps; return the number of steps that were taken.

    ints, floats: the table; plan, weights: the loops (`loop_layout`), all coordinates unknown.
    row_scale, unit: scales of equations and of velocity coordinates. held: 1 for each coordinate
    that does not move, else 0. start, tangent: a point of the curve and its unit tangent, 0 where
    held is 1. step, longest: the first step and the longest; a step 0 leads `start` to the curve,
    in the plane across `tangent`. tries: steps of a correction at most. rules: the largest residual
    of a point where all coordinates are small, what rounding adds, the size of the last step of a
    correction, and of one that is rounding, the largest correction as a part of the step, the
    largest angle between tangents, and the one that steps aim at. Written for each step: the point,
    its tangent, and the length of the next step. The step after the last one was refused, or none
    was left.
    """
    nq = ints[NQ]
    nv = ints[NV]
    n_rows = ints[TABLE_ROWS]
    m = plan[L.N_ROWS]
    sweep = count_sweep_scratch(n_rows)
    block = np.empty(sweep + nq + 2 * m + plan[L.BLOCKS] + m * nv + nv * nv + 3 * nv)
    scratch = get_pointer(block)
    q = advance_pointer(scratch, sweep)
    error = advance_pointer(q, nq)
    residual = advance_pointer(error, m)
    blocks = advance_pointer(residual, m)
    columns = advance_pointer(blocks, plan[L.BLOCKS])
    matrix = advance_pointer(columns, m * nv)
    t = advance_pointer(matrix, nv * nv)
    work = CurveScratch(
        columns,
        matrix,
        t,
        advance_pointer(t, nv),
        advance_pointer(t, 2 * nv),
        residual,
        get_pointer(row_scale),
        get_pointer(unit),
        get_pointer(held),
    )
    loops = LoopScratch(
        get_pointer(ints),
        get_pointer(floats),
        get_pointer(plan),
        get_pointer(weights),
        scratch,
        q,
        scratch,
        advance_pointer(scratch, locate_poses(n_rows)),
        error,
        blocks,
        n_rows,
        nq,
        nv,
    )
    copy_numbers(q, get_pointer(start), 0, nq)
    copy_numbers(t, get_pointer(tangent), 0, nv)
    h = step
    count = 0
    while count < out_q.shape[0]:
        move_along(loops, work, h, t)
        worst = correct_point(loops, work, tries, rules[2], rules[3])
        size = 0.0
        for i in range(nq):
            size = max(size, abs(q[i]))
        if not worst < rules[0] * (1.0 + 0.01 * size) + rules[1]:
            break
        if h > 0.0 and not compute_norm(work.total, nv) <= rules[4] * h:
            break
        bend = turn_tangent(loops, work)
        if not bend <= (rules[5] if h > 0.0 else math.pi):
            break
        copy_numbers(t, work.step, 0, nv)
        h = min(longest, h * min(1.5, max(0.5, rules[6] / max(bend, 1e-9))))
        for i in range(nq):
            out_q[count, i] = q[i]
        for v in range(nv):
            out_t[count, v] = t[v]
        out_step[count] = h
        count += 1
    keep_alive(block)
    return count
