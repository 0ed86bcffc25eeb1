"""Answers that are tables of numbers: their columns by name, and files of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kempe.description.source import expanded, no_file
from kempe.errors import InputError
from kempe.spatial import Array
from kempe.words import counted

SUFFIXES = (".csv", ".npy")
"""Endings of files of numbers."""


class Tabular:
    """An answer with a `table`, which `save` writes. Base of answers that are configurations."""

    def table(self) -> tuple[list[str], Array]:
        """Names and columns (n, k) for a file, in radians and metres."""
        raise NotImplementedError

    def save(self, path: str | Path) -> Path:
        """Write the `table` to a .csv file, with the names in its first line, or to a .npy file;
        returns the path.

        Numbers are written in full: what is read again is equal. Errors: `InputError` for other
        endings, and where the file cannot be written.
        """
        return write_table(path, *self.table())


def write_table(
    path: str | Path, names: Sequence[str], rows: Array, array: Array | None = None
) -> Path:
    """The path written: `rows` (n, k) with their column names to a .csv, or `array` (the rows) to a
    .npy file.

    Errors: `InputError`.
    """
    path = table_file(path)
    if what := no_file(path):
        raise InputError(f"{path}: this is {what}; name a plain file")
    try:
        if path.suffix.lower() == ".npy":
            np.save(path, rows if array is None else array)
        else:
            header = ",".join(names)
            np.savetxt(
                path, rows, delimiter=",", fmt="%.17g", header=header, comments="", encoding="utf-8"
            )
    except OSError as error:
        raise InputError(f"{path}: it cannot be written: {error.strerror or error}") from None
    return path


def table_file(path: str | Path) -> Path:
    """The path of a file of numbers. Errors: `InputError` where its ending is neither .csv nor
    .npy.
    """
    path = expanded(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: results are written to {' or '.join(SUFFIXES)} files")
    return path


def as_numbers(parts: Sequence[str], what: str) -> list[float]:
    """The numbers that texts are. Errors: `InputError` naming the one that is none."""
    try:
        return [float(part) for part in parts]
    except ValueError:
        bad = next(part.strip() for part in parts if not is_number(part))
        raise InputError(
            f"{what}: {bad!r} is not a number; write numbers with commas between them"
        ) from None


def is_number(text: str) -> bool:
    """Whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def header_of(line: str) -> list[str] | None:
    """The names that a first line of a .csv holds; None where it has numbers."""
    names = [_unquoted(cell) for cell in line.split(",")]
    return None if any(map(is_number, names)) else names


def _unquoted(cell: str) -> str:
    """The text of a cell, without blanks and quotation marks around it."""
    return cell.strip().removeprefix('"').removesuffix('"').strip()


def rows_of_text(path: Path, lines: Sequence[tuple[int, str]], width: int) -> Array:
    """The numbers (n, width) of lines of a .csv, each with its number in the file; NaN for empty
    cells.

    Cells may stand in quotation marks, as a program writes them that quotes all cells. Errors:
    `InputError`.
    """
    out = np.empty((len(lines), width))
    for row, (line, text) in zip(out, lines, strict=True):
        cells = text.split(",")
        if len(cells) != width:
            raise InputError(
                f"{path}:{line}: {counted(len(cells), 'value')}; the first line has {width}"
            )
        row[:] = as_numbers([_unquoted(cell) or "nan" for cell in cells], f"{path}:{line}")
    return out
