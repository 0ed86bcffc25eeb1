"""The verb `map_file`: a verb applied to all rows of a large file, with the answers on disk.

Answers form a Zarr group that fills up chunk by chunk, each with a checksum; a run that was
interrupted goes on where it ended.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.answers.tables import PLACE, QUATERNION, poses_of_columns, said_columns
from kempe.answers.targets import task_of
from kempe.arguments import (
    explained,
    explained_methods,
    flag,
    interruptible,
    known,
    listed,
    seed_number,
)
from kempe.assemble.assemble import assemble
from kempe.budget import Budget, Usual
from kempe.description.source import expanded
from kempe.errors import UNREADABLE, DamagedError, InputError
from kempe.forward.fk import fk
from kempe.inverse.ik import ik
from kempe.inverse.ik_all import ik_all
from kempe.kernels.compiled import VARIANT
from kempe.model.configurations import as_q, as_start, has_loops, q_from_dict, units
from kempe.numerics.clock import BROKEN_OFF, TimeLimit, partial
from kempe.numerics.pool import thread_count
from kempe.report import Cells, Report, brief
from kempe.spatial import Array
from kempe.status import MEMBERS, Status
from kempe.version import __version__
from kempe.words import counted, jsonable
from kempe.workspace.row_sources import RowSource, open_rows
from kempe.workspace.store import (
    DonePart,
    PartLog,
    add_array,
    consolidate,
    description_of,
    not_written,
    refuse_other,
    refuse_place,
    take_place,
    zarr_library,
)
from kempe.workspace.workers import (
    RETRIES,
    ClusterWorkers,
    Pace,
    Stopped,
    ThreadWorkers,
    connected,
    finished,
    refuse_kernels,
)

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model


# ---- verbs over rows

# What a row is to each verb, and what the verb answers, as arrays with named axes.

Arrays = dict[str, Any]


@dataclass(frozen=True)
class RowJob:
    """A verb of a system with its options, and what the rows are that it is for: all that an answer
    depends on.

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

    def said(self) -> dict[str, Any]:
        """What is written beside a map, and must be the same for it to be gone on with. Errors:
        `InputError`.
        """
        try:
            options = json.loads(json.dumps(jsonable(self.options)))
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

    def answers(self, rows: Array) -> Arrays:
        """What the verb answers to rows (n, *tail), each array with n rows, in one thread. Errors:
        `KernelsError`.
        """
        refuse_kernels(self.variant, self.version)
        return VERBS[self.verb].answers(self, rows)

    @cached_property
    def layout(self) -> dict[str, np.ndarray]:
        """The arrays of no rows: their shapes and types. Errors: those of the verb for its options."""
        found = self.answers(np.zeros((0, *self.tail)))
        return {name: np.asarray(array) for name, array in found.items()}

    @property
    def row_bytes(self) -> list[int]:
        """Bytes of the answer to a row, of each array."""
        return [a.itemsize * int(np.prod(a.shape[1:])) for a in self.layout.values()]

    # ---- what a row is

    def configurations(self, rows: Array) -> Array:
        """Configurations (n, nq) of rows: all coordinates in order, or some by name. Errors:
        `InputError`.
        """
        if self.columns is None:
            return as_q(self.system, rows)
        missing = [name for name in self.system.coordinate_names if name not in self.columns]
        if missing and has_loops(self.system):
            every = ", ".join(self.system.coordinate_names)
            raise InputError(
                f"column {missing[0]!r} is missing, which the loops of {self.system.name!r} "
                f"decide: give all of {every}, or map assemble first"
            )
        return q_from_dict(self.system, self.by_name(rows))

    def by_name(self, rows: Array) -> dict[str, Array]:
        """The columns (n,) by their names, angles in radians. Errors: `InputError`."""
        if self.columns is None:
            raise InputError(
                "the columns have no names: name the known coordinates by columns=(...)"
            )
        unit = units(self.system)
        turns = [name for name in self.columns if self.degrees and unit.get(name) == "rad"]
        return {
            name: np.radians(x) if name in turns else x
            for name, x in zip(self.columns, rows.T, strict=True)
        }

    def targets(self, rows: Array) -> Array:
        """Targets of rows: poses (n, 4, 4), or positions (n, 3), where only these count. Errors:
        `InputError`.
        """
        if len(self.tail) == 2:
            if self.tail not in ((4, 4), (3, 4)):
                raise InputError(
                    f"a row is of shape {self.tail}; a target is (4, 4), (3, 4), or the columns "
                    f"{said_columns(self.system.dim)}"
                )
            X = np.broadcast_to(np.eye(4), (len(rows), 4, 4)).copy()
            X[:, : self.tail[0]] = rows
            return X
        X, position = poses_of_columns(self.system.dim, rows, self.columns, self.degrees)
        task = self.options.get("task")
        if isinstance(task, str):
            task_of(task, position, False)
        if position and task not in (None, "position"):
            raise InputError(
                f"task {task!r} needs targets with an orientation; they have x, y, z only"
            )
        return np.ascontiguousarray(X[:, : self.system.dim, 3]) if position else X

    def axes(self) -> dict[str, list[str]]:
        """What stands along the axes that have names."""
        q = list(self.system.coordinate_names)
        unit = units(self.system)
        return {
            "coordinate": q,
            "unit": [unit[name] or "1" for name in q],
            "body": list(self.system.body_names),
            "axis": list(PLACE),
            "component": [*PLACE, *QUATERNION],
        }


