"""Steps of a path from target to target, as long as nothing about them is in doubt.

A step begins at its first order and ends at the solution that the search for several tasks finds
from there. Where it is regular and hardly longer than its first order, and where a path next to a
singularity goes on as before, it counts. Everything else, from the first target on at which it
occurs, is left to `kempe.inverse.path`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import FLAG, INT, OUT, F, I
from kempe.kernels.base.linear import factor_matrix, substitute_back
from kempe.kernels.base.random import mix_bits
from kempe.kernels.base.scratch import advance_pointer, copy_numbers
from kempe.kernels.base.search_layout import LARGEST, NOTHING, SOLVED
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.constraint_rows import LoopScratch
from kempe.kernels.constraints.envelope import add_product
from kempe.kernels.constraints.loop_coordinates import (
    find_place,
    prepare_start,
    read_velocity_number,
)
from kempe.kernels.forward.table_layout import N_ROWS as TABLE_ROWS
from kempe.kernels.forward.table_layout import NQ, NV
from kempe.kernels.forward.table_rows import locate_poses
from kempe.kernels.tasks.task_search import (
    assess_equations,
    count_search_floats,
    divide_search_scratch,
    is_rigid,
    make_ask,
    restore_bounds,
    search_tasks,
)

REGULAR = 1
NEAR = 0
DOUBTFUL = -1
"""How a configuration is: regular, near a singularity, or so that rounding decides."""

MAX_STEP = 0
STRETCH = 1
SMALL = 2
WEAK = 3
DAMPING = 4
UNEVEN = 5
STAYS = 6
ALIKE = 7
RULES = 8
"""Places of the numbers that judge a step, as `kempe.inverse.path` names them."""


class Step(NamedTuple):
    """Pointers to the scratch of a step: the Jacobian of the `m` rows that count, row by row, their
    residuals, square matrices, and scaled velocities.
    """

    m: int
    jacobian: object
    error: object
    normal: object
    factors: object
    square: object
    fourth: object
    eighth: object
    ahead: object
    moved: object
    begin: object
    """The configuration (nq,) at which the step begins."""
    column: object


@device
def count_step_floats(m, rows, nq, nv):
    """Return the number of floats of scratch of a step."""
    return m * nv + m + 5 * m * m + 2 * nv + nq + rows


@device
def make_step(scratch, m, nq, nv):
    """Divide scratch among the parts of a step."""
    error = advance_pointer(scratch, m * nv)
    normal = advance_pointer(error, m)
    ahead = advance_pointer(normal, 5 * m * m)
    begin = advance_pointer(ahead, 2 * nv)
    return Step(
        m,
        scratch,
        error,
        normal,
        advance_pointer(normal, m * m),
        advance_pointer(normal, 2 * m * m),
        advance_pointer(normal, 3 * m * m),
        advance_pointer(normal, 4 * m * m),
        ahead,
        advance_pointer(ahead, nv),
        begin,
        advance_pointer(begin, nq),
    )


@device
def write_counted_rows(loops, counted, step):
    """Write residuals and Jacobian of the rows that count; return the norm of the residuals."""
    nv = loops.nv
    rows = loops.plan[L.N_ROWS]
    total = 0.0
    k = 0
    for i in range(rows):
        if counted[i] != 0:
            step.error[k] = loops.error[i]
            total += loops.error[i] * loops.error[i]
            k += 1
    for v in range(nv):
        for i in range(rows):
            step.column[i] = 0.0
        add_product(loops, v, 1.0, step.column, 1)
        k = 0
        for i in range(rows):
            if counted[i] != 0:
                step.jacobian[k * nv + v] = step.column[i]
                k += 1
    return math.sqrt(total)


@device
def square_symmetric(a, n, out):
    """Write the square of a symmetric n by n matrix."""
    for i in range(n):
        for j in range(i + 1):
            x = 0.0
            for k in range(n):
                x += a[i * n + k] * a[j * n + k]
            out[i * n + j] = x
            out[j * n + i] = x


@device
def trace_product(a, b, n):
    """Return the trace of the product of two symmetric n by n matrices."""
    total = 0.0
    for k in range(n * n):
        total += a[k] * b[k]
    return total


@device
def is_definite(step, shift):
    """Return whether J J^T less `shift` times the identity is positive definite."""
    m = step.m
    copy_numbers(step.factors, step.normal, 0, m * m)
    for i in range(m):
        step.factors[i * m + i] -= shift
    return factor_matrix(step.factors, m)


@routine
def classify_configuration(loops, step, weak):
    """Classify the configuration by the ratio of its singular values, `weak` being the border.

    The largest eigenvalue x of A = J J^T is between tr A^9 / tr A^8 and (tr A^8)^(1/8).
    """
    m = step.m
    nv = loops.nv
    a = step.normal
    for i in range(m):
        for j in range(i + 1):
            x = 0.0
            for v in range(nv):
                x += step.jacobian[i * nv + v] * step.jacobian[j * nv + v]
            a[i * m + j] = x
            a[j * m + i] = x
    size = 0.0
    for i in range(m):
        size += a[i * m + i]
    if not size < LARGEST:
        return DOUBTFUL
    if size <= 0.0:
        return NEAR
    square_symmetric(a, m, step.square)
    square_symmetric(step.square, m, step.fourth)
    square_symmetric(step.fourth, m, step.eighth)
    eighth = 0.0
    for i in range(m):
        eighth += step.eighth[i * m + i]
    if not 1e-200 < eighth < LARGEST:
        return DOUBTFUL
    low = trace_product(a, step.eighth, m) / eighth
    high = math.sqrt(math.sqrt(math.sqrt(eighth)))
    if is_definite(step, weak * weak * high):
        return REGULAR
    return DOUBTFUL if is_definite(step, weak * weak * low) else NEAR


@routine
def write_first_order(loops, step, damping):
    """Write the damped first-order step to `ahead`; return its largest entry and its norm."""
    m = step.m
    nv = loops.nv
    is_definite(step, -damping * damping)
    substitute_back(step.factors, m, step.error)
    most = 0.0
    total = 0.0
    for v in range(nv):
        x = 0.0
        for i in range(m):
            x -= step.jacobian[i * nv + v] * step.error[i]
        step.ahead[v] = x
        most = max(most, abs(x))
        total += x * x
    return most, math.sqrt(total)


@routine
def land_step(loops, work, ask, step, ahead, limits, key, limit):
    """Search a solution from `begin` plus the scaled step `ahead`, and write the step there to
    `moved`; return whether there is one inside the limits, the largest entry of the step and its
    norm.
    """
    nv = loops.nv
    q = loops.q
    copy_numbers(q, step.begin, 0, loops.nq)
    for v in range(nv):
        i = find_place(loops, v)
        x = step.begin[i] + ahead[v] * read_velocity_number(loops, 0, v)
        q[i] = min(max(x, limits[v]), limits[nv + v])
    good = prepare_start(loops, work.home)
    if good:
        status, _, _ = search_tasks(loops, work, ask, key, 1, limit, NOTHING, 0)
        good = status == SOLVED
    most = 0.0
    total = 0.0
    for v in range(nv):
        i = find_place(loops, v)
        good = good and limits[v] <= q[i] <= limits[nv + v]
        x = (q[i] - step.begin[i]) / read_velocity_number(loops, 0, v)
        step.moved[v] = x
        most = max(most, abs(x))
        total += x * x
    return good, most, math.sqrt(total)


@device
def compute_change(a, b, n):
    """Return the norms of b and of a - b."""
    size = 0.0
    away = 0.0
    for v in range(n):
        size += b[v] * b[v]
        away += (a[v] - b[v]) * (a[v] - b[v])
    return math.sqrt(size), math.sqrt(away)


@routine
def take_path_step(loops, work, ask, step, counted, rules, limits, before, key, limit):
    """Step from q to the target; return whether the step is beyond doubt.

    `before` (nv + 1) is the scaled step before and the length of its way.
    """
    nv = loops.nv
    copy_numbers(step.begin, loops.q, 0, loops.nq)
    restore_bounds(loops, work)
    assess_equations(loops, work)
    way = write_counted_rows(loops, counted, step)
    kind = classify_configuration(loops, step, rules[WEAK])
    if not way < LARGEST or kind == DOUBTFUL:
        return False
    if kind == REGULAR:
        longest, size = write_first_order(loops, step, rules[DAMPING])
        if longest > rules[MAX_STEP]:
            return False
        good, most, length = land_step(loops, work, ask, step, step.ahead, limits, key, limit)
        explained = most <= rules[MAX_STEP] and length <= rules[STRETCH] * size + rules[SMALL]
        good = good and (explained or most <= rules[SMALL])
    else:  # the step before goes on
        last = before[nv]
        part = 1.0
        if abs(way - last) > rules[UNEVEN] * last:
            part = way / last if last > 0.0 else 0.0
        for v in range(nv):
            step.ahead[v] = part * before[v]
        size, _ = compute_change(step.ahead, step.ahead, nv)
        if size == 0.0:
            return False
        good, most, _ = land_step(loops, work, ask, step, step.ahead, limits, key, limit)
        _, away = compute_change(step.moved, step.ahead, nv)
        good = good and away <= rules[ALIKE] * size and most <= rules[MAX_STEP]
    if good and way > rules[STAYS]:
        copy_numbers(before, step.moved, 0, nv)
        before[nv] = way
    return good


@kernel(
    I("_"),
    F("_"),
    I("_"),
    F("_"),
    I("_"),
    F("_", 3),
    F("1|N", "_"),
    I("m"),
    F(RULES),
    F(2, "nv"),
    INT,
    FLAG,
    INT,
    OUT("nv+1"),
    OUT("N", "nq"),
)
def follow_targets(
    ints,
    floats,
    plan,
    weights,
    stages,
    strengths,
    pins,
    counted,
    rules,
    limits,
    limit,
    loose,
    seed,
    before,
    out,
):
    """Follow targets from the first row of `out` on; return how many rows are solutions then.

    ints, floats, plan, weights, stages, strengths, limit, loose, seed: as `task_search.solve_tasks`
    takes them, all tasks being hard equations and all coordinates turns or slides. pins (N or 1, k):
    the targets; the first is that of the first row. counted (m,): 1 for each row whose residual and
    derivatives make the first order. rules: the numbers that judge a step. limits (2, nv): lower and
    upper. before: the scaled step that led to the first row and the length of its way, 0 for none;
    of the last row when this returns. out (N, nq): the rows after the last solution are as they
    were.
    """
    nq = ints[NQ]
    nv = ints[NV]
    n_rows = ints[TABLE_ROWS]
    rows_count = plan[L.N_ROWS]
    m = 0
    for i in range(rows_count):
        m += int(counted[i] != 0)
    floats_count = count_search_floats(plan, n_rows, nq, nv)
    block = np.empty(floats_count + count_step_floats(m, rows_count, nq, nv))
    scratch = get_pointer(block)
    q, rows, weight, blocks, work = divide_search_scratch(
        get_pointer(plan), scratch, n_rows, nq, nv
    )
    step = make_step(advance_pointer(scratch, floats_count), m, nq, nv)
    now = np.empty(2 * plan[L.N_TIES], dtype=np.int64)
    ask = make_ask(
        get_pointer(plan),
        get_pointer(stages),
        get_pointer(strengths),
        weight,
        get_pointer(now),
        loose,
    )
    key = mix_bits(np.uint64(0), np.uint64(seed))
    done = 1
    for i in range(1, out.shape[0]):
        pin = advance_pointer(get_pointer(pins), i * pins.shape[1] if pins.shape[0] > 1 else 0)
        fine = True
        for j in range(pins.shape[1]):
            fine = fine and abs(pin[j]) < LARGEST
        for j in range(plan[L.N_PINS]):
            fine = fine and is_rigid(pin, 12 * j)
        if not fine:
            break
        loops = LoopScratch(
            get_pointer(ints),
            get_pointer(floats),
            get_pointer(plan),
            get_pointer(weights),
            pin,
            q,
            scratch,
            advance_pointer(scratch, locate_poses(n_rows)),
            rows,
            blocks,
            n_rows,
            nq,
            nv,
        )
        copy_numbers(q, get_pointer(out), (i - 1) * nq, nq)
        if not take_path_step(
            loops,
            work,
            ask,
            step,
            get_pointer(counted),
            get_pointer(rules),
            get_pointer(limits),
            get_pointer(before),
            key,
            limit,
        ):
            break
        copy_numbers(advance_pointer(get_pointer(out), i * nq), q, 0, nq)
        done += 1
    keep_alive(block)
    keep_alive(now)
    return done
