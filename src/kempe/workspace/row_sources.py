"""Rows of numbers in files of any size, read in blocks: Parquet, Zarr, .npy and .csv."""

from __future__ import annotations

import itertools
import os
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kempe.answers.tables import parse_header, parse_rows, split_unit
from kempe.arguments import check_name
from kempe.arrays import KINDS
from kempe.description.source import expand_path
from kempe.errors import UNREADABLE, DamagedError, InputError, KempeError, MissingExtraError
from kempe.spatial import Array
from kempe.words import DEGREE, choose_verb, format_count, join_words
from kempe.workspace.store import import_zarr

BLOCK_ROWS = 2**16
"""Rows of a block where the file itself has none, or smaller ones."""
BLOCK_BYTES = 2**30
"""The largest block that is read: a row group of a Parquet file, a chunk of Zarr."""


class RowSource:
    """The rows of a file: the `edges` of its blocks, a function that reads the k-th `block`. Also
    return the columns.

    A row has a shape `tail`; where that is one axis its columns may have `names`, and `units` "deg"
    or "rad" where the file states them.
    """

    def __init__(
        self,
        path: Path,
        edges: Any,
        tail: tuple[int, ...],
        names: tuple[str, ...] | None,
        block: Callable[[int], Any],
        units: Sequence[str] = (),
    ):
        self.path = path
        self.edges = np.asarray(edges)
        self.tail = tail
        self.names = names
        self._block = block
        self.n = int(self.edges[-1])
        self._held: tuple[int, Any] = -1, None
        self._units = units
        self._scale: Any = 1.0

    def choose_angles(self, degrees: bool) -> None:
        """Choose whether angles whose unit the file states are read in degrees or in radians."""
        other, factor = ("rad", 1.0 / DEGREE) if degrees else ("deg", DEGREE)
        if other in self._units:
            self._scale = np.array([factor if unit == other else 1.0 for unit in self._units])

    @property
    def row_bytes(self) -> int:
        """Bytes of a row of float64."""
        return 8 * int(np.prod(self.tail))

    def identify_files(self) -> dict[str, Any]:
        """Return the name, the size in bytes and the last change in ns of the file. A folder has
        the sum of the sizes and the latest change.
        """
        files = (
            [p for p in self.path.rglob("*") if p.is_file()] if self.path.is_dir() else [self.path]
        )
        stats = [os.stat(p) for p in files]
        return {
            "file": self.path.name,
            "size": sum(s.st_size for s in stats),
            "changed": max((s.st_mtime_ns for s in stats), default=0),
        }

    def read_rows(self, first: int, last: int) -> Array:
        """Read the rows `first` to `last` (n, *tail). Errors: `DamagedError`, `InputError` for text
        that is no number.
        """
        out = np.empty((last - first, *self.tail))
        at = first
        while at < last:
            k = int(np.searchsorted(self.edges, at, side="right")) - 1
            low = int(self.edges[k])
            stop = min(last, int(self.edges[k + 1]))
            try:
                if self._held[0] != k:
                    self._held = k, self._block(k)
                out[at - first : stop - first] = self._held[1][at - low : stop - low]
            except KempeError:
                raise
            except UNREADABLE as error:
                where = f"rows {low} to {int(self.edges[k + 1])}"
                raise DamagedError(f"{self.path}: {where} cannot be read: {error}") from error
            at = stop
        return out * self._scale if np.ndim(self._scale) else out


def open_rows(
    path: str | Path, columns: Sequence[str] | None = None, degrees: bool = False
) -> RowSource:
    """Open the rows of a file. `columns` selects columns by name, or names those without names.

    Columns of a .csv file whose names state a unit, such as "q1 [deg]", are called "q1", and are
    read in degrees or radians as `degrees` says.

    Errors: `InputError` for what is no such file, `UnknownNameError` for columns,
    `MissingExtraError`.
    """
    path = expand_path(path)
    if not path.exists():
        raise InputError(f"{path}: there is no such file")
    reader = READERS.get(
        path.suffix.lower(), _choose_folder_reader(path) if path.is_dir() else None
    )
    if reader is None:
        raise InputError(
            f"{path}: rows are read from Zarr, and from {join_words(list(READERS))} files"
        )
    try:
        source = reader(path, columns)
    except KempeError:
        raise
    except UNREADABLE as error:
        kind = "Zarr" if reader is _open_zarr else path.suffix or "a folder of .parquet files"
        raise InputError(f"{path}: this cannot be read as {kind}: {error}") from error
    if columns is not None and source.names is None:
        if source.tail != (len(columns),):
            named = (
                f"{format_count(len(columns), 'column')} {choose_verb(len(columns), 'is', 'are')} "
                "named"
            )
            raise InputError(f"{path}: a row is of shape {source.tail}, and {named}")
        source.names = tuple(columns)
    source.choose_angles(degrees)
    return source


