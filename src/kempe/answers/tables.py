"""Tables of numbers: files of answers, and targets read from columns."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from kempe import spatial
from kempe.arrays import is_number
from kempe.description.source import describe_special_file, expand_path
from kempe.errors import InputError
from kempe.spatial import Array
from kempe.words import ByName, format_count, join_first_words

SUFFIXES = (".csv", ".npy")
"""Endings of files of numbers."""


class Tabular:
    """An answer with a `table`, which `save` writes to a file. Base of answers with configurations."""

    def table(self) -> tuple[list[str], Array]:
        """Return names and columns (n, k) of a table, in radians and metres.

        The configurations come first; success, errors and targets follow where the answer has them.
        """
        names, columns = self._list_columns()
        outcomes = self._list_outcomes()
        own = [name for name in outcomes if name not in names]
        return [*names, *own], np.column_stack([columns, *(outcomes[name] for name in own)])

    def save(self, path: str | Path, *, degrees: bool = False) -> Path:
        """Write the answer to a .csv or .npy file, and return the path.

        A .csv file has the whole `table` with the names of its columns. A .npy file has no names:
        it holds the configurations, without success, errors and targets.

        Numbers are written in full: what is read again is equal. With `degrees` the angles of
        configurations and targets are degrees, and the columns of a .csv file are called
        "q1 [deg]", which is read again as degrees; errors stay in radians. Errors: `InputError` for
        other endings, and where the file cannot be written.
        """
        plain = check_table_path(path).suffix.lower() == ".npy"
        table = self._list_columns() if plain else self.table()
        return write_table(path, *convert_columns(*table, self._list_units(), degrees))

    def _list_columns(self) -> tuple[list[str], Array]:
        """Return names and columns (n, k) of the configurations, in radians and metres."""
        raise NotImplementedError

    def _list_outcomes(self) -> dict[str, np.ndarray]:
        """Return the further columns (n,) of the `table` by name: success, errors, targets."""
        return {}

    def _list_units(self) -> dict[str, str]:
        """Return the units of the columns by name; columns that are never converted have none."""
        return {}


def convert_columns(
    names: list[str], columns: Array, units: Mapping[str, str], degrees: bool
) -> tuple[list[str], Array]:
    """Convert the columns (n, k) with unit "rad" to degrees if that is requested.

    Their names then say so: "q1 [deg]".
    """
    if not degrees:
        return names, columns
    kinds = [units.get(name, "") for name in names]
    named = [
        f"{name} [deg]" if kind == "rad" else name for name, kind in zip(names, kinds, strict=True)
    ]
    return named, ByName(names, kinds, columns).convert_units(degrees)


def write_table(
    path: str | Path, names: Sequence[str], rows: Array, array: Array | None = None
) -> Path:
    """Write numbers to a .csv or .npy file; return its path.

    A .csv file gets `rows` (n, k) with their column names, a .npy file `array`, by default the
    rows.

    Errors: `InputError`.
    """
    path = check_table_path(path)
    if what := describe_special_file(path):
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


def check_table_path(path: str | Path) -> Path:
    """Return the path of a file of numbers.

    Errors: `InputError` if its ending is neither .csv nor .npy.
    """
    path = expand_path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: results are written to {' or '.join(SUFFIXES)} files")
    return path


def convert_texts(parts: Sequence[str], what: str) -> list[float]:
    """Convert texts to numbers. Errors: `InputError` naming the text that is no number."""
    try:
        return [float(part) for part in parts]
    except ValueError:
        bad = next(part.strip() for part in parts if not is_number(part))
        raise InputError(
            f"{what}: {bad!r} is not a number; write numbers with commas between them"
        ) from None


def parse_header(line: str) -> list[str] | None:
    """Return the column names in the first line of a .csv file; None if the line has numbers."""
    names = [_strip_quotes(cell) for cell in line.split(",")]
    return None if any(map(is_number, names)) else names


_UNIT = re.compile(r"(.*\S)\s*\[(deg|rad)\]")


def split_unit(name: str) -> tuple[str, str]:
    """Split the name of a column, such as "q1 [deg]", into name and unit of angles, '' without one."""
    found = _UNIT.fullmatch(name)
    return (found[1], found[2]) if found else (name, "")


def _strip_quotes(cell: str) -> str:
    """Strip blanks and quotation marks from the text of a cell."""
    return cell.strip().removeprefix('"').removesuffix('"').strip()


def parse_rows(path: Path, lines: Sequence[tuple[int, str]], width: int) -> Array:
    """Parse lines of a .csv file into numbers (n, width); empty cells are NaN.

    Each line comes with its line number, for messages.

    Cells may stand in quotation marks, as a program writes them that quotes all cells. Errors:
    `InputError`.
    """
    out = np.empty((len(lines), width))
    for row, (line, text) in zip(out, lines, strict=True):
        cells = text.split(",")
        if len(cells) != width:
            marks = "; commas separate columns, and a point is the decimal mark" * (";" in text)
            raise InputError(
                f"{path}:{line}: {format_count(len(cells), 'value')}; the first line has {width}"
                f"{marks}"
            )
        row[:] = convert_texts([_strip_quotes(cell) or "nan" for cell in cells], f"{path}:{line}")
    return out


# ---- targets read from columns

# Columns are read by their order or by their names.

PLACE = ("x", "y", "z")
TURNED = ("roll", "pitch", "yaw")
QUATERNION = ("qw", "qx", "qy", "qz")
COLUMNS = {
    2: [("x", "y"), ("x", "y", "angle"), (*PLACE, *TURNED), (*PLACE, *QUATERNION)],
    3: [PLACE, (*PLACE, *TURNED), (*PLACE, *QUATERNION)],
}
"""What columns of targets can be, in the plane and in space; the first are positions only."""


def list_target_columns(dim: int, X: Array, is_position: bool) -> dict[str, np.ndarray]:
    """Return the columns (n,) of target poses (n, 4, 4) by name, for tables of answers."""
    values = spatial.xyz_rpy_from_pose(X)
    if is_position:
        order = COLUMNS[dim][0]
    else:
        order = COLUMNS[dim][1]
    places = [5 if name == "angle" else (*PLACE, *TURNED).index(name) for name in order]
    return {f"{TARGET}{name}": values[:, k] for name, k in zip(order, places, strict=True)}


TARGET = "target_"
"""Beginning of the names of columns with targets."""
TARGET_UNITS = {f"{TARGET}{name}": "rad" for name in ("angle", *TURNED)}


def describe_target_columns(dim: int) -> str:
    """Describe which columns targets may have, in the plane or in space."""
    return ", ".join(
        ",".join(names) + " (position only)" * (k == 0) for k, names in enumerate(COLUMNS[dim][:-1])
    ) + (f" or {','.join(COLUMNS[dim][-1])}")


def read_pose_columns(
    dim: int, values: Array, names: Sequence[str] | None = None, degrees: bool = False
) -> tuple[Array, bool]:
    """Read poses (..., 4, 4) of targets from columns (..., k), and whether they are positions only.

    Columns are in the order of `COLUMNS`, or have the `names` there, in capitals or not. Angles
    turn about fixed axes, as in URDF; where `degrees` says so they are degrees. A quaternion of
    length zero gives NaN. Errors: `InputError`.
    """
    width = values.shape[-1]
    keys = None if names is None else [name.lower() for name in names]
    order = next(
        (
            c
            for c in COLUMNS[dim]
            if (len(c) == width if keys is None else sorted(c) == sorted(keys))
        ),
        None,
    )
    if order is None:
        has = (
            format_count(width, "number")
            if names is None
            else f"the columns {join_first_words(names, 12)}"
        )
        order = "" if names is None else ", in any order"
        raise InputError(f"the target has {has}; it must be {describe_target_columns(dim)}{order}")
    if keys is not None:
        values = values[..., [keys.index(name) for name in order]]
    full = np.zeros((*values.shape[:-1], 6))
    whole = ("x", "y", "yaw") if order[-1] == "angle" else order[:3] if order[-1] == "qz" else order
    full[..., [(*PLACE, *TURNED).index(name) for name in whole]] = values[..., : len(whole)]
    if degrees:
        full[..., 3:] *= math.pi / 180.0
    with np.errstate(invalid="ignore", over="ignore"):
        X = spatial.pose_from_xyz_rpy(full)
        if order[-1] == "qz":
            X[..., :3, :3] = spatial.quat_wxyz_to_matrix(values[..., 3:])
    return X, order == COLUMNS[dim][0]
