"""Checks of the arguments of builder calls.

Each function returns the checked value or raises an error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any, NoReturn

import numpy as np

from kempe import spatial
from kempe.arrays import is_mapping, is_real, is_sequence, warn_of_degrees
from kempe.description.parts import Body, Joint, Limits
from kempe.errors import (
    DescriptionError,
    Fault,
    InputError,
    UnknownNameError,
    Where,
    format_value,
    hint,
)
from kempe.joints import JointType, P, Q, R, make_joint_type
from kempe.poses import Placement
from kempe.values import Expression, read_value, read_values
from kempe.words import choose_verb, format_count

SAME_DIRECTION = 1e-12
"""How far two unit vectors may be apart and still be one direction."""


def raise_problem(subject: str, message: str, where: Where | None, allowed: str = "") -> NoReturn:
    """Raise a `DescriptionError` with one problem."""
    raise DescriptionError(Fault(message, subject, where, allowed))


def check_name(given: object, kind: str) -> str:
    """Return the name of a body, joint or frame, a text that is not empty.

    Errors: `InputError`.
    """
    if not isinstance(given, str) or not given.strip():
        raise InputError(f"{kind} name is {given!r}; it must be text, not empty")
    return given


def check_number(x: object, what: str) -> float:
    """Return a finite number.

    Errors: `InputError`.
    """
    checked = read_value(x, what)
    if isinstance(checked, Expression):
        raise InputError(f"{what} is {format_value(x)}; it must be a number")
    return checked


def check_numbers(given: object, what: str) -> dict[str, float]:
    """Return finite numbers by coordinate name.

    Errors: `InputError`.
    """
    if not is_mapping(given):
        raise InputError(f"{what} is {given!r}; it must be a dict of numbers by coordinate name")
    return {str(k): check_number(v, f"{what}: {k!r}") for k, v in given.items()}


def make_body(
    given: str,
    particle: bool,
    mass: object,
    center: Any,
    where: Where | None,
) -> Body:
    """Return a `Body` with checked name, mass [kg] and centre of mass [m] (2 or 3 lengths)."""
    subject = f"body {check_name(given, 'body')!r}"
    if mass is not None:
        mass = check_number(mass, f"{subject}: mass")
        if mass < 0:
            raise_problem(subject, f"mass is {mass:g}", where, "it must not be negative")
    coordinates: Any = center
    if center is not None:
        if isinstance(center, str) or not isinstance(center, Iterable):
            raise_problem(subject, f"center is {center!r}", where, "it must have 2 or 3 numbers")
        lengths = [check_number(c, f"{subject}: center") for c in coordinates]
        if len(lengths) not in (2, 3):
            raise_problem(
                subject,
                f"center has {format_count(len(lengths), 'number')}",
                where,
                "it must have 2 or 3",
            )
        center = (*lengths, 0.0)[:3]
    return Body(given, particle, mass, center, where=where)  # type: ignore[arg-type]


def check_color(given: object) -> tuple[float, float, float, float] | None:
    """Return red, green, blue and opacity (default 1), each from 0 to 1.

    Errors: `InputError`.
    """
    if given is None:
        return None
    found = read_values(given, (3, 4), "color")
    if any(isinstance(x, Expression) or not 0.0 <= x <= 1.0 for x in found):
        raise InputError(
            f"color is {format_value(given)}; it must be red, green, blue and opacity from 0 to 1"
        )
    return (*found, 1.0)[:4]  # type: ignore[return-value]


def check_joint_type(
    dim: int, subject: str, type_: JointType, parent: Body, child: Body, where: Where | None
) -> None:
    """Raise `DescriptionError` if a joint type cannot be used in the plane or between these bodies."""
    if dim == 2 and not type_.planar:
        raise_problem(
            subject,
            f"a {type_.type_name} joint does not exist in the plane",
            where,
            "planar systems take revolute, prismatic, planar, translation, fixed and free",
        )
    if parent.particle:
        raise_problem(
            subject,
            f"its parent {parent.name!r} is a particle, which has no orientation",
            where,
            "make the particle the child",
        )
    fault = find_type_fault(type_, dim, child.particle)
    if fault:
        raise_problem(
            subject, f"joint type {type_.type_name!r} is not declared well: {fault}", where
        )
    primitives = type_.layout(dim, child.particle)[1]
    if child.particle and any(p.kind != P for p in primitives):
        raise_problem(
            subject,
            f"a {type_.type_name} joint turns, but {child.name!r} is a particle",
            where,
            "particles take prismatic, planar, translation, fixed, free, and products of slides",
        )
    if dim == 2:
        flat = all(
            p.kind == R and p.axis == "z" or p.kind == P and p.axis != "z" for p in primitives
        )
        if not flat and any(p.kind != P or p.axis != "z" for p in primitives):
            raise_problem(
                subject,
                f"a {type_.type_name} joint leaves the plane",
                where,
                "in the plane a joint turns about z and slides along x and y, or slides along z "
                "only",
            )


def explain_unknown_option(
    kind: str | JointType, options: Iterable[str], builder: Callable[..., Joint]
) -> str:
    """Return the message about an option that the joint type does not have; '' where it has all.

    It names the keyword that is meant, or all keywords that joints take.
    """
    import inspect  # only here: most calls are right

    inner = {"self", "options", "where", "name", "kind", "parent", "child"}
    keywords = [k for k in inspect.signature(builder).parameters if k not in inner]
    try:
        own = make_joint_type(kind).list_defaults()
        is_type = True
    except (InputError, UnknownNameError):  # the type itself is wrong, too
        own = {}
        is_type = False
    for key in (key for key in options if key not in own):
        if key in FOREIGN_KEYWORDS:
            return f"joints have no keyword {key!r}: {FOREIGN_KEYWORDS[key]}"
        near = hint(key, [*keywords, *own])
        if "did you mean" in near:
            return f"joints have no keyword {key!r}{near}"
        if is_type:
            return f"joints have no keyword {key!r}; they take {', '.join([*keywords, *own])}"
    return ""


FOREIGN_KEYWORDS = {
    **dict.fromkeys(
        ("origin", "xyz", "position", "pos", "offset", "translation"),
        "give the joint's place as at=(x, y, z)",
    ),
    **dict.fromkeys(
        ("lower", "upper", "limit", "range", "min", "max"), "give limits=(lower, upper)"
    ),
    "length": "a link's length is where its next joint sits: give at=(length, 0, 0) there",
    **dict.fromkeys(
        ("rotation", "R", "orientation"), "give rpy=(roll, pitch, yaw), quat_wxyz= or matrix="
    ),
    "theta": "give angle= in the plane, rpy= in space",
    "direction": "give axis=(x, y, z)",
}
"""Keywords of other libraries and files, and what a joint takes in their place."""


@lru_cache(maxsize=256)
def find_type_fault(type_: JointType, dim: int, particle: bool) -> str:
    """Return the fault in a joint type's coordinates and primitives as text; '' for none."""
    names, primitives = type_.layout(dim, particle)
    if len(set(names)) < len(names) or (len(names) > 1 and "" in names):
        return f"its coordinates are {names}; each needs a name of its own"
    owners: list[set[int]] = [set() for _ in names]
    for k, (what, axis, first, multiplier) in enumerate(primitives):
        size = 4 if what == Q else 1
        if what not in (R, P, Q) or axis not in ("x", "y", "z"):
            return f"{primitives[k]} is not R, P or Q about or along x, y or z"
        if not 0 <= first <= len(names) - size:
            there = (
                f"there {choose_verb(len(names), 'is', 'are')} "
                f"{format_count(len(names), 'coordinate')}"
            )
            return f"{primitives[k]} is of coordinate {first}, but {there}"
        if not math.isfinite(multiplier) or (what == Q and multiplier != 1.0):
            return f"{primitives[k]} has the multiplier {multiplier:g}"
        for i in range(first, first + size):
            owners[i] |= {-1 - k} if what == Q else {i} if multiplier else set()
    idle = [name for name, own in zip(names, owners, strict=True) if not own]
    if idle:
        return f"no primitive has its coordinate {idle[0]!r}"
    if any(len(own) > 1 for own in owners) or sum(p.kind == Q for p in primitives) > 1:
        return "a quaternion shares no coordinate, and there is at most one"
    given = type_.list_velocity_names(dim, particle)
    return (
        ""
        if len(set(given)) == len(given)
        else f"its velocities are {given}; each needs a name of its own"
    )


