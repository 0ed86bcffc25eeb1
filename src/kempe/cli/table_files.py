"""Rows of numbers in .csv and .npy files, and numbers in texts."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from kempe.answers.tables import SUFFIXES, convert_texts
from kempe.description.source import describe_special_file
from kempe.errors import InputError
from kempe.spatial import Array
from kempe.workspace.row_sources import open_rows


def is_table_file(text: str) -> bool:
    """Whether an argument names a .csv or .npy file of rows."""
    return Path(text).suffix.lower() in SUFFIXES


def parse_numbers(text: str, what: str) -> list[float]:
    """Return the numbers of 'a,b,c'.

    Errors: `InputError` that names the part that is no number.

    Errors: `InputError` that names the part that is no number.
    """
    return convert_texts(text.split(","), what)


def parse_finite_numbers(text: str, what: str) -> list[float]:
    """Return the numbers of 'a,b,c', all finite.

    Errors: `InputError`.

    Errors: `InputError`.
    """
    try:
        values = parse_numbers(text, what)
    except InputError:
        raise InputError(f"{what} is {text!r}; it must be numbers, separated by commas") from None
    if bad := [x for x in values if not math.isfinite(x)]:
        raise InputError(f"{what} is {text!r}, which holds {bad[0]}; all numbers must be finite")
    return values


def check_input_file(path: Path) -> None:
    """Raise `InputError` if there is no plain file to read at `path`."""
    if what := describe_special_file(path):
        raise InputError(f"{path}: this is {what}; give the path of a plain file")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")


def read_table(path: Path, matrices: bool = False) -> tuple[list[str] | None, Array]:
    """Return rows (n, k) of a .csv or .npy file, and the names in the first line of a .csv file.

    A .npy may hold (n, 4, 4) matrices where `matrices` allows. Errors: `InputError` with the file
    and the line.
    """
    check_input_file(path)
    source = open_rows(path)
    if not source.n:
        raise InputError(f"{path}: it holds no rows of numbers")
    if len(source.tail) > 1 and not (matrices and source.tail == (4, 4)):
        shape = (source.n, *source.tail)
        wanted = "target, or (n, 4, 4) poses" if matrices else "configuration"
        raise InputError(
            f"{path}: it holds an array of shape {shape}; needed is a row for each {wanted}"
        )
    names = source.names
    return None if names is None else list(names), source.read_rows(0, source.n)


def find_nonfinite_rows(q: Array) -> list[int]:
    """Return the indices of the rows of q (n, nq) with NaN or infinities; [] where q is (nq,)."""
    return np.flatnonzero(~np.isfinite(q).all(axis=-1)).tolist() if q.ndim > 1 else []
