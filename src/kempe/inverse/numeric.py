"""The solvers of `ik`: search by numbers, the nearest solution in closed form, or several tasks.

Searches give their iterates on request.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np

from kempe.answers.problem import Problem, Solver
from kempe.answers.targets import (
    explain_refused_target,
    make_target_constraints,
    turn_targets_to_axis,
)
from kempe.arguments import (
    compute_deadline,
    draw_seed,
    read_start_count,
    read_step_count,
    read_tolerances,
)
from kempe.arrays import is_sequence
from kempe.budget import Usual
from kempe.constraints.clearances import Apart
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.errors import InputError
from kempe.inverse import multi_start
from kempe.inverse.answer import MOST_STARTS, IkHistory, Solution
from kempe.inverse.chain.problem import (
    ITERATIONS,
    MOST,
    FrameProblem,
    compute_errors,
    mark_unreachable_targets,
    pack_row_flags,
)
from kempe.inverse.chain.problem import TOLERANCE as PROBLEM_TOLERANCE
from kempe.inverse.chain.serial_chain import find_chain, find_obstacle
from kempe.inverse.closed_forms.plan import ChainPlan, find_plan_or_reason
from kempe.inverse.closed_forms.problem import ChainProblem, Watch
from kempe.inverse.closed_forms.solve import TOLERANCE
from kempe.inverse.multi_start import make_seeds, solve_targets
from kempe.kernels.base.search_layout import SOLVED, STEPS
from kempe.model.configurations import refuse_large_numbers
from kempe.numerics.clock import SHORT, TimeLimit
from kempe.poses import correct_rotations
from kempe.spatial import Array
from kempe.status import Status, to_status
from kempe.units import make_tolerance

# ---- the nearest of all solutions in closed form

# Numbers answer the rest.

PIECE = 2**15
"""Targets that are solved, and whose solutions are compared, before the clock is looked at
again."""


def find_nearest_solutions(
    problem: FrameProblem, plan: ChainPlan, near: Array, seeds: Array, threads: int | None
) -> tuple[Array, Array, np.ndarray]:
    """Find the solution inside the limits nearest to `near`, else what a search finds."""
    n = len(problem.targets)
    q = np.empty((n, len(problem.chain.q_index)))
    residual = np.zeros((n, 2))
    there = np.zeros(n, dtype=bool)
    for k in range(0, max(n, 1), PIECE):
        if k and time.monotonic() >= problem.end:
            break
        at = slice(k, k + PIECE)
        base = near[k : k + PIECE] if len(near) > 1 else near
        q[at], residual[at], there[at] = _solve_closed_form(
            replace(problem, targets=problem.targets[at]), plan, base, threads
        )
    info = np.zeros((n, 3), dtype=np.int64)
    info[:, 0] = SOLVED
    rest = np.flatnonzero(~there)
    if len(rest):
        some = seeds[rest] if len(seeds) > 1 else seeds
        q[rest], residual[rest], info[rest] = solve_targets(
            problem, some, threads, targets=problem.targets[rest]
        )
    return q, residual, info


def _solve_closed_form(
    problem: FrameProblem, plan: ChainPlan, near: Array, threads: int | None
) -> tuple[Array, Array, np.ndarray]:
    """Solve targets in closed form: nearest solutions (n, k), errors (n, 2), and which exist."""
    n = len(problem.targets)
    chain = problem.chain
    within = min(*problem.tolerance, TOLERANCE)
    limit = TimeLimit(problem.time_limit)
    limit.end = problem.end  # that of the whole batch
    chain_problem = ChainProblem(
        problem.system,
        problem.frame,
        problem.name,
        problem.axis,
        problem.targets,
        (n,),
        within,
        watch=Watch(limit, n),
    )
    from kempe.inverse.solve_all import (
        solve_chain_problem,  # only here: it imports what most targets never need
    )

    found = solve_chain_problem(chain_problem, plan, near, {}, threads)
    own = found._rows[..., : len(plan.lines)]
    inside = found.inside
    unit = np.abs(plan.lines.multiplier)
    away = np.where(
        inside, np.linalg.norm((own - near[:, None, plan.lines.q_index]) * unit, axis=-1), np.inf
    )
    best = np.argmin(away, axis=1)
    there = np.asarray(inside.any(axis=1))
    residual = np.zeros((n, 2))
    at = {int(x): i for i, x in enumerate(plan.lines.q_index)}
    q = own[np.arange(n), best][:, [at[int(x)] for x in chain.q_index]]
    residual[there] = compute_errors(problem, problem.targets[there], q[there])
    return q, residual, there


# ---- iterates of a search


def add_history(answer: Solution, problem: Problem) -> Solution:
    """Add the iterates to an answer.

    Errors: `InputError` for batches and other methods.
    """
    if np.ndim(answer.success) or problem.method != "numeric" or type(answer) is not Solution:
        raise InputError(
            "history=True is for one target of one frame that is searched for with method 'numeric'"
        )
    frame_problem = answer.problem
    base, seeds = make_seeds(problem.system, frame_problem.chain, problem.start, ())
    object.__setattr__(
        answer, "history", _collect_history(frame_problem, base, seeds, int(answer.starts))
    )
    return answer


def _collect_history(problem: FrameProblem, base: Array, seeds: Array, starts: int) -> IkHistory:
    head = (
        problem.chain.ints,
        problem.chain.floats,
        problem.chain.limits,
        pack_row_flags(problem),
        turn_targets_to_axis(problem.targets, problem.axis),
        seeds,
        problem.rng,
    )
    n = len(problem.chain.q_index)
    rows: list[Array] = []
    at: list[tuple[int, int]] = []
    for start in range(min(max(starts, 1), MOST_STARTS)):
        for steps in range(problem.iterations + 1):
            found = multi_start.run_one_start(problem, head, start, steps)[0]
            if steps and found[n + STEPS] < steps:
                break
            rows.append(found[:n])
            at.append((start, steps))
    chain = np.array(rows)
    missed = compute_errors(problem, np.repeat(problem.targets, len(chain), axis=0), chain)
    q = np.repeat(base, len(chain), axis=0)
    q[:, problem.chain.q_index] = chain
    number, step = np.array(at).T
    return IkHistory(problem.system, q, missed[:, 0], missed[:, 1], number, step, starts)


# ---- methods, and usual budgets

METHODS = ("numeric", "analytic", "auto")
TASKS = "tasks are requested, not a target of one frame"
CLOSED = "method='analytic' asks for a closed form"
USUAL = Usual("ik", starts=MOST, iterations=ITERATIONS, time_limit=SHORT, rng=0, threads=None)
BATCH = Usual("ik", starts=MOST, iterations=ITERATIONS, time_limit=None, rng=0, threads=None)


# ---- the solvers, and how one is chosen


def _explain_no_closed_form(problem: Problem) -> str | None:
    system = problem.system
    frame = problem.frame
    if frame is None or problem.method == "numeric":
        return TASKS if frame is None else "method='analytic' or 'auto' asks for it"
    bounds = pack_one_sided_rows(system)
    if bounds.declared:
        return (
            f"method 'analytic' does not hold one-sided constraints, such as {bounds.names[0]!r}; "
            "leave it out, or take one of the solutions of ik_all, which do"
        )
    plan = find_plan_or_reason(system, frame, *problem.task)
    return plan if isinstance(plan, str) else None


def _explain_no_chain(problem: Problem) -> str | None:
    system = problem.system
    frame = problem.frame
    if frame is None or problem.method == "analytic":
        return TASKS if frame is None else CLOSED
    if problem.prefer is not None:
        return "it prefers nothing"
    if pack_one_sided_rows(system).declared:
        return f"it does not hold one-sided constraints, such as {pack_one_sided_rows(system).names[0]!r}"
    return find_obstacle(system, frame)


def _explain_no_tasks(problem: Problem) -> str | None:
    return CLOSED if problem.method == "analytic" else None


def solve_by_closed_form(problem: Problem) -> Solution:
    """Solve `ik` in closed form by the frame's own chain; by numbers without a closed form."""
    plan: Any = find_plan_or_reason(problem.system, str(problem.frame), *problem.task)
    return _solve_chain(problem, plan)