class Verb(NamedTuple):
    """A verb: what it answers to rows, its options, and how many rows it is given at once, at most."""

    answers: Callable[[RowJob, Array], Arrays]
    options: tuple[str, ...]
    rows: int
    needs_frame: bool = True


def _fk(job: RowJob, rows: Array) -> Arrays:
    X = fk(job.system, job.configurations(rows), job.frame, threads=1, **job.options)
    form = job.options.get("form") or "matrix"
    code = np.where(
        np.isfinite(X).all(axis=tuple(range(1, X.ndim))), Status.SOLVED, Status.BAD_INPUT
    )
    return {"pose" if form in ("matrix", "3x4") else form: X, "code": code.astype(np.uint8)}


def _ik(job: RowJob, rows: Array) -> Arrays:
    answer = ik(
        job.system,
        job.targets(rows),
        job.frame,
        budget=Budget(rng=job.rng, threads=1),
        **job.options,
    )
    return {
        "q": answer.q,
        "code": np.asarray(answer.code, dtype=np.uint8),
        "position_error": answer.position_error,
        "orientation_error": answer.orientation_error,
    }


def _ik_all(job: RowJob, rows: Array) -> Arrays:
    if job.options.get("limits") == "turns":
        raise InputError(
            "limits='turns' gives as many solutions as there are turns; a map has room for one of "
            "each"
        )
    answer: Any = ik_all(
        job.system, job.targets(rows), str(job.frame), budget=Budget(threads=1), **job.options
    )
    return {
        "q": answer.q,
        "code": np.asarray(answer.code, dtype=np.uint8),
        "residual": answer.residual,
        "inside": answer.inside,
        "count": answer.mask.sum(axis=-1).astype(np.uint8),
        "complete": np.asarray(answer.complete, dtype=bool),
    }


def _assemble(job: RowJob, rows: Array) -> Arrays:
    if job.options.get("prefer") == "continuous":
        raise InputError(
            "prefer='continuous' goes row by row; a map has its rows answered side by side"
        )
    budget = Budget(rng=job.rng, threads=1)
    answer = assemble(job.system, job.by_name(rows), budget=budget, **job.options)
    return {
        "q": answer.q,
        "code": np.asarray(answer.code, dtype=np.uint8),
        "residual": answer.residual,
    }


