"""Reader of SDF text: a model, or a world with models, placed as Gazebo and Drake place them.

Refusals name the line in the file.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.description.formats import describe_root_fault
from kempe.description.mechanism import Mechanism
from kempe.description.parts import Joint
from kempe.description.sdf_elements import (
    NEWEST,
    TYPES,
    Axis,
    Version,
    check_known_children,
    find_first_child,
    get_child_text,
    parse_truth,
    read_axis,
    read_inertial,
    read_mimic,
    read_number,
    read_numbers,
    read_version,
)
from kempe.description.sdf_scopes import GROUND, Files, Scope, list_gazebo_folders
from kempe.description.sdf_shapes import collect_unread_shapes, note_unread_shapes, read_shapes
from kempe.description.source import (
    Findings,
    choose_numbered_name,
    list_folders,
    make_error,
    shorten_text,
)
from kempe.description.xml import XmlElement, parse_xml
from kempe.errors import InputError, UnknownNameError
from kempe.poses import Placement, place
from kempe.spatial import Array
from kempe.words import choose_verb, format_count, join_first_words

ORTHOGONAL = 1e-9
"""Cosine up to which two axes are orthogonal."""
PARALLEL = 1e-6
"""How far two unit vectors may be apart and still be one axis of a gearbox."""


def read_sdf(
    text: str | bytes,
    source: str = "<text>",
    *,
    base: str | None = None,
    model: str | None = None,
    lenient_limits: bool = False,
    package_dirs: Iterable[str | Path] = (),
) -> Mechanism:
    """Return the mechanism of an SDF text: its model, or all models of its world.

    The ground is called 'world'.

    Bodies and joints are named as the outermost model names them: 'link', 'nested::link'; in a
    world 'model::link'. `model` reads only the model of this name. What nothing ties to the ground
    is held where the file places it, by a fixed joint called 'base'; ``base="free"`` makes this a
    free joint, so that at its zero the bodies are where the file places them; static models are
    always held. Two joints that lead to one link are a loop. `lenient_limits` reads a lower limit
    above the upper one as none. Included models lie in the file's folder and in `package_dirs`.
    What was noticed but changes nothing is in `notes` of the mechanism. Errors: `DescriptionError`
    with all problems; `UnknownNameError` for a `model` that is not there.
    """
    if base not in (None, "free"):
        raise InputError(
            f"base is {base!r}; it must be None (what nothing ties to the ground is held) or 'free'"
        )
    findings = Findings()
    sdf = parse_xml(text, source, findings)
    _check_is_sdf(sdf)
    version = read_version(sdf, findings)
    check_known_children(sdf, findings, "sdf")
    roots = (*list_folders(package_dirs), *list_gazebo_folders())
    home = Path(source).parent if source != "<text>" and Path(source).is_file() else None
    files = Files(roots, findings)
    outer = _open_outermost_scope(sdf, model, version, home, files)
    mechanism = Mechanism(outer.name or "sdf", ground=GROUND)
    _Reader(outer, mechanism, findings, lenient_limits, home).fill_mechanism(base == "free")
    findings.raise_problems()
    mechanism.notes = list(dict.fromkeys(findings.notes))
    mechanism.roots = tuple(map(str, roots))
    return mechanism


def _check_is_sdf(sdf: XmlElement) -> None:
    """Raise `DescriptionError` if the outermost element is not <sdf>."""
    if sdf.tag == "sdf":
        return
    raise make_error(
        describe_root_fault(sdf.tag),
        sdf.location,
        f"SDF starts with <sdf version='{NEWEST[0]}.{NEWEST[1]}'>",
    )


def _open_outermost_scope(
    sdf: XmlElement, model: str | None, version: Version, home: Path | None, files: Files
) -> Scope:
    """Return the scope of the model or world that is read."""
    worlds = sdf.find_children("world")
    models = {m.attributes.get("name", "").strip(): m for m in sdf.find_children("model")}
    if model is None and len(worlds) + len(sdf.find_children("model")) > 1:
        raise make_error(
            f"the file has {format_count(len(worlds), 'world')} and "
            f"{format_count(len(sdf.find_children('model')), 'model')}",
            (worlds + sdf.find_children("model"))[1].location,
            f"choose one by model=: {join_first_words([repr(n) for n in models], 8)}"
            if models
            else "a file has one of them",
        )
    if not worlds and not models:
        raise make_error(
            "there is no model in this file",
            sdf.location,
            "SDF has a <model> or a <world> with models directly in <sdf>",
        )
    if model is None or model in models:
        element = models[model] if model is not None else (worlds + sdf.find_children("model"))[0]
        name = element.attributes.get("name", "").strip()
        scope = Scope(element, name, None, version, home, files)
        scope.scan_elements()
        return scope
    known = [*models]
    for element in worlds:
        world = Scope(element, element.attributes.get("name", ""), None, version, home, files)
        world.scan_elements(only=model)
        if model in world.models:
            return world.models[model]
        inside = [*element.find_children("model"), *element.find_children("include")]
        known += [m.attributes.get("name", "") or get_child_text(m, "name") for m in inside]
    files.findings.raise_problems()
    raise UnknownNameError("model", model, [n for n in known if n], sdf.source.name)


# ---- the mechanism


class _Ends(NamedTuple):
    """Bodies that a joint connects, and the placement of the joint's frame on each of them."""

    parent: str
    child: str
    X_PJ: Placement
    X_CJ: Placement