def solve_by_numbers(problem: Problem) -> Solution:
    """Solve `ik` by a search over the frame's own chain."""
    return _solve_chain(problem, None)


def _solve_chain(problem: Problem, plan: ChainPlan | None) -> Solution:
    """Solve `ik` by the frame's own chain, in closed form where there is a `plan`."""
    system = problem.system
    name = str(problem.frame)
    lead = problem.lead
    spend = (BATCH if lead else USUAL).complete_budget(problem.budget)
    usual = problem.budget is None or problem.budget.time_limit is None
    chain = find_chain(system, name, problem.task[1])
    tolerance = problem.tolerance
    base, seeds = make_seeds(system, chain, problem.start, lead)
    packed_problem = FrameProblem(
        system,
        name,
        problem.targets,
        *problem.task,
        make_tolerance(PROBLEM_TOLERANCE, system.unit)
        if tolerance is None
        else read_tolerances(tolerance),
        read_start_count(spend.starts),
        draw_seed(spend.rng),
        chain,
        read_step_count(spend.iterations),
        spend.time_limit,
        problem.options["end"] if problem.options else compute_deadline(spend.time_limit),
        usual,
    )
    packed_problem, (q, residual, info) = _run_solver(
        packed_problem, plan, base, seeds, spend.threads, lead
    )
    return _make_checked_answer(packed_problem, base, q, residual, info, lead, seeds, spend.threads)


