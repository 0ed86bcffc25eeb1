"""Maps of workspaces on disk, as Zarr (version 3), which xarray opens.

A map has counts with named axes, the middles of their cells in metres, and what made them.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.errors import UNREADABLE, DamagedError, DiskError, InputError
from kempe.workspace.cell_map import CellMap, Grid
from kempe.workspace.sampling_job import checksum_of
from kempe.workspace.store import (
    add_array,
    consolidate,
    description_of,
    format_of,
    refuse_place,
    take_place,
    zarr_library,
)

if TYPE_CHECKING:
    from kempe.model.model import Model

FORMAT = "kempe workspace 1"
CHUNK = 64
"""Cells of a chunk along each axis, at most."""
SAME = 1e-9
"""Part of a cell by which the middles of an axis may be off, which rounding makes so."""


@dataclass(frozen=True)
class Stored:
    """What a file of a map holds: the map, numbers of samples, what made it, and the system's
    description as TOML.
    """

    map: CellMap
    samples: int
    outside: int
    left_out: int
    said: dict[str, Any]
    toml: str | None = None
    """What a file that was read says; of what is to be written, it is worked out then."""


def write_map(path: Path, system: Model, stored: Stored) -> None:
    """Write a map of a system, which is then there whole or not at all. Errors: `DiskError`,
    `MissingExtraError`, `InputError`.
    """
    zarr = zarr_library()
    refuse_place(path, FORMAT)
    toml = description_of(system)
    beside = path.with_name(path.name + ".new")
    try:
        shutil.rmtree(beside, ignore_errors=True)
        group = zarr.open_group(str(beside), mode="w", zarr_format=3)
        group.attrs.update(_attributes(stored, toml))
        axes = stored.map.axes
        counts = stored.map.counts
        chunks = tuple(min(CHUNK, k) for k in counts.shape)
        kind = np.uint32 if counts.max(initial=0) < 2**32 else np.uint64
        array = add_array(
            group,
            "counts",
            counts.shape,
            kind,
            chunks,
            tuple(axes),
            long_name="samples in the cell",
            units="1",
        )
        array[...] = counts.astype(kind)
        for name, middles in axes.items():
            unit = "1" if name == "height" else stored.map.unit
            array = add_array(
                group,
                name,
                middles.shape,
                np.float64,
                middles.shape,
                (name,),
                units=unit,
                long_name=f"{name} in the ground frame",
            )
            array[...] = middles
        consolidate(beside)
        take_place(beside, path)
    except OSError as error:
        shutil.rmtree(beside, ignore_errors=True)
        raise DiskError(f"{path} cannot be written: {error.strerror or error}") from error


def _attributes(stored: Stored, toml: str | None) -> dict[str, Any]:
    numbers = {"samples": stored.samples, "outside": stored.outside, "left_out": stored.left_out}
    made = {**stored.said, **numbers, "toml": toml}
    made["checksum"] = _checksum(stored.map.counts, made)
    return {
        "title": f"workspace of {stored.said['frame']}",
        "format": FORMAT,
        "kempe": json.dumps(made),
    }


def _checksum(counts: np.ndarray, made: dict[str, Any]) -> str:
    """A checksum of counts and of what made them."""
    return hashlib.sha256(
        f"{checksum_of(counts)} {json.dumps(made, sort_keys=True)}".encode()
    ).hexdigest()


def read_map(path: Path) -> Stored:
    """The map at a path. Errors: `InputError` where there is none, `DamagedError` where it is not
    what was written.
    """
    zarr = zarr_library()
    if not path.exists():
        raise InputError(f"{path}: there is no such map")
    if format_of(path) != FORMAT:
        raise InputError(
            f"{path}: this is no map of a workspace ({FORMAT!r} is not written in its zarr.json)"
        )
    again = "make it again by the same call"
    try:
        group = zarr.open_group(str(path), mode="r", zarr_format=3)
        made = json.loads(group.attrs["kempe"])
        counts = np.asarray(group["counts"][...])
        grid = Grid(**{k: tuple(made[k]) for k in ("low", "high", "cells", "axes", "names")})
        middles = {name: np.asarray(group[name][...]) for name in grid.axes}
        checksum = made.pop("checksum")
    except UNREADABLE as error:
        raise DamagedError(
            f"{path} is damaged ({type(error).__name__}: {error}); {again}"
        ) from error
    if counts.shape != grid.shape or _checksum(counts, made) != checksum:
        raise DamagedError(
            f"{path} is damaged: the counts, or what made them, are not what was written; {again}"
        )
    cells = CellMap(grid, counts)
    for (name, written), edge in zip(cells.axes.items(), cells.cell, strict=True):
        found = middles[name]
        if found.shape != written.shape or not (np.abs(found - written) < SAME * edge).all():
            raise DamagedError(
                f"{path} is damaged: its axis {name!r} is not what was written; {again}"
            )
    samples, outside, left_out = (int(made.pop(k)) for k in ("samples", "outside", "left_out"))
    return Stored(cells, samples, outside, left_out, made, made.pop("toml"))