def _choose_folder_reader(path: Path) -> Callable[[Path, Sequence[str] | None], RowSource]:
    """Choose the reader of a folder: Zarr, or else .parquet files. Errors: `InputError`."""
    if any((path / name).exists() for name in ("zarr.json", ".zgroup", ".zarray", ".zmetadata")):
        return _open_zarr
    if any(path.rglob("*.parquet")):
        return _open_parquet
    raise InputError(f"{path}: this folder cannot be read as Zarr, and holds no .parquet files")


def _choose_columns(
    path: Path, has: Sequence[str], columns: Sequence[str] | None
) -> tuple[str, ...]:
    """Choose the requested columns of those in a file. Errors: `InputError`, `UnknownNameError`."""
    names = tuple(has if columns is None else columns)
    given = Counter(has)
    wanted = Counter(names)
    for name in names:
        if name not in given:
            check_name("column", name, has, str(path))
        if wanted[name] > 1 or given[name] > 1:
            raise InputError(f"{path}: a column {name!r} appears twice")
    return names


def _check_numeric(path: Path, dtype: np.dtype, what: str) -> None:
    """Refuse a type that is not numeric. Errors: `InputError`."""
    if dtype.kind not in "fiu":
        raise InputError(
            f"{path}: {what} holds {KINDS.get(dtype.kind, str(dtype))}; it must hold real numbers"
        )


def _list_block_edges(n: int, step: int) -> list[int]:
    """List the edges of blocks of `step` rows."""
    return [*range(0, n, step), n]


# ---- formats


def _open_npy(path: Path, columns: Sequence[str] | None) -> RowSource:
    """Open an array of NumPy, of which only requested rows are read into memory."""
    try:
        array: Any = np.load(path, mmap_mode="r", allow_pickle=False)
    except ValueError as error:
        if "Python objects" in str(error):
            raise InputError(
                f"{path}: it holds Python objects; it must hold an array of real numbers"
            ) from None
        if "pickle" in str(error):  # of which numpy says how to run code that may be in the file
            raise ValueError("it does not begin as such a file does") from None
        raise
    if not hasattr(array, "shape"):
        raise InputError(
            f"{path}: this is a .npz archive of arrays, whatever its name says; save one array as "
            ".npy"
        )
    return _wrap_array(path, array, [0, len(array)] if array.ndim else [0])


def _wrap_array(path: Path, array: Any, edges: list[int]) -> RowSource:
    """Make the source of the rows of an array (n,), (n, k) or (n, j, k)."""
    if array.ndim not in (1, 2, 3):
        raise InputError(
            f"{path}: it holds an array of shape {array.shape}; needed is a row for each question"
        )
    _check_numeric(path, array.dtype, "it")
    tail = array.shape[1:] or (1,)
    return RowSource(
        path, edges, tail, None, lambda k: array[edges[k] : edges[k + 1]].reshape(-1, *tail)
    )


def _open_zarr(path: Path, columns: Sequence[str] | None) -> RowSource:
    """Open an array of Zarr, or a group of one-dimensional arrays as columns."""
    zarr = import_zarr()
    node = zarr.open(str(path), mode="r")
    if isinstance(node, zarr.Array):
        return _wrap_array(path, node, _list_zarr_edges(path, node, node.shape[1:]))
    arrays = {name: array for name, array in node.arrays() if columns is None or name in columns}
    if columns is None and (
        len({a.shape for a in arrays.values()}) != 1 or next(iter(arrays.values())).ndim != 1
    ):
        held = ", ".join(f"{name} {array.shape}" for name, array in arrays.items()) or "no arrays"
        such = max(arrays, key=lambda name: arrays[name].ndim, default="q")
        raise InputError(
            f"{path}: it holds {held}; name columns of one length, or give the path of an array, "
            f"such as {path / such}"
        )
    names = _choose_columns(path, list(arrays), columns)
    shapes = {arrays[name].shape for name in names}
    if len(shapes) != 1 or len(next(iter(shapes))) != 1:
        raise InputError(
            f"{path}: the columns have the shapes {sorted(shapes)}; they must have one, (n,)"
        )
    for name in names:
        _check_numeric(path, arrays[name].dtype, f"column {name!r}")
    edges = _list_zarr_edges(path, arrays[names[0]], (len(names),))

    def read_block(k: int) -> Array:
        """Read the k-th block."""
        return np.column_stack([arrays[name][edges[k] : edges[k + 1]] for name in names])

    return RowSource(path, edges, (len(names),), names, read_block)