def _solve_tasks(problem: Problem) -> Solution:
    """Solve `ik` for several tasks by `kempe.inverse.tasks.search.reach_tasks`."""
    from kempe.inverse.tasks.search import reach_tasks

    frame = problem.frame
    targets = problem.targets
    held = (
        problem.wanted
        if frame is None
        else make_target_constraints(frame, *problem.task, targets.reshape(*problem.lead, 4, 4))
    )
    given = held if is_sequence(held) else [held]
    if any(isinstance(t, Apart) for t in given):
        from kempe.inverse.tasks.keep_clear import reach_clear

        return reach_clear(problem._replace(wanted=given))
    return reach_tasks(problem._replace(wanted=held))


BY_TASKS = Solver(
    "levels",
    "least squares over all coordinates, with loops, limits and one-sided rows, by priorities",
    _explain_no_tasks,
    _solve_tasks,
)
SOLVERS = (
    Solver(
        "closed form",
        "of all solutions of ik_all the nearest; else as chain",
        _explain_no_closed_form,
        solve_by_closed_form,
    ),
    Solver(
        "chain",
        "damped least squares over the frame's own chain, with limits and restarts",
        _explain_no_chain,
        solve_by_numbers,
    ),
    BY_TASKS,
)
"""Who answers for targets of one frame, and for tasks."""


def _run_solver(
    problem: FrameProblem,
    plan: Any,
    base: Array,
    seeds: Array,
    threads: int | None,
    lead: tuple[int, ...],
) -> tuple[FrameProblem, tuple[Array, Array, np.ndarray]]:
    """Run the search, or the closed form of a plan; mend rotations that were rounded."""
    if plan is None:
        found = solve_targets(problem, seeds, threads, postpone=bool(lead))
    else:
        found = find_nearest_solutions(problem, plan, base, seeds, threads)
    targets = problem.targets
    if (
        lead
        and (found[2][:, 0] == Status.BAD_INPUT).any()
        and (mended := correct_rotations(targets, "target")) is not targets
    ):
        return _run_solver(replace(problem, targets=mended), plan, base, seeds, threads, lead)
    return problem, found


def _find_nearest_configurations(
    problem: FrameProblem,
    base: Array,
    seeds: Array,
    threads: int | None,
    q: Array,
    residual: Array,
    info: np.ndarray,
    lead: tuple[int, ...],
) -> dict[str, Any]:
    """Find all fields of a batch's answer, with what is nearest to the targets out of reach."""
    far = np.flatnonzero(info[:, 0] == Status.OUT_OF_REACH)
    some = seeds[far] if len(seeds) > 1 else seeds
    anew = replace(problem, end=compute_deadline(problem.time_limit))
    q[far], residual[far], info[far] = solve_targets(
        anew, some, threads, targets=problem.targets[far]
    )
    return vars(_make_checked_answer(problem, base, q, residual, info, lead, seeds, threads))


def _make_checked_answer(
    problem: FrameProblem,
    base: Array,
    q: Array,
    residual: Array,
    info: np.ndarray,
    lead: tuple[int, ...],
    seeds: Array,
    threads: int | None,
) -> Solution:
    """Make the answer from the chain's configurations (N, n), residuals (N, 2) and info (N, 3).

    Where `solve_targets` has postponed targets, their part of it is found on demand.
    """
    system = problem.system
    targets = problem.targets
    code = info[:, 0]
    if (code == Status.OUT_OF_REACH).any():
        given = (problem, base, seeds, threads, q, residual, info, lead)
        known = code.reshape(lead).copy()
        return Solution.from_fields(
            success=known == SOLVED,
            code=known,
            problem=problem,
            _later=(_find_nearest_configurations, given),
        )
    full = np.empty((len(targets), system.nq))
    full[:] = base
    full[:, problem.chain.q_index] = q
    if code.any():
        mark_unreachable_targets(problem, code)
        full[code == Status.BAD_INPUT] = math.nan
    if not lead and code[0] == Status.BAD_INPUT:
        refuse_large_numbers(system, base, "start")
        raise InputError(explain_refused_target(targets[0], "start"))
    return _make_answer(problem, full, code, residual, info, lead)


def _make_answer(
    problem: FrameProblem,
    q: Array,
    code: np.ndarray,
    residual: Array,
    info: np.ndarray,
    lead: tuple[int, ...],
) -> Solution:
    columns = (code == SOLVED, code, residual[:, 0], residual[:, 1], info[:, 1], info[:, 2])
    fields = [x.reshape(lead) if lead else x[0].item() for x in columns]
    success, code_, position, angle, steps, starts = fields
    q = q.reshape(*lead, problem.system.nq)
    return Solution(q, success, to_status(code_), position, angle, steps, starts, problem)
