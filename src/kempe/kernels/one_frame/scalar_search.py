"""Starts one at a time: the search of chains with balls, whose steps the lanes of `schedule` do not
have.

From 50 to 100 % of the starts reach the goal, whatever the optimiser: restarts decide, so a step
must be cheap and a start must be given up early. Each step takes the damping 0.05 E + 1e-10 (Chan
and Lawrence 1988; Sugihara 2011) and is always accepted. A start ends at the goal, after
`iteration_limit` steps, or after three steps that hardly lower the error.
"""

from __future__ import annotations

import numpy as np

from kempe.kernels.base._jit import kernel, routine
from kempe.kernels.base.scratch import copy
from kempe.kernels.base.search_layout import NOT_FOUND, SOLVED, STATUS
from kempe.kernels.base.vectors import keep, raw
from kempe.kernels.forward.table_layout import NQ, NV
from kempe.kernels.one_frame.descent import ENOUGH
from kempe.kernels.one_frame.ik_problem import (
    ARGUMENTS,
    answer_of,
    begin,
    count_columns,
    go_to,
    judged,
    problem_floats,
    problem_ints,
    problem_of,
    write,
)
from kempe.kernels.one_frame.lanes_step import DAMPING, DAMPING_CAP, DAMPING_FLOOR, PATIENCE, SLOW
from kempe.kernels.one_frame.residual import distances, energy, error, fill_jacobian, trace
from kempe.kernels.one_frame.step import advance, damped_step


@routine
def attempt(chain, limit, tol_linear, tol_angular, kept):
    """Least energy that one start led to, the steps taken, whether within tolerance; `kept` is
    where.

    Within tolerance, it goes on as long as that pays: usually a step or two to rounding error.
    """
    best = np.inf
    stall = 0
    steps = 0
    found = False
    while True:
        tip = trace(chain)
        e = error(chain.goal, tip)
        new = energy(e)
        stall = 0 if new < SLOW * best else stall + 1
        if new < best:
            best = new
            copy(kept, chain.q, 0, chain.nq)
            linear, angular = distances(chain, e)
            found = found or (linear <= tol_linear and angular <= tol_angular)
        if best < ENOUGH or steps >= limit or stall >= (1 if found else PATIENCE):
            return best, steps, found
        fill_jacobian(chain, tip)
        damped_step(chain, e, min(DAMPING * new, DAMPING_CAP) + DAMPING_FLOOR)
        advance(chain)
        steps += 1


@routine
def one_by_one(problem, i):
    """Search from one start after the other until one reaches goal i, which is the chain's, and
    write the answer.
    """
    chain = problem.chain
    best = answer_of(problem, i)
    steps = np.int64(0)
    least = np.inf
    copy(best, problem.home, 0, chain.nq)
    for start in range(problem.tries):
        go_to(problem, i, start, problem.home)
        reached, count, found = attempt(
            chain, problem.iteration_limit, problem.tol_linear, problem.tol_angular, problem.kept
        )
        steps += count
        if found:
            copy(chain.q, problem.kept, 0, chain.nq)
            solved, linear, angular = judged(problem, problem.home)
            if solved:
                copy(best, chain.q, 0, chain.nq)
                write(problem, i, SOLVED, linear, angular, steps, start + 1)
                return
        if reached < least:
            least = reached
            copy(best, problem.kept, 0, chain.nq)
    write(problem, i, NOT_FOUND, least, 0.0, steps, problem.tries)


@kernel(*ARGUMENTS)
def reach_one_by_one(
    ints,
    floats,
    limits,
    task,
    targets,
    seeds,
    seed,
    first,
    start_limit,
    iteration_limit,
    tol_linear,
    tol_angular,
    length,
    out,
):
    """As `schedule.reach`, for all chains, but slower."""
    columns = count_columns(raw(ints))
    nq = ints[NQ]
    nv = ints[NV]
    notes = np.empty(problem_ints(columns, nv), np.int64)
    block = np.empty(problem_floats(columns, nq, nv))
    problem = problem_of(
        ints,
        floats,
        limits,
        task,
        targets,
        seeds,
        seed,
        first,
        start_limit,
        iteration_limit,
        tol_linear,
        tol_angular,
        length,
        out,
        columns,
        raw(notes),
        raw(block),
    )
    missed = 0
    for i in range(targets.shape[0]):
        if begin(problem, i, problem.home):
            one_by_one(problem, i)
        missed += int(out[i, nq + STATUS] != SOLVED)
    keep(block)
    keep(notes)
    return missed