def check_joint_frames(
    dim: int,
    subject: str,
    type_: JointType,
    X_PF: Placement,
    X_CM: Placement,
    child: Body,
    where: Where | None,
) -> None:
    """Refuse joint frames that leave the plane, or that lie away from the origin of a particle.

    X_PF and X_CM are the placements of the frames F on the parent and M on the child. `subject`
    names the joint and `where` its place in a file, for the message; `dim` is 2 in the plane, else
    3. Errors: `DescriptionError`.
    """
    if child.particle and any(motion in ("x", "y", "z") for motion, _ in X_CM.steps):
        raise_problem(
            subject,
            f"a particle ({child.name!r}) has no extent: the joint must sit on it",
            where,
            "leave out child_at",
        )
    if dim == 3:
        return
    if not any(p.kind == P and p.axis == "z" for p in type_.layout(dim, child.particle)[1]):
        check_planar_placement(subject, X_PF, where)
        check_planar_placement(subject, X_CM, where)
        return
    out_of_plane = f"a {type_.type_name} joint slides along z, out of the plane"
    directions = [find_planar_axis(subject, X, out_of_plane, where) for X in (X_PF, X_CM)]
    if np.abs(directions[1] - directions[0]).max() > SAME_DIRECTION:
        raise_problem(
            subject,
            "its axis differs on the two bodies",
            where,
            "turn the child by child_angle instead",
        )


