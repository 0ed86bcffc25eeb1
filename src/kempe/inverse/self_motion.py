"""Self-motions: motions of a system that keep its tasks, traced step by step."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.answers import wording
from kempe.answers.answer import Configurations
from kempe.answers.problem import NOTHING, Problem, Solver, accept_all_problems, solve_problem
from kempe.answers.targets import (
    choose_task,
    is_axis_task,
    make_target_constraints,
    read_axis,
    split_task,
)
from kempe.arguments import explain_errors, explain_method_errors, raise_interrupted
from kempe.arrays import is_whole
from kempe.budget import Budget, Usual
from kempe.constraints.base import Constraint, read_numbers
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.equations.slip import find_first_slip
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.forward.fk import fk
from kempe.inverse.tasks.freedoms import Local
from kempe.inverse.tasks.search import make_checked_answer, make_demands
from kempe.kernels.base.search_layout import SOLVED
from kempe.model.configurations import find_free_angles, read_q, shorten_turns
from kempe.numerics.clock import BROKEN_OFF, TIME_LIMIT, TimeLimit, limit_preparation_time
from kempe.numerics.curves import NONE, Curve, Node, has_returned, walk_curve
from kempe.spatial import Array, ArrayLike
from kempe.units import make_tolerance
from kempe.words import format_count, join_words

if TYPE_CHECKING:
    from kempe.inverse.tasks.demands import Demands
    from kempe.model.model import FrameLike, Model

USUAL = Usual("self_motion", points=200, step=0.05, time_limit=TIME_LIMIT, progress=None)
TOLERANCE = 1e-10
"""Largest error of the tasks along the way, in metres and radians."""
HOLDS = (1e-9, 1e-9)
"""Largest error of a task, in metres and radians, with which it is said to hold along the way."""
HOME = 1e-6
"""Distance from its start at which a self-motion has returned to it."""
ALIKE = 0.98
"""Cosine above which two directions are those of one curve."""
AT_LIMIT = 1e-6
"""How near to a limit a coordinate is at it."""
SHORTEST = 1e-4
"""Part of a step below which the way ends."""
LEAST_PART = 0.05
"""Part of the wished direction that the freedoms must still have for the way to go on."""


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class SelfMotion(Configurations):
    """Family of configurations that keep tasks, in the order of the motion.

    Attributes
    ----------
    q
        Configurations (n, nq).
    freedoms
        Number of freedoms that the tasks leave at the start, over a distance. It is 0, and `q` has
        the start alone, if these freedoms exist only to first order.
    start
        Row of the configuration at which the motion was started.
    closed, ends
        Whether the motion returns to its start, or else why it ends at both ends.
    late, interrupted
        Whether the time limit or Ctrl-C ended the work; `q` is then what was found by then.
    """

    is_motion = True
    _entries = ("freedoms", "start", "closed", "ends", "interrupted", "late")

    system: Model
    q: Array
    freedoms: int
    start: int
    closed: bool
    ends: tuple[str, str]
    problem: Demands
    """The tasks that hold all along."""
    interrupted: bool = False
    late: bool = False

    @property
    def success(self) -> bool:
        """Whether the system moves, and the self-motion was traced to its ends."""
        return self.freedoms > 0 and self._find_early_end() is None

    def _list_goals(self) -> Sequence[tuple[Any, Any, Any]]:
        return [(task, goals, HOLDS) for task, goals, _ in self.problem.hard_tasks]

    def _make_headline(self) -> str:
        return self.status

    def _compose_sentence(self, index: tuple[int, ...]) -> str:
        how = (
            "it comes back to its start"
            if self.closed
            else f"from {self.ends[0]} to {self.ends[1]}"
        )
        if not self.freedoms:
            return f"1 configuration, no motion: {self.ends[0]}"
        many = (
            f"{format_count(len(self.q), 'configuration')} of a self-motion with "
            f"{format_count(self.freedoms, 'freedom')}"
        )
        return f"{many}: {how}{self._describe_early_end()}"


@explain_errors
@raise_interrupted
def self_motion(
    system: Model,
    q: Any,
    tasks: FrameLike | Constraint | Sequence[Constraint],
    *,
    task: str | tuple[str, ArrayLike] | None = None,
    direction: Any = None,
    budget: Budget | None = None,
) -> SelfMotion:
    """Trace the motion of a system from q (nq,), in both directions, that keeps tasks fulfilled.

    `tasks` is a frame, or hard tasks that are fulfilled at q. A frame keeps its pose, or only the
    part that `task` names, as for `System.ik`: "position", "orientation", "direction",
    "position_axis". Only joints that move a frame of the tasks count, and move. If the tasks leave
    one freedom, the whole curve is traced until it closes, meets a limit or has the largest number
    of points in each direction. If they leave more, `direction` chooses a curve: the name of a
    coordinate, or a velocity (nv,), which is projected onto the velocities that the tasks allow.
    `budget.step` is the length of a step, in radians and characteristic lengths. The tasks are
    fulfilled to 1e-9 at all points, by corrections of minimum norm. Where the Jacobian loses rank
    and no motion is found, the answer is q alone, and says so. Errors: `InputError` where the tasks
    are not fulfilled at q,
    leave no freedom to first order, or more than one without a direction; `UnsupportedError` where
    velocity constraints do not allow the motion.
    """
    q = read_q(system, q)
    if q.ndim != 1:
        raise InputError(f"q has shape {q.shape}; needed is one configuration ({system.nq},)")
    wanted = _read_tasks(system, q, tasks, *split_task(task))
    problem = Problem(
        system, "set", NOTHING, q, budget=budget, options={"direction": direction}, wanted=wanted
    )
    return solve_problem(SOLVERS, problem)


def trace_self_motion(problem: Problem) -> SelfMotion:
    """Trace the self-motion by steps along its tangent, each corrected."""
    spend: Any = USUAL.complete_budget(problem.budget)
    system = problem.system
    direction = problem.options["direction"]
    steps = spend.points
    time = TimeLimit(spend.time_limit)
    size = step = spend.step
    number = isinstance(step, (int, float, np.floating))
    if not is_whole(steps) or steps < 1 or not number or not 0.0 < step <= 0.5:
        raise InputError(
            f"points is {steps!r}, step {step!r}; needed are a whole number from 1, and 0 < step "
            "<= 0.5"
        )
    time.release_reserved_time()  # there is nothing to do afterwards
    with limit_preparation_time(USUAL, time):
        demands, q0 = _make_start(system, problem.start, problem.wanted)
        local = Local(demands, q0)
        if not local.allowed_velocities.shape[1]:
            raise InputError("the tasks leave no freedom at q: there is no self-motion")
        finite = local.finite_freedoms
    if not finite:
        text = wording.describe_remaining_freedoms(local.allowed_velocities.shape[1], 0)
        return SelfMotion(system, local.q[None], 0, 0, False, (text, text), demands)
    wish = _choose_direction(system, direction, local, demands)
    if local.finite_freedoms == 1:  # of curves that meet here, the one nearest to the direction
        found = np.concatenate([local.motions, -local.motions])
        wish = found[np.argmax(found @ wish)]
    way = _Direction(local, wish, local.finite_freedoms > 1, float(size), time, spend.progress)
    forth = way.follow_direction(q0, 1.0, steps)
    if forth.closed:
        return SelfMotion(
            system,
            _refuse_slip(system, [q0, *forth.q]),
            local.finite_freedoms,
            0,
            True,
            ("", ""),
            demands,
        )
    back = _HalfCurve([], False, "the start", -forth.t)
    if way.broken is None:
        back = way.follow_direction(
            q0, -1.0, steps, (forth.q[-1], -forth.t) if forth.q and forth.last else None
        )
    q = _refuse_slip(system, [*back.q[::-1], q0, *forth.q])
    ends = ("", "") if back.closed else (back.end, forth.end)
    interrupted, late = (isinstance(way.broken, kind) for kind in BROKEN_OFF)
    return SelfMotion(
        system, q, local.finite_freedoms, len(back.q), back.closed, ends, demands, interrupted, late
    )


def _refuse_slip(system: Model, q: list[Array]) -> Array:
    """Check configurations (n, nq) of a motion.

    Errors: `UnsupportedError` where they slip.
    """
    found = np.array(q)
    slip = find_first_slip(system, found)
    if slip is not None:
        raise UnsupportedError(
            f"the self-motion of {system.name} {slip.text}: only what does not move what rolls is "
            "followed; steps without slip are those of ik_step"
        )
    return found


def _read_tasks(system: Model, q: Array, tasks: Any, task: str | None, axis: ArrayLike) -> Any:
    """Read the tasks; for a frame, make those that keep its pose."""
    wanted: Any = tasks
    if isinstance(tasks, (Constraint, list, tuple)):
        if task is not None:
            raise InputError(
                f"task is {task!r}; it belongs to a frame, tasks say themselves what they ask"
            )
        return wanted
    name = system.structure.frame_name(tasks)
    kind = choose_task(task, False, bool(system.structure.table.at[name][2]))
    if system.dim == 2 and is_axis_task(kind):
        kind = "orientation" if kind == "direction" else "pose"
    return make_target_constraints(name, kind, read_axis(axis), fk(system, q, name))


def _make_start(system: Model, q: Array, wanted: Any) -> tuple[Demands, Array]:
    """Make the problem of the tasks, and the closed start q (nq,).

    Errors: `InputError` where the tasks do not hold.
    """
    problem, start = make_demands(system, wanted, q, make_tolerance(TOLERANCE, system.unit), 1)
    rows = pack_one_sided_rows(system)
    if problem.lead:
        raise InputError(
            f"the goals have the leading shape {problem.lead}; needed are those of one problem"
        )
    problem = replace(problem, tasks=tuple(t.copy_without_tolerance() for t in problem.tasks))
    at = make_checked_answer(
        replace(problem, tolerance=make_tolerance(1e-6, system.unit)),
        start,
        np.zeros((1, 3), dtype=np.int64),
    )
    if not at:
        if over := rows.list_violated_names(q):
            raise InputError(
                f"q is outside the limits of {join_words([repr(name) for name in over])}"
            )
        raise InputError(
            f"the tasks do not hold at q: they are missed by {at.position_error} m, "
            f"{at.orientation_error} rad"
        )
    return problem, problem.run_search(start)[0][0]


def _choose_direction(system: Model, direction: Any, local: Local, problem: Demands) -> Array:
    """Choose the scaled velocity (nv,) to follow."""
    if direction is None:
        if local.finite_freedoms > 1:
            raise InputError(
                f"the tasks leave {format_count(local.finite_freedoms, 'freedom')}: say by `direction` "
                "which way to go"
            )
        found = local.motions
        if (np.abs(found @ found[0]) < ALIKE).any():
            raise InputError("self-motions branch here: `direction` chooses one")
        return found[0]
    scale = problem.packed.scale
    if isinstance(direction, str):
        if direction not in system.structure.velocity_names:
            raise UnknownNameError(
                "coordinate", direction, system.structure.velocity_names, system.name
            )
        at = system.structure.velocity_names.index(direction)
        if at not in local.movers:
            own = join_words([repr(system.structure.velocity_names[int(v)]) for v in local.movers])
            raise InputError(
                f"direction is {direction!r}, which does not move what the tasks hold; {own} do"
            )
        return np.eye(system.nv)[at]
    wish = read_numbers(direction, "direction")
    if wish.shape != (system.nv,) or not np.isfinite(wish).all() or not wish.any():
        raise InputError(
            f"direction has shape {wish.shape}; it must be a velocity ({system.nv},), not zero"
        )
    return wish / scale / np.linalg.norm(wish / scale)


class _HalfCurve(NamedTuple):
    """One way from the start: configurations, whether they come to where they should, why they end,
    the last direction, and whether it is only for the number of steps that they end.
    """

    q: list[Array]
    closed: bool
    end: str
    t: Array
    last: bool = False


class _Direction(Curve):
    """Tracer of self-motions by steps along the tangent, each corrected."""

    def __init__(
        self,
        local: Local,
        wish: Array,
        wished: bool,
        step: float,
        time: TimeLimit,
        progress: Callable[[int], Any] | None,
    ) -> None:
        self.time = time
        self.progress = progress
        self.done = 0
        self.broken: BaseException | None = None
        self.local = local
        self.problem = local.problem
        self.wish = wish
        self.wished = wished
        self.step = step
        self.circle = find_free_angles(local.problem.system)

    def follow_direction(
        self, q: Array, sign: float, steps: int, goal: tuple[Array, Array] | None = None
    ) -> _HalfCurve:
        """Follow the self-motion from q one way, until it meets the goal or returns to q.

        The goal is a configuration (nq,) and the direction (nv,) in which it is passed.
        """
        out: list[Array] = []
        try:
            with self.time:
                return self._follow_curve_to_goal(q, sign, steps, goal, out)
        except BROKEN_OFF as error:
            self.broken = error
            return _HalfCurve(out, False, self.time.describe_end_reason(error), sign * self.wish)

    def _follow_curve_to_goal(
        self, q: Array, sign: float, steps: int, goal: tuple[Array, Array] | None, out: list[Array]
    ) -> _HalfCurve:
        system = self.problem.system
        way = sign * self.wish
        a = self._make_node(q, way)
        given = goal is not None
        goal = (q, a.t) if goal is None else goal
        nothing = _HalfCurve(out, False, "where the tasks leave nothing of this direction", a.t)
        if a.sigma < LEAST_PART:
            return nothing

        def take_step(a: Node, h: float) -> list[Node] | None:
            self.time.check_time()
            x = self._correct_configuration(self.move_point(a.x, h * a.t))
            if x is None or self.compute_difference(a.x, x) @ a.t < 0.01 * h:
                return None
            return [self._make_node(x, way if self.wished else a.t)]

        for b in walk_curve(
            a, take_step, self.step, self.step, least=SHORTEST * self.step, ideal=math.inf
        ):
            may_return = (out or given) and not self.wished
            if may_return and has_returned(self, a, b, self._turn_goal(goal, b.x), HOME):
                return _HalfCurve(out, True, "", a.t)
            out.append(b.x)
            self.done += 1
            if self.progress is not None:
                self.progress(self.done)
            if names := _list_reached_limits(system, b.x, a.t):
                return _HalfCurve(out, False, f"the limit of {names[0]!r}", a.t)
            if len(out) == steps:
                return _HalfCurve(
                    out, False, f"the last of {format_count(steps, 'step')}", b.t, True
                )
            if b.sigma < LEAST_PART:
                return nothing._replace(t=b.t)
            a = b
        return _HalfCurve(
            out, False, _describe_stop(self.problem, a.x, a.t, 10.0 * SHORTEST * self.step), a.t
        )

    def evaluate_equations(self, x: Array) -> tuple[Array, Array]:
        return self.local.evaluate_equations(x)

    def compute_tolerance(self, x: Array) -> float:
        return TOLERANCE

    def move_point(self, x: Array, y: Array) -> Array:
        return self.local.move_point(x, y)

    def compute_difference(self, x: Array, other: Array) -> Array:
        return self.local.compute_difference(x, other)

    def make_node(self, x: Array, toward: Array, J: Array) -> Node:
        return self._make_node(x, toward)

    def _turn_goal(self, goal: tuple[Array, Array], x: Array) -> Node:
        """Make the node of a goal with the whole turns of unlimited joints at x."""
        layout = self.problem.system.structure.layout
        v = layout.compute_difference(goal[0], x)
        turns = v - shorten_turns(v.copy(), self.circle)
        return Node(layout.integrate_velocity(goal[0], turns), goal[1], 1.0, 1, NONE, NONE)

    def _correct_configuration(self, x: Array) -> Array | None:
        """Find the configuration (nq,) nearest to x in which the tasks hold, or None."""
        found, info = self.problem.run_search(x[None])
        return found[0] if info[0, 0] == SOLVED else None

    def _make_node(self, x: Array, toward: Array) -> Node:
        """Make the node at x, its tangent the part of a direction that the freedoms allow."""
        N = self.local.compute_tangents(x)
        t = N @ (N.T @ toward)
        size = float(np.linalg.norm(t))
        return Node(x, t if size < LEAST_PART else t / size, size, N.shape[1], NONE, NONE)


def _describe_stop(problem: Demands, q: Array, t: Array, ahead: float) -> str:
    """Describe the limit or bound that stops the motion from q along t within `ahead`."""
    system = problem.system
    scale = problem.packed.scale
    if names := _list_reached_limits(system, q, t, ahead * scale):
        return f"the limit of {names[0]!r}"
    there = system.structure.layout.integrate_velocity(q, ahead * t * scale)
    rows = problem.packed.one_sided
    beyond = np.append(rows.compute_excess(there, declared=True) * rows.scale[: rows.declared], 0.0)
    if beyond.max() > 0.01 * ahead:
        return f"the one-sided constraint {rows.names[int(beyond.argmax())]!r}"
    owner = problem.packed.owner
    ties = problem.packed.loops.ties
    for i in sorted({int(k) for k, tie in zip(owner, ties, strict=True) if tie.bounds and k >= 0}):
        task = problem.tasks[i]
        if max(task.measure_error(there, problem.goals[i])) > 0.01 * ahead:
            return f"the bound of {task.label!r}"
    return "a point where it cannot be followed"


def _list_reached_limits(
    system: Model, q: Array, t: Array, ahead: Array | float = 0.0
) -> list[str]:
    """List coordinates whose limits the direction t (nv,) passes within `ahead` (nv,)."""
    v = system.structure.layout.vector_v
    x = q[system.structure.layout.vector_q]
    near = AT_LIMIT + np.abs(ahead * t)[v]
    low = (x <= system.lower[v] + near) & (t[v] < 0.0)
    high = (x >= system.upper[v] - near) & (t[v] > 0.0)
    return [system.structure.velocity_names[v[i]] for i in np.flatnonzero(low | high)]


SOLVERS = (
    Solver(
        "tangents",
        "steps along the directions in which the tasks hold to first order, led back, both ways",
        accept_all_problems,
        trace_self_motion,
    ),
)
"""Who answers for a self-motion."""
