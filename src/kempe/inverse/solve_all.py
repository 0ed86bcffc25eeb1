"""The solvers of `ik_all`, which find every configuration in which a frame reaches a target.

A chain is solved by its plan, with spare joints held at several values. For a frame that moves with
loops, the solutions are assembly modes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.problem import Choice, Problem, Solver, TaskOf, choose, takes_all
from kempe.answers.targets import TASKS, Z_AXIS, frame_of, not_a_pose
from kempe.arrays import FARTHEST
from kempe.budget import Budget, Usual, look
from kempe.equations.one_sided import one_sided_rows
from kempe.errors import InputError, UnsupportedError
from kempe.inverse.all_answer import Solutions, packed
from kempe.inverse.chain.problem import FEW, ITERATIONS, MOST, outside, rows_of
from kempe.inverse.chain.serial_chain import inside, of_loops, shared_by
from kempe.inverse.closed_forms.chain_lines import chain_lines
from kempe.inverse.closed_forms.nearest import Aim, descend, limits_of
from kempe.inverse.closed_forms.plan import ChainPlan, plan_for, side_by_side_of, within_domains
from kempe.inverse.closed_forms.question import Question, Watch, held, near_of, within
from kempe.inverse.closed_forms.solve import TOLERANCE, attainable, solve_held
from kempe.inverse.closed_forms.start_search import frame_problem, places_in
from kempe.inverse.multi_start import answered
from kempe.kernels.base.search_layout import ANGULAR, ANSWER, LINEAR, SOLVED, STATUS
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.compiled import maker, schedule
from kempe.model.configurations import winding_angles
from kempe.model.model import kept
from kempe.numerics.pool import over_chunks
from kempe.poses import sound
from kempe.spatial import Array
from kempe.words import joined

if TYPE_CHECKING:
    from kempe.assemble.modes import Modes
    from kempe.model.model import Model


# ---- other values of the joints that a redundant chain has to spare

# A target has solutions at some values of a spare joint only, near the boundary of the workspace
# and in the corners of the limits at hardly more than one. So a grid of values misses some. A
# numerical search finds a configuration wherever there is one; with the spare joints held where
# that has them, all the other solutions follow.

VALUES = 64
"""Values of the spare joints that are tried before it is said that there is no solution, the first
among them."""

LOOSE = 1e-6
"""Tolerance of the last search, which is polished after."""

POLISHES = 4
BRISK = 1e-8
"""Descents in a row that polish, at most, and the damping with which each begins."""

SAME = 1e-4
"""A solution nearer than this to the configuration of the search is that configuration."""

ROOM = 512
"""Targets times values that are solved at a time, unless there are more targets."""

CHUNK = 256
SERIAL_BELOW = 1024
PIECE = 16
"""Targets of a chunk, from how many on there are threads, and targets between two looks at the
clock."""

SIGN = -(2**63)
"""The bit that codes of rows in use do not have."""

Solve = Callable[[Question, Array, Array], tuple[Array, np.ndarray]]


@dataclass(frozen=True, eq=False)
class SpareJoints:
    """Where the spare joints are: `locked` (1 or N, n) coordinates of which those count that are
    held, and of each target how many values were `tried` (N,).
    """

    locked: Array
    tried: np.ndarray


def look_further(
    question: Question,
    plan: ChainPlan,
    near: Array,
    locked: Array,
    rows: Array,
    counts: np.ndarray,
    solve: Solve,
    threads: int | None,
) -> SpareJoints:
    """Where the spare joints are in the end, if there are some.

    `rows` (N, K, n + 2) and `counts` (N, 2) are made better in place.

    near, locked: (1 or N, n). solve: rows and counts of a question, near and locked.
    """
    tried = np.ones(len(rows), dtype=np.int64)
    left = np.flatnonzero((counts[:, 0] >= 0) & ~_reached(rows))
    if not len(left):
        return SpareJoints(locked, tried)
    many = _Targets(
        question,
        plan,
        near,
        np.array(np.broadcast_to(locked, (len(rows), len(plan.lines)))),
        rows,
        counts,
        tried,
        solve,
        threads,
    )
    left = many.searched(left, FEW, question.tolerance, True)
    if len(left):
        left = left[outside(frame_problem(question), question.targets[left]) == 0.0]
    if not len(left):
        return SpareJoints(many.locked, tried)
    if plan.method != "search" and many.spare:
        left = many.stepped(left)
    left = many.searched(left, MOST, question.tolerance, True)
    left = many.searched(left, MOST, max(question.tolerance, LOOSE), True)
    many.searched(left[~_used(rows[left])], MOST, max(question.tolerance, LOOSE), False)
    return SpareJoints(many.locked, tried)


def _used(rows: Array) -> np.ndarray:
    """Which targets (N,) have a solution."""
    return np.any(rows[..., -A.INFO + A.CODE] >= 0.0, axis=1)


def _reached(rows: Array) -> np.ndarray:
    """Which targets (N,) have a solution inside the limits."""
    # by solutions: many times as fast
    code = np.ascontiguousarray(rows[..., -A.INFO + A.CODE].T).astype(np.int64)
    return np.any((code & (SIGN | int(A.INSIDE_BIT))) == int(A.INSIDE_BIT), axis=0)


@dataclass(frozen=True, eq=False)
class _Targets:
    """The targets of a closed-form problem with the best solutions so far, in arrays that are
    written in place.
    """

    question: Question
    plan: ChainPlan
    near: Array
    locked: Array
    rows: Array
    counts: np.ndarray
    tried: np.ndarray
    solve: Solve
    threads: int | None

    @property
    def spare(self) -> list[int]:
        """Numbers of the spare joints, which are held at chosen values."""
        return [i for i in self.plan.locked if i not in self.plan.fixed]

    def solutions_at(self, which: np.ndarray, locked: Array) -> tuple[Array, np.ndarray]:
        """All solutions of the targets `which` (m indices) with the spare joints held at `locked`
        (1 or m, n).

        Returns rows (m, K, n + 2), each a configuration with its error and flag, and their counts
        (m, 2).
        """
        lead = None if self.question.lead is None and len(which) == 1 else (len(which),)
        some = self.question.of(which, lead)
        near = self.near if len(self.near) == 1 else self.near[which]
        return self.solve(some, near, locked)

    def take(self, which: np.ndarray, locked: Array, rows: Array, counts: np.ndarray) -> None:
        """Keep the answers that are better: they have a solution inside the limits, or have one at
        all.
        """
        old = self.rows[which]
        better = (_reached(rows) & ~_reached(old)) | (_used(rows) & ~_used(old))
        at = which[better]
        self.rows[at] = rows[better]
        self.counts[at] = counts[better]
        self.locked[at] = locked[better]

    def stepped(self, left: np.ndarray) -> np.ndarray:
        """The targets of `left` that have no solution inside the limits at any of VALUES values."""
        values = spare_values(self.plan, self.spare)
        k = 0
        while k < len(values) and len(left) and not self.question.stopped(left):
            some = values[k : k + max(1, ROOM // len(left))]
            which = np.repeat(left, len(some))
            locked = self.locked[which]
            locked[:, self.spare] = np.tile(some, (len(left), 1))
            same = len(some) == 1 and not np.ptp(locked, axis=0).any()
            rows, counts = self.solutions_at(which, locked[:1] if same else locked)
            grade = (2 * _reached(rows) + _used(rows)).reshape(len(left), len(some))
            first = np.arange(len(left)) * len(some) + np.argmax(grade, axis=1)
            self.take(left, locked[first], rows[first], counts[first])
            self.tried[left] += np.where(
                grade.max(axis=1) == 3, 1 + np.argmax(grade, axis=1), len(some)
            )
            left = left[~_reached(self.rows[left])]
            k = k + len(some)
        return left

    def searched(
        self, left: np.ndarray, starts: int, tolerance: float, limited: bool
    ) -> np.ndarray:
        """The targets of `left` for which no start found a configuration, inside the limits where
        `limited`.

        The others have all solutions with the spare joints where their configuration has them,
        itself among them.
        """
        if not len(left) or self.question.stopped(left):
            return left
        q, error, found = self._configurations(left, starts, tolerance, limited)
        which = left[found]
        q = q[found]
        error = error[found]
        if len(which):
            locked = self.locked[which]
            locked[:, self.spare] = q[:, self.spare]
            rows, counts = self.solutions_at(which, locked)
            for i in np.flatnonzero(~(_reached(rows) if limited else _used(rows))):
                _put(rows[i], counts[i], q[i], error[i], limited, self.question.lead is None)
            self.tried[which] += 1
            self.take(which, locked, rows, counts)
        return left[~found]

    def _configurations(
        self, which: np.ndarray, starts: int, tolerance: float, limited: bool
    ) -> tuple[Array, Array, np.ndarray]:
        """Coordinates (m, n) of the chain, errors (m,), and which were found (m,), to the tolerance
        of the question.
        """
        lines = self.plan.lines
        task = frame_problem(self.question)
        m = len(which)
        chain = task.chain
        at = places_in(chain, lines)
        goals = self.question.targets[which]
        pins = list(self.plan.fixed)
        if self.question.axis != Z_AXIS:
            goals = goals.copy()
            goals[:, :3, :3] = goals[:, :3, :3] @ frame_of(np.array(self.question.axis))
        pinned = self.locked[which][:, pins]
        out = np.empty((m, len(lines) + ANSWER))
        circular = chain.circular.copy()
        circular[at[pins]] = 0
        task = replace(
            task,
            chain=replace(chain, circular=circular),
            starts=starts,
            tolerance=(tolerance, min(tolerance, max(self.question.angular, LOOSE))),
        )
        wanted = rows_of(task)
        limits = chain.limits.copy() if limited else np.tile([[-np.inf], [np.inf]], len(lines))
        near = self.near if len(self.near) == 1 else self.near[which]
        seeds = np.empty((len(near), 1, len(lines)))
        seeds[:, 0, at] = near
        if starts > FEW and limited:  # the few began at `near`: other starts, then
            seeds = chain.no_seed

        def pieces(i: int, j: int) -> int:
            for k in range(i, j, PIECE):
                look()
                last = min(k + PIECE, j)
                if self.question.stopped(which[k:last]):
                    out[k:last] = np.nan
                else:
                    work(k, last)
            return 0

        def work(i: int, j: int) -> int:
            if len(pins):
                limits[:, at[pins]] = pinned[i]
            first = seeds[i:j] if len(seeds) > 1 else seeds
            if chain.span.wide:
                return answered(task, self.question.targets[which[i:j]], first, limits, out[i:j])
            return schedule.reach(
                chain.ints,
                chain.floats,
                limits,
                wanted,
                goals[i:j],
                first,
                0,
                0,
                starts,
                ITERATIONS,
                *task.tolerance,
                0.0,
                out[i:j],
            )

        if len(pins) and np.ptp(pinned, axis=0).any():
            for i in range(m):
                pieces(i, i + 1)
        else:
            over_chunks(pieces, m, CHUNK, self.threads, SERIAL_BELOW)
        n = len(lines)
        q = out[:, at]
        error = np.hypot(out[:, n + LINEAR], out[:, n + ANGULAR])
        found = out[:, n + STATUS] == SOLVED
        for i in np.flatnonzero(found & (error > self.question.tolerance)):
            q[i], error[i] = self._polished(which[i], q[i], limited)
        within = (error <= self.question.tolerance) & (
            out[:, n + ANGULAR] <= max(self.question.angular, LOOSE)
        )
        return q, error, found & within

    def _polished(self, index: int, q: Array, limited: bool) -> tuple[Array, float]:
        """A configuration (n,) on the target as nearly as can be, and its error."""
        lines = self.plan.lines
        X = self.question.targets[index].copy()
        if self.question.axis != Z_AXIS:
            X[:3, :3] = X[:3, :3] @ frame_of(np.array(self.question.axis))
        X[:3, 3] = (X[:3, 3] - lines.origin) / lines.length
        moves = np.array([i for i in range(len(lines)) if i not in self.plan.fixed], dtype=np.int64)
        aim = Aim(lines, np.flatnonzero(TASKS[self.plan.task]), X, moves)
        low, high = limits_of(lines) if limited else np.tile([[-np.inf], [np.inf]], len(lines))
        theta = lines.theta(q)[None]
        error = np.inf
        for _ in range(POLISHES):  # where the chain is singular a step halves the way
            theta = descend(aim, theta, low[moves], high[moves], BRISK)
            R, p, _, _ = aim.sweep(theta)
            e = aim.errors(R, p)[0]
            error = float(np.hypot(np.linalg.norm(e[:3]) * lines.length, np.linalg.norm(e[3:])))
            if error <= 0.1 * self.question.tolerance:
                break
        q = (theta[0] - lines.offset) / lines.multiplier
        return np.clip(q, *lines.limits) if limited else q, error


def spare_values(plan: ChainPlan, spare: list[int]) -> Array:
    """Values (VALUES - 1, k) of the spare joints between their limits: the ends, and what fills the
    space between.

    The points of one joint are those of van der Corput (1935), of several those of a Kronecker
    sequence.
    """
    lines = plan.lines
    k = len(spare)
    count = VALUES - 1
    if k == 1:
        number = np.arange(1, count - 1)
        shares = sum(((number >> bit) & 1) / 2.0 ** (bit + 1) for bit in range(6))
        shares = np.concatenate([np.reshape(shares, (-1, 1)), [[0.0], [1.0]]])
    else:
        root = 2.0
        for _ in range(50):  # x^(k + 1) = x + 1
            root = (1.0 + root) ** (1.0 / (k + 1))
        shares = (0.5 + np.arange(1, count + 1)[:, None] * root ** -np.arange(1.0, k + 1)) % 1.0
    full = np.full((count, len(lines)), 0.5)
    full[:, spare] = shares
    return within_domains(lines, full)[:, spare]


def _put(row: Array, count: np.ndarray, q: Array, error: float, inside: bool, first: bool) -> None:
    """Make a configuration one of the rows (K, n + 2) of its target: in place of itself, else where
    there is room.
    """
    n = len(q)
    used = row[:, n + A.CODE] >= 0.0
    off = np.where(used, np.abs(row[:, :n] - q).max(axis=1), np.inf)
    at = (
        int(np.argmin(off))
        if off.min() < SAME
        else int(np.argmin(used))
        if not used.all()
        else len(row) - 1
    )
    count[0] += int(not used[at])
    count[1] = 1
    own = np.concatenate([q, [error, A.MULTIPLICITY_UNIT + float(inside)]])
    if first:
        row[1 : at + 1] = row[:at].copy()
        at = 0
    row[at] = own


# ---- solutions that hold one-sided constraints


def obeying(solutions: Solutions) -> Solutions:
    """The solutions that hold the one-sided constraints of their system; the status says how many
    do not, and which.

    Coordinates that the chain does not have are where the solutions have them: near, or neutral.
    Where a constraint tells whole turns of one without limits apart, others of its turns may hold
    it: the answer is then not complete.
    """
    bounds = one_sided_rows(solutions.system)
    if not bounds.declared:
        return solutions
    used = solutions._used
    q = np.where(used[..., None], solutions._full(), solutions.system.neutral)
    beyond = used[..., None] & (bounds.beyond(q, declared=True) > 0.0)
    bad = np.any(beyond, axis=-1)
    if not bad.any():
        return solutions
    rows = solutions._rows.copy()
    rows[bad, -A.INFO + A.CODE] = A.UNUSED
    rows = packed(rows) if solutions.single else rows
    texts = np.empty(len(beyond), dtype=object)
    texts[:] = [bounds.left_out(each) for each in beyond]
    out = solutions._with(rows, solutions, texts)
    if names := _wound(solutions):
        dropped = bad.any(axis=-1)
        counts = solutions._counts.copy()
        counts[dropped, 1] += 1
        texts[dropped] += f", at other whole turns of {joined(list(map(repr, names)))} they may not"
        out._counts = counts
    return out


def _wound(solutions: Solutions) -> list[str]:
    """The coordinates of the chain without limits whose whole turns a constraint tells apart."""
    names = solutions.system.structure.velocity_names
    endless = winding_angles(solutions.system)
    return [names[int(v)] for v in solutions.plan.lines.v_index if endless[v]]


# ---- frames that move with loops, or with joints that follow others

# Their solutions are the assembly modes with the frame known.

LOOPS = Usual("ik_all", threads=None, time_limit=30.0)
"""What is spent on one target."""

KNOWN_TASKS = ("pose", "position")
"""What of a target can be known of a frame."""


def all_modes(problem: Problem, moving: str = "loops") -> Modes:
    """The configurations that are found, those inside the limits first; the frame moves with what
    `moving` says.

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
    limit = LOOPS.of(problem.budget).time_limit
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


