"""Reader of URDF text; what affects the motion is read exactly, or refused.

Refusals name the line in the file.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from kempe.description.formats import describe_root_fault, join_words
from kempe.description.mechanism import Mechanism, number_components
from kempe.description.parts import Body
from kempe.description.source import (
    Findings,
    choose_numbered_name,
    list_folders,
    make_error,
    shorten_text,
)
from kempe.description.srdf import ROOT_JOINT, Srdf, VirtualJoint
from kempe.description.urdf_elements import (
    ATTRIBUTES,
    check_robot_children,
    check_version,
    has_quaternions,
    read_joint,
    read_link,
    read_numbers,
    strip_namespaces,
)
from kempe.description.urdf_loops import read_loops
from kempe.description.urdf_shapes import read_materials, read_shapes
from kempe.description.xacro import XACRO_ADVICE
from kempe.description.xml import XmlElement, parse_xml
from kempe.errors import InputError, UnknownNameError
from kempe.words import format_count

# ---- the graph of links

# Who is joined to whom, for readers and writers of tree-shaped formats; without recursion, for any
# size.


def choose_root(
    links: Mapping[str, XmlElement],
    ends: Mapping[str, tuple[str, str]],
    findings: Findings,
    root: str | None,
) -> str | None:
    """Return the name of the link that is the ground; None after recording why there is none.

    `ends` are (parent, child) of each joint. The root is the only link that is nobody's child, or
    `root`. Links that no joint connects to it are a problem.
    """
    if not links:
        return None
    children = {child for _, child in ends.values()}
    roots = [root] if root is not None else [n for n in links if n not in children]
    parts = number_components(links, ends.values())
    if not roots:
        cycle = find_cycle(links, ends)
        shown = " -> ".join(map(repr, cycle))
        allowed = f"name the link that does not move, with root={cycle[0]!r}"
        message = f"no link is the root, since each is the child of a joint: {shown}"
        findings.add_problem(message, "robot", links[cycle[0]].location, allowed)
        return None
    if len(roots) > 1:
        listed = _format_links(roots, links)
        separate = len({parts[n] for n in roots}) > 1
        cure = (
            "join them by joints (type fixed where they do not move)"
            if separate
            else f"choose with root={roots[0]!r}"
        )
        findings.add_problem(
            f"{len(roots)} links are nobody's child: {listed}",
            "robot",
            links[roots[1]].location,
            f"one link must be the root; {cure}",
        )
        return None
    detached = [n for n in links if parts[n] != parts[roots[0]]]
    if detached:
        message = f"no joints lead from the root {roots[0]!r} to {_format_links(detached, links)}"
        findings.add_problem(
            message, "robot", links[detached[0]].location, "join them by joints, or remove them"
        )
        return None
    return roots[0]


def _format_links(names: list[str], links: Mapping[str, XmlElement]) -> str:
    """Return names of links with their lines as text."""
    shown = ", ".join(f"{n!r} (line {links[n].location.line})" for n in names[:8])
    return shown + (f", ... ({len(names)} in all)" if len(names) > 8 else "")


def find_cycle(bodies: Iterable[str], ends: Mapping[str, tuple[str, str]]) -> list[str]:
    """Return a cycle of bodies, its first repeated at the end.

    Every body must be the child of a joint.
    """
    parent: dict[str, str] = {}
    for a, b in ends.values():
        parent.setdefault(b, a)
    here = next(iter(bodies))
    seen: dict[str, None] = {}
    while here not in seen:
        seen[here] = None
        here = parent[here]
    path = list(seen)
    cycle = path[path.index(here) :][::-1]
    first = min(range(len(cycle)), key=lambda i: cycle[i])
    cycle = cycle[first:] + cycle[:first]
    return [*cycle, cycle[0]] if len(cycle) <= 10 else [*cycle[:9], "...", cycle[0]]


def find_reachable_bodies(start: str, ends: Iterable[tuple[str, str]]) -> set[str]:
    """Return the bodies that joints reach from `start`, from parent to child only."""
    children: dict[str, list[str]] = {}
    for a, b in ends:
        children.setdefault(a, []).append(b)
    reached = {start}
    queue = deque([start])
    while queue:
        for there in children.get(queue.popleft(), ()):
            if there not in reached:
                reached.add(there)
                queue.append(there)
    return reached


# ---- the reader

TYPES = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
    "floating": "free",
    "planar": "planar",
    "spherical": "spherical",
}
"""URDF's joint types and the types of the zoo that they are. "spherical" is not of ROS, but of
MuJoCo and Bullet."""

DRAKE_TYPES = {
    "ball": "spherical",
    "planar": "planar",
    "screw": "helical",
    "universal": "universal",
}
"""Types of <drake:joint>, and the types of the zoo that they are."""

ALL_TYPES = {**TYPES, **DRAKE_TYPES}

DRAKE_JOINT = "drake:joint"
"""The element of Drake for joints of its own types."""

WORLD = "world"
"""A link that a file need not have: for some readers, such as Drake and Simbody, it is the ground
of all models."""

_XACRO = re.compile(r"\$\{|\$\(")
_MARKS = ("<xacro:", "${", "$(")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_GENERATED = re.compile(r"autogenerated by xacro from\s+(\S+)")


@dataclass
class _Urdf:
    """Content of a file while it is read: elements by name, and findings."""

    robot: XmlElement
    lenient: bool = False
    findings: Findings = field(default_factory=Findings)
    links: dict[str, XmlElement] = field(default_factory=dict[str, XmlElement])
    joints: dict[str, XmlElement] = field(default_factory=dict[str, XmlElement])
    ends: dict[str, tuple[str, str]] = field(default_factory=dict[str, tuple[str, str]])
    types: dict[str, str] = field(default_factory=dict[str, str])
    of_drake: set[XmlElement] = field(default_factory=set[XmlElement])
    """Joints that were written as <drake:joint>, which become <joint>."""

    @cached_property
    def quaternions(self) -> bool:
        """Whether the version of the file has `quat_xyzw`."""
        return has_quaternions(self.robot)


def read_urdf(
    text: str | bytes,
    source: str = "<text>",
    *,
    base: str | None = None,
    root: str | None = None,
    package_dirs: Iterable[str | Path] = (),
    beside: Iterable[str] = (),
    lenient_limits: bool = False,
    srdf: Srdf | None = None,
) -> Mechanism:
    """Return the mechanism of a URDF text; its root link becomes the ground.

    `source` names the text in messages. ``base="free"`` puts a ground called 'world' under the root
    link and joins them by a free joint called 'base'. `root` names the link to take as root where
    the file leaves it open. `package_dirs` are the folders in which meshes may lie, `beside` the
    names of other files to suggest, `srdf` what is added, see `kempe.description.srdf`. Two joints
    that lead to one link are a loop. `lenient_limits`
    reads limits that hold no range as none: a <limit> without lower and upper (else 0 to 0, as URDF
    has it), and lower above upper (else refused); and negative limits of velocity and effort. What
    was noticed but changes nothing is in `notes` of the mechanism. Errors: `DescriptionError` with
    all problems; `UnknownNameError` for a `root` that is no link.
    """
    if base not in (None, "free"):
        raise InputError(
            f"base is {base!r}; it must be None (the root link does not move) or 'free'"
        )
    findings = Findings()
    robot = parse_xml(text, source, findings)
    strip_namespaces(robot)
    _check_is_urdf(robot)
    _refuse_xacro(robot)
    urdf = _Urdf(robot, bool(lenient_limits), findings)
    check_version(robot, urdf.findings)
    _scan_links_and_joints(urdf)
    if not urdf.links and not urdf.findings.problems:
        raise _make_no_links_error(robot, tuple(beside))
    if root is not None and root not in urdf.links:
        raise UnknownNameError("link", root, urdf.links, source)
    _scan_joints(urdf)
    # where a joint's ends are wrong, links that look detached may not be
    sound = len(urdf.ends) == len(robot.find_children("joint"))
    ground = choose_root(urdf.links, urdf.ends, urdf.findings if sound else Findings(), root)
    mechanism = _build_mechanism(urdf, ground, _choose_base(ground, base, srdf))
    _note_unused_blocks(urdf)
    urdf.findings.raise_problems()
    mechanism.notes = urdf.findings.notes
    mechanism.roots = tuple(map(str, list_folders(package_dirs)))
    if srdf is not None:
        srdf.apply_to_mechanism(mechanism)
    return mechanism


def _choose_base(ground: str | None, base: str | None, srdf: Srdf | None) -> VirtualJoint | None:
    """Return the joint that moves the root link, from the option `base` and an SRDF.

    None: the root link is the ground.
    """
    found = srdf.find_virtual_joint(ground) if srdf is not None and ground is not None else None
    if base is None:
        return found
    if found is not None and found.kind != base:
        raise InputError(
            f"base is {base!r}, but the virtual joint {found.name!r} of the SRDF is {found.kind}; "
            "leave base out"
        )
    named = srdf is not None and srdf.has_joint_value(ROOT_JOINT)
    return found or VirtualJoint(ROOT_JOINT if named else "base", base, WORLD)


# ---- is it URDF at all


def _check_is_urdf(robot: XmlElement) -> None:
    """Raise `DescriptionError` if the outermost element is not <robot>."""
    if robot.tag == "robot":
        return
    raise make_error(
        describe_root_fault(robot.tag),
        robot.location,
        "URDF starts with <robot name=...>",
    )


def _has_xacro_marks(text: str) -> bool:
    """Whether a text may be xacro."""
    return any(mark in text for mark in _MARKS)


def _refuse_xacro(robot: XmlElement) -> None:
    """Refuse text that must be expanded first: xacro elements, or expressions for names or numbers."""
    text = robot.source.text
    if not _has_xacro_marks(text) or not _has_xacro_marks(_COMMENT.sub("", text)):
        return
    for element in robot.iterate_elements():
        found = where = None
        if element.tag.startswith("xacro:"):
            found = f"<{element.tag}>"
            where = element.location
        elif element.tag in (*ATTRIBUTES, "link", "robot"):
            for key, text in element.attributes.items():
                if not key.startswith("xmlns") and _XACRO.search(text):
                    found = f"{key}={shorten_text(text)}"
                    where = element.locate_attribute(key)
                    break
        if found and where:
            raise make_error(
                f"this is xacro, a program that writes URDF: {found} has to be expanded first",
                where,
                XACRO_ADVICE,
            )


_SRDF = {
    "group",
    "group_state",
    "end_effector",
    "virtual_joint",
    "passive_joint",
    "disable_collisions",
    "enable_collisions",
    "disable_default_collisions",
    "link_sphere_approximation",
    "joint_property",
}
"""Elements that MoveIt's semantic descriptions have in the outermost one, named <robot> as in
URDF."""


def _make_no_links_error(robot: XmlElement, beside: tuple[str, ...]) -> Exception:
    """Return the error for a robot without links."""
    generated = _GENERATED.search(robot.source.text)
    joints = len(robot.find_children("joint"))
    if found := sorted({e.tag for e in robot.children} & _SRDF):
        parts = join_words([f"<{tag}>" for tag in found], "and")
        return make_error(
            f"this is an SRDF: groups, postures and pairs of links ({parts}), but no links or "
            "joints",
            robot.location,
            "load the URDF of the robot that it belongs to, with this file as srdf=(...)",
        )
    holds = (
        f"only {format_count(joints, 'joint')}"
        if joints
        else "nothing but an empty <robot> element"
    )
    message = (
        f"there is no robot in this file: it holds {holds}, and without a <link> there is no body "
        "to move"
    )
    allowed = "a robot has at least one <link name=...> and a <joint> for each further link"
    if generated:
        stem = generated[1].split(".")[0]
        allowed = (
            f"its header says that xacro made it from {generated[1]!r}, which probably only "
            "defines macros: expand the file that calls them (often "
            f"{stem + '_robot.urdf.xacro'!r})"
        )
    if beside:
        allowed += f", or load another file of the same folder: {', '.join(sorted(beside)[:8])}"
    return make_error(message, robot.location, allowed)


# ---- names and connections


def _scan_links_and_joints(urdf: _Urdf) -> None:
    """Fill `links` and `joints` with elements that have unique, non-empty names."""
    findings = urdf.findings
    if not urdf.robot.attributes.get("name", "").strip():
        findings.add_note("the robot has no name", where=urdf.robot.location)
    for element in urdf.robot.find_children(DRAKE_JOINT):
        urdf.of_drake.add(element)
        element.tag = "joint"
    for element in urdf.robot.children:
        if element.tag not in ("link", "joint"):
            continue
        table = urdf.links if element.tag == "link" else urdf.joints
        name = element.attributes.get("name")
        if name is None or not name.strip():
            what = "has no name" if name is None else "has an empty name"
            where = element.location if name is None else element.locate_attribute("name")
            findings.add_problem(
                f"a {element.tag} {what}",
                where=where,
                allowed="every link and joint needs a name of its own",
            )
        elif name in table:
            message = f"there is another {element.tag} of this name, at {table[name].location}"
            findings.add_problem(
                message,
                f"{element.tag} {name!r}",
                element.locate_attribute("name"),
                "names must be unique",
            )
        else:
            table[name] = element
    check_robot_children(urdf.robot, urdf.links, urdf.joints, findings)


def _scan_joints(urdf: _Urdf) -> None:
    """Fill `types` and `ends` (parent and child) of the joints where these are valid."""
    findings = urdf.findings
    _add_world_link(urdf)
    for name, element in urdf.joints.items():
        subject = f"joint {name!r}"
        _scan_type(urdf, name, element, subject)
        ends = [_read_end(urdf, element, tag, subject) for tag in ("parent", "child")]
        if None in ends:
            continue
        if ends[0] == ends[1]:
            findings.add_problem(
                f"it connects link {ends[0]!r} to itself",
                subject,
                element.find_children("child")[0].location,
                "it must connect two links",
            )
            continue
        urdf.ends[name] = (ends[0], ends[1])  # type: ignore[assignment]


def _scan_type(urdf: _Urdf, name: str, element: XmlElement, subject: str) -> None:
    """Fill `types` with the type of a joint if it is known."""
    given = element.attributes.get("type")
    known = DRAKE_TYPES if element in urdf.of_drake else TYPES
    if given not in known:
        said = urdf.findings.suggest_name(given, known) if given else ""
        wrong = "it has no type" if given is None else f"unknown type {shorten_text(given)}{said}"
        allowed = f"URDF has {', '.join(TYPES)} (TOML has more)"
        if known is DRAKE_TYPES:
            allowed = f"a <{DRAKE_JOINT}> has {', '.join(known)}, a <joint> has the others"
        elif given in DRAKE_TYPES:
            said = ""
            wrong = f"unknown type {given!r}"
            allowed = f"it is a type of Drake: write <{DRAKE_JOINT}>"
        urdf.findings.add_problem(
            wrong,
            subject,
            element.locate_attribute("type"),
            "" if "did you mean" in said else allowed,
        )
        return
    urdf.types[name] = given
    said = {
        "spherical": "'spherical' is a type of MuJoCo and Bullet; ROS refuses it",
        "ball": "its coordinates are a unit quaternion; Drake has roll, pitch and yaw for it",
    }.get(given)
    if said:
        urdf.findings.add_note(said, subject, element.location)


def _add_world_link(urdf: _Urdf) -> None:
    """Add the link 'world' where a joint has this parent, in any letter case, and no link the name."""
    if any(name.casefold() == WORLD for name in urdf.links):
        return
    for name, joint in urdf.joints.items():
        for parent in joint.find_children("parent")[:1]:
            if parent.attributes.get("link") == WORLD:
                urdf.links[WORLD] = parent
                said = (
                    f"its parent link {WORLD!r} is not in the file; it is taken for the ground, as "
                    "Drake takes it"
                )
                urdf.findings.add_note(said, f"joint {name!r}", parent.location)
                return


def _read_end(urdf: _Urdf, joint: XmlElement, tag: str, subject: str) -> str | None:
    """Return the link that an end of a joint names; None after recording a problem."""
    element = (joint.find_children(tag) or [None])[0]
    link = element.attributes.get("link") if element is not None else None
    if element is None or not link:
        where = element.location if element is not None else joint.location
        urdf.findings.add_problem(
            f"it has no <{tag} link=...>",
            subject,
            where,
            "a joint names its parent and its child link",
        )
        return None
    if link not in urdf.links:
        urdf.findings.add_problem(
            f"its {tag} link {shorten_text(link)} does not exist{urdf.findings.suggest_name(link, urdf.links)}",
            subject,
            element.locate_attribute("link"),
        )
        return None
    return link


# ---- the mechanism


def _build_mechanism(urdf: _Urdf, ground: str | None, base: VirtualJoint | None) -> Mechanism:
    """Return the mechanism of all valid elements; problems of the others are recorded."""
    name = urdf.robot.attributes.get("name", "").strip() or "robot"
    bodies = _read_bodies(urdf)
    root = ground if ground is not None else next(iter(bodies), "ground")
    mechanism = Mechanism(name, ground=choose_numbered_name(base.ground, bodies) if base else root)
    for link, body in bodies.items():
        if link == mechanism.ground.name:
            mechanism.bodies[link] = body
        else:
            mechanism._add_body(body)
    if base:
        name = choose_numbered_name(base.name, urdf.joints)
        mechanism.joint(name, base.kind, mechanism.ground, root)
    for joint, element in urdf.joints.items():
        kind = urdf.types.get(joint, "fixed")
        settings = read_joint(kind, joint, element, urdf.findings, urdf.quaternions, urdf.lenient)
        if joint in urdf.ends and joint in urdf.types and settings is not None:
            unstated = settings.pop("unstated", False)
            with urdf.findings.record_errors(f"joint {joint!r}", element.location):
                made = mechanism.joint(
                    joint, ALL_TYPES[kind], *urdf.ends[joint], where=element.location, **settings
                )
                mechanism.joints[joint] = replace(made, unstated=True) if unstated else made
    _add_mimics(urdf, mechanism)
    read_loops(urdf.robot, mechanism, urdf.findings)
    return mechanism


def _read_bodies(urdf: _Urdf) -> dict[str, Body]:
    """Return the bodies of all links with their shapes, by name."""
    materials = read_materials(urdf.robot, urdf.findings)
    out: dict[str, Body] = {}
    for name, element in urdf.links.items():
        shapes = read_shapes(element, name, materials, urdf.findings, urdf.quaternions)
        out[name] = read_link(name, element, urdf.findings, shapes)
    return out


# ---- mimic joints


def _add_mimics(urdf: _Urdf, mechanism: Mechanism) -> None:
    """Add the couplings of joints with a <mimic>."""
    findings = urdf.findings
    follows: dict[str, tuple[str, XmlElement]] = {}
    for name, element in urdf.joints.items():
        mimic = (element.find_children("mimic") or [None])[0]
        subject = f"joint {name!r}"
        if mimic is None:
            continue
        leader = mimic.attributes.get("joint")
        if not leader:
            findings.add_problem(
                "its <mimic> names no joint", subject, mimic.location, "write <mimic joint=.../>"
            )
            continue
        factor, offset = (
            read_numbers(mimic, key, 1, findings, subject)
            if key in mimic.attributes
            else (default,)
            for key, default in (("multiplier", 1.0), ("offset", 0.0))
        )
        if leader not in urdf.joints:
            said = findings.suggest_name(leader, urdf.joints, but=name)
            message = f"it mimics joint {shorten_text(leader)}, which does not exist{said}"
            findings.add_problem(message, subject, mimic.locate_attribute("joint"))
        elif urdf.types.get(name) == "fixed":
            findings.add_note(
                "a fixed joint does not move: its <mimic> is not used", subject, mimic.location
            )
        elif _has_one_coordinate(urdf, name, leader, subject, mimic):
            follows[name] = (leader, mimic)
            if factor and offset:
                with findings.record_errors(subject, mimic.location):
                    mechanism.couple(name, {leader: factor[0]}, offset[0], where=mimic.location)
                if {name, leader} <= mechanism.joints.keys() and name in mechanism.couplings:
                    _note_blocked_leader(mechanism, name, leader, (factor[0], offset[0]), findings)
    _refuse_cycles(follows, findings)


def _note_blocked_leader(
    m: Mechanism, name: str, leader: str, law: tuple[float, float], findings: Findings
) -> None:
    """Note a follower whose limits leave a single value to the joint that it follows.

    `law` is the multiplier and the offset by which it follows.
    """
    factor, offset = law
    own = m.joints[leader].limits.get("")
    limits = m.joints[name].limits.get("")
    if not factor or own is None or limits is None or own[0] == own[1] or limits[0] == limits[1]:
        return
    low, high = sorted((x - offset) / factor for x in limits)
    if max(low, own[0]) == min(high, own[1]):
        findings.add_note(
            f"its limits leave nothing but {max(low, own[0]) + 0.0:g} to {leader!r}, which it "
            f"follows by {factor:g}: neither of them can move",
            f"joint {name!r}",
            m.couplings[name].where,
        )


SEVERAL = ("planar", "floating", "spherical", "ball", "universal")
"""Types of joints with several coordinates."""


def _has_one_coordinate(
    urdf: _Urdf, name: str, leader: str, subject: str, mimic: XmlElement
) -> bool:
    """Return whether a follower and its leader have one coordinate each; record a problem if not."""
    for joint, role in ((name, "it"), (leader, f"joint {leader!r}")):
        kind = urdf.types.get(joint)
        if kind in ("fixed", *SEVERAL):
            has = "no coordinate" if kind == "fixed" else "several coordinates"
            urdf.findings.add_problem(
                f"it mimics joint {leader!r}, but {role} is {kind} and has {has}",
                subject,
                mimic.locate_attribute("joint"),
                "revolute, continuous and prismatic joints can mimic each other",
            )
            return False
    return True


def _refuse_cycles(follows: Mapping[str, tuple[str, XmlElement]], findings: Findings) -> None:
    """Record each cycle of joints that mimic each other, once."""
    done: set[str] = set()
    for start in follows:
        path: dict[str, None] = {}
        name = start
        while name in follows and name not in done and name not in path:
            path[name] = None
            name = follows[name][0]
        if name in path:
            order = list(path)
            cycle = [*order[order.index(name) :], name]
            shown = " mimics ".join(
                repr(n) for n in (cycle if len(cycle) < 12 else [*cycle[:10], "...", name])
            )
            findings.add_problem(
                f"it mimics itself: {shown}",
                f"joint {name!r}",
                follows[name][1].location,
                "one of them must be free",
            )
        done.update(path)


# ---- blocks that are not read


def _note_unused_blocks(urdf: _Urdf) -> None:
    """Note blocks about joints that are missing, and joints that only simulators know."""
    for block in urdf.robot.children:
        if block.tag not in ("transmission", "ros2_control", "gazebo"):
            continue
        for joint in block.iterate_elements():
            name = joint.attributes.get("name", "")
            if joint.tag != "joint":
                continue
            if block.tag == "gazebo" and joint.find_children("child"):
                urdf.findings.add_note(
                    "a joint inside a <gazebo> block is not read; if it closes a loop, give the "
                    "link a second <joint> or use TOML",
                    f"joint {name!r}",
                    joint.location,
                )
            elif name not in urdf.joints and block.tag != "gazebo":
                urdf.findings.add_note(
                    f"a <{block.tag}> speaks of joint {shorten_text(name)}, which does not exist",
                    where=joint.location,
                )
