"""Answers of `ik`: configurations, their errors, and sentences on success or failure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from kempe.answers.answer import Answer, Row
from kempe.answers.tables import list_target_columns
from kempe.arguments import explain_method_errors, read_batch_index
from kempe.arrays import unwrap_scalar
from kempe.equations.slip import has_velocity_constraints
from kempe.errors import InputError
from kempe.late import import_late_member
from kempe.report import Report
from kempe.spatial import Array
from kempe.status import PROOFS, Status
from kempe.words import cut_lines, format_count

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kempe.inverse.chain.problem import FrameProblem
    from kempe.model.model import Model


@dataclass(frozen=True)
class SolutionRow(Row):
    """Functions that describe answers of `ik`."""

    proofs: Callable[[Any, tuple[int, ...]], tuple[Any, ...]]
    """What proves that there is no answer for one target."""
    derive: Callable[[Any], Any]
    """How answers move with their targets."""
    analyse: Callable[[Any], tuple[int, int, int, Array]]
    """Equations, freedoms, rank of the equations and self-motions of one answer."""


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Solution(Answer):
    """Answer of `ik` for targets of a frame: one configuration for each target.

    All fields have the leading shape of the targets; for a single target they are plain Python
    numbers. In a batch, the nearest configurations to targets that are proven out of reach are
    computed when `q`, an error, `iterations`, `starts` or `status` is first read. `success`, `code`
    and `proven` need no search.

    Attributes
    ----------
    q
        Configurations (..., nq): solutions where `success`, else the nearest configurations found
        inside the limits. NaN for targets that are not finite.
    position_error
        Distances in metres, by the forward model.
    orientation_error
        Rotation angles in radians, by the forward model; 0 for positions.
    iterations, starts
        Numbers of steps and of starts.
    """

    row = "answers of ik"
    what = "targets reached"
    _entries = ("position_error", "orientation_error", "iterations", "starts")

    q: Array
    success: Any
    code: Any
    position_error: Any
    orientation_error: Any
    iterations: Any
    starts: Any
    problem: Any
    """The problem that was solved, a `FrameProblem`; of several tasks their `Demands`."""
    history: ClassVar[IkHistory | None] = None
    """The iterates, an `IkHistory`, where `ik` was given ``history=True``."""

    if not TYPE_CHECKING:  # a type checker would take any name for a field

        def __getattr__(self, name: str) -> Any:
            """Compute the fields that `_later`, a function and its arguments, gives on demand."""
            later = self.__dict__.get("_later")
            if later is None or name not in self.__dataclass_fields__:
                return object.__getattribute__(self, name)  # the error as it was
            function, given = later
            self.__dict__.update(function(*given))
            self.__dict__.pop("_later", None)
            return self.__dict__[name]

    @cached_property
    def residual(self) -> Any:
        """Error (...) of each configuration: norm of position error [m] and rotation error [rad]."""
        return unwrap_scalar(np.hypot(self.position_error, self.orientation_error))

    @property
    def proven(self) -> Any:
        """Mask (...) of targets proven to have no solution.

        Proofs rest on link lengths, on two contradicting tasks, or on limits that exclude all
        solutions. Without a proof, a failure means that no start found a solution.
        """
        out = np.array(np.isin(self.code, PROOFS))
        for index in np.argwhere(np.asarray(self.code) == Status.NOT_FOUND):
            out[tuple(index)] = bool(self._list_row_proofs(tuple(index.tolist())))
        return unwrap_scalar(out)

    def proofs(self, index: tuple[int, ...] | int = ()) -> tuple[Any, ...]:
        """Return the proofs that one target has no solution.

        Parameters
        ----------
        index
            Place of the target in a batch.

        Returns
        -------
        tuple of Evidence
            Each has figures and a `text` (`kempe.answers.evidence`). Empty without a proof.

        Raises
        ------
        InputError
            For a place outside the batch.
        """
        return self._list_row_proofs(read_batch_index(index, self._batch_shape))

    def _list_row_proofs(self, index: tuple[int, ...]) -> tuple[Any, ...]:
        return self._row.proofs(self, index)

    @property
    def system(self) -> Model:
        """The system of the problem."""
        return self.problem.system

    @cached_property
    def _local_analysis(self) -> tuple[int, int, int, Array]:
        """(m, n, rank, basis): equations, freedoms, rank, and an orthonormal basis of self-motions."""
        if np.ndim(self.success):
            raise InputError(
                "m, n, rank and self_motion are those of one answer: ask for one problem, not for "
                "a batch"
            )
        return self._row.analyse(self)

    @property
    def m(self) -> int:
        """Number of equations of the hard tasks, without inequalities."""
        return self._local_analysis[0]

    @property
    def n(self) -> int:
        """Number of freedoms of the joints that move the tasks' frames, directly or through loops.

        At the answer.

        Their velocity coordinates, less the rank of the loops and relations that these are in.
        """
        return self._local_analysis[1]

    @property
    def rank(self) -> int:
        """Rank of the Jacobian of the hard tasks at the answer.

        It is restricted to velocities that keep the loops closed.
        """
        return self._local_analysis[2]

    @property
    def redundancy(self) -> int:
        """Number of freedoms that the hard tasks leave to the joints, n - rank."""
        return self.n - self.rank

    @property
    def self_motion(self) -> Array:
        """Orthonormal basis (nv, k) of velocities that keep loops and tasks.

        In radians and characteristic lengths.
        """
        return self._local_analysis[3]

    def _list_goals(self) -> Sequence[tuple[Any, Any, Any]]:
        from kempe.answers.targets import make_target_constraints
        from kempe.equations.tasks import Task

        problem: FrameProblem = self.problem
        X = np.reshape(problem.targets, (*np.shape(self.success), 4, 4))
        made = make_target_constraints(problem.frame, problem.name, problem.axis, X)
        return [(Task(problem.system, c), None, problem.tolerance) for c in made]

    def _list_outcomes(self) -> dict[str, np.ndarray]:
        return self._list_errors() | self._list_targets()

    def _list_errors(self) -> dict[str, np.ndarray]:
        """Return success and errors (n,) of each row as columns of the `table`."""
        names = ("success", "position_error", "orientation_error")
        return {name: np.ravel(getattr(self, name)) for name in names}

    def _list_targets(self) -> dict[str, np.ndarray]:
        """Return the targets (n,) of each row as columns of the `table`."""
        X = np.reshape(self.problem.targets, (-1, 4, 4))
        return list_target_columns(self.system.dim, X, self.problem.name == "position")

    def plot_history(self, ax: Any = None) -> Any:
        """Plot the errors over the steps on Matplotlib axes.

        For answers of ``ik(..., history=True)``.
        """
        if self.history is None:
            raise InputError("this answer has no history; ask for it by ik(..., history=True)")
        return self.history.plot(ax)

    @cached_property
    def derivative(self) -> Any:
        """Derivatives dq (..., nv, 6) for a twist [linear; angular] of the target.

        See `kempe.inverse.derivative`.
        """
        return self._row.derive(self)

    def _compose_sentence(self, index: tuple[int, ...]) -> str:
        return self._row.sentence(self, index) + self._describe_manoeuvre(index)

    def _describe_manoeuvre(self, index: tuple[int, ...]) -> str:
        """End a success sentence: under velocity constraints, that driving there needs a manoeuvre."""
        if not np.asarray(self.success)[index] or not has_velocity_constraints(self.system):
            return ""
        return import_late_member("way_there")(self.system)


# ---- the answer for several tasks


class Closest(NamedTuple):
    """The pair of bodies of each problem that comes closest to what a clearance asks.

    Attributes
    ----------
    pairs
        Names of two bodies for each problem, in the order of the flattened batch; None where no
        pair is near.
    distance, at_least
        Their distances (n,) in metres, and those that are asked; infinite and 0 where no pair is
        near.
    """

    pairs: tuple[tuple[str, str] | None, ...]
    distance: Array
    at_least: Array

    @classmethod
    def from_rows(cls, rows: Sequence[tuple[str, str, float, float] | None]) -> Closest:
        """Make it from the names, the distance and the least distance of each problem."""
        return cls(
            tuple(None if r is None else r[:2] for r in rows),
            np.array([np.inf if r is None else r[2] for r in rows]),
            np.array([0.0 if r is None else r[3] for r in rows]),
        )


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Reached(Solution):
    """Answer of `System.ik` for tasks.

    Attributes
    ----------
    q, success, iterations, starts
        As in `Solution`.
    position_error, orientation_error
        Largest errors of the hard tasks, in metres and radians.
    errors
        Errors (..., 2) in metres and radians by the label of each task.
    late
        Mask (...) of the searches that the time limit ended, including those that minimise soft
        tasks and preferences.
    closest
        The pair of bodies nearest to what clearances ask; None without clearances.
    """

    row = "answers of ik, tasks"
    what = "problems solved"

    errors: dict[str, Array]
    late: Any
    closest: Closest | None = None

    @property
    def _closed_system(self) -> Any:
        return self.problem.packed.closing

    def _list_goals(self) -> Sequence[tuple[Any, Any, Any]]:
        return self.problem.hard_tasks

    def _list_targets(self) -> dict[str, np.ndarray]:
        return {}

    @cached_property
    def derivative(self) -> dict[str, Array]:
        """Derivatives dq (..., nv, k) for motions of the goal of each task, by the task's label.

        See `kempe.inverse.derivative`.
        """
        return self._row.derive(self)


# ---- iterates of the numerical search

MOST_STARTS = 64
"""Starts whose iterates are kept: those of more fill no picture."""
MOST_LINES = 32
"""Lines of the text."""


@dataclass(frozen=True, eq=False, repr=False)
class IkHistory(Report):
    """Errors of a search after each of its steps, one row each.

    `q` (k, nq) is the nearest configuration that its start had found by then (steps that lead away
    are taken, too, and repeat the row before), `position_error` (k,) in metres, `orientation_error`
    (k,) in radians, `start` (k,) the number of the start, `step` (k,) that of the step in it: 0 is
    where it began.
    """

    _entries = ("q", "position_error", "orientation_error", "start", "step", "starts")

    system: Model
    q: Array
    position_error: Array
    orientation_error: Array
    start: np.ndarray
    step: np.ndarray
    starts: int
    """How many starts there were; of the first 64 there are rows."""

    @property
    def errors(self) -> Array:
        """Position and orientation error (k, 2) after each step."""
        return np.stack([self.position_error, self.orientation_error], axis=-1)

    @property
    def status(self) -> str:
        """Numbers of steps and starts, and how the errors fell."""
        last = (
            f"{self.position_error[-1]:.2g} m"
            + f" and {self.orientation_error[-1]:.2g} rad" * self._has_orientation
        )
        kept = "" if self.starts <= MOST_STARTS else f", the first {MOST_STARTS} of {self.starts}"
        count = int(self.start[-1]) + 1
        return (
            f"{format_count(len(self.q) - count, 'step')} of {format_count(count, 'start')}{kept}: "
            f"at last {last}"
        )

    @property
    def _has_orientation(self) -> bool:
        """Whether the task has an orientation error."""
        return bool(np.any(self.orientation_error > 0.0))

    def _list_notes(self, degrees: bool = False) -> list[str]:
        rows = list(
            zip(self.start, self.step, self.position_error, self.orientation_error, strict=True)
        )
        if self.start[-1] > 0:  # of each of several starts the last step
            rows = [rows[k] for k in (*(np.flatnonzero(np.diff(self.start))), -1)]
        lines = [
            f"start {s}, step {k}: {p:.3g} m" + f", {a:.3g} rad" * self._has_orientation
            for s, k, p, a in rows
        ]
        return cut_lines(lines, MOST_LINES)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Plot the errors over the steps on Matplotlib axes, one line for each start.

        See `kempe.views.plots.plot_history`.

        The iterates themselves are drawn by ``system.plot(history.q)``.
        """
        return import_late_member("plots").plot_history(self, ax)
