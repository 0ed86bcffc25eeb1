"""The solvers of `ik_all`, which find every configuration in which a frame reaches a target.

A chain is solved by its plan, with spare joints held at several values. For a frame that moves with
loops, the solutions are assembly modes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers import wording
from kempe.answers.problem import Problem, Solver, accept_all_problems
from kempe.answers.targets import Z_AXIS, explain_refused_target
from kempe.arrays import FARTHEST
from kempe.budget import Budget, Usual
from kempe.constraints.clearances import Apart
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.errors import InputError, UnsupportedError
from kempe.forward.fk import fk
from kempe.inverse.all_answer import Solutions, pack_rows
from kempe.inverse.chain.serial_chain import (
    has_shared_coordinates,
    is_moved_by_loop,
    move_inside_limits,
)
from kempe.inverse.closed_forms.chain_lines import find_chain_lines
from kempe.inverse.closed_forms.plan import METHODS, SEARCH, ChainPlan, Method, find_plan
from kempe.inverse.closed_forms.problem import (
    ChainProblem,
    Watch,
    read_held_joints,
    read_near_configurations,
    read_solution_tolerance,
)
from kempe.inverse.closed_forms.solve import (
    TOLERANCE,
    estimate_attainable_error,
    solve_locked_chain,
)
from kempe.inverse.spare_joints import search_spare_joints
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.compiled import make_allocator
from kempe.kernels.forward.table_layout import SLIDE
from kempe.model.configurations import find_winding_angles
from kempe.model.model import bind_call
from kempe.poses import correct_rotations
from kempe.spatial import Array
from kempe.units import from_metres, make_tolerance
from kempe.words import join_words

if TYPE_CHECKING:
    from kempe.assemble.modes import Modes
    from kempe.model.model import Model


# ---- solutions that hold one-sided constraints, and that keep clear

PAIRS_SAID = 3
"""Pairs of bodies that a status names as too near."""


def select_obeying_solutions(solutions: Solutions) -> Solutions:
    """Select the solutions that satisfy the one-sided constraints.

    The status says how many do not, and of which constraints.

    Coordinates that the chain does not have are where the solutions have them: near, or neutral.
    Where a constraint tells whole turns of one without limits apart, others of its turns may hold
    it: the answer is then not complete.
    """
    bounds = pack_one_sided_rows(solutions.system)
    if not bounds.declared:
        return solutions
    used = solutions._used_rows
    q = np.where(used[..., None], solutions._fill_configurations(), solutions.system.neutral)
    beyond = used[..., None] & (bounds.compute_excess(q, declared=True) > 0.0)
    bad = np.any(beyond, axis=-1)
    if not bad.any():
        return solutions
    rows = solutions._rows.copy()
    rows[bad, -A.INFO + A.CODE] = A.UNUSED
    rows = pack_rows(rows) if solutions.single else rows
    texts = np.empty(len(beyond), dtype=object)
    texts[:] = [bounds.describe_omitted_configurations(each) for each in beyond]
    out = solutions._replace_rows(rows, solutions, texts)
    if names := _list_wound_coordinates(solutions):
        dropped = bad.any(axis=-1)
        counts = solutions._counts.copy()
        counts[dropped, 1] += 1
        texts[dropped] += (
            f", at other whole turns of {join_words(list(map(repr, names)))} they may not"
        )
        out._counts = counts
    return out


def select_clear_solutions(solutions: Solutions, clearances: Sequence[Apart]) -> Solutions:
    """Select the solutions that keep clearances; the status says how many do not, and which pairs."""
    from kempe.geometry.clearance import watch_clearances  # only here: seldom asked for

    system = solutions.system
    watch = watch_clearances(system, clearances)
    names = watch.solids.names
    used = solutions._used_rows
    q = np.where(used[..., None], solutions._fill_configurations(), system.neutral)
    bad = np.zeros(used.shape, dtype=bool)
    texts = np.full(len(used), "", dtype=object)
    if solutions._left_out is not None:
        texts[:] = solutions._left_out
    for i in range(len(used)):
        near: dict[str, None] = {}
        for k in np.flatnonzero(used[i]).tolist():
            X = fk(system, q[i, k], names)
            worst = watch.find_worst(watch.list_gaps(X, 0.0))
            if worst is not None:
                bad[i, k] = True
                near[wording.describe_closest(worst[:2], *worst[2:])] = None
        if near:
            count = int(bad[i].sum())
            said = join_words(list(near)[:PAIRS_SAID]) + ", ..." * (len(near) > PAIRS_SAID)
            left = "1 is left out that comes" if count == 1 else f"{count} are left out that come"
            texts[i] += f"; {left} too near: {said}"
    if not bad.any():
        return solutions
    rows = solutions._rows.copy()
    rows[bad, -A.INFO + A.CODE] = A.UNUSED
    rows = pack_rows(rows) if solutions.single else rows
    whole = solutions if solutions._whole is None else solutions._whole
    out = solutions._replace_rows(rows, whole, texts)
    out._near = (bad & (solutions._code % 2 == 1)).any(axis=1)
    return out


def _list_wound_coordinates(solutions: Solutions) -> list[str]:
    """List unlimited coordinates of the chain whose whole turns a constraint distinguishes."""
    names = solutions.system.structure.velocity_names
    endless = find_winding_angles(solutions.system)
    return [names[int(v)] for v in solutions.plan.lines.v_index if endless[v]]


# ---- frames that move with loops, or with joints that follow others

# Their solutions are the assembly modes with the frame known.

LOOPS = Usual("ik_all", threads=None, time_limit=30.0)
"""What is spent on one target."""

KNOWN_TASKS = ("pose", "position")
"""What of a target can be known of a frame."""


def find_all_modes(problem: Problem, moving: str = "loops") -> Modes:
    """Find the configurations that loops allow, those inside the limits first.

    The frame moves with what `moving` says.

    Errors: `UnsupportedError`.
    """
    system = problem.system
    frame = problem.frame
    (task, _) = problem.task
    targets = problem.targets
    if task not in KNOWN_TASKS or problem.lead != ():
        what = f"task {task!r}" if task not in KNOWN_TASKS else "more than one target"
        raise UnsupportedError(
            f"frame {frame!r} moves with {moving}: `ik_all` takes one pose or position there, not "
            f"{what}; `ik` can"
        )
    X = targets[0] if task == "pose" else targets[0, : system.dim, 3]
    limit = LOOPS.complete_budget(problem.budget).time_limit
    spend = Budget(time_limit=math.inf if limit is None else limit)
    known = {**problem.known, str(frame): X}
    from kempe.assemble.modes import assembly_modes  # only here: frames of chains never need it

    found = assembly_modes(system, known, problem.start, limits=bool(problem.limits), budget=spend)
    order = np.argsort(~found.inside, kind="stable")
    return replace(
        found,
        q=found.q[order],
        branches=tuple(found.branches[int(i)] for i in order),
        multiplicity=found.multiplicity[order],
        freedoms=found.freedoms[order],
        inside=found.inside[order],
    )


# ---- answers for loops and for chains

SINGLE = 30.0
"""Seconds that the answer for one target may take, unless the caller says otherwise."""
USUAL = Usual("ik_all", threads=None, time_limit=SINGLE)
BATCH = Usual("ik_all", threads=None, time_limit=None)


def _solve_loops(problem: Problem) -> Modes:
    """Solve `ik_all` for a frame that moves with loops, or with coupled joints."""
    if problem.limits == "turns":
        raise InputError(
            f"frame {problem.frame!r} moves with {_describe_movers(problem)}: limits='turns' is for chains"
        )

    return find_all_modes(problem, _describe_movers(problem))


def _describe_movers(problem: Problem) -> str:
    """Describe what moves a frame that has no chain of independent joints."""
    return (
        "loops"
        if is_moved_by_loop(problem.system, str(problem.frame))
        else "joints that follow others"
    )


def solve_by_chain(problem: Problem) -> Solutions:
    """Solve `ik_all` for a frame that its own chain moves."""
    system = problem.system
    name = str(problem.frame)
    (task, direction) = problem.task
    targets = problem.targets
    single = problem.lead == ()
    lines = find_chain_lines(system, name, direction)
    spend = (USUAL if single else BATCH).complete_budget(problem.budget)
    values = read_held_joints(name, lines.names, problem.known)
    threads = spend.threads
    watch = Watch(problem.options["time"], len(targets))
    plan = _plan_chain(problem, values)
    linear, angular = (
        make_tolerance(TOLERANCE, system.unit)
        if problem.tolerance is None
        else (read_solution_tolerance(problem.tolerance),) * 2
    )
    sure = max(linear, estimate_attainable_error(targets, lines))
    packed_problem = ChainProblem(
        system,
        name,
        task,
        direction,
        targets,
        None if single else problem.lead,
        sure,
        angular,
        watch,
    )
    turned_particle = bool(system.structure.table.at[name][2])
    plain = single and not pack_one_sided_rows(system).declared
    usual = task == "pose" and system.dim == 3 and not turned_particle
    if plain and usual and plan.locked == plan.fixed and BoundIkAll.is_for(plan):
        held = tuple(values)
        key = (name, *held) if held else name
        bind_call(system, "ik_all", key, lambda: BoundIkAll(system, name, held).__call__)
    near = read_near_configurations(system, problem.start, packed_problem.lead)
    answer = solve_chain_problem(packed_problem, plan, near, values, threads)
    if (
        not single
        and (answer._counts[:, 0] < 0).any()
        and (mended := correct_rotations(targets, "target")) is not targets
    ):
        answer = solve_chain_problem(
            replace(packed_problem, targets=mended), plan, near, values, threads
        )
    if single and answer._counts[0, 0] < 0:
        raise InputError(explain_refused_target(targets[0]))
    if problem.limits:
        answer = answer.select_solutions(problem.limits == "turns", inside_only=True)
    return select_obeying_solutions(answer)


# ---- the solvers, and how one is chosen


def _explain_no_loops(problem: Problem) -> str | None:
    system = problem.system
    frame = str(problem.frame)
    if is_moved_by_loop(system, frame) or has_shared_coordinates(system, frame):
        return None
    return "the frame does not move with loops, or with joints that follow others"


def _plan_chain(problem: Problem, values: Mapping[str, Any]) -> ChainPlan:
    """Plan the solution of a frame's chain with joints held at `values`."""
    frame = str(problem.frame)
    task, direction = problem.task
    lines = find_chain_lines(problem.system, frame, direction)
    return find_plan(problem.system, frame, lines, task, direction, tuple(values))


