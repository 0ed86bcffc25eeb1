"""Reading of simulator elements in URDF that close loops: Drake's constraints, and loop joints."""

from __future__ import annotations

from typing import Any

from kempe.constraints import KINDS
from kempe.description.mechanism import Mechanism
from kempe.description.source import Findings, choose_numbered_name, shorten_text
from kempe.description.urdf_elements import check_known_name, read_numbers
from kempe.description.xml import XmlElement
from kempe.words import format_count

BALL = "drake:ball_constraint"
BODIES = (f"{BALL}_body_A", f"{BALL}_body_B")
POINTS = (f"{BALL}_p_AP", f"{BALL}_p_BQ")
"""The parts of Drake's constraint: two bodies, and on each a point, which coincide."""

LOOP_TYPES = {
    "spherical": "spherical",
    "fixed": "fixed",
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
}
"""Types of <loop_joint>, which Isaac Sim and older versions of Drake have, and the types of the zoo
that they are."""

_IN_LOOP = ("link1", "link2", "axis")
_OF_END = ("link", "xyz", "rpy")


def read_loops(robot: XmlElement, mechanism: Mechanism, findings: Findings) -> None:
    """Add the elements that close loops to a mechanism that has its bodies and joints."""
    for element in robot.find_children(BALL):
        _read_ball_constraint(element, mechanism, findings)
    for element in robot.find_children("loop_joint"):
        _read_loop_joint(element, mechanism, findings)


def _read_ball_constraint(element: XmlElement, mechanism: Mechanism, findings: Findings) -> None:
    """Add a constraint that two points coincide; it has no coordinates of its own."""
    name = element.attributes.get("name", "") or choose_numbered_name(
        "ball_constraint", mechanism.constraints
    )
    subject = f"constraint {name!r}"
    for child in element.children:
        check_known_name("element", child.tag, (*BODIES, *POINTS), findings, subject, child)
    bodies: Any = [
        _read_body_name(
            _find_only_child(element, tag, findings, subject), "name", mechanism, findings, subject
        )
        for tag in BODIES
    ]
    points = [
        _read_numbers(_find_only_child(element, tag, findings, subject), "value", findings, subject)
        for tag in POINTS
    ]
    if None in bodies or None in points:
        return
    with findings.record_errors(subject, element.location):
        position: Any = KINDS["position"]
        held = position(bodies[1], points[0], points[1], other=bodies[0])
        mechanism.constrain(held, name, element.location)


def _read_loop_joint(element: XmlElement, mechanism: Mechanism, findings: Findings) -> None:
    """Add a cut joint between two frames, <link1> and <link2>."""
    name = element.attributes.get("name", "")
    subject = f"loop_joint {name!r}" if name else "<loop_joint>"
    if not name:
        findings.add_problem(
            "it has no name", subject, element.location, "every joint needs a name of its own"
        )
    kind = element.attributes.get("type")
    if kind not in LOOP_TYPES:
        said = "it has no type" if kind is None else f"unknown type {shorten_text(kind)}"
        allowed = f"a <loop_joint> has {', '.join(LOOP_TYPES)}"
        findings.add_problem(said, subject, element.locate_attribute("type"), allowed)
    for child in element.children:
        check_known_name("element", child.tag, _IN_LOOP, findings, subject, child)
    ends = [child for child in element.children if child.tag in ("link1", "link2")]
    if len(ends) != 2:
        findings.add_problem(
            f"it has {format_count(len(ends), 'end')}",
            subject,
            element.location,
            "a loop joint has two: <link1 link=... xyz=... rpy=.../> and <link2 .../>",
        )
        return
    bodies: list[Any] = [_read_body_name(end, "link", mechanism, findings, subject) for end in ends]
    places: list[Any] = [_read_place(end, findings, subject) for end in ends]
    axis: Any = (1.0, 0.0, 0.0)
    for child in element.find_children("axis")[:1]:
        axis = _read_numbers(child, "xyz", findings, subject)
    if not name or kind not in LOOP_TYPES or axis is None or None in (*bodies, *places):
        return
    (at, rpy), (child_at, child_rpy) = places
    moves = kind not in ("spherical", "fixed")
    with findings.record_errors(subject, element.location):
        mechanism.joint(
            name,
            LOOP_TYPES[kind],
            bodies[0],
            bodies[1],
            at=at,
            rpy=rpy,
            child_at=child_at,
            child_rpy=child_rpy,
            axis=axis if moves else None,
            cut=True,
            where=element.location,
        )


def _read_place(end: XmlElement, findings: Findings, subject: str) -> Any:
    """Return the position and the angles of an end in the frame of its link; None after a problem."""
    for key in end.attributes:
        if key not in _OF_END:
            check_known_name(f"{end.tag} attribute", key, _OF_END, findings, subject, end)
    found = [
        _read_numbers(end, key, findings, subject) if key in end.attributes else (0.0, 0.0, 0.0)
        for key in ("xyz", "rpy")
    ]
    return None if None in found else found


def _find_only_child(
    element: XmlElement, tag: str, findings: Findings, subject: str
) -> XmlElement | None:
    """Return the only child with this tag; None after recording that there are none or several."""
    found = element.find_children(tag)
    if len(found) == 1:
        return found[0]
    where = found[1].location if found else element.location
    findings.add_problem(f"it has {len(found) or 'no'} <{tag}>", subject, where, "it needs one")
    return None


def _read_body_name(
    element: XmlElement | None,
    attribute: str,
    mechanism: Mechanism,
    findings: Findings,
    subject: str,
) -> str | None:
    """Return the body that an attribute names; None after recording that there is none."""
    if element is None:
        return None
    name = element.attributes.get(attribute, "")
    if name in mechanism.bodies:
        return name
    said = (
        f"its link {shorten_text(name)} does not exist{findings.suggest_name(name, mechanism.bodies)}"
        if name
        else f"its <{element.tag}> names no link"
    )
    findings.add_problem(
        said, subject, element.locate_attribute(attribute), "" if name else f"write {attribute}="
    )
    return None


def _read_numbers(
    element: XmlElement | None, attribute: str, findings: Findings, subject: str
) -> tuple[float, ...] | None:
    """Return the three numbers of an attribute; None after recording a problem."""
    if element is None:
        return None
    if attribute not in element.attributes:
        findings.add_problem(
            f"its <{element.tag}> has no {attribute}", subject, element.location, "give it"
        )
        return None
    return read_numbers(element, attribute, 3, findings, subject)
