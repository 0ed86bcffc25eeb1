"""Results of long work on disk: parts with checksums, which a later process finds again.

Results are also stored as folders of Zarr.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import warnings
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from kempe.errors import UNREADABLE, DiskError, InputError, KempeError, MissingExtraError

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- parts with checksums

# A folder beside what is made holds a list: a line that says what the work is, and one for each
# part that is done, each with a checksum of its own. Lines are added whole; other files are written
# under another name first and then renamed. A line that is cut off counts as not written, and a
# part that is not what was written is made again.

LIST = "parts.jsonl"


class DonePart(NamedTuple):
    """Number `first` to `last` of the work, the checksum of what was made, and that of what it was
    made of.
    """

    first: int
    last: int
    checksum: str
    source: str = ""


class PartLog:
    """The folder of the parts of what is made at a path.

    `said` is what the work is, as plain data, and `needed` the bytes that the disk must have free.
    After `begin`, `done` are the parts that are whole, `damaged` says how many were not, and
    `header` is what they were said to be.
    """

    loose: tuple[str, ...] = ()
    """What of the work may differ from what is there."""

    def __init__(self, path: Path, said: dict[str, Any], needed: int):
        self.path = path
        self.folder = path.with_name(path.name + ".parts")
        self.said = said
        self.needed = needed
        self.done: list[DonePart] = []
        self.damaged = 0
        self.header = said
        self.keys = [key for key in said if key not in self.loose]

    def sound(self, part: DonePart) -> bool:
        """Whether what is on disk of a part is what was written."""
        raise NotImplementedError

    def begin(self) -> None:
        """Find what is done, and make the folder. Errors: `InputError` where it is of another map;
        `DiskError`.
        """
        try:
            lines = (
                (self.folder / LIST).read_bytes().split(b"\n")
                if (self.folder / LIST).exists()
                else [b""]
            )
        except OSError as error:
            raise DiskError(f"{self.folder / LIST} cannot be read: {error.strerror}") from error
        torn = lines.pop()
        read: list[Any] = [_read(line) for line in lines]
        header = read[:1]
        rest = read[1:]
        whole = header != [None]  # else all is done anew
        self.header = header[0] if whole and header else self.said
        refuse_other(self.header, self.said, str(self.folder), self.keys)
        found: dict[int, DonePart] = (
            {x[0]: DonePart(*x) for x in rest if x is not None} if whole else {}
        )
        self._make()
        self.done = [part for part in sorted(found.values()) if self.sound(part)]
        self.damaged += len(found) - len(self.done) + rest.count(None) if whole else 1
        if torn or self.damaged or not header:
            self.write_list()

    def _make(self) -> None:
        """Make the folder, on a disk that has enough room. Errors: `DiskError`."""
        free = shutil.disk_usage(self.path.parent).free
        if free < self.needed:
            raise DiskError(
                f"{self.path.parent}: {free / 1e6:.3g} MB are free on this disk; the map needs up "
                f"to {self.needed / 1e6:.3g} MB while it is made"
            )
        try:
            self.folder.mkdir(exist_ok=True)
        except OSError as error:
            raise DiskError(f"{self.folder} cannot be made: {error.strerror}") from error
        if not os.access(self.folder, os.W_OK):
            raise DiskError(f"{self.folder} may not be written to")

    def add(self, part: DonePart) -> None:
        """Write down that one more part is done. Errors: `DiskError`."""
        try:
            with open(self.folder / LIST, "ab") as stream:
                stream.write(_line(part))
                stream.flush()
                os.fsync(stream.fileno())
        except OSError as error:
            raise not_written(self.folder / LIST, error) from error
        self.done.append(part)

    def write_list(self) -> None:
        """Write down anew what is done. Errors: `DiskError`."""
        text = b"".join(map(_line, [self.said, *self.done]))
        write_whole(self.folder / LIST, lambda stream: stream.write(text))

    def missing(self, n: int, most: int, piece: int) -> list[tuple[int, int]]:
        """Ranges of at most `most`, whole pieces, that are left of the first n."""
        most = max(piece, most // piece * piece)
        at = 0
        out: list[tuple[int, int]] = []
        for first, last in [*sorted((p.first, p.last) for p in self.done), (n, n)]:
            while at < first:
                out.append((at, min(at + most, first)))
                at = out[-1][1]
            at = max(at, last)
        return out

    def count(self, n: int) -> int:
        """How many of the first n are done."""
        return sum(p.last - p.first for p in self.done if p.last <= n)

    def clear(self) -> None:
        """Drop the folder: the map holds all of it."""
        shutil.rmtree(self.folder, ignore_errors=True)


def _line(said: Any) -> bytes:
    text = json.dumps(said).encode()
    return b"%08x %s\n" % (zlib.crc32(text), text)


def _read(line: bytes) -> Any:
    """What a line says; None where it is not what was written."""
    sum_, _, text = line.partition(b" ")
    try:
        return json.loads(text) if int(sum_, 16) == zlib.crc32(text) else None
    except ValueError:
        return None


def write_whole(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file by `write(stream)` so that it is there whole or not at all. Errors: `DiskError`."""
    beside = path.with_name(path.name + ".new")
    try:
        with open(beside, "wb") as stream:
            write(stream)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(beside, path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise not_written(path, error) from error


def not_written(path: Path, error: OSError) -> DiskError:
    """The error for a part that could not be written."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    why = (
        "the disk is full"
        if full
        else error.strerror or "not all of it was taken: the disk may be full"
    )
    return DiskError(
        f"{path} cannot be written: {why}; what was written before stands, and the same call goes "
        "on from there"
    )


def refuse_other(
    of: dict[str, Any], said: dict[str, Any], where: str, keys: Iterable[str] | None = None
) -> None:
    """Refuse to add to a map of something else, by these keys, or all. Errors: `InputError` that
    says what differs.
    """
    different = [key for key in (said if keys is None else keys) if of.get(key) != said[key]]
    if different:
        key = different[0]
        if key == "system":
            why = (
                f"it is of another system, or that system has changed since (hash {of.get(key)}, "
                f"here {said[key]})"
            )
        else:
            why = f"its {key} is {of.get(key)!r}, and here it is {said[key]!r}"
        raise InputError(f"{where} belongs to another map: {why}; take another path, or remove it")


# ---- Zarr folders

# Version 3 of the format, with named axes, which xarray opens; a folder is there whole or not at
# all.


def zarr_library() -> Any:
    """The package zarr. Errors: `MissingExtraError`."""
    try:
        import zarr
    except ImportError:
        raise MissingExtraError("zarr", "scale") from None
    return zarr


def description_of(system: Model) -> str | None:
    """The system as TOML text, to be read again; None where it holds what no file can, such as
    functions.
    """
    from kempe.description.toml_writer import write_toml

    try:
        return write_toml(system.mechanism)
    except KempeError:
        return None


def format_of(path: Path) -> str | None:
    """Which of our formats is written at a path, sound or not; None for all else."""
    try:
        return json.loads((path / "zarr.json").read_text(encoding="utf-8"))["attributes"]["format"]
    except UNREADABLE:
        return None


OTHER_FORMATS = {
    ".csv",
    ".tsv",
    ".txt",
    ".json",
    ".xlsx",
    ".xls",
    ".npy",
    ".npz",
    ".parquet",
    ".feather",
    ".arrow",
    ".h5",
    ".hdf5",
    ".mat",
    ".pkl",
    ".zip",
    ".gz",
    ".bz2",
    ".xz",
    ".zst",
}
"""Endings of files that are no folders of Zarr."""


def refuse_place(path: Path, format: str) -> None:
    """Refuse a path that has no folder, or where something else than this format is. Errors:
    `InputError`.
    """
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {str(path.parent)!r}")
    stem = path
    while stem.suffix.lower() in OTHER_FORMATS:
        stem = stem.with_suffix("")
    if stem != path:
        raise InputError(
            f"{path}: results are written as a folder of Zarr; give it a name such as "
            f"{stem.name + '.zarr'!r}, and open it with xarray.open_zarr"
        )
    if path.exists() and format_of(path) != format:
        raise InputError(f"{path}: there is something else than a map; take another path")


def add_array(
    group: Any,
    name: str,
    shape: tuple[int, ...],
    dtype: Any,
    chunks: tuple[int, ...],
    dims: tuple[str, ...],
    compressors: Any = "auto",
    **attributes: Any,
) -> Any:
    """A new array of a group, with names of its axes and what else is said of it."""
    return group.create_array(
        name,
        shape=shape,
        dtype=dtype,
        chunks=chunks,
        dimension_names=dims,
        attributes=attributes,
        compressors=compressors,
    )


def consolidate(folder: Path) -> None:
    """Write the descriptions of all arrays into one file, too, which readers look for first."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that not all readers of Zarr know this file
        zarr_library().consolidate_metadata(str(folder))


def take_place(beside: Path, path: Path) -> None:
    """Put a folder in the place of another one."""
    former = path.with_name(path.name + ".former")
    shutil.rmtree(former, ignore_errors=True)
    if path.exists():
        os.replace(path, former)
    os.replace(beside, path)
    shutil.rmtree(former, ignore_errors=True)