def _list_zarr_edges(path: Path, array: Any, tail: tuple[int, ...]) -> list[int]:
    """List the edges of blocks of whole chunks, several if they are small."""
    if not array.ndim:
        return [0]
    rows = (getattr(array, "shards", None) or array.chunks)[0]
    _check_block_size(path, rows, tail, "chunk")
    return _list_block_edges(array.shape[0], -(-BLOCK_ROWS // rows) * rows)


def _check_block_size(path: Path, rows: int, tail: tuple[int, ...], what: str) -> None:
    """Refuse a block that is too large for memory. Errors: `InputError`."""
    size = 8 * rows * int(np.prod(tail))
    if size > BLOCK_BYTES:
        raise InputError(
            f"{path}: a {what} of it has {rows} rows, {size / 1e9:.3g} GB; at most "
            f"{BLOCK_BYTES / 1e9:.3g} GB are read at once: write it in smaller ones"
        )


def _open_parquet(path: Path, columns: Sequence[str] | None) -> RowSource:
    """Open a Parquet file, or a folder of such files in order of their names."""
    try:
        import pyarrow.parquet as parquet
    except ImportError:
        raise MissingExtraError("pyarrow", "scale") from None
    arrow: Any = parquet
    paths = sorted(p for p in path.rglob("*.parquet") if p.is_file()) if path.is_dir() else [path]
    files: list[Any] = [arrow.ParquetFile(p) for p in paths]
    if not files:
        raise InputError(f"{path}: this folder holds no .parquet files")
    names = _choose_columns(path, files[0].schema_arrow.names, columns)
    for p, file in zip(paths, files, strict=True):
        schema = file.schema_arrow
        for name in names:
            dtype = schema.field(
                check_name("column", name, schema.names, str(p))
            ).type.to_pandas_dtype()
            _check_numeric(p, np.dtype(dtype), f"column {name!r}")
    groups = [(file, k) for file in files for k in range(file.num_row_groups)]
    rows = [int(file.metadata.row_group(k).num_rows) for file, k in groups]
    _check_block_size(path, max(rows, default=0), (len(names),), "row group")

    def read_block(k: int) -> Array:
        """Read the k-th block."""
        file, group = groups[k]
        table = file.read_row_group(group, columns=list(names))
        return np.column_stack([np.asarray(table.column(name), dtype=float) for name in names])

    return RowSource(path, [0, *itertools.accumulate(rows)], (len(names),), names, read_block)


def _open_csv(path: Path, columns: Sequence[str] | None) -> RowSource:
    """Open a text file. It is read once to find where its blocks begin."""
    places: list[
        tuple[int, int]
    ] = []  # of each block its place in the file, and the number of its first line
    names = None
    width = 0
    n = 0
    at = 0
    with open(path, "rb") as stream:
        for number, line in enumerate(stream, start=1):
            row = bool(line.strip())
            if row and not width:
                first = line.decode("utf-8-sig").strip()
                names = parse_header(first)
                width = first.count(",") + 1
                row = names is None
            if row:
                places += [(at, number)] * (n % BLOCK_ROWS == 0)
                n += 1
            at += len(line)
    split = None if names is None else [split_unit(name) for name in names]
    names = None if split is None else [name for name, _ in split]
    units = [unit for _, unit in split or ()]
    chosen = None if names is None else _choose_columns(path, names, columns)
    places.append((at, 0))
    at_name = {name: i for i, name in enumerate(names or ())}
    pick: Any = slice(None) if chosen is None else [at_name[name] for name in chosen]

    def read_block(k: int) -> Array:
        """Read the k-th block."""
        with open(path, "rb") as stream:
            stream.seek(places[k][0])
            text = stream.read(places[k + 1][0] - places[k][0]).decode("utf-8-sig")
        lines = [(i, line) for i, line in enumerate(text.split("\n"), places[k][1]) if line.strip()]
        return parse_rows(path, lines, width)[:, pick]

    return RowSource(
        path,
        _list_block_edges(n, BLOCK_ROWS),
        (width if chosen is None else len(chosen),),
        chosen,
        read_block,
        [units[at_name[name]] for name in chosen or ()],
    )


READERS = {".parquet": _open_parquet, ".npy": _open_npy, ".csv": _open_csv}
"""Who reads a file, by its ending; folders without one are read by what they hold."""
