"""Serial chains from Denavit-Hartenberg tables and from screw axes (product of exponentials)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from kempe.arguments import explain_errors
from kempe.arrays import is_array, is_mapping
from kempe.description.mechanism import BodyLike, Mechanism
from kempe.errors import InputError, hint
from kempe.poses import (
    Placement,
    make_placement_from_pose,
    place,
    read_direction,
    read_placement_steps,
)
from kempe.units import METRE
from kempe.values import Expression, Value, read_value, read_values
from kempe.words import format_count

# ---- rows of Denavit-Hartenberg tables

# People have them as dicts, records, lists or columns, with angles in degrees or radians.

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


def normalize_rows(
    rows: Any, columns: Sequence[str], known: tuple[str, ...]
) -> tuple[list[Any], str]:
    """Return the rows of a table as dicts or records, and a note on the assumed columns.

    Errors: `InputError` for tables of another form, and for columns that are not `known`.
    """
    columns = _check_columns(columns, known)
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
        return _read_named_table(rows, list(names), known), ""
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
        keys = _list_entry_names(row)
        entries = row
        own = keys is None and isinstance(row, (list, tuple, np.ndarray))
        plain |= own
        out.append(
            _convert_plain_row(row, i, columns)
            if own
            else row
            if keys is None
            else dict(zip(keys, entries, strict=True))
        )
    if columns != ORDER and not plain and out:
        raise InputError("columns are given, but the rows name their entries; leave columns out")
    return out, f"plain rows of the table were read as {', '.join(columns)}" if plain else ""


def _list_entry_names(row: Any) -> list[str] | None:
    """Return the names in a named tuple, a record or a series; None for any other row."""
    if isinstance(row, np.void):
        return list(row.dtype.names or ())
    named: Any = getattr(row, "_fields" if isinstance(row, tuple) else "index", None)
    if named is None or isinstance(row, (list, np.ndarray)) or callable(named):
        return None
    return [str(name) for name in named]


def _check_columns(columns: Any, known: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the columns of plain rows.

    Errors: `InputError`.
    """
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


def _convert_plain_row(row: Any, number: int, columns: tuple[str, ...]) -> dict[str, Any]:
    """Return a row without names as a dict by column."""
    entries = list(row)
    names = (*columns, "type") if columns == ORDER and len(entries) == 5 else columns
    if len(entries) != len(names):
        also = ", and the type where it is not revolute" if columns == ORDER else ""
        raise InputError(
            f"row {number} has {format_count(len(entries), 'entry')}; it must have "
            f"{', '.join(columns)}{also}"
        )
    return {name: _convert_numpy_scalar(x) for name, x in zip(names, entries, strict=True)}


def _read_named_table(table: Any, names: list[Any], known: tuple[str, ...]) -> list[dict[str, Any]]:
    """Return the rows of a table with named columns as dicts, without missing entries.

    None is missing, and NaN where no number is due.
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
        row = {field: _convert_numpy_scalar(x) for field, x in zip(fields, entries, strict=True)}
        rows.append(
            {k: x for k, x in row.items() if not (x is None or (k not in ORDER and _is_nan(x)))}
        )
    return rows


def _convert_numpy_scalar(x: Any) -> Any:
    """Return a number or text of numpy as a number or text of Python."""
    given: Any = x
    return given.item() if isinstance(x, np.generic) else x


def _is_nan(x: Any) -> bool:
    """Whether a value is the number NaN."""
    return isinstance(x, float) and math.isnan(x)


# ---- angles in radians


def has_counted_turns(rows: Iterable[DHRow]) -> bool:
    """Whether angles beyond one turn, in radians, can be turns that a controller has counted.

    They are few then: in a table of degrees most angles are larger than 2 pi, in one of radians
    most are not. A single angle does not tell, and may be one. Angles that are expressions are
    those of somebody who writes radians.
    """
    within = 0
    beyond = 0
    for i, row in enumerate(rows, 1):
        for k in ("alpha", "theta", *(("offset",) if row.type == "revolute" else ())):
            x = read_value(getattr(row, k), f"row {i}: {k}")
            number = not isinstance(x, Expression)
            beyond += number and abs(x) > ONE_TURN
            within += not number or SHARE <= abs(x) <= ONE_TURN
    return beyond <= max(1, within)


def convert_to_radians(row: DHRow, number: int, deg: bool, winds: bool = True) -> DHRow:
    """Return the row with its angles in radians.

    `winds` is the value of `has_counted_turns` for the table.

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
        k: _convert_angle(getattr(row, k), f"row {number}: {k}", deg, winds and k != "alpha")
        for k in angles
    }
    if turns:
        changed["limits"] = _convert_limits(row.limits, f"row {number}: limits", deg)
        if deg and isinstance(row.velocity, (int, float, np.number)):
            changed["velocity"] = row.velocity * DEGREE
    return replace(row, **changed)


