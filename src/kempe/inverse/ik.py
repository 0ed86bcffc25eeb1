"""`ik` for targets of one frame: a configuration in which the frame reaches the target.

Plain calls for one target go by a bound form.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers.problem import (
    Choice,
    Problem,
    Solver,
    record_choice,
    select_solver,
    solve_problem,
)
from kempe.answers.targets import (
    Z_AXIS,
    check_particle,
    choose_axis,
    choose_task,
    is_axis_task,
    make_planar_target,
    make_target_constraints,
    parse_task_targets,
    read_target,
    refuse_position,
    split_task,
)
from kempe.arguments import broadcast_shapes, explain_errors, quiet, read_flag
from kempe.budget import Budget, TimeUp
from kempe.errors import InputError, TimeLimitError
from kempe.inverse import multi_start
from kempe.inverse.answer import Solution
from kempe.inverse.chain import problem
from kempe.inverse.chain.problem import FEW, ITERATIONS, MOST, TOLERANCE, FrameProblem
from kempe.inverse.numeric import BATCH, BY_TASKS, METHODS, SOLVERS, USUAL, add_history
from kempe.kernels.base.search_layout import ANSWER, STATUS
from kempe.kernels.compiled import make_allocator, schedule
from kempe.kernels.forward.table_layout import HAS_QUATERNION
from kempe.model.configurations import read_start
from kempe.model.model import bind_call
from kempe.numerics.clock import TimeLimit
from kempe.spatial import Array
from kempe.status import MEMBERS, Status, to_status
from kempe.units import make_tolerance

if TYPE_CHECKING:
    from kempe.constraints.base import Constraint
    from kempe.model.model import FrameLike, Model


# ---- the bound form of plain calls

# All is looked up but the target and the start.


def bind_plain_calls(frame_problem: FrameProblem, task: str | None, shape: tuple[int, ...]) -> None:
    """Bind plain calls like this one to a `BoundIk`, which answers them faster."""
    system = frame_problem.system
    chain = frame_problem.chain
    # a turned particle is an error
    point = frame_problem.name == "position" and (task is not None or shape != (4, 4))
    plain = (
        shape in ((4, 4), (3,), (2,))
        if point
        else (shape == (4, 4) and frame_problem.name != "position")
    )

    def make_call() -> Any:
        tolerance = make_tolerance(TOLERANCE, system.unit)
        usual = replace(frame_problem, tolerance=tolerance, starts=MOST, rng=0)
        return BoundIk(usual, shape).__call__  # a method, which takes less time to call

    if plain and frame_problem.axis == Z_AXIS and not chain.ints[HAS_QUATERNION]:
        bind_call(system, "ik", (frame_problem.frame, task, len(shape)), make_call)


class BoundIk:
    """`ik` of single targets for one frame and task, with all look-ups done once."""

    def __init__(self, frame_problem: FrameProblem, shape: tuple[int, ...]):
        self.requested = frame_problem
        self.length, self.angle = frame_problem.tolerance
        self.chain = frame_problem.chain
        self.rows = problem.pack_row_flags(frame_problem)
        system = frame_problem.system
        self.size = len(frame_problem.chain.q_index)
        self.nq = system.nq
        first = int(self.chain.q_index[0]) if self.size else 0
        in_a_row = np.array_equal(self.chain.q_index, np.arange(first, first + self.size))
        self.part = slice(first, first + self.size) if in_a_row else self.chain.q_index
        self.whole = in_a_row and self.size == system.nq
        """Whether the chain has all coordinates of the system."""
        self.plain = system.nq == system.nv == len(system.structure.layout.vector_q)
        """Whether entry i of q and of the limits belong together."""
        self.lower = system.lower
        self.upper = system.upper
        self.unmoved = np.eye(4)[None]
        self.shape = shape
        self.posed = len(shape) == 2
        self.new = make_allocator(1, self.size + ANSWER)
        self.reach = schedule.reach_goals
        self.base = self.chain.base[0]
        self.no_seed = self.chain.no_seed

    def __reduce__(self) -> tuple[Any, ...]:
        return BoundIk, (self.requested, self.shape)

    def make_problem(self, X: Array) -> FrameProblem:
        """Make the problem for poses (1, 4, 4)."""
        return replace(self.requested, targets=X)

    def _make_pose(self, target: Array) -> Array:
        """Make a pose (1, 4, 4) of a position."""
        X = self.unmoved.copy()
        X[0, : self.shape[0], 3] = target
        return X

    def read_fields(self, X: Array, row: Array) -> dict[str, Any]:
        """Read the fields of an answer, other than `q` and `success`, from what the kernels wrote."""
        linear, angular, code, steps, starts = row[-ANSWER:].tolist()
        return {
            "code": MEMBERS[int(code)],
            "position_error": linear,
            "orientation_error": angular,
            "iterations": int(steps),
            "starts": int(starts),
            "problem": self.make_problem(X),
        }

    @quiet
    def _continue_search(self, X: Array, seeds: Array, out: Array) -> None:
        """Continue the search from other starts."""
        head = (self.chain.ints, self.chain.floats, self.chain.limits, self.rows, X, seeds, 0)
        multi_start.continue_search(self.make_problem(X), X, head, FEW, out)

    def __call__(self, target: Array, start: Any) -> Solution | None:
        """Return the answer for a target; None where it needs the general solver."""
        if target.shape != self.shape or not (self.posed or target.dtype == np.float64):
            return None
        chain = self.chain
        n = self.size
        if start is None:
            base = self.base
            seeds = self.no_seed
        else:
            if (
                start.__class__ is not np.ndarray
                or start.dtype != np.float64
                or start.shape != (self.nq,)
            ):
                return None
            if not (self.plain and start.flags.c_contiguous):
                return None
            base = start
            seeds = (start if self.whole else start[self.part]).reshape(1, 1, n)
        out = self.new()
        X = target.copy()[None] if self.posed else self._make_pose(target)  # the answer keeps it
        try:
            missed = self.reach(
                chain.ints,
                chain.floats,
                chain.limits,
                self.rows,
                X,
                seeds,
                0,
                0,
                FEW,
                ITERATIONS,
                self.length,
                self.angle,
                0.0,
                out,
            )
        except TypeError:  # not float64
            return None
        row = out[0]
        if missed:
            self._continue_search(X, seeds, out)
            if row[n + STATUS] == Status.BAD_INPUT:
                return None
        if self.whole:
            q = row[:n]
        else:
            q = np.maximum(base, self.lower) if self.plain else base.copy()
            if self.plain:
                np.minimum(q, self.upper, out=q)
            q[self.part] = row[:n]
            if not math.hypot(*base.tolist()) < math.inf:
                return None
        if not missed or row[n + STATUS] == Status.SOLVED:
            answer = object.__new__(Solution)
            fields = answer.__dict__  # one by one: `from_fields` takes 0.4 us more
            fields["q"] = q
            fields["success"] = True
            fields["_later"] = self.read_fields, (X, row)
            return answer
        fields = self.read_fields(X, row)
        codes = np.array([Status.NOT_FOUND])
        quiet(problem.mark_unreachable_targets)(fields["problem"], codes)
        return Solution.from_fields(q=q, success=False, **fields | {"code": to_status(codes[0])})


# ---- the general call


@explain_errors
def ik(
    system: Model,
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
    """Find a configuration within limits in which a frame reaches a target; see `System.ik`.

    Without a frame the target are tasks, see `kempe.inverse.tasks.search.reach_tasks`.
    """
    if frame is not None:
        return _solve_frame(
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
    return solve_problem(SOLVERS, problem)


def make_frame_tasks(
    system: Model, target: Any, frame: FrameLike, task: str | tuple[str, ArrayLike] | None = None
) -> list[Constraint]:
    """Make the tasks that bring a frame to targets, as `ik` reads them."""
    name = system.structure.frame_name(frame)
    (word, axis), X, lead = _check_targets(
        system, name, read_target(system, target), *split_task(task)
    )
    return make_target_constraints(name, word, axis, X.reshape(*lead, 4, 4))


def _solve_frame(
    system: Model,
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
    """Solve `ik` for targets of one frame."""
    name = system.structure.frame_name(frame)
    target = read_target(system, target)
    said, axis = split_task(task)
    requested, targets, lead = _check_targets(system, name, target, said, axis)
    if start is not None:
        targets, lead, start = _broadcast_targets(targets, lead, read_start(system, start))
    if method not in METHODS:
        raise InputError(f"method is {method!r}; it must be one of {', '.join(map(repr, METHODS))}")
    if prefer is not None and method != "numeric":
        raise InputError(f"method is {method!r}, which prefers nothing; leave it out, or prefer")
    # the answer keeps them
    targets = targets.copy() if np.may_share_memory(targets, target) else targets
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
    )
    if method == "numeric":
        solver, choice = select_solver(SOLVERS, problem)
    else:
        solver, choice, problem = _choose_solver(problem)
    answer = record_choice(solver.run(problem), choice)
    if not lead and task is said and solver is not BY_TASKS:
        bind_plain_calls(answer.problem, said, np.shape(target))
    return add_history(answer, problem) if read_flag(history, "history") else answer


def _broadcast_targets(
    targets: Array, lead: tuple[int, ...], start: Array
) -> tuple[Array, tuple[int, ...], Array]:
    """Broadcast targets (N, 4, 4) and starts against each other; also return the leading shape."""
    if start.ndim == 1 or start.shape[:-1] == lead:
        return targets, lead, start
    many = broadcast_shapes({"target": lead, "start": start.shape[:-1]})
    targets = np.broadcast_to(targets.reshape(*lead, 4, 4), (*many, 4, 4)).reshape(
        math.prod(many), 4, 4
    )
    return np.ascontiguousarray(targets), many, np.broadcast_to(start, (*many, start.shape[-1]))


def _choose_solver(problem: Problem) -> tuple[Solver, Choice, Problem]:
    """Choose the solver and its method: search by numbers if there is no time to plan."""
    time = TimeLimit((BATCH if problem.lead else USUAL).complete_budget(problem.budget).time_limit)
    time.release_reserved_time()  # a plan is made as a whole, or not at all
    problem = problem._replace(options={"end": time.end})
    try:
        with time:
            return *select_solver(SOLVERS, problem), problem
    except TimeUp:
        if not time.spent:
            raise
        if problem.method == "analytic":
            raise TimeLimitError("ik", time.limit) from None
    problem = problem._replace(method="numeric")
    return *select_solver(SOLVERS, problem), problem


def _check_targets(
    system: Model, frame: str, target: Any, task: str | None, axis: ArrayLike
) -> tuple[tuple[str, tuple[float, float, float]], Array, tuple[int, ...]]:
    """Check task and targets: (task, axis), poses (N, 4, 4) and their leading shape."""
    if system.dim == 2 and is_axis_task(task):
        target, task = make_planar_target(target, task, axis)
    direction = choose_axis(axis, task)
    targets, lead, is_position = parse_task_targets(system, target, task, direction)
    particle = bool(system.structure.table.at[frame][2])
    name = choose_task(task, is_position, particle)
    refuse_position(name, is_position, system.dim)
    if particle and task is None and not is_position:
        check_particle(targets, frame)
    return (name, direction), targets, lead
