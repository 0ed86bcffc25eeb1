"""The parts of URDF's links and joints, read strictly: what is wrong goes to the findings with its
place.
"""

from __future__ import annotations

import math
import re
from typing import Any

from kempe.description.parts import Body
from kempe.description.source import Findings, shorten
from kempe.description.urdf.urdf_unknown import check_known
from kempe.description.urdf.xml import XmlElement
from kempe.placement import place

UNLIMITED = 1e308
"""A limit of this size or more stands for none: URDF has no other way to say so for a prismatic
joint."""

LENIENT = "lenient_limits=True"
"""The option of readers for limits that hold no range, as messages name it."""

AXIS_TOLERANCE = 1e-5
"""An axis whose length differs from 1 by more than rounding in the file is worth a note."""

WITHOUT_AXIS = ("fixed", "floating", "spherical")
"""Types whose <axis> says nothing."""

_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_PLAIN = re.compile(r"[-+.0-9eE \t\r\n]+")
"""Text in which `float` reads what `_NUMBER` matches, and nothing else."""
_BLANKS = re.compile(r"[ \t\r\n]+")

_IN_LINK = (
    "inertial",
    "visual",
    "collision",
    "contact",
    "self_filter",
    "gravity",
    "surface",
    "kinematic",
    "self_collide",
    "collision_checking",
    "self_collision_checking",
    "verbose",
)
"""Elements of a link that are read or change no motion; others are noted. Likewise in joints."""

_IN_JOINT = (
    "parent",
    "child",
    "origin",
    "axis",
    "limit",
    "mimic",
    "dynamics",
    "calibration",
    "safety_controller",
    "hardwareInterface",
    "physics",
    "joint_properties",
)
_ONCE = ("parent", "child", "origin", "axis", "limit", "mimic")
ATTRIBUTES = {
    "joint": ("name", "type"),
    "parent": ("link",),
    "child": ("link",),
    "origin": ("xyz", "rpy", "quat_xyzw"),
    "axis": ("xyz",),
    "mimic": ("joint", "multiplier", "offset"),
    "limit": ("lower", "upper", "effort", "velocity", "acceleration", "deceleration", "jerk"),
}
"""Attributes of the elements that decide on the motion."""


# ---- numbers


def numbers(
    element: XmlElement, attribute: str, count: int, findings: Findings, subject: str
) -> tuple[float, ...] | None:
    """The finite numbers of an attribute, or None after recording what is wrong with it."""
    text = element.attributes[attribute]
    if _PLAIN.fullmatch(text):
        try:
            found = tuple(map(float, text.split()))
        except ValueError:
            found = ()
        if len(found) == count and math.isfinite(sum(found)):
            return found
    pieces = [p for p in _BLANKS.split(text) if p]
    wrong = None
    for piece in pieces:
        if _NUMBER.fullmatch(piece):
            if math.isinf(float(piece)):
                wrong = f"{shorten(piece)} is not finite"
        elif _special(piece) is not None:
            wrong = f"{shorten(piece)} is not finite"
        elif re.fullmatch(r"[+-]?[0-9]+,[0-9]+", piece):
            wrong = f"{piece!r} is not a number (decimals take a point: {piece.replace(',', '.')})"
        elif "," in piece:
            wrong = f"{shorten(piece)} is not a number (no commas between numbers)"
        else:
            wrong = f"{shorten(piece)} is not a number"
        if wrong:
            break
    if wrong is None and len(pieces) != count:
        wrong = f"{len(pieces)} number{'s' if len(pieces) != 1 else ''}"
    if wrong is None:
        return tuple(float(p) for p in pieces)
    allowed = (
        "it must be a finite number"
        if count == 1
        else f"it must be {count} finite numbers separated by blanks"
    )
    findings.add(
        f"{element.tag} {attribute} is {shorten(text)}: {wrong}",
        subject,
        element.where_of(attribute),
        allowed,
    )
    return None


def _special(piece: str) -> float | None:
    """Infinity or NaN where the text says so, in any of the usual spellings."""
    match = re.fullmatch(r"([+-]?)(inf|infinity|nan)", piece, re.IGNORECASE)
    return float(match[0]) if match else None


def _bound(element: XmlElement, attribute: str, findings: Findings, subject: str) -> float | None:
    """A limit: a number, where infinity or a huge one stands for none; None where it is missing or
    wrong.
    """
    if attribute not in element.attributes:
        return None
    text = element.attributes[attribute]
    special = None if _PLAIN.fullmatch(text) else _special(text.strip())
    if special is not None and not math.isnan(special):
        return special
    found = numbers(element, attribute, 1, findings, subject)
    return (
        None
        if found is None
        else found[0]
        if abs(found[0]) < UNLIMITED
        else math.copysign(math.inf, found[0])
    )


