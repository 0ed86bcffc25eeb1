"""The inverse geometric model, all of it: every configuration in which a frame reaches a target."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.budget import Budget, Usual, look
from kempe.calls import explained
from kempe.errors import InputError
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.compiled import maker
from kempe.kernels.forward.table_layout import SLIDE
from kempe.kinematics.common.parallel import over_chunks
from kempe.kinematics.one_sided import one_sided_rows
from kempe.model.kept import kept
from kempe.reals import FARTHEST
from kempe.rigid import sound
from kempe.solvers.analytic.answers.solutions import Solutions
from kempe.solvers.analytic.obeying import obeying
from kempe.solvers.analytic.plans.chain_lines import Lines, lines_of
from kempe.solvers.analytic.plans.choice import plan_holding
from kempe.solvers.analytic.plans.plan import ChainPlan, kernel_of, side_by_side_of
from kempe.solvers.analytic.plans.question import Question, Watch, held, held_by, near_of, within
from kempe.solvers.common.clock import TimeLimit, begun_within
from kempe.solvers.common.problem import (
    Choice,
    Problem,
    Solver,
    TaskOf,
    choose,
    chosen_by,
    takes_all,
)
from kempe.solvers.common.serial_chain import inside, of_loops, shared_by
from kempe.solvers.common.targets import (
    Z_AXIS,
    axis_for,
    frame_of,
    given_target,
    in_plane,
    not_a_pose,
    points_along,
    refuse_position,
    targets_of,
    task_and_axis,
    task_of,
)
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System
    from kempe.solvers.modes.modes import Modes

TOLERANCE = 1e-9
"""Largest position error [m] and rotation angle [rad] of a solution."""

EPSILON = float(np.finfo(float).eps)
CHUNK = 256
SERIAL_BELOW = 4096
PIECE = 512
ELIMINATED = 64
"""Targets of a chunk between two looks at the clock: in closed form, and by elimination, which
takes ten times as long. Both are multiples of the targets that are solved side by side."""

SINGLE = 30.0
"""Seconds that the answer for one target may take, unless the caller says otherwise."""
FAR = 300.0
"""Lengths of a chain with slides beyond which these are so long that its equations may say nothing
of the rest."""

NONE = np.zeros(0, dtype=np.int64)
"""No targets."""

LIMITS = (False, True, "turns")
USUAL = Usual("ik_all", threads=None, time_limit=SINGLE)
BATCH = Usual("ik_all", threads=None, time_limit=None)


@explained
def ik_all(
    system: System,
    target: ArrayLike,
    frame: FrameLike,
    start: Any = None,
    *,
    task: str | tuple[str, ArrayLike] | None = None,
    fixed: Mapping[str, Any] | None = None,
    limits: bool | str = False,
    tolerance: float | None = None,
    budget: Budget | None = None,
) -> Solutions | Modes:
    """Every configuration in which `frame` reaches `target`: the inverse geometric model with all
    its solutions.

    `target` is a pose (..., 4, 4) in the ground frame (in planar systems also (..., 3, 3), and,
    with ``task="pose"``, x, y and angle (..., 3)) or a position (..., 3) (in planar systems also
    (..., 2)). `task` says what of it counts: "pose", "position", "orientation", "direction" (of the
    tool's z axis, or of another one in a pair such as ("direction", (1, 0, 0))), "position_axis"
    (both). Joints of redundant chains are held by `fixed`, a dict of numbers, or of arrays of one
    for each target; others that are to spare where `start` has them, and elsewhere for targets that
    have no solution inside the limits there: `Solutions.held` says where. Solutions are sorted:
    inside the limits first, then by nearness to `start` (nq,), which also chooses among turns; with
    `limits` others are dropped, and with ``limits="turns"`` every turn inside the limits is listed.
    Joints that do not move `frame` keep their values in `start`, else the neutral ones, brought
    inside their limits, as in `ik`. What violates one-sided constraints of the system is left out,
    and the status says so.

    Each solution is verified by the forward model to `tolerance` [m, rad] (1e-9, or to rounding,
    far away). What is not reached has no solutions and a `status` that says why;
    ``answer.expect()`` raises `NoSolutionError` for it. Of the `budget` are read: threads, and
    time_limit (30 s for one target, none for a batch). Targets whose work it ended have the
    solutions that are known by then, are not `complete`, and say so (`late`). Errors:
    `UnsupportedError` for chains with quaternions, `InputError`, `UnknownNameError`.
    For one pose or position of a frame that moves with loops, or with joints that follow others (a
    helical joint, a parallel linkage written as a coupling), the answer is that of `assembly_modes`
    with it known.
    Method: see `System.inverse.plan`, and `kempe.kernels.closed_form`, `kempe.kernels.elimination`.
    """
    name = system.structure.frame_name(frame)
    target = given_target(system, target)
    (said, axis) = task_and_axis(task)
    if limits not in LIMITS:
        raise InputError(f"limits is {limits!r}; it must be False, True or 'turns'")
    if system.dim == 2 and points_along(said):
        target, said = in_plane(target, said, axis)
    direction = axis_for(axis, said)
    targets, lead, is_position = targets_of(system, target, said, direction)
    task = task_of(said, is_position, bool(system.structure.table.at[name][2]))
    refuse_position(task, is_position, system.dim)
    if lead == () and not np.all(np.abs(targets) < FARTHEST):
        raise InputError(not_a_pose(targets[0]))
    known = held_by(fixed)
    problem = Problem(
        system,
        "all",
        known,
        start,
        None,
        limits,
        tolerance,
        budget,
        frame=name,
        task=(task, direction),
        targets=targets,
        lead=lead,
    )
    time = TimeLimit((BATCH if lead else USUAL).of(budget).time_limit)
    time.put_in_order()  # a plan is made as a whole, or not at all
    with begun_within(USUAL, time):
        solver, choice = chosen(system, name, problem.task, tuple(known))
    problem = problem._replace(options={"time": time})
    return chosen_by(solver.run(problem), choice)


def _of_loops(problem: Problem) -> Modes:
    """The answer for a frame that moves with loops, or with joints that follow others."""
    if problem.limits == "turns":
        raise InputError(
            f"frame {problem.frame!r} moves with {_moving(problem)}: limits='turns' is for chains"
        )
    from kempe.solvers.analytic.through_loops import all_modes

    return all_modes(problem, _moving(problem))


def _moving(problem: Problem) -> str:
    """What a frame moves with that has no chain of independent joints."""
    return "loops" if of_loops(problem.system, str(problem.frame)) else "joints that follow others"


def by_chain(problem: Problem) -> Solutions:
    """The answer for a frame that its own chain moves."""
    system = problem.system
    name = str(problem.frame)
    (task, direction) = problem.task
    targets = problem.targets
    single = problem.lead == ()
    lines = chain_lines(system, name, direction)
    spend = (USUAL if single else BATCH).of(problem.budget)
    values = held(name, lines.names, problem.known)
    threads = spend.threads
    watch = Watch(problem.options["time"], len(targets))
    plan = plan_for(system, name, lines, task, direction, tuple(values))
    wanted = TOLERANCE if problem.tolerance is None else within(problem.tolerance)
    sure = max(wanted, attainable(targets, lines))
    question = Question(
        system,
        name,
        task,
        direction,
        targets,
        None if single else problem.lead,
        sure,
        wanted,
        watch,
    )
    plain = not one_sided_rows(system).declared
    if (
        plain
        and single
        and system.dim == 3
        and task == "pose"
        and plan.side_by_side
        and (name,) not in system._queries
    ):
        bind(system, name)
    near = near_of(system, problem.start, question.lead)
    answer = solve(question, plan, near, values, threads)
    if (
        not single
        and (answer._counts[:, 0] < 0).any()
        and (mended := sound(targets, "target")) is not targets
    ):
        answer = solve(replace(question, targets=mended), plan, near, values, threads)
    if single and answer._counts[0, 0] < 0:
        raise InputError(not_a_pose(targets[0]))
    if problem.limits:
        answer = answer.chosen(problem.limits == "turns", inside_only=True)
    return obeying(answer)


# ---- the solvers


def _no_loops(system: System, frame: str, task: TaskOf, fixed: tuple[str, ...]) -> str | None:
    if of_loops(system, frame) or shared_by(system, frame):
        return None
    return "the frame does not move with loops, or with joints that follow others"


def _needs(method: str, side_by_side: bool, why: str) -> Callable[..., str | None]:
    """A refusal of chains whose plan is another one."""

    def refuses(system: System, frame: str, task: TaskOf, fixed: tuple[str, ...]) -> str | None:
        lines = chain_lines(system, frame, task[1])
        values = held(frame, lines.names, dict.fromkeys(fixed, 0.0))
        plan = plan_for(system, frame, lines, *task, tuple(values))
        return None if plan.method == method and plan.side_by_side >= side_by_side else why

    return refuses


SOLVERS = (
    Solver(
        "assembly modes",
        "closed configurations with the frame known, see assembly_modes",
        _no_loops,
        _of_loops,
    ),
    Solver(
        "closed form, side by side",
        "subproblems of six turns, many targets at once; what is close is done again",
        _needs(
            "closed",
            True,
            "it is for six joints that turn, of which one equation in one unknown is left",
        ),
        by_chain,
    ),
    Solver(
        "closed form",
        "subproblems of the lines of the chain, and of lines that stand in for what the task "
        "leaves",
        _needs(
            "closed",
            False,
            "no three neighbouring axes of the chain meet or are parallel, or as it takes",
        ),
        by_chain,
    ),
    Solver(
        "elimination",
        "sixteen roots of six lines in general",
        _needs(
            "elimination",
            False,
            "its lines are not general enough to find random configurations again",
        ),
        by_chain,
    ),
    Solver(
        "search", "many starts: what is found, with no claim that it is all", takes_all, by_chain
    ),
)
"""Who answers for all configurations of a frame."""


@kept
def chosen(
    system: System, frame: str, task: TaskOf, fixed: tuple[str, ...]
) -> tuple[Solver, Choice]:
    """Who answers for a frame, a task, and joints that are held."""
    return choose(SOLVERS, system, frame, task, fixed)


class BoundIkAll:
    """`ik_all` of single poses for one frame, with all that can be looked up looked up: the way of
    plain calls.
    """

    def __init__(self, system: System, frame: str, plan: ChainPlan, kernel: Callable[..., int]):
        self.system = system
        self.frame = frame
        self.plan = plan
        self.kernel = kernel
        self.base = inside(system, system.neutral[None].copy())
        self.near = np.ascontiguousarray(system.neutral[None, plan.lines.q_index])
        self.counts = np.zeros((1, 2), dtype=np.int64)
        self.ints = plan.ints
        self.floats = plan.floats
        self.left = np.zeros(1, dtype=np.int64)  # written, never read
        self.new = maker(1, plan.slots, len(plan.lines) + A.INFO)

    def __reduce__(self) -> tuple[Any, ...]:
        return bind, (self.system, self.frame)

    def question(self, target: Array) -> Question:
        """The problem that was solved."""
        return Question(self.system, self.frame, "pose", Z_AXIS, target[None], None, TOLERANCE)

    def __call__(self, target: Array) -> Solutions | None:
        """All solutions for a pose (4, 4), None where the target needs the general solver."""
        # the answer keeps it
        rows = self.new()
        X = target.copy()
        try:
            used = self.kernel(
                self.ints, self.floats, X[None], self.near, self.near, 1, rows, self.left
            )
        except TypeError:  # not float64
            return None
        if used >= 0 or (used == -1 and not np.all(np.abs(X) < FARTHEST)):
            return None
        return Solutions((self, X), self.plan, self.base, rows, self.counts, None, -1 - used)


def bind(system: System, frame: str) -> BoundIkAll | None:
    """The bound form for poses of a frame, None where there is none; made once."""
    lines = chain_lines(system, frame, Z_AXIS)
    plan = plan_for(system, frame, lines, "pose", Z_AXIS, ())
    kernel = None if plan.locked or system.structure.table.at[frame][2] else side_by_side_of(plan)
    bound = None if kernel is None else BoundIkAll(system, frame, plan, kernel)
    system._queries[(frame,)] = None if bound is None else bound.__call__
    return bound


def attainable(targets: Array, lines: Lines) -> float:
    """The error [m] that rounding leaves, given the size of targets and chain: far away it is above
    the tolerance.
    """
    if len(targets) == 1:  # in Python: for three numbers arrays cost more
        far = max([abs(x) for x in targets[0, :3, 3].tolist() if math.isfinite(x)], default=0.0)
    else:
        size = np.abs(targets[:, :3, 3])
        far = float(size[np.isfinite(size)].max(initial=0.0))
    return (
        16.0
        * EPSILON
        * (far + lines.length * (1.0 + max(abs(x) for x in lines.tip[:3, 3].tolist())))
    )


@kept
def chain_lines(system: System, frame: str, axis: tuple[float, float, float]) -> Lines:
    """The lines of the frame's chain, its tip turned so that its z axis is the tool's `axis`."""
    lines = lines_of(system, frame)
    if axis == Z_AXIS:
        return lines
    tip = lines.tip.copy()
    tip[:3, :3] = tip[:3, :3] @ frame_of(np.array(axis))
    return replace(lines, tip=tip)


def plan_for(
    system: System,
    frame: str,
    lines: Lines,
    task: str,
    axis: tuple[float, float, float],
    fixed: tuple[str, ...],
) -> ChainPlan:
    """The plan for a task with these joints held; of redundant chains more are held, by choice."""
    return _plan(system, frame, task, axis, tuple(sorted(lines.names.index(n) for n in fixed)))


@kept
def _plan(
    system: System, frame: str, task: str, axis: tuple[float, float, float], at: tuple[int, ...]
) -> ChainPlan:
    planar = system.dim == 2
    return replace(
        plan_holding(chain_lines(system, frame, axis), task, at, planar), fixed=at, planar=planar
    )


def solve(
    question: Question,
    plan: ChainPlan,
    near: Array | None,
    values: Mapping[str, Array],
    threads: int | None,
) -> Solutions:
    """The answer of the kernels; joints that are held by choice where there are solutions."""
    lines = plan.lines
    system = question.system
    base = system.neutral[None] if near is None else near
    chain_near = np.ascontiguousarray(base[:, lines.q_index])
    base = inside(system, base.copy())
    start = np.array([plan.first]) if near is None and plan.first else chain_near
    first = _locked(question, plan, start, values) if plan.locked else chain_near
    out, counts = solve_held(question, plan, chain_near, first, threads)
    decided = plan.locked == plan.fixed and not lines.span.wide
    if question.lead is None and not decided:
        code = float(out[0, 0, -A.INFO + A.CODE])
        decided = (
            code >= 0.0 and code % 2.0 == 1.0
        )  # the first of rows in order is inside the limits
    if decided:
        _outside(plan, out)
        return Solutions(
            question,
            plan,
            base,
            out,
            counts,
            question.lead,
            locked=first,
            first=first,
            late=_late(question, counts),
        )
    from kempe.solvers.analytic.further import look_further

    def at(some: Question, near: Array, locked: Array) -> tuple[Array, np.ndarray]:
        return solve_held(
            some, plan, near, locked, threads, starts=False
        )  # of which there are many for all values

    held_at = look_further(question, plan, chain_near, first, out, counts, at, threads)
    _outside(plan, out)
    return Solutions(
        question,
        plan,
        base,
        out,
        counts,
        question.lead,
        locked=held_at.locked,
        first=first,
        tried=held_at.tried,
        late=_late(question, counts),
    )


def _late(question: Question, counts: np.ndarray) -> tuple[float, np.ndarray] | None:
    """The time limit [s] and the targets (N,) whose work it ended, which are in doubt; None where
    it ended none.
    """
    if question.watch is None or not question.watch.late.any():
        return None
    late = question.watch.late & (counts[:, 0] >= 0)
    counts[late, 1] = 1
    return question.watch.limit.limit or 0.0, late


def _outside(plan: ChainPlan, rows: Array) -> None:
    """Mark the rows (N, K, n + 2) as outside the limits where a joint held by name is beyond its
    own.
    """
    if not plan.fixed:
        return
    at = list(plan.fixed)
    (low, high) = plan.lines.limits
    q = rows[..., at]
    code = rows[..., -A.INFO + A.CODE]
    off = ((q < low[at] - TOLERANCE) | (q > high[at] + TOLERANCE)).any(axis=-1)
    code[off & (code >= 0.0) & (code % 2.0 == 1.0)] -= A.INSIDE_BIT


def solve_held(
    question: Question,
    plan: ChainPlan,
    chain_near: Array,
    locked: Array,
    threads: int | None,
    starts: bool = True,
) -> tuple[Array, np.ndarray]:
    """Rows (N, K, n + 2) and counts (N, 2) of the kernels with joints locked at their values in
    `locked` (1 or N, n).

    chain_near: (1 or N, n) coordinates of the chain, near which angles are given. With `starts` a
    search looks for solutions where the equations say nothing.
    """
    targets = question.targets
    lines = plan.lines
    n = len(targets)
    single = question.lead is None
    if question.axis != Z_AXIS:
        targets = targets.copy()
        targets[:, :3, :3] = targets[:, :3, :3] @ frame_of(np.array(question.axis))
    out = np.empty((n, plan.slots, len(lines) + A.INFO))
    counts = np.zeros((n, 2), dtype=np.int64)
    if plan.method == "search":
        from kempe.solvers.analytic.start_search import search

        search(question, plan, chain_near, locked, out, counts, np.arange(n))
        return out, counts
    side_by_side = side_by_side_of(plan)
    piece = (
        ELIMINATED if plan.method == "elimination" else PIECE if side_by_side is None else max(n, 1)
    )
    if not plan.locked:
        locked = locked[:1]

    def pieces(i: int, j: int) -> int:
        for k in range(i, j, piece):
            look()
            last = min(k + piece, j)
            if question.stopped(slice(k, last)):
                out[k:last, :, -A.INFO + A.CODE] = A.UNUSED
                counts[k:last, 1] = 1
            else:
                work(k, last)
        return 0

    def work(i: int, j: int) -> int:
        some = chain_near[i:j] if len(chain_near) > 1 else chain_near
        held_at = locked[i:j] if len(locked) > 1 else locked
        which = np.arange(j - i)
        if side_by_side:
            padded = (
                np.resize(some, (A.LANES, len(lines)))
                if 1 < len(some) < A.LANES and len(locked) == 1
                else some
            )
            left = side_by_side(
                plan.ints, plan.floats, targets[i:j], padded, held_at, int(single), out[i:j], which
            )
            if left <= 0:
                return 0
            which = which[:left].copy()
        kernel_of(plan)(
            plan.ints,
            plan.floats,
            targets[i:j],
            some,
            held_at,
            question.tolerance,
            question.angular,
            int(single),
            which,
            out[i:j],
            counts[i:j],
        )
        return 0

    over_chunks(pieces, n, CHUNK, threads, SERIAL_BELOW)
    maybe_none = n != 1 or counts.item(0) == 0
    if (lines.kinds == SLIDE).any():
        counts[np.linalg.norm(targets[:, :3, 3] - lines.origin, axis=1) > FAR * lines.length, 1] = 1
    none = np.flatnonzero(counts[:, 0] == 0) if maybe_none and plan.rests else NONE
    if len(none) and (other := plan.other) is not None:  # two completions have to agree
        for k in range(0, len(none), ELIMINATED):
            some = none[k : k + ELIMINATED]
            if question.stopped(some):
                counts[some, 1] = 1
                continue
            kernel_of(other)(
                other.ints,
                other.floats,
                targets,
                chain_near,
                locked,
                question.tolerance,
                question.angular,
                int(single),
                some,
                out,
                counts,
            )
    lost = (
        np.flatnonzero((counts[:, 1] == 1) & (counts[:, 0] == 0)) if maybe_none and starts else NONE
    )
    if len(lost):  # the equations said nothing: starts may
        from kempe.solvers.analytic.start_search import search

        search(question, plan, chain_near, locked, out, counts, lost)
    if lines.span.wide or plan.blurred:  # a structure may be there by rounding alone
        counts[:, 1] = 1
    return out, counts


def _locked(question: Question, plan: ChainPlan, near: Array, values: Mapping[str, Array]) -> Array:
    """Coordinates (1 or N, n) of the chain, of which those of locked joints count."""
    lines = plan.lines
    shapes = [v.shape for v in values.values()]
    batch = any(shapes) or len(near) > 1
    out = np.array(np.broadcast_to(near, (len(question.targets) if batch else 1, len(lines))))
    low, high = lines.limits
    for i in plan.locked:
        given = values.get(lines.names[i])
        if given is None:
            out[:, i] = out[:, i].clip(low[i], high[i])
            continue
        lead = question.lead or ()
        try:
            out[:, i] = np.broadcast_to(given, lead).reshape(-1) if given.ndim else given
        except ValueError:
            raise InputError(
                f"{lines.names[i]} is held at values of shape {given.shape}; it must be a number "
                f"or {lead}"
            ) from None
    if question.lead is None and not np.isfinite(out[:, list(plan.locked)]).all():
        raise InputError("a joint is held at a value that is not finite")
    return np.ascontiguousarray(out)
