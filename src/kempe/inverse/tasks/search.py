"""`ik` for several tasks on any frames of any system: trees, loops, relations, free bases."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.problem import Problem
from kempe.arguments import draw_seed, read_start_count, read_step_count, read_tolerances
from kempe.arrays import is_sequence, is_whole
from kempe.assemble.bound import TOLERANCE as CLOSED
from kempe.assemble.nearest_exact import find_ideal_system, find_nearest_exact_in_time
from kempe.budget import Usual
from kempe.constraints.base import Constraint, Content, freeze_fields
from kempe.equations.packed_tasks import Packed, find_leading_shape, refuse_goal
from kempe.equations.task_functions import (
    REAL_STEP,
    choose_derivative_method,
    compute_checked_value,
    compute_function_jacobian,
)
from kempe.equations.tasks import Task
from kempe.errors import InputError, format_value
from kempe.forward.fk import fk, jacobian
from kempe.inverse.answer import Reached
from kempe.inverse.tasks.demands import (
    FIRST,
    KEPT,
    STARTS,
    STEPS,
    Demands,
    TaskLevel,
    get_task_level,
)
from kempe.inverse.tasks.proofs import find_contradictory_problems, find_unreachable_problems
from kempe.joints import P
from kempe.kernels.base import search_layout as S
from kempe.kernels.compiled import closure_batch
from kempe.kernels.constraints import loop_layout as L
from kempe.model.configurations import (
    compute_mid_configuration,
    find_home,
    read_start,
    refuse_large_numbers,
    sample_configurations,
)
from kempe.model.kernel_functions import Callback
from kempe.model.model import keep_answers, store_answer
from kempe.model.own_tree import remove_cut_marks
from kempe.numerics.clock import EndReached, TimeLimit
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array
from kempe.status import MEMBERS, Status
from kempe.units import make_tolerance

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- starts near a target

FAR = 10.0
"""Characteristic lengths from a frame to its target from which on a base is moved before the first
start."""


def move_bases_to_target(problem: Demands, home: Array) -> Array:
    """Move unlimited sliding bases of starts (N or 1, nq) to the first hard task's goal.

    So a drive over the plane begins beside its target; what is near stays. A base that flies is
    moved by the kernels.
    """
    system = remove_cut_marks(problem.system)
    base = _list_free_slides(system)
    if not len(base) or problem.packed.loops.plan[L.BASE_TIE] >= 0:
        return home[None]
    for task, goal in zip(problem.tasks, problem.goals, strict=True):
        shape = task.frame_shape
        a, b = task.frames
        placed = shape is not None and shape.point and not task.bounded and a is None
        if not placed or task.weight is not None or goal.pose is None or b is None:
            continue
        J = jacobian(system, home, b)[:3, base]
        X = fk(system, home, b) @ np.reshape(task.tool, (4, 4))
        away = goal.pose[..., :3, 3] - X[:3, 3]
        far = np.linalg.norm(away, axis=-1, keepdims=True) > FAR * problem.packed.loops.length
        if not J.any() or not far.any():
            continue
        dx = away @ Spectrum(J).compute_pseudo_inverse(Level.CLOSED).T
        moved = np.tile(home, (*dx.shape[:-1], 1))
        places = dict(
            zip(
                system.structure.layout.vector_v.tolist(),
                system.structure.layout.vector_q.tolist(),
                strict=True,
            )
        )
        moved[..., [places[v] for v in base]] += dx
        moved = np.where(far & np.isfinite(dx).all(axis=-1, keepdims=True), moved, home)
        return (
            np.broadcast_to(moved, (*(problem.lead if dx.ndim > 1 else ()), system.nq))
            .reshape(-1, system.nq)
            .copy()
        )
    return home[None]


@keep_answers
def _list_free_slides(system: Model) -> list[int]:
    """List velocity coordinates of unlimited slides along axes that nothing turns."""
    table = system.structure.table
    out: list[int] = []
    straight: set[int] = {-1}
    for row, (kind, parent, v) in enumerate(zip(table.kind, table.parent, table.iv, strict=True)):
        if kind == P and int(parent) in straight:
            straight.add(row)
            if (
                np.isinf(system.lower[v])
                and np.isinf(system.upper[v])
                and np.sum(table.iv == v) == 1
            ):
                out.append(int(v))
    return out


# ---- preferences: what is minimised in the freedoms that tasks leave

SMALL = 1e-24
"""Added to squared singular values, so that the logarithm of none is infinite."""


def make_objective(problem: Demands, prefer: Any) -> Callback:
    """Make the objective that the search minimises, as kernels call it.

    `prefer` is "manipulability" or a function of q. Errors: `InputError`.
    """
    if prefer == "manipulability":
        callback = Callback(
            problem.system,
            1,
            _add_difference_gradient(problem, lambda q: -compute_log_manipulability(problem, q)),
        )
    else:
        callback = Callback(problem.system, 1, _wrap_user_function(problem, prefer))
    callback.scale = problem.packed.scale
    return callback.remember_maker(make_objective, problem, prefer)


def compute_log_manipulability(problem: Demands, q: Array) -> Array:
    """Compute the logarithm (...) of the hard tasks' manipulability at q (..., nq).

    It is sqrt(det(J J^T)) (Yoshikawa, 1985).

    J is taken in the velocities that the loops leave. For tasks that are singular everywhere, of
    the part that is not.
    """
    packed = problem.packed
    hard = [i for i, t in enumerate(problem.tasks) if t.weight is None]
    J = packed.evaluate_tasks(q, problem.pins)[1][
        ..., np.isin(packed.rows[packed.rows >= 0], hard), :
    ]
    C = packed.evaluate_tasks(q, problem.pins, closures=True)[1]
    if C.shape[-2]:
        J = J - J @ Spectrum(C).compute_pseudo_inverse(Level.CLOSED) @ C
    s = Spectrum(J).values
    return 0.5 * np.sum(np.log(s * s + SMALL), axis=-1)


def _add_difference_gradient(
    problem: Demands, function: Callable[[Array], Array]
) -> Callable[[Array], tuple[Any, Array]]:
    """Add the gradient by central differences to a function of configurations."""
    system = problem.system
    steps = REAL_STEP * np.concatenate(
        [np.eye(system.nv), -np.eye(system.nv), np.zeros((1, system.nv))]
    )

    def evaluate_with_gradient(q: Array) -> tuple[Any, Array]:
        f = function(system.structure.layout.integrate_velocity(q, steps))
        return f[-1:], ((f[: system.nv] - f[system.nv : -1]) / (2.0 * REAL_STEP))[None]

    return evaluate_with_gradient


def _wrap_user_function(
    problem: Demands, function: Callable[[Array], Any]
) -> Callable[[Array], tuple[Any, Array]]:
    """Wrap a user's function of q as one that gives value (1,) and gradient (1, nv)."""
    layout = problem.system.structure.layout
    q0 = sample_configurations(problem.system, 0)
    if compute_checked_value("prefer", function, q0).size != 1:
        raise InputError(
            "what is preferred must be one number: a function of q (nq,) to be made least"
        )
    how = choose_derivative_method(function, layout, q0)
    return lambda q: (
        np.ravel(function(q)),
        compute_function_jacobian(function, None, how, layout, q).reshape(1, -1),
    )