def _convert_angle(given: Value | str, what: str, deg: bool, winds: bool) -> Value:
    """Return an angle in radians.

    Errors: `InputError` for an angle that is probably given in the other unit.
    """
    x = read_value(given, what)
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
        if abs(x) > ONE_TURN and not (winds and abs(x) <= MOST_TURNS and not _is_round_number(x)):
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


def _is_round_number(x: float) -> bool:
    """Whether a number is typical of degrees: a multiple of 0.5, or nearly a multiple of 45."""
    return (2.0 * x) % 1.0 == 0.0 or abs(x - ROUND * round(x / ROUND)) < NEAR_ROUND


def _convert_limits(given: Any, what: str, deg: bool) -> Any:
    """Return the limits of a revolute joint in radians; the joint itself refuses what is no pair."""
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


# ---- the chains

CONVENTIONS = ("standard", "modified")
NUMBERS = ("a", "alpha", "d", "theta", "offset")
JOINT_TYPES = ("revolute", "prismatic", "fixed")

UNIT_TOLERANCE = 1e-3
"""A screw whose axis is this close to unit length is normalised: published tables are rounded."""

PITCH_TOLERANCE = 1e-12
"""A pitch below this many metres a radian, relative to the size of the screw, is rounding."""


@dataclass(frozen=True)
class DHRow:
    """Row of a Denavit-Hartenberg table: lengths `a`, `d` [m] and angles `alpha`, `theta` [rad].

    In the modified convention `a` and `alpha` are those that stand before the joint, a(i-1) and
    alpha(i-1). `type` is revolute (theta is the angle at q = 0), prismatic (d is the length at q =
    0) or fixed. `offset` is added to theta or d, and with `flip` the joint counts the other way:
    theta + offset - q. Each number can be an expression in parameters. `name` is the joint's,
    `body` that of the body it moves.
    """

    a: Value | str = 0.0
    alpha: Value | str = 0.0
    d: Value | str = 0.0
    theta: Value | str = 0.0
    type: str = "revolute"
    name: str | None = None
    body: str | None = None
    limits: tuple[float, float] | None = None
    velocity: float | None = None
    effort: float | None = None
    actuated: bool | None = None
    offset: Value | str = 0.0
    flip: bool = False


class TableLike(Protocol):
    """A table with named columns, as a DataFrame is."""

    @property
    def columns(self) -> object:
        """Names of the columns."""
        ...


PlacedAt: TypeAlias = ArrayLike | Placement | Mapping[str, object]
"""A pose (4, 4), a placement, or a dict of the keywords of `kempe.poses.place`."""


@dataclass(frozen=True)
class ScrewRow:
    """Screw axis in the ground frame at q = 0: either `twist`, or `axis` with `point` and `pitch`.

    `twist` is [v; w], the linear part first (Lynch and Park write [w; v]): |w| = 1, or w = 0 and
    |v| = 1 for a slide. `axis` is the direction and `point` a point that it passes through, both in
    the ground frame; `pitch` is metres a radian, infinite for a slide along the axis. `point` can
    use parameters.
    """

    twist: Iterable[float] | None = None
    axis: Iterable[float] | str | None = None
    point: Iterable[Value | str] = (0.0, 0.0, 0.0)
    pitch: float = 0.0
    name: str | None = None
    body: str | None = None
    limits: tuple[float, float] | None = None
    velocity: float | None = None
    effort: float | None = None
    actuated: bool | None = None


Rows: TypeAlias = (
    Sequence[DHRow | Mapping[str, object] | Sequence[Value | str]]
    | Mapping[str, Sequence[object]]
    | ArrayLike
    | TableLike
)
"""Rows of a Denavit-Hartenberg table, or a table with named columns."""


