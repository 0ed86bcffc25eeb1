"""`Sweep`: the answer of `ik_sweep`, the solutions of a redundant chain as functions of a
parameter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from kempe.budget import look
from kempe.calls import brief, explained_methods
from kempe.constraints.frame_targets import AXIS_TASKS, of_target
from kempe.errors import InputError
from kempe.kernels.forward.table_layout import SLIDE
from kempe.kinematics.common.result import Cells, by_code
from kempe.kinematics.forward import fk
from kempe.kinematics.tasks.task_classes import task_of
from kempe.reals import reals
from kempe.solvers.analytic.plans.chain_lines import Lines
from kempe.solvers.analytic.redundant.intervals import Intervals, spelled, union
from kempe.solvers.common.answer import Answer, ConfigurationList
from kempe.solvers.common.targets import Z_AXIS
from kempe.spatial import Array, log_so3
from kempe.status import Status, member
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.model.system import System

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
    """What a sweep is made of: branches of solutions over the parameter."""

    domain: tuple[float, float]
    labels: tuple[str, ...]
    base: Array
    lines: Lines
    exact: bool
    circular: bool
    late: bool
    reason: str

    def intervals(self, limited: bool) -> list[list[tuple[float, float]]]:
        """For each branch, where it exists, inside the limits where `limited`."""
        ...

    def rows(self, values: Array, branch: int | None) -> tuple[Array, np.ndarray]:
        """Coordinates (m, K, n) of the chain, in any turn, and which are there (m, K); of one
        branch K = 1.
        """
        ...


class Best(NamedTuple):
    """The best configuration of a sweep: parameter `value`, `q` (nq,), `branch` and `score`."""

    value: float
    q: Array
    branch: int
    score: float


@explained_methods
@dataclass(frozen=True, eq=False)
class Slice(ConfigurationList, Answer):
    """All solutions at one value of the parameter of a `sweep`, or at each of many.

    For one: `q` (k, nq), those inside the limits first, and `inside`, `residual` (norm of position
    error [m] and orientation error [rad] by the forward model) and `branch` (k,). For values (m,):
    `q` (m, K, nq) with a row for each branch, NaN where `mask` (m, K) is False, the others (m, K).
    """

    __repr__ = brief

    what = "values with a solution inside the limits"
    also = ("value", "inside", "branch")

    sweep: Sweep = field(repr=False)
    value: Any
    q: Array
    mask: np.ndarray
    inside: np.ndarray
    residual: Any = field()
    branch: np.ndarray

    success = by_code

    @property
    def system(self) -> System:
        """The system of the problem."""
        return self.sweep.system

    @property
    def code(self) -> Any:
        """The outcome (...): the sweep is in closed form, so that there is no solution is proven."""
        there = np.where(self.mask.any(axis=-1), Status.OUTSIDE_LIMITS, Status.NONE_EXISTS)
        return member(np.where(self.inside.any(axis=-1), Status.SOLVED, there))

    def _goals(self) -> Sequence[tuple[Any, Any, Any]]:
        return self.sweep._goals()

    def _claimed(self) -> np.ndarray:
        return self.mask

    def _sentence(self, index: tuple[int, ...]) -> str:
        count = int(self.mask[index].sum())
        good = int(self.inside[index].sum())
        value = float(np.asarray(self.value)[index])
        return (
            f"{counted(count, 'solution')} at {self.sweep.parameter} = {value:.9g}, {good} inside "
            "limits"
        )


@explained_methods
@dataclass(frozen=True, eq=False, repr=False)
class Sweep(Answer):
    """The solutions of a chain with one freedom to spare, over a `parameter`: a joint, or
    "arm_angle".

    `intervals` has, for each branch, the intervals (low, high) of the parameter in which its
    solution is inside the limits; `spans` those in which it exists at all; `feasible` is the union
    of `intervals`. Arm angles: low is in [-pi, pi), and high is beyond pi where the interval passes
    it. `exact`: the intervals are in closed form and complete; else they are found from solutions
    at many values, their ends to 1e-10, and pieces between two of these values may be missing.
    `labels` name the branches, by the sides to which shoulder, elbow and wrist bend.

    `values` (n,), `q` (n, K, nq), `mask` and `inside` (n, K) are samples, if any were requested:
    each row is one branch, continuous inside its intervals, NaN where `mask` is False. `at` gives
    all solutions at any value, `best` the best.
    """

    also = (
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

    system: System
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

    def table(self) -> tuple[list[str], Array]:
        """Names and columns for a file: a row a sample and branch inside the limits, with the
        parameter's value.
        """
        row, branch = np.nonzero(self.inside)
        first = [np.asarray(self.values, dtype=float)[row], branch.astype(float)]
        return ["value", "branch", *self.system.coordinate_names], np.column_stack(
            [*first, self.q[row, branch]]
        )

    @property
    def feasible(self) -> Intervals:
        """The intervals in which there is any solution inside the limits."""
        return union([i for rows in self.intervals for i in rows], self.curves.circular)

    def at(self, value: ArrayLike) -> Any:
        """All solutions at a value of the parameter, a `Slice`, or for joints `Solutions` of
        `ik_all`; (m,) for many.

        Errors: `InputError` for values that are not finite.
        """
        x = reals(value, "value", "a finite number, or an array (m,) of them")
        if x.ndim > 1 or not np.isfinite(x).all():
            raise InputError(
                f"value is {value!r}; it must be a finite number, or an array (m,) of them"
            )
        return self.ask(x) if self.ask is not None else self._slice(x)

    def _slice(self, x: Array) -> Slice:
        q, mask, fits = self._sampled(np.atleast_1d(x), False)
        X = fk(self.system, np.where(mask[..., None], q, self.near), self.frame)
        turn = log_so3(np.swapaxes(X[..., :3, :3], -1, -2) @ self.target[:3, :3])
        error = np.linalg.norm(
            np.concatenate([X[..., :3, 3] - self.target[:3, 3], turn], axis=-1), axis=-1
        )
        error = np.where(mask, error, np.nan)
        branch = np.where(mask, np.arange(mask.shape[1], dtype=np.int64), -1)
        if x.ndim:
            return Slice(self, x, q, mask, fits, error, branch)
        keep = distinct(self.curves.lines, self.system, q[0], mask[0])
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

    def _sampled(
        self, values: Array, along: bool, branch: int | None = None
    ) -> tuple[Array, np.ndarray, np.ndarray]:
        """Configurations (m, K, nq), which are there, which are inside the limits (m, K); of one
        branch K = 1.
        """
        lines = self.curves.lines
        rows: list[tuple[Array, np.ndarray]] = []
        for k in range(0, max(len(values), 1), PIECE):
            look()
            rows.append(self.curves.rows(values[k : k + PIECE], branch))
        chain = np.concatenate([x for x, _ in rows])
        mask = np.concatenate([x for _, x in rows])
        chain, fits = turned(lines, chain, mask, self.near[lines.q_index], along)
        q = np.full((*mask.shape, self.system.nq), np.nan)
        q[:] = self.near
        q[..., lines.q_index] = chain
        q[~mask] = np.nan
        return q, mask, fits & mask

    def best(self, objective: str | Callable[[Array], Array] = "limits") -> Best | None:
        """The best configuration inside the limits, over all branches; None where there is none.

        objective: "limits" (the share of its range by which the joint nearest to a limit is away
        from it, at most 1), "near" (minus the distance to `near`), or a function of configurations
        (m, nq) that gives numbers (m,), the larger the better. Method: many values in each
        interval, the best refined by smaller and smaller steps.
        """
        score = self._objective(objective)
        found: list[Best] = []
        for branch, rows in enumerate(self.intervals):
            for low, high in rows:
                values = np.linspace(low, high, TRIES)[1:-1]
                first = self._best_of(score, branch, values, None)
                found += [first] if first else []
        if not found:
            return None
        found = sorted(found, key=lambda b: -b.score)[:REFINED]
        return max((self._refined(score, b) for b in found), key=lambda b: b.score)

    def _best_of(
        self, score: Callable[[Array], Array], branch: int, values: Array, best: Best | None
    ) -> Best | None:
        """The best of one branch at these values, or `best` where that is better."""
        q, mask, fits = self._sampled(values, False, branch)
        rows = np.flatnonzero((mask & fits)[:, 0])
        if not rows.size:
            return best
        scores = reals(score(q[rows, 0]), "the score")
        if scores.shape != rows.shape:
            raise InputError(
                f"the objective gives an array {scores.shape} for "
                f"{counted(len(rows), 'configuration')}"
            )
        k = int(np.argmax(scores))
        if best is not None and scores[k] <= best.score:
            return best
        return Best(float(values[rows[k]]), q[rows[k], 0], branch, float(scores[k]))

    def _refined(self, score: Callable[[Array], Array], best: Best) -> Best:
        low, high = next((a, b) for a, b in self.intervals[best.branch] if a <= best.value <= b)
        step = (high - low) / (TRIES - 1)
        while step > 1e-10:
            values = np.clip(np.linspace(best.value - step, best.value + step, 21), low, high)
            best = self._best_of(score, best.branch, values, best) or best
            step *= 0.1
        return best

    def _objective(self, objective: str | Callable[[Array], Array]) -> Callable[[Array], Array]:
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

        def room(q: Array) -> Array:
            x = q[..., at][..., limited]
            a = low[limited]
            b = high[limited]
            return np.min(2.0 * np.minimum(x - a, b - x) / (b - a), axis=-1, initial=1.0)

        return room

    @property
    def success(self) -> bool:
        """Whether there is any solution inside the limits."""
        return any(self.intervals)

    @property
    def late(self) -> bool:
        """Whether the time limit ended the search for branches, of which there may be more, or the
        sampling.
        """
        return self.curves.late

    @property
    def code(self) -> Status:
        """The outcome: that there is no solution is proven where the intervals are `exact`."""
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

    def _goals(self) -> Sequence[tuple[Any, Any, Any]]:
        made = (
            () if self.task in AXIS_TASKS else of_target(self.frame, self.task, Z_AXIS, self.target)
        )
        return [(task_of(c, self.system.dim), None, HOLDS) for c in made]

    def _claimed(self) -> np.ndarray:
        return self.mask

    def _sentence(self, index: tuple[int, ...]) -> str:
        way = "in closed form" if self.exact else "ends to 1e-10, from solutions at sampled values"
        late = "the time limit ended the sampling" if self.exact else LATE
        return self._found(way) + (f"; {late}" if self.late else "")

    def _found(self, way: str) -> str:
        if self:
            return f"{self.parameter} can be in {spelled(self.feasible)} ({way})"
        if any(self.spans):
            return f"outside the limits for every {self.parameter} ({way})"
        return f"no solution for any {self.parameter}: {self.curves.reason}"

    def __repr__(self) -> str:
        return (
            f"Sweep({self.system.name!r}, {self.frame!r}, {self.parameter!r}, "
            f"feasible=[{spelled(self.feasible)}])"
        )

    def _headline(self) -> str:
        return f"{self.frame!r} of {self.system.name}, {self.task}: {self.status}"

    def _cells(self) -> Cells:
        each = zip(self.labels, self.intervals, self.spans, strict=True)
        rows = [(label, spelled(a) or "-", spelled(b)) for label, a, b in each if b]
        return ("branch", "inside the limits", "exists"), rows

    def _lines(self) -> Sequence[str]:
        lines: list[str] = []
        if self.held:
            lines.append("held: " + ", ".join(f"{n} = {x:.9g}" for n, x in self.held.items()))
        for label, rows in zip(self.labels, self.intervals, strict=True):
            if rows:
                lines.append(f"{label}: {spelled(rows)}")
        outside = sum(
            1 for rows, spans in zip(self.intervals, self.spans, strict=True) if spans and not rows
        )
        if outside and self:
            lines.append(f"{outside} more branch{'' if outside == 1 else 'es'} outside the limits")
        return lines


def turned(
    lines: Lines, q: Array, mask: np.ndarray, near: Array, along: bool
) -> tuple[Array, np.ndarray]:
    """Coordinates (m, K, n) with turns chosen, inside the limits and nearest to `near` (n,), and
    whether they fit.

    `along`: nearest to the row before, where there is one.
    """
    period = np.where(lines.kinds == SLIDE, np.inf, TWO_PI / np.abs(lines.multiplier))
    if not along:
        out, fits = _turned(lines, q, near, period)
        return out, fits & mask
    out = np.empty_like(q)
    fits = np.empty(mask.shape, dtype=bool)
    last = np.broadcast_to(near, q.shape[1:])
    for i in range(len(q)):
        look()
        out[i], fits[i] = _turned(lines, q[i], last, period)
        last = np.where(mask[i][:, None], out[i], near)
    return out, fits & mask


def _turned(lines: Lines, q: Array, near: Array, period: Array) -> tuple[Array, np.ndarray]:
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


def distinct(lines: Lines, system: System, q: Array, mask: np.ndarray) -> np.ndarray:
    """Rows (k,) of q (K, nq) in use that are not the same configuration as one before them."""
    out: list[int] = []
    period = np.where(lines.kinds == SLIDE, np.inf, TWO_PI / np.abs(lines.multiplier))
    for k in np.flatnonzero(mask):
        d = q[out][:, lines.q_index] - q[k, lines.q_index]
        with np.errstate(invalid="ignore"):
            d = np.where(np.isfinite(period), d - period * np.round(d / period), d)
        if not len(out) or np.abs(d).max(axis=-1).min() > SAME:
            out.append(int(k))
    return np.array(out, dtype=int)