# ---- effort: how many starts a search is given

# Few where nothing speaks for an answer, many where much does. Without the limits, nearly every
# start finds an answer where there is one. So where some starts without them fail too, more are
# hardly worth their time; where they do not, an answer within the limits may take thousands of
# starts.

EACH = 30
MOST = 15_000
HOPELESS = 10
"""Starts by the square of the number of limited coordinates that the tasks move, their largest
number, and the part of them that is tried where no answer without limits is found either. With 30,
1470 are for an arm with seven joints."""


GLIMPSE = 10_000
SHARE = 2_500
"""Calls of Python functions after which it is checked whether a search may ever end well, and calls
of each of the searches by which this is checked. They are counted, not timed, so that no answer
depends on how busy the machine is."""

Found = tuple[Array, np.ndarray]
"""Configurations (N, nq) and (status, steps, starts) (N, 3)."""


class Effort:
    """Check for `watched_by` that ends a search after `most` function calls and starts."""

    def __init__(self, most: int):
        self.most = most
        self.count = 0

    def __call__(self) -> None:
        """Count one call; raise `EndReached` where there are too many."""
        self.count += 1
        if self.spent:
            raise EndReached

    @property
    def spent(self) -> bool:
        """Whether the search has made too many calls."""
        return self.count > self.most


