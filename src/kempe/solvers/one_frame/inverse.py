"""The inverse geometric model, numerically: a configuration in which a frame of a tree reaches a
target.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.budget import Budget, TimeUp, Usual
from kempe.calls import explained, flag, together
from kempe.constraints.frame_targets import of_target
from kempe.errors import InputError, TimeLimitError
from kempe.kernels.base.search_layout import ANSWER, LARGEST, LINEAR, SOLVED, STATUS
from kempe.kinematics.configuration import as_start, refuse_far
from kempe.kinematics.one_sided import one_sided_rows
from kempe.model.kept import kept
from kempe.rigid import sound
from kempe.solvers.common.arguments import (
    deadline,
    seed_number,
    start_count,
    step_count,
    tolerances,
)
from kempe.solvers.common.clock import SHORT, TimeLimit
from kempe.solvers.common.problem import NOTHING, Choice, Problem, Solver, TaskOf, choose, chosen_by
from kempe.solvers.common.serial_chain import Chain, chain_of, inside, obstacle
from kempe.solvers.common.targets import (
    axis_for,
    check_particle,
    given_target,
    in_plane,
    not_a_pose,
    points_along,
    refuse_position,
    targets_of,
    task_and_axis,
    task_of,
)
from kempe.solvers.one_frame import multi_start
from kempe.solvers.one_frame.bound_ik import bind
from kempe.solvers.one_frame.iterates import with_history
from kempe.solvers.one_frame.multi_start import (
    ITERATIONS,
    MOST,
    TOLERANCE,
    FrameProblem,
    look_closer,
)
from kempe.solvers.one_frame.solution import Solution
from kempe.spatial import Array
from kempe.status import Status, member

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

METHODS = ("numeric", "analytic", "auto")
TASKS = "tasks are requested, not a target of one frame"
CLOSED = "method='analytic' asks for a closed form"
USUAL = Usual("ik", starts=MOST, iterations=ITERATIONS, time_limit=SHORT, rng=0, threads=None)
BATCH = Usual("ik", starts=MOST, iterations=ITERATIONS, time_limit=None, rng=0, threads=None)


@explained
def ik(
    system: System,
    target: Any,
    frame: FrameLike | None = None,
    start: Any = None,
    *,
    task: str | tuple[str, ArrayLike] | None = None,
    prefer: Any = None,
    method: str | None = None,
    tolerance: float | tuple[float, float] | None = None,
    budget: Budget | None = None,
    history: bool = False,
) -> Solution:
    """A configuration in which `frame` reaches `target` (the inverse geometric model), always
    inside the limits.

    Without a frame `target` are tasks, see `kempe.solvers.tasks.ik_tasks.reach`.
    `target` is a pose (..., 4, 4) in the ground frame (in planar systems also (..., 3, 3), and,
    with ``task="pose"``, x, y and angle (..., 3)), or a position (..., 3) (in planar systems also
    (..., 2)), or an object or words that say one (`kempe.rigid.arrays`), or the name of a frame on
    the ground. `task` says what of it counts: "pose", "position", "orientation", "direction" (of
    the tool's z axis, or of another one in a pair such as ("direction", (1, 0, 0))),
    "position_axis" (both). `tolerance` is the largest position error [m] and rotation angle [rad],
    1e-6 each.
    `start` (nq,) or (..., nq), a dict by name, or the name of a posture, is the first start; what
    the chain does not move keeps its value there, else the neutral one, inside the limits. Targets
    and starts broadcast: many starts for one target give many answers. With `history`, the answer
    to one target has its iterates (`Solution.history`).

    Of the `budget` are read: starts (1000), iterations (40), time_limit (30 s for one target, none
    for a batch, whose number of targets says how long it takes), rng (0), threads. Starts are tried
    in order, `start` or the middle of the limits first, the others drawn from rng; the first that
    reaches the target is the answer: the same for the same arguments, whatever the threads.
    Iterations are the steps of one start, at most; where all fail, as many descents to the nearest,
    at most 16, have five times as many. A time limit that is given is looked at after each 32
    starts, of chains of more than 31 coordinates after fewer: an answer that it ended says so, and
    is the only one that depends on the machine.

    The answer says by `success` and `status` whether it was reached and if not, why;
    ``answer.expect()`` raises `NoSolutionError` then. Not reached, its `q` is the nearest found:
    least is the square of the miss, of the position in characteristic lengths of the system, of the
    rotation in radians. A NaN in a single target is an `InputError`, in a batch it gives a NaN row.
    A frame that moves with closed loops, declared constraints, or relations of several coordinates,
    is a case for `reach`, which holds these, and so is what one would `prefer` of many
    configurations, as there: the answer then is `Reached`.

    `method`: "numeric" (the default), damped least squares with an active set of limits and
    restarts (Sugihara, 2011; Chan and Lawrence, 1988); "analytic", of all solutions that `ik_all`
    finds the one nearest to `start`; "auto", that where the chain allows it, else numeric. Targets
    that have no analytic solution inside the limits get the numeric answer.
    """
    if frame is not None:
        return _of_frame(
            system,
            target,
            frame,
            start,
            task,
            prefer,
            method or "numeric",
            tolerance,
            budget,
            history,
        )
    for name, value in (("task", task), ("method", method), ("history", history or None)):
        if value is not None:
            raise InputError(
                f"{name} is {value!r}; it belongs to a target of one frame, not to tasks"
            )
    problem = Problem(
        system, "one", start=start, prefer=prefer, tolerance=tolerance, budget=budget, wanted=target
    )
    solver, choice = chosen(system, None, problem.task, problem.method, prefer is not None)
    return chosen_by(solver.run(problem), choice)


def _of_frame(
    system: System,
    target: Any,
    frame: FrameLike,
    start: Any,
    task: Any,
    prefer: Any,
    method: str,
    tolerance: Any,
    budget: Budget | None,
    history: bool,
) -> Solution:
    """The answer for targets of one frame."""
    name = system.structure.frame_name(frame)
    target = given_target(system, target)
    said, axis = task_and_axis(task)
    requested, targets, lead = _checked(system, name, target, said, axis)
    if start is not None:
        targets, lead, start = _together(targets, lead, as_start(system, start))
    if method not in METHODS:
        raise InputError(f"method is {method!r}; it must be one of {', '.join(map(repr, METHODS))}")
    if prefer is not None and method != "numeric":
        raise InputError(f"method is {method!r}, which prefers nothing; leave it out, or prefer")
    options = NOTHING
    if method == "numeric":
        solver, choice = chosen(system, name, requested, method, prefer is not None)
    else:
        time = TimeLimit((BATCH if lead else USUAL).of(budget).time_limit)
        solver, choice, method = _planned(time, system, name, requested, method, prefer is not None)
        options = {"end": time.end}
    targets = (
        targets.copy() if np.may_share_memory(targets, target) else targets
    )  # the answer keeps them
    problem = Problem(
        system,
        "one",
        start=start,
        prefer=prefer,
        tolerance=tolerance,
        budget=budget,
        frame=name,
        task=requested,
        targets=targets,
        lead=lead,
        method=method,
        options=options,
    )
    answer = chosen_by(solver.run(problem), choice)
    if not lead and task is said and solver is not BY_TASKS:
        bind(answer.task, said, np.shape(target))
    return with_history(answer, problem) if flag(history, "history") else answer


def _together(
    targets: Array, lead: tuple[int, ...], start: Array
) -> tuple[Array, tuple[int, ...], Array]:
    """Targets (N, 4, 4), their leading shape and starts, one of which is for all of the others,
    with one shape.
    """
    if start.ndim == 1 or start.shape[:-1] == lead:
        return targets, lead, start
    many = together({"target": lead, "start": start.shape[:-1]})
    targets = np.broadcast_to(targets.reshape(*lead, 4, 4), (*many, 4, 4)).reshape(
        math.prod(many), 4, 4
    )
    return np.ascontiguousarray(targets), many, np.broadcast_to(start, (*many, start.shape[-1]))


# ---- the solvers


def _no_closed_form(
    system: System, frame: str | None, task: TaskOf, method: str, prefers: bool
) -> str | None:
    if frame is None or method == "numeric":
        return TASKS if frame is None else "method='analytic' or 'auto' asks for it"
    bounds = one_sided_rows(system)
    if bounds.declared:
        return (
            f"method 'analytic' does not hold one-sided constraints, such as {bounds.names[0]!r}; "
            "leave it out, or take one of the solutions of ik_all, which do"
        )
    from kempe.solvers.analytic.ik_analytic import plan_of

    plan = plan_of(system, frame, *task)
    return plan if isinstance(plan, str) else None


def _no_chain(
    system: System, frame: str | None, task: TaskOf, method: str, prefers: bool
) -> str | None:
    if frame is None or method == "analytic":
        return TASKS if frame is None else CLOSED
    if prefers:
        return "it prefers nothing"
    if one_sided_rows(system).declared:
        return (
            f"it does not hold one-sided constraints, such as {one_sided_rows(system).names[0]!r}"
        )
    return obstacle(system, frame)


def _no_tasks(
    system: System, frame: str | None, task: TaskOf, method: str, prefers: bool
) -> str | None:
    return CLOSED if method == "analytic" else None


def _of_chain(problem: Problem) -> Solution:
    """The answer by the frame's own chain: by numbers, or in closed form where the method is not
    numeric.
    """
    system = problem.system
    name = str(problem.frame)
    lead = problem.lead
    spend = (BATCH if lead else USUAL).of(problem.budget)
    usual = problem.budget is None or problem.budget.time_limit is None
    chain = chain_of(system, name, problem.task[1])
    tolerance = problem.tolerance
    base, seeds = seeds_of(system, chain, problem.start, lead)
    question = FrameProblem(
        system,
        name,
        problem.targets,
        *problem.task,
        TOLERANCE if tolerance is None else tolerances(tolerance),
        start_count(spend.starts),
        seed_number(spend.rng),
        chain,
        step_count(spend.iterations),
        spend.time_limit,
        problem.options["end"] if problem.options else deadline(spend.time_limit),
        usual,
    )
    plan = None
    if problem.method != "numeric":
        from kempe.solvers.analytic import ik_analytic

        found = ik_analytic.plan_of(system, name, *problem.task)
        plan = None if isinstance(found, str) else found
    question, (q, residual, info) = _run(question, plan, base, seeds, spend.threads, lead)
    return _judged(question, base, q, residual, info, lead, seeds, spend.threads)


def _of_tasks(problem: Problem) -> Solution:
    """The answer of `kempe.solvers.tasks.ik_tasks.reach`."""
    from kempe.solvers.tasks.ik_tasks import reach

    frame = problem.frame
    targets = problem.targets
    held = (
        problem.wanted
        if frame is None
        else of_target(frame, *problem.task, targets.reshape(*problem.lead, 4, 4))
    )
    return reach(problem._replace(wanted=held))


BY_TASKS = Solver(
    "levels",
    "least squares over all coordinates, with loops, limits and one-sided rows, by priorities",
    _no_tasks,
    _of_tasks,
)
SOLVERS = (
    Solver(
        "closed form",
        "of all solutions of ik_all the nearest; else as chain",
        _no_closed_form,
        _of_chain,
    ),
    Solver(
        "chain",
        "damped least squares over the frame's own chain, with limits and restarts",
        _no_chain,
        _of_chain,
    ),
    BY_TASKS,
)
"""Who answers for targets of one frame, and for tasks."""


@kept
def chosen(
    system: System, frame: str | None, task: TaskOf, method: str, prefers: bool
) -> tuple[Solver, Choice]:
    """Who answers for a frame and a task of it, or, without a frame, for tasks."""
    return choose(SOLVERS, system, frame, task, method, prefers)


def _planned(
    time: TimeLimit, system: System, frame: str, task: TaskOf, method: str, prefers: bool
) -> tuple[Solver, Choice, str]:
    """Who answers, and by which method: numbers where the time does not last to plan a closed form."""
    time.put_in_order()  # a plan is made as a whole, or not at all
    try:
        with time:
            return *chosen(system, frame, task, method, prefers), method
    except TimeUp:
        if not time.spent:
            raise
        if method == "analytic":
            raise TimeLimitError("ik", time.limit) from None
    return *chosen(system, frame, task, "numeric", prefers), "numeric"


def _run(
    question: FrameProblem,
    plan: Any,
    base: Array,
    seeds: Array,
    threads: int | None,
    lead: tuple[int, ...],
) -> tuple[FrameProblem, tuple[Array, Array, np.ndarray]]:
    """The question and what `run`, or the closed form of a plan, finds; rotations that were rounded
    are mended.
    """
    if plan is None:
        found = run(question, seeds, threads, postpone=bool(lead))
    else:
        from kempe.solvers.analytic import ik_analytic

        found = ik_analytic.answer(question, plan, base, seeds, threads)
    targets = question.targets
    if (
        lead
        and (found[2][:, 0] == Status.BAD_INPUT).any()
        and (mended := sound(targets, "target")) is not targets
    ):
        return _run(replace(question, targets=mended), plan, base, seeds, threads, lead)
    return question, found


def _nearest(
    question: FrameProblem,
    base: Array,
    seeds: Array,
    threads: int | None,
    q: Array,
    residual: Array,
    info: np.ndarray,
    lead: tuple[int, ...],
) -> Solution:
    """The answer of a batch as of `run`, with what is nearest to the targets that are out of reach."""
    far = np.flatnonzero(info[:, 0] == Status.OUT_OF_REACH)
    some = seeds[far] if len(seeds) > 1 else seeds
    anew = replace(question, end=deadline(question.time_limit))
    q[far], residual[far], info[far] = run(anew, some, threads, targets=question.targets[far])
    return _judged(question, base, q, residual, info, lead, seeds, threads)


def _judged(
    question: FrameProblem,
    base: Array,
    q: Array,
    residual: Array,
    info: np.ndarray,
    lead: tuple[int, ...],
    seeds: Array,
    threads: int | None,
) -> Solution:
    """The answer, from the chain's configurations (N, n), residuals (N, 2) and status, steps and
    starts (N, 3).

    Where `run` has postponed targets, their part of it is found on demand.
    """
    system = question.system
    targets = question.targets
    code = info[:, 0]
    if (code == Status.OUT_OF_REACH).any():
        given = (question, base, seeds, threads, q, residual, info, lead)
        return Solution.postponed(code.reshape(lead).copy(), question, (_nearest, given))
    full = np.empty((len(targets), system.nq))
    full[:] = base
    full[:, question.chain.q_index] = q
    if code.any():
        look_closer(question, code)
        full[code == Status.BAD_INPUT] = math.nan
    if not lead and code[0] == Status.BAD_INPUT:
        refuse_far(system, base, "start")
        raise InputError(not_a_pose(targets[0], "start"))
    return _answer(question, full, code, residual, info, lead)


def _checked(
    system: System, frame: str, target: Any, task: str | None, axis: ArrayLike
) -> tuple[tuple[str, tuple[float, float, float]], Array, tuple[int, ...]]:
    """(task, axis), targets (N, 4, 4) and their leading shape."""
    if system.dim == 2 and points_along(task):
        target, task = in_plane(target, task, axis)
    direction = axis_for(axis, task)
    targets, lead, is_position = targets_of(system, target, task, direction)
    particle = bool(system.structure.table.at[frame][2])
    name = task_of(task, is_position, particle)
    refuse_position(name, is_position, system.dim)
    if particle and task is None and not is_position:
        check_particle(targets, frame)
    return (name, direction), targets, lead


def run(
    task: FrameProblem,
    seeds: Array,
    threads: int | None = 1,
    limits: Array | None = None,
    targets: Array | None = None,
    postpone: bool = False,
) -> tuple[Array, Array, np.ndarray]:
    """Chain configurations, residuals (N, 2) and (status, steps, starts) of all targets, in fixed
    chunks.

    `postpone` is as in `multi_start.answered`.
    """
    chain = task.chain
    goals = task.targets if targets is None else targets
    n = len(goals)
    nq = len(chain.q_index)
    out = np.empty((n, nq + ANSWER))
    bounds = chain.limits if limits is None else limits

    multi_start.answered(task, goals, seeds, bounds, out, postpone, threads)
    return out[:, :nq], out[:, nq + LINEAR : nq + STATUS], out[:, nq + STATUS :].astype(np.int64)


def seeds_of(
    system: System, chain: Chain, start: Any, lead: tuple[int, ...]
) -> tuple[Array, Array]:
    """Configurations (1 or N, nq) to start from, and the chain's part of them as (1 or N, K, nq)
    for the kernel.
    """
    if start is None:
        return chain.base, chain.no_seed
    base = as_start(system, start)
    base = np.array(base.reshape(math.prod(base.shape[:-1]), system.nq))
    if not lead and not np.all(np.abs(base) < LARGEST):
        refuse_far(system, base, "start")
    seeds = np.ascontiguousarray(
        base[:, None, chain.q_index]
    )  # the kernel brings them inside, circles by turns
    return inside(system, base), seeds


def _answer(
    task: FrameProblem,
    q: Array,
    code: np.ndarray,
    residual: Array,
    info: np.ndarray,
    lead: tuple[int, ...],
) -> Solution:
    columns = (code == SOLVED, code, residual[:, 0], residual[:, 1], info[:, 1], info[:, 2])
    fields = [x.reshape(lead) if lead else x[0].item() for x in columns]
    success, code_, position, angle, steps, starts = fields
    q = q.reshape(*lead, task.system.nq)
    return Solution(q, success, member(code_), position, angle, steps, starts, task)
