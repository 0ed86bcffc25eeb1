"""Counts of ranges of samples on disk while a map is made: a file for each part."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from kempe.analysis.maps.part_log import DonePart, PartLog, write_whole
from kempe.errors import UNREADABLE, DiskError

BLOCK = 2**18
"""Counts that are converted at once."""
MANY = 24
"""Parts from which on those that follow each other are put into one file."""


def checksum_of(counts: np.ndarray) -> str:
    """A checksum of counts, by their values."""
    digest = hashlib.sha256()
    flat = counts.reshape(-1)
    for k in range(0, flat.size, BLOCK):
        digest.update(flat[k : k + BLOCK].astype("<u8").data)
    return digest.hexdigest()


class SampleParts(PartLog):
    """The counts of ranges of samples, beside the path of a map."""

    def __init__(self, path: Path, said: dict[str, Any], entries: int):
        super().__init__(path, said, 3 * 8 * entries)
        self.entries = entries

    def file(self, part: DonePart) -> Path:
        """Where the counts of a part are."""
        return self.folder / f"{part.first}-{part.last}.npy"

    def sound(self, part: DonePart) -> bool:
        """Whether the counts are there, and those that were written."""
        return self.read(part) is not None

    def read(self, part: DonePart) -> np.ndarray | None:
        """The counts of a part; None where they are not what was written."""
        try:
            counts = np.load(self.file(part), allow_pickle=False)
        except UNREADABLE:
            return None
        return (
            counts
            if counts.shape == (self.entries,) and checksum_of(counts) == part.checksum
            else None
        )

    def add_counts(self, first: int, last: int, counts: np.ndarray) -> None:
        """Write one more part. Errors: `DiskError`."""
        self.add(self._written(first, last, counts))
        if len(self.done) > MANY:
            self._merge()

    def _written(self, first: int, last: int, counts: np.ndarray) -> DonePart:
        part = DonePart(first, last, checksum_of(counts))
        write_whole(self.file(part), lambda stream: np.save(stream, counts))
        return part

    def _merge(self) -> None:
        """Put parts that follow each other into one file; the former ones go when the list no
        longer names them.
        """
        former = self.done
        runs: list[list[DonePart]] = []
        for part in sorted(former):
            if runs and runs[-1][-1].last == part.first:
                runs[-1].append(part)
            else:
                runs.append([part])
        self.done = [
            run[0] if len(run) == 1 else self._written(run[0].first, run[-1].last, self.total(run))
            for run in runs
        ]
        self.write_list()
        for part in set(former) - set(self.done):
            self.file(part).unlink(missing_ok=True)

    def total(self, parts: list[DonePart] | None = None) -> np.ndarray:
        """The sum (entries,) of parts, by default of all, of uint64. Errors: `DiskError`."""
        out = np.zeros(self.entries, dtype=np.uint64)
        for part in self.done if parts is None else parts:
            counts = self.read(part)
            if counts is None:
                raise DiskError(
                    f"{self.file(part)} was damaged meanwhile: the same call draws it again"
                )
            out += counts
        return out
