"""Counts of ranges of samples on disk while a map is made: what is done is found again after any end of the process.

A folder beside the map holds a list and one file for each part. Both are written under another name first and then
renamed, so that each is there whole or not at all; the list has a checksum of each part. A part that is not what was
written is left out, and its samples are drawn again.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from kempe.errors import DiskError, InputError

LIST = "parts.json"
BLOCK = 2**18
"""Counts that are converted at once."""
MANY = 24
"""Parts from which on those that follow each other are put into one file."""


class SamplePart(NamedTuple):
    """The samples `first` to `last`, whose counts are in a file with this checksum."""

    first: int
    last: int
    file: str
    checksum: str


def checksum_of(counts: np.ndarray) -> str:
    """A checksum of counts, by their values."""
    digest, flat = hashlib.sha256(), counts.reshape(-1)
    for k in range(0, flat.size, BLOCK):
        digest.update(flat[k : k + BLOCK].astype("<u8").data)
    return digest.hexdigest()


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
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        why = "the disk is full" if full else error.strerror or str(error)
        raise DiskError(f"{path} cannot be written: {why}; what was written before stands, and the same call goes on "
                        f"from there") from error  # fmt: skip


class SampleParts:
    """The folder of the parts of a map: `done` are those that are whole, `damaged` how many were not."""

    def __init__(self, path: Path, said: dict[str, Any], entries: int):
        self.folder, self.said, self.entries = path.with_name(path.name + ".parts"), said, entries
        self.done: list[SamplePart] = []
        self.damaged = 0

    def begin(self) -> None:
        """Find what is done, and make the folder. Errors: `InputError` where it is of another map; `DiskError`."""
        try:
            listed = json.loads((self.folder / LIST).read_text(encoding="utf-8"))
            parts = [SamplePart(*part) for part in listed["parts"]]
            of = listed["of"]
        except FileNotFoundError:
            of, parts = self.said, []
        except (ValueError, KeyError, TypeError):
            of, parts = self.said, []  # the list itself is damaged: all is done anew
            self.damaged = 1
        refuse_other(of, self.said, str(self.folder))
        for part in parts:
            if self.read(part) is None:
                self.damaged += 1
            else:
                self.done.append(part)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DiskError(f"{self.folder} cannot be made: {error.strerror}") from error
        free, needed = shutil.disk_usage(self.folder).free, 3 * 8 * self.entries
        if free < needed:
            raise DiskError(f"{self.folder}: {free / 1e6:.3g} MB are free on this disk; the map needs up to "
                            f"{needed / 1e6:.3g} MB while it is made")  # fmt: skip

    def read(self, part: SamplePart) -> np.ndarray | None:
        """The counts of a part; None where they are not what was written."""
        try:
            counts = np.load(self.folder / part.file, allow_pickle=False)
        except (OSError, ValueError, EOFError):
            return None
        return counts if counts.shape == (self.entries,) and checksum_of(counts) == part.checksum else None

    def add(self, first: int, last: int, counts: np.ndarray) -> None:
        """Write one more part. Errors: `DiskError`."""
        part = SamplePart(first, last, f"{first}-{last}.npy", checksum_of(counts))
        write_whole(self.folder / part.file, lambda stream: np.save(stream, counts))
        self.done.append(part)
        self._list()
        if len(self.done) > MANY:
            self._merge()

    def _merge(self) -> None:
        """Put parts that follow each other into one file; the former ones go when the list no longer names them."""
        former = self.done
        runs: list[list[SamplePart]] = []
        for part in sorted(former):
            if runs and runs[-1][-1].last == part.first:
                runs[-1].append(part)
            else:
                runs.append([part])
        self.done = []
        for run in runs:
            whole, counts = run[0], None
            if len(run) > 1:
                counts = self.total(run)
                file = f"{run[0].first}-{run[-1].last}.npy"
                whole = SamplePart(run[0].first, run[-1].last, file, checksum_of(counts))
                write_whole(self.folder / file, lambda stream, x=counts: np.save(stream, x))
            self.done.append(whole)
        self._list()
        for part in set(former) - set(self.done):
            (self.folder / part.file).unlink(missing_ok=True)

    def _list(self) -> None:
        """Write down which parts are done. Errors: `DiskError`."""
        text = json.dumps({"of": self.said, "parts": self.done}, indent=1)
        write_whole(self.folder / LIST, lambda stream: stream.write(text.encode()))

    def missing(self, n: int, most: int, piece: int) -> list[tuple[int, int]]:
        """Ranges of at most `most` samples, whole pieces, that are left of the first n."""
        most, at = max(piece, most // piece * piece), 0
        out: list[tuple[int, int]] = []
        for first, last in [*sorted((p.first, p.last) for p in self.done), (n, n)]:
            while at < first:
                out.append((at, min(at + most, first)))
                at = out[-1][1]
            at = max(at, last)
        return out

    def total(self, parts: list[SamplePart] | None = None) -> np.ndarray:
        """The sum (entries,) of parts, by default of all, of uint64. Errors: `DiskError`."""
        out = np.zeros(self.entries, dtype=np.uint64)
        for part in self.done if parts is None else parts:
            counts = self.read(part)
            if counts is None:
                raise DiskError(f"{self.folder / part.file} was damaged meanwhile: the same call draws it again")
            out += counts
        return out

    def clear(self) -> None:
        """Drop the folder: the map holds all of it."""
        shutil.rmtree(self.folder, ignore_errors=True)


def refuse_other(of: dict[str, Any], said: dict[str, Any], where: str) -> None:
    """Refuse to add to a map of something else. Errors: `InputError` that says what differs."""
    different = [key for key in said if of.get(key) != said[key]]
    if different:
        key = different[0]
        raise InputError(
            f"{where} belongs to another map: its {key} is {of.get(key)!r}, and here it is {said[key]!r}; take another "
            f"path, or remove it"
        )
