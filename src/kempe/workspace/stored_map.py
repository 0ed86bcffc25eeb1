"""Counts of samples in the cells of a grid, in memory and on disk.

On disk they are Zarr (version 3), which xarray opens: counts with named axes, the middles of their
cells in metres, and what made them.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.errors import UNREADABLE, DamagedError, InputError
from kempe.workspace.cell_map import CellMap, Grid
from kempe.workspace.store import (
    add_array,
    find_format,
    format_description,
    import_zarr,
    read_array,
    write_group,
)

if TYPE_CHECKING:
    from kempe.model.model import Model

FORMAT = "kempe workspace 2"
ANSWERS = "kempe rows "
"""How the formats of `kempe.workspace.map_file` begin, which holds answers to rows of a file."""
CHUNK = 64
"""Cells of a chunk along each axis, at most."""
AFTER = 2
"""Counts after those of the cells: of samples outside the box, and of those left out."""


@dataclass(frozen=True, eq=False)
class SampleCounts:
    """Counts of samples in the cells of a grid, with the data that define them.

    `counts` (cells + 2,) end with the samples outside the box and those that were left out;
    `ranges` are the numbers of all these samples, from the first to before the last.
    """

    metadata: dict[str, Any]
    grid: Grid
    counts: np.ndarray
    ranges: tuple[tuple[int, int], ...] = ()

    @cached_property
    def map(self) -> CellMap:
        """The number of samples in each cell."""
        return CellMap(self.grid, self.counts[: self.grid.count].reshape(self.grid.shape))

    @property
    def samples(self) -> int:
        """Number of samples drawn."""
        return sum(last - first for first, last in self.ranges)

    @property
    def outside(self) -> int:
        """Number of samples outside the box."""
        return int(self.counts[self.grid.count])

    @property
    def left_out(self) -> int:
        """Number of samples that could not be closed, violated a constraint, or were not reached."""
        return int(self.counts[self.grid.count + 1])

    def add_counts(self, first: int, last: int, counts: np.ndarray) -> SampleCounts:
        """Return these counts with those of the samples `first` to `last` added."""
        ranges: list[tuple[int, int]] = []
        for start, stop in sorted([*self.ranges, (first, last)]):
            if ranges and ranges[-1][1] == start:
                start = ranges.pop()[0]
            ranges.append((start, stop))
        total = self.counts + counts[: self.counts.size]
        return replace(self, counts=total, ranges=tuple(ranges))

    def list_missing_ranges(self, n: int, most: int) -> list[tuple[int, int]]:
        """List the missing ranges of the first n samples, each of at most `most` samples."""
        out: list[tuple[int, int]] = []
        start = 0
        for first, last in [*self.ranges, (n, n)]:
            first = min(first, n)
            out += [(k, min(k + most, first)) for k in range(start, first, most)]
            start = last
        return out


def make_empty_counts(metadata: dict[str, Any], grid: Grid) -> SampleCounts:
    """Make counts without samples."""
    return SampleCounts(metadata, grid, np.zeros(grid.count + AFTER, dtype=np.uint64))


def write_map(path: Path, system: Model, samples: SampleCounts) -> None:
    """Write the map of a system, as a whole or not at all. Errors: `DiskError`,
    `MissingExtraError`, `InputError`.
    """
    cells = samples.map
    made = {
        **samples.metadata,
        "ranges": [list(x) for x in samples.ranges],
        **{name: getattr(samples, name) for name in ("samples", "outside", "left_out")},
        "toml": format_description(system),
    }
    attributes = {
        "title": f"workspace of {samples.metadata['frame']}",
        "format": FORMAT,
        "kempe": json.dumps({**made, "checksum": _compute_checksum(made)}),
    }

    def fill_group(group: Any) -> None:
        """Fill the group with the arrays of the map."""
        kind = np.uint32 if cells.counts.max(initial=0) < 2**32 else np.uint64
        chunks = tuple(min(CHUNK, k) for k in cells.counts.shape)
        add_array(
            group,
            "counts",
            cells.counts.shape,
            kind,
            chunks,
            tuple(cells.axes),
            long_name="samples in the cell",
            units="1",
        )[...] = cells.counts.astype(kind)
        for name, middles in cells.axes.items():
            add_array(
                group,
                name,
                middles.shape,
                np.float64,
                middles.shape,
                (name,),
                units="1" if name == "height" else cells.unit,
                long_name=f"{name} in the ground frame",
            )[...] = middles

    write_group(path, FORMAT, attributes, fill_group)


def _compute_checksum(made: dict[str, Any]) -> str:
    """Compute a checksum of the data that define a map."""
    return hashlib.sha256(json.dumps(made, sort_keys=True).encode()).hexdigest()


def read_map(path: Path) -> tuple[SampleCounts, str | None]:
    """Read the counts at a path, and the description of their system as TOML text, if there is one.

    Errors: `InputError` where there is no map, `DamagedError` where it is not what was written.
    """
    zarr = import_zarr()
    if not path.exists():
        raise InputError(f"{path}: there is no such map")
    if (format := find_format(path)) != FORMAT:
        if (format or "").startswith(ANSWERS):
            raise InputError(
                f"{path}: it holds answers of `kempe map`, no workspace; open it with "
                "xarray.open_zarr"
            )
        other = "it was written by another version of Kempe" if format else "this is no map"
        raise InputError(f"{path}: {other} ({FORMAT!r} is not written in its zarr.json)")
    try:
        group = zarr.open_group(str(path), mode="r", zarr_format=3)
        made = json.loads(group.attrs["kempe"])
        if made.pop("checksum") != _compute_checksum(made):
            raise ValueError("the description of the map does not match its checksum")
        grid = Grid(**{k: tuple(made[k]) for k in ("low", "high", "cells", "axes", "names")})
        counts = read_array(group["counts"])
        for name in grid.axes:
            read_array(group[name])
        total, outside, left_out = (made.pop(k) for k in ("samples", "outside", "left_out"))
        if counts.shape != grid.shape or counts.sum() + outside + left_out != total:
            raise ValueError("its counts are not those of its samples")
    except UNREADABLE as error:
        raise DamagedError(f"{path} is damaged: {error}; make it again by the same call") from error
    toml = made.pop("toml")
    ranges = tuple((first, last) for first, last in made.pop("ranges"))
    every = np.concatenate([counts.ravel(), [outside, left_out]]).astype(np.uint64)
    return SampleCounts(made, grid, every, ranges), toml
