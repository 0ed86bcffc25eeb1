"""SRDF, MoveIt's file beside a URDF: groups, postures, end effectors, base joint, ignored pairs."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from graphlib import CycleError, TopologicalSorter

from kempe.description.formats import describe_root_fault
from kempe.description.mechanism import Mechanism, find_path_joints
from kempe.description.parts import Coupling, Joint
from kempe.description.source import Findings, find_intended_name, make_error, shorten_text
from kempe.description.urdf_elements import read_numbers
from kempe.description.xacro import XACRO_ADVICE
from kempe.description.xml import XmlElement, parse_xml
from kempe.errors import Where
from kempe.words import format_count, join_first_words

ELEMENTS = (
    "group",
    "group_state",
    "end_effector",
    "virtual_joint",
    "passive_joint",
    "disable_collisions",
    "disable_default_collisions",
    "enable_collisions",
)
"""Elements that are read; others are noted."""

BASES = {"fixed": "fixed", "floating": "free", "planar": "planar"}
"""Types of virtual joints, and the types of the zoo that they are."""

ORDERS = {
    "free": ("x", "y", "z", "qx", "qy", "qz", "qw"),
    "planar": ("x", "y", "rz"),
    "spherical": ("qx", "qy", "qz", "qw"),
}
"""Order in which the values of a joint with several coordinates are given, as MoveIt has it."""

ROOT_JOINT = "root_joint"
"""Pinocchio's name of the joint by which a free base moves, in SRDFs without a virtual joint."""

IN_GROUP = ("joint", "link", "chain", "group")
MOST = 1_000_000
"""Joints in all groups together, and pairs of links, at most."""
FEW = 5
"""Names that a note lists where all of them can be read in another place."""
MANY = 50
"""Names that a note lists of joints, links and groups that the robot does not have."""
CLOSE = 1e-6
"""Difference from the value of a coordinate that is followed, below which rounding explains it."""


@dataclass(frozen=True)
class VirtualJoint:
    """Joint that moves the root link of a robot: its name, its type and its ground."""

    name: str
    kind: str
    ground: str


def read_srdf(text: str | bytes, source: str) -> Srdf:
    """Return an SRDF to be applied to the mechanism of its robot; `source` names it in messages.

    Errors: `DescriptionError` where it is no SRDF.
    """
    findings = Findings()
    root = parse_xml(text, source, findings)
    if root.tag != "robot":
        raise make_error(
            describe_root_fault(root.tag),
            root.location,
            "SRDF starts with <robot name=...>",
        )
    for element in root.iterate_elements():
        if element.tag.startswith("xacro:"):
            raise make_error(
                f"this is xacro, a program that writes SRDF: <{element.tag}> has to be expanded "
                "first",
                element.location,
                XACRO_ADVICE,
            )
    if links := root.find_children("link"):
        raise make_error(
            "this is no SRDF, but a URDF: it has links",
            links[0].location,
            "give the file of the robot first, and its SRDF by srdf=(...)",
        )
    return Srdf(root, findings)


