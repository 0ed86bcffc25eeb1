"""`assemble`: search for a configuration that closes all loops, given coordinates or places."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.problem import (
    NOTHING,
    Problem,
    Solver,
    accept_all_problems,
    record_choice,
    select_solver,
)
from kempe.arguments import explain_errors, read_distinct_names, read_flag
from kempe.arrays import unwrap_scalar
from kempe.assemble.answer import Assembly
from kempe.assemble.bound import LOOSEST, TOLERANCE, USUAL, Assembler, get_assembler_as_given
from kempe.assemble.nearest_exact import (
    choose_smaller_tolerance,
    find_ideal_system,
    find_nearest_exact,
    is_nearest_exact_known,
)
from kempe.budget import Budget, TimeUp, list_checks
from kempe.constraints.tape import TIME
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.equations.task_functions import add_held_constraints
from kempe.errors import InputError, format_value
from kempe.model.configurations import make_q, warn_of_degrees_in_values
from kempe.model.model import keep_answers
from kempe.model.time_coordinate import fix_known_time
from kempe.numerics.clock import LEAST, TimeLimit
from kempe.status import Status, to_status

if TYPE_CHECKING:
    from kempe.model.model import Model


@explain_errors
def assemble(
    system: Model,
    known: Mapping[str, Any] | None = None,
    start: Any = None,
    *,
    branch: str | None = None,
    prefer: str | None = None,
    limits: bool = True,
    also: Any = (),
    tolerance: float | str | None = None,
    budget: Budget | None = None,
) -> Assembly:
    """Find a configuration that closes all loops; see `System.assemble`."""
    given: Mapping[str, Any] = {} if known is None else known
    # asking what a dict is takes long
    if given.__class__ is not dict and not isinstance(given, Mapping):
        raise InputError(
            f"known is {format_value(given)}; it must be a dict of values by coordinate or frame "
            "name"
        )
    if also.__class__ is not tuple or also:
        system = add_held_constraints(system, also)
    warn_of_degrees_in_values(system, given)
    if TIME in given:
        system, given = fix_known_time(system, given)
    signs = branch is not None and branch not in system.structure.posture_names
    time = None if is_nearest_exact_known(system, tolerance) else _make_time_limit(budget)
    if time is not None:
        try:
            find_nearest_exact(system, tolerance, time)
        except TimeUp:
            if not time.spent:
                raise
            q = (
                make_q(system, branch)
                if branch is not None and start is None and not signs
                else start
            )
            problem = Problem(system, "one", given, q, None, limits, TOLERANCE)
            return replace(
                _make_late_answer(get_assembler_as_given(system, given), problem),
                late=True,
                limit=time.limit,
            )
        budget = _reduce_budget(budget, time)
    if tolerance is not None:
        system, tolerance = choose_tolerated_system(system, tolerance)
    if (
        branch is None
        and prefer is None
        and limits is True
        and tolerance is None
        and budget is None
    ):
        answer = get_assembler(system, tuple(given))._answer_usual_call(given, start)
        if answer is not None:
            return _note_time_limit(answer, time)
    options = NOTHING
    if signs:
        options = {"branch": branch}
    elif branch is not None and start is None:
        start = make_q(system, branch)
    problem = Problem(
        system, "one", given, start, prefer, limits, tolerance or TOLERANCE, budget, options
    )
    return _note_time_limit(select_solver(SOLVERS, problem)[0].run(problem), time)


def _note_time_limit(answer: Assembly, time: TimeLimit | None) -> Assembly:
    """Store the time limit of the whole call in an answer that ran out of time."""
    if time is not None and answer.limit is not None:
        answer.__dict__["limit"] = time.limit
    return answer


def _make_time_limit(budget: Budget | None) -> TimeLimit:
    """Return the time limit of this call.

    There is none where the call is a part of another verb, whose limit counts.
    """
    asked = list_checks() and (budget is None or budget.time_limit is None)
    return TimeLimit(None if asked else USUAL.complete_budget(budget).time_limit)


def _reduce_budget(budget: Budget | None, time: TimeLimit) -> Budget | None:
    """Return the budget with the remaining time as its time limit."""
    return (
        budget
        if time.limit is None
        else replace(budget or Budget(), time_limit=time.remaining_seconds)
    )


def _make_late_answer(assembler: Assembler, problem: Problem) -> Assembly:
    """Return the answer of a call whose time ended before the search began.

    Its code is `OUT_OF_TIME`; `q` is what one start reached.
    """
    answer = assembler._solve_problem(
        problem._replace(prefer=None, budget=Budget(starts=1, time_limit=LEAST))
    )
    code = np.where(
        np.asarray(answer.code) == Status.BAD_INPUT, Status.BAD_INPUT, Status.OUT_OF_TIME
    )
    return replace(
        answer,
        success=unwrap_scalar(np.zeros(np.shape(code), dtype=bool)),
        code=to_status(unwrap_scalar(code)),
    )


def choose_tolerated_system(system: Model, tolerance: float | str) -> tuple[Model, float]:
    """Return the system to assemble within a tolerance, and the largest residual of a success.

    A near mechanism that closes exactly takes the place of the given one; without one, the
    tolerance is that residual.
    """
    found = find_nearest_exact(system, tolerance)
    if found is not None:
        return found.system, TOLERANCE
    return system, TOLERANCE if isinstance(tolerance, str) else min(
        float(choose_smaller_tolerance(tolerance)), LOOSEST
    )


# ---- the bound form, for a fixed set of known names


@explain_errors
def bind_assembler(system: Model, known: Iterable[str] = ()) -> Assembler:
    """Return the `Assembler` for these known names, reusable for many sets of known values.

    Errors: `UnknownNameError`; `InputError` for a name that stands twice.
    """
    return get_assembler(system, read_distinct_names(known, "known"))


@keep_answers
def get_assembler(system: Model, known: tuple[str, ...]) -> Assembler:
    """Return the `Assembler` of the mechanism that stands for this one.

    That is the nearest one that closes exactly, where the system has one within its tolerance.
    """
    return get_assembler_as_given(find_ideal_system(system), known)


# ---- the solvers, and how one is chosen


def _explain_missing_signs(problem: Problem) -> str | None:
    """Return the reason why no branch is named by signs; None if one is."""
    return None if "branch" in problem.options else "no branch is named by signs"


def _explain_missing_bounds(problem: Problem) -> str | None:
    """Return the reason why there are no inequalities to obey; None if there are."""
    bounded = pack_one_sided_rows(problem.system).declared
    return None if bounded else "the system has no one-sided constraints"


def _assemble_known(problem: Problem) -> Assembly:
    """Assemble a problem by the `Assembler` of its known names."""
    return get_assembler(problem.system, tuple(problem.known))._solve_problem(problem)


def assemble_named_branch(problem: Problem) -> Assembly:
    """Assemble on the branch that signs name: closed form of dyads, polished and checked."""
    from kempe.assemble.dyads import (  # only here: other calls do not need them
        find_closed_form,
        solve_branch,
    )

    assembler = get_assembler(problem.system, tuple(problem.known))
    asked = USUAL.complete_budget(problem.budget)
    threads = None if problem.budget is None else asked.threads
    named = problem.budget is not None and problem.budget.time_limit is not None
    many = not named and any(np.ndim(x) for x in problem.known.values())
    time = TimeLimit(None) if many else _make_time_limit(problem.budget)
    try:
        with time:
            start = solve_branch(
                assembler.system, problem.known, problem.options["branch"], problem.start, threads
            )
            answer, searched, before = assembler._confirm_closed_form(
                start, read_flag(problem.limits, "limits"), threads
            )
    except TimeUp:
        if not time.spent:
            raise
        return replace(_make_late_answer(assembler, problem), limit=time.limit)
    if len(searched):  # the others are as the closed form gave them
        plan: Any = find_closed_form(assembler.system, assembler.sources)
        after = answer.q.reshape(-1, assembler.system.nq)[searched]
        code = np.array(answer.code)
        strayed = np.any(plan.branch_of(after) != plan.branch_of(before), axis=-1)
        code.flat[searched[strayed & (code.flat[searched] == Status.SOLVED)]] = Status.OTHER_BRANCH
        answer = replace(answer, success=unwrap_scalar(code == Status.SOLVED), code=to_status(code))
    return record_choice(answer, select_solver(SOLVERS, problem)[1])


SOLVERS = (
    Solver(
        "dyads",
        "closed form on the branch with these signs, then least squares",
        _explain_missing_signs,
        assemble_named_branch,
    ),
    Solver(
        "active set",
        "damped least squares in which bounds are taken up and released",
        _explain_missing_bounds,
        _assemble_known,
    ),
    Solver(
        "least squares",
        "damped least squares of the closure equations, with steps of minimum norm",
        accept_all_problems,
        _assemble_known,
    ),
)
"""Who answers for one closed configuration."""