@explain_errors
def from_dh(
    rows: Rows,
    convention: str = "standard",
    name: str = "arm",
    base: PlacedAt | None = None,
    tool: PlacedAt | None = None,
    parameters: Mapping[str, float] | None = None,
    *,
    deg: bool = False,
    columns: Sequence[str] = ORDER,
    unit: str = METRE,
) -> Mechanism:
    """Return the chain of a Denavit-Hartenberg table.

    Parameters
    ----------
    rows
        One row a joint: `DHRow`, dicts with its fields, a table with named columns (a DataFrame, a
        dict of lists), or plain rows of numbers, a list of tuples or an array (n, 4). Lengths are
        in `unit`, angles radians; both may be expressions in parameters.
    convention
        "standard" (default) or "modified", see the notes.
    name
        Name of the mechanism.
    base
        Pose of DH frame 0 on the ground: a matrix (4, 4), a `Placement`, or a dict such as
        ``{"at": (0, 0, 0.3)}`` (default: the ground).
    tool
        Pose of the frame "tool" on the last body, likewise (default: the last DH frame).
    parameters
        Values of parameters by name.
    deg
        Whether angles are degrees: alpha, theta, and the offsets, limits and velocities of turning
        joints (default: False).
    columns
        Order of the numbers of plain rows, which differs from book to book (default: a, alpha, d,
        theta).
    unit
        Unit of the lengths, as of `Mechanism`: "m" (default), "cm", "mm" or "in".

    Returns
    -------
    Mechanism
        The chain. Bodies are "link1", ... and joints "q1", ... unless named; body i has DH frame i.

    Raises
    ------
    InputError
        If the table is empty, a number or word is wrong, or angles look like degrees without `deg`,
        see the notes.

    See Also
    --------
    from_screws : the chain of screw axes.

    Notes
    -----
    The pose of body i is A1 A2 ... Ai. "standard" is Ai = Rz(theta) Tz(d) Tx(a) Rx(alpha) (Denavit
    and Hartenberg, 1955); "modified" is Ai = Rx(alpha) Tx(a) Rz(theta) Tz(d) (Craig, 1986).

    Without `deg` an alpha beyond one turn is refused. A theta or an offset beyond one turn, which
    calibrated arms have, is refused where it is more than 10 turns, a whole or half number or
    within 0.5 of a multiple of 45, and where more angles of the table are beyond one turn than
    within (angles below 0.1 do not count; a single one is allowed).

    Examples
    --------
    >>> arm = from_dh([{"a": 0.5}, {"a": "l2"}], parameters={"l2": 0.4})
    >>> float(arm.build().fk([0.0, 0.0], "tool")[0, 3])
    0.9
    >>> from_dh([(0, 90, 0.4, 0), (0.5, 0, 0, 30)], deg=True)
    Mechanism('arm', dim=3, bodies=2, joints=2)
    """
    out = Mechanism(name, unit=unit)
    for key, number in (parameters or {}).items():
        out.parameter(key, number)
    add_dh_chain(out, rows, convention, base=base, tool=tool, deg=deg, columns=columns)
    return out