def _explain_other_method(problem: Problem, method: Method) -> str | None:
    """Explain why a problem is not for a method; None where it is."""
    lines = find_chain_lines(problem.system, str(problem.frame), problem.task[1])
    names = read_held_joints(str(problem.frame), lines.names, dict.fromkeys(problem.known, 0.0))
    return None if _plan_chain(problem, names).method == method else method.unfit


SOLVERS = (
    Solver(
        "assembly modes",
        "closed configurations with the frame known, see assembly_modes",
        _explain_no_loops,
        _solve_loops,
    ),
    *(
        Solver(
            method.name,
            method.how,
            accept_all_problems
            if method == SEARCH
            else partial(_explain_other_method, method=method),
            solve_by_chain,
        )
        for method in METHODS
    ),
)
"""Who answers for all configurations of a frame."""


# ---- the bound form of plain calls, and the kernels

NUMBERS = (float, int, np.float64)
"""Types of values of held joints that plain calls have."""


class BoundIkAll:
    """`ik_all` of single poses for one frame and held joints, with all look-ups done once."""

    def __init__(self, system: Model, frame: str, held: tuple[str, ...] = ()):
        lines = find_chain_lines(system, frame, Z_AXIS)
        plan = find_plan(system, frame, lines, "pose", Z_AXIS, held)
        self.system = system
        self.frame = frame
        self.held = held
        self.plan = plan
        blocks: Any = plan.method.blocks
        self.kernel: Callable[..., int] = blocks()
        self.base = move_inside_limits(system, system.neutral[None].copy())
        self.near = np.ascontiguousarray(system.neutral[None, lines.q_index])
        self.first = np.array([plan.first]) if plan.first else self.near
        at = [lines.names.index(name) for name in held]
        low, high = lines.limits[:, at].tolist()
        self.places = list(zip(held, at, low, high, strict=True))
        """Name, place, lower and upper limit of each held joint."""
        self.counts = np.zeros((1, 2), dtype=np.int64)
        self.ints = plan.ints
        self.floats = plan.floats
        self.left = np.zeros(1, dtype=np.int64)  # written, never read
        self.new = make_allocator(1, plan.method.slots, len(plan.lines) + A.INFO)

    @staticmethod
    def is_for(plan: ChainPlan) -> bool:
        """Whether kernels alone answer by this plan, unless a target needs a second look."""
        plain = not (plan.lines.span.wide or plan.blurred or (plan.lines.kinds == SLIDE).any())
        return plan.method.blocks is not None and (plain or not plan.fixed)

    def __reduce__(self) -> tuple[Any, ...]:
        return BoundIkAll, (self.system, self.frame, self.held)

    def make_problem(self, target: Array) -> ChainProblem:
        """Make the problem that was solved."""
        linear = from_metres(TOLERANCE, self.system.unit)
        return ChainProblem(self.system, self.frame, "pose", Z_AXIS, target[None], None, linear)

    def __call__(self, target: Array, fixed: Mapping[str, Any] | None = None) -> Solutions | None:
        """Return all solutions for a pose (4, 4); None where it needs the general solver.

        `fixed` are the values of the held joints.
        """
        locked = self.near
        if fixed is not None:
            locked = self.first.copy()
            for name, i, low, high in self.places:
                value = fixed[name]
                if value.__class__ not in NUMBERS or not low <= value <= high:
                    return None
                locked[0, i] = value
        # the answer keeps it
        rows = self.new()
        X = target.copy()
        try:
            used = self.kernel(
                self.ints, self.floats, X[None], self.near, locked, 1, rows, self.left
            )
        except TypeError:  # not float64
            return None
        if used >= 0 or (used == -1 and not np.all(np.abs(X) < FARTHEST)):
            return None
        if fixed is None:
            return Solutions((self, X), self.plan, self.base, rows, self.counts, None, -1 - used)
        return Solutions(
            (self, X), self.plan, self.base, rows, self.counts, None, -1 - used, locked, locked
        )