def find_planar_axis(
    subject: str, X: Placement, out_of_plane: str, where: Where | None
) -> spatial.Array:
    """Return the joint axis (3,) of a placement in the plane that ends by aligning z with it."""
    if not X.steps or X.steps[-1][0] != "align":
        raise_problem(subject, out_of_plane, where, "give its axis=(x, y)")
    check_planar_placement(subject, Placement(X.steps[:-1]), where)
    axis = spatial.unit([float(x) for x in X.steps[-1][1]])  # type: ignore[arg-type]
    if axis[2] != 0.0:
        raise_problem(
            subject,
            f"its axis has z = {axis[2]:g}, out of the plane",
            where,
            "give its axis=(x, y)",
        )
    return axis


MOTIONS = {
    "align": "the axis",
    "unalign": "the axis of the child",
    "rx": "a turn about x",
    "ry": "a turn about y",
    "quat_wxyz": "the quaternion",
    "matrix": "the rotation matrix",
}
"""Elementary motions of a placement, as words of a message."""


def check_planar_placement(subject: str, X: Placement, where: Where | None) -> None:
    """Raise `DescriptionError` if a placement of a planar system leaves the xy-plane."""
    for motion, _ in X.steps:
        if motion not in ("x", "y", "rz"):
            raise_problem(
                subject,
                f"{MOTIONS.get(motion, motion)} leaves the plane",
                where,
                "planar systems take x, y and turns about z",
            )


def name_place(subject: str, what: str, where: Where | None) -> str:
    """Return the name of a number for a warning: "arm.toml:7: joint 'q': a limit"."""
    return f"{f'{where}: ' if where else ''}{subject}: {what}"


def check_limits(
    subject: str, given: object, type_: JointType, dim: int, particle: bool, where: Where | None
) -> dict[str, Limits]:
    """Return the limits (lower, upper) of a joint by coordinate.

    `given` is a pair, with None where there is no limit, or a dict of such pairs by coordinate.

    None is no limit on that side. A quaternion has no limits by coordinate.
    """
    coordinates = type_.list_coordinate_names(dim, particle)
    names = tuple(v for v in type_.list_velocity_names(dim, particle) if v in coordinates)
    turning = type_.list_turning_names(dim, particle)
    out: dict[str, Limits] = {}
    for key, pair in _list_coordinate_values(subject, "limits", given, names, where):
        plain = pair.__class__ is np.ndarray and pair.ndim == 1 and pair.dtype != object
        numbers: tuple[Any, ...] = tuple(pair) if plain or is_sequence(pair) else ()
        if len(numbers) == 2:
            numbers = tuple(
                end if x is None else x
                for x, end in zip(numbers, (-math.inf, math.inf), strict=True)
            )
        if len(numbers) != 2 or not all(is_real(x) for x in numbers):
            allowed = "they must be a pair (lower, upper), None where there is none"
            raise_problem(subject, f"limits are {format_value(pair)}", where, allowed)
        lower = float(numbers[0])
        upper = float(numbers[1])
        if math.isnan(lower) or math.isnan(upper) or lower == math.inf or upper == -math.inf:
            raise_problem(subject, f"limits are ({lower}, {upper})", where, "they must be numbers")
        if lower > upper:
            said = f"lower limit {lower:g} is above upper limit {upper:g}"
            raise_problem(subject, said, where, "lower must not be above upper")
        if key in turning:
            place = name_place(subject, "a limit", where)
            warn_of_degrees((lower, upper), place, where is not None)
        out[key] = (lower, upper)
    return out


def check_bounds(
    subject: str, what: str, given: object, names: tuple[str, ...], where: Where | None
) -> dict[str, float]:
    """Return the largest speeds or efforts by velocity coordinate: numbers >= 0, also infinite."""
    out: dict[str, float] = {}
    for key, bound in _list_coordinate_values(subject, what, given, names, where):
        if not is_real(bound) or not float(bound) >= 0:  # type: ignore[arg-type]
            raise_problem(
                subject, f"{what} limit is {bound!r}", where, "it must be a number, not negative"
            )
        out[key] = float(bound)  # type: ignore[arg-type]
    return out


def _list_coordinate_values(
    subject: str, what: str, given: object, names: tuple[str, ...], where: Where | None
) -> list[tuple[str, Any]]:
    """Return pairs of a coordinate and its value; a single value belongs to the coordinate ''."""
    if given is None:
        return []
    if not is_mapping(given):
        if names != ("",):
            raise_problem(
                subject,
                f"{what} given as {given!r}",
                where,
                f"this joint needs them by coordinate: {', '.join(names) or 'it has none'}",
            )
        return [("", given)]
    for key in given:
        if key not in names:
            raise_problem(subject, str(UnknownNameError("coordinate", key, names, "it")), where)
    return list(given.items())
