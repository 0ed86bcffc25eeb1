"""Strict reading of SDF elements: poses, axes, masses, and the elements beside them.

What is wrong goes to the findings with its place.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Any

from kempe.description.source import (
    Findings,
    find_intended_name,
    shorten_text,
)
from kempe.description.xml import XmlElement
from kempe.errors import Where
from kempe.poses import Placement, place

# ---- elements that are known

Version = tuple[int, int]

OLDEST: Version = (1, 2)
NEWEST: Version = (1, 12)
"""Versions of SDF that are read; those before 1.4 differ from it in nothing that moves."""

UNLIMITED = 1e16
"""A bound of this size or more stands for none, as in Gazebo."""

AXIS_TOLERANCE = 1e-5
"""An axis whose length differs from 1 by more than rounding in the file is worth a note."""

TYPES = (
    "revolute",
    "continuous",
    "prismatic",
    "fixed",
    "ball",
    "universal",
    "revolute2",
    "screw",
    "gearbox",
)
"""Types of joints."""

KNOWN = {
    "sdf": ("model", "world", "light", "actor"),
    "world": (
        "model",
        "include",
        "frame",
        "joint",
        "audio",
        "wind",
        "gravity",
        "magnetic_field",
        "atmosphere",
        "gui",
        "physics",
        "scene",
        "light",
        "plugin",
        "road",
        "spherical_coordinates",
    ),
    "model": (
        "link",
        "joint",
        "frame",
        "model",
        "include",
        "pose",
        "static",
        "self_collide",
        "allow_auto_disable",
        "enable_wind",
        "plugin",
    ),
    "include": ("uri", "name", "pose", "static", "placement_frame", "namespace", "plugin"),
    "link": (
        "pose",
        "inertial",
        "visual",
        "collision",
        "gravity",
        "enable_wind",
        "self_collide",
        "must_be_base_link",
        "kinematic",
        "velocity_decay",
        "sensor",
        "projector",
        "audio_sink",
        "audio_source",
        "battery",
        "light",
        "particle_emitter",
        "drake:visual",
    ),
    "joint": (
        "parent",
        "child",
        "pose",
        "axis",
        "axis2",
        "physics",
        "sensor",
        "thread_pitch",
        "screw_thread_pitch",
        "gearbox_ratio",
        "gearbox_reference_body",
    ),
    "frame": ("pose",),
    "inertial": (
        "mass",
        "pose",
        "inertia",
        "density",
        "auto_inertia_params",
        "fluid_added_mass",
    ),
    "axis": ("xyz", "limit", "mimic", "dynamics", "use_parent_model_frame"),
    "limit": ("lower", "upper", "effort", "velocity", "stiffness", "dissipation"),
    "mimic": ("multiplier", "offset", "reference"),
}
"""Elements that are read, or change no motion, by the element that holds them."""

ATTRIBUTES = {
    "model": ("name", "canonical_link", "placement_frame", "namespace"),
    "include": ("merge",),
    "link": ("name",),
    "joint": ("name", "type"),
    "frame": ("name", "attached_to"),
    "pose": ("relative_to", "frame", "degrees", "rotation_format"),
    "xyz": ("expressed_in",),
    "mimic": ("joint", "axis"),
}
"""Attributes that are read, or change no motion."""

ONCE = {
    "pose",
    "static",
    "parent",
    "child",
    "axis",
    "axis2",
    "xyz",
    "limit",
    "mimic",
    "lower",
    "upper",
    "velocity",
    "effort",
    "mass",
    "inertial",
    "uri",
    "name",
    "placement_frame",
    "thread_pitch",
    "screw_thread_pitch",
    "multiplier",
    "offset",
    "reference",
}
"""Elements that are given once."""

NOT_READ = {
    "state": "poses of a recorded state are not used: models stand where they are placed",
    "population": "models that it would add are not there",
    "actor": "what an actor does is an animation",
    "gripper": "what it grasps is for a simulator",
    "initial_position": "it is not used: at zero the links are where the file places them",
    "drake:linear_bushing_rpy": "it is a spring, which holds nothing",
    "drake:linear_spring_damper": "it is a spring, which holds nothing",
    "drake:tendon_constraint": "the range of a tendon is not held",
}
"""What is noted about elements that are known and not read."""

FORCES = ("drake:rotor_inertia", "drake:gear_ratio", "drake:controller_gains")
"""Elements of Drake inside of joints that change no motion."""


def check_known_children(
    element: XmlElement, findings: Findings, subject: str, extra: tuple[str, ...] = ()
) -> None:
    """Refuse misspelled and repeated children and attributes of an element; note unread ones.

    `extra` are elements with a prefix that the caller reads.
    """
    tag = "axis" if element.tag == "axis2" else element.tag
    known = KNOWN[tag] + extra
    seen: dict[str, XmlElement] = {}
    for child in element.children:
        first = seen.setdefault(child.tag, child)
        if child is not first and child.tag in ONCE and child.text.split() != first.text.split():
            findings.add_problem(
                f"it has two <{child.tag}> elements, on line {first.location.line} and here",
                subject,
                child.location,
                "one is allowed",
            )
        if child.tag not in known and child is first:
            _note_unknown_name("element", child.tag, known, findings, subject, child.location)
        check_attributes(child, findings, subject)


def check_attributes(element: XmlElement, findings: Findings, subject: str) -> None:
    """Refuse misspelled attributes of an element; note unread ones."""
    known = ATTRIBUTES.get(element.tag)
    for key in element.attributes if known is not None else ():
        if known is not None and key not in known:
            _note_unknown_name(
                "attribute", key, known, findings, subject, element.locate_attribute(key)
            )


def _note_unknown_name(
    kind: str,
    name: str,
    known: tuple[str, ...],
    findings: Findings,
    subject: str,
    where: Where,
) -> None:
    """Record a problem for a misspelled name of an element or attribute, and a note for any other."""
    if name.startswith("xmlns") or name in FORCES:
        return
    near = None if ":" in name else find_intended_name(name[:60].casefold(), known)
    if name not in NOT_READ and near:
        findings.add_problem(
            f"unknown {kind} {shorten_text(name)}; did you mean {near!r}?", subject, where
        )
        return
    reason = f": {NOT_READ[name]}" if name in NOT_READ else ""
    findings.add_note(f"the {kind} {shorten_text(name)} is not read{reason}", subject, where)


# ---- texts and numbers


def find_first_child(element: XmlElement | None, tag: str) -> XmlElement | None:
    """Return the first child with this tag; None where there is none."""
    return (element.find_children(tag) or [None])[0] if element is not None else None


def get_child_text(element: XmlElement | None, tag: str) -> str:
    """Return the text in the first child with this tag; '' without one."""
    child = find_first_child(element, tag)
    return child.content if child is not None and not child.children else ""


def read_numbers(
    element: XmlElement, count: int, findings: Findings, subject: str
) -> tuple[float, ...] | None:
    """Return the finite numbers in an element; None after recording a problem."""
    text = element.content
    return findings.read_numbers(
        text, count, element.tag, subject, lambda: element.content_location
    )


def read_number(
    holder: XmlElement, tag: str, default: float, findings: Findings, subject: str
) -> float | None:
    """Return the finite number in a child, or the default without a child; None after a problem."""
    child = find_first_child(holder, tag)
    if child is None:
        return default
    found = read_numbers(child, 1, findings, subject)
    return None if found is None else found[0]


def parse_truth(
    text: str | None, where: Where, findings: Findings, subject: str, what: str
) -> bool:
    """Return whether a text is "true" or "1", in any letter case; None and '' are false."""
    given = (text or "").strip().casefold()
    if given not in ("", "true", "false", "1", "0"):
        findings.add_problem(
            f"{what} is {shorten_text(text)}", subject, where, "it must be true or false"
        )
    return given in ("true", "1")


# ---- poses


def read_pose(
    holder: XmlElement, findings: Findings, subject: str
) -> tuple[Placement, str, XmlElement | None]:
    """Return the placement in the <pose> of an element, its reference frame, and the <pose>.

    The name of the reference frame is '' where the file leaves it open.
    """
    pose = find_first_child(holder, "pose")
    if pose is None:
        return Placement(), "", None
    given = pose.attributes
    relative = given.get("relative_to") or given.get("frame") or ""
    if not pose.content:
        return Placement(), relative, pose
    form = given.get("rotation_format", "euler_rpy")
    if form not in ("euler_rpy", "quat_xyzw"):
        findings.add_problem(
            f"rotation_format is {shorten_text(form)}",
            subject,
            pose.locate_attribute("rotation_format"),
            "it must be euler_rpy or quat_xyzw",
        )
        return Placement(), relative, pose
    degrees = parse_truth(
        given.get("degrees"), pose.locate_attribute("degrees"), findings, subject, "degrees"
    )
    found = read_numbers(pose, 6 if form == "euler_rpy" else 7, findings, subject)
    if found is None:
        return Placement(), relative, pose
    with findings.record_errors(subject, pose.content_location):
        if form == "quat_xyzw":
            x, y, z, w = found[3:]
            return place(found[:3], quat_wxyz=(w, x, y, z)), relative, pose
        turn = tuple(map(math.radians, found[3:])) if degrees else found[3:]
        return place(found[:3], rpy=turn), relative, pose
    return Placement(), relative, pose


# ---- masses


def read_inertial(
    link: XmlElement, findings: Findings, subject: str
) -> tuple[float | None, tuple[float, ...] | None]:
    """Return mass [kg] and centre of mass [m] of a link; None where they are not given."""
    inertial = find_first_child(link, "inertial")
    if inertial is None:
        return None, None
    check_known_children(inertial, findings, subject)
    X, relative, pose = read_pose(inertial, findings, subject)
    if relative and pose is not None:
        findings.add_problem(
            f"the pose of its <inertial> is relative to {relative!r}",
            subject,
            pose.location,
            "it is seen from the link, and names no frame",
        )
    mass = read_number(inertial, "mass", 1.0, findings, subject)
    where = inertial.locate_attribute("auto")
    if parse_truth(inertial.attributes.get("auto"), where, findings, subject, "auto"):
        findings.add_note(
            "its mass follows from its shapes (<inertial auto='true'>) and is not computed",
            subject,
            inertial.location,
        )
        return None, None
    return mass, tuple(X.evaluate_pose({})[:3, 3].tolist())


# ---- axes


@dataclass
class Axis:
    """An <axis> or <axis2> of a joint."""

    xyz: tuple[float, ...] = (0.0, 0.0, 1.0)
    expressed_in: str = ""
    where: Where | None = None
    keywords: dict[str, Any] = field(default_factory=dict[str, Any])
    """`limits`, `velocity` and `effort` as `Mechanism.joint` takes them, where they are given."""
    mimic: XmlElement | None = None


def read_axis(
    axis: XmlElement, version: Version, findings: Findings, subject: str, lenient: bool
) -> Axis | None:
    """Return the axis that an element describes; None after recording a problem.

    `version` is that of its file, `lenient` reads a lower limit above the upper one as no limit.
    """
    before = len(findings.problems)
    check_known_children(axis, findings, subject)
    out = Axis(where=axis.location, mimic=find_first_child(axis, "mimic"))
    xyz = find_first_child(axis, "xyz")
    if xyz is not None:
        out.xyz = read_numbers(xyz, 3, findings, subject) or out.xyz
        out.expressed_in = xyz.attributes.get("expressed_in", "")
        out.where = xyz.content_location
        _check_axis_length(out.xyz, xyz, findings, subject)
    flag = find_first_child(axis, "use_parent_model_frame")
    said = "use_parent_model_frame"
    if version < (1, 5):
        out.expressed_in = "__model__"
    elif flag is not None and parse_truth(flag.content, flag.location, findings, subject, said):
        if version < (1, 7):
            out.expressed_in = "__model__"
        else:
            findings.add_note(
                "the element 'use_parent_model_frame' is not read: from version 1.7 on xyz has "
                "expressed_in",
                subject,
                flag.location,
            )
    limit = find_first_child(axis, "limit")
    if limit is not None:
        check_known_children(limit, findings, subject)
        out.keywords = _read_limits(limit, findings, subject, lenient)
    return out if len(findings.problems) == before else None


def _check_axis_length(
    xyz: tuple[float, ...], element: XmlElement, findings: Findings, subject: str
) -> None:
    """Record a problem for an axis of length zero."""
    length = math.hypot(*xyz)
    if length < 1e-150:
        findings.add_problem(
            f"its axis is {shorten_text(element.content)}",
            subject,
            element.content_location,
            "it must not be zero: an axis has a direction, such as 0 0 1",
        )
    elif abs(length - 1.0) > AXIS_TOLERANCE:
        text = " ".join(f"{x:g}" for x in xyz)
        findings.add_note(
            f"its axis {text} has length {length:g}; it was normalised", subject, element.location
        )


def _read_limits(
    limit: XmlElement, findings: Findings, subject: str, lenient: bool
) -> dict[str, Any]:
    """Return the keywords `limits`, `velocity` and `effort`; missing or negative bounds are none."""
    ends = {"lower": -math.inf, "upper": math.inf, "velocity": math.inf, "effort": math.inf}
    bounds = {key: _read_bound(limit, key, end, findings, subject) for key, end in ends.items()}
    out: dict[str, Any] = {}
    for key in ("velocity", "effort"):
        if 0.0 <= bounds[key] < math.inf:
            out[key] = bounds[key]
    lower = bounds["lower"]
    upper = bounds["upper"]
    both = f"lower {get_child_text(limit, 'lower')}, upper {get_child_text(limit, 'upper')}"
    if lower > upper and lenient:
        said = f"its limits are swapped ({both}); it is read as unlimited, as requested"
        findings.add_note(said, subject, limit.location)
    elif lower > upper or lower == math.inf or upper == -math.inf:
        findings.add_problem(
            f"its limits are swapped: {both}",
            subject,
            limit.location,
            "lower must not be above upper; lenient_limits=True reads this as unlimited",
        )
    elif (lower, upper) != (-math.inf, math.inf):
        out["limits"] = (lower, upper)
    return out


def _read_bound(
    limit: XmlElement, tag: str, default: float, findings: Findings, subject: str
) -> float:
    """Return a bound, or the default where it is missing; a huge number is infinite."""
    element = find_first_child(limit, tag)
    if element is None:
        return default
    found = findings.read_bound(
        element.content, UNLIMITED, tag, subject, lambda: element.content_location
    )
    return default if found is None else found


@dataclass(frozen=True)
class Mimic:
    """Relation of a follower: coordinate = multiplier * (leader - reference) + offset."""

    joint: str
    axis: str
    multiplier: float
    offset: float
    where: Where


def read_mimic(element: XmlElement, findings: Findings, subject: str) -> Mimic | None:
    """Return the relation of a <mimic> or <drake:mimic>; None after recording a problem."""
    before = len(findings.problems)
    leader = element.attributes.get("joint", "").strip()
    axis = element.attributes.get("axis", "axis")
    if not leader:
        findings.add_problem(
            "its <mimic> names no joint", subject, element.location, "write joint=..."
        )
    if axis not in ("axis", "axis2"):
        findings.add_problem(
            f"it mimics the axis {shorten_text(axis)}",
            subject,
            element.locate_attribute("axis"),
            "it must be axis or axis2",
        )
    if element.tag == "mimic":
        check_known_children(element, findings, subject)
        multiplier, offset, reference = (
            read_number(element, tag, default, findings, subject)
            for tag, default in (("multiplier", 1.0), ("offset", 0.0), ("reference", 0.0))
        )
    else:
        multiplier, offset = (
            _read_attribute(element, key, default, findings, subject)
            for key, default in (("multiplier", 1.0), ("offset", 0.0))
        )
        reference = 0.0
    if len(findings.problems) > before or multiplier is None or offset is None or reference is None:
        return None
    return Mimic(leader, axis, multiplier, offset - multiplier * reference, element.location)


def _read_attribute(
    element: XmlElement, key: str, default: float, findings: Findings, subject: str
) -> float | None:
    """Return the number of an attribute, or the default where it is missing; None after a problem."""
    if key not in element.attributes:
        return default
    what = f"{element.tag} {key}"
    text = element.attributes[key]
    found = findings.read_numbers(text, 1, what, subject, lambda: element.locate_attribute(key))
    return None if found is None else found[0]


# ---- versions


def parse_version(text: str) -> Version:
    """Return a version as two numbers; (0, 0) where the text is no version."""
    found = re.fullmatch(r"\s*0*(\d{1,9})\.0*(\d{1,9})(?:\.\d+)?\s*", text, re.ASCII)
    return (int(found[1]), int(found[2])) if found else (0, 0)


def read_version(sdf: XmlElement, findings: Findings) -> Version:
    """Return the version of a file as two numbers; record a problem for a version that is not read."""
    given = sdf.attributes.get("version")
    version = parse_version(given or "")
    if OLDEST <= version <= NEWEST:
        return version
    said = "it has no version" if given is None else f"the version is {shorten_text(given)}"
    findings.add_problem(
        said,
        "sdf",
        sdf.locate_attribute("version"),
        f"it must be one from {OLDEST[0]}.{OLDEST[1]} to {NEWEST[0]}.{NEWEST[1]}, as in <sdf "
        f"version='{NEWEST[0]}.{NEWEST[1]}'>",
    )
    return NEWEST