def add_dh_chain(
    mechanism: Mechanism,
    rows: Any,
    convention: str = "standard",
    on: BodyLike | None = None,
    base: object = None,
    tool: object = None,
    wheres: Iterable[Any] = (),
    deg: bool = False,
    columns: Sequence[str] = ORDER,
) -> None:
    """Add the chain of a Denavit-Hartenberg table to `mechanism`.

    The chain starts on the body `on` (the ground where None).

    Other arguments as in `from_dh`; `wheres` are the rows' places in a file. Errors: `InputError`,
    `DescriptionError`.
    """
    if convention not in CONVENTIONS:
        raise InputError(
            f"convention is {convention!r}; it must be {' or '.join(map(repr, CONVENTIONS))}"
        )
    before = _make_placement(base, "base")
    here = on if on is not None else mechanism.ground
    table, note = normalize_rows(rows, columns, tuple(f.name for f in fields(DHRow)))
    checked = [_make_row(DHRow, row, i) for i, row in enumerate(table, 1)]
    if not checked:
        raise InputError("the table has no rows; it must have one for each joint")
    winds = has_counted_turns(checked)
    places = list(wheres) or [None] * len(checked)
    for i, (row, where) in enumerate(zip(checked, places, strict=True), 1):
        if row.type not in JOINT_TYPES:
            raise InputError(f"row {i}: type is {row.type!r}; it must be {', '.join(JOINT_TYPES)}")
        row = convert_to_radians(row, i, deg, winds)
        a, alpha, d, theta, offset = (read_value(getattr(row, k), f"row {i}: {k}") for k in NUMBERS)
        if offset != 0.0:
            theta, d = (theta + offset, d) if row.type == "revolute" else (theta, d + offset)
        along_x = Placement((("rx", (alpha,)), ("x", (a,)))).drop_identity_steps()
        along_z = Placement((("rz", (theta,)), ("z", (d,)))).drop_identity_steps()
        if convention == "standard":
            X_PF = before @ along_z
            X_CM = along_x.invert_steps()
        else:
            X_PF = before @ along_x @ along_z
            X_CM = Placement()
        if row.flip:  # frames F and M both turned over: the motion of z is that of -z
            over = place(axis="-z")
            X_PF = X_PF @ over
            X_CM = X_CM @ over
        here = _add_link(mechanism, row, i, row.type, here, X_PF, X_CM, where, {})
        before = Placement()
    mechanism.frame("tool", here, at=_make_placement(tool, "tool"))
    mechanism.notes += [note] if note else []


@explain_errors
def from_screws(
    screws: Iterable[ScrewRow | Mapping[str, object] | ArrayLike],
    home: PlacedAt | None = None,
    name: str = "arm",
    parameters: Mapping[str, float] | None = None,
    *,
    unit: str = METRE,
) -> Mechanism:
    """Return the chain of screw axes (product of exponentials).

    Parameters
    ----------
    screws
        One screw a joint, in the ground frame at q = 0: `ScrewRow`, dicts with its fields, or
        twists [v; w] of six numbers, the linear part first. A screw is revolute, prismatic (w = 0)
        or, with a pitch, helical.
    home
        Pose of the frame "tool" at q = 0: a matrix (4, 4), a `Placement`, or a dict such as
        ``{"at": (0.9, 0, 0)}`` (default: the ground frame).
    name
        Name of the mechanism.
    parameters
        Values of parameters by name.
    unit
        Unit of the lengths, as of `Mechanism`: "m" (default), "cm", "mm" or "in".

    Returns
    -------
    Mechanism
        The chain. At q = 0 all body frames are the ground frame.

    Raises
    ------
    InputError
        If there are no screws, or a number is wrong.

    See Also
    --------
    from_dh : the chain of a Denavit-Hartenberg table.

    Notes
    -----
    Body i has the pose exp(S1 q1) ... exp(Si qi), and the tool that of the last body times `home`
    (Brockett, 1984; Lynch and Park, Modern Robotics, 2017, chapter 4; they write [w; v]).

    Examples
    --------
    >>> arm = from_screws([[0, 0, 0, 0, 0, 1], [0, -0.5, 0, 0, 0, 1]], home={"at": (0.9, 0, 0)})
    >>> arm.build().fk([0.0, 0.0], "tool")[:3, 3]
    array([0.9, 0. , 0. ])
    """
    out = Mechanism(name, unit=unit)
    for key, number in (parameters or {}).items():
        out.parameter(key, number)
    add_screw_chain(out, screws, home)
    return out


def add_screw_chain(
    mechanism: Mechanism,
    screws: Iterable[ScrewRow | Mapping[str, Any] | ArrayLike],
    home: object = None,
    wheres: Iterable[Any] = (),
) -> None:
    """Add a chain of screw axes to the ground of `mechanism`; arguments as in `from_screws`."""
    checked = [
        _make_row(ScrewRow, s if isinstance(s, (ScrewRow, Mapping)) else {"twist": s}, i)
        for i, s in enumerate(screws, 1)
    ]
    if not checked:
        raise InputError("the list of screws is empty; it must have one for each joint")
    places = list(wheres) or [None] * len(checked)
    here: BodyLike = mechanism.ground
    for i, (row, where) in enumerate(zip(checked, places, strict=True), 1):
        kind, X, options = _resolve_screw(row, i)
        here = _add_link(mechanism, row, i, kind, here, X, X, where, options)
    mechanism.frame("tool", here, at=_make_placement(home, "home"))


