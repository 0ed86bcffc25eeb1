"""Configurations, targets and poses as text and as .csv and .npy files, in radians or degrees."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kempe import spatial
from kempe.answers.tables import (
    SUFFIXES,
    as_numbers,
    header_of,
    poses_of_columns,
    rows_of_text,
)
from kempe.arrays import reals
from kempe.description.source import expanded, no_file
from kempe.errors import UNREADABLE, InputError, UnknownNameError
from kempe.model.configurations import (
    as_q,
    by_name,
    closed_from,
    from_home,
    mid,
    q_from_dict,
    units,
)
from kempe.words import DEGREE

if TYPE_CHECKING:
    from kempe.model.model import Model


def is_file(text: str) -> bool:
    """Whether a value given as text names a file of rows."""
    return Path(text).suffix.lower() in SUFFIXES


def numbers(text: str, what: str) -> list[float]:
    """The numbers of 'a,b,c'. Errors: `InputError` naming the one that is none."""
    return as_numbers(text.split(","), what)


def configuration(
    system: Model,
    text: str | None,
    posture: str | None = None,
    degrees: bool = False,
    start: bool = False,
) -> spatial.Array:
    """Configurations from the command line: (nq,), or (n, nq) where `text` names a file.

    `text` is 'a,b,c' (all of q in order), 'name=value,...' (the rest neutral, or as in the posture;
    in a system with loops, what closes these), or a .csv or .npy file. `posture` names a posture of
    the system, or is 'neutral' or 'mid'. Of a `start` no loop is closed.
    Errors: `InputError`, `UnknownNameError`.
    """
    base = None if posture is None else _posture(system, posture)
    if text is None:
        return _posture(system, posture)
    if is_file(text):
        return _configurations(system, expanded(text), degrees, start)
    if "=" in text:
        coordinates = _named(system, text, degrees)
        if start:
            if base is None:
                return from_home(system, coordinates)
            return q_from_dict(system, coordinates, base)
        return closed_from(system, coordinates, base)
    return _radians(system, as_q(system, numbers(text, "q")), degrees)


def _posture(system: Model, name: str | None) -> spatial.Array:
    special = {"neutral": system.neutral.copy(), "mid": mid(system).copy()}
    if name is None:
        return system.neutral.copy()
    if name not in system.structure.posture_names and name in special:
        return special[name]
    if name not in system.structure.posture_names:
        raise UnknownNameError(
            "posture", name, (*system.structure.posture_names, *special), system.name
        )
    return q_from_dict(system, name)


def _named(system: Model, text: str, degrees: bool) -> dict[str, float]:
    unit = units(system)
    out: dict[str, float] = {}
    for part in text.split(","):
        name, sign, value = part.partition("=")
        name = name.strip()
        if not sign:
            raise InputError(
                f"q: {part.strip()!r} has no '='; write name=value,name=value or all {system.nq} "
                "numbers"
            )
        if name in out:
            raise InputError(f"q: {name!r} is given twice")
        (x,) = numbers(value, f"q: {name}")
        out[name] = x * DEGREE if degrees and unit.get(name) == "rad" else x
    return out


def _radians(system: Model, q: spatial.Array, degrees: bool) -> spatial.Array:
    """q with its angles, given in degrees where `degrees` says so, in radians."""
    return q / by_name(system, np.ones(system.nq)).within(degrees)


def _configurations(system: Model, path: Path, degrees: bool, start: bool) -> spatial.Array:
    """Configurations (n, nq) of a file; a .csv may name its columns, the missing ones are as where
    values are named.
    """
    names, rows = read(path)
    if names is None:
        return _radians(system, as_q(system, rows), degrees)
    if len(set(names)) < len(names):
        raise InputError(f"{path}: a column appears twice")
    unit = units(system)
    factors = [DEGREE if degrees and unit.get(name) == "rad" else 1.0 for name in names]
    coordinates = {
        name: column * factor for name, column, factor in zip(names, rows.T, factors, strict=True)
    }
    return (from_home if start else closed_from)(system, coordinates)


def target(system: Model, text: str, degrees: bool = False) -> tuple[spatial.Array, bool]:
    """Target poses (..., 4, 4) from the command line, and whether only their position counts.

    'x,y,z,roll,pitch,yaw' (fixed axes, as in URDF), 'x,y,z,qw,qx,qy,qz' or 'x,y,z'; of planar
    systems 'x,y,angle' and 'x,y' in place of 'x,y,z'; or a file of such rows, where a .npy may also
    hold (n, 4, 4) matrices.
    """
    if is_file(text):
        names, rows = read(expanded(text), matrices=True)
    else:
        names = None
        rows = np.array(numbers(text, "target"))
    if rows.ndim == 3:
        return rows, False
    return poses_of_columns(system.dim, rows, names, degrees)


def read(path: Path, matrices: bool = False) -> tuple[list[str] | None, spatial.Array]:
    """Rows (n, k) of a .csv or .npy file, and the names in the first line of a .csv if it has them.

    A .npy may hold (n, 4, 4) matrices where `matrices` allows. Errors: `InputError` with the file
    and the line.
    """
    if what := no_file(path):
        raise InputError(f"{path}: this is {what}; give the path of a plain file")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    return _read_npy(path, matrices) if path.suffix.lower() == ".npy" else _read_csv(path)


def _read_npy(path: Path, matrices: bool) -> tuple[None, spatial.Array]:
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


def _read_csv(path: Path) -> tuple[list[str] | None, spatial.Array]:
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


def not_finite(q: spatial.Array) -> list[int]:
    """Numbers of the rows of q (n, nq) that hold NaN or infinities; none of a single configuration."""
    return np.flatnonzero(~np.isfinite(q).all(axis=-1)).tolist() if q.ndim > 1 else []


def tolerance(text: str) -> tuple[float, float]:
    """Largest errors in metres and radians, from 'm' (for both) or 'm,rad'."""
    values = numbers(text, "tolerance")
    if len(values) not in (1, 2) or not all(v > 0.0 for v in values):
        raise InputError(
            f"tolerance is {text!r}; it must be one or two positive numbers, in metres and radians"
        )
    return values[0], values[-1]