def _of_loops(problem: Problem) -> Modes:
    """The answer for a frame that moves with loops, or with joints that follow others."""
    if problem.limits == "turns":
        raise InputError(
            f"frame {problem.frame!r} moves with {_moving(problem)}: limits='turns' is for chains"
        )

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


# ---- the solvers, and how one is chosen


def _no_loops(system: Model, frame: str, task: TaskOf, fixed: tuple[str, ...]) -> str | None:
    if of_loops(system, frame) or shared_by(system, frame):
        return None
    return "the frame does not move with loops, or with joints that follow others"


def _needs(method: str, side_by_side: bool, why: str) -> Callable[..., str | None]:
    """A refusal of chains whose plan is another one."""

    def refuses(system: Model, frame: str, task: TaskOf, fixed: tuple[str, ...]) -> str | None:
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
    system: Model, frame: str, task: TaskOf, fixed: tuple[str, ...]
) -> tuple[Solver, Choice]:
    """Who answers for a frame, a task, and joints that are held."""
    return choose(SOLVERS, system, frame, task, fixed)


# ---- the bound form of plain calls, and the kernels


class BoundIkAll:
    """`ik_all` of single poses for one frame, with all that can be looked up looked up: the way of
    plain calls.
    """

    def __init__(self, system: Model, frame: str, plan: ChainPlan, kernel: Callable[..., int]):
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


def bind(system: Model, frame: str) -> BoundIkAll | None:
    """The bound form for poses of a frame, None where there is none; made once."""
    lines = chain_lines(system, frame, Z_AXIS)
    plan = plan_for(system, frame, lines, "pose", Z_AXIS, ())
    kernel = None if plan.locked or system.structure.table.at[frame][2] else side_by_side_of(plan)
    bound = None if kernel is None else BoundIkAll(system, frame, plan, kernel)
    system._queries[(frame,)] = None if bound is None else bound.__call__
    return bound


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
        # the first of rows in order is inside the limits
        decided = code >= 0.0 and code % 2.0 == 1.0
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

    def at(some: Question, near: Array, locked: Array) -> tuple[Array, np.ndarray]:
        # of which there are many for all values
        return solve_held(some, plan, near, locked, threads, starts=False)

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