VERBS = {
    "fk": Verb(_fk, ("form", "dtype"), 2**16, needs_frame=False),
    "ik": Verb(_ik, ("task", "start", "method", "tolerance"), 2**12),
    "ik_all": Verb(_ik_all, ("task", "start", "fixed", "limits", "tolerance"), 2**12),
    "assemble": Verb(
        _assemble, ("start", "branch", "prefer", "limits", "tolerance"), 2**12, needs_frame=False
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


def axes_of(name: str, array: np.ndarray) -> tuple[str, ...]:
    """The names of the axes of an array: rows, then what there is several of, then those of its
    own.
    """
    own = AXES[name][0]
    several = "body" if name in ("pose", "position", "position_quat_wxyz") else "solution"
    return ("row", *([several] if array.ndim > len(own) + 1 else []), *own)


def job_of(
    system: Model,
    verb: str,
    frame: Any,
    options: Mapping[str, Any] | None,
    source: Any,
    degrees: bool,
    rng: int,
) -> RowJob:
    """A verb with what it needs, checked on no rows. Errors: `InputError`, `UnknownNameError`,
    those of the verb.
    """
    chosen = VERBS[known("verb", verb, VERBS)]
    given = dict(options or {})
    for name in given:
        known(f"option of map {verb}", name, chosen.options)
    if verb == "assemble" and frame is not None:
        raise InputError("assemble needs no frame: known are coordinates")
    if chosen.needs_frame and frame is None:
        raise InputError(f"{verb} needs a frame")
    if given.get("start") is not None:
        start = as_start(system, given["start"])
        if np.ndim(start) != 1:
            raise InputError(f"start must be one configuration ({system.nq},)")
        if not np.isfinite(start).all():
            raise InputError(f"start is {start.tolist()}; its numbers must be finite")
    name = None if frame is None else system.structure.frame_name(frame)
    job = RowJob(system, verb, name, given, source.tail, source.names, degrees, rng)
    job.said()
    assert set(job.layout) <= set(AXES)
    return job


# ---- the store of answers

FORMAT = "kempe rows 1"
ROWS = "rows.zarr"
"""Where the group lies while it fills up."""
SUMS = {
    "checksum": ("checksum", "checksum of the answers to a chunk"),
    "source_checksum": ("source", "checksum of the rows of a chunk"),
}
"""Arrays with an entry for each chunk, what of a `DonePart` they hold, and in words."""


PIECES = 8
"""Pieces of a chunk, as a verb takes one at once: what is done of them is kept where the work is
stopped."""


def _joined(parts: list[Arrays]) -> Arrays:
    """Arrays one after the other, by their names."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def checksum_of_arrays(arrays: Arrays) -> str:
    """A checksum, 64 bits, of arrays by their names and values."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.data)
    return digest.hexdigest()[:16]


class RowStore(PartLog):
    """The answers of a job to the rows of a source, in chunks of so many rows."""

    loose = ("source",)

    def __init__(self, path: Path, job: RowJob, source: RowSource, chunk: int):
        zarr_library()
        refuse_place(path, FORMAT)
        self.job = job
        self.source = source
        self.chunk = chunk
        said = {**job.said(), "rows": source.n, "chunk": chunk, "source": source.identity()}
        super().__init__(path, said, 0)
        written = sum(p.stat().st_size for p in self.folder.rglob("*") if p.is_file())
        self.needed = max(0, source.n * sum(job.row_bytes) - written)
        self.arrays: Arrays = {}
        self.checked: Callable[[int], None] = lambda done: None
        self.whole = False

    # ---- what is there

    def begin(self) -> None:
        """Find what is done, check it, and make room for the rest; `whole` says that nothing is
        left to do.

        Errors: `InputError` where the path, or the folder beside it, is of another map, or the rows
        have changed.
        """
        if self.path.exists() and self._finished():
            return
        super().begin()
        self._refuse_changed()
        if not self.done:
            self._make_arrays()

    def _finished(self) -> bool:
        """Whether the map at the path is sound; else what is sound of it becomes what is done."""
        try:
            group = zarr_library().open_group(str(self.path), mode="r")
            self.header = json.loads(group.attrs["kempe"])
        except UNREADABLE as error:
            raise DamagedError(
                f"{self.path} is damaged: it does not say what made it; take another path, or "
                "remove it"
            ) from error
        refuse_other(self.header, self.said, str(self.path), self.keys)
        try:
            sums = [np.asarray(group[name][...]) for name in SUMS]
            if any(group[name][...].tolist() != words for name, words in self._words()):
                raise ValueError("the names along an axis are not those that were written")
            self._open(self.path, "r")
        except UNREADABLE:
            self.damaged = 1
            return False
        starts = range(0, self.source.n, self.chunk)
        parts = [
            DonePart(at, min(at + self.chunk, self.source.n), f"{a:016x}", f"{b:016x}")
            for at, a, b in zip(starts, *(s.tolist() for s in sums), strict=False)
        ]
        self.done = [part for part in parts if self.sound(part)]
        self._refuse_changed()
        self.whole = len(self.done) == len(starts)
        if self.whole:
            self.clear()
            return True
        self.done = parts
        self._make()
        self.write_list()
        shutil.rmtree(self.folder / ROWS, ignore_errors=True)
        os.replace(self.path, self.folder / ROWS)
        self.arrays = {}
        return False

    def _open(self, folder: Path, mode: str) -> None:
        """Take the arrays of the group in a folder for those that are read and written."""
        group = zarr_library().open_group(str(folder), mode=mode)
        self.arrays = {name: group[name] for name in self.job.layout}

    def sound(self, part: DonePart) -> bool:
        """Whether the answers to a part are those that were written."""
        self.checked(part.first)
        try:
            if not self.arrays:
                self._open(self.folder / ROWS, "r+")
            found = {name: array[part.first : part.last] for name, array in self.arrays.items()}
        except UNREADABLE:
            return False
        return checksum_of_arrays(found) == part.checksum

    def _refuse_changed(self) -> None:
        """Refuse rows that are not those of which parts are done, where the file is not the same.
        Errors as `begin`.
        """
        if self.header.get("source") == self.said["source"]:
            return
        for part in self.done:
            if checksum_of_arrays({"rows": self.source.read(part.first, part.last)}) != part.source:
                raise InputError(
                    f"{self.path} belongs to another map: the rows {part.first} to {part.last} of "
                    f"{self.source.path} have changed since; take another path, or remove it"
                )
        if not self.path.exists():
            self.write_list()  # the same rows in another file

    def _make_arrays(self) -> None:
        """Make a new group, which fills up, and its arrays. Errors: `DiskError`."""
        try:
            self._describe(
                zarr_library().open_group(str(self.folder / ROWS), mode="w", zarr_format=3)
            )
        except OSError as error:
            raise not_written(self.folder / ROWS, error) from error

    def _describe(self, group: Any) -> None:
        n = self.source.n
        job = self.job
        made = {**self.said, "toml": description_of(job.system)}
        group.attrs.update(
            {
                "title": f"{job.verb} of {job.frame or job.system.name}",
                "format": FORMAT,
                "kempe": json.dumps(made),
            }
        )
        for name, empty in job.layout.items():
            _, what, unit = AXES[name]
            more: dict[str, Any] = {"long_name": what, "units": unit}
            if name == "code":
                more |= {
                    "flag_values": [int(s) for s in MEMBERS],
                    "flag_meanings": " ".join(s.name for s in MEMBERS),
                }
            tail = empty.shape[1:]
            packed = "auto" if empty.itemsize == 1 else None  # configurations do not get smaller
            self.arrays[name] = add_array(
                group,
                name,
                (n, *tail),
                empty.dtype,
                (self.chunk, *tail),
                axes_of(name, empty),
                packed,
                **more,
            )
        for name, words in self._words():
            dims = ("coordinate",) if name == "unit" else (name,)
            add_array(group, name, (len(words),), str, (len(words),), dims)[...] = np.array(words)

    def _words(self) -> list[tuple[str, list[str]]]:
        """The axes that have words, such as names of coordinates, and these."""
        used = {axis for name, empty in self.job.layout.items() for axis in axes_of(name, empty)}
        return [
            (name, words)
            for name, words in self.job.axes().items()
            if name in used or (name == "unit" and "coordinate" in used)
        ]

    # ---- what is done

    def answers(self, first: int, rows: Any) -> Arrays:
        """Answers to the rows of a chunk that begins at row `first`; after a stop the next call
        goes on with them.
        """
        piece = max(1, VERBS[self.job.verb].rows // PIECES)
        kept = self.folder / f"begun_{first}.npz"
        parts = self._begun(kept, rows)
        at = sum(len(part["code"]) for part in parts)
        try:
            while at < len(rows):
                parts.append(self.job.answers(rows[at : at + piece]))
                at += len(parts[-1]["code"])
        except Stopped:
            if parts:
                self._keep(kept, _joined(parts), rows)
            raise
        kept.unlink(missing_ok=True)
        return _joined(parts)

    def _begun(self, path: Path, rows: Any) -> list[Arrays]:
        """The answers to the first rows of a chunk that a stop has left; none where the file or the
        rows changed.
        """
        if not path.exists():
            return []
        try:
            # np.load leaves a damaged file open
            with (
                path.open("rb") as opened,
                np.load(opened) as file,
            ):
                found = {name: file[name] for name in file.files}
            own = [str(found.pop(name)) for name in ("sum", "of")]
            count = len(found["code"])
            good = set(found) == set(self.job.layout) and own == self._sums(found, rows[:count])
        except (*UNREADABLE, zipfile.BadZipFile):
            return []
        return [found] if good else []

    def _keep(self, path: Path, found: Arrays, rows: Any) -> None:
        """Keep the answers to the first rows of a chunk; where there is no room they are found
        again.
        """
        sums = dict(zip(("sum", "of"), self._sums(found, rows[: len(found["code"])]), strict=True))
        try:
            np.savez(path, **found, **sums)  # type: ignore[arg-type]
        except OSError:
            path.unlink(missing_ok=True)

    def _sums(self, found: Arrays, rows: Any) -> list[str]:
        return [checksum_of_arrays(found), checksum_of_arrays({"rows": rows})]

    def made(self, first: int, last: int, rows: Any, arrays: Arrays) -> DonePart:
        """Write the answers to the rows `first` to `last`; to be added when that is done. Errors:
        `DiskError`.
        """
        try:
            for name, array in arrays.items():
                self.arrays[name][first:last] = array
        except OSError as error:
            raise not_written(self.folder / ROWS, error) from error
        return DonePart(first, last, checksum_of_arrays(arrays), checksum_of_arrays({"rows": rows}))

    def outcomes(self) -> dict[str, int]:
        """How many rows have which outcome, by its name, of those that are done."""
        counts = np.zeros(len(MEMBERS), dtype=np.int64)
        for part in self.done:
            counts += np.bincount(
                self.arrays["code"][part.first : part.last], minlength=len(MEMBERS)
            )
        return {MEMBERS[k].name: int(c) for k, c in enumerate(counts) if c}

    def finish(self) -> None:
        """Write the checksums, and put the group in its place. Errors: `DiskError`."""
        folder = self.folder / ROWS
        parts = sorted(self.done)
        try:
            group = zarr_library().open_group(str(folder), mode="r+")
            for name, (of, what) in SUMS.items():
                if name in group:
                    del group[name]
                sums = np.array([int(getattr(part, of), 16) for part in parts], dtype=np.uint64)
                chunks = (max(1, len(sums)),)
                added = add_array(
                    group, name, sums.shape, sums.dtype, chunks, ("chunk",), long_name=what
                )
                added[...] = sums
            consolidate(folder)
            take_place(folder, self.path)
        except OSError as error:
            raise not_written(self.path, error) from error
        self._open(self.path, "r")
        self.clear()


# ---- the answer and the verb

USUAL = Usual("map_file", rng=0, threads=None, time_limit=None, progress=None)
CHUNK_BYTES = 2**23
"""Bytes of the rows of a chunk, and of each array of answers to them, at most."""
MANY = 2**16
"""Chunks from which on they are made larger, as far as `CHUNK_BYTES` allows."""


@explained_methods
@dataclass(frozen=True, eq=False)
class FileMap(Report):
    """What a verb answered to the rows of a file, and where that is.

    `rows` of the `requested` ones are done, in chunks of `chunk` rows; `outcomes` says how many of
    them came to which `Status`, by its name. Where the work was `interrupted`, or the time limit
    came (`late`), the same call goes on.
    """

    __repr__ = brief

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
        """`SOLVED` where all rows are, `PARTLY` where some are not; `INTERRUPTED` or `OUT_OF_TIME`
        if rows are left.
        """
        if self.interrupted or self.late:
            return Status.INTERRUPTED if self.interrupted else Status.OUT_OF_TIME
        return Status.SOLVED if set(self.outcomes) <= {Status.SOLVED.name} else Status.PARTLY

    @property
    def status(self) -> str:
        """How many rows are done, and what became of them."""
        of = f"{self.rows} of {counted(self.requested, 'row')}"
        found = ", ".join(f"{n} {name}" for name, n in self.outcomes.items())
        return (
            f"{self.verb} of {of} of {self.source.name}: "
            f"{found or 'nothing'}{partial(self.interrupted, self.late)}"
        )

    def _cells(self) -> Cells:
        rows = [("answers", str(self.path)), ("chunks", f"{counted(self.chunk, 'row')} each")]
        return (), rows + [
            ("redone", f"{counted(self.redone, 'chunk')} that was damaged on disk")
        ] * bool(self.redone)

    def _data(self) -> dict[str, Any]:
        names = ("verb", "rows", "requested", "chunk", "outcomes", "redone")
        return {"system": self.system.name, "source": str(self.source), "path": str(self.path)} | {
            name: getattr(self, name) for name in names
        }


@explained
@interruptible
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
    """A `FileMap`: what a verb answers to each row of a file of any size, written to a path as
    Zarr.

    `verb` is "fk", "ik", "ik_all" or "assemble"; `source` a .parquet, .npy or .csv file, a folder
    of .parquet files, or Zarr: an array, or a group whose arrays of one axis are columns. Rows are
    configurations for "fk": all coordinates in the order of `q`, or columns that have their names
    (those that are missing are neutral). For "ik" and "ik_all" they are targets of a `frame`: x, y,
    z, with roll, pitch, yaw or with qw, qx, qy, qz, in the plane also x, y and x, y, angle, or
    poses (n, 4, 4) and (n, 3, 4). For "assemble" they are known coordinates. In radians and metres,
    or angles in `degrees`. `columns` are those that count, or the names of columns that have none.
    `options` are those of the verb: form, dtype; task, start, method, tolerance, limits, fixed;
    branch, prefer.

    At `path` then are arrays with a row for each row, which xarray opens: the answer, `code`
    (`Status`), errors, and what made them. A row that is no number gives NaN and the code
    BAD_INPUT. Chunks have 65 536 rows ("ik" 16 384, others 4096), and at most 8 MB of rows and 8 MB
    of answers; of these the memory holds two a thread. A block of the file (a row group of Parquet,
    a chunk of Zarr) is held besides, 1 GB at most.

    What is done is written beside the path chunk by chunk, with checksums: after any interruption
    the same call goes on, and makes damaged chunks again. Answers do not depend on threads or
    workers: with a `client`, a `distributed.Client` or the address of a scheduler, those of a Dask
    cluster answer. Of the `budget` are read: rng (0), threads, time_limit (none), progress(rows,
    n).

    Errors: `InputError` and `UnknownNameError` for what the file is not, and for what is at the
    path; those of the verb for its options; `DiskError`; `DamagedError` for a source that cannot be
    read; `MissingExtraError` without the extra [scale].
    """
    spend = USUAL.of(budget)
    own = isinstance(client, str)
    clock = TimeLimit(spend.time_limit)
    threads = thread_count(spend.threads)
    rows = open_rows(source, None if columns is None else listed(columns, "columns"))
    job = job_of(
        system, verb, frame, options, rows, flag(degrees, "degrees"), seed_number(spend.rng)
    )
    store = RowStore(expanded(path), job, rows, _chunk(job, rows))
    client = None if client is None else connected(client)
    broken = None
    try:
        _fill(store, client, threads, spend, clock)
    except BROKEN_OFF as error:
        broken = error
    finally:
        if own and client is not None:
            client.close()
    interrupted = isinstance(broken, KeyboardInterrupt)
    return FileMap(
        system,
        verb,
        rows.path,
        store.path,
        store.count(rows.n),
        rows.n,
        store.chunk,
        store.outcomes(),
        interrupted,
        broken is not None and not interrupted,
        store.damaged,
    )


def _chunk(job: RowJob, rows: RowSource) -> int:
    """Rows of a chunk: what a verb takes at once, more where there are very many, as the memory
    allows.
    """
    most = 1 << max(0, (CHUNK_BYTES // max(rows.row_bytes, *job.row_bytes)).bit_length() - 1)
    wanted = max(VERBS[job.verb].rows, 1 << (rows.n // MANY).bit_length())
    return max(1, min(wanted, most, rows.n))


def _fill(store: RowStore, client: Any, threads: int, spend: Budget, clock: TimeLimit) -> None:
    """Answer all rows that are not answered. Errors: those of tasks, and what broke it off."""
    n = store.source.n
    pace = Pace(spend.progress, store.source.n)

    def checked(done: int) -> None:
        pace(done)
        clock.check()

    store.checked = checked
    store.begin()
    if store.whole:
        return
    done = store.count(n)
    tasks = store.missing(n, store.chunk, store.chunk)
    for part in (
        _local(store, tasks, threads, clock)
        if client is None
        else _far(store, tasks, client, clock)
    ):
        store.add(part)
        done += part.last - part.first
        pace(done, at_once=done == n)
    store.finish()


def _local(
    store: RowStore, tasks: list[tuple[int, int]], threads: int, clock: TimeLimit
) -> Iterator[DonePart]:
    """The parts that threads of this process make of ranges of rows."""
    with ThreadWorkers(threads, spare=1, stops=True) as workers:

        def work(first: int, last: int, rows: Any) -> DonePart:
            return store.made(first, last, rows, store.answers(first, rows))

        def begin(task: tuple[int, int], _: int) -> Any:
            return workers.submit(work, *task, store.source.read(*task))

        for _, part in finished(workers, tasks, begin, clock.check):
            yield part


def _far(
    store: RowStore, tasks: list[tuple[int, int]], client: Any, clock: TimeLimit
) -> Iterator[DonePart]:
    """The parts of which the workers of a cluster give the answers: rows go there, and answers come
    back.
    """
    sent: dict[int, Any] = {}
    workers = ClusterWorkers(client)
    jobs: dict[int, Any] = {}

    def begin(task: tuple[int, int], attempt: int) -> Any:
        if attempt not in jobs:
            jobs[attempt] = workers.share(store.job)
        rows = sent[task[0]] = store.source.read(*task)
        return client.submit(RowJob.answers, jobs[attempt], rows, retries=RETRIES, pure=False)

    for (first, last), answers in finished(workers, tasks, begin, clock.check):
        yield store.made(first, last, sent.pop(first), answers)
