"""Answers to rows on disk: a Zarr group that fills up chunk by chunk, with a checksum of each."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from kempe.analysis.maps.part_log import DonePart, PartLog, not_written, refuse_other
from kempe.analysis.maps.row_sources import RowSource
from kempe.analysis.maps.row_verbs import AXES, VERBS, Arrays, RowJob, axes_of
from kempe.analysis.maps.zarr_folders import (
    add_array,
    consolidate,
    description_of,
    refuse_place,
    take_place,
    zarr_library,
)
from kempe.errors import UNREADABLE, DamagedError, InputError
from kempe.kinematics.common.parallel import Stopped
from kempe.status import MEMBERS

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
            with (
                path.open("rb") as opened,
                np.load(opened) as file,
            ):  # np.load leaves a damaged file open
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