class Srdf:
    """Content of an SRDF: the motion of the robot's base, and additions to its mechanism.

    Many an SRDF is written for several variants of a robot. Names that the given one does not have
    are noted, and what they stand in is left out; a file of which no name fits is refused.
    """

    def __init__(self, root: XmlElement, findings: Findings):
        self.root = root
        self.findings = findings
        self.has_known_name = False
        self.absent: dict[tuple[str, str], dict[str, Where]] = {}
        """Names that the robot does not have, with their places, by subject and kind."""

    # ---- the base

    def find_virtual_joint(self, link: str) -> VirtualJoint | None:
        """Return the virtual joint of the robot's root link; None where there is none."""
        found: VirtualJoint | None = None
        for element in self.root.find_children("virtual_joint"):
            name = self._read_name(element, "virtual_joint")
            subject = f"virtual_joint {name!r}"
            given = self._read_attributes(element, subject, "type", "parent_frame", "child_link")
            if name is None or given is None:
                continue
            kind, ground, child = given
            if kind not in BASES:
                said = f"unknown type {shorten_text(kind)}{self.findings.suggest_name(kind, BASES)}"
                self.findings.add_problem(said, subject, element.locate_attribute("type"))
            elif child != link:
                self.findings.add_note(
                    f"it is not used: its child link {shorten_text(child)} is not {link!r}, the root of "
                    "the robot",
                    subject,
                    element.locate_attribute("child_link"),
                )
            elif found:
                self.findings.add_note(
                    f"it is not used: {found.name!r} holds the root already",
                    subject,
                    element.location,
                )
            else:
                found = VirtualJoint(name, BASES[kind], ground)
        return found

    def has_joint_value(self, joint: str) -> bool:
        """Whether a posture gives values of a joint with this name."""
        states = self.root.find_children("group_state")
        return any(
            c.attributes.get("name") == joint
            for state in states
            for c in state.find_children("joint")
        )

    # ---- what is added to a mechanism

    def apply_to_mechanism(self, mechanism: Mechanism) -> None:
        """Add groups, postures, end effectors, passive joints and ignored pairs.

        Errors: `DescriptionError` with all problems of the SRDF.
        """
        self._check_names(mechanism)
        self._declare_groups(mechanism)
        self._declare_postures(mechanism)
        for element in self.root.find_children("passive_joint"):
            name = self._read_known_name(
                element, "name", mechanism.joints, "joint", "passive_joint"
            )
            if name is not None:
                mechanism.joints[name] = replace(mechanism.joints[name], actuated=False)
        for element in self.root.find_children("end_effector"):
            self._add_end_effector(mechanism, element)
        self._ignore_pairs(mechanism)
        self._note_absent_names(mechanism)
        self.findings.raise_problems()
        mechanism.notes += self.findings.notes

    def _check_names(self, mechanism: Mechanism) -> None:
        """Note where the SRDF names another robot than the mechanism, and check its elements."""
        given = self.root.attributes.get("name", "").strip()
        if given and given != mechanism.name:
            said = (
                f"it is written for the robot {shorten_text(given)}, and this is {mechanism.name!r}"
            )
            self.findings.add_note(said, "", self.root.locate_attribute("name"))
        seen: dict[str, XmlElement] = {}
        for element in self.root.children:
            if element.tag not in ELEMENTS:
                seen.setdefault(element.tag, element)
        for element in seen.values():
            self._check_unknown_element(element, ELEMENTS, "")

    # ---- groups

    def _declare_groups(self, mechanism: Mechanism) -> None:
        """Declare all groups, each after the groups that are parts of it."""
        elements: dict[str, XmlElement] = {}
        for element in self.root.find_children("group"):
            name = self._read_name(element, "group")
            if name in elements:
                said = f"there is another group of this name, at {elements[name].location}"
                self.findings.add_problem(
                    said, f"group {name!r}", element.location, "names must be unique"
                )
            elif name is not None:
                elements[name] = element
        parts = {
            name: self._list_parts(name, element, elements) for name, element in elements.items()
        }
        try:
            order = [*TopologicalSorter(parts).static_order()]
        except CycleError as error:
            cycle: list[str] = error.args[1][::-1]
            shown = " holds ".join(map(repr, cycle[:FEW]))
            where = elements[cycle[0]].location
            self.findings.add_problem(f"it holds itself: {shown}", f"group {cycle[0]!r}", where)
            return
        found = {name: self._list_joints(name, elements[name], mechanism) for name in order}
        total = 0
        for name in order:
            for part in parts[name]:
                found[name] |= found[part]
            total += len(found[name])
            if total > MOST:
                said = f"with it the groups hold more than {MOST} joints"
                self.findings.add_problem(said, f"group {name!r}", elements[name].location)
                return
        for name in elements:  # in the order of the file
            if not found[name]:
                self.findings.add_note(
                    "it holds no joint", f"group {name!r}", elements[name].location
                )
            mechanism.group(name, [joint for joint in mechanism.joints if joint in found[name]])

    def _list_parts(self, name: str, element: XmlElement, elements: Collection[str]) -> list[str]:
        """Return the names of the groups that are parts of a group."""
        subject = f"group {name!r}"
        for child in element.children:
            if child.tag not in IN_GROUP:
                self._check_unknown_element(child, IN_GROUP, subject)
        known = [
            self._read_known_name(child, "name", elements, "group", subject)
            for child in element.find_children("group")
        ]
        return [part for part in known if part is not None]

    def _list_joints(self, name: str, element: XmlElement, mechanism: Mechanism) -> set[str]:
        """Return the joints of a group without the joints of its parts."""
        subject = f"group {name!r}"
        found: set[str] = set()
        for child in element.find_children("joint"):
            if joint := self._read_known_name(child, "name", mechanism.joints, "joint", subject):
                found.add(joint)
        for child in element.find_children("link"):
            if link := self._read_known_name(child, "name", mechanism.bodies, "link", subject):
                above = [j for j in mechanism.joints.values() if j.child == link]
                found.update(j.name for j in sorted(above, key=lambda j: j.cut)[:1])
        for child in element.find_children("chain"):
            ends = [
                self._read_known_name(child, key, mechanism.bodies, "link", subject)
                for key in ("base_link", "tip_link")
            ]
            if None not in ends:
                with self.findings.record_errors(subject, child.location):
                    found.update(j.name for j in find_path_joints(mechanism, *ends))  # type: ignore[arg-type]
        return found

    # ---- postures

    def _declare_postures(self, mechanism: Mechanism) -> None:
        """Declare the states of groups as postures, such as "arm/home"."""
        for element in self.root.find_children("group_state"):
            name = self._read_name(element, "group_state")
            subject = f"group_state {name!r}"
            group = element.attributes.get("group")
            if group is None:
                said = "it names no group: the posture has its name without a group before it"
                self.findings.add_note(said, subject, element.location)
            else:
                self._read_known_name(element, "group", mechanism.groups, "group", subject)
            if name is None:
                continue
            posture = f"{group}/{name}" if group else name
            if posture in mechanism.postures:
                said = f"there is another posture {posture!r}"
                self.findings.add_problem(said, subject, element.location, "names must be unique")
                continue
            values = self._read_state(mechanism, element, f"posture {posture!r}")
            if values or not element.find_children("joint"):
                mechanism.posture(posture, values)
            else:
                said = "it is left out: the robot has none of its coordinates"
                self.findings.add_note(said, f"posture {posture!r}", element.location)

    def _read_state(
        self, mechanism: Mechanism, element: XmlElement, subject: str
    ) -> dict[str, float]:
        """Return the values of a posture by coordinate name."""
        values: dict[str, float] = {}
        joints: list[str] = []
        for child in element.children:
            if child.tag != "joint":
                self._check_unknown_element(child, ("joint",), subject)
                continue
            name = child.attributes.get("name")
            if name == ROOT_JOINT and name not in mechanism.joints:
                said = f"the value of {ROOT_JOINT!r} is not used: base='free' lets the root move"
                self.findings.add_note(said, subject, child.location)
            elif joint := self._read_known_name(child, "name", mechanism.joints, "joint", subject):
                joints.append(joint)
                values |= self._read_joint_values(
                    mechanism, mechanism.joints[joint], child, subject
                )
        group = mechanism.groups.get(element.attributes.get("group", ""), tuple(joints))
        if other := [joint for joint in joints if joint not in group]:
            names = join_first_words([*map(repr, other)], FEW)
            said = f"{format_count(len(other), 'joint')} not in the group: {names}"
            self.findings.add_note(said, subject, element.location)
        self._drop_followers(mechanism, values, subject, element)
        return values

    def _read_joint_values(
        self, mechanism: Mechanism, joint: Joint, element: XmlElement, subject: str
    ) -> dict[str, float]:
        """Return the values of a joint by the names of its coordinates."""
        names = joint.type.list_coordinate_names(
            mechanism.dim, mechanism.bodies[joint.child].particle
        )
        order = ORDERS.get(joint.type.type_name, names)
        if not names:
            said = f"joint {joint.name!r} does not move: its value is not used"
            self.findings.add_note(said, subject, element.location)
            return {}
        if "value" not in element.attributes:
            self.findings.add_problem(
                f"joint {joint.name!r} has no value", subject, element.location
            )
            return {}
        found = read_numbers(element, "value", len(order), self.findings, subject)
        return {
            f"{joint.name}.{name}" if name else joint.name: x
            for name, x in zip(order, found or (), strict=False)
        }

    def _drop_followers(
        self, mechanism: Mechanism, values: dict[str, float], subject: str, element: XmlElement
    ) -> None:
        """Remove values of followers that contradict their leaders, with a note."""
        for name in [name for name in values if name in mechanism.couplings]:
            needed = _evaluate_coupling(mechanism.couplings[name], values)
            if needed is not None and abs(needed - values[name]) > CLOSE:
                said = (
                    f"the value {values[name]:g} of {name!r} is not used: it follows "
                    f"{', '.join(mechanism.couplings[name].sources)}, which makes it {needed:g}"
                )
                self.findings.add_note(said, subject, element.location)
                del values[name]

    # ---- end effectors and pairs

    def _add_end_effector(self, mechanism: Mechanism, element: XmlElement) -> None:
        """Add a frame with the name of the end effector to its parent link."""
        name = self._read_name(element, "end_effector")
        subject = f"end_effector {name!r}"
        link = self._read_known_name(element, "parent_link", mechanism.bodies, "link", subject)
        for key in ("group", "parent_group"):
            group = element.attributes.get(key, "")
            if group and group not in mechanism.groups:
                said = f"there is no group {shorten_text(group)}"
                hint = self.findings.suggest_name(group, mechanism.groups)
                self.findings.add_note(f"{said}{hint}", subject, element.locate_attribute(key))
        if name is None or link is None:
            return
        if name in mechanism.bodies or name in mechanism.frames:
            what = "link" if name in mechanism.bodies else "frame"
            said = f"it gets no frame of its own: a {what} has its name; it is on {link!r}"
            self.findings.add_note(said, subject, element.location)
            return
        with self.findings.record_errors(subject, element.location):
            mechanism.frame(name, link, where=element.location)

    def _ignore_pairs(self, mechanism: Mechanism) -> None:
        """Declare the pairs of links that are not checked for collisions."""
        without = {
            link
            for element in self.root.find_children("disable_default_collisions")
            if (
                link := self._read_known_name(
                    element, "link", mechanism.bodies, "link", element.tag
                )
            )
        }
        if len(without) * len(mechanism.bodies) > MOST:
            where = self.root.find_children("disable_default_collisions")[0].location
            self.findings.add_problem(f"it disables more than {MOST} pairs", "robot", where)
            return
        every = ((a, b) for a in without for b in mechanism.bodies if a != b)
        ignored = {frozenset(pair): "Default" for pair in every}
        for tag in ("enable_collisions", "disable_collisions"):
            for element in self.root.find_children(tag):
                ends = self._read_attributes(element, f"<{tag}>", "link1", "link2")
                if ends is None:
                    continue
                known = [
                    self._read_known_name(element, key, mechanism.bodies, "link", f"<{tag}>")
                    for key in ("link1", "link2")
                ]
                if None in known:
                    continue
                if ends[0] == ends[1]:
                    said = f"both links are {ends[0]!r}"
                    self.findings.add_problem(
                        said, f"<{tag}>", element.location, "a pair has two links"
                    )
                elif tag == "enable_collisions":
                    ignored.pop(frozenset(ends), None)
                else:
                    ignored[frozenset(ends)] = element.attributes.get("reason", "")
        for pair, reason in ignored.items():
            mechanism.ignore_pair(*pair, reason=reason)

    # ---- names

    def _check_unknown_element(
        self, element: XmlElement, known: tuple[str, ...], subject: str
    ) -> None:
        """Record a problem for a misspelled element, and a note for any other unknown one."""
        tag = element.tag
        if near := find_intended_name(tag[:60], known):
            said = f"unknown element {shorten_text(tag)}; did you mean {near!r}?"
            self.findings.add_problem(said, subject, element.location)
        else:
            self.findings.add_note(
                f"the element {shorten_text(tag)} is not read", subject, element.location
            )

    def _read_name(self, element: XmlElement, subject: str) -> str | None:
        """Return the name of an element; None after recording that it has none."""
        name = element.attributes.get("name", "")
        if name.strip():
            return name
        self.findings.add_problem("it has no name", f"<{subject}>", element.location, "write name=")
        return None

    def _read_attributes(self, element: XmlElement, subject: str, *keys: str) -> list[str] | None:
        """Return the values of attributes; None after recording which are missing."""
        missing = [key for key in keys if not element.attributes.get(key)]
        for key in missing:
            self.findings.add_problem(
                f"it has no {key}", subject, element.location, f"write {key}="
            )
        return None if missing else [element.attributes[key] for key in keys]

    def _read_known_name(
        self, element: XmlElement, key: str, known: Collection[str], kind: str, subject: str
    ) -> str | None:
        """Return the name in an attribute; None after recording that nothing has this name."""
        given = self._read_attributes(element, subject, key)
        if given is None:
            return None
        if given[0] in known:
            self.has_known_name |= kind != "group"
            return given[0]
        where = element.locate_attribute(key)
        self.absent.setdefault((subject, kind), {}).setdefault(given[0], where)
        return None

    def _note_absent_names(self, mechanism: Mechanism) -> None:
        """Note which names the robot does not have; refuse the file where it has none."""
        tables = {
            "joint": mechanism.joints,
            "link": mechanism.bodies,
            "group": mechanism.groups,
        }
        needed = [(*key, names) for key, names in self.absent.items() if key[1] != "group"]
        if needed and not self.has_known_name:
            subject, kind, names = needed[0]
            name, where = next(iter(names.items()))
            self.findings.add_problem(
                f"there is no {kind} {shorten_text(name)}, nor any other joint or link that the "
                f"SRDF names{self.findings.suggest_name(name, tables[kind])}",
                subject,
                where,
                f"give the SRDF of the robot {mechanism.name!r}",
            )
        for (subject, kind), names in self.absent.items():
            name, where = next(iter(names.items()))
            if len(names) > 1:
                listed = join_first_words([*map(shorten_text, names)], MANY)
                said = f"{len(names)} {kind}s that the robot does not have are left out: {listed}"
            else:
                hint = self.findings.suggest_name(name, tables[kind])
                said = f"{kind} {shorten_text(name)} is left out: the robot does not have it{hint}"
            self.findings.add_note(said, subject, where)


def _evaluate_coupling(coupling: Coupling, values: dict[str, float]) -> float | None:
    """Return the value of a follower from the values of its leaders; None where one has no value."""
    if any(name not in values for name in coupling.sources):
        return None
    terms = [factor * values[name] for name, factor in coupling.sources.items()]
    total = sum(terms, coupling.offset)
    return total if isinstance(total, (int, float)) else None
