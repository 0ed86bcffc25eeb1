"""Results as folders of Zarr (version 3) with named axes, which xarray opens: there whole or not at
all.
"""

from __future__ import annotations

import json
import os
import shutil
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kempe.errors import UNREADABLE, InputError, KempeError, MissingExtraError

if TYPE_CHECKING:
    from kempe.model.system import System


def zarr_library() -> Any:
    """The package zarr. Errors: `MissingExtraError`."""
    try:
        import zarr
    except ImportError:
        raise MissingExtraError("zarr", "scale") from None
    return zarr


def description_of(system: System) -> str | None:
    """The system as TOML text, to be read again; None where it holds what no file can, such as
    functions.
    """
    from kempe.description.toml.toml_writer import write_toml

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
