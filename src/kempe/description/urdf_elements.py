"""Strict reading of URDF elements: links, joints, and the elements beside them.

What is wrong goes to the findings with its place.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from kempe.description.parts import Body, Shape
from kempe.description.source import (
    Findings,
    find_intended_name,
    shorten_text,
)
from kempe.description.xml import XmlElement
from kempe.poses import place

# ---- elements that are not read

# An element that has no part in the motion is passed over where it is known, else noted. What would
# be part of the mechanism for another reader, by its name or by what it ties together, is refused:
# without it the file describes another mechanism. The parts of blocks for one simulator, <gazebo>
# and <mujoco>, are for it alone, and are noted.

VERSIONS = ("1.0", "1.1", "1.2")
"""Versions of URDF that are read. 1.1 adds `quat_xyzw` and capsules, 1.2 more kinds of limits
(urdfdom's README)."""

NAMESPACE = "http://www.ros.org"
"""Namespace of URDF's own elements, by its schema."""

MOTION = {
    "link": "a <link> stands directly in <robot>",
    "joint": "a <joint> stands directly in <robot>",
    "parent": "it belongs directly into a <joint>",
    "child": "it belongs directly into a <joint>",
    "origin": "it belongs directly into a <joint>",
    "axis": "it belongs directly into a <joint>",
    "limit": "it belongs directly into a <joint>",
    "mimic": "it belongs directly into a <joint>",
}
"""Elements that decide on the motion, and where they are read."""

TOP = (
    "link",
    "joint",
    "material",
    "transmission",
    "gazebo",
    "sensor",
    "ros2_control",
    "group",
    "group_state",
    "disable_collisions",
    "end_effector",
    "virtual_joint",
    "mujoco",
    "drake",
    "verbose",
)
"""Elements of a robot that are read or change no motion; others are noted."""

SIMULATORS = ("mujoco", "drake")
"""Blocks of simulators, like <gazebo>: what they tie is not part of the robot for other readers."""

_OWN = re.compile(r"https?://(www\.|wiki\.)?ros\.org/?((wiki/)?urdf\b.*)?")
_TIES = re.compile(
    r"constraint|loop|closure|closing|coupl|equality|gear|belt|tendon|(?<!dis)connect|weld"
)
_SPEAKS = re.compile(rf"{_TIES.pattern}|joint|link|mimic|limit|axis|origin|pose", re.IGNORECASE)
_FOLLOWS = re.compile(r"mimic|gearbox|constraint", re.IGNORECASE)
_PREFIXED = re.compile(r"<[\w.-]+:")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_CONTENT = re.compile(r">([^<>]*)<")
_ELSEWHERE = {
    "visual": ("origin",),
    "collision": ("origin",),
    "inertial": ("origin",),
    "collision_checking": ("origin",),
    "self_collision_checking": ("origin",),
    "sensor": ("origin", "parent"),
    "self_filter": ("origin",),
    "loop_joint": ("axis",),
}
"""Elements of the same names that say something else there: where a visual or a sensor is, and the
axis of a loop joint, which its own reader reads."""

_NOT_READ = (
    "name",
    "type",
    "link",
    "joint",
    "xyz",
    "rpy",
    "quat_xyzw",
    "lower",
    "upper",
    "multiplier",
    "offset",
)
"""Attributes that decide on the motion."""


# ---- namespaces and version


def strip_namespaces(robot: XmlElement) -> None:
    """Remove the prefixes of elements whose prefix is bound to URDF's namespace.

    The namespace of the outermost element counts as URDF's, too.

    Names without a prefix are URDF's, whatever the default namespace is: other readers know no
    namespaces.
    """
    text = robot.source.text
    if not _PREFIXED.search(text) or not _PREFIXED.search(_COMMENT.sub("", text)):
        return
    stack: list[tuple[XmlElement, Mapping[str, str]]] = [(robot, {})]
    own: str | None = None
    while stack:
        element, bound = stack.pop()
        new = {
            k[6:]: v
            for k, v in element.attributes.items()
            if k.startswith("xmlns:") or k == "xmlns"
        }
        bound = {**bound, **new} if new else bound
        prefix, _, local = element.tag.rpartition(":")
        if element is robot and local == "robot":
            own = bound.get(prefix)
        if prefix and prefix != "xacro" and bound.get(prefix) is not None:
            uri = bound[prefix].strip()
            if uri == own or _OWN.fullmatch(uri):
                element.tag = local
        stack.extend((child, bound) for child in element.children)


def check_version(robot: XmlElement, findings: Findings) -> None:
    """Record a problem for an unknown version of URDF, as ROS does; the default is version 1.0."""
    given = robot.attributes.get("version")
    if given is not None and _read_version(robot) not in VERSIONS:
        findings.add_problem(
            f"the version is {shorten_text(given)}",
            "robot",
            robot.locate_attribute("version"),
            f"it is the version of URDF, not of the robot, and one of {', '.join(VERSIONS)} (1.0 "
            "where it is left out)",
        )


def has_quaternions(robot: XmlElement) -> bool:
    """Whether the version of the file has `quat_xyzw`."""
    return _read_version(robot) != "1.0"


def _read_version(robot: XmlElement) -> str:
    """Return the version as two numbers: '1.00' is '1.0', as ROS reads it."""
    given = robot.attributes.get("version", "1.0").strip()
    found = re.fullmatch(r"0*(\d{1,9})\.0*(\d{1,9})", given, re.ASCII)
    return f"{found[1]}.{found[2]}" if found else given


# ---- unknown names


def check_known_name(
    kind: str,
    name: str,
    known: tuple[str, ...],
    findings: Findings,
    subject: str,
    element: XmlElement,
) -> None:
    """Record a problem for an unread name that affects the motion or is misspelled, else a note."""
    if name in known or name.startswith("xmlns"):
        return
    local = name.rpartition(":")[2]
    if kind == "element":
        _check_element(element, local, known, findings, subject)
        return
    where = element.locate_attribute(name)
    if local != name and local in _NOT_READ:
        findings.add_problem(
            f"the {kind} {shorten_text(name)} is not read, for its prefix",
            subject,
            where,
            f"write {local}",
        )
    elif near := find_intended_name(
        local[:60].casefold(), known if local == name else tuple(k for k in known if k in _NOT_READ)
    ):
        findings.add_problem(
            f"unknown {kind} {shorten_text(name)}; did you mean {near!r}?", subject, where
        )
    else:
        findings.add_note(f"the {kind} {shorten_text(name)} is not read", subject, where)


def _check_element(
    element: XmlElement, local: str, known: tuple[str, ...], findings: Findings, subject: str
) -> None:
    """Record a problem for an unread element that affects the motion or is misspelled, else a note."""
    where = element.location
    tag = element.tag
    if local in MOTION:
        said = f"the prefix of <{tag}> hides it" if local in known else f"<{tag}> is not read here"
        advice = (
            f"write <{local}>, or bind the prefix to {NAMESPACE}"
            if local in known
            else MOTION[local]
        )
        findings.add_problem(
            said + _describe_contents(element), subject, where, f"{advice}; or remove it"
        )
        return
    used = tuple(k for k in known if k in MOTION or k in ("inertial", "visual"))
    if near := find_intended_name(local[:60].casefold(), used):
        findings.add_problem(
            f"unknown element {shorten_text(tag)}; did you mean {near!r}?", subject, where
        )
    else:
        reported = _describe_contents(element) if _SPEAKS.search(local) else ""
        findings.add_note(f"the element {shorten_text(tag)} is not read{reported}", subject, where)


# ---- children of <robot>, and of elements that are not read


def check_robot_children(
    robot: XmlElement, links: Collection[str], joints: Mapping[str, XmlElement], findings: Findings
) -> None:
    """Check the elements that a robot holds beside its links and joints.

    `links` are the names of its links, `joints` its joints by name.
    """
    names = {*links, *joints}
    for element in robot.children:
        if element.tag in ("link", "joint", *LOOPS):
            _check_nested_elements(element, findings)
            continue
        local = element.tag.rpartition(":")[2]
        ties = _TIES.search(local.lower()) or (
            local not in MOTION
            and element.tag != "gazebo"
            and _list_child_names(element) >= {"parent", "child"}
        )
        tied = [n for n in _iterate_texts(element) if n in names] if ties else []
        if tied:
            shown = " and ".join(map(repr, dict.fromkeys(tied[:4])))
            findings.add_problem(
                f"<{element.tag}> is not read, and it ties {shown}: without it this is another "
                "mechanism",
                "robot",
                element.location,
                "give a second <joint> to a link where it closes a loop, or use TOML; or remove it",
            )
        else:
            check_known_name("element", element.tag, TOP, findings, "", element)
        _check_nested_elements(element, findings)
        if element.tag == "gazebo":
            _note_followers(element, joints, findings)
        elif element.tag in SIMULATORS:
            _note_ties(element, names, findings)


def _note_followers(
    block: XmlElement, joints: Mapping[str, XmlElement], findings: Findings
) -> None:
    """Note elements that make joints follow each other for a simulator only.

    Joints that have their own <mimic> are known.
    """
    for element in block.iterate_elements():
        if element.tag not in MOTION and _FOLLOWS.search(element.tag):
            reported = [n for n in _iterate_texts(element) if n in joints]
            if not reported or any(not joints[n].find_children("mimic") for n in reported):
                said = (
                    f"<{element.tag}> in a <gazebo> block is not "
                    f"read{f': {reported[0]!r}' if reported else ''}"
                )
                findings.add_note(f"{said}; there joints follow each other", "", element.location)


def _note_ties(block: XmlElement, names: Collection[str], findings: Findings) -> None:
    """Note elements that tie links or joints for a simulator only, such as MuJoCo's <equality>."""
    seen: set[int] = set()
    for element in block.iterate_elements():
        local = element.tag.rpartition(":")[2]
        if id(element) in seen or element is block or not _TIES.search(local.lower()):
            continue
        seen |= {id(part) for part in element.iterate_elements()}
        tied = [n for n in _iterate_texts(element) if n in names]
        if tied:
            shown = " and ".join(map(repr, dict.fromkeys(tied[:4])))
            said = (
                f"<{element.tag}> in a <{block.tag}> block is not read{_describe_contents(element)}; there "
                f"it ties {shown}"
            )
            findings.add_note(said, "", element.location)


def _check_nested_elements(outer: XmlElement, findings: Findings) -> None:
    """Refuse links, joints and followers that are nested too deep; note those in <gazebo> blocks."""
    joint = outer.tag == "joint"
    holders = [c for c in outer.children if c.children] if joint or outer.tag == "link" else [outer]
    for holder in holders:  # what stands directly in a link or joint is judged with it
        for element in holder.children:
            if joint or element.tag in MOTION or ":" in element.tag:
                _judge_nested_element(outer, holder, element, findings)
            if element.children:
                holders.append(element)


def _judge_nested_element(
    outer: XmlElement, holder: XmlElement, element: XmlElement, findings: Findings
) -> None:
    """Record a problem or a note for an element that is nested in another one."""
    local = element.tag.rpartition(":")[2]
    joint = outer.tag == "joint"
    defines = local in MOTION and (joint or _is_definition(element, local))
    urdf = (
        local in MOTION and local not in _ELSEWHERE.get(holder.tag, ()) and _has_urdf_form(element)
    )
    if not (defines or joint or urdf):
        return
    subject = (
        f"{outer.tag} {outer.attributes['name']!r}"
        if outer.attributes.get("name")
        else f"<{outer.tag}>"
    )
    said = f"<{element.tag}> inside <{holder.tag}> is not read{_describe_contents(element)}"
    if defines and outer.tag != "gazebo":
        findings.add_problem(said, subject, element.location, MOTION[local])
    elif joint or urdf:
        findings.add_note(said, subject, element.location)


def _list_child_names(element: XmlElement) -> set[str]:
    """Return the names of the children of an element, without prefixes."""
    return {child.tag.rpartition(":")[2] for child in element.children}


def _is_definition(element: XmlElement, local: str) -> bool:
    """Whether an element defines a link or joint rather than naming one."""
    if local == "joint":
        return _list_child_names(element) >= {"parent", "child"}
    if local == "link":
        return bool(_list_child_names(element) & {"inertial", "visual", "collision"})
    return local == "mimic" and "joint" in element.attributes


def _has_urdf_form(element: XmlElement) -> bool:
    """Whether an element has the attributes of URDF, where SDF in <gazebo> blocks has elements."""
    return any(key in element.attributes for key in _NOT_READ if key not in ("name", "type"))


def _iterate_texts(element: XmlElement) -> Iterator[str]:
    """Iterate over the attribute values and texts of an element and the elements below it."""
    for part in element.iterate_elements():
        yield from part.attributes.values()
    yield from (text.strip() for text in _CONTENT.findall(element.text))


def _describe_contents(element: XmlElement) -> str:
    """Return the end of a message: the contents of an unread element, in one line."""
    said = [
        f"{p.tag.rpartition(':')[2]} {k}={shorten_text(v, 30)}"
        if p is not element
        else f"{k}={shorten_text(v, 30)}"
        for p in element.iterate_elements()
        for k, v in p.attributes.items()
        if not k.startswith("xmlns") and p.tag not in ("mass", "inertia", "mesh", "material")
    ]
    return f" ({', '.join(said[:5])}{', ...' if len(said) > 5 else ''})" if said else ""


# ---- elements that are read

UNLIMITED = 1e308
"""A limit of this size or more stands for none: URDF has no other way to say so for a prismatic
joint."""

LENIENT = "lenient_limits=True"
"""The option of readers for limits that hold no range, as messages name it."""

AXIS_TOLERANCE = 1e-5
"""An axis whose length differs from 1 by more than rounding in the file is worth a note."""

WITHOUT_AXIS = ("fixed", "floating", "spherical", "ball", "universal")
"""Types whose <axis> says nothing."""

WITHOUT_LIMIT = ("planar", "floating", "spherical", "ball", "universal", "screw")
"""Types that move and whose <limit> says nothing."""

PITCH = "drake:screw_thread_pitch"
"""The element of Drake for how far a screw advances in a turn."""

LOOPS = ("drake:ball_constraint", "loop_joint")
"""Elements of simulators that close loops, and are read."""

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
_ONCE = ("parent", "child", "origin", "axis", "limit", "mimic", PITCH)
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


def read_numbers(
    element: XmlElement, attribute: str, count: int, findings: Findings, subject: str
) -> tuple[float, ...] | None:
    """Return the finite numbers of an attribute; None after recording a problem."""
    text = element.attributes[attribute]
    what = f"{element.tag} {attribute}"
    return findings.read_numbers(
        text, count, what, subject, lambda: element.locate_attribute(attribute)
    )


def _read_bound(
    element: XmlElement, attribute: str, findings: Findings, subject: str
) -> float | None:
    """Return a limit, infinite for huge numbers; None where it is missing or wrong."""
    if attribute not in element.attributes:
        return None
    what = f"{element.tag} {attribute}"
    text = element.attributes[attribute]
    return findings.read_bound(
        text, UNLIMITED, what, subject, lambda: element.locate_attribute(attribute)
    )


# ---- links


def read_link(
    name: str, element: XmlElement, findings: Findings, shapes: tuple[Shape, ...]
) -> Body:
    """Return the body of a <link> with shapes, mass [kg] and centre of mass [m]."""
    subject = f"link {name!r}"
    mass = None
    center = None
    for child in element.children:
        if child.tag == "origin":
            findings.add_note(
                "an <origin> directly in a link has no meaning and is not used",
                subject,
                child.location,
            )
        else:
            check_known_name("element", child.tag, _IN_LINK, findings, subject, child)
    inertials = element.find_children("inertial")
    if len(inertials) > 1:
        findings.add_note(
            "it has two <inertial> elements; the first is used", subject, inertials[1].location
        )
    for inertial in inertials[:1]:
        for part in inertial.find_children("mass")[:1]:
            found = (
                read_numbers(part, "value", 1, findings, subject)
                if "value" in part.attributes
                else None
            )
            mass = found[0] if found else None
            if mass is not None and mass < 0.0:
                findings.add_problem(
                    f"mass is {mass:g}",
                    subject,
                    part.locate_attribute("value"),
                    "it must not be negative",
                )
        center = (0.0, 0.0, 0.0)
        for part in inertial.find_children("origin")[:1]:
            if "xyz" in part.attributes:
                center = read_numbers(part, "xyz", 3, findings, subject)
    return Body(name, False, mass, center, shapes, element.location)  # type: ignore[arg-type]


# ---- joints


def read_joint(
    kind: str,
    name: str,
    element: XmlElement,
    findings: Findings,
    quaternions: bool = True,
    lenient: bool = False,
) -> dict[str, Any] | None:
    """Return the keywords of `Mechanism.joint` for a joint of type `kind`; None after a problem.

    `quaternions` says whether the file's version has `quat_xyzw`, which readers pass over in older
    ones. Limits that hold no range are none where `lenient`; else the keyword `unstated` tells
    those that the file does not give.
    """
    subject = f"joint {name!r}"
    before = len(findings.problems)
    _check_joint(kind, element, findings, subject)
    out = read_origin(element, findings, subject, quaternions)
    out["axis"] = _read_axis(kind, element, findings, subject)
    if kind == "screw":
        out["pitch"] = _read_pitch(element, findings, subject)
    out |= _read_limit(kind, element, findings, subject, lenient)
    return out if len(findings.problems) == before else None


def read_origin(
    element: XmlElement, findings: Findings, subject: str, quaternions: bool
) -> dict[str, Any]:
    """Return the arguments of `place` in the <origin> of an element; {} for a missing or wrong one."""
    out: dict[str, Any] = {}
    for origin in element.find_children("origin")[:1]:
        given = {
            k: read_numbers(origin, k, n, findings, subject)
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
            where = origin.locate_attribute("quat_xyzw")
            findings.add_problem(
                said, subject, where, "write <robot version='1.1' ...>, or give rpy"
            )
        elif "rpy" in given:
            findings.add_problem(
                "its origin has both rpy and quat_xyzw", subject, origin.location, "give one"
            )
        else:
            turn: Any = given["quat_xyzw"]
            x, y, z, w = turn
            with findings.record_errors(subject, origin.locate_attribute("quat_xyzw")):
                out["at"] = place(out["at"], quat_wxyz=(w, x, y, z))
    return out


def _read_axis(
    kind: str, joint: XmlElement, findings: Findings, subject: str
) -> tuple[float, ...] | None:
    """Return the direction (3,) of the axis where the type has one; the default is x."""
    found: tuple[float, ...] | None = (1.0, 0.0, 0.0)
    axis = (joint.find_children("axis") or [None])[0]
    if axis is not None and "xyz" not in axis.attributes:
        findings.add_problem(
            "its <axis> has no xyz",
            subject,
            axis.location,
            "write <axis xyz='0 0 1'/>, for example",
        )
        return None
    if axis is not None:
        found = read_numbers(axis, "xyz", 3, findings, subject)
    if kind in WITHOUT_AXIS or found is None or axis is None:
        return None if kind in WITHOUT_AXIS else found
    length = math.hypot(*found)
    if length < 1e-150:
        findings.add_problem(
            f"its axis is {shorten_text(axis.attributes['xyz'])}",
            subject,
            axis.locate_attribute("xyz"),
            "it must not be zero: an axis has a direction, such as 0 0 1",
        )
        return None
    if abs(length - 1.0) > AXIS_TOLERANCE:
        text = " ".join(f"{x:g}" for x in found)
        findings.add_note(
            f"its axis {text} has length {length:g}; it was normalised",
            subject,
            axis.locate_attribute("xyz"),
        )
    return found


def _read_pitch(joint: XmlElement, findings: Findings, subject: str) -> float | None:
    """Return the pitch of a screw in m/rad; Drake writes it in metres for each turn."""
    for element in joint.find_children(PITCH)[:1]:
        if "value" in element.attributes:
            found = read_numbers(element, "value", 1, findings, subject)
            if found and not found[0]:
                where = element.locate_attribute("value")
                findings.add_problem("its thread pitch is 0", subject, where, "it must not be zero")
            return found[0] / math.tau if found else None
    findings.add_problem(
        f"it has no <{PITCH} value=...>", subject, joint.location, "a screw needs it: metres a turn"
    )
    return None


def _read_limit(
    kind: str, joint: XmlElement, findings: Findings, subject: str, lenient: bool
) -> dict[str, Any]:
    """Return the keywords `limits`, `velocity`, `effort` and `unstated`."""
    limit = (joint.find_children("limit") or [None])[0]
    if limit is None:
        if kind in ("revolute", "prismatic"):
            findings.add_note(
                f"a {kind} joint should have a <limit>; without one it is taken as unlimited",
                subject,
                joint.location,
            )
        return {}
    bounds = {
        key: _read_bound(limit, key, findings, subject)
        for key in ("lower", "upper", "velocity", "effort")
    }
    if kind in WITHOUT_LIMIT:
        findings.add_note(
            f"the <limit> of a {kind} joint has no defined meaning and is not used",
            subject,
            limit.location,
        )
    if kind in ("fixed", *WITHOUT_LIMIT):
        return {}
    out: dict[str, Any] = {}
    for key in ("velocity", "effort"):
        found = bounds[key]
        if found is not None and found < 0.0 and lenient:
            said = f"its {key} limit is {found:g}; it is read as unlimited, as requested"
            findings.add_note(said, subject, limit.locate_attribute(key))
        elif found is not None and found < 0.0:
            findings.add_problem(
                f"{key} limit is {found:g}",
                subject,
                limit.locate_attribute(key),
                f"it must not be negative ({LENIENT} reads it as unlimited)",
            )
        elif found is not None and not math.isinf(found):
            out[key] = found
    if kind == "continuous":
        if any(bounds[key] and not math.isinf(bounds[key] or 0.0) for key in ("lower", "upper")):
            findings.add_note(
                "a continuous joint turns without end: its lower and upper limit are not used",
                subject,
                limit.location,
            )
        return out
    return out | _read_range(limit, bounds, findings, subject, lenient)


def _read_range(
    limit: XmlElement,
    bounds: dict[str, float | None],
    findings: Findings,
    subject: str,
    lenient: bool,
) -> dict[str, Any]:
    """Return the keywords `limits` and `unstated` of a revolute or prismatic joint.

    By the rules of URDF a missing bound is 0.
    """
    given = [key for key in ("lower", "upper") if key in limit.attributes]
    lower = bounds["lower"] or 0.0
    upper = bounds["upper"] or 0.0
    both = " ".join(f"{key}={shorten_text(limit.attributes[key])}" for key in given)
    if lenient and (not given or lower > upper):
        said = f"its limits are swapped ({both})" if given else "its <limit> has no lower and upper"
        findings.add_note(f"{said}; it is read as unlimited, as requested", subject, limit.location)
        return {}
    if not given:
        said = (
            "its <limit> has no lower and upper; by the rules of URDF both are 0 and the joint "
            "cannot move"
        )
        findings.add_note(f"{said} ({LENIENT} reads it as unlimited)", subject, limit.location)
        return {"limits": (0.0, 0.0), "unstated": True}
    if lower > upper or lower == math.inf or upper == -math.inf:
        missing = "" if len(given) == 2 else " (what is missing is 0 by the rules of URDF)"
        meant = (
            f"; for Bullet and MuJoCo that means unlimited: {LENIENT} reads it so"
            if lower > upper
            else ""
        )
        findings.add_problem(
            f"its limits are swapped: {both}{missing}",
            subject,
            limit.locate_attribute(given[0]),
            f"lower must not be above upper{meant}",
        )
        return {}
    return {} if (lower, upper) == (-math.inf, math.inf) else {"limits": (lower, upper)}


# ---- unknown and repeated parts of joints


def _check_joint(kind: str, joint: XmlElement, findings: Findings, subject: str) -> None:
    """Check the names of the children and attributes of a joint."""
    allowed = (*_IN_JOINT, PITCH) if kind == "screw" else _IN_JOINT
    for part in (joint, *joint.children):
        if part is not joint and part.tag not in allowed:
            check_known_name("element", part.tag, allowed, findings, subject, part)
        known = ATTRIBUTES.get(part.tag)
        for key in part.attributes if known else ():
            if key not in known:  # type: ignore[operator]
                check_known_name(f"{part.tag} attribute", key, known, findings, subject, part)  # type: ignore[arg-type]
    tags = [child.tag for child in joint.children]
    for tag in _ONCE if len(set(tags)) < len(tags) else ():
        found = joint.find_children(tag)
        for other in found[1:2]:
            message = f"it has two <{tag}> elements, on line {found[0].location.line} and here"
            if all(o.attributes == found[0].attributes for o in found):
                findings.add_note(f"{message}, which say the same", subject, other.location)
            else:
                findings.add_problem(message, subject, other.location, "one is allowed")