def solve_chain_problem(
    problem: ChainProblem,
    plan: ChainPlan,
    near: Array | None,
    values: Mapping[str, Array],
    threads: int | None,
) -> Solutions:
    """Solve a chain's problem by kernels; spare joints are held where solutions exist."""
    lines = plan.lines
    system = problem.system
    base = system.neutral[None] if near is None else near
    chain_near = np.ascontiguousarray(base[:, lines.q_index])
    base = move_inside_limits(system, base.copy())
    start = np.array([plan.first]) if near is None and plan.first else chain_near
    first = _compute_locked_coordinates(problem, plan, start, values) if plan.locked else chain_near
    out, counts = solve_locked_chain(problem, plan, chain_near, first, threads)
    decided = plan.locked == plan.fixed and not lines.span.wide
    if problem.lead is None and not decided:
        code = float(out[0, 0, -A.INFO + A.CODE])
        # the first of rows in order is inside the limits
        decided = code >= 0.0 and code % 2.0 == 1.0
    if decided:
        _mark_outside_rows(plan, out)
        return Solutions(
            problem,
            plan,
            base,
            out,
            counts,
            problem.lead,
            locked=first,
            first=first,
            late=_find_late_targets(problem, counts),
        )

    def solve_some_targets(
        some: ChainProblem, near: Array, locked: Array
    ) -> tuple[Array, np.ndarray]:
        # of which there are many for all values
        return solve_locked_chain(some, plan, near, locked, threads, starts=False)

    held_at = search_spare_joints(
        problem, plan, chain_near, first, out, counts, solve_some_targets, threads
    )
    _mark_outside_rows(plan, out)
    return Solutions(
        problem,
        plan,
        base,
        out,
        counts,
        problem.lead,
        locked=held_at.locked,
        first=first,
        tried=held_at.tried,
        late=_find_late_targets(problem, counts),
    )