# ---- links


def read_link(name: str, element: XmlElement, findings: Findings) -> Body:
    """Body of a <link>: its mass and centre of mass where given, its visuals as text."""
    subject = f"link {name!r}"
    mass = None
    center = None
    for child in element.children:
        if child.tag == "origin":
            findings.note(
                "an <origin> directly in a link has no meaning and is not used",
                subject,
                child.where,
            )
        else:
            check_known("element", child.tag, _IN_LINK, findings, subject, child)
    inertials = element.of("inertial")
    if len(inertials) > 1:
        findings.note(
            "it has two <inertial> elements; the first is used", subject, inertials[1].where
        )
    for inertial in inertials[:1]:
        for part in inertial.of("mass")[:1]:
            found = (
                numbers(part, "value", 1, findings, subject) if "value" in part.attributes else None
            )
            mass = found[0] if found else None
            if mass is not None and mass < 0.0:
                findings.add(
                    f"mass is {mass:g}", subject, part.where_of("value"), "it must not be negative"
                )
        center = (0.0, 0.0, 0.0)
        for part in inertial.of("origin")[:1]:
            if "xyz" in part.attributes:
                center = numbers(part, "xyz", 3, findings, subject)
    visuals = tuple(v.text for v in element.of("visual"))
    return Body(name, False, mass, center, visuals, element.where)  # type: ignore[arg-type]


# ---- joints


def read_joint(
    kind: str,
    name: str,
    element: XmlElement,
    findings: Findings,
    quaternions: bool = True,
    lenient: bool = False,
) -> dict[str, Any] | None:
    """Keywords for `Mechanism.joint` of a <joint> of type `kind`, or None after recording what is
    wrong.

    `quaternions` says whether the file's version has `quat_xyzw`, which readers pass over in older
    ones. Limits that hold no range are none where `lenient`; else the keyword `unstated` tells
    those that the file does not give.
    """
    subject = f"joint {name!r}"
    before = len(findings.problems)
    _check_joint(element, findings, subject)
    out = _origin(element, findings, subject, quaternions)
    out["axis"] = _axis(kind, element, findings, subject)
    out |= _limit(kind, element, findings, subject, lenient)
    return out if len(findings.problems) == before else None


def _origin(
    joint: XmlElement, findings: Findings, subject: str, quaternions: bool
) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for origin in joint.of("origin")[:1]:
        given = {
            k: numbers(origin, k, n, findings, subject)
            for k, n in (("xyz", 3), ("rpy", 3), ("quat_xyzw", 4))
            if k in origin.attributes
        }
        if None in given.values():
            return out
        out["at"] = given.get("xyz", (0.0, 0.0, 0.0))
        if "quat_xyzw" not in given:
            out["rpy"] = given.get("rpy")
        elif not quaternions:
            said = (
                "quat_xyzw is of URDF 1.1, and this file is of version 1.0, where readers pass "
                "over it"
            )
            where = origin.where_of("quat_xyzw")
            findings.add(said, subject, where, "write <robot version='1.1' ...>, or give rpy")
        elif "rpy" in given:
            findings.add("its origin has both rpy and quat_xyzw", subject, origin.where, "give one")
        else:
            turn: Any = given["quat_xyzw"]
            x, y, z, w = turn
            with findings.guard(subject, origin.where_of("quat_xyzw")):
                out["at"] = place(out["at"], quat_wxyz=(w, x, y, z))
    return out


def _axis(
    kind: str, joint: XmlElement, findings: Findings, subject: str
) -> tuple[float, ...] | None:
    """Direction of the axis where the type has one; the default is x."""
    found: tuple[float, ...] | None = (1.0, 0.0, 0.0)
    axis = (joint.of("axis") or [None])[0]
    if axis is not None and "xyz" not in axis.attributes:
        findings.add(
            "its <axis> has no xyz", subject, axis.where, "write <axis xyz='0 0 1'/>, for example"
        )
        return None
    if axis is not None:
        found = numbers(axis, "xyz", 3, findings, subject)
    if kind in WITHOUT_AXIS or found is None or axis is None:
        return None if kind in WITHOUT_AXIS else found
    length = math.hypot(*found)
    if length < 1e-150:
        findings.add(
            f"its axis is {shorten(axis.attributes['xyz'])}",
            subject,
            axis.where_of("xyz"),
            "it must not be zero: an axis has a direction, such as 0 0 1",
        )
        return None
    if abs(length - 1.0) > AXIS_TOLERANCE:
        text = " ".join(f"{x:g}" for x in found)
        findings.note(
            f"its axis {text} has length {length:g}; it was normalised",
            subject,
            axis.where_of("xyz"),
        )
    return found


