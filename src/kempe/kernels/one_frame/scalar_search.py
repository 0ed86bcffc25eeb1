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
from kempe.kernels.base.scratch import copy_numbers
from kempe.kernels.base.search_layout import NOT_FOUND, SOLVED, STATUS
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.forward.table_layout import NQ, NV
from kempe.kernels.one_frame.descent import ENOUGH
from kempe.kernels.one_frame.ik_problem import (
    ARGUMENTS,
    begin_goal,
    count_columns,
    count_problem_floats,
    count_problem_ints,
    go_to_start,
    judge_configuration,
    locate_answer,
    make_ik_problem,
    write_answer,
)
from kempe.kernels.one_frame.lanes_step import DAMPING, DAMPING_CAP, DAMPING_FLOOR, PATIENCE, SLOW
from kempe.kernels.one_frame.residual import (
    compute_distances,
    compute_energy,
    compute_error,
    fill_jacobian,
    trace_chain,
)
from kempe.kernels.one_frame.step import advance_configuration, compute_damped_step


@routine
def attempt_start(chain, limit, tol_linear, tol_angular, kept):
    """Descend from one start; return the least energy, the number of steps, and whether it is
    within tolerance. `kept` is the configuration.

    Within tolerance, it goes on as long as that pays: usually a step or two to rounding error.
    """
    best = np.inf
    stall = 0
    steps = 0
    found = False
    while True:
        tip = trace_chain(chain)
        e = compute_error(chain.goal, tip)
        new = compute_energy(e)
        stall = 0 if new < SLOW * best else stall + 1
        if new < best:
            best = new
            copy_numbers(kept, chain.q, 0, chain.nq)
            linear, angular = compute_distances(chain, e)
            found = found or (linear <= tol_linear and angular <= tol_angular)
        if best < ENOUGH or steps >= limit or stall >= (1 if found else PATIENCE):
            return best, steps, found
        fill_jacobian(chain, tip)
        compute_damped_step(chain, e, min(DAMPING * new, DAMPING_CAP) + DAMPING_FLOOR)
        advance_configuration(chain)
        steps += 1


@routine
def search_goal(problem, i):
    """Search from one start after the other until one reaches goal i, the chain's goal, and write
    the answer.
    """
    chain = problem.chain
    best = locate_answer(problem, i)
    steps = np.int64(0)
    least = np.inf
    copy_numbers(best, problem.home, 0, chain.nq)
    for start in range(problem.tries):
        go_to_start(problem, i, start, problem.home)
        reached, count, found = attempt_start(
            chain, problem.iteration_limit, problem.tol_linear, problem.tol_angular, problem.kept
        )
        steps += count
        if found:
            copy_numbers(chain.q, problem.kept, 0, chain.nq)
            solved, linear, angular = judge_configuration(problem, problem.home)
            if solved:
                copy_numbers(best, chain.q, 0, chain.nq)
                write_answer(problem, i, SOLVED, linear, angular, steps, start + 1)
                return
        if reached < least:
            least = reached
            copy_numbers(best, problem.kept, 0, chain.nq)
    write_answer(problem, i, NOT_FOUND, least, 0.0, steps, problem.tries)


@kernel(*ARGUMENTS)
def reach_goals_singly(
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
    """Search the goals as `schedule.reach_goals` does, for all chains, but one start at a time and
    slower.
    """
    columns = count_columns(get_pointer(ints))
    nq = ints[NQ]
    nv = ints[NV]
    notes = np.empty(count_problem_ints(columns, nv), np.int64)
    block = np.empty(count_problem_floats(columns, nq, nv))
    problem = make_ik_problem(
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
        get_pointer(notes),
        get_pointer(block),
    )
    missed = 0
    for i in range(targets.shape[0]):
        if begin_goal(problem, i, problem.home):
            search_goal(problem, i)
        missed += int(out[i, nq + STATUS] != SOLVED)
    keep_alive(block)
    keep_alive(notes)
    return missed
