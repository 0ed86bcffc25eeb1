"""`ik_sweep`: solutions of a chain with one redundant freedom, as functions of a parameter."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.answers.answer import Answer, ConfigurationList
from kempe.answers.problem import Problem, Solver, solve_problem
from kempe.answers.targets import (
    AXIS_TASKS,
    Z_AXIS,
    choose_axis,
    explain_refused_target,
    make_target_constraints,
    parse_task_targets,
    refuse_position,
    split_task,
)
from kempe.answers.targets import choose_task as task_of_targets
from kempe.arguments import explain_errors, explain_method_errors
from kempe.arrays import FARTHEST, is_whole, read_reals
from kempe.budget import Budget, TimeUp, Usual, check_for_stop
from kempe.equations.tasks import Task
from kempe.errors import InputError, UnknownNameError, UnsupportedError, format_value
from kempe.forward.fk import fk
from kempe.inverse.arm_angle import (
    BRANCHES,
    ELBOW,
    Arm,
    Posed,
    explain_missing_arm,
    find_arm,
    require_arm,
)
from kempe.inverse.chain.serial_chain import move_inside_limits
from kempe.inverse.closed_forms.chain_lines import Lines, find_chain_lines
from kempe.inverse.closed_forms.plan import compute_domains, find_plan
from kempe.inverse.closed_forms.problem import read_held_joints, read_near_configurations
from kempe.inverse.ik_all import ik_all
from kempe.inverse.sweep_curves import Arcs, ChainMotion, trace_arcs
from kempe.kernels.forward.table_layout import SLIDE
from kempe.numerics.clock import SHARE, SHORT, TimeLimit, find_time_limit, limit_time
from kempe.numerics.intervals import Intervals, format_intervals, unite_intervals
from kempe.poses import check_poses, read_pose_array
from kempe.report import Table, by_code
from kempe.spatial import Array, log_so3
from kempe.status import Status, to_status
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model


# ---- the answer

EDGE = 1e-10
"""How far beyond a limit rounding may push a coordinate, as in `ik_all`."""

HOLDS = (1e-6, 1e-6)
"""Metres and radians that a sampled solution may miss the target by."""

SAME = 1e-6
"""Largest difference of two configurations that count as one."""

TRIES = 201
REFINED = 4
"""Configurations of each interval that are compared, and how many of the best of these are
refined."""

LATE = "the time limit ended the search: there may be more"
"""What is added where branches may be missing."""

PIECE = 4096
"""Samples between two looks at the clock."""

TWO_PI = 2.0 * math.pi


class Curves(Protocol):
    """Protocol of branches of solutions as functions of the parameter."""

    domain: tuple[float, float]
    labels: tuple[str, ...]
    base: Array
    lines: Lines
    exact: bool
    circular: bool
    late: bool
    reason: str

    def find_intervals(self, limited: bool) -> list[list[tuple[float, float]]]:
        """Find the intervals of the parameter where each branch exists.

        With `limited`, only where it is inside the limits.
        """
        ...

    def compute_rows(self, values: Array, branch: np.ndarray | None) -> tuple[Array, np.ndarray]:
        """Compute coordinates (m, K, n) of the chain, and which branches exist (m, K).

        With a branch (m,) for each value K = 1; angles are in any turn.
        """
        ...


class Best(NamedTuple):
    """The best configuration of a sweep: parameter `value`, `q` (nq,), `branch` and `score`."""

    value: float
    q: Array
    branch: int
    score: float


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Slice(ConfigurationList, Answer):
    """All solutions at one value of the parameter of a `sweep`, or at each of several values.

    Attributes
    ----------
    q
        Configurations (k, nq) for one value, those inside the limits first. For m values (m, K, nq)
        with a column for each branch, NaN where `mask` (m, K) is False.
    inside
        Mask of the solutions inside the limits.
    residual
        Norm of the position error [m] and orientation error [rad], by the forward model.
    branch
        Number of the branch of each solution.
    """

    what = "values with a solution inside the limits"
    _entries = ("value", "inside", "branch")

    sweep: Sweep
    value: Any
    q: Array
    mask: np.ndarray
    inside: np.ndarray
    residual: Any = field()
    branch: np.ndarray

    success = by_code

    @property
    def system(self) -> Model:
        """The system of the problem."""
        return self.sweep.system

    @property
    def code(self) -> Any:
        """Outcome (...): `NONE_EXISTS` is proven, since the sweep is in closed form."""
        there = np.where(self.mask.any(axis=-1), Status.OUTSIDE_LIMITS, Status.NONE_EXISTS)
        return to_status(np.where(self.inside.any(axis=-1), Status.SOLVED, there))

    def _list_goals(self) -> Sequence[tuple[Any, Any, Any]]:
        return self.sweep._list_goals()

    def _select_claimed_rows(self) -> np.ndarray:
        return self.mask

    def _compose_sentence(self, index: tuple[int, ...]) -> str:
        count = int(self.mask[index].sum())
        good = int(self.inside[index].sum())
        value = float(np.asarray(self.value)[index])
        return (
            f"{format_count(count, 'solution')} at {self.sweep.parameter} = {value:.9g}, {good} "
            "inside limits"
        )


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Sweep(Answer):
    """Solutions of a chain with one redundant freedom along a parameter: a joint or "arm_angle".

    `at` gives all solutions at any value of the parameter, `best` the best one.

    Attributes
    ----------
    intervals
        For each branch, the intervals (low, high) of the parameter in which its solution is inside
        the limits. For arm angles, low is in [-pi, pi), and high exceeds pi if the interval passes
        it.
    spans
        For each branch, the intervals in which its solution exists.
    feasible
        Union of `intervals`.
    exact
        Whether the intervals have a closed form and are complete. Otherwise their ends are found to
        1e-10 from solutions at many values, and pieces between two of these values may be missing.
    labels
        Names of the branches, by the sides to which shoulder, elbow and wrist bend.
    values, q, mask, inside
        Samples, if requested: values (n,), configurations (n, K, nq) with a column for each branch,
        continuous inside its intervals, and masks (n, K).
    """

    _entries = (
        "frame",
        "parameter",
        "task",
        "held",
        "domain",
        "labels",
        "intervals",
        "spans",
        "feasible",
        "exact",
        "values",
        "inside",
    )

    system: Model
    frame: str
    parameter: str
    task: str
    target: Array
    held: dict[str, float]
    domain: tuple[float, float]
    labels: tuple[str, ...]
    intervals: tuple[Intervals, ...]
    spans: tuple[Intervals, ...]
    exact: bool
    values: Array
    q: Array
    mask: np.ndarray
    inside: np.ndarray
    curves: Curves
    near: Array
    ask: Callable[[Array], Any] | None

    def _list_columns(self) -> tuple[list[str], Array]:
        """Return names and columns of a table with a row for each feasible sample and branch."""
        row, branch = np.nonzero(self.inside)
        first = [np.asarray(self.values, dtype=float)[row], branch.astype(float)]
        return ["value", "branch", *self.system.coordinate_names], np.column_stack(
            [*first, self.q[row, branch]]
        )

    @property
    def feasible(self) -> Intervals:
        """Intervals of the parameter with a solution inside the limits."""
        return unite_intervals([i for rows in self.intervals for i in rows], self.curves.circular)

    def at(self, value: ArrayLike) -> Any:
        """Return all solutions at a value of the parameter, or at many values (m,).

        They are a `Slice`, or for joints the `Solutions` of `ik_all`.

        Errors: `InputError` for values that are not finite.
        """
        x = read_reals(value, "value", "a finite number, or an array (m,) of them")
        if x.ndim > 1 or not np.isfinite(x).all():
            raise InputError(
                f"value is {value!r}; it must be a finite number, or an array (m,) of them"
            )
        return self.ask(x) if self.ask is not None else self._make_slice(x)

    def _make_slice(self, x: Array) -> Slice:
        q, mask, fits = self._sample_branches(np.atleast_1d(x), False)
        X = fk(self.system, np.where(mask[..., None], q, self.near), self.frame)
        turn = log_so3(np.swapaxes(X[..., :3, :3], -1, -2) @ self.target[:3, :3])
        error = np.linalg.norm(
            np.concatenate([X[..., :3, 3] - self.target[:3, 3], turn], axis=-1), axis=-1
        )
        error = np.where(mask, error, np.nan)
        branch = np.where(mask, np.arange(mask.shape[1], dtype=np.int64), -1)
        if x.ndim:
            return Slice(self, x, q, mask, fits, error, branch)
        keep = find_distinct_rows(self.curves.lines, self.system, q[0], mask[0])
        score = np.linalg.norm((q[0] - self.near)[keep], axis=-1)
        keep = keep[np.lexsort((score, ~fits[0, keep]))]
        return Slice(
            self,
            float(x),
            q[0, keep],
            mask[0, keep],
            fits[0, keep],
            error[0, keep],
            branch[0, keep],
        )

    def _sample_branches(
        self, values: Array, along: bool, branch: np.ndarray | None = None
    ) -> tuple[Array, np.ndarray, np.ndarray]:
        """Compute configurations (m, K, nq), which exist, and which are inside the limits (m, K).

        With a branch (m,) for each value K = 1.
        """
        lines = self.curves.lines
        rows: list[tuple[Array, np.ndarray]] = []
        for k in range(0, max(len(values), 1), PIECE):
            check_for_stop()
            some = slice(k, k + PIECE)
            rows.append(
                self.curves.compute_rows(values[some], None if branch is None else branch[some])
            )
        chain = np.concatenate([x for x, _ in rows])
        mask = np.concatenate([x for _, x in rows])
        chain, fits = choose_turns(lines, chain, mask, self.near[lines.q_index], along)
        q = np.full((*mask.shape, self.system.nq), np.nan)
        q[:] = self.near
        q[..., lines.q_index] = chain
        q[~mask] = np.nan
        return q, mask, fits & mask

    def best(self, objective: str | Callable[[Array], Array] = "limits") -> Best | None:
        """Return the best configuration inside the limits over all branches; None if none exists.

        objective: "limits" (the share of its range by which the joint nearest to a limit is away
        from it, at most 1), "near" (minus the distance to `near`), or a function of configurations
        (m, nq) that gives numbers (m,), the larger the better. Method: many values in each
        interval, the best refined by smaller and smaller steps.
        """
        score = self._make_score(objective)
        spans = [(k, *ends) for k, rows in enumerate(self.intervals) for ends in rows]
        if not spans:
            return None
        (branch, low, high) = (np.array(column) for column in zip(*spans, strict=True))
        values = np.linspace(low, high, TRIES, axis=1)[:, 1:-1]
        found = self._find_best_samples(score, branch, values, [None] * len(spans))
        order = [i for i in range(len(spans)) if found[i] is not None]
        order = sorted(order, key=lambda i: -found[i].score)[:REFINED]
        best = [found[i] for i in order]
        branch, low, high = (x[order] for x in (branch, low, high))
        step = (high - low) / (TRIES - 1)
        while (left := np.flatnonzero(step > 1e-10)).size:
            middle = np.array([best[i].value for i in left])
            values = np.linspace(middle - step[left], middle + step[left], 21, axis=1)
            values = np.clip(values, low[left, None], high[left, None])
            better = self._find_best_samples(score, branch[left], values, [best[i] for i in left])
            for i, one in zip(left, better, strict=True):
                best[i] = one
            step = step * 0.1
        return max(best, key=lambda b: b.score, default=None)

    def _find_best_samples(
        self,
        score: Callable[[Array], Array],
        branch: np.ndarray,
        values: Array,
        best: list[Any],
    ) -> list[Any]:
        """Find the best sample (k,) of each row of values (k, m) on branches (k,).

        The `best` by now, or None, stays where none is better.
        """
        k, m = values.shape
        flat = values.ravel()
        q, mask, fits = self._sample_branches(flat, False, np.repeat(branch, m))
        rows = np.flatnonzero((mask & fits)[:, 0])
        if not rows.size:
            return best
        scores = read_reals(score(q[rows, 0]), "the score")
        if scores.shape != rows.shape:
            raise InputError(
                f"the objective gives an array {scores.shape} for "
                f"{format_count(len(rows), 'configuration')}"
            )
        out = list(best)
        ends: list[int] = np.searchsorted(rows, list(range(0, m * k + 1, m))).tolist()
        for i in range(k):
            first = ends[i]
            last = ends[i + 1]
            if first == last:
                continue
            at = first + int(np.argmax(scores[first:last]))
            before = out[i]
            if before is None or scores[at] > before.score:
                out[i] = Best(
                    float(flat[rows[at]]), q[rows[at], 0], int(branch[i]), float(scores[at])
                )
        return out

    def _make_score(self, objective: str | Callable[[Array], Array]) -> Callable[[Array], Array]:
        if callable(objective):
            return objective
        lines = self.curves.lines
        if objective == "near":
            return lambda q: -np.linalg.norm(q - self.near, axis=-1)
        if objective != "limits":
            raise InputError(
                f"objective is {objective!r}; it must be 'limits', 'near' or a function of "
                "configurations"
            )
        (low, high) = lines.limits
        at = lines.q_index
        limited = np.isfinite(low) & np.isfinite(high) & (high > low)

        def compute_limit_margin(q: Array) -> Array:
            x = q[..., at][..., limited]
            a = low[limited]
            b = high[limited]
            return np.min(2.0 * np.minimum(x - a, b - x) / (b - a), axis=-1, initial=1.0)

        return compute_limit_margin

    @property
    def success(self) -> bool:
        """Whether there is a solution inside the limits."""
        return any(self.intervals)

    @property
    def late(self) -> bool:
        """Whether the time limit ended the search for branches, or the sampling."""
        return self.curves.late

    @property
    def code(self) -> Status:
        """Outcome: `NONE_EXISTS` or `OUTSIDE_LIMITS` only if the intervals are `exact`."""
        if self.success:
            return Status.SOLVED
        if self.late and not self.exact:
            return Status.OUT_OF_TIME
        return (
            Status.NOT_FOUND
            if not self.exact
            else Status.OUTSIDE_LIMITS
            if any(self.spans)
            else Status.NONE_EXISTS
        )

    def _list_goals(self) -> Sequence[tuple[Any, Any, Any]]:
        made = (
            ()
            if self.task in AXIS_TASKS
            else make_target_constraints(self.frame, self.task, Z_AXIS, self.target)
        )
        return [(Task(self.system, c), None, HOLDS) for c in made]

    def _select_claimed_rows(self) -> np.ndarray:
        return self.mask

    def _compose_sentence(self, index: tuple[int, ...]) -> str:
        way = "in closed form" if self.exact else "ends to 1e-10, from solutions at sampled values"
        late = "the time limit ended the sampling" if self.exact else LATE
        return self._describe_feasible(way) + (f"; {late}" if self.late else "")

    def _describe_feasible(self, way: str) -> str:
        if self:
            return f"{self.parameter} can be in {format_intervals(self.feasible)} ({way})"
        if any(self.spans):
            return f"outside the limits for every {self.parameter} ({way})"
        return f"no solution for any {self.parameter}: {self.curves.reason}"

    def _make_headline(self) -> str:
        return f"{self.frame!r} of {self.system.name}, {self.task}: {self.status}"

    def _make_tables(self) -> Sequence[Table]:
        each = zip(self.labels, self.intervals, self.spans, strict=True)
        rows = [
            (label, format_intervals(a) or "-", format_intervals(b)) for label, a, b in each if b
        ]
        return [Table(("branch", "inside the limits", "exists"), rows)] if rows else []

    def _list_notes(self, degrees: bool = False) -> Sequence[str]:
        held = ", ".join(f"{n} = {x:.9g}" for n, x in self.held.items())
        return [f"held: {held}"] if held else []


def choose_turns(
    lines: Lines, q: Array, mask: np.ndarray, near: Array, along: bool
) -> tuple[Array, np.ndarray]:
    """Choose turns of coordinates (m, K, n) inside the limits, nearest to `near` (n,).

    Also returns whether they are inside the limits.

    `along`: nearest to the row before, where there is one.
    """
    period = np.where(lines.kinds == SLIDE, np.inf, TWO_PI / np.abs(lines.multiplier))
    if not along:
        out, fits = _shift_by_turns(lines, q, near, period)
        return out, fits & mask
    out = np.empty_like(q)
    fits = np.empty(mask.shape, dtype=bool)
    last = np.broadcast_to(near, q.shape[1:])
    for i in range(len(q)):
        check_for_stop()
        out[i], fits[i] = _shift_by_turns(lines, q[i], last, period)
        last = np.where(mask[i][:, None], out[i], near)
    return out, fits & mask


def _shift_by_turns(lines: Lines, q: Array, near: Array, period: Array) -> tuple[Array, np.ndarray]:
    low, high = lines.limits
    with np.errstate(invalid="ignore"):
        best = np.where(np.isfinite(period), q + period * np.round((near - q) / period), q)
        over = np.where(np.isfinite(period), period * np.ceil((best - high - EDGE) / period), 0.0)
        under = np.where(np.isfinite(period), period * np.ceil((low - EDGE - best) / period), 0.0)
        other = np.where(
            best > high + EDGE, best - over, np.where(best < low - EDGE, best + under, best)
        )
        fits = (other >= low - EDGE) & (other <= high + EDGE)
        return np.where(fits, np.clip(other, low, high), best), fits.all(axis=-1)


def find_distinct_rows(lines: Lines, system: Model, q: Array, mask: np.ndarray) -> np.ndarray:
    """Find the rows (k,) of q (K, nq) that differ from all rows before them."""
    out: list[int] = []
    period = np.where(lines.kinds == SLIDE, np.inf, TWO_PI / np.abs(lines.multiplier))
    for k in np.flatnonzero(mask):
        d: Array = q[out][:, lines.q_index] - q[k, lines.q_index]
        with np.errstate(invalid="ignore"):
            d = np.where(np.isfinite(period), d - period * np.round(d / period), d)
        if not len(out) or np.abs(d).max(axis=-1).min() > SAME:
            out.append(int(k))
    return np.array(out, dtype=int)


# ---- the call of `ik_sweep`

ARM_ANGLE = "arm_angle"

SAMPLES = 256
MOST_SAMPLES = 10_000_000
"""Values of a joint at which all solutions are requested, as starts of the curves between: usually,
and at most."""
USUAL = Usual("ik_sweep", points=SAMPLES, time_limit=SHORT)


@explain_errors
@limit_time(USUAL)
def ik_sweep(
    system: Model,
    target: ArrayLike,
    frame: FrameLike,
    parameter: str | tuple[str, ArrayLike] | None = None,
    *,
    n: int | None = None,
    task: str | tuple[str, ArrayLike] | None = None,
    start: Any = None,
    fixed: Mapping[str, Any] | None = None,
    budget: Budget | None = None,
) -> Sweep:
    """Solve the inverse kinematics of a redundant chain for one target, over a parameter.

    The answer includes the intervals inside the limits.

    `parameter` is a joint of the chain, or "arm_angle" for seven turning joints of which the first
    three axes meet, and the last three (`kempe.inverse.arm_angle` says what it
    is; a pair ("arm_angle", reference) names its reference); by default that, and else the joint
    that `ik_all` holds. `target` and `task` are as in `ik_all`. Where there is more than one
    freedom to spare, joints are held: those `fixed`, by name, and others at `start` (nq,), which
    also chooses among turns of angles; without `start` where `ik_all` finds a solution inside the
    limits. `n` asks for samples at so many values. Of the `budget` are read: points (256), the
    values of a joint at which curves are looked for, and time_limit (30 s): where it ends the work,
    `late` is true, and the branches are those found.

    Errors: `UnsupportedError` for chains without a freedom to spare, or without an arm angle where
    that is requested, `InputError`, `UnknownNameError`, `TimeLimitError` where no branch could be
    looked for by then.

    >>> import kempe
    >>> robot = kempe.load("iiwa14")
    >>> target = robot.fk([0.3, 0.9, 0.2, 1.3, -0.4, 0.8, 0.1], "tool")
    >>> sweep = ik_sweep(robot, target, "tool")
    >>> [(round(low, 3), round(high, 3)) for low, high in sweep.intervals[0]]
    [(0.156, 6.204)]
    >>> sweep.at(0.2).q[0].round(3).tolist()
    [0.252, -0.341, -0.177, -1.3, 0.474, -0.535, -0.241]
    """
    name = system.structure.frame_name(frame)
    said, axis = split_task(task)
    with_reference = isinstance(parameter, (tuple, list))
    if with_reference and len(parameter) != 2:
        raise InputError(
            f"the parameter is {format_value(parameter)}; it must be a name, or a name and a "
            "direction"
        )
    parameter, reference = parameter if with_reference else (parameter, None)
    if reference is not None:
        reference = tuple(read_reals(reference, "the reference of the arm angle").ravel().tolist())
    _check_sample_count(USUAL.complete_budget(budget).points)
    direction = choose_axis(axis, said)
    targets, lead, is_position = parse_task_targets(
        system, read_pose_array(target, "target"), said, direction
    )
    if lead != ():
        raise InputError(f"target has the leading shape {lead}; a sweep has one target")
    if not np.all(np.abs(targets) < FARTHEST):
        raise InputError(explain_refused_target(targets[0]))
    task = task_of_targets(said, is_position, bool(system.structure.table.at[name][2]))
    refuse_position(task, is_position, system.dim)
    given_near = read_near_configurations(system, start, None)
    near = system.neutral[None] if given_near is None else given_near
    lines = find_chain_lines(system, name, Z_AXIS)
    base = move_inside_limits(system, near.copy())[0]
    # which chooses among turns, also from outside the limits
    base[lines.q_index] = near[0, lines.q_index]
    if task != "position" and system.dim == 3:
        _refuse_no_rotation(targets[0, :3, :3])
    given = read_held_joints(name, lines.names, fixed)
    if any(v.ndim for v in given.values()):
        raise InputError("a sweep holds joints at single numbers")
    options = {
        "base": base,
        "n": None if n is None else _check_sample_count(n),
        "given": read_reals(target, "target"),
    }
    problem = Problem(
        system,
        "set",
        given,
        start,
        budget=budget,
        options=options,
        frame=name,
        task=(task, direction),
        targets=targets,
        parameter=(parameter, reference),
    )
    return solve_problem(SOLVERS, problem)


# ---- the solvers


def _explain_no_arm(problem: Problem) -> str | None:
    system = problem.system
    frame = str(problem.frame)
    parameter, reference = problem.parameter
    joints = ", ".join(_find_lines(problem).names)
    if parameter not in (None, ARM_ANGLE):
        return f"joint {parameter!r} is named as the parameter"
    if problem.task[0] != "pose" or problem.known:
        return f"the arm angle is for poses, with no joint held; name a joint: {joints}"
    arm = find_arm(system, frame, reference)
    return explain_missing_arm(system, frame, arm) if isinstance(arm, str) else None


def _explain_no_joint(problem: Problem) -> str | None:
    return "the arm angle is requested" if problem.parameter[0] == ARM_ANGLE else None


def sweep_arm_angle(problem: Problem) -> Sweep:
    """Sweep the branches of an arm over its arm angle, in closed form."""
    arm = require_arm(problem.system, str(problem.frame), problem.parameter[1])
    return _make_sweep(problem, ArmCurves(problem, arm))


def sweep_joint(problem: Problem) -> Sweep:
    """Sweep the branches over a joint, from solutions at many of its values."""
    points = _check_sample_count(USUAL.complete_budget(problem.budget).points)
    return _make_sweep(problem, _trace_joint_curves(problem, points))


SOLVERS = (
    Solver(
        "arm angle",
        "both sides of shoulder, elbow and wrist over the angle of the arm's plane",
        _explain_no_arm,
        sweep_arm_angle,
    ),
    Solver(
        "joint",
        "all solutions at many values of a joint, and the curves through them",
        _explain_no_joint,
        sweep_joint,
    ),
)
"""Who answers for the solutions over a parameter."""


def _refuse_no_rotation(R: Array) -> None:
    check_poses(spatial.pose(R), "target")


def _check_sample_count(n: object) -> int:
    if not is_whole(n) or not 2 <= n <= MOST_SAMPLES:
        raise InputError(
            f"the number of samples is {n!r}; it must be a whole number from 2 to {MOST_SAMPLES}"
        )
    return int(n)


# ---- the joints that are held, and the solutions at values of the parameter


def _find_lines(problem: Problem) -> Lines:
    """Find the lines of the chain of a problem, with the tip as the frame has it."""
    return find_chain_lines(problem.system, str(problem.frame), Z_AXIS)


def _list_locked_joints(problem: Problem, fixed: Mapping[str, Any]) -> tuple[int, ...]:
    """List the joints that `ik_all` holds, with these `fixed`."""
    task, axis = problem.task
    frame = str(problem.frame)
    lines = find_chain_lines(problem.system, frame, axis)
    return find_plan(problem.system, frame, lines, task, axis, tuple(fixed)).locked


def _choose_held_configuration(problem: Problem) -> Array:
    """Choose the configuration (nq,) where unnamed joints are held: near, or on target."""
    if problem.start is None:
        found = ik_all(
            problem.system,
            problem.options["given"],
            str(problem.frame),
            task=problem.task,
            fixed=problem.known,
        )
        if found:
            return found.q[0]
    lines = _find_lines(problem)
    q = problem.options["base"].copy()
    q[lines.q_index] = np.clip(q[lines.q_index], *lines.limits)
    return q


def solve_at_values(
    problem: Problem,
    name: str,
    values: Array,
    fixed: Mapping[str, Any],
    time: TimeLimit | None = None,
) -> Any:
    """Solve `ik_all` with a joint held at values () or (m,), in the remaining time."""
    budget = (
        None
        if time is None or time.remaining_seconds is None
        else Budget(time_limit=SHARE * time.remaining_seconds)
    )
    m = (len(values),) if values.ndim else ()
    given = problem.options["given"]
    base = problem.options["base"]
    return ik_all(
        problem.system,
        np.broadcast_to(given, (*m, *given.shape)),
        str(problem.frame),
        np.array(np.broadcast_to(base, (*m, *base.shape)), order="C"),
        task=problem.task,
        fixed={**fixed, name: values},
        budget=budget,
    )


# ---- the curves of the solutions


def _make_sweep(problem: Problem, curves: ArmCurves | JointCurves) -> Sweep:
    """Make the answer, with samples."""
    n = problem.options["n"]
    rows, spans = (
        tuple(tuple(r) for r in curves.find_intervals(limited)) for limited in (True, False)
    )
    none = np.zeros((0, len(curves.labels)), dtype=bool)
    sweep = Sweep(
        problem.system,
        str(problem.frame),
        curves.parameter,
        problem.task[0],
        problem.targets[0],
        curves.held,
        curves.domain,
        curves.labels,
        rows,
        spans,
        curves.exact,
        np.zeros(0),
        np.zeros((*none.shape, problem.system.nq)),
        none,
        none,
        curves,
        curves.base,
        None
        if curves.exact
        else partial(solve_at_values, problem, curves.parameter, fixed=curves.held),
    )
    if n is None:
        return sweep
    values = np.linspace(*curves.domain, n)
    try:
        q, mask, fits = sweep._sample_branches(values, True)
    except TimeUp:
        if not find_time_limit(USUAL).spent:
            raise
        curves.late = True
        return sweep
    for name, x in (("values", values), ("q", q), ("mask", mask), ("inside", fits)):
        object.__setattr__(sweep, name, x)
    return sweep


class ArmCurves:
    """The eight branches of an arm over its arm angle."""

    parameter = ARM_ANGLE
    exact = True
    circular = True
    late = False
    domain = (-math.pi, math.pi)

    def __init__(self, problem: Problem, arm: Arm):
        self.posed = Posed(arm, problem.targets[0])
        self.lines = arm.lines
        self.base = problem.options["base"]
        self.held: dict[str, float] = {}
        names = (arm.lines.names[1], arm.lines.names[ELBOW], arm.lines.names[5])
        self.labels = tuple(
            " ".join(n + ("+", "-")[side] for n, side in zip(names, (s, e, w), strict=True))
            for e, s, w in BRANCHES
        )
        self.reason = (
            f"the wrist would have to be {self.posed.distance * arm.lines.length:.6g} m from the "
            "shoulder"
        )

    def find_intervals(self, limited: bool) -> list[list[tuple[float, float]]]:
        """Find the intervals of the arm angle where each branch exists, or is inside the limits."""
        return self.posed.find_intervals(limited)

    def compute_rows(
        self, values: Array, branch: np.ndarray | None = None
    ) -> tuple[Array, np.ndarray]:
        """Compute coordinates (m, 8, 7), and which branches exist (m, 8).

        With a branch (m,) for each value they are (m, 1, 7) and (m, 1).
        """
        theta, found = self.posed.solve_branches(values)
        if branch is not None:
            rows = np.arange(len(values))
            theta = theta[rows, branch][:, None]
            found = found[rows, branch][:, None]
        return (theta - self.lines.offset) / self.lines.multiplier, found


class JointCurves:
    """Branches over a joint: arcs of the curves of self-motion."""

    exact = False
    circular = False

    def __init__(
        self,
        motion: ChainMotion,
        arcs: Arcs,
        name: str,
        domain: tuple[float, float],
        fixed: dict[str, float],
        samples: int,
        late: bool,
    ):
        self.late = late
        self.motion = motion
        self.arcs = arcs
        self.lines = motion.lines
        self.parameter = name
        self.domain = domain
        self.held = fixed
        self.base = motion.base
        self.unit = float(motion.unit[motion.p])
        self.labels = tuple(f"branch {k + 1}" for k in range(len(arcs)))
        self.reason = (
            f"none of {format_count(samples, 'value')} of it admits a solution; the target alone may "
            "determine its value"
        )

    def find_intervals(self, limited: bool) -> list[list[tuple[float, float]]]:
        """Find the intervals of the joint where each branch exists, or is inside the limits."""
        return [
            [(a * self.unit, b * self.unit) for a, b in rows]
            for rows in self.arcs.find_intervals(limited)
        ]

    def compute_rows(
        self, values: Array, branch: np.ndarray | None = None
    ) -> tuple[Array, np.ndarray]:
        """Compute coordinates (m, K, n), and which branches exist (m, K).

        With a branch (m,) for each value K = 1.
        """
        shape = (len(values), len(self.arcs) if branch is None else 1)
        arc = np.tile(np.arange(shape[1]), shape[0]) if branch is None else branch
        flat = np.repeat(values, shape[1])
        x, mask = self.arcs.find_points(flat / self.unit, arc)
        q = self.motion.make_configurations(x)[:, self.lines.q_index]
        q[:, self.motion.free[self.motion.p]] = flat
        q[~mask] = np.nan
        return q.reshape(*shape, -1), mask.reshape(shape)


def _trace_joint_curves(problem: Problem, samples: int) -> JointCurves:
    """Trace the branches over a joint.

    Errors: `UnsupportedError` where the chain has no freedom to spare.
    """
    lines = _find_lines(problem)
    frame = str(problem.frame)
    parameter = problem.parameter[0]
    task, axis = problem.task
    time = find_time_limit(USUAL)
    if parameter is not None and parameter not in lines.names:
        raise UnknownNameError(
            "joint", str(parameter), (*lines.names, ARM_ANGLE), f"the chain of {frame!r}"
        )
    if parameter in problem.known:
        raise InputError(f"{parameter} is fixed; the parameter must be free")
    locked = _choose_locked_joints(problem)
    if not locked:
        raise UnsupportedError(
            f"the chain of {frame!r} has no freedom to spare for {_format_task(task)}: ask `ik_all`"
        )
    name = locked[0] if parameter is None else parameter
    others = {n: float(problem.known[n]) for n in locked if n in problem.known}
    if left := [n for n in locked if n not in (name, *others)]:
        q = _choose_held_configuration(problem)
        others |= {n: float(q[lines.q_index[lines.names.index(n)]]) for n in left}
    i = lines.names.index(name)
    first, last = compute_domains(lines)[:, i].tolist()
    domain: tuple[float, float] = first, last
    shift = (domain[1] - domain[0]) * 0.381966 / samples  # arms tend to be singular at round values
    inner = np.linspace(domain[0], domain[1], samples)[:-1] + shift
    values = np.concatenate([[domain[0]], inner, [domain[1]]])
    time.release_reserved_time()  # `ik_all` has its share, and ends by itself
    found = solve_at_values(problem, name, values, others, time)
    missed = int(np.sum(found.late))
    free = tuple(j for j, n in enumerate(lines.names) if n not in others)
    base = problem.options["base"].copy()
    for other, value in others.items():
        base[lines.q_index[lines.names.index(other)]] = value
    motion = ChainMotion(
        problem.system, frame, lines, task, axis, problem.targets[0], base, free, free.index(i)
    )
    level, row = np.nonzero(found.mask & (found.multiplicity > 0))
    arcs = trace_arcs(
        motion,
        values / motion.unit[motion.p],
        motion.read_coordinates(found.q[level, row]),
        level,
        time,
    )
    late = missed > 0 or time.spent
    return JointCurves(motion, arcs, name, domain, others, len(values) - missed, late)


def _format_task(task: str) -> str:
    return f"a{'n' if task[0] in 'aeiou' else ''} {task.replace('_axis', ' with an axis')}"


def _choose_locked_joints(problem: Problem) -> list[str]:
    """Choose the joints that `ik_all` holds, the parameter first.

    There are none where the chain has no freedom to spare.
    """
    parameter = problem.parameter[0]
    fixed = dict(problem.known)
    if parameter is not None:
        fixed[parameter] = np.zeros(())
    names = _find_lines(problem).names
    chosen = [names[i] for i in _list_locked_joints(problem, fixed) if names[i] not in fixed]
    if parameter is None:
        return [*chosen, *fixed] if chosen else []
    spare = [
        i for i in _list_locked_joints(problem, problem.known) if names[i] not in problem.known
    ]
    return [parameter, *chosen, *problem.known] if spare else []