def has_function_tasks(problem: Demands) -> bool:
    """Whether Python functions are among the constraints, so that times are unpredictable."""
    return any(t.function is not None for t in problem.packed.loops.ties)


def search_with_call_limit(
    problem: Demands, solve: Callable[[Demands], Found], base: Array
) -> tuple[Demands, Found]:
    """Search one problem with at most GLIMPSE calls of functions; go on if there is hope.

    Returns the problem with how far it was searched, and what `solve` finds.

    It goes on only where a search without limits finds an answer, and each function alone holds
    inside the limits.
    """
    effort = Effort(GLIMPSE)
    q, info = solve(replace(problem, effort=effort))
    if not effort.spent or time.monotonic() >= problem.end:
        return problem, (q, info)
    if _is_hopeful(problem, base) or time.monotonic() >= problem.end:
        return problem, solve(problem)
    info[info[:, 0] >= S.LATE, 0] -= S.LATE  # it was not the time that ended it
    return replace(problem, given_up=effort.most), (q, info)


def _is_hopeful(problem: Demands, base: Array) -> bool:
    """Whether there is an answer without limits, and one for each function inside them."""
    hard = [i for i, t in enumerate(problem.tasks) if t.weight is None]
    called = {
        int(i)
        for i, t in zip(problem.packed.owner, problem.packed.loops.ties, strict=True)
        if t.function
    }
    trials = [
        problem.select_tasks(hard, False),
        *(problem.select_tasks([i]) for i in hard if i in called),
    ]
    for trial in trials:
        _, info = replace(trial, end=problem.end, effort=Effort(SHARE)).run_search(
            base[:1], tries=FIRST
        )
        if info[0, 0] != S.SOLVED:
            return False
    return True


def choose_start_count(system: Model, packed: Packed) -> int:
    """Choose the number of starts by the number of limits that an answer may touch.

    The number is kept.
    """
    found = packed.stages.get(choose_start_count)
    if found is None:
        plan = packed.loops.plan
        weights = packed.loops.weights
        nv = system.nv
        places = plan[plan[L.AT_PLACES] :][: L.PLACE_INTS * nv].reshape(nv, L.PLACE_INTS)
        moves = np.diff(plan[plan[L.AT_VARS] :][: nv + 1]) > 0
        _, low, high, *_ = L.view_velocity_lists(weights, nv)
        limited = np.isfinite(low) | np.isfinite(high)
        count = int(np.sum(moves & limited & (places[:, 1] <= L.BOUND_TURN) & (places[:, 2] == 0)))
        found = packed.stages[choose_start_count] = min(max(EACH * count * count, 5 * FIRST), MOST)
    return found


def find_failure_proofs(problem: Demands) -> np.ndarray:
    """Find proofs that problems have no answer: status codes (N,), 0 without a proof.

    They are kept with the problem.
    """
    found: np.ndarray | None = problem.kept.get(find_failure_proofs)
    if found is None:
        against = np.where(find_contradictory_problems(problem), Status.CONTRADICTORY, 0)
        found = np.where(find_unreachable_problems(problem), Status.OUT_OF_REACH, against).ravel()
        problem.kept[find_failure_proofs] = found
    return found


