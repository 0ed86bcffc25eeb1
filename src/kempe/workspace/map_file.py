"""The verb `map_file`: a verb applied to all rows of a large file, with the answers on disk.

Answers form a Zarr group that fills up chunk by chunk, each with a checksum; a run that was
interrupted goes on where it ended.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.answers.tables import PLACE, QUATERNION, describe_target_columns, read_pose_columns
from kempe.answers.targets import choose_task
from kempe.arguments import (
    check_name,
    draw_seed,
    explain_errors,
    explain_method_errors,
    raise_interrupted,
    read_flag,
    read_names,
)
from kempe.assemble.assemble import assemble
from kempe.budget import Budget, Usual
from kempe.description.source import expand_path
from kempe.errors import UNREADABLE, DamagedError, InputError
from kempe.forward.fk import fk
from kempe.inverse.ik import ik
from kempe.inverse.ik_all import ik_all
from kempe.kernels.compiled import VARIANT
from kempe.model.configurations import has_loops, list_units, make_q, read_q, read_start
from kempe.numerics.clock import BROKEN_OFF, TimeLimit, describe_early_end
from kempe.numerics.pool import choose_thread_count
from kempe.report import Report, Table
from kempe.spatial import Array
from kempe.status import MEMBERS, Status
from kempe.version import __version__
from kempe.words import format_count, to_json_data
from kempe.workspace.row_sources import RowSource, open_rows
from kempe.workspace.store import (
    add_array,
    find_chunk_file,
    format_description,
    import_zarr,
    make_disk_error,
    refuse_other_map,
    refuse_place,
    refuse_small_disk,
    restore_former_map,
    write_group,
)
from kempe.workspace.workers import (
    Pace,
    connect_client,
    iterate_results,
    refuse_kernels,
    work_in_threads,
)

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model


# ---- verbs over rows

# What a row is to each verb, and what the verb answers, as arrays with named axes.

Arrays = dict[str, Any]


@dataclass(frozen=True)
class RowJob:
    """A verb of a system with its options and the meaning of rows: all that an answer depends on.

    `tail` is the shape of a row and `columns` their names, None where they have none.
    """

    system: Model
    verb: str
    frame: str | None
    options: dict[str, Any]
    tail: tuple[int, ...]
    columns: tuple[str, ...] | None
    degrees: bool = False
    rng: int = 0
    variant: str = VARIANT
    version: str = field(default=__version__)

    def describe_job(self) -> dict[str, Any]:
        """Describe the job as data that are stored with a map and must agree to continue it.
        Errors: `InputError`.
        """
        try:
            options = json.loads(json.dumps(to_json_data(self.options)))
        except (TypeError, ValueError):
            raise InputError(
                "options hold more than numbers and names, which cannot be written beside a map"
            ) from None
        return {
            "system": self.system.structure.content_hash,
            "verb": self.verb,
            "frame": self.frame,
            "options": options,
            "columns": None if self.columns is None else list(self.columns),
            "row": list(self.tail),
            "degrees": self.degrees,
            "rng": self.rng,
            "variant": self.variant,
            "version": self.version,
        }

    def answer_rows(self, rows: Array) -> Arrays:
        """Answer rows (n, *tail) in one thread, as arrays with n rows. Errors: `KernelsError`."""
        refuse_kernels(self.variant, self.version)
        answers = VERBS[self.verb].answers(self, rows)
        return {name: np.asarray(x, dtype=TYPES.get(name)) for name, x in answers.items()}

    @cached_property
    def answer_layout(self) -> dict[str, np.ndarray]:
        """Shapes and types of the answer arrays, without rows. Errors: those of the verb."""
        return self.answer_rows(np.zeros((0, *self.tail)))

    @property
    def row_bytes(self) -> list[int]:
        """Bytes of the answer to one row, for each array."""
        return [a.itemsize * int(np.prod(a.shape[1:])) for a in self.answer_layout.values()]

    # ---- what a row is

    def read_configurations(self, rows: Array) -> Array:
        """Read rows as configurations (n, nq), with all coordinates in order or some by name.
        Errors: `InputError`.
        """
        if self.columns is None:
            return read_q(self.system, rows)
        missing = [name for name in self.system.coordinate_names if name not in self.columns]
        if missing and has_loops(self.system):
            every = ", ".join(self.system.coordinate_names)
            raise InputError(
                f"column {missing[0]!r} is missing: give all of {every}, or compute the missing "
                f"coordinates of the loops of {self.system.name!r} first, by the verb assemble"
            )
        return make_q(self.system, self.name_columns(rows))

    def name_columns(self, rows: Array) -> dict[str, Array]:
        """Return the columns (n,) by name, angles in radians. Errors: `InputError`."""
        if self.columns is None:
            raise InputError(
                "the columns have no names: name the known coordinates by columns=(...)"
            )
        unit = list_units(self.system)
        turns = [name for name in self.columns if self.degrees and unit.get(name) == "rad"]
        return {
            name: np.radians(x) if name in turns else x
            for name, x in zip(self.columns, rows.T, strict=True)
        }

    def read_targets(self, rows: Array) -> Array:
        """Read rows as targets: poses (n, 4, 4), or positions (n, 3) if only these count. Errors:
        `InputError`.
        """
        if len(self.tail) == 2:
            if self.tail not in ((4, 4), (3, 4)):
                raise InputError(
                    f"a row is of shape {self.tail}; a target is (4, 4), (3, 4), or the columns "
                    f"{describe_target_columns(self.system.dim)}"
                )
            X = np.broadcast_to(np.eye(4), (len(rows), 4, 4)).copy()
            X[:, : self.tail[0]] = rows
            return X
        X, position = read_pose_columns(self.system.dim, rows, self.columns, self.degrees)
        task = self.options.get("task")
        if isinstance(task, str):
            choose_task(task, position, False)
        if position and task not in (None, "position"):
            raise InputError(
                f"task {task!r} needs targets with an orientation; they have x, y, z only"
            )
        return np.ascontiguousarray(X[:, : self.system.dim, 3]) if position else X

    def label_axes(self) -> dict[str, list[str]]:
        """Return the labels along the axes that have names."""
        q = list(self.system.coordinate_names)
        unit = list_units(self.system)
        return {
            "coordinate": q,
            "unit": [unit[name] or "1" for name in q],
            "body": list(self.system.body_names),
            "axis": list(PLACE),
            "component": [*PLACE, *QUATERNION],
        }


class Verb(NamedTuple):
    """A verb for rows: its function, its options, and the largest number of rows for one call."""

    answers: Callable[[RowJob, Array], Arrays]
    options: tuple[str, ...]
    rows: int
    needs_frame: bool = True


def _answer_fk(job: RowJob, rows: Array) -> Arrays:
    """Compute the poses of rows by forward kinematics."""
    X = fk(job.system, job.read_configurations(rows), job.frame, threads=1, **job.options)
    form = job.options.get("form") or "matrix"
    finite = np.isfinite(X).all(axis=tuple(range(1, X.ndim)))
    return {
        "pose" if form in ("matrix", "3x4") else form: X,
        "code": np.where(finite, Status.SOLVED, Status.BAD_INPUT),
    }


def _answer_ik(job: RowJob, rows: Array) -> Arrays:
    """Solve the inverse kinematics of rows."""
    budget = Budget(rng=job.rng, threads=1)
    answer = ik(job.system, job.read_targets(rows), job.frame, budget=budget, **job.options)
    return select_fields(answer, "q", "code", "position_error", "orientation_error")


def _answer_ik_all(job: RowJob, rows: Array) -> Arrays:
    """Find all inverse solutions of rows."""
    if job.options.get("limits") == "turns":
        raise InputError(
            "limits='turns' gives as many solutions as there are turns; a map has room for one of "
            "each"
        )
    answer: Any = ik_all(
        job.system, job.read_targets(rows), str(job.frame), budget=Budget(threads=1), **job.options
    )
    fields = select_fields(answer, "q", "code", "residual", "inside", "complete")
    return {**fields, "count": answer.mask.sum(axis=-1)}


def _answer_assemble(job: RowJob, rows: Array) -> Arrays:
    """Assemble the mechanism for the known values of rows."""
    if job.options.get("prefer") == "continuous":
        raise InputError(
            "prefer='continuous' goes row by row; a map has its rows answered side by side"
        )
    budget = Budget(rng=job.rng, threads=1)
    answer = assemble(job.system, job.name_columns(rows), budget=budget, **job.options)
    return select_fields(answer, "q", "code", "residual")


def select_fields(answer: Any, *names: str) -> Arrays:
    """Select fields of an answer to many rows."""
    return {name: getattr(answer, name) for name in names}


VERBS = {
    "fk": Verb(_answer_fk, ("form", "dtype"), 2**16, needs_frame=False),
    "ik": Verb(_answer_ik, ("task", "start", "method", "tolerance"), 2**12),
    "ik_all": Verb(_answer_ik_all, ("task", "start", "fixed", "limits", "tolerance"), 2**12),
    "assemble": Verb(
        _answer_assemble,
        ("start", "branch", "prefer", "limits", "tolerance"),
        2**12,
        needs_frame=False,
    ),
}
"""The verbs that files can be mapped by."""

AXES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "q": (("coordinate",), "configuration", "rad or m, see unit"),
    "pose": (("matrix_row", "matrix_column"), "pose in the ground frame", "1, the last column m"),
    "position": (("axis",), "position in the ground frame", "m"),
    "position_quat_wxyz": (
        ("component",),
        "position and unit quaternion in the ground frame",
        "m and 1",
    ),
    "code": ((), "outcome", "1"),
    "position_error": ((), "position error of the answer", "m"),
    "orientation_error": ((), "angle of the rotation between target and answer", "rad"),
    "residual": ((), "norm of what is missed", "rad and m"),
    "inside": ((), "whether the solution is inside the limits", "1"),
    "count": ((), "number of solutions", "1"),
    "complete": ((), "whether there are no other isolated solutions", "1"),
}
"""Of each array the names of its last axes, what it is, and its unit."""


TYPES = {"code": np.uint8, "count": np.uint8, "complete": np.bool_}
"""Types of arrays on disk, where they are smaller than those of answers."""


def name_axes(name: str, array: np.ndarray) -> tuple[str, ...]:
    """Name the axes of an array: rows, then an axis of several items, then its own axes."""
    own = AXES[name][0]
    several = "body" if name in ("pose", "position", "position_quat_wxyz") else "solution"
    return ("row", *([several] if array.ndim > len(own) + 1 else []), *own)


def make_job(
    system: Model,
    verb: str,
    frame: Any,
    options: Mapping[str, Any] | None,
    source: Any,
    degrees: bool,
    rng: int,
) -> RowJob:
    """Make a job for a verb with its options, checked on zero rows. Errors: `InputError`,
    `UnknownNameError`, those of the verb.
    """
    chosen = VERBS[check_name("verb", verb, VERBS)]
    given = dict(options or {})
    for name in given:
        check_name(f"option of map {verb}", name, chosen.options)
    if verb == "assemble" and frame is not None:
        raise InputError("assemble needs no frame: known are coordinates")
    if chosen.needs_frame and frame is None:
        raise InputError(f"{verb} needs a frame")
    if given.get("start") is not None:
        start = read_start(system, given["start"])
        if np.ndim(start) != 1:
            raise InputError(f"start must be one configuration ({system.nq},)")
        if not np.isfinite(start).all():
            raise InputError(f"start is {start.tolist()}; its numbers must be finite")
    name = None if frame is None else system.structure.frame_name(frame)
    job = RowJob(system, verb, name, given, source.tail, source.names, degrees, rng)
    job.describe_job()
    assert set(job.answer_layout) <= set(AXES)
    return job


# ---- the store of answers

FORMAT = "kempe rows 2"
DONE = "done"
"""The array that says of each chunk how many of its rows are answered, and the checksum of these
rows."""
LEFT = 255
"""The code of rows that are not answered yet."""
PIECES = 8
"""Pieces of a chunk, as a verb takes one at once: what is done of them is kept where the work is
stopped."""


def compute_rows_checksum(rows: Array) -> int:
    """Compute a 64-bit checksum of rows."""
    return int.from_bytes(hashlib.sha256(np.ascontiguousarray(rows).data).digest()[:8], "little")


class RowStore:
    """Store of the answers of a job, a Zarr group. Each answer is an array in chunks of the same
    number of rows.

    The entry of a chunk in the array `DONE` is written after its answers: what a process that ended
    leaves without one counts as not written. `done` are the numbers of answered rows by chunks,
    `damaged` says how many chunks were not what was written.
    """

    def __init__(self, path: Path, job: RowJob, source: RowSource, chunk: int):
        import_zarr()
        restore_former_map(path)
        refuse_place(path, FORMAT)
        self.path = path
        self.job = job
        self.source = source
        self.chunk = chunk
        self.metadata = {
            **job.describe_job(),
            "rows": source.n,
            "chunk": chunk,
            "source": source.identify_files(),
        }
        self.arrays: Arrays = {}
        self.done: dict[int, int] = {}
        self.damaged = 0

    def open_group(self, check: Callable[[], None]) -> None:
        """Open or make the group, and read all chunks that are done; `check` is called for each.

        Errors: `InputError` where the group is of another map, or the rows have changed;
        `DamagedError` where it does not describe its arrays; `DiskError`.
        """
        zarr = import_zarr()
        if not self.path.exists():
            refuse_small_disk(self.path.parent, self.source.n * sum(self.job.row_bytes))
            made = {**self.metadata, "toml": format_description(self.job.system)}
            title = f"{self.job.verb} of {self.job.frame or self.job.system.name}"
            attributes = {"title": title, "format": FORMAT, "kempe": json.dumps(made)}
            write_group(self.path, FORMAT, attributes, self._add_arrays)
        try:
            group = zarr.open_group(str(self.path), mode="r+")
            made = json.loads(group.attrs["kempe"])
            same = [key for key in self.metadata if key != "source"]
            refuse_other_map(made, self.metadata, str(self.path), same)
            with zarr.config.set({"array.write_empty_chunks": True}):
                self.arrays = {name: group[name] for name in (*self.job.answer_layout, DONE)}
            axes = {name: group[name] for name in self._list_axis_words()}
        except InputError:  # it is another map
            raise
        except UNREADABLE as error:
            raise DamagedError(
                f"{self.path} is damaged: {error}; remove it, and the same call makes it anew"
            ) from error
        for name, words in self._list_axis_words().items():
            self._repair_words(axes[name], words)
        for k in range(self.arrays[DONE].shape[0]):
            if find_chunk_file(self.arrays[DONE], (k, 0)).exists():
                check()
                self._read_done_rows(k, same_rows=made["source"] == self.metadata["source"])

    def _add_arrays(self, group: Any) -> None:
        """Add the arrays, without chunks, and the labels along the axes."""
        n = self.source.n
        for name, empty in self.job.answer_layout.items():
            _, what, unit = AXES[name]
            more: dict[str, Any] = {"long_name": what, "units": unit}
            if name == "code":
                more |= {
                    "flag_values": [int(s) for s in MEMBERS],
                    "flag_meanings": " ".join(s.name for s in MEMBERS),
                }
            tail = empty.shape[1:]
            add_array(
                group,
                name,
                (n, *tail),
                empty.dtype,
                (self.chunk, *tail),
                name_axes(name, empty),
                packed=empty.itemsize == 1,  # configurations do not get smaller
                fill=choose_fill_value(name, empty),
                **more,
            )
        for name, words in self._list_axis_words().items():
            dims = ("coordinate",) if name == "unit" else (name,)
            add_array(group, name, (len(words),), str, (len(words),), dims)[...] = np.array(words)
        what = "number of answered rows of a chunk, and their checksum"
        size = (-(-n // self.chunk), 2)
        dims = ("chunk", "rows_and_checksum")
        add_array(group, DONE, size, np.uint64, (1, 2), dims, packed=False, long_name=what)

    def _list_axis_words(self) -> dict[str, list[str]]:
        """Return the labels of each labelled axis, such as names of coordinates."""
        used = {
            axis
            for name, empty in self.job.answer_layout.items()
            for axis in name_axes(name, empty)
        }
        return {
            name: words
            for name, words in self.job.label_axes().items()
            if name in used or (name == "unit" and "coordinate" in used)
        }

    def _repair_words(self, array: Any, words: list[str]) -> None:
        """Write the labels of an axis again if they are damaged."""
        try:
            if array[...].tolist() == words:
                return
        except UNREADABLE:
            pass
        self.damaged += 1
        array[...] = np.array(words)

    def _read_done_rows(self, k: int, same_rows: bool) -> None:
        """Read how many rows of a chunk are answered, unless its files are damaged. Errors:
        `InputError` if the rows have changed.
        """
        first, last = self._bound_chunk(k)
        try:
            count, checksum = (int(x) for x in self.arrays[DONE][k])
            for name in self.job.answer_layout:
                array = self.arrays[name]
                find_chunk_file(
                    array, (k,) + (0,) * (array.ndim - 1)
                ).stat()  # else it reads as empty
                array[first:last]
        except UNREADABLE:
            self.damaged += 1
            return
        if (
            not same_rows
            and compute_rows_checksum(self.source.read_rows(first, first + count)) != checksum
        ):
            raise InputError(
                f"{self.path} belongs to another map: the rows {first} to {first + count} of "
                f"{self.source.path} have changed since; take another path, or remove it"
            )
        self.done[k] = count

    def _bound_chunk(self, k: int) -> tuple[int, int]:
        """Return the first row of a chunk and the row after its last one."""
        return k * self.chunk, min((k + 1) * self.chunk, self.source.n)

    # ---- answers

    @property
    def n_rows(self) -> int:
        """Number of answered rows."""
        return sum(list(self.done.values()))

    def list_missing_chunks(self) -> Iterator[tuple[int, Array]]:
        """Yield the unfinished chunks: their numbers and all their rows."""
        for k in range(self.arrays[DONE].shape[0]):
            first, last = self._bound_chunk(k)
            if self.done.get(k, 0) < last - first:
                yield k, self.source.read_rows(first, last)

    def answer_chunk(self, k: int, rows: Array) -> None:
        """Answer the rows of a chunk and write the answers. A stopped thread writes those that are
        done. Errors: `DiskError`, those of the verb.
        """
        piece = max(1, VERBS[self.job.verb].rows // PIECES)
        first, _ = self._bound_chunk(k)
        count = self.done.get(k, 0)
        parts = [
            {name: self.arrays[name][first : first + count] for name in self.job.answer_layout}
        ]
        try:
            for at in range(count, len(rows), piece):
                parts.append(self.job.answer_rows(rows[at : at + piece]))
        finally:
            if len(parts) > 1:
                answers = {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}
                self.write_answers(k, rows, answers)

    def write_answers(self, k: int, rows: Array, answers: Arrays) -> None:
        """Write the answers to the first rows of a chunk, or to all. Errors: `DiskError`."""
        first, last = self._bound_chunk(k)
        count = len(answers["code"])
        try:
            for name, found in answers.items():
                whole = np.full(
                    (last - first, *found.shape[1:]),
                    choose_fill_value(name, found),
                    dtype=found.dtype,
                )
                whole[:count] = found
                self.arrays[name][first:last] = whole
            checksum = compute_rows_checksum(rows[:count])
            self.arrays[DONE][k] = np.array([count, checksum], dtype=np.uint64)
        except OSError as error:
            raise make_disk_error(self.path, error) from error
        self.done[k] = count

    def count_outcomes(self) -> dict[str, int]:
        """Count the answered rows by the name of their outcome."""
        counts = np.zeros(len(MEMBERS), dtype=np.int64)
        for k, count in self.done.items():
            first, _ = self._bound_chunk(k)
            counts += np.bincount(
                self.arrays["code"][first : first + count], minlength=len(MEMBERS)
            )
        return {MEMBERS[k].name: int(c) for k, c in enumerate(counts) if c}


def choose_fill_value(name: str, array: np.ndarray) -> Any:
    """Choose the value in an array that stands for rows without an answer."""
    return LEFT if name == "code" else np.nan if array.dtype.kind == "f" else 0


# ---- the answer and the verb

USUAL = Usual("map_file", rng=0, threads=None, time_limit=None, progress=None)
CHUNK_BYTES = 2**23
"""Bytes of the rows of a chunk, and of each array of answers to them, at most."""
MANY = 2**16
"""Chunks from which on they are made larger, as far as `CHUNK_BYTES` allows."""


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class FileMap(Report):
    """Answers of a verb to the rows of a file, and where they are stored.

    Attributes
    ----------
    rows, requested
        Numbers of finished and of requested rows.
    chunk
        Number of rows in one chunk of the store.
    outcomes
        Number of rows by the name of their `Status`.
    late, interrupted
        Whether the time limit or Ctrl-C ended the work. The same call continues it.
    """

    _entries = ("system", "verb", "rows", "requested", "chunk", "outcomes", "redone")

    system: Model
    verb: str
    source: Path
    path: Path
    rows: int
    requested: int
    chunk: int
    outcomes: dict[str, int]
    interrupted: bool = False
    late: bool = False
    redone: int = 0
    """Damaged chunks that were found on disk, and made again."""

    @property
    def code(self) -> Status:  # type: ignore[override]
        """Outcome: `SOLVED` if all rows are solved, `PARTLY` if some rows are not.

        `INTERRUPTED` or `OUT_OF_TIME` means that rows are left.
        """
        if self.interrupted or self.late:
            return Status.INTERRUPTED if self.interrupted else Status.OUT_OF_TIME
        return Status.SOLVED if set(self.outcomes) <= {Status.SOLVED.name} else Status.PARTLY

    @property
    def status(self) -> str:
        """The number of answered rows and their outcomes, as a sentence."""
        of = f"{self.rows} of {format_count(self.requested, 'row')}"
        found = ", ".join(f"{n} {name}" for name, n in self.outcomes.items())
        return (
            f"{self.verb} of {of} of {self.source.name}: "
            f"{found or 'nothing'}{describe_early_end(self.interrupted, self.late)}"
        )

    def _make_tables(self) -> Sequence[Table]:
        rows = [("answers", str(self.path)), ("chunks", f"{format_count(self.chunk, 'row')} each")]
        rows += [
            ("redone", f"{format_count(self.redone, 'chunk')} that was damaged on disk")
        ] * bool(self.redone)
        return [Table((), rows, record=True)]

    def _collect_data(self) -> dict[str, Any]:
        return super()._collect_data() | {"source": str(self.source), "path": str(self.path)}


@explain_errors
@raise_interrupted
def map_file(
    system: Model,
    verb: str,
    source: str | Path,
    path: str | Path,
    frame: FrameLike | None = None,
    *,
    columns: Iterable[str] | None = None,
    options: Mapping[str, Any] | None = None,
    degrees: bool = False,
    client: Any = None,
    budget: Budget | None = None,
) -> FileMap:
    """Apply a verb to each row of a file of any size, and write the answers to a Zarr store.

    Parameters
    ----------
    system
        The system.
    verb
        "fk", "ik", "ik_all" or "assemble".
    source
        A .parquet, .npy or .csv file, a folder of .parquet files, or Zarr: an array, or a group
        whose arrays of one axis are columns. Rows for "fk" are configurations: all coordinates in
        order, or columns by name (missing ones are neutral). Rows for "ik" and "ik_all" are
        targets: x, y, z with roll, pitch, yaw or with qw, qx, qy, qz; in the plane x, y or x, y,
        angle; or poses (n, 4, 4) and (n, 3, 4). Rows for "assemble" are known coordinates. Units
        are radians and metres.
    path
        Path of the Zarr store.
    frame
        Name of the frame. "ik" and "ik_all" need it; "fk" without it gives all bodies.
    columns
        Names of the columns that count, or names for columns without any.
    options
        Options of the verb: form, dtype; task, start, method, tolerance, limits, fixed; branch,
        prefer.
    degrees
        Angles are in degrees. Columns of a .csv file called "q1 [deg]" are in degrees anyway.
    client
        A `distributed.Client` or the address of a scheduler: a Dask cluster does the work.
    budget
        Reads rng (0), threads, time_limit (none) and progress(rows, n).

    Returns
    -------
    FileMap
        What was done. The store has arrays with one entry for each row: the answer, its `code`, and
        errors. A row that is not finite has NaN and the code BAD_INPUT; an unfinished row has NaN
        and the code 255.

    Raises
    ------
    InputError, UnknownNameError
        For a wrong file or path, and for wrong options of the verb.
    DiskError
        If the store cannot be written.
    DamagedError
        For a source that cannot be read.
    MissingExtraError
        Without the extra [scale].

    Notes
    -----
    A chunk has 65 536 rows for "fk" and 4096 for other verbs, and at most 8 MB of rows and of
    answers. Memory holds one chunk for each thread, and one block of the file (at most 1 GB).
    Chunks are written with checksums. After an interruption the same call continues, and repeats
    damaged chunks. Answers do not depend on threads or workers.
    """
    spend = USUAL.complete_budget(budget)
    own = isinstance(client, str)
    clock = TimeLimit(spend.time_limit)
    threads = choose_thread_count(spend.threads)
    degrees = read_flag(degrees, "degrees")
    named = None if columns is None else read_names(columns, "columns")
    rows = open_rows(source, named, degrees)
    job = make_job(system, verb, frame, options, rows, degrees, draw_seed(spend.rng))
    store = RowStore(expand_path(path), job, rows, _choose_chunk_size(job, rows))
    client = None if client is None else connect_client(client)
    broken = None
    try:
        broken = _answer_missing_rows(store, client, threads, Pace(spend.progress, rows.n, clock))
    except BROKEN_OFF as error:
        broken = error
    finally:
        if own and client is not None:
            client.close()
    interrupted = isinstance(broken, KeyboardInterrupt)
    late = broken is not None and not interrupted and store.n_rows < rows.n
    return FileMap(
        system,
        verb,
        rows.path,
        store.path,
        store.n_rows,
        rows.n,
        store.chunk,
        store.count_outcomes(),
        interrupted,
        late,
        store.damaged,
    )


def _choose_chunk_size(job: RowJob, rows: RowSource) -> int:
    """Choose the number of rows in a chunk, from the verb, the number of rows and the memory."""
    most = 1 << max(0, (CHUNK_BYTES // max(rows.row_bytes, *job.row_bytes)).bit_length() - 1)
    wanted = max(VERBS[job.verb].rows, 1 << (rows.n // MANY).bit_length())
    return max(1, min(wanted, most, rows.n))


def _answer_missing_rows(
    store: RowStore, client: Any, threads: int, pace: Pace
) -> BaseException | None:
    """Answer all rows without an answer, and return what broke the work off. Errors: those of the
    verb, and what broke it off.
    """

    def check_progress(_: int = 0) -> None:
        """Report the number of rows that are done, and check the clock."""
        pace(store.n_rows)

    store.open_group(check_progress)
    if store.n_rows == store.source.n:
        return None
    broken = None
    if client is None:
        _, broken = work_in_threads(
            store.list_missing_chunks(),
            lambda _, part: store.answer_chunk(*part),
            threads,
            check_progress,
            stops=True,
        )
    else:
        parts = ((part, part[1:]) for part in store.list_missing_chunks())
        for (k, rows), answers in iterate_results(
            client, RowJob.answer_rows, store.job, parts, check_progress
        ):
            store.write_answers(k, rows, answers)
    if broken is None:
        pace(store.n_rows, at_once=True)
    return broken
