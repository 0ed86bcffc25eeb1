"""Constraints as parts of a mechanism: their ends found, their numbers checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import constraints
from kempe.constraints.base import (
    Constraint,
    End,
    Op,
    Row,
    expressions_in,
    frames_of,
    held,
    numbers_in,
    with_numbers,
)
from kempe.constraints.tape import POSE, TWIST
from kempe.description import checks
from kempe.description.parts import Body, Declared, Frame
from kempe.errors import DescriptionError, InputError, UnknownNameError, Where, shown
from kempe.placement import AXES, Placement
from kempe.reals import is_sequence
from kempe.values import Expression, value

if TYPE_CHECKING:
    from kempe.description.mechanism import Mechanism

BETWEEN = {"distance": "distance", "point_on_line": "on_line", "point_on_plane": "on_plane"}
"""Kinds that are placed on bodies, by their names as methods of `Mechanism` and in files of format
1."""

Placed = tuple[Any, object, Mapping[str, object]]
"""A body or frame, a place on it, and how it is turned there."""


def declare(mechanism: Mechanism, given: object, name: str, where: Where | None = None) -> Declared:
    """Add a constraint to a mechanism; see `Mechanism.constrain`."""
    if not isinstance(given, Constraint):
        raise InputError(f"{shown(given)} is no constraint; see kempe.constraints")
    if isinstance(name, str):
        name = name or given.name or given.label
    subject = f"constraint {name!r}"
    mechanism._free_joint_name(checks.name(name, "constraint"), subject, where)
    names = ("weight", "priority", "tolerance")
    demands = [
        f
        for f in names
        if getattr(given, f) not in (getattr(Constraint, f), getattr(type(given), f))
    ]
    if demands:
        checks.refuse(
            subject,
            f"{demands[0]} is what ik reads of a wish",
            where,
            "a mechanism always holds it: leave it out",
        )
    made = _with_values(mechanism, given, subject, where).knowing(mechanism.parameters)
    made = replace(made, name="") if made.name else made
    if made.ends[1] is None:
        record = Declared(name, made, "", "", where=where)
    else:
        ends = [_end(mechanism, e, subject, where) for e in made.ends]
        record = Declared(name, made, ends[0].body, ends[1].body, ends[0].X, ends[1].X, where)
    check(mechanism, record)
    mechanism.constraints[name] = record
    return record


def between(
    mechanism: Mechanism,
    name: str,
    kind: str,
    parent: Placed,
    child: Placed,
    length: object,
    where: Where | None,
) -> Declared:
    """Add a constraint of `BETWEEN` with its ends placed on bodies; see `Mechanism.point_on_line`."""
    subject = f"constraint {name!r}"
    mechanism._free_joint_name(checks.name(name, "constraint"), subject, where)
    if kind not in BETWEEN:
        checks.refuse(subject, str(UnknownNameError("kind of constraint", kind, BETWEEN)), where)
    A, B = (_placed(mechanism, p, subject, where) for p in (parent, child))
    rod = BETWEEN[kind] == "distance"
    if A.body == B.body:
        checks.refuse(
            subject, f"it ties body {A.body!r} to itself", where, "it must tie two bodies"
        )
    if mechanism.dim == 2 and BETWEEN[kind] == "on_plane":
        checks.refuse(
            subject,
            f"{kind} does not exist in the plane",
            where,
            "planar systems take distance and point_on_line",
        )
    if rod and length is None:
        checks.refuse(subject, "it has no length", where, "give the length of the rod in metres")
    if not rod and length is not None:
        checks.refuse(subject, f"{kind} takes no length", where, "only a distance must have one")
    if rod:
        try:
            length = _checked(mechanism, value(length, "length"), "length", subject, where)
        except InputError as error:
            if isinstance(error, DescriptionError):
                raise
            checks.refuse(subject, str(error), where)
        return declare(mechanism, constraints.Distance(B, A, length), name, where)
    direction: Any = (0.0, 0.0, 1.0)
    if mechanism.dim == 2 and kind == "point_on_line":
        checks.axis_in_plane(subject, A.X, "its line is z of the frame, out of the plane", where)
        A, direction = End(A.body, Placement(A.X.steps[:-1])), A.X.steps[-1][1]
    made: Any = constraints.KINDS[BETWEEN[kind]]
    turned = {"direction": direction} if BETWEEN[kind] == "on_line" else {}
    return declare(mechanism, made(B, other=A, **turned), name, where)


def _placed(mechanism: Mechanism, placed: Placed, subject: str, where: Where | None) -> End:
    """An end of a constraint as a placement on a body; a frame stands for its placement."""
    thing, at, turn = placed
    frame = mechanism.frames.get(str(thing)) if isinstance(thing, (Frame, str)) else None
    if frame is None:
        on = mechanism._body(thing, subject, where)  # type: ignore[arg-type]
        return End(on.name, mechanism._place(at, turn, subject, where, on))
    if isinstance(at, (Frame, str)):
        checks.refuse(
            subject,
            f"its point is given twice, by frames {frame.name!r} and {str(at)!r}",
            where,
            "name the frame once",
        )
    on = mechanism.bodies[frame.body]
    return End(on.name, frame.X_BF @ mechanism._place(at, turn, subject, where, on))


def _end(mechanism: Mechanism, end: object, subject: str, where: Where | None) -> End:
    """An end of a constraint as a placement on a body: None is the ground, text is a frame or a
    body.
    """
    if end is None:
        return End(mechanism.ground.name)
    if isinstance(end, End):
        mechanism._body(end.body, subject, where)
        return end
    name = end.name if isinstance(end, (Body, Frame)) else end
    frame = mechanism.frames.get(name) if isinstance(name, str) else None
    if frame is not None:
        return End(frame.body, frame.X_BF)
    if isinstance(name, str) and name in mechanism.bodies:
        return End(name)
    known = [*mechanism.frames, *mechanism.bodies]
    checks.refuse(
        subject, str(UnknownNameError("frame or body", name, known, mechanism.name)), where
    )


def _with_values(
    mechanism: Mechanism, given: Constraint, subject: str, where: Where | None
) -> Constraint:
    """The constraint with text in its fields of numbers as expressions in known parameters."""
    changed: dict[str, Any] = {}
    for key, x in numbers_in(given).items():
        if isinstance(x, str) and x in AXES:
            continue
        read = _checked(mechanism, x, key, subject, where)
        if read is not x:
            changed[key] = read
    return replace(given, **changed) if changed else given


def _checked(mechanism: Mechanism, x: Any, what: str, subject: str, where: Where | None) -> Any:
    """Numbers, or expressions in known parameters that are finite with their values."""
    try:
        read = _read(x, what)
        for e in expressions_in(read):
            for name in e.names:
                if name not in mechanism.parameters:
                    raise UnknownNameError("parameter", name, mechanism.parameters)
            number = e.evaluate(mechanism.parameters)
            if not math.isfinite(number):
                raise InputError(f"{what} is {float(number)} ({what} = {e}); it must be finite")
    except (InputError, UnknownNameError) as error:
        text = str(error) if isinstance(error, InputError) else f"{what} is {x!s}: {error}"
        checks.refuse(subject, text, where)
    return read


def _read(x: Any, what: str) -> Any:
    """Numbers, lists of numbers or expressions as values."""
    given: Any = x
    if isinstance(x, (np.ndarray, np.generic)):
        given = given.tolist()
    if is_sequence(given):
        items = tuple(_read(item, what) for item in given)
        return given if all(a is b for a, b in zip(items, given, strict=True)) else items
    return value(given, what) if isinstance(given, (str, Expression)) else given


def check(mechanism: Mechanism, made: Declared) -> None:
    """Refuse ends, frames and numbers that the constraint cannot have."""
    subject = f"constraint {made.name!r}"
    where = made.where
    dim = mechanism.dim
    if made.parent and made.parent == made.child:
        checks.refuse(
            subject, f"it ties body {made.parent!r} to itself", where, "it must tie two bodies"
        )
    numbers = resolved(made, mechanism.parameters, dim)
    rows = numbers.rows(dim)
    tool = numbers.tool(dim)
    if not made.parent:
        if not made.of.reads:
            checks.refuse(
                subject,
                f"{made.of.label} is requested in one call of ik, not held always",
                where,
                "hold coordinates by lock, couple or equation, frames by kinds that name them",
            )
        return
    a, b = (mechanism.bodies[n] for n in (made.parent, made.child))
    if a.particle and any(r.op is not Op.DISTANCE for r in rows):
        checks.refuse(
            subject,
            f"its parent {a.name!r} is a particle, which has no axes",
            where,
            "make the particle the child",
        )
    if b.particle and (any(map(reads_axes, rows)) or any(tool[k] for k in (3, 7, 11))):
        checks.refuse(
            subject, f"{b.name!r} is a particle, which has no axes and no extent", where, ""
        )
    for on, X in ((a, made.X_PF), (b, made.X_CM)):
        if on.particle and X.steps:
            checks.refuse(
                subject,
                f"a particle ({on.name!r}) has no extent: the point must sit on it",
                where,
                "leave out its at and its axis",
            )
        if dim == 2:
            checks.flat(subject, X, where)


def resolved(made: Declared, parameters: Mapping[str, float], dim: int) -> Constraint:
    """The constraint with its expressions evaluated at the parameters, checked. Errors:
    `DescriptionError`.
    """
    numbers = with_numbers(made.of, parameters)
    try:
        rows = numbers.rows(dim)
        for key, x in numbers_in(numbers).items():
            if x is not None and _not_a_number(x):
                raise InputError(f"{key} is {shown(x)}; it must be numbers")
        _lengths(made, numbers, rows)
        numbers.check(dim)
        numbers.goal(dim)
        numbers.tool(dim)
    except InputError as error:
        if isinstance(error, DescriptionError):
            raise
        checks.refuse(f"constraint {made.name!r}", str(error), made.where)
    return numbers


def _not_a_number(x: Any) -> bool:
    """Whether NaN is among numbers, or a whole number that no float holds."""
    try:
        return bool(np.isnan(np.asarray(x, dtype=float)).any())
    except OverflowError:
        return True
    except (TypeError, ValueError):
        return False


def reads_axes(row: Row) -> bool:
    """Whether a row reads how frame B is turned."""
    if row.op in (Op.TAPE, Op.VELOCITY):
        tape, output = row.args
        return tape.degrees_in((*POSE[3:], *TWIST[3:]))[output] > 0
    return row.op not in (Op.DISTANCE, Op.POINT)


def _lengths(made: Declared, numbers: Constraint, rows: tuple[Row, ...]) -> None:
    """Refuse lengths that no rod has: points that coincide are a joint."""
    for row in rows:
        name = held(numbers, row) if row.op is Op.DISTANCE else ""
        length = getattr(numbers, name) if name else 1.0
        if not 0.0 < float(length) < math.inf:  # not a number fails, too
            given = getattr(made.of, name)
            text = f" (length = {given})" if isinstance(given, Expression) else ""
            allowed = "it must be above zero" + (
                "; points that coincide are a joint" if float(length) == 0.0 else ""
            )
            checks.refuse(
                f"constraint {made.name!r}",
                f"its length is {float(length):g}{text}",
                made.where,
                allowed,
            )


def renamed(
    made: Declared, bodies: Mapping[str, str], frames: Mapping[str, str], prefix: str
) -> Declared:
    """The same constraint with other names of bodies and frames, and a prefix for its own name and
    coordinates.
    """
    both = {**bodies, **frames}

    def other(x: Any) -> Any:
        return replace(x, body=bodies[x.body]) if isinstance(x, End) else both.get(x, x)

    of = replace(made.of, **{k: other(x) for k, x in frames_of(made.of).items()})
    own = {"name": prefix + made.name, "of": of.prefixed(prefix)}
    return replace(
        made, **own, parent=bodies.get(made.parent, ""), child=bodies.get(made.child, "")
    )