def search_by_effort(
    problem: Demands, base: Array, threads: int | None = 1
) -> tuple[Array, np.ndarray]:
    """Run the search with as many starts as each problem deserves.

    No more than these where a proof says that there is no answer.
    """
    q, info = problem.run_search(base, threads, tries=FIRST)
    if len(info) == 1 and info[0, 0] == S.SOLVED:
        return q, info
    left = np.flatnonzero(info[:, 0] == S.NOT_FOUND)
    if not left.size or problem.starts <= FIRST:
        return q, info
    left = left[find_failure_proofs(problem)[left] == 0]
    if not left.size:
        return q, info
    open_ = replace(problem, limits=False, mode=S.NOTHING)
    _, found = open_.run_search(base, threads, tries=FIRST, rows=left)
    hope = found[:, 0] == S.SOLVED
    for rows, tries in ((left[hope], problem.starts), (left[~hope], problem.starts // HOPELESS)):
        if not rows.size or tries <= FIRST:
            continue
        again, more = problem.run_search(base, threads, tries=tries, rows=rows)
        better = (more[:, 0] % S.LATE == S.SOLVED) | (more[:, 2] >= info[rows, 2])
        q[rows[better]], info[rows[better]] = again[better], more[better]
        late = rows[~better]
        info[late, 0] = S.NOT_FOUND + S.LATE  # the time was up before it came as far again
    return q, info


# ---- levels of tasks, in the order of their priorities

# Lowering never gives up what earlier levels have reached, and soft levels are added one by one,
# each to what is found without it. Hard tasks behind a soft level are met first, and an angle that
# a later level names does not turn on beyond its limits: there the search without the later ones is
# looked at, too.

Search = Callable[[Demands, Array, "int | None"], tuple[Array, np.ndarray]]

GAIN = 1e-6
LITTLE = 1e-12
"""Part of the square that a level misses by which another must be less to count as lower, and the
least difference."""
MET = 1e-16
"""Square of what a soft level misses up to which it is met."""


def pack_tasks(system: Model, tasks: tuple[Task, ...], turns: bool) -> Packed:
    """Pack the ties of tasks, once for each structure; the last few are kept."""
    levels: tuple[int, ...] = ()
    if len(tasks) > 1:
        order = sorted({get_task_level(t) for t in tasks})
        if any(soft for _, soft in order[:-1]):
            levels = tuple(order.index(get_task_level(t)) for t in tasks)
    key = (turns, levels, *((t.label, t.structure_key) for t in tasks))
    answers = system._kept.setdefault(pack_tasks, {})
    found = answers.get(key)
    if found is None:
        found = Packed(system, tasks, turns=turns, levels=levels, closing=find_ideal_system(system))
        if all(t.lasting for t in tasks):
            store_answer(answers, key, found, KEPT)
    return found


def solve_levels(
    problem: Demands,
    base: Array,
    search: Search,
    threads: int | None = 1,
    rows: np.ndarray | None = None,
) -> tuple[Array, np.ndarray]:
    """Search configurations (N, nq) that satisfy the levels of tasks, from starts.

    Also returns (status, steps, starts) (N, 3); the starts are (N or 1, nq).

    A soft last level behind another soft one is lowered from what is found without it.
    """
    end = _find_last_level(problem, _is_added)
    if end is None:
        few = rows is not None
        q, info = (
            problem.run_search(base, threads, tries=FIRST, rows=rows)
            if few
            else search(problem, base, threads)
        )
        if len(problem.tasks) > 1:
            _compare_levels(
                problem, base, q, info, search, threads, np.arange(len(q)) if rows is None else rows
            )
        return q, info
    q, info = solve_levels(_select_levels(problem, end), base, search, threads, rows)
    rows = np.arange(len(q)) if rows is None else rows
    at = np.flatnonzero((info[:, 0] < S.LATE) & (info[:, 0] != S.BAD_INPUT))
    if at.size:
        q[at], more = _continue_search(problem, rows[at], q[at], threads, -1)
        info[at, 0] = more[:, 0]
        info[at, 1] += more[:, 1]
    return q, info


def _compare_levels(
    problem: Demands,
    base: Array,
    q: Array,
    info: np.ndarray,
    search: Search,
    threads: int | None,
    rows: np.ndarray,
) -> None:
    """Replace answers whose earlier levels a search without the last levels makes better.

    This is looked at where the last levels can change what the others reach, and that is missed.
    Where it comes lower, the last ones are lowered from there, as far as the others stay there. A
    success is given up only for what is one without them.
    """
    end = _find_last_level(problem, _may_differ)
    if end is None:
        return
    soft = any(t.weight is not None and get_task_level(t) <= end for t in problem.tasks)
    at = np.flatnonzero((info[:, 0] == S.NOT_FOUND) | (soft & (info[:, 0] == S.SOLVED)))
    if not at.size:
        return
    part = _select_levels(problem, end)
    here = compute_level_values(part, q[at], rows[at])
    missed = (here > MET).any(axis=1)
    at = at[missed]
    here = here[missed]
    if not at.size or time.monotonic() >= problem.end:
        return
    alone, found = solve_levels(part, base, search, threads, rows[at])
    info[at, 1] += found[:, 1]
    there = compute_level_values(part, alone, rows[at])
    fair = (found[:, 0] == S.SOLVED) | ((found[:, 0] == S.NOT_FOUND) & (info[at, 0] == S.NOT_FOUND))
    better = fair & is_lower(there, here)
    at = at[better]
    alone = alone[better]
    there = there[better]
    if not at.size:
        return
    again, more = _continue_search(problem, rows[at], alone, threads, 0)
    lost = is_lower(there, compute_level_values(part, again, rows[at]))
    again[lost] = alone[lost]
    more[lost, 0] = S.NOT_FOUND
    in_time = more[:, 0] < S.LATE
    q[at[in_time]] = again[in_time]
    info[at[in_time], 0] = more[in_time, 0]
    info[at, 1] += more[:, 1]


def _continue_search(
    problem: Demands, rows: np.ndarray, q: Array, threads: int | None, tries: int
) -> tuple[Array, np.ndarray]:
    """Run the search for some rows, from configurations of these rows."""
    starts = np.zeros((math.prod(problem.lead), q.shape[1]))
    starts[rows] = q
    return problem.run_search(starts, threads, tries=tries, rows=rows)


def _find_last_level(
    problem: Demands, where: Callable[[Demands, TaskLevel], bool]
) -> TaskLevel | None:
    """Find the last level, before the end, for which `where` is true."""
    levels = tuple([get_task_level(t) for t in problem.tasks])
    requested = where, levels
    ends = problem.packed.stages.get(requested)
    if ends is None:
        order = sorted(set(levels))
        ends = store_answer(
            problem.packed.stages,
            requested,
            [end for end in order[:-1] if where(problem, end)][-1:],
            KEPT,
        )
    return ends[0] if ends else None


def _is_added(problem: Demands, end: TaskLevel) -> bool:
    """Whether this level is soft, or follows soft ones, and a soft level comes last."""
    levels = sorted({get_task_level(t) for t in problem.tasks})
    return levels[-1][1] and end == levels[-2] and any(soft for _, soft in levels[:-1])


def _may_differ(problem: Demands, end: TaskLevel) -> bool:
    """Whether tasks of later levels can change what the levels up to `end` reach.

    Hard ones are met before soft ones are lowered, and angles that are named do not turn on beyond
    their limits.
    """
    later = [t for t in problem.tasks if get_task_level(t) > end]
    soft = any(t.weight is not None and get_task_level(t) <= end for t in problem.tasks)
    if soft and any(t.weight is None for t in later):
        return True
    named = any(t.list_coordinates() for t in later)
    return named and bool(np.any(_select_levels(problem, end).packed.wide & ~problem.packed.wide))


def _select_levels(problem: Demands, end: TaskLevel) -> Demands:
    """Return the problem with the levels up to `end`, without a preference."""
    levels = tuple([get_task_level(t) for t in problem.tasks])
    requested = _select_levels, levels, end
    chosen, packed = problem.packed.stages.get(requested) or ((), None)
    if packed is None:
        chosen = tuple(i for i, level in enumerate(levels) if level <= end)
        packed = pack_tasks(
            problem.system, tuple(problem.tasks[i] for i in chosen), problem.packed.turns
        )
        store_answer(problem.packed.stages, requested, (chosen, packed), KEPT)
    tasks = tuple([problem.tasks[i] for i in chosen])
    goals = tuple([problem.goals[i] for i in chosen])
    pins = packed.pack_pins(goals, problem.lead if find_leading_shape(goals) else ())
    use = (True,) * len(tasks)
    return replace(
        problem,
        tasks=tasks,
        packed=packed,
        goals=goals,
        pins=pins,
        use=use,
        mode=S.NOTHING,
        aim=None,
        callback=None,
    )


def is_lower(values: Array, than: Array) -> np.ndarray:
    """Whether the first entry in which two rows (N, levels) differ is the lower one."""
    far = np.abs(values - than) > np.maximum(GAIN * np.maximum(values, than), LITTLE)
    first = far.argmax(axis=1)[:, None]
    return far.any(axis=1) & (np.take_along_axis(values - than, first, 1)[:, 0] < 0.0)


def compute_level_values(problem: Demands, q: Array, rows: np.ndarray) -> Array:
    """Compute the errors (N, levels) of the levels, as the solver weighs them.

    A soft level counts its weighted square, a hard one the largest square by its tolerance where
    that is above 1.
    """
    loops = problem.packed.loops
    m = len(problem.packed.rows)
    stages, strengths, *_ = problem.levels
    pins = problem.pins[rows] if len(problem.pins) > 1 else problem.pins
    g = np.empty((len(q), m))
    none = np.empty((0, m, 0))
    ties = len(loops.ties)
    closure_batch.evaluate_equations(
        loops.ints,
        loops.floats,
        loops.plan,
        loops.weights,
        pins,
        np.ascontiguousarray(q),
        False,
        g,
        none,
    )
    out = np.zeros((len(q), int(stages[:ties].max()) + 1))
    at = 0
    g -= np.clip(g, *loops.bounds)
    for k, (tie, lengths) in enumerate(zip(loops.ties, loops.lengths, strict=True)):
        count = len(tie.row_names)
        stage = stages[k]
        error = g[:, at : at + count]
        at += count
        if stage < 1:
            continue
        if stages[ties + k]:
            linear, angular = (
                np.sum(x * x, axis=1) for x in (error[:, :lengths], error[:, lengths:])
            )
            worst = np.maximum(linear / strengths[k, 1] ** 2, angular / strengths[k, 2] ** 2)
            out[:, stage] = np.maximum(out[:, stage], np.where(worst > 1.0 + GAIN, worst, 0.0))
        else:
            out[:, stage] += strengths[k, 0] * np.sum(error * error, axis=1)
    return out[:, 1:]


# ---- `ik` for several tasks

TOLERANCE = 1e-6
"""Largest error in metres and radians of a hard task that has no tolerance of its own; see
`make_tolerance`."""
SLACK = 1.0 + 1e-6
"""By which part of a tolerance the check by the forward model may differ from the solver's own:
rounding."""
PREFERRED = ("nearest", "mid", "manipulability")
"""What can be preferred by name, besides a function of q."""
SINGLE = 30.0
"""Seconds that the answer for one problem may take, unless the caller says otherwise."""
USUAL = Usual("ik", starts=None, iterations=STEPS, time_limit=SINGLE, rng=0, threads=None)
BATCH = Usual("ik", starts=None, iterations=STEPS, time_limit=None, rng=0, threads=None)


def reach_tasks(problem: Problem) -> Reached:
    """Find a configuration that satisfies several tasks at once; see `System.ik`.

    Hard tasks are solved first. Soft tasks alone are minimised from up to five starts, and the
    smallest error counts. The default number of starts is 60, and then as many as the problem
    deserves: none where a proof shows that there is no solution; 30 times the square of the number
    of limited coordinates that the tasks move (300 to 15 000) where a solution without limits was
    found; else a tenth of that number. A lower level takes four times as many steps as the
    iterations of one start. A success is verified by the forward model: hard tasks, limits and
    loops.

    Sources: Levenberg (1944) and Sugihara (2011) for damped least squares with an active set of
    limits; Siciliano and Slotine (1991) for lower levels in the null space of higher ones.
    """
    system = problem.system
    prefer = problem.prefer
    spend = BATCH.complete_budget(problem.budget)
    if not (
        prefer is None or callable(prefer) or (isinstance(prefer, str) and prefer in PREFERRED)
    ):
        raise InputError(
            f"prefer is {format_value(prefer)}; it must be {', '.join(map(repr, PREFERRED))} or a "
            "function of q"
        )
    starts = spend.starts
    threads = spend.threads
    turns = prefer is None or prefer == "nearest"
    time = TimeLimit(USUAL.complete_budget(problem.budget).time_limit)
    find_nearest_exact_in_time(USUAL, time, system)
    demands, base = make_demands(
        system, problem.wanted, problem.start, problem.tolerance, starts, spend.rng, turns
    )
    search = Demands.run_search if starts is not None else search_by_effort
    limit = spend.time_limit if demands.lead else time.limit
    if spend.iterations != STEPS or limit is not None:
        end = math.inf if limit is None else time.end
        demands = replace(
            demands, iterations=read_step_count(spend.iterations), time_limit=limit, end=end
        )
    # it depends on the goal, of which each row has its own
    if prefer == "manipulability" and demands.lead:
        rows = [
            _add_preference(demands.select_row(i), prefer, base)
            for i in range(math.prod(demands.lead))
        ]
        each = [
            solve_levels(row, base[i : i + 1] if len(base) > 1 else base, search)
            for i, row in enumerate(rows)
        ]
        q, info = (
            np.concatenate([x[k] for x in each] or [np.empty((0, n))])
            for k, n in ((0, system.nq), (1, 3))
        )
    else:
        demands = demands if prefer is None else _add_preference(demands, prefer, base)
        unasked = problem.budget is None or problem.budget.time_limit is None
        if unasked and starts is None and not demands.lead and has_function_tasks(demands):
            demands, (q, info) = search_with_call_limit(
                demands, lambda part: solve_levels(part, base, search, threads), base
            )
        else:
            q, info = solve_levels(demands, base, search, threads)
    answer = make_checked_answer(demands, q, info)
    if not demands.lead and answer.code == Status.BAD_INPUT:
        for each, goals in zip(demands.tasks, demands.goals, strict=True):
            refuse_goal(goals, each.label)
        refuse_large_numbers(system, base, "start")
        raise InputError("the goals and the start lead to numbers that are not finite")
    return answer


def make_demands(
    system: Model,
    wanted: Constraint | Sequence[Constraint],
    start: Any = None,
    tolerance: Any = None,
    starts: int | None = STARTS,
    rng: Any = 0,
    turns: bool = False,
) -> tuple[Demands, Array]:
    """Check and pack the tasks of a problem, and make its first starts (N or 1, nq).

    `starts` None are as many as it deserves.
    """
    tasks = make_distinct_tasks(wanted, system)
    goals = tuple(t.goal for t in tasks)
    base = _choose_home(system) if start is None else read_start(system, start)
    lead = own = find_leading_shape(goals)
    if base.ndim > 1:
        try:
            lead = np.broadcast_shapes(lead, base.shape[:-1])
        except ValueError:
            raise InputError(
                f"start has shape {base.shape}, the goals have the leading shape {lead}"
            ) from None
        base = np.broadcast_to(base, (*lead, system.nq)).reshape(math.prod(lead), system.nq)
    packed = pack_tasks(system, tasks, turns)
    pins = packed.pack_pins(goals, lead if own else ())
    use = (True,) * len(tasks)
    most = choose_start_count(system, packed) if starts is None else read_start_count(starts)
    problem = Demands(
        system,
        tasks,
        packed,
        goals,
        pins,
        lead,
        make_tolerance(TOLERANCE, system.unit) if tolerance is None else read_tolerances(tolerance),
        most,
        draw_seed(rng),
        use,
        loose=start is None,
    )
    starts_at = (
        move_bases_to_target(problem, base)
        if start is None
        else base.reshape(math.prod(base.shape[:-1]), system.nq)
    )
    return problem, np.ascontiguousarray(starts_at)


@keep_answers
def _choose_home(system: Model) -> Array:
    """Choose the configuration where a search starts by default."""
    return find_home(system)


def make_distinct_tasks(wanted: Any, system: Model) -> tuple[Task, ...]:
    """Make checked tasks with different labels."""
    single = isinstance(wanted, Constraint)
    given: tuple[Any, ...] = (wanted,) if single else tuple(wanted) if is_sequence(wanted) else ()
    if not given or not all([isinstance(t, Constraint) for t in given]):
        what = "an empty list" if is_sequence(wanted) and not wanted else format_value(wanted)
        raise InputError(
            "without a frame the target must be a task of kempe.tasks or a list of them; it is "
            f"{what}; a pose or a position needs the name of a frame: ik(target, "
            f"{system.frame_names[-1]!r})"
        )
    out: dict[str, Task] = {}
    for constraint in given:
        if not isinstance(constraint.name, str):
            raise InputError(f"name of a task is {constraint.name!r}; it must be text")
        label = constraint.label
        count = 1
        while label in out:
            count += 1
            label = f"{constraint.label} ({count})"
        out[label] = _find_task(system, constraint, label)
    return tuple(out.values())


def _find_task(system: Model, constraint: Constraint, label: str) -> Task:
    """Find the checked task of a constraint: the last one of its label, where nothing changed, or
    one with its structure, where only the goal did.
    """
    tasks: dict[str, tuple[Constraint, Content, Task]] = system._kept.setdefault(_find_task, {})
    content = freeze_fields(constraint)
    kept = tasks.get(label)
    task = None
    if kept is not None:
        old, before, task = kept
        # the task reads the arrays of the constraint that it was made of
        if content == before and (old is constraint or freeze_fields(old) == before):
            return task
        same = content.kind is before.kind and content.rest == before.rest
        task = task.copy_with_goal(constraint) if same and label == constraint.label else None
    task = task or _make_task(system, constraint, label)
    if content.comparable and task.lasting:
        store_answer(tasks, label, (constraint, content, task))
    return task


def _make_task(system: Model, constraint: Constraint, label: str) -> Task:
    """Make the task of a constraint under a label. Errors: `InputError` for what only `ik` reads."""
    if not is_whole(constraint.priority):
        raise InputError(
            f"priority of {constraint.label} is {constraint.priority!r}; it must be a whole number"
        )
    weight: Any = constraint.weight
    number: bool = isinstance(weight, (int, float, np.integer, np.floating)) and not isinstance(
        weight, bool
    )
    if weight is not None and not (number and 0.0 < weight < math.inf):
        raise InputError(
            f"weight of {constraint.label} is {weight!r}; it must be a positive number, or None"
        )
    given = constraint.tolerance
    if given is not None:
        allowed = read_tolerances(given)
        if given.__class__ not in (int, float):
            constraint = replace(constraint, tolerance=allowed)
    if label != constraint.label:
        constraint = replace(constraint, name=label)
    return Task(system, constraint)


def _add_preference(problem: Demands, prefer: Any, base: Array) -> Demands:
    """Add what `prefer` minimises to the problem as its last level."""
    if prefer == "nearest":
        return replace(
            problem, mode=S.AHEAD, aim=_choose_home(problem.system)[None] if problem.loose else base
        )
    if prefer == "mid":
        return replace(problem, mode=S.AHEAD, aim=compute_mid_configuration(problem.system)[None])

    callback = make_objective(problem, prefer)
    return replace(problem, mode=callback.address, callback=callback)


def make_checked_answer(problem: Demands, q: Array, info: np.ndarray) -> Reached:
    """Make the answer; the forward model, limits and loops check each configuration."""
    system = problem.system
    lead = problem.lead
    packed = problem.packed
    status = info[:, 0]
    bad = status == S.BAD_INPUT
    some_bad = bad.any()
    sound = (np.where(bad[:, None], system.neutral, q) if some_bad else q).reshape(*lead, system.nq)
    hard, allowed = problem.levels[2:]
    every = np.empty((len(problem.tasks), *lead, 2))
    for error, task, goal in zip(every, problem.tasks, problem.goals, strict=True):
        error[..., 0], error[..., 1] = task.measure_error(sound, goal)
    allowed = allowed.reshape(-1, *[1] * len(lead), 2)
    of_hard = every if len(hard) == len(every) else every[hard]
    good = (of_hard <= allowed * SLACK).all(axis=(0, -1))
    worst = of_hard.max(axis=0, initial=0.0)
    if problem.limits:
        at, low, high = packed.limits
        x = sound[..., at]
        good &= ((x >= low) & (x <= high)).all(axis=-1)
    if packed.closed:
        from kempe.equations.closure_rows import evaluate_constraints

        good &= (
            np.linalg.norm(evaluate_constraints(packed.closing, sound, False, True)[0], axis=-1)
            <= 10.0 * CLOSED
        )
    if packed.one_sided.declared and problem.one_sided:
        good &= ~packed.one_sided.compute_excess(sound, declared=True).any(axis=-1)
    late = status >= S.LATE
    code = np.zeros(len(status), dtype=np.int64)  # S.SOLVED: np.full takes ten times as long
    if some_bad or not good.all():
        code = np.where(
            good.ravel(), Status.SOLVED, np.where(late, Status.OUT_OF_TIME, Status.NOT_FOUND)
        )
        code[bad] = Status.BAD_INPUT
        if problem.limits and np.any(code == Status.NOT_FOUND):
            proofs = find_failure_proofs(problem)
            code = np.where((code == Status.NOT_FOUND) & (proofs > 0), proofs, code)
    columns = (code == S.SOLVED, code, worst[..., 0], worst[..., 1], info[:, 1], info[:, 2], late)
    fields = [x.reshape(lead) if lead else x.item() for x in columns]
    errors = {t.label: e for t, e in zip(problem.tasks, every, strict=True)}
    success, code, *fields, cut_off = fields
    q = q.reshape(*lead, system.nq)
    code = code if lead else MEMBERS[int(code)]
    return Reached(q, success, code, *fields, problem=problem, errors=errors, late=cut_off)
