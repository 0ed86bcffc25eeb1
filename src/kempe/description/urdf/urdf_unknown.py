"""What a URDF file holds beside the elements that are read: passed over, noted, or refused.

An element that has no part in the motion is passed over where it is known, else noted. What would
be part of the mechanism for another reader, by its name or by what it ties together, is refused:
without it the file describes another mechanism. The parts of blocks for one simulator, <gazebo> and
<mujoco>, are for it alone, and are noted.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Iterator, Mapping
from functools import lru_cache

from kempe.description.source import Findings, shorten
from kempe.description.urdf.xml import XmlElement

VERSIONS = ("1.0", "1.1", "1.2")
"""Versions of URDF that are read. 1.1 adds `quat_xyzw` and capsules, 1.2 more kinds of limits
(urdfdom's README)."""

NAMESPACE = "http://www.ros.org"
"""Namespace of URDF's own elements, by its schema."""

SLIP = 0.8
"""Likeness (of `difflib`) from which on an unknown name is taken for a slip of a known one."""

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
}
"""Elements of the same names that say something else there: where a visual or a sensor is."""

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


# ---- namespaces, version


def strip_namespaces(robot: XmlElement) -> None:
    """Give elements whose prefix is bound to URDF's namespace, or to that of the outermost element,
    their plain names.

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
    """Refuse versions of URDF that are not known, as ROS does; without one, a file is of version
    1.0.
    """
    given = robot.attributes.get("version")
    if given is not None and _version(robot) not in VERSIONS:
        findings.add(
            f"the version is {shorten(given)}",
            "robot",
            robot.where_of("version"),
            f"it is the version of URDF, not of the robot, and one of {', '.join(VERSIONS)} (1.0 "
            "where it is left out)",
        )


def has_quaternions(robot: XmlElement) -> bool:
    """Whether the file is of a version that has `quat_xyzw`."""
    return _version(robot) != "1.0"


def _version(robot: XmlElement) -> str:
    """The version as two numbers: '1.00' is 1.0, as ROS reads it."""
    given = robot.attributes.get("version", "1.0").strip()
    found = re.fullmatch(r"0*(\d{1,9})\.0*(\d{1,9})", given, re.ASCII)
    return f"{found[1]}.{found[2]}" if found else given


# ---- names that are not known


def check_known(
    kind: str,
    name: str,
    known: tuple[str, ...],
    findings: Findings,
    subject: str,
    element: XmlElement,
) -> None:
    """Refuse a name that decides on the motion, or looks like a slip of one that is read; note any
    other.
    """
    if name in known or name.startswith("xmlns"):
        return
    local = name.rpartition(":")[2]
    if kind == "element":
        _check_element(element, local, known, findings, subject)
        return
    where = element.where_of(name)
    if local != name and local in _NOT_READ:
        findings.add(
            f"the {kind} {shorten(name)} is not read, for its prefix",
            subject,
            where,
            f"write {local}",
        )
    elif near := _near(
        local[:60].casefold(), known if local == name else tuple(k for k in known if k in _NOT_READ)
    ):
        findings.add(f"unknown {kind} {shorten(name)}; did you mean {near!r}?", subject, where)
    else:
        findings.note(f"the {kind} {shorten(name)} is not read", subject, where)


def _check_element(
    element: XmlElement, local: str, known: tuple[str, ...], findings: Findings, subject: str
) -> None:
    where = element.where
    tag = element.tag
    if local in MOTION:
        said = f"the prefix of <{tag}> hides it" if local in known else f"<{tag}> is not read here"
        advice = (
            f"write <{local}>, or bind the prefix to {NAMESPACE}"
            if local in known
            else MOTION[local]
        )
        findings.add(said + _speaks_of(element), subject, where, f"{advice}; or remove it")
        return
    used = tuple(k for k in known if k in MOTION or k in ("inertial", "visual"))
    if near := _near(local[:60].casefold(), used):
        findings.add(f"unknown element {shorten(tag)}; did you mean {near!r}?", subject, where)
    else:
        reported = _speaks_of(element) if _SPEAKS.search(local) else ""
        findings.note(f"the element {shorten(tag)} is not read{reported}", subject, where)


def _words(name: str) -> list[str]:
    return [w for w in re.split(r"[_\-.\s]+", name) if w]


@lru_cache(maxsize=1024)
def _near(name: str, known: tuple[str, ...]) -> str | None:
    """The known name that this one is a slip of. A name that holds a known one among its words is
    no slip.
    """
    swapped = [
        k for k in known if sorted(k) == sorted(name)
    ]  # 'xzy': too short to be like 'xyz' otherwise
    if swapped:
        return swapped[0]
    mine = _words(name)
    for k in difflib.get_close_matches(name, known, n=3, cutoff=SLIP):
        own = _words(k)
        if len(own) == len(mine) or not any(
            mine[i : i + len(own)] == own for i in range(len(mine))
        ):
            return k
    return None


# ---- what stands in <robot>, and inside what is not read


def check_top(
    robot: XmlElement, links: Collection[str], joints: Mapping[str, XmlElement], findings: Findings
) -> None:
    """Judge what a robot holds beside its links and joints: the names of its `links`, and its
    `joints` by name.
    """
    names = {*links, *joints}
    for element in robot.children:
        if element.tag in ("link", "joint"):
            _check_inside(element, findings)
            continue
        local = element.tag.rpartition(":")[2]
        ties = _TIES.search(local.lower()) or (
            local not in MOTION
            and element.tag != "gazebo"
            and _held(element) >= {"parent", "child"}
        )
        tied = [n for n in _named(element) if n in names] if ties else []
        if tied:
            shown = " and ".join(map(repr, dict.fromkeys(tied[:4])))
            findings.add(
                f"<{element.tag}> is not read, and it ties {shown}: without it this is another "
                "mechanism",
                "robot",
                element.where,
                "give a second <joint> to a link where it closes a loop, or use TOML; or remove it",
            )
        else:
            check_known("element", element.tag, TOP, findings, "", element)
        _check_inside(element, findings)
        if element.tag == "gazebo":
            _note_followers(element, joints, findings)
        elif element.tag in SIMULATORS:
            _note_ties(element, names, findings)


def _note_followers(
    block: XmlElement, joints: Mapping[str, XmlElement], findings: Findings
) -> None:
    """Note what makes joints follow each other for a simulator alone: joints that have their own
    <mimic> are known.
    """
    for element in block.walk():
        if element.tag not in MOTION and _FOLLOWS.search(element.tag):
            reported = [n for n in _named(element) if n in joints]
            if not reported or any(not joints[n].of("mimic") for n in reported):
                said = (
                    f"<{element.tag}> in a <gazebo> block is not "
                    f"read{f': {reported[0]!r}' if reported else ''}"
                )
                findings.note(f"{said}; there joints follow each other", "", element.where)


def _note_ties(block: XmlElement, names: Collection[str], findings: Findings) -> None:
    """Note what ties links or joints for a simulator alone, such as MuJoCo's <equality>: each tie
    once.
    """
    seen: set[int] = set()
    for element in block.walk():
        local = element.tag.rpartition(":")[2]
        if id(element) in seen or element is block or not _TIES.search(local.lower()):
            continue
        seen |= {id(part) for part in element.walk()}
        tied = [n for n in _named(element) if n in names]
        if tied:
            shown = " and ".join(map(repr, dict.fromkeys(tied[:4])))
            said = (
                f"<{element.tag}> in a <{block.tag}> block is not read{_speaks_of(element)}; there "
                f"it ties {shown}"
            )
            findings.note(said, "", element.where)


def _check_inside(outer: XmlElement, findings: Findings) -> None:
    """Refuse definitions of links, joints and followers deeper than they are read; note them in
    <gazebo> blocks.
    """
    joint = outer.tag == "joint"
    holders = [c for c in outer.children if c.children] if joint or outer.tag == "link" else [outer]
    for holder in holders:  # what stands directly in a link or joint is judged with it
        for element in holder.children:
            if joint or element.tag in MOTION or ":" in element.tag:
                _judge_inside(outer, holder, element, findings)
            if element.children:
                holders.append(element)


def _judge_inside(
    outer: XmlElement, holder: XmlElement, element: XmlElement, findings: Findings
) -> None:
    local = element.tag.rpartition(":")[2]
    joint = outer.tag == "joint"
    defines = local in MOTION and (joint or _defines(element, local))
    urdf = (
        local in MOTION and local not in _ELSEWHERE.get(holder.tag, ()) and _in_urdf_form(element)
    )
    if not (defines or joint or urdf):
        return
    subject = (
        f"{outer.tag} {outer.attributes['name']!r}"
        if outer.attributes.get("name")
        else f"<{outer.tag}>"
    )
    said = f"<{element.tag}> inside <{holder.tag}> is not read{_speaks_of(element)}"
    if defines and outer.tag != "gazebo":
        findings.add(said, subject, element.where, MOTION[local])
    elif joint or urdf:
        findings.note(said, subject, element.where)


def _held(element: XmlElement) -> set[str]:
    """Names of its children, without prefixes."""
    return {child.tag.rpartition(":")[2] for child in element.children}


def _defines(element: XmlElement, local: str) -> bool:
    """Whether an element says what a link or joint is, rather than naming one."""
    if local == "joint":
        return _held(element) >= {"parent", "child"}
    if local == "link":
        return bool(_held(element) & {"inertial", "visual", "collision"})
    return local == "mimic" and "joint" in element.attributes


def _in_urdf_form(element: XmlElement) -> bool:
    """Whether an element has what URDF writes in attributes, where SDF in <gazebo> blocks has
    elements.
    """
    return any(key in element.attributes for key in _NOT_READ if key not in ("name", "type"))


def _named(element: XmlElement) -> Iterator[str]:
    """Values of all attributes, and all texts between tags, of an element and those below it."""
    for part in element.walk():
        yield from part.attributes.values()
    yield from (text.strip() for text in _CONTENT.findall(element.text))


def _speaks_of(element: XmlElement) -> str:
    """The tail of a message: what an element that is not read says, as far as that fits into a
    line.
    """
    said = [
        f"{p.tag.rpartition(':')[2]} {k}={shorten(v, 30)}"
        if p is not element
        else f"{k}={shorten(v, 30)}"
        for p in element.walk()
        for k, v in p.attributes.items()
        if not k.startswith("xmlns") and p.tag not in ("mass", "inertia", "mesh", "material")
    ]
    return f" ({', '.join(said[:5])}{', ...' if len(said) > 5 else ''})" if said else ""
