"""Base classes of the answers of solvers: configurations, their errors, and an independent check."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from kempe.answers.tables import TARGET_UNITS, Tabular, convert_columns
from kempe.arguments import explain_method_errors, read_batch_index
from kempe.arrays import is_whole, unwrap_scalar
from kempe.equations.judge import Judgement, judge_configurations
from kempe.errors import CallError, InputError, NoSolutionError, UnknownNameError, format_value
from kempe.forward.fk import fk
from kempe.late import import_late_member
from kempe.model.configurations import list_limits, list_units, make_ranges_table, name_values
from kempe.numerics.clock import describe_early_end
from kempe.report import MOST_JUDGED, ROWS, Nearest, Result, Table
from kempe.spatial import Array
from kempe.status import Status
from kempe.units import name_lengths
from kempe.words import ByName, Quantity, format_share, join_first_words, make_plural

if TYPE_CHECKING:
    from kempe.answers.problem import Choice
    from kempe.model.model import FrameLike


REASONS = 5
"""Rows of a batch of which a text says why they have no answer."""


@dataclass(frozen=True)
class Row:
    """Functions of the verb that gave an answer: its sentence and its solver."""

    sentence: Callable[[Any, Any], str]
    """The sentence for one target, by its index in the batch."""
    choice: Callable[[Any], Choice | None]
    """Which solver answers such problems: of bound calls, whose answers do not keep the choice."""


@explain_method_errors
class Answer(Result, Tabular):
    """Base of answers with configurations of a system.

    A batch behaves as a list of configurations: it has a length, ``answer[k]`` is row k of `q`, and
    ``for q in answer`` visits all rows. The method `sentence` gives the text for an outcome.

    Attributes
    ----------
    system
        The system.
    q
        Configurations (..., nq) in radians and metres. Rows without `success` are the nearest
        configurations found, or NaN if there are none, as for input that is not finite.
    success
        Mask (...) of the rows that are answers.
    """

    system: Any
    """The `System` of the problem: a field of some answers, a property of others."""
    q: Any
    """Configurations (..., nq): a field of most answers, computed on demand by others."""
    what: ClassVar[str] = ""
    """What is counted of a batch: "3 of 4 targets reached"."""
    row: ClassVar[str] = ""
    """Name of its `Row` in `kempe.late`; "" where the class says all of it."""
    _has_angles = True
    is_motion: ClassVar[bool] = False
    """Whether the rows of `q` are passed one after the other."""

    @classmethod
    def from_fields(cls, **fields: Any) -> Self:
        """Make an answer from its fields, in a fraction of the time that a frozen class takes."""
        out = object.__new__(cls)
        out.__dict__.update(fields)
        return out

    @property
    def within(self) -> Nearest | None:  # type: ignore[override]
        """Nearest mechanism that closes exactly; None if the answer is for the given mechanism."""
        return self._closed_system._ideal

    @property
    def _closed_system(self) -> Any:
        """`System` whose loops the configurations `q` close; frames are those of `system`."""
        return self.system

    def sentence(self, index: tuple[int, ...] | int = ()) -> str:
        """Return the sentence for one target, given its index in the batch. Errors: `InputError`."""
        said = self._compose_sentence(read_batch_index(index, self._batch_shape))
        return name_lengths(said, self._unit)

    @property
    def _batch_shape(self) -> tuple[int, ...]:
        """Leading shape of a batch of answers; () for a single answer."""
        return np.shape(self.code)

    @property
    def _row(self) -> Any:
        """The `Row` of functions of the verb that gave this answer."""
        return import_late_member(self.row)

    def _count_row(self, index: tuple[int, ...]) -> int:
        """Count along all axes of the batch, which row has this index; 0 for a single answer."""
        return int(np.ravel_multi_index(index, self._batch_shape)) if index else 0

    def _compose_sentence(self, index: tuple[int, ...]) -> str:
        """Compose the sentence for one target, given its index in the batch."""
        return self._row.sentence(self, index)

    @cached_property
    def status(self) -> Any:
        """Sentence for a single answer; an array of sentences for a batch. Computed on demand."""
        more = "" if self.within is None else f"; {self.within.sentence}"
        if not self._batch_shape:
            return name_lengths(self._compose_sentence(()) + more, self._unit)
        out = np.empty(self._batch_shape, dtype=object)
        for index in np.ndindex(out.shape):
            out[index] = name_lengths(self._compose_sentence(index) + more, self._unit)
        return out

    # ---- what is missed

    @cached_property
    def residual(self) -> Any:
        """Largest error (...) of each configuration `q` [m, rad], over all constraints and targets.

        It is NaN for configurations that are no numbers.
        """
        return unwrap_scalar(np.linalg.norm(self.judged.errors, axis=-1).max(axis=0, initial=0.0))

    @cached_property
    def judged(self) -> Judgement:
        """Errors of `q` in all constraints and targets, verified independently in numpy, on demand.

        It shares nothing with the equations by which kernels say `success`.
        """
        return judge_configurations(
            self.system,
            self.q,
            self._list_goals(),
            self._get_solver_residual(),
            self._list_times(),
            self._closed_system,
        )

    def _list_times(self) -> Any:
        """List the times (...) [s] at which equations in time must hold at `q`; 0 without time."""
        return 0.0

    def _list_goals(self) -> Sequence[tuple[Any, Any, Any]]:
        """List the tasks that must hold, each with its goal and its tolerances."""
        return ()

    def _get_solver_residual(self) -> Any:
        """Return the residual (...) of the equations of successful rows, as the solver reports it."""
        return 0.0

    def _select_claimed_rows(self) -> np.ndarray:
        """Return a mask (...) of the rows of `q` that the solver reports as solutions."""
        return np.asarray(self.success)

    @property
    def verdict(self) -> str:
        """Result of the independent check of the successful rows, as a sentence; '' without rows.

        Of a batch only what contradicts a success is said.
        """
        claimed = self._select_claimed_rows()
        if not claimed.any() or not self.judged.names:
            return ""
        false = int((claimed & ~np.asarray(self.judged.holds)).sum())
        if self._batch_shape:
            return f"{false} are contradicted by an independent check" if false else ""
        said = self.judged.of(claimed)
        text = f"success is contradicted; {said}" if false else str(said)
        return name_lengths(text, self._unit)

    # ---- as a picture, as a table, as text, as data

    @property
    def titles(self) -> tuple[str, ...]:
        """Names of the configurations in pictures; () if the configurations have no names."""
        return ()

    def plot(self, **options: Any) -> Any:
        """Draw the configurations, or the motion, on Matplotlib axes; options as for `System.plot`."""
        return import_late_member("plots").plot(self.system, self, **options)

    def plot_curve(self, names: Sequence[str] = (), ax: Any = None) -> Any:
        """Plot the coordinates over arc length, time, or the row number, on Matplotlib axes.

        `names` are those that are drawn, all by default. Errors: `UnknownNameError`.
        """
        return import_late_member("plots").plot_path(self, names=names, ax=ax)

    def animate(self, file: Any, **options: Any) -> Any:
        """Write the configurations as an animation (.gif, .mp4, .html).

        The options are those of `System.animate`.
        """
        return import_late_member("films").animate(self.system, self, file, **options)

    def _list_columns(self) -> tuple[list[str], Array]:
        """Return names and columns (n, nq): the coordinates of each row of `q` [rad, m]."""
        return list(self.system.coordinate_names), np.reshape(self.q, (-1, self.system.nq))

    def _list_units(self) -> dict[str, str]:
        """Return the unit of each coordinate, and of each angle of a target, by its name."""
        return TARGET_UNITS | list_units(self.system)

    def _list_dataframe_rows(self, degrees: bool) -> tuple[Sequence[str], Any]:
        """Return the columns of the `table`, with angles in radians or degrees; masks are bools."""
        names, columns = self.table()
        _, columns = convert_columns(names, columns, self._list_units(), degrees)
        kinds = {name: x.dtype for name, x in self._list_outcomes().items()}
        for name in self.system.coordinate_names:
            kinds.pop(name, None)
        return names, {
            name: column.astype(kinds.get(name, float))
            for name, column in zip(names, columns.T, strict=True)
        }

    def expect(self) -> Self:
        """Return the answer itself if it is a success.

        Errors: `NoSolutionError` otherwise, with the answer as its `solution`.
        """
        if not self:
            raise NoSolutionError(self)
        return self

    @property
    def solver(self) -> Choice | None:
        """Solver that answered, and why the solvers before refused; None if no choice was made."""
        return self.__dict__.get("_choice") or (self._row.choice(self) if self.row else None)

    def __len__(self) -> int:
        self._refuse_single_answer()
        return len(self.success)

    def __iter__(self) -> Iterator[Array]:
        self._refuse_single_answer()
        return iter(self.q)

    def __getitem__(self, k: Any) -> Array:
        self._refuse_single_answer()
        return select_rows(self.q, k)

    def _refuse_single_answer(self) -> None:
        """Refuse to treat the answer to one problem as a list. Errors: `CallError`."""
        if not self._batch_shape:
            name = type(self).__name__
            raise CallError(
                name,
                "it is the answer to one problem and no list: its configuration is `q`; a batch of "
                "problems has a row for each",
            )

    def _make_headline(self) -> str:
        """Return the first line of the text: the sentence, or the number of successes of a batch."""
        if self._batch_shape:
            return format_share(int(np.sum(self.success)), np.size(self.success), self.what)
        return self.status

    def _make_tables(self) -> Sequence[Table]:
        """Make the table of a configuration by coordinate, with limits; of a batch one row each."""
        if self._batch_shape or np.ndim(self.q) != 1:
            each = np.size(self.success) and np.ndim(self.q) == len(self._batch_shape) + 1
            return [self._make_batch_table()] if each and self._batch_shape else []
        names = self.system.coordinate_names
        limits = list_limits(self.system).values()
        rows = list(
            zip(names, self._list_quantities(self.q), limits, self._mark_coordinates(), strict=True)
        )
        title = "coordinate" if self.success else "nearest found"
        return [Table((title, "value", "limits", ""), rows, record=True)]

    def _make_batch_table(self) -> Table:
        """Make the table of a batch, with one configuration in each row."""
        first = list(islice(np.ndindex(self._batch_shape), ROWS))
        rows = [
            (
                index[0] if len(index) == 1 else _format_row_number(index),
                "yes" if np.asarray(self.success)[index] else "no",
                *self._list_quantities(self.q[index]),
            )
            for index in first
        ]
        heads = ("row", self.what.split()[-1], *self.system.coordinate_names)
        return Table(heads, rows, more=int(np.size(self.success)) - len(rows), printed=False)

    def _list_quantities(self, q: Array, places: Sequence[int] | None = None) -> list[Quantity]:
        """List the values of a configuration (nq,) with their units, of all or of some coordinates.

        `places` are the indices of these coordinates.
        """
        names = self.system.coordinate_names
        unit = list_units(self.system)
        each = range(len(names)) if places is None else places
        return [Quantity(float(q[i]), unit[names[i]]) for i in each]

    def _mark_coordinates(self) -> Sequence[str]:
        """Return a remark about each coordinate of a single configuration; '' without one."""
        return [""] * self.system.nq

    def _list_notes(self, degrees: bool = False) -> Sequence[str]:
        """List the last lines of the text: reasons of failures, and the independent check."""
        verdict = self.verdict if self._is_judged() else ""
        return [*self._list_reasons(), *([verdict] if verdict else [])]

    def _list_reasons(self) -> list[str]:
        """Explain why the first failed rows of a batch have no answer, and list the others."""
        if not self._batch_shape:
            return []
        missed = list(zip(*np.nonzero(~np.asarray(self.success)), strict=True))
        lines = [
            f"row {_format_row_number(index)}: {self.sentence(tuple(map(int, index)))}"
            for index in missed[:REASONS]
        ]
        if more := [_format_row_number(index) for index in missed[REASONS:]]:
            lines.append(f"and {make_plural(len(more), 'row')} {join_first_words(more, 12)}")
        return lines

    def _is_judged(self) -> bool:
        """Whether the answer is small enough to be verified for its text and `data`."""
        return np.size(self.q) <= MOST_JUDGED

    def _collect_head_data(self) -> dict[str, Any]:
        """Return the first entries of the `data`: the names of the system and of the solver."""
        solver = {} if self.solver is None else {"solver": self.solver.name}
        return {"system": self.system.name} | solver

    def _collect_data(self) -> dict[str, Any]:
        """Return the entries of the `data`: residual, independent check, configurations."""
        out = super()._collect_data() | {"residual": np.asarray(self.residual).tolist()}
        if self._is_judged():
            out["judged"] = self.judged.data()
        return out | {"q": self._name_coordinates(self.q)}

    def _name_coordinates(self, q: Array) -> ByName:
        """Return configurations (..., nq) by the names of the coordinates."""
        return name_values(self.system, q)


def _format_row_number(index: Sequence[int]) -> str:
    """Format the index of a row of a batch: '3', or '0, 2' for a batch with two dimensions."""
    return ", ".join(map(str, index))


class ConfigurationList:
    """List of configurations `q` (n, ...), with length, indexing and iteration.

    A base of answers that may have many configurations.
    """

    q: Any

    def __len__(self) -> int:
        return len(self.q)

    def __iter__(self) -> Iterator[Array]:
        return iter(self.q)

    def __getitem__(self, k: Any) -> Array:
        return select_rows(self.q, k)


def select_rows(q: Array, k: Any) -> Array:
    """Return rows of configurations (n, ..., nq) by a number, a slice or an index array.

    Errors: `InputError`, `IndexError`.
    """
    try:
        return q[k]
    except IndexError:
        if is_whole(k):  # where an iteration ends
            raise
        raise InputError(
            f"index is {format_value(k)}; it must be a whole number, a slice or an array of these"
        ) from None


@explain_method_errors
class Configurations(ConfigurationList, Answer):
    """Base of answers with several configurations for one call: all solutions, or a path.

    Attributes
    ----------
    q
        Configurations (n, nq).
    late
        Whether the time limit ended the work; `q` is then what was found by then.
    interrupted
        Whether Ctrl-C ended the work. Such an answer is in the `answer` of the `Interrupted` that
        the verb raises.
    """

    interrupted: bool
    late: bool
    reason: str

    @property
    def code(self) -> Any:
        """Outcome of the computation, a `Status`."""
        if self.success:
            return Status.SOLVED
        return self._find_early_end() or (Status.PARTLY if len(self) > 1 else Status.NOT_FOUND)

    def _find_early_end(self) -> Status | None:
        """Return the `Status` of a computation that an interrupt or time limit ended, else None."""
        return Status.INTERRUPTED if self.interrupted else Status.OUT_OF_TIME if self.late else None

    def _describe_early_end(self) -> str:
        """Describe that the computation ended early, as the end of a sentence; '' if it did not."""
        return describe_early_end(self.interrupted, self.late)

    def _select_claimed_rows(self) -> np.ndarray:
        return np.full(len(self), bool(self.success) or len(self) > 1)

    def _compose_sentence(self, index: tuple[int, ...]) -> str:
        return self.reason

    def _make_headline(self) -> str:
        return f"{self.system.name}: {self.status}"

    def _make_tables(self) -> Sequence[Table]:
        return []


@explain_method_errors
class Motion(Configurations):
    """Motion of a `system`: a sequence of configurations `q` (n, nq).

    Base of motions.
    """

    is_motion = True

    def curve(self, frame: FrameLike, poses: bool = False) -> Array:
        """Return positions (n, 3) [m], or poses (n, 4, 4), of a frame along the motion."""
        X = fk(self.system, self.q, frame)
        return X if poses else X[:, :3, 3].copy()

    def values(self, coordinate: str) -> Array:
        """Return the values (n,) of one coordinate along the motion [rad or m]."""
        names = self.system.coordinate_names
        if coordinate not in names:
            raise UnknownNameError("coordinate", coordinate, names, self.system.name)
        return self.q[:, names.index(coordinate)].copy()

    def _make_tables(self) -> Sequence[Table]:
        """Make the table of the range of each coordinate."""
        if len(self) < 2:
            return []
        return [make_ranges_table(self.system, self.q)]

    def _make_columns(
        self, first: str, column: Array, frames: Iterable[FrameLike]
    ) -> tuple[list[str], Array]:
        """Return names and columns (n, k) of a table along the motion.

        Its columns: `column` with the name `first`, all coordinates, and x, y (and z) of each
        frame.
        """
        names = [first, *self.system.coordinate_names]
        columns = [column[:, None], self.q]
        axes = "xyz"[: self.system.dim]
        for frame in [frames] if isinstance(frames, str) else frames:
            names += [f"{self.system.structure.frame_name(frame)}.{axis}" for axis in axes]
            columns.append(self.curve(frame)[:, : len(axes)])
        return names, np.hstack(columns)
