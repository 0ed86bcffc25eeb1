"""`Solutions`, the answer of `ik_all`: all configurations that reach a target."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np

from kempe.answers.answer import Answer, ConfigurationList, Row
from kempe.answers.tables import list_target_columns
from kempe.answers.targets import TASKS, Z_AXIS, make_rotations_along, make_target_constraints
from kempe.arguments import explain_method_errors
from kempe.equations.tasks import Task
from kempe.errors import InputError
from kempe.forward.fk import fk, jacobian
from kempe.inverse.closed_forms.branch_names import (
    Kind,
    match_branch_names,
    name_branches,
    recognise_kind,
)
from kempe.inverse.closed_forms.chain_lines import Lines
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.forward.table_layout import SLIDE
from kempe.model.configurations import list_units
from kempe.numerics.rank import Level, Spectrum
from kempe.report import ROWS, Table, by_code
from kempe.spatial import Array
from kempe.status import Status, to_status
from kempe.units import METRES
from kempe.words import Quantity, format_count

if TYPE_CHECKING:
    from kempe.inverse.closed_forms.plan import ChainPlan
    from kempe.inverse.closed_forms.problem import ChainProblem
    from kempe.model.model import Model


# ---- status of each target, and goals of its solutions


def compute_status_codes(solutions: Solutions) -> np.ndarray:
    """Compute the `Status` numbers (N,) of the targets.

    That there is no solution is proven where the answer is complete.

    Solutions that were left out, of a whole answer, are outside of limits or of one-sided
    constraints, or come too near for a clearance. What is known of curves of solutions is no proof.
    """
    whole = solutions if solutions._whole is None else solutions._whole
    used = whole._used_rows
    multiplicity = whole._code // int(A.MULTIPLICITY_UNIT)
    curves = (used & (multiplicity == 0)).any(axis=1)
    none = np.where(used.any(axis=1), Status.OUTSIDE_LIMITS, Status.NONE_EXISTS)
    if solutions._near is not None:
        none = np.where(solutions._near, Status.TOO_NEAR, none)
    # of the whole, and of what is left
    complete = np.ravel(whole.complete) & np.ravel(solutions.complete)
    none = np.where(complete & ~curves, none, Status.NOT_FOUND)
    none = np.where(np.ravel(whole.late), Status.OUT_OF_TIME, none)
    none = np.where(whole._counts[:, 0] < 0, Status.BAD_INPUT, none)
    return np.where((solutions._code % 2 == 1).any(axis=1), Status.SOLVED, none)


def list_goals(solutions: Solutions) -> list[tuple[Any, Any, Any]]:
    """List tasks, goals and tolerances of the target, for each of its solutions."""
    problem = solutions.problem
    lead = solutions._lead
    X = problem.targets[0] if lead is None else problem.targets.reshape(*lead, 1, 4, 4)
    rounding = problem.tolerance * float(METRES[solutions.system.unit])
    allowed = (problem.tolerance, max(rounding, problem.angular))
    made = make_target_constraints(problem.frame, problem.task, problem.axis, X)
    return [(Task(solutions.system, c), None, allowed) for c in made]


# ---- choice and order of solutions

# Every turn inside the limits, only what is inside, branches that continue.

NEW = 1e3
"""Change of the joints that is as bad as the beginning of a branch."""

MOST_ROWS = 20_000
"""Rows of one target, at most: limits of many turns multiply."""


def select_inside_rows(rows: Array, single: bool) -> Array:
    """Select rows (N, K, n + 2) of solutions inside the limits; mark the others as unused.

    Of a single target the unused rows come last.
    """
    code = rows[..., -A.INFO + A.CODE]
    out = rows.copy()
    out[(code >= 0.0) & (code.astype(np.int64) % 2 == 0), -A.INFO + A.CODE] = A.UNUSED
    return pack_rows(out) if single else out


def pack_rows(rows: Array) -> Array:
    """Move the used rows (N, K, n + 2) to the front, in their order."""
    unused = rows[..., -A.INFO + A.CODE] < 0.0
    order = np.argsort(unused, axis=1, kind="stable")
    return np.take_along_axis(rows, order[..., None], axis=1)


def expand_rows(rows: Array, lines: Lines) -> Array:
    """Add a row (N, K, n + 2) for every further turn of an angle that is inside the limits.

    Solutions outside the limits stay as they are.

    Errors: `InputError` where one target would have more than MOST_ROWS.
    """
    for i in range(len(lines) if rows.size else 0):
        low, high = lines.limits[:, i]
        period = 2.0 * math.pi / abs(lines.multiplier[i])
        if lines.kinds[i] == SLIDE or not high - low < math.inf or high - low < period - 1e-9:
            continue
        code = rows[..., -A.INFO + A.CODE]
        q = rows[..., i]
        fits = (code >= 0.0) & (code.astype(np.int64) % 2 == 1)
        first = np.where(fits, np.ceil((low - q) / period - 1e-12), 0.0)
        last = np.where(fits, np.floor((high - q) / period + 1e-12), 0.0)
        count = int(np.nanmax(last - first, initial=0.0)) + 1
        if rows.shape[1] * count > MOST_ROWS:
            raise InputError(
                f"more than {MOST_ROWS} solutions: joint {lines.names[i]!r} alone has {count} turns"
            )
        turns = first[..., None] + np.arange(count)
        more = np.repeat(rows[:, :, None], count, axis=2)
        more[..., i] = np.where(
            fits[..., None], np.clip(q[..., None] + turns * period, low, high), q[..., None]
        )
        more[..., -A.INFO + A.CODE] = np.where(
            turns <= last[..., None], more[..., -A.INFO + A.CODE], A.UNUSED
        )
        rows = pack_rows(more.reshape(len(rows), -1, rows.shape[2]))
        used = rows[..., -A.INFO + A.CODE] >= 0.0
        rows = rows[:, : max(int(used.sum(axis=1).max(initial=0)), 1)]
    return rows


def follow_branches(rows: Array, lines: Lines, length: int) -> Array:
    """Reorder rows (N, K, n + 2) so that each place follows one branch along a trajectory.

    Trajectories have `length` targets.
    """
    from scipy import optimize

    out = rows.copy()
    n = len(lines)
    unit = np.abs(lines.multiplier)
    period = np.where(lines.kinds == SLIDE, np.inf, 2.0 * math.pi / unit)
    for first in range(0, len(rows), max(length, 1)):
        last = np.full((rows.shape[1], n), np.nan)  # where each place was last in use
        for i in range(first, min(first + length, len(rows))):
            used = out[i, :, n + A.CODE] >= 0.0
            with np.errstate(invalid="ignore"):
                d = out[i, None, :, :n] - last[:, None]
                d = np.where(np.isinf(period), d, d - period * np.round(d / period))
                cost = np.linalg.norm(d * unit, axis=-1)
            cost = np.where(used, np.where(np.isnan(cost), NEW, np.minimum(cost, NEW)), 2.0 * NEW)
            order: np.ndarray = cast(Any, optimize).linear_sum_assignment(cost)[1]
            out[i] = out[i, order]
            last = np.where((out[i, :, n + A.CODE] >= 0.0)[:, None], out[i, :, :n], last)
    return out


# ---- the answer


@dataclass(frozen=True)
class SolutionsRow(Row):
    """Functions that describe answers of `ik_all`.

    Targets are numbered along all axes of a batch.
    """

    held: Callable[[Any], str]
    """Where joints are held, in a sentence."""
    nearest: Callable[[Any, int], tuple[Array, float, float]]
    """What comes nearest to one target."""
    families: Callable[[Any, int], tuple[list[Any], np.ndarray]]
    """The self-motions of one target, a list of `Family`, and for each solution the number of its
    own."""


class Bound(Protocol):
    """The prepared form of a plain call, which can make the problem of a pose (4, 4)."""

    system: Model

    def make_problem(self, target: Array) -> ChainProblem:
        """Make the problem of a target (4, 4)."""
        ...


@explain_method_errors
class Solutions(ConfigurationList, Answer):
    """All configurations that reach a target, or each target of a batch.

    For one target the solutions inside the limits come first; each group is sorted by distance to
    `start`. In a batch along a trajectory, each branch keeps its row.

    Attributes
    ----------
    q
        Configurations (k, nq), or (..., K, nq) for a batch with NaN where `mask` (..., K) is False.
    residual
        Norm of the position error [m] and orientation error [rad], by the forward model.
    inside
        Whether each solution is inside the limits.
    multiplicity
        Number of roots that have merged in each solution; 0 for one of infinitely many (see
        `families`).
    branch, names
        Number and name of the branch of each solution; -1 and "" for none.
    condition
        Condition number of the Jacobian of the task.
    complete
        Whether no other isolated solutions exist.
    """

    def __init__(
        self,
        problem: ChainProblem | tuple[Bound, Array],
        plan: ChainPlan,
        base: Array,
        rows: Array,
        counts: np.ndarray,
        lead: tuple[int, ...] | None,
        used: int | None = None,
        locked: Array | None = None,
        first: Array | None = None,
        tried: np.ndarray | None = None,
        late: tuple[float, np.ndarray] | None = None,
    ):
        self._problem = problem
        self.plan = plan
        self._base = base
        self._rows = rows
        self._counts = counts
        self._lead = lead
        self._count = used
        self._locked = locked
        self._first = first
        self._tried = tried
        self._ended = late
        self._whole: Solutions | None = (
            None  # the answer before some of it was chosen: what is said is about that
        )
        self._left_out: np.ndarray | None = (
            None  # and what is said besides (N,) of those that were left out
        )
        self._near: np.ndarray | None = (
            None  # and whether solutions inside the limits (N,) come too near for a clearance
        )

    @cached_property
    def problem(self) -> ChainProblem:
        """The problem that was solved."""
        if isinstance(self._problem, tuple):
            bound, target = self._problem
            return bound.make_problem(target)
        return self._problem

    @property
    def system(self) -> Model:
        """The system of the problem."""
        return self._problem[0].system if isinstance(self._problem, tuple) else self._problem.system

    @property
    def single(self) -> bool:
        """Whether one target was given, not a batch."""
        return self._lead is None

    @cached_property
    def _code(self) -> np.ndarray:
        """Codes of all rows (N, K); 0 for unused rows.

        See `kempe.kernels.closed_form.analytic_layout`.
        """
        code = self._rows[..., len(self.plan.lines) + A.CODE]
        return np.where(code >= 0.0, code, 0.0).astype(np.int64)

    @cached_property
    def _used_rows(self) -> np.ndarray:
        """Mask (N, K) of the rows in use."""
        return self._rows[..., len(self.plan.lines) + A.CODE] >= 0.0

    @cached_property
    def mask(self) -> np.ndarray:
        """Mask of the rows in use: (..., K) for a batch; (k,), all true, for a single target."""
        return self._reshape_rows(self._used_rows)

    def _reshape_rows(self, rows: Array) -> Any:
        """Reshape rows (N, K, ...) to the shape of the answer."""
        if self._lead is None:
            return rows[0, : int(self._used_rows[0].sum()) if self._count is None else self._count]
        return rows.reshape(*self._lead, *rows.shape[1:])

    def _reshape_values(self, values: Array) -> Array:
        """Reshape numbers (N, K, ...) to the shape of the answer, NaN in unused rows."""
        if self._lead is not None and not self._used_rows.all():
            shape = (*self._used_rows.shape, *[1] * (values.ndim - 2))
            values = np.where(self._used_rows.reshape(shape), values, np.nan)
        return self._reshape_rows(values)

    @cached_property
    def q(self) -> Array:
        """Configurations (k, nq) for a single target, or (..., K, nq) for a batch."""
        return self._reshape_values(self._fill_configurations())

    def _fill_configurations(self) -> Array:
        """Fill the configurations (N, K, nq) of all rows."""
        n = self.system.nq
        index = self.plan.lines.q_index
        own = self._rows[..., : len(index)]
        if self.plan.has_system_coordinates and len(index) == n:
            return own
        full = np.empty((*own.shape[:2], n))
        full[:] = self._base[:, None]
        full[..., index] = own
        return full

    @cached_property
    def residual(self) -> Array:
        """Norm (k,) or (..., K) of position error [m] and orientation error [rad]."""
        return self._reshape_values(self._rows[..., len(self.plan.lines) + A.ERROR])

    @cached_property
    def inside(self) -> np.ndarray:
        """Whether each solution is inside the limits, (k,) or (..., K)."""
        return self._reshape_rows(self._code % 2 == 1)

    @cached_property
    def multiplicity(self) -> np.ndarray:
        """Multiplicity of each solution as a root, (k,) or (..., K); 0 for members of a family."""
        return self._reshape_rows(self._code // int(A.MULTIPLICITY_UNIT))

    @cached_property
    def branch(self) -> np.ndarray:
        """Index of the branch of each solution, (k,) or (..., K); -1 without a branch."""
        unit = int(A.SLOT_UNIT)
        return self._reshape_rows(self._code % int(A.MULTIPLICITY_UNIT) // unit - 1)

    def _list_columns(self) -> tuple[list[str], Array]:
        """Return names and columns for a file: one row for each solution.

        Of a batch the number of the target comes first.
        """
        names = list(self.system.coordinate_names)
        mask = self.mask
        if self.single:
            return names, self.q
        mask = mask.reshape(-1, mask.shape[-1])
        q = self.q.reshape(*mask.shape, self.system.nq)[mask]
        return ["target", *names], np.column_stack([np.nonzero(mask)[0].astype(float), q])

    def _list_outcomes(self) -> dict[str, np.ndarray]:
        row = np.zeros(len(self.q), int) if self.single else np.nonzero(self._used_rows)[0]
        each = {"inside": self.inside, "branch": self.branch, "residual": self.residual}
        X = np.reshape(self.problem.targets, (-1, 4, 4))[row]
        targets = list_target_columns(self.system.dim, X, self.problem.task == "position")
        return {name: x[self.mask] for name, x in each.items()} | targets

    # ---- joints that are held

    @property
    def _held_values(self) -> tuple[Array | None, Array | None, np.ndarray | None]:
        """Values of held joints, values at first, and numbers of values that were tried."""
        return self._locked, self._first, self._tried

    @property
    def spare(self) -> tuple[str, ...]:
        """Names of joints that `ik_all` holds because the chain has more freedoms than the task."""
        plan = self.plan
        return tuple(plan.lines.names[i] for i in plan.spare_joints)

    @cached_property
    def held(self) -> dict[str, Any]:
        """Values of held joints by name: a number, or an array (...) for the targets of a batch."""
        out: dict[str, Any] = {}
        locked = self._base[:, self.plan.lines.q_index] if self._locked is None else self._locked
        for i in self.plan.locked:
            values = np.broadcast_to(locked[:, i], len(self._rows))
            out[self.plan.lines.names[i]] = (
                float(values[0]) if self._lead is None else values.reshape(self._lead)
            )
        return out

    @property
    def tried(self) -> Any:
        """Number of values of the `spare` joints at which solutions were computed.

        An int, or an array (...) of a batch.
        """
        tried = np.ones(len(self._rows), dtype=np.int64) if self._tried is None else self._tried
        return int(tried[0]) if self._lead is None else tried.reshape(self._lead)

    @cached_property
    def _kind(self) -> Kind | None:
        """Kind of arm whose branches have names; None for others."""
        return recognise_kind(self.plan, self.system.dim == 2)

    @property
    def titles(self) -> tuple[str, ...]:
        """Names of the configurations in pictures: names of branches, or else numbers."""
        return tuple(name or str(k) for k, name in enumerate(np.ravel(self.names).tolist(), 1))

    @cached_property
    def names(self) -> np.ndarray:
        """Name of the branch of each solution, (k,) or (..., K), such as "elbow-up".

        Arms in space have names such as "shoulder left, elbow up, no flip".

        A name depends on the configuration alone, and says "singular" on the border of two
        branches. It is "" where there is none: for other chains than planar arms, SCARAs, those of
        six turns, the second and third about parallel axes, with a wrist of three axes that meet in
        a point, or with a fourth axis parallel to the second and axes 5 and 6 that meet, Stanford
        arms, and seven turns with a spherical shoulder and wrist ("elbow +").
        """
        lines = self.plan.lines
        out = np.full(self._used_rows.shape, "", dtype=object)
        if self._kind is not None and self._used_rows.any():
            theta = lines.compute_theta(self._rows[self._used_rows][:, : len(lines)])
            merged = self._code[self._used_rows] // int(A.MULTIPLICITY_UNIT) != 1
            out[self._used_rows] = name_branches(self._kind, lines, theta, merged)
        return self._reshape_rows(out)

    def find_branch(self, words: str | Iterable[str]) -> np.ndarray:
        """Return a mask of the solutions whose names contain all given words.

        Parameters
        ----------
        words
            Words such as "elbow up", as one text or several.

        Returns
        -------
        Array
            Mask (k,) or (..., K), for example for ``a.q[a.find_branch("elbow up, no flip")]``.

        Raises
        ------
        InputError
            If the branches of the chain have no names.
        UnknownNameError
            For other words.
        """
        return match_branch_names(self._kind, self.names, words)

    # ---- what is found out on demand

    @cached_property
    def jacobian(self) -> Array:
        """Jacobians (k, 6, n) or (..., K, 6, n) of the chain at the solutions, in the tip's frame.

        Rows that the task does not read and columns of joints that are held are zero; in metres and
        radians.
        """
        problem = self.problem
        plan = self.plan
        own = np.where(self._used_rows[..., None], self._rows[..., : len(plan.lines)], 0.0)
        q = np.broadcast_to(self._base[:, None], (*own.shape[:2], self.system.nq)).copy()
        q[..., plan.lines.q_index] = own
        J = jacobian(self.system, q, problem.frame, "body")[..., plan.lines.v_index]
        if problem.axis != Z_AXIS:
            R = make_rotations_along(np.array(problem.axis)).T
            J = np.concatenate([R @ J[..., :3, :], R @ J[..., 3:, :]], axis=-2)
        J = J * np.array(TASKS[plan.task], dtype=float)[:, None]
        J[..., list(plan.locked)] = 0.0
        return self._reshape_values(J)

    @cached_property
    def condition(self) -> Array:
        """Condition numbers (k,) or (..., K) of the Jacobian; infinite if singular.

        Lengths are measured by that of the chain.
        """
        plan = self.plan
        J = np.nan_to_num(self.jacobian)
        scale = np.array([1.0 / plan.lines.length] * 3 + [1.0] * 3)[:, None]
        units = np.where(plan.lines.kinds == SLIDE, plan.lines.length, 1.0)
        moves = [i for i in range(len(plan.lines)) if i not in plan.locked]
        values = Spectrum((J * scale * units)[..., moves]).values
        rank = min(len(moves), int(np.sum(TASKS[plan.task])))
        if self.system.dim == 2:
            rank = min(rank, 2 if plan.task == "position" else 3)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = values[..., 0] / values[..., rank - 1]
        return (
            ratio
            if self.single
            else np.where(self.mask, np.where(np.isnan(ratio), np.inf, ratio), np.nan)
        )

    @cached_property
    def derivative(self) -> Array:
        """Derivatives dq (k, nv, 6) or (..., K, nv, 6) for a twist [linear; angular] of the target.

        In ground axes, at the target's origin.

        The pseudoinverse of the Jacobian where the task asks for less than a pose, or the chain has
        fewer joints.
        """
        J = self.jacobian
        used = self.mask[..., None, None]
        inverse = Spectrum(np.where(used, J, 0.0)).compute_pseudo_inverse(Level.ROUNDING)
        R = fk(self.system, np.where(self.mask[..., None], self.q, 0.0), self.problem.frame)[
            ..., :3, :3
        ]
        if self.problem.axis != Z_AXIS:
            R = R @ make_rotations_along(np.array(self.problem.axis))
        R = np.swapaxes(R, -1, -2)
        body = np.concatenate([inverse[..., :3] @ R, inverse[..., 3:] @ R], axis=-1)
        out = np.zeros((*J.shape[:-2], self.system.nv, 6))
        out[..., self.plan.lines.v_index, :] = body
        return np.where(used, out, np.nan)

    @cached_property
    def complete(self) -> Any:
        """Whether no other isolated solutions exist: bool, or (...) of a batch."""
        proven = self.plan.method.word != "search" and self.plan.locked == self.plan.fixed
        sure = (self._counts[:, 1] == 0) & proven & (self._counts[:, 0] >= 0)
        return bool(sure[0]) if self._lead is None else sure.reshape(self._lead)

    @property
    def late(self) -> Any:
        """Whether the time limit ended the search early: bool, or (...) of a batch.

        Then there may be other solutions.
        """
        if self._ended is None:
            return False if self._lead is None else np.zeros(self._lead, dtype=bool)
        return bool(self._ended[1][0]) if self._lead is None else self._ended[1].reshape(self._lead)

    @cached_property
    def _families(self) -> list[tuple[list[Any], np.ndarray]]:
        """Families of each target, and the family of each row (-1: none)."""
        spare = self.plan.locked != self.plan.fixed
        weak = [spare or bool(row.any()) for row in self._used_rows & (self._code % 4 >= 2)]
        none: tuple[list[Any], np.ndarray] = ([], np.full(len(self._used_rows.T), -1))
        return [self._row.families(self, i) if weak[i] else none for i in range(len(weak))]

    @property
    def families(self) -> Any:
        """Families of solutions, which are self-motions: a list of `Family`, (...) for a batch."""
        if self._lead is None:
            return self._families[0][0]
        out = np.empty(len(self._families), dtype=object)
        for i, (families, _) in enumerate(self._families):
            out[i] = families
        return out.reshape(self._lead)

    @property
    def family(self) -> np.ndarray:
        """Number of the family of each solution, (k,) or (..., K); -1 for isolated solutions."""
        return self._reshape_rows(
            np.array([rows for _, rows in self._families]).reshape(self._used_rows.shape)
        )

    @property
    def _batch_shape(self) -> tuple[int, ...]:
        """Shape of the batch of targets; () for a single target."""
        return self._lead or ()

    def _compose_sentence(self, index: tuple[int, ...]) -> str:
        i = self._count_row(index)
        if self._whole is None:
            return self._row.sentence(self, i)
        return self._whole._compose_sentence(index) + (
            "" if self._left_out is None else self._left_out[i]
        )

    success = by_code

    @cached_property
    def code(self) -> Any:
        """Status (...) of each target: solved where a solution is inside the limits.

        Failures are proven where the answer is `complete`.
        """
        code = compute_status_codes(self)
        return to_status(code[0]) if self._lead is None else code.reshape(self._lead)

    def _list_goals(self) -> Sequence[tuple[Any, Any, Any]]:
        return list_goals(self)

    def _select_claimed_rows(self) -> np.ndarray:
        return self.mask

    def nearest(self, index: int = 0) -> tuple[Array, float, float]:
        """Return the configuration inside the limits that is closest to a target, and its errors.

        Parameters
        ----------
        index
            Number of the target in a batch, counted along all its axes.

        Returns
        -------
        tuple
            Configuration (nq,), position error in metres, and rotation error in radians.
        """
        if not 0 <= index < len(self._rows):
            raise InputError(
                f"index is {index}; there are {format_count(len(self._rows), 'target')}, from 0"
            )
        return self._row.nearest(self, index)

    def select_solutions(self, expand_turns: bool, inside_only: bool) -> Solutions:
        """Return the answer with every turn inside the limits, or only with solutions inside."""

        rows = self._rows
        if inside_only:
            rows = select_inside_rows(rows, self.single)
        if expand_turns:
            rows = expand_rows(rows, self.plan.lines)
        return self._replace_rows(rows, self)

    def along(self) -> Solutions:
        """Return the batch with rows ordered so that each row follows one branch along the targets.

        Along the last axis of the targets.

        Where branches have names (`branch`), rows do so already; others are matched by the smallest
        change of the joints from one target to the next. A branch that ends leaves its row to the
        next one that begins.
        """

        if self._lead is None or not self._lead:
            return self
        rows = follow_branches(self._rows, self.plan.lines, self._lead[-1])
        return self._replace_rows(rows, self._whole, self._left_out)

    def _replace_rows(
        self, rows: Array, whole: Solutions | None, left_out: np.ndarray | None = None
    ) -> Solutions:
        """Return the same answer with other rows.

        Sentences describe the answer `whole`, and `left_out` what was left out.
        """
        out = Solutions(
            self._problem,
            self.plan,
            self._base,
            rows,
            self._counts,
            self._lead,
            None,
            *self._held_values,
            late=self._ended,
        )
        out._whole = whole
        out._left_out = left_out
        out._near = self._near
        return out

    row = "answers of ik_all"
    what = "targets reached"
    _entries = (
        "complete",
        "late",
        "inside",
        "multiplicity",
        "branch",
        "names",
        "condition",
        "held",
        "spare",
        "tried",
    )

    def _make_headline(self) -> str:
        text = super()._make_headline() + (
            "" if self.single else f", {format_count(int(self._used_rows.sum()), 'solution')}"
        )
        return f"{text}; {self._row.held(self)}" if self.spare and not self.single else text

    def _make_tables(self) -> Sequence[Table]:
        """Table with one row for each solution: coordinates of the chain, and remarks."""
        if not self.mask.any():
            return []
        targets = np.nonzero(self.mask.reshape(-1, self.mask.shape[-1]))[0].tolist()
        columns = [x[self.mask] for x in (self.q, self.names, self.inside, self.multiplicity)]
        places = self.plan.lines.q_index.tolist()
        rows: list[tuple[Any, ...]] = []
        for target, q, *facts in zip(targets[:ROWS], *columns, strict=False):
            first = () if self.single else (target,)
            rows.append((*first, *self._list_quantities(q, places), _format_remark(*facts)))
        heads: list[str] = [self.system.coordinate_names[i] for i in places]
        heads = [*([] if self.single else ["target"]), *heads, "note"]
        if not any(row[-1] for row in rows):
            rows = [row[:-1] for row in rows]
            heads = heads[:-1]
        return [Table(heads, rows, more=len(targets) - len(rows), printed=self.single)]

    def _list_notes(self, degrees: bool = False) -> Sequence[str]:
        families = self.families if self.single else ()
        return [*(f"family: {family}" for family in families), *super()._list_notes()]

    def _collect_data(self) -> dict[str, Any]:
        families = [
            {
                "freedoms": family.freedoms,
                "joints": list(family.joints),
                "closed": bool(family.closed),
                "text": str(family),
                "q": self._name_coordinates(family.q),
            }
            for family in (self.families if self.single else ())
        ]
        unit = list_units(self.system)
        held = {name: Quantity(x, unit[name]) for name, x in self.held.items()}
        goal = {"frame": self.problem.frame, "task": self.problem.task}
        out = goal | super()._collect_data() | {"held": held}
        return out | {"families": families} if self.single else out


def _format_remark(name: str, inside: bool, multiplicity: int) -> str:
    """Format the remark on a solution: branch, limits, multiplicity."""
    notes = [name] if name else []
    notes += [] if inside else ["outside limits"]
    many = f"{multiplicity} roots" if multiplicity else "one of a family"
    return ", ".join([*notes, *([] if multiplicity == 1 else [many])])
