"""Chains from Denavit-Hartenberg tables and from screw axes (product of exponentials)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.calls import explained
from kempe.description.dh import dh_table
from kempe.description.mechanism import BodyLike, Mechanism
from kempe.errors import InputError, hint
from kempe.placement import Placement, direction, place, placement_of_pose, steps_from_data
from kempe.reals import is_mapping
from kempe.values import Value, value, values

CONVENTIONS = ("standard", "modified")
NUMBERS = ("a", "alpha", "d", "theta", "offset")
JOINT_TYPES = ("revolute", "prismatic", "fixed")

UNIT_TOLERANCE = 1e-3
"""A screw whose axis is this close to unit length is normalised: published tables are rounded."""

PITCH_TOLERANCE = 1e-12
"""A pitch below this many metres a radian, relative to the size of the screw, is rounding."""


@dataclass(frozen=True)
class DHRow:
    """One row of a Denavit-Hartenberg table: lengths `a` and `d` [m], angles `alpha` and `theta`
    [rad].

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


@dataclass(frozen=True)
class ScrewRow:
    """One screw axis in the ground frame at q = 0: either `twist` or `axis` (with `point` and
    `pitch`).

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


@explained
def from_dh(
    rows: Any,
    convention: str = "standard",
    name: str = "arm",
    base: object = None,
    tool: object = None,
    parameters: Mapping[str, float] | None = None,
    *,
    deg: bool = False,
    columns: Sequence[str] = dh_table.ORDER,
) -> Mechanism:
    """Chain of a Denavit-Hartenberg table; the pose of body i is A1 A2 ... Ai, its frame is DH
    frame i.

    With `convention` "standard", Ai = Rz(theta) Tz(d) Tx(a) Rx(alpha) (Denavit and Hartenberg,
    1955); with "modified", Ai = Rx(alpha) Tx(a) Rz(theta) Tz(d) (Craig, 1986). `rows` are `DHRow`,
    dicts with their fields, a table with named columns (a DataFrame, a dict of lists), or plain
    rows of numbers: a list of tuples, an array (n, 4). Of these `columns` names the order, which
    differs from book to book. With `deg` angles are
    degrees: alpha, theta, and offsets, limits and velocities of turning joints. Bodies are 'link1',
    ... and joints 'q1', ... unless named. `base` is the pose of DH frame 0 on the
    ground, `tool` that of the frame 'tool' on the last body: pose matrices (4, 4), `Placement` or
    dicts of the keywords of `place`. Errors: `InputError`, also where an angle is not one in the
    unit said: 90 without `deg`. Without `deg` an alpha beyond one turn is refused; a theta or an
    offset beyond one turn, which calibrated arms have, is refused where it is more than 10 turns, a
    whole or half number or within 0.5 of a multiple of 45, and where more angles of the table are
    beyond one turn than within (below 0.1 they do not count; a single one is allowed).

    >>> arm = from_dh([{"a": 0.5}, {"a": "l2"}], parameters={"l2": 0.4})
    >>> float(arm.joints["q2"].X_CM.evaluate(arm.parameters)[0, 3])
    -0.4
    >>> from_dh([(0, 90, 0.4, 0), (0.5, 0, 0, 30)], deg=True)
    Mechanism('arm', dim=3, bodies=2, joints=2)
    """
    out = Mechanism(name)
    for key, number in (parameters or {}).items():
        out.parameter(key, number)
    add_dh(out, rows, convention, base=base, tool=tool, deg=deg, columns=columns)
    return out


def add_dh(
    mechanism: Mechanism,
    rows: Any,
    convention: str = "standard",
    on: BodyLike | None = None,
    base: object = None,
    tool: object = None,
    wheres: Iterable[Any] = (),
    deg: bool = False,
    columns: Sequence[str] = dh_table.ORDER,
) -> None:
    """Add the chain of a Denavit-Hartenberg table to `mechanism`, on the body `on` (the ground
    where None).

    Other arguments as in `from_dh`; `wheres` are the rows' places in a file. Errors: `InputError`,
    `DescriptionError`.
    """
    if convention not in CONVENTIONS:
        raise InputError(
            f"convention is {convention!r}; it must be {' or '.join(map(repr, CONVENTIONS))}"
        )
    before = _placement(base, "base")
    here = on if on is not None else mechanism.ground
    table, note = dh_table.rows_of(rows, columns, tuple(f.name for f in fields(DHRow)))
    checked = [_row(DHRow, row, i) for i, row in enumerate(table, 1)]
    if not checked:
        raise InputError("the table has no rows; it must have one for each joint")
    winds = dh_table.counts_turns(checked)
    places = list(wheres) or [None] * len(checked)
    for i, (row, where) in enumerate(zip(checked, places, strict=True), 1):
        if row.type not in JOINT_TYPES:
            raise InputError(f"row {i}: type is {row.type!r}; it must be {', '.join(JOINT_TYPES)}")
        row = dh_table.in_radians(row, i, deg, winds)
        a, alpha, d, theta, offset = (value(getattr(row, k), f"row {i}: {k}") for k in NUMBERS)
        if offset != 0.0:
            theta, d = (theta + offset, d) if row.type == "revolute" else (theta, d + offset)
        along_x = Placement((("rx", (alpha,)), ("x", (a,)))).simplified()
        along_z = Placement((("rz", (theta,)), ("z", (d,)))).simplified()
        if convention == "standard":
            X_PF = before @ along_z
            X_CM = along_x.inverse()
        else:
            X_PF = before @ along_x @ along_z
            X_CM = Placement()
        if row.flip:  # frames F and M both turned over: the motion of z is that of -z
            over = place(axis="-z")
            X_PF = X_PF @ over
            X_CM = X_CM @ over
        here = _add(mechanism, row, i, row.type, here, X_PF, X_CM, where, {})
        before = Placement()
    mechanism.frame("tool", here, at=_placement(tool, "tool"))
    mechanism.notes += [note] if note else []


@explained
def from_screws(
    screws: Iterable[ScrewRow | Mapping[str, Any] | ArrayLike],
    home: object = None,
    name: str = "arm",
    parameters: Mapping[str, float] | None = None,
) -> Mechanism:
    """Chain of screw axes: body i has the pose exp(S1 q1) ... exp(Si qi), the frame 'tool' that
    times `home`.

    `screws` are `ScrewRow`, dicts with their fields, or plain twists [v; w], the linear part first,
    in the ground frame at q = 0. A screw is revolute, prismatic (w = 0) or, with a pitch, helical.
    `home` is the pose of the tool at q = 0: a matrix (4, 4), a `Placement` or a dict of the
    keywords of `place`. All body frames coincide with the ground's at q = 0. Source: Brockett,
    1984; Lynch and Park, 2017, chapter 4.

    >>> sorted(from_screws([[0, 0, 0, 0, 0, 1], [0, -0.5, 0, 0, 0, 1]], home={"at": (0.9, 0, 0)}).joints)
    ['q1', 'q2']
    """
    out = Mechanism(name)
    for key, number in (parameters or {}).items():
        out.parameter(key, number)
    add_screws(out, screws, home)
    return out


def add_screws(
    mechanism: Mechanism,
    screws: Iterable[ScrewRow | Mapping[str, Any] | ArrayLike],
    home: object = None,
    wheres: Iterable[Any] = (),
) -> None:
    """Add a chain of screw axes to `mechanism`, on its ground; arguments as in `from_screws`."""
    checked = [
        _row(ScrewRow, s if isinstance(s, (ScrewRow, Mapping)) else {"twist": s}, i)
        for i, s in enumerate(screws, 1)
    ]
    if not checked:
        raise InputError("the list of screws is empty; it must have one for each joint")
    places = list(wheres) or [None] * len(checked)
    here: BodyLike = mechanism.ground
    for i, (row, where) in enumerate(zip(checked, places, strict=True), 1):
        kind, X, options = _screw(row, i)
        here = _add(mechanism, row, i, kind, here, X, X, where, options)
    mechanism.frame("tool", here, at=_placement(home, "home"))


def _add(
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


def _screw(row: ScrewRow, number: int) -> tuple[str, Placement, dict[str, Any]]:
    """Joint type, placement of its frames in the ground frame at q = 0, and options."""
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
        axis = values(direction(row.axis), 3, f"{label}: axis")
        X = place(values(row.point, 3, f"{label}: point"), axis=axis)
        return kind, X, {"pitch": pitch} if kind == "helical" else {}
    twist = values(row.twist, 6, f"{label}: twist")  # type: ignore[arg-type]
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


def _row(kind: Any, row: Any, number: int) -> Any:
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


def _placement(X: object, what: str) -> Placement:
    """Placement of a matrix, a `Placement`, or a dict of keywords of `place` (or of steps)."""
    if X is None:
        return Placement()
    if isinstance(X, Placement):
        return X
    if is_mapping(X):
        known = ("at", "rpy", "angle", "axis", "quat_wxyz", "matrix", "steps")
        for key in X:
            if key not in known:
                raise InputError(f"{what} has an unknown entry {key!r}{hint(key, known)}")
        return steps_from_data(X["steps"]) if "steps" in X else place(**X)
    return placement_of_pose(X)