@dataclass
class _Reader:
    """Reader that fills a mechanism from the scopes of a file."""

    outer: Scope
    mechanism: Mechanism
    findings: Findings
    lenient: bool
    home: Path | None
    """The folder of the outermost file."""
    links: dict[str, tuple[Scope, str]] = field(default_factory=dict[str, tuple[Scope, str]])
    """Scope and name of the link of each body."""
    coordinates: dict[tuple[str, str], str] = field(default_factory=dict[tuple[str, str], str])
    """The coordinate of each axis, by the joint and 'axis' or 'axis2'."""
    followers: list[tuple[Scope, str, str, XmlElement]] = field(
        default_factory=list[tuple[Scope, str, str, XmlElement]]
    )
    """Scope, joint and axis that has a <mimic>."""
    others: dict[str, list[XmlElement]] = field(default_factory=dict[str, list[XmlElement]])
    """Shapes of kinds that are not read."""

    def fill_mechanism(self, free: bool) -> None:
        """Add all links, joints and frames of the file to the mechanism.

        With `free`, free joints carry what nothing ties to the ground, else fixed ones do.
        """
        scopes = [*self.outer.iterate_scopes()]
        for scope in scopes:
            for name, element in scope.links.items():
                self._read_link(scope, name, element)
        if not self.links and not self.findings.problems:
            raise make_error(
                "there is no link in this file",
                self.outer.element.location,
                "a model has at least one <link name=...>",
            )
        gearboxes: list[tuple[Scope, str, XmlElement]] = []
        for scope in scopes:
            if scope.static and scope.joints:
                said = "the model is static: its joints do not move"
                self.findings.add_note(said, scope.subject, scope.element.location)
            for name, element in scope.joints.items():
                if element.attributes.get("type", "").strip().lower() == "gearbox":
                    gearboxes.append((scope, name, element))
                elif not scope.static:
                    self._read_joint(scope, name, element)
            self._read_drake_elements(scope)
        for scope, name, element in gearboxes:
            self._read_gearbox(scope, name, element)
        for scope, joint, axis, element in self.followers:
            self._read_follower(scope, joint, axis, element)
        self._connect_to_ground(free)
        note_unread_shapes(self.others, self.findings)
        for scope in scopes:
            for name, element in scope.frames.items():
                self._read_frame(scope, name, element)

    def _read_link(self, scope: Scope, name: str, element: XmlElement) -> None:
        """Add a link with its shapes as a body."""
        subject = scope.describe_part("link", name)
        check_known_children(element, self.findings, subject)
        mass, center = read_inertial(element, self.findings, subject)
        full = scope.prefix + name
        scope.compute_world_pose(name)

        def place_shape(frame: str, at: XmlElement) -> Placement | None:
            """Return the placement of a frame on the link."""
            if scope.find_frame(frame) is None:
                scope.record_unknown_name(
                    "relative_to", frame, at.locate_attribute("relative_to"), subject
                )
                return None
            return self._place_frame(scope, frame, (scope, name), name)

        with self.findings.record_errors(subject, element.location):
            self.mechanism.body(full, mass, center, where=element.location)
            self.links[full] = scope, name
        folder = self._find_folder(scope)
        for shape in read_shapes(element, subject, place_shape, folder, self.findings):
            with self.findings.record_errors(subject, shape.where):
                self.mechanism.shape(
                    full,
                    shape.geometry,
                    at=shape.X_BS,
                    visual=shape.visual,
                    collision=shape.collision,
                    color=shape.color,
                    name=shape.name,
                    where=shape.where,
                )
        collect_unread_shapes(element, self.others)

    def _find_folder(self, scope: Scope) -> str:
        """Return the folder of a scope's file, relative to the folder of the outermost file."""
        if scope.folder is None or self.home is None:
            return ""
        return Path(os.path.relpath(scope.folder.resolve(), self.home.resolve())).as_posix()

    def _read_frame(self, scope: Scope, name: str, element: XmlElement) -> None:
        """Add a frame of a scope to the mechanism."""
        subject = scope.describe_part("frame", name)
        check_known_children(element, self.findings, subject)
        found = scope.find_link(name, element.location, subject)
        if found is None:
            return
        body, link = self._name_body(found)
        full = scope.prefix + name
        if full in self.mechanism.bodies:
            full = choose_numbered_name(
                f"{full}_frame", {**self.mechanism.bodies, **self.mechanism.frames}
            )
            self.findings.add_note(
                f"a link has its name; it is called {full!r}", subject, element.location
            )
        with self.findings.record_errors(subject, element.location):
            X = self._place_frame(scope, name, found, link)
            self.mechanism.frame(full, body, at=X, where=element.location)

    def _name_body(self, found: tuple[Scope, str]) -> tuple[str, str]:
        """Return the name of a body in the mechanism, and of its link in its scope."""
        scope, link = found
        return (scope.prefix + link, link) if link else (GROUND, GROUND)

    def _place_frame(
        self, scope: Scope, name: str, found: tuple[Scope, str], link: str
    ) -> Placement:
        """Return the placement of a frame of a scope on a link, or on the ground."""
        key = scope.find_frame(name)
        if found[0] is scope and key is not None and link != GROUND:
            exact = scope.find_relative_placement(key, link)
            if exact is not None:
                return exact
            back = scope.find_relative_placement(link, key)
            if back is not None:
                return back.invert_steps()
        X_W = scope.compute_world_pose(name)
        return place(
            X_W if link == GROUND else spatial.inverse(found[0].compute_world_pose(link)) @ X_W
        )

    # joints

    def _read_joint(self, scope: Scope, name: str, element: XmlElement) -> None:
        """Add a joint of the file to the mechanism."""
        findings = self.findings
        subject = scope.describe_part("joint", name)
        check_known_children(element, findings, subject, ("drake:mimic",))
        kind = element.attributes.get("type", "").strip().lower()
        if kind not in TYPES:
            given = element.attributes.get("type")
            said = findings.suggest_name(kind, TYPES) if given else ""
            wrong = (
                "it has no type" if given is None else f"unknown type {shorten_text(given)}{said}"
            )
            allowed = "" if "did you mean" in said else f"SDF has {', '.join(TYPES)}"
            findings.add_problem(wrong, subject, element.locate_attribute("type"), allowed)
        ends = self._read_ends(scope, name, element, subject)
        axes = self._read_axes(scope, element, kind, subject)
        if kind not in TYPES or ends is None or axes is None:
            return
        with findings.record_errors(subject, element.location):
            made = self._make_joints(scope, name, element, kind, ends, axes)
            for tag in axes:
                mimic = axes[tag].mimic
                if mimic is not None:
                    self.followers.append((scope, name, tag, mimic))
            for mimic in element.find_children("drake:mimic")[:1]:
                self.followers.append((scope, name, "axis", mimic))
            names = [f"{j.name}.{c}" if c else j.name for j in made for c in _list_coordinates(j)]
            if kind not in ("ball", "fixed"):
                for tag, coordinate in zip(("axis", "axis2"), names, strict=False):
                    self.coordinates[scope.prefix + name, tag] = coordinate

    def _read_ends(
        self, scope: Scope, name: str, element: XmlElement, subject: str
    ) -> _Ends | None:
        """Return the two bodies of a joint with the placements of its frame; None after a problem."""
        found: list[tuple[Scope, str]] = []
        for tag in ("parent", "child"):
            end = self._read_end(scope, element, tag, subject)
            if end is not None:
                found.append(end)
        if len(found) < 2:
            return None
        (parent, P), (child, C) = map(self._name_body, found)
        if parent == child:
            self.findings.add_problem(
                f"it connects {parent!r} to itself",
                subject,
                element.location,
                "it must connect two links",
            )
            return None
        X_PJ, X_CJ = (
            self._place_frame(scope, name, end, link)
            for end, link in zip(found, (P, C), strict=True)
        )
        return _Ends(parent, child, X_PJ, X_CJ)

    def _read_end(
        self, scope: Scope, element: XmlElement, tag: str, subject: str
    ) -> tuple[Scope, str] | None:
        """Return the link that an end of a joint names, or whose frame it names; None if wrong."""
        holder = find_first_child(element, tag)
        given = get_child_text(element, tag) if holder is not None else ""
        if holder is None or not given:
            self.findings.add_problem(
                f"it has no <{tag}>",
                subject,
                holder.location if holder is not None else element.location,
                "a joint names its parent and its child",
            )
            return None
        where = holder.content_location
        if given == GROUND and tag == "parent":
            return scope, ""
        if given == GROUND:
            self.findings.add_problem(
                "its child is the world", subject, where, "the world can only be the parent"
            )
            return None
        if scope.find_frame(given) is None:
            scope.record_unknown_name(f"its {tag}", given, where, subject)
            return None
        return scope.find_link(given, where, subject)

    def _read_axes(
        self, scope: Scope, element: XmlElement, kind: str, subject: str
    ) -> dict[str, Axis] | None:
        """Return the axes of a joint in its own frame; None after recording a problem."""
        needed = {"universal": 2, "revolute2": 2, "gearbox": 2, "fixed": 0, "ball": 0}.get(kind, 1)
        out: dict[str, Axis] = {}
        before = len(self.findings.problems)
        for count, tag in enumerate(("axis", "axis2"), 1):
            given = find_first_child(element, tag)
            if given is None and count <= needed:
                said = f"a {kind} joint has no <{tag}>"
                allowed = f"write <{tag}><xyz>0 0 1</xyz></{tag}>, for example"
                self.findings.add_problem(said, subject, element.location, allowed)
            if given is None:
                continue
            axis = read_axis(given, scope.version, self.findings, subject, self.lenient)
            if count > needed and kind in TYPES:
                if kind != "fixed":
                    said = f"a {kind} joint does not read its <{tag}>"
                    self.findings.add_note(said, subject, given.location)
                continue
            if axis is not None and axis.expressed_in:
                where = axis.where or given.location
                if scope.find_frame(axis.expressed_in) is None:
                    scope.record_unknown_name("expressed_in", axis.expressed_in, where, subject)
                else:
                    axis.xyz = self._turn_axis(scope, element, axis)
            if axis is not None:
                out[tag] = axis
        return out if len(self.findings.problems) == before else None

    def _turn_axis(self, scope: Scope, element: XmlElement, axis: Axis) -> tuple[float, ...]:
        """Return the direction (3,) of an axis in its joint's frame."""
        R_ME = scope.compute_pose(axis.expressed_in)[:3, :3]
        R_MJ = scope.compute_pose(element.attributes["name"].strip())[:3, :3]
        return tuple((R_MJ.T @ (R_ME @ np.array(axis.xyz))).tolist())

    def _make_joints(
        self,
        scope: Scope,
        name: str,
        element: XmlElement,
        kind: str,
        ends: _Ends,
        axes: dict[str, Axis],
    ) -> list[Joint]:
        """Return the new joints for a joint of the file: one, or two in series."""
        full = scope.prefix + name
        options: dict[str, Any] = {
            "where": element.location,
            "cut": self._is_cut_joint(element, full),
        }
        if kind in ("universal", "revolute2"):
            return self._make_universal_joint(full, ends, axes, options)
        at: dict[str, Any] = {"at": ends.X_PJ, "child_at": ends.X_CJ}
        if "axis" in axes:
            options |= axes["axis"].keywords
            at["axis"] = axes["axis"].xyz
        if kind == "continuous":
            if options.pop("limits", None):
                said = (
                    "a continuous joint turns without end: its lower and upper limit are not used"
                )
                self.findings.add_note(said, f"joint {full!r}", element.location)
        if kind == "screw":
            options["pitch"] = self._read_pitch(element, f"joint {full!r}")
        types = {"continuous": "revolute", "ball": "spherical", "screw": "helical"}
        type_ = types.get(kind, kind)
        return [self.mechanism.joint(full, type_, ends.parent, ends.child, **at, **options)]

    def _is_cut_joint(self, element: XmlElement, full: str) -> bool:
        """Whether the file marks the joint as the cut joint of a loop."""
        simbody = find_first_child(find_first_child(element, "physics"), "simbody")
        cut = find_first_child(simbody, "must_be_loop_joint")
        if cut is None:
            return False
        said = "must_be_loop_joint"
        return parse_truth(
            cut.content, cut.content_location, self.findings, f"joint {full!r}", said
        )

    def _read_pitch(self, element: XmlElement, subject: str) -> float:
        """Return the pitch of a screw joint in m/rad.

        <screw_thread_pitch> is in metres for each turn, the older <thread_pitch> in radians for
        each metre of a left-handed thread.
        """
        per_turn = read_number(element, "screw_thread_pitch", 1.0, self.findings, subject)
        if find_first_child(element, "screw_thread_pitch") is None and find_first_child(
            element, "thread_pitch"
        ):
            per_metre = read_number(element, "thread_pitch", 1.0, self.findings, subject)
            if per_metre == 0.0:
                where = element.find_children("thread_pitch")[0].content_location
                said = "thread_pitch is 0, radians a metre"
                self.findings.add_problem(said, subject, where, "it must not be zero")
            return -1.0 / per_metre if per_metre else 1.0
        return (per_turn or 0.0) / (2.0 * np.pi)

    def _make_universal_joint(
        self, full: str, ends: _Ends, axes: dict[str, Axis], options: dict[str, Any]
    ) -> list[Joint]:
        """Return a universal joint, or two revolute joints where the axes are not orthogonal."""
        a, b = (spatial.unit(axes[tag].xyz) for tag in ("axis", "axis2"))
        m = self.mechanism
        if abs(a @ b) > ORTHOGONAL:
            cross = m.body(choose_numbered_name(f"{full}_cross", m.bodies), where=options["where"])
            one, two = (axes[tag] for tag in ("axis", "axis2"))
            uncut: dict[str, Any] = {**options, "cut": False}
            return [
                m.revolute(
                    choose_numbered_name(f"{full}_axis", m.joints),
                    ends.parent,
                    cross,
                    at=ends.X_PJ,
                    axis=one.xyz,
                    **one.keywords,
                    **options,
                ),
                m.revolute(
                    choose_numbered_name(f"{full}_axis2", m.joints),
                    cross,
                    ends.child,
                    child_at=ends.X_CJ,
                    axis=two.xyz,
                    **two.keywords,
                    **uncut,
                ),
            ]
        b = spatial.unit(b - (a @ b) * a)
        turn = place(matrix=np.column_stack([a, b, np.cross(a, b)]))
        for key in ("limits", "velocity", "effort"):
            given = {c: axes[tag].keywords.get(key) for c, tag in (("rx", "axis"), ("ry", "axis2"))}
            options[key] = {c: x for c, x in given.items() if x is not None}
        at = {"at": ends.X_PJ @ turn, "child_at": ends.X_CJ @ turn}
        return [m.universal(full, ends.parent, ends.child, **at, **options)]

    # coordinates that follow others

    def _read_follower(self, scope: Scope, joint: str, axis: str, element: XmlElement) -> None:
        """Add the coupling that a <mimic> describes."""
        subject = scope.describe_part("joint", joint)
        mimic = read_mimic(element, self.findings, subject)
        if mimic is None:
            return
        of = self.coordinates.get((scope.prefix + joint, axis))
        leader = self.coordinates.get((scope.prefix + mimic.joint, mimic.axis))
        if leader is None:
            said = self.findings.suggest_name(mimic.joint, scope.joints, but=joint)
            known = mimic.joint in scope.joints
            self.findings.add_problem(
                f"it mimics {mimic.axis} of joint {shorten_text(mimic.joint)}, which has no such axis"
                if known
                else f"it mimics joint {shorten_text(mimic.joint)}, which does not exist{said}",
                subject,
                mimic.where,
                "joints with an axis can mimic each other" if known else "",
            )
        elif of is not None:
            with self.findings.record_errors(subject, mimic.where):
                self.mechanism.couple(
                    of, {leader: mimic.multiplier}, mimic.offset, where=mimic.where
                )

    def _read_gearbox(self, scope: Scope, name: str, element: XmlElement) -> None:
        """Add the coupling of a gearbox.

        It couples the joints that lead from its reference body to its parent and its child.
        """
        findings = self.findings
        subject = scope.describe_part("joint", name)
        check_known_children(element, findings, subject)
        before = len(findings.problems)
        ratio = read_number(element, "gearbox_ratio", 1.0, findings, subject)
        axes = self._read_axes(scope, element, "gearbox", subject)
        ends = [
            self._read_end(scope, element, tag, subject)
            for tag in ("gearbox_reference_body", "parent", "child")
        ]
        if len(findings.problems) > before or axes is None or ratio is None or None in ends:
            return
        reference, parent, child = (self._name_body(end)[0] for end in ends if end is not None)
        R_WJ = scope.compute_world_pose(name)[:3, :3]
        turns: list[tuple[str, float]] = []
        for link, tag in ((parent, "axis"), (child, "axis2")):
            turn = self._find_gear_joint(reference, link, R_WJ @ spatial.unit(axes[tag].xyz))
            if turn is not None:
                turns.append(turn)
                continue
            findings.add_problem(
                f"no revolute joint about its axis leads from {reference!r} to {link!r}",
                subject,
                element.location,
                "a gearbox couples two joints that connect its reference body to its parent and "
                "to its child",
            )
        if len(turns) == 2:
            (leader, sense), (of, other) = turns
            with findings.record_errors(subject, element.location):
                factor = -ratio * sense * other
                self.mechanism.couple(of, {leader: factor}, where=element.location)

    def _find_gear_joint(self, reference: str, link: str, axis: Array) -> tuple[str, float] | None:
        """Return the revolute joint between two bodies about an axis (3,), and its sense.

        The sense is 1.0 where the joint turns the link about this axis as the reference sees it,
        else -1.0.
        """
        for joint in self.mechanism.joints.values():
            if joint.type.type_name != "revolute" or {joint.parent, joint.child} != {
                reference,
                link,
            }:
                continue
            z = (self._compute_body_pose(joint.parent) @ joint.X_PF.evaluate_pose({}))[:3, 2]
            sense = 1.0 if joint.child == link else -1.0
            for sign in (1.0, -1.0):
                if np.abs(z - sign * axis).max() < PARALLEL:
                    return joint.name, sign * sense
        return None

    def _compute_body_pose(self, body: str) -> Array:
        """Return the pose (4, 4) at which the file places a body in the world."""
        if body == GROUND:
            return np.eye(4)
        scope, link = self.links[body]
        return scope.compute_world_pose(link)

    # Drake's own elements

    def _read_drake_elements(self, scope: Scope) -> None:
        """Add the joints and constraints of a model that only Drake reads."""
        for element in scope.element.children if not scope.is_world else ():
            name = element.attributes.get("name", "").strip()
            if element.tag == "drake:joint" and not scope.static:
                self._read_drake_joint(scope, name, element)
            elif element.tag in ("drake:ball_constraint", "drake:distance_constraint"):
                self._read_drake_constraint(scope, element)

    def _read_drake_joint(self, scope: Scope, name: str, element: XmlElement) -> None:
        """Add a planar joint of Drake."""
        subject = scope.describe_part("joint", name)
        kind = element.attributes.get("type", "")
        if kind != "planar" or not name:
            self.findings.add_problem(
                f"<drake:joint> of type {shorten_text(kind)} is not read"
                if name
                else "it has no name",
                subject,
                element.location,
                "planar ones are" if name else "every joint needs a name of its own",
            )
            return
        found = [
            self._read_end(scope, element, f"drake:{tag}", subject) for tag in ("parent", "child")
        ]
        if found[0] is None or found[1] is None:
            return
        (parent, P), (child, C) = (self._name_body(end) for end in found if end is not None)
        X = [
            self._place_frame(scope, get_child_text(element, f"drake:{tag}"), end, link)
            for tag, end, link in zip(("parent", "child"), found, (P, C), strict=True)
            if end is not None
        ]
        with self.findings.record_errors(subject, element.location):
            self.mechanism.planar(
                scope.prefix + name, parent, child, at=X[0], child_at=X[1], where=element.location
            )

    def _read_drake_constraint(self, scope: Scope, element: XmlElement) -> None:
        """Add a constraint of Drake: coincident points, or points at a fixed distance."""
        kind = element.tag.removeprefix("drake:")
        subject = f"<{element.tag}>"
        before = len(self.findings.problems)
        if kind == "distance_constraint" and find_first_child(element, f"{element.tag}_stiffness"):
            said = "it is a spring, which holds nothing: it is not read"
            self.findings.add_note(said, subject, element.location)
            return
        ends = [
            self._read_end(scope, element, f"{element.tag}_body_{letter}", subject)
            for letter in "AB"
        ]
        points: list[tuple[float, ...]] = []
        for tag in (f"{element.tag}_p_AP", f"{element.tag}_p_BQ"):
            given = find_first_child(element, tag)
            if given is None:
                self.findings.add_problem(
                    f"it has no <{tag}>", subject, element.location, "give the point"
                )
            else:
                points.append(read_numbers(given, 3, self.findings, subject) or ())
        length = read_number(element, f"{element.tag}_distance", 0.0, self.findings, subject)
        if len(self.findings.problems) > before or None in ends:
            return
        a, b = (self._name_body(end)[0] for end in ends if end is not None)
        m = self.mechanism
        name = choose_numbered_name(scope.prefix + kind, {**m.joints, **m.constraints})
        with self.findings.record_errors(subject, element.location):
            at: dict[str, Any] = {"at": points[0], "child_at": points[1], "where": element.location}
            if kind == "ball_constraint":
                m.spherical(name, a, b, **at)
            else:
                m.distance(name, a, b, length or 0.0, **at)

    # what nothing ties to the ground

    def _connect_to_ground(self, free: bool) -> None:
        """Connect bodies that no joint connects to the ground by fixed or free joints."""
        parts = _Parts(self.mechanism)
        children = {j.child for j in self.mechanism.joints.values()}
        first_ones = [
            b for b in map(self._find_canonical_body, self.outer.iterate_scopes()) if b is not None
        ]
        everything = [*first_ones, *self.links]
        held: list[str] = []
        for static in (True, False):
            for body in [b for b in everything if b not in children] + everything:
                scope, _ = self.links[body]
                if scope.static >= static and not parts.are_connected(body, GROUND):
                    self._tie_body(scope, body, free and not static)
                    parts.connect_bodies(body, GROUND)
                    held += [body] * (not static)
        if held and not free:
            names = join_first_words([repr(n) for n in held], 8)
            self.findings.add_note(
                f"nothing ties {names} to the world: held where the file places "
                f"{choose_verb(len(held), 'it, while it moves', 'them, while they move')} freely "
                "in Gazebo and Drake; base='free' reads it so",
                where=self.outer.element.location,
            )

    def _find_canonical_body(self, scope: Scope) -> str | None:
        """Return the body that moves with the own frame of a model; None for a world."""
        if scope.is_world or scope.canonical_link is None:
            return None
        found = scope.find_link(scope.canonical_link, scope.element.location, scope.subject)
        body = self._name_body(found)[0] if found is not None else None
        return body if body in self.links else None

    def _tie_body(self, scope: Scope, body: str, free: bool) -> None:
        """Connect a body to the ground by a free or a fixed joint."""
        m = self.mechanism
        name = choose_numbered_name(f"{scope.prefix}base", {**m.joints, **m.constraints})
        m.joint(
            name, "free" if free else "fixed", GROUND, body, at=place(self._compute_body_pose(body))
        )


class _Parts:
    """Connected components of the bodies, by union and find."""

    def __init__(self, mechanism: Mechanism):
        self._next: dict[str, str] = {}
        for joint in mechanism.joints.values():
            self.connect_bodies(joint.parent, joint.child)

    def _find_representative(self, body: str) -> str:
        """Return the body that represents the component of a body."""
        path: list[str] = []
        while body in self._next:
            path.append(body)
            body = self._next[body]
        for other in path:
            self._next[other] = body
        return body

    def are_connected(self, a: str, b: str) -> bool:
        """Whether joints lead from one body to the other."""
        return self._find_representative(a) == self._find_representative(b)

    def connect_bodies(self, a: str, b: str) -> None:
        """Join the components of two bodies."""
        one, two = self._find_representative(a), self._find_representative(b)
        if one != two:
            self._next[one] = two


def _list_coordinates(joint: Joint) -> Iterator[str]:
    """Iterate over the names of the coordinates within a joint."""
    yield from joint.type.list_coordinate_names(3, False)
