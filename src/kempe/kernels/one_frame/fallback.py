"""Goals that no start reached: the nearest configuration, the best of several descents to a local
minimum.
"""

from __future__ import annotations

import numpy as np

from kempe.kernels.base._jit import kernel, routine
from kempe.kernels.base.scratch import copy_numbers
from kempe.kernels.base.search_layout import DESCENTS, LINEAR, NOT_FOUND, SOLVED, STATUS, STEPS
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.forward.table_layout import NQ, NV
from kempe.kernels.one_frame.descent import minimize_energy
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

DESCENT_STEPS = 5
"""Steps of a descent by those of a start."""


@routine
def answer_nearest(problem, i, one):
    """Write for goal i, which no start reached, the nearest configuration that descents find.

    They begin at the answer as it is, whose energy stands for its linear error, and at random.
    `one` is the only one that is made, counted from 1: errors are written after the last one. With
    0 all are made.
    """
    chain = problem.chain
    best = locate_answer(problem, i)
    least = best[chain.nq + LINEAR]
    steps = int(best[chain.nq + STEPS])
    begin_goal(problem, i, problem.home)
    most = min(problem.tries, DESCENTS)
    only = one - 1
    for k in range(max(only, 0), only + 1 if only >= 0 else most):
        if k == 0:
            copy_numbers(chain.q, best, 0, chain.nq)
        else:
            go_to_start(problem, i, problem.tries + k, problem.home)
        reached, count = minimize_energy(
            chain, DESCENT_STEPS * problem.iteration_limit, problem.kept
        )
        steps += count
        if reached < least:
            least = reached
            copy_numbers(best, problem.kept, 0, chain.nq)
    if 0 <= only < most - 1:
        best[chain.nq + LINEAR] = least
        best[chain.nq + STEPS] = steps
        return
    copy_numbers(chain.q, best, 0, chain.nq)
    solved, linear, angular = judge_configuration(problem, problem.home)
    copy_numbers(best, chain.q, 0, chain.nq)
    write_answer(problem, i, SOLVED if solved else NOT_FOUND, linear, angular, steps, problem.tries)


@kernel(*ARGUMENTS)
def approach_goals(
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
    """Replace the q of goals that are NOT_FOUND in `out`, as `schedule.reach_goals` left it, by the
    nearest q; return the number of goals not reached.

    `first` is the only descent that is made, counted from 1, or 0 for all of them: see
    `answer_nearest`.
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
        0,
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
        if out[i, nq + STATUS] == NOT_FOUND:
            answer_nearest(problem, i, first)
        missed += int(out[i, nq + STATUS] != SOLVED)
    keep_alive(block)
    keep_alive(notes)
    return missed
