"""The inverse geometric model for several tasks on any frames of any system: trees, loops,
relations, free bases.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.budget import Usual
from kempe.constraints.base import Constraint
from kempe.errors import InputError, shown
from kempe.kernels.base import search_layout as S
from kempe.kinematics.configuration import as_start, home_of, mid, refuse_far
from kempe.kinematics.tasks.packed import lead_of, refuse
from kempe.kinematics.tasks.task import Task
from kempe.kinematics.tasks.task_classes import task_of
from kempe.model.kept import kept
from kempe.reals import is_sequence, is_whole
from kempe.solvers.assembly.assembler import TOLERANCE as CLOSED
from kempe.solvers.assembly.ideal import decided_within
from kempe.solvers.common.arguments import seed_number, start_count, step_count, tolerances
from kempe.solvers.common.clock import TimeLimit
from kempe.solvers.common.problem import Problem
from kempe.solvers.tasks import effort
from kempe.solvers.tasks.default_start import near_target
from kempe.solvers.tasks.demands import STARTS, STEPS, Demands
from kempe.solvers.tasks.effort import most_starts, proofs_of
from kempe.solvers.tasks.levels import packed_for, solve
from kempe.solvers.tasks.reached import Reached
from kempe.spatial import Array
from kempe.status import MEMBERS, Status

if TYPE_CHECKING:
    from kempe.model.system import System

TOLERANCE = (1e-6, 1e-6)
"""Largest error in metres and radians of a hard task that has no tolerance of its own."""
SLACK = 1.0 + 1e-6
"""By which part of a tolerance the check by the forward model may differ from the solver's own:
rounding."""
PREFERRED = ("nearest", "mid", "manipulability")
"""What can be preferred by name, besides a function of q."""
SINGLE = 30.0
"""Seconds that the answer for one problem may take, unless the caller says otherwise."""
USUAL = Usual("ik", starts=None, iterations=STEPS, time_limit=SINGLE, rng=0, threads=None)
BATCH = Usual("ik", starts=None, iterations=STEPS, time_limit=None, rng=0, threads=None)


def reach(problem: Problem) -> Reached:
    """A configuration that holds several tasks at once (the inverse geometric model of any system).

    `wanted` are tasks of `kempe.tasks`, hard or soft and in strict priorities; goals with leading
    axes make a batch. Joint limits, couplings, relations and closed loops hold, too. `start` (nq,)
    or (..., nq), or a dict by name, is the first start (default: the posture 'closed' of the file,
    else the middle of the limits). `prefer` says what is made least in the freedoms that all tasks
    leave: "nearest" (distance to the start), "mid" (distance to the middle of the limits),
    "manipulability" (its inverse, of the hard tasks), or a function of q (nq,). `tolerance` is the
    largest error of a hard task in metres and radians, by default 1e-6 each; what is reached is
    then closed to rounding where it converges. Soft tasks alone are lowered from up to five starts,
    the least counts.

    Of the `budget` are read: starts, iterations (60), time_limit, rng (0), threads. Starts are
    drawn from rng: the same arguments give the same answer, whatever the threads. By default they
    are 60, then as many as the problem deserves: no more where it is proven that there is no
    answer; where one is found without the limits, 30 times the square of the number of limited
    coordinates that the tasks move (at least 300, at most 15 000); else a tenth of these.
    Iterations are the steps of one start, at most, and four times as many those of a lower level
    from one start. The time limit is looked at before each start: an answer that it ended says so,
    and is the only one that depends on the machine. By default it is 30 s for one problem; a batch
    has none. Where tasks or constraints are Python functions, one problem is given up after 10 000
    calls of these if a search without limits, or for these alone, finds nothing.

    A success is checked by the forward model: hard tasks, limits and loops. Else the answer says
    what fails and why, and ``answer.expect()`` raises `NoSolutionError`; its `q` is the nearest
    found, by the sum of squares of what tasks miss, in characteristic lengths and radians. Method:
    damped least squares with an active set of limits and restarts (Levenberg, 1944; Sugihara,
    2011), then the lower levels in the null space of the higher ones (Siciliano and Slotine, 1991).
    Errors: `InputError`, `UnknownNameError`.
    """
    system = problem.system
    prefer = problem.prefer
    spend = BATCH.of(problem.budget)
    if not (
        prefer is None or callable(prefer) or (isinstance(prefer, str) and prefer in PREFERRED)
    ):
        raise InputError(
            f"prefer is {shown(prefer)}; it must be {', '.join(map(repr, PREFERRED))} or a "
            "function of q"
        )
    tolerance = TOLERANCE if problem.tolerance is None else problem.tolerance
    starts = spend.starts
    threads = spend.threads
    turns = prefer is None or prefer == "nearest"
    time = TimeLimit(USUAL.of(problem.budget).time_limit)
    decided_within(USUAL, time, system)
    demands, base = pose_problem(
        system, problem.wanted, problem.start, tolerance, starts, spend.rng, turns
    )
    search = Demands.run if starts is not None else effort.search
    limit = spend.time_limit if demands.lead else time.limit
    if spend.iterations != STEPS or limit is not None:
        end = math.inf if limit is None else time.end
        demands = replace(
            demands, iterations=step_count(spend.iterations), time_limit=limit, end=end
        )
    if (
        prefer == "manipulability" and demands.lead
    ):  # it depends on the goal, of which each row has its own
        rows = [_preferring(demands.of(i), prefer, base) for i in range(math.prod(demands.lead))]
        each = [
            solve(row, base[i : i + 1] if len(base) > 1 else base, search)
            for i, row in enumerate(rows)
        ]
        q, info = (
            np.concatenate([x[k] for x in each] or [np.empty((0, n))])
            for k, n in ((0, system.nq), (1, 3))
        )
    else:
        demands = demands if prefer is None else _preferring(demands, prefer, base)
        unasked = problem.budget is None or problem.budget.time_limit is None
        if unasked and starts is None and not demands.lead and effort.of_functions(demands):
            demands, (q, info) = effort.patiently(
                demands, lambda part: solve(part, base, search, threads), base
            )
        else:
            q, info = solve(demands, base, search, threads)
    answer = judge(demands, q, info)
    if not demands.lead and answer.code == Status.BAD_INPUT:
        for each, goals in zip(demands.tasks, demands.goals, strict=True):
            refuse(goals, each.label)
        refuse_far(system, base, "start")
        raise InputError("the goals and the start lead to numbers that are not finite")
    return answer


def pose_problem(
    system: System,
    wanted: Constraint | Sequence[Constraint],
    start: Any = None,
    tolerance: Any = TOLERANCE,
    starts: int | None = STARTS,
    rng: Any = 0,
    turns: bool = False,
) -> tuple[Demands, Array]:
    """The problem, checked and packed, and its first starts (N or 1, nq); `turns` as in `Packed`.

    `starts` None are as many as it deserves.
    """
    tasks = _distinct(wanted, system.dim)
    goals = tuple(t.goals(system) for t in tasks)
    base = _home(system) if start is None else as_start(system, start)
    lead = own = lead_of(goals)
    if base.ndim > 1:
        try:
            lead = np.broadcast_shapes(lead, base.shape[:-1])
        except ValueError:
            raise InputError(
                f"start has shape {base.shape}, the goals have the leading shape {lead}"
            ) from None
        base = np.broadcast_to(base, (*lead, system.nq)).reshape(math.prod(lead), system.nq)
    packed = packed_for(system, tasks, turns)
    pins = packed.pins(goals, lead if own else ())
    use = (True,) * len(tasks)
    most = most_starts(system, packed) if starts is None else start_count(starts)
    problem = Demands(
        system,
        tasks,
        packed,
        goals,
        pins,
        lead,
        TOLERANCE if tolerance is TOLERANCE else tolerances(tolerance),
        most,
        seed_number(rng),
        use,
        loose=start is None,
    )
    starts_at = (
        near_target(problem, base)
        if start is None
        else base.reshape(math.prod(base.shape[:-1]), system.nq)
    )
    return problem, np.ascontiguousarray(starts_at)


@kept
def _home(system: System) -> Array:
    """Where a search starts by default."""
    return home_of(system)


def _distinct(wanted: Any, dim: int) -> tuple[Task, ...]:
    """The tasks, checked, with labels that differ."""
    single = isinstance(wanted, Constraint)
    given: tuple[Any, ...] = (wanted,) if single else tuple(wanted) if is_sequence(wanted) else ()
    if not given or not all([isinstance(t, Constraint) for t in given]):
        what = "an empty list" if is_sequence(wanted) and not wanted else shown(wanted)
        raise InputError(
            "without a frame the target must be a task of kempe.tasks or a list of them; it is "
            f"{what}"
        )
    out: dict[str, Task] = {}
    for task in given:
        if not is_whole(task.priority):
            raise InputError(
                f"priority of {task.label} is {task.priority!r}; it must be a whole number"
            )
        weight: Any = task.weight
        number: bool = isinstance(weight, (int, float, np.integer, np.floating)) and not isinstance(
            weight, bool
        )
        if weight is not None and not (number and 0.0 < weight < math.inf):
            raise InputError(
                f"weight of {task.label} is {weight!r}; it must be a positive number, or None"
            )
        if not isinstance(task.name, str):
            raise InputError(f"name of a task is {task.name!r}; it must be text")
        if task.tolerance is not None:
            allowed = tolerances(task.tolerance)
            task = (
                task
                if task.tolerance.__class__ in (int, float)
                else replace(task, tolerance=allowed)
            )
        label = task.label
        count = 1
        while label in out:
            count += 1
            label = f"{task.label} ({count})"
        out[label] = task_of(task if count == 1 else replace(task, name=label), dim)
    return tuple(out.values())


def _preferring(problem: Demands, prefer: Any, base: Array) -> Demands:
    """The problem, with what `prefer` minimises as its last level."""
    if prefer == "nearest":
        return replace(
            problem, mode=S.AHEAD, aim=_home(problem.system)[None] if problem.loose else base
        )
    if prefer == "mid":
        return replace(problem, mode=S.AHEAD, aim=mid(problem.system)[None])
    from kempe.solvers.tasks.preferences import least

    callback = least(problem, prefer)
    return replace(problem, mode=callback.address, callback=callback)


def judge(problem: Demands, q: Array, info: np.ndarray) -> Reached:
    """The answer, each configuration checked by the forward model, the limits and the loops."""
    system = problem.system
    lead = problem.lead
    packed = problem.packed
    status = info[:, 0]
    bad = status == S.BAD_INPUT
    some_bad = bad.any()
    sound = (np.where(bad[:, None], system.neutral, q) if some_bad else q).reshape(*lead, system.nq)
    hard, allowed = problem.levels[2:]
    every = np.empty((len(problem.tasks), *lead, 2))
    for error, task, goals in zip(every, problem.tasks, problem.goals, strict=True):
        error[..., 0], error[..., 1] = task.measure(system, sound, goals)
    allowed = allowed.reshape(-1, *[1] * len(lead), 2)
    of_hard = every if len(hard) == len(every) else every[hard]
    good = (of_hard <= allowed * SLACK).all(axis=(0, -1))
    worst = of_hard.max(axis=0, initial=0.0)
    if problem.limits:
        at, low, high = packed.limits
        x = sound[..., at]
        good &= ((x >= low) & (x <= high)).all(axis=-1)
    if packed.closed:
        from kempe.kinematics.closure_rows import evaluate

        good &= (
            np.linalg.norm(evaluate(packed.closing, sound, False, True)[0], axis=-1)
            <= 10.0 * CLOSED
        )
    if packed.one_sided.declared and problem.one_sided:
        good &= ~packed.one_sided.beyond(sound, declared=True).any(axis=-1)
    late = status >= S.LATE
    code = np.zeros(len(status), dtype=np.int64)  # S.SOLVED: np.full takes ten times as long
    if some_bad or not good.all():
        code = np.where(
            good.ravel(), Status.SOLVED, np.where(late, Status.OUT_OF_TIME, Status.NOT_FOUND)
        )
        code[bad] = Status.BAD_INPUT
        if problem.limits and np.any(code == Status.NOT_FOUND):
            proofs = proofs_of(problem)
            code = np.where((code == Status.NOT_FOUND) & (proofs > 0), proofs, code)
    columns = (code == S.SOLVED, code, worst[..., 0], worst[..., 1], info[:, 1], info[:, 2], late)
    fields = [x.reshape(lead) if lead else x.item() for x in columns]
    errors = {t.label: e for t, e in zip(problem.tasks, every, strict=True)}
    success, code, *fields, cut_off = fields
    q = q.reshape(*lead, system.nq)
    code = code if lead else MEMBERS[int(code)]
    return Reached(q, success, code, *fields, problem=problem, errors=errors, late=cut_off)