def _find_late_targets(
    problem: ChainProblem, counts: np.ndarray
) -> tuple[float, np.ndarray] | None:
    """Find the targets (N,) whose work the time limit [s] ended; None if there are none."""
    if problem.watch is None or not problem.watch.late.any():
        return None
    late = problem.watch.late & (counts[:, 0] >= 0)
    counts[late, 1] = 1
    return problem.watch.limit.limit or 0.0, late


def _mark_outside_rows(plan: ChainPlan, rows: Array) -> None:
    """Mark rows (N, K, n + 2) as outside where a joint held by name is beyond its limits."""
    if not plan.fixed:
        return
    at = list(plan.fixed)
    (low, high) = plan.lines.limits
    q = rows[..., at]
    code = rows[..., -A.INFO + A.CODE]
    off = ((q < low[at] - TOLERANCE) | (q > high[at] + TOLERANCE)).any(axis=-1)
    code[off & (code >= 0.0) & (code % 2.0 == 1.0)] -= A.INSIDE_BIT


def _compute_locked_coordinates(
    problem: ChainProblem, plan: ChainPlan, near: Array, values: Mapping[str, Array]
) -> Array:
    """Compute coordinates (1 or N, n) of the chain, of which those of locked joints count."""
    lines = plan.lines
    shapes = [v.shape for v in values.values()]
    batch = any(shapes) or len(near) > 1
    out = np.array(np.broadcast_to(near, (len(problem.targets) if batch else 1, len(lines))))
    low, high = lines.limits
    for i in plan.locked:
        given = values.get(lines.names[i])
        if given is None:
            out[:, i] = out[:, i].clip(low[i], high[i])
            continue
        lead = problem.lead or ()
        try:
            out[:, i] = np.broadcast_to(given, lead).reshape(-1) if given.ndim else given
        except ValueError:
            raise InputError(
                f"{lines.names[i]} is held at values of shape {given.shape}; it must be a number "
                f"or {lead}"
            ) from None
    if problem.lead is None and not np.isfinite(out[:, list(plan.locked)]).all():
        raise InputError("a joint is held at a value that is not finite")
    return np.ascontiguousarray(out)
