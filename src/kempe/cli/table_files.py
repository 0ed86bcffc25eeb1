"""Rows of numbers in .csv and .npy files, and numbers in texts."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from kempe.answers.tables import SUFFIXES, as_numbers, header_of, rows_of_text
from kempe.arrays import reals
from kempe.description.source import no_file
from kempe.errors import UNREADABLE, InputError
from kempe.spatial import Array


def is_file(text: str) -> bool:
    """Whether a value given as text names a file of rows."""
    return Path(text).suffix.lower() in SUFFIXES


def numbers(text: str, what: str) -> list[float]:
    """The numbers of 'a,b,c'. Errors: `InputError` naming the one that is none."""
    return as_numbers(text.split(","), what)


def finite_numbers(text: str, what: str) -> list[float]:
    """The numbers of 'a,b,c', all of them finite. Errors: `InputError`."""
    try:
        values = numbers(text, what)
    except InputError:
        raise InputError(f"{what} is {text!r}; it must be numbers, separated by commas") from None
    if bad := [x for x in values if not math.isfinite(x)]:
        raise InputError(f"{what} is {text!r}, which holds {bad[0]}; all numbers must be finite")
    return values


def read(path: Path, matrices: bool = False) -> tuple[list[str] | None, Array]:
    """Rows (n, k) of a .csv or .npy file, and the names in the first line of a .csv if it has them.

    A .npy may hold (n, 4, 4) matrices where `matrices` allows. Errors: `InputError` with the file
    and the line.
    """
    if what := no_file(path):
        raise InputError(f"{path}: this is {what}; give the path of a plain file")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    return _read_npy(path, matrices) if path.suffix.lower() == ".npy" else _read_csv(path)


def _read_npy(path: Path, matrices: bool) -> tuple[None, Array]:
    try:
        # a map of the file asks for no memory: the header may promise more rows than there are
        array = reals(np.array(np.load(path, mmap_mode="r", allow_pickle=False)), "the file")
    except UNREADABLE:
        raise InputError(f"{path}: it is not a .npy file of numbers") from None
    except MemoryError:
        raise InputError(f"{path}: this memory does not hold the array in it") from None
    if array.ndim == 2 or (matrices and array.ndim == 3 and array.shape[1:] == (4, 4)):
        return None, array
    wanted = (
        "a row for each target, or (n, 4, 4) poses" if matrices else "a row for each configuration"
    )
    raise InputError(f"{path}: it holds an array of shape {array.shape}; needed is {wanted}")


def _read_csv(path: Path) -> tuple[list[str] | None, Array]:
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise InputError(f"{path}: it is not UTF-8 text") from None
    table = [(i, line) for i, line in enumerate(lines, start=1) if line.strip()]
    names = header_of(table[0][1]) if table else None
    if names is not None:
        del table[0]
    if not table:
        raise InputError(f"{path}: it holds no rows of numbers")
    return names, rows_of_text(
        path, table, len(table[0][1].split(",")) if names is None else len(names)
    )


def not_finite(q: Array) -> list[int]:
    """Numbers of the rows of q (n, nq) that hold NaN or infinities; none of a single configuration."""
    return np.flatnonzero(~np.isfinite(q).all(axis=-1)).tolist() if q.ndim > 1 else []