def _limit(
    kind: str, joint: XmlElement, findings: Findings, subject: str, lenient: bool
) -> dict[str, Any]:
    """Keywords `limits`, `velocity`, `effort` and `unstated`."""
    limit = (joint.of("limit") or [None])[0]
    if limit is None:
        if kind in ("revolute", "prismatic"):
            findings.note(
                f"a {kind} joint should have a <limit>; without one it is taken as unlimited",
                subject,
                joint.where,
            )
        return {}
    bounds = {
        key: _bound(limit, key, findings, subject)
        for key in ("lower", "upper", "velocity", "effort")
    }
    if kind in ("planar", "floating", "spherical"):
        findings.note(
            f"the <limit> of a {kind} joint has no defined meaning and is not used",
            subject,
            limit.where,
        )
    if kind in ("fixed", "planar", "floating", "spherical"):
        return {}
    out: dict[str, Any] = {}
    for key in ("velocity", "effort"):
        found = bounds[key]
        if found is not None and found < 0.0:
            findings.add(
                f"{key} limit is {found:g}", subject, limit.where_of(key), "it must not be negative"
            )
        elif found is not None and not math.isinf(found):
            out[key] = found
    if kind == "continuous":
        if any(bounds[key] and not math.isinf(bounds[key] or 0.0) for key in ("lower", "upper")):
            findings.note(
                "a continuous joint turns without end: its lower and upper limit are not used",
                subject,
                limit.where,
            )
        return out
    return out | _range(limit, bounds, findings, subject, lenient)


def _range(
    limit: XmlElement,
    bounds: dict[str, float | None],
    findings: Findings,
    subject: str,
    lenient: bool,
) -> dict[str, Any]:
    """Keywords `limits` and `unstated` of a revolute or prismatic joint: what is missing is 0 by
    the rules of URDF.
    """
    given = [key for key in ("lower", "upper") if key in limit.attributes]
    lower = bounds["lower"] or 0.0
    upper = bounds["upper"] or 0.0
    both = " ".join(f"{key}={shorten(limit.attributes[key])}" for key in given)
    if lenient and (not given or lower > upper):
        said = f"its limits are swapped ({both})" if given else "its <limit> has no lower and upper"
        findings.note(f"{said}; it is read as unlimited, as requested", subject, limit.where)
        return {}
    if not given:
        said = (
            "its <limit> has no lower and upper; by the rules of URDF both are 0 and the joint "
            "cannot move"
        )
        findings.note(f"{said} ({LENIENT} reads it as unlimited)", subject, limit.where)
        return {"limits": (0.0, 0.0), "unstated": True}
    if lower > upper or lower == math.inf or upper == -math.inf:
        missing = "" if len(given) == 2 else " (what is missing is 0 by the rules of URDF)"
        meant = (
            f"; for Bullet and MuJoCo that means unlimited: {LENIENT} reads it so"
            if lower > upper
            else ""
        )
        findings.add(
            f"its limits are swapped: {both}{missing}",
            subject,
            limit.where_of(given[0]),
            f"lower must not be above upper{meant}",
        )
        return {}
    return {} if (lower, upper) == (-math.inf, math.inf) else {"limits": (lower, upper)}


# ---- what is not known


def _check_joint(joint: XmlElement, findings: Findings, subject: str) -> None:
    for part in (joint, *joint.children):
        if part is not joint and part.tag not in _IN_JOINT:
            check_known("element", part.tag, _IN_JOINT, findings, subject, part)
        known = ATTRIBUTES.get(part.tag)
        for key in part.attributes if known else ():
            if key not in known:  # type: ignore[operator]
                check_known(f"{part.tag} attribute", key, known, findings, subject, part)  # type: ignore[arg-type]
    tags = [child.tag for child in joint.children]
    for tag in _ONCE if len(set(tags)) < len(tags) else ():
        found = joint.of(tag)
        for other in found[1:2]:
            message = f"it has two <{tag}> elements, on line {found[0].where.line} and here"
            if all(o.attributes == found[0].attributes for o in found):
                findings.note(f"{message}, which say the same", subject, other.where)
            else:
                findings.add(message, subject, other.where, "one is allowed")