def _add_link(
    mechanism: Mechanism,
    row: DHRow | ScrewRow,
    number: int,
    kind: str,
    parent: BodyLike,
    X_PF: Placement,
    X_CM: Placement,
    where: Any,
    options: dict[str, Any],
) -> BodyLike:
    """Add the body and the joint of a row to the mechanism and return the body."""
    child = mechanism.body(row.body or f"link{number}", where=where)
    mechanism.joint(
        row.name or f"q{number}",
        kind,
        parent,
        child,
        at=X_PF,
        child_at=X_CM,
        limits=row.limits,
        velocity=row.velocity,
        effort=row.effort,
        actuated=row.actuated,
        where=where,
        **options,
    )
    return child


def _resolve_screw(row: ScrewRow, number: int) -> tuple[str, Placement, dict[str, Any]]:
    """Return the joint type of a screw, its frame on the ground at q = 0, and options."""
    label = f"screw {number}"
    if (row.twist is None) == (row.axis is None):
        raise InputError(f"{label} must have either twist or axis")
    if row.axis is not None:
        if (
            isinstance(row.pitch, bool)
            or not isinstance(row.pitch, (int, float))
            or math.isnan(row.pitch)
        ):
            raise InputError(
                f"{label}: pitch is {row.pitch!r}; it must be a number, infinite for a slide"
            )
        pitch = float(row.pitch)
        kind = "prismatic" if math.isinf(pitch) else "helical" if pitch else "revolute"
        axis = read_values(read_direction(row.axis), 3, f"{label}: axis")
        X = place(read_values(row.point, 3, f"{label}: point"), axis=axis)
        return kind, X, {"pitch": pitch} if kind == "helical" else {}
    twist = read_values(row.twist, 6, f"{label}: twist")  # type: ignore[arg-type]
    if not all(isinstance(x, float) for x in twist):
        raise InputError(
            f"{label}: a twist must be plain numbers; with parameters use axis and point"
        )
    v = np.array(twist[:3], dtype=float)
    w = np.array(twist[3:], dtype=float)
    unit, what = (w, "w") if w.any() else (v, "v")
    length = float(np.linalg.norm(unit))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        said = "its rotation part w" if what == "w" else "it has no rotation, and its linear part v"
        raise InputError(
            f"{label}: {said} has length {length:g}; it must be 1 (the order is [v; w], linear "
            "first)"
        )
    if what == "v":
        return "prismatic", place(axis=v), {}
    # the axis passes through w x v and the pitch is w . v, for |w| = 1 (Murray, Li, Sastry, 1994,
    # 2.3)
    v = v / length
    w = w / length
    pitch = float(w @ v)
    X = place(np.cross(w, v).tolist(), axis=w.tolist())
    if abs(pitch) <= PITCH_TOLERANCE * max(1.0, float(np.linalg.norm(v))):
        return "revolute", X, {}
    return "helical", X, {"pitch": pitch}


def _make_row(kind: Any, row: Any, number: int) -> Any:
    """Return a row of class `kind` from a dict.

    Errors: `InputError` for unknown entries.
    """
    if isinstance(row, kind):
        return row
    known = [f.name for f in fields(kind)]
    plain = "plain numbers or " if kind is DHRow else ""
    if not is_mapping(row):
        raise InputError(
            f"row {number} is {row!r}; it must be {plain}a dict with some of {', '.join(known)}"
        )
    for key in row:
        if key not in known:
            raise InputError(f"row {number} has an unknown entry {key!r}{hint(key, known)}")
    return kind(**row)


def _make_placement(X: object, what: str) -> Placement:
    """Return the placement of a matrix, a `Placement`, or a dict of keywords of `place`."""
    if X is None:
        return Placement()
    if isinstance(X, Placement):
        return X
    if is_mapping(X):
        known = ("at", "rpy", "angle", "axis", "quat_wxyz", "matrix", "steps")
        for key in X:
            if key not in known:
                raise InputError(f"{what} has an unknown entry {key!r}{hint(key, known)}")
        return read_placement_steps(X["steps"]) if "steps" in X else place(**X)
    return make_placement_from_pose(X)
