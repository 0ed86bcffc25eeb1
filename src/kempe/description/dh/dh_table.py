"""Rows of Denavit-Hartenberg tables in the forms in which people have them, and their angles in
radians.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.errors import InputError, hint
from kempe.reals import is_array, is_mapping
from kempe.values import Expression, Value, value
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.description.dh.dh import DHRow

ORDER = ("a", "alpha", "d", "theta")
"""Order of plain rows unless their columns are named; a fifth entry is the type of the joint."""

DEGREE = math.pi / 180.0

ONE_TURN = 2.0 * math.pi + 1e-3
"""Angles of a table beyond this many radians are taken for degrees, unless they can be those of a
calibration.

Controllers count turns, so that a theta or an offset of a calibrated arm may be some turns; a twist
alpha never is.
"""

MOST_TURNS = 20.0 * math.pi
"""Largest theta or offset, in radians, that is taken for the turns that a controller has
counted."""

SHARE = 0.1
"""Angles below this, in the unit of the table, are corrections of zero: they do not tell which unit
it is."""

ROUND = 45.0
NEAR_ROUND = 0.5
"""Angles within so many degrees of a multiple of so many degrees are meant to be that multiple."""

LARGEST_LIMIT = 10.0 * math.pi
"""The same for limits, of joints that may turn some times."""

QUARTER = 1e-4
"""How near to a quarter turn in radians a number must be, not to be taken for degrees."""


def rows_of(rows: Any, columns: Sequence[str], known: tuple[str, ...]) -> tuple[list[Any], str]:
    """The rows as dicts (or as they are, where they name their entries), and a note on what was
    assumed of them.

    Errors: `InputError` for tables of another form, and for columns that are not `known`.
    """
    columns = _checked_columns(columns, known)
    table: Any = rows
    if isinstance(table, memoryview):  # one of two axes cannot be gone through
        rows = table = np.asarray(table)
    names: Any = (
        rows.dtype.names
        if is_array(rows)
        else rows
        if is_mapping(rows)
        else getattr(rows, "columns", None)
    )
    if names is not None:
        if columns != ORDER:
            raise InputError("columns are given, but the table names its own; leave columns out")
        return _named(rows, list(names), known), ""
    if (
        isinstance(rows, (str, bytes))
        or not isinstance(rows, Iterable)
        or getattr(table, "ndim", 1) == 0
    ):
        raise InputError(
            f"rows are {rows!r}; they must be a list of rows, an array (n, 4) or a table by column "
            "name"
        )
    plain = False
    out: list[Any] = []
    for i, row in enumerate(table, 1):
        keys = _keys(row)
        entries = row
        own = keys is None and isinstance(row, (list, tuple, np.ndarray))
        plain |= own
        out.append(
            _plain(row, i, columns)
            if own
            else row
            if keys is None
            else dict(zip(keys, entries, strict=True))
        )
    if columns != ORDER and not plain and out:
        raise InputError("columns are given, but the rows name their entries; leave columns out")
    return out, f"plain rows of the table were read as {', '.join(columns)}" if plain else ""


def _keys(row: Any) -> list[str] | None:
    """Names of the entries of a row that is no dict but names them: a named tuple, a record or a
    series.
    """
    if isinstance(row, np.void):
        return list(row.dtype.names or ())
    named: Any = getattr(row, "_fields" if isinstance(row, tuple) else "index", None)
    if named is None or isinstance(row, (list, np.ndarray)) or callable(named):
        return None
    return [str(name) for name in named]


def _checked_columns(columns: Any, known: tuple[str, ...]) -> tuple[str, ...]:
    given: Any = columns
    if isinstance(columns, str) or not isinstance(columns, Iterable):
        raise InputError(f"columns are {columns!r}; they must be a list of names, such as {ORDER}")
    names: tuple[str, ...] = tuple(given)
    for name in names:
        if name not in known:
            raise InputError(f"columns hold {name!r}, which a row does not have{hint(name, known)}")
    if len(set(names)) < len(names):
        raise InputError(f"columns are {names}; a name appears twice")
    return names


def _plain(row: Any, number: int, columns: tuple[str, ...]) -> dict[str, Any]:
    """A row without names as a dict."""
    entries = list(row)
    names = (*columns, "type") if columns == ORDER and len(entries) == 5 else columns
    if len(entries) != len(names):
        also = ", and the type where it is not revolute" if columns == ORDER else ""
        raise InputError(
            f"row {number} has {counted(len(entries), 'entry')}; it must have "
            f"{', '.join(columns)}{also}"
        )
    return {name: _own(x) for name, x in zip(names, entries, strict=True)}


def _named(table: Any, names: list[Any], known: tuple[str, ...]) -> list[dict[str, Any]]:
    """Rows of a table with named columns; entries that are missing (None, NaN where no number is
    due) are left out.
    """
    fields: list[str] = []
    for name in names:
        field = str(name).strip().lower()
        if field not in known:
            raise InputError(f"the table has an unknown column {name!r}{hint(name, known)}")
        fields.append(field)
    if len(set(fields)) < len(fields):
        raise InputError(f"the table has columns {names}; a name appears twice")
    columns: list[list[Any]] = []
    for name in names:
        column = entries = table[name]
        if isinstance(column, (str, bytes)) or not isinstance(column, Iterable):
            raise InputError(f"column {name!r} is {column!r}; it must have an entry for each row")
        columns.append(list(entries))
    if len({len(column) for column in columns}) > 1:
        said = ", ".join(
            f"{len(column)} of {name!r}" for name, column in zip(names, columns, strict=True)
        )
        raise InputError(f"the columns have different lengths: {said}")
    rows: list[dict[str, Any]] = []
    for entries in zip(*columns, strict=True):
        row = {field: _own(x) for field, x in zip(fields, entries, strict=True)}
        rows.append(
            {k: x for k, x in row.items() if not (x is None or (k not in ORDER and _is_nan(x)))}
        )
    return rows


def _own(x: Any) -> Any:
    """A number or text of numpy as one of Python."""
    given: Any = x
    return given.item() if isinstance(x, np.generic) else x


def _is_nan(x: Any) -> bool:
    return isinstance(x, float) and math.isnan(x)


# ---- angles


def counts_turns(rows: Iterable[DHRow]) -> bool:
    """Whether angles beyond a turn, in a table of radians, can be turns that a controller has
    counted.

    They are few then: in a table of degrees most angles are larger than 2 pi, in one of radians
    most are not. A single angle does not tell, and may be one. Angles that are expressions are
    those of somebody who writes radians.
    """
    within = 0
    beyond = 0
    for i, row in enumerate(rows, 1):
        for k in ("alpha", "theta", *(("offset",) if row.type == "revolute" else ())):
            x = value(getattr(row, k), f"row {i}: {k}")
            number = not isinstance(x, Expression)
            beyond += number and abs(x) > ONE_TURN
            within += not number or SHARE <= abs(x) <= ONE_TURN
    return beyond <= max(1, within)


def in_radians(row: DHRow, number: int, deg: bool, winds: bool = True) -> DHRow:
    """The row with its angles in radians; `winds` is what `counts_turns` says of the table.

    Errors: `InputError` for angles that are clearly in the other unit.
    """
    if not isinstance(deg, (bool, np.bool_)):
        raise InputError(f"deg is {deg!r}; it must be True or False")
    if not isinstance(row.flip, (bool, np.bool_)):
        raise InputError(f"row {number}: flip is {row.flip!r}; it must be True or False")
    turns = row.type == "revolute"
    if row.type == "fixed" and (row.flip or row.offset != 0.0):
        raise InputError(
            f"row {number}: a fixed row has no offset and is not flipped: it has no joint variable"
        )
    angles = ("alpha", "theta", "offset") if turns else ("alpha", "theta")
    changed: dict[str, Any] = {
        k: _angle(getattr(row, k), f"row {number}: {k}", deg, winds and k != "alpha")
        for k in angles
    }
    if turns:
        changed["limits"] = _limits(row.limits, f"row {number}: limits", deg)
        if deg and isinstance(row.velocity, (int, float, np.number)):
            changed["velocity"] = row.velocity * DEGREE
    return replace(row, **changed)


def _angle(given: Value | str, what: str, deg: bool, winds: bool) -> Value:
    x = value(given, what)
    if isinstance(x, Expression):
        if not deg:
            return x
        if (
            "pi"
            in x.text.replace("(", " ")
            .replace(")", " ")
            .replace("*", " ")
            .replace("/", " ")
            .split()
        ):
            raise InputError(
                f"{what} is {x.text!r} with deg=True, where angles are degrees: leave deg out, or "
                "pi"
            )
        return Expression(f"radians({x.text})")
    if not deg:
        if abs(x) > ONE_TURN and not (winds and abs(x) <= MOST_TURNS and not _is_round(x)):
            same = x - 2.0 * math.pi * round(x / (2.0 * math.pi))
            raise InputError(
                f"{what} is {x:g}, which is {abs(x) / (2.0 * math.pi):.1f} turns in radians; for "
                f"degrees give deg=True; if it is in radians, the same angle is {same:.12g}"
            )
        return x
    quarters = x / (0.5 * math.pi)
    if 0.5 < abs(quarters) < 4.5 and abs(quarters - round(quarters)) < QUARTER:
        raise InputError(
            f"{what} is {x:g} with deg=True, where angles are degrees; in radians it is "
            f"{90 * round(quarters)} degrees: leave deg out, or write that"
        )
    return x * DEGREE


def _is_round(x: float) -> bool:
    """Whether a number is one that people write in degrees: a whole or half one, or nearly a
    multiple of 45.
    """
    return (2.0 * x) % 1.0 == 0.0 or abs(x - ROUND * round(x / ROUND)) < NEAR_ROUND


def _limits(given: Any, what: str, deg: bool) -> Any:
    """Limits of a turning joint in radians; what is no pair is left to the joint, which refuses it."""
    entries: Any = given
    if not isinstance(given, (list, tuple, np.ndarray)):
        return given
    out: list[Any] = []
    for x in entries:
        number: Any = x
        real = isinstance(x, (int, float, np.number)) and not isinstance(x, bool)
        if real and not deg and LARGEST_LIMIT < abs(number) < math.inf:
            turns = abs(number) / (2.0 * math.pi)
            raise InputError(
                f"{what} hold {number:g}, which is {turns:.1f} turns in radians; for degrees give "
                "deg=True"
            )
        out.append(float(number) * DEGREE if real and deg else number)
    return tuple(out)
