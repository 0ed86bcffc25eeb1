"""Folders of Zarr (version 3) with checksums and named axes, which xarray opens."""

from __future__ import annotations

import errno
import json
import os
import shutil
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.errors import UNREADABLE, DiskError, InputError, KempeError, MissingExtraError

if TYPE_CHECKING:
    from kempe.model.model import Model


def refuse_other_map(
    of: dict[str, Any], metadata: dict[str, Any], where: str, keys: Iterable[str] | None = None
) -> None:
    """Refuse to add to a map whose data differ, in these keys or in all. Errors: `InputError` with
    the difference.
    """
    different = [
        key for key in (metadata if keys is None else keys) if of.get(key) != metadata[key]
    ]
    if different:
        key = different[0]
        if key == "system":
            why = (
                f"it is of another system, or that system has changed since (hash {of.get(key)}, "
                f"here {metadata[key]})"
            )
        else:
            why = f"its {key} is {of.get(key)!r}, and here it is {metadata[key]!r}"
        raise InputError(f"{where} belongs to another map: {why}; take another path, or remove it")


def import_zarr() -> Any:
    """Import the package zarr. Errors: `MissingExtraError`."""
    try:
        import zarr
    except ImportError:
        raise MissingExtraError("zarr", "scale") from None
    return zarr


def format_description(system: Model) -> str | None:
    """Format the system as TOML text. None if it holds functions or other things that files cannot
    hold.
    """
    from kempe.description.toml_writer import write_toml

    try:
        return write_toml(system.mechanism)
    except KempeError:
        return None


def find_format(path: Path) -> str | None:
    """Find which format of Kempe is stored at a path, sound or damaged; None for other contents."""
    try:
        return json.loads((path / "zarr.json").read_text(encoding="utf-8"))["attributes"]["format"]
    except UNREADABLE:
        return None


TABLES = ".csv .tsv .txt .json .xlsx .xls .npy .npz .parquet .feather .arrow .h5 .hdf5 .mat .pkl"
PACKED = ".zip .gz .bz2 .xz .zst"
OTHER_FORMATS = frozenset(f"{TABLES} {PACKED}".split())
"""Endings of files that are no folders of Zarr."""


def refuse_place(path: Path, format: str) -> None:
    """Refuse a path without a folder, or with contents of another format. Errors: `InputError`."""
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
    if path.exists() and (other := find_format(path)) != format:
        kind = "" if other is None else f" of this kind and version ({other!r})"
        raise InputError(f"{path}: there is something else than a map{kind}; take another path")


def add_array(
    group: Any,
    name: str,
    shape: tuple[int, ...],
    dtype: Any,
    chunks: tuple[int, ...],
    dims: tuple[str, ...],
    packed: bool = True,
    fill: Any = None,
    **attributes: Any,
) -> Any:
    """Add an array with named axes and attributes to a group.

    Each chunk ends with its checksum (CRC-32C), and all chunks that are assigned to are written,
    also those of zeros: their files say what is done.
    """
    codecs: Any = import_zarr().codecs
    return group.create_array(
        name,
        shape=shape,
        dtype=dtype,
        chunks=chunks,
        dimension_names=dims,
        fill_value=fill,
        attributes=attributes,
        compressors=[*[codecs.ZstdCodec()] * packed, codecs.Crc32cCodec()],
        config={"write_empty_chunks": True},
    )


def find_chunk_file(array: Any, index: tuple[int, ...]) -> Path:
    """Find the file of a chunk of an array."""
    return array.store.root / array.path / array.metadata.encode_chunk_key(index)


def read_array(array: Any) -> np.ndarray:
    """Read a whole array. Errors: `ValueError` that names the first missing or damaged chunk."""
    try:
        if array.nchunks_initialized == array.nchunks:
            return np.asarray(array[...])
    except UNREADABLE:
        pass
    for index in np.ndindex(*array.cdata_shape):
        file = find_chunk_file(array, index)
        try:
            file.stat()
            array.blocks[index]
        except UNREADABLE as error:
            name = file.relative_to(array.store.root)
            why = "it is missing" if isinstance(error, FileNotFoundError) else error
            raise ValueError(f"chunk {str(name)!r}: {why}") from error
    raise ValueError(f"array {array.path!r} cannot be read")


def write_group(
    path: Path, format: str, attributes: dict[str, Any], fill: Callable[[Any], None]
) -> None:
    """Write a group, filled by `fill(group)`, in place of the contents of a path. Afterwards it is
    there as a whole or not at all.

    Errors: `DiskError`, `MissingExtraError`, `InputError` for a path where this format may not be
    written.
    """
    zarr = import_zarr()
    refuse_place(path, format)
    beside = path.with_name(path.name + NEW)
    former = path.with_name(path.name + FORMER)
    try:
        shutil.rmtree(beside, ignore_errors=True)
        group = zarr.open_group(str(beside), mode="w", zarr_format=3)
        group.attrs.update(attributes)
        fill(group)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that not all readers of Zarr know this file
            zarr.consolidate_metadata(str(beside))
        for file in beside.rglob("*"):
            if file.is_file():
                with file.open("r+b") as stream:
                    os.fsync(stream.fileno())
        if path.exists():
            shutil.rmtree(former, ignore_errors=True)
            os.replace(path, former)
        os.replace(beside, path)
        shutil.rmtree(former, ignore_errors=True)
    except OSError as error:
        shutil.rmtree(beside, ignore_errors=True)
        raise make_disk_error(path, error) from error


FORMER = ".kempe-former"
NEW = ".kempe-new"
"""Endings of the names that a map has while it is replaced, and that the new one has until then."""


def restore_former_map(path: Path) -> None:
    """Restore the former map at a path after a process ended while it was replaced. If the new map
    is there, the former one is removed.
    """
    former = path.with_name(path.name + FORMER)
    if not path.exists():
        if former.exists():
            os.replace(former, path)
    elif (format := find_format(path)) is not None and format == find_format(former):
        shutil.rmtree(former, ignore_errors=True)


def refuse_small_disk(folder: Path, needed: int) -> None:
    """Refuse to begin if a disk has less than these bytes free. Errors: `DiskError`."""
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise DiskError(
            f"{folder}: {free / 1e6:.3g} MB are free on this disk; the map needs up to "
            f"{needed / 1e6:.3g} MB"
        )


def make_disk_error(path: Path, error: OSError) -> DiskError:
    """Make the error of a result that could not be written."""
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
