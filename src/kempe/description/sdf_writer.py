"""Writer of SDF text; everything that SDF cannot hold is refused at once."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from kempe import spatial
from kempe.description.formats import SDF
from kempe.description.mechanism import Mechanism
from kempe.description.parts import Body, Joint, Shape
from kempe.description.sdf_scopes import GROUND, MODEL
from kempe.description.shapes import Mesh, list_size_names
from kempe.description.urdf_writer import UrdfWriter, reserve_name
from kempe.errors import InputError
from kempe.poses import Placement
from kempe.spatial import Array
from kempe.words import join_first_words

CLOSED = 1e-9
"""How far the two frames of a joint may be apart where all coordinates are zero."""

TYPES = {
    "revolute": "revolute",
    "prismatic": "prismatic",
    "helical": "screw",
    "universal": "universal",
    "spherical": "ball",
    "planar": "planar",
}
"""Types of joints that are written."""


def write_sdf(mechanism: Mechanism) -> str:
    """Return the SDF text of a mechanism; `read_sdf` gives all bodies and frames the same poses.

    The ground becomes a link that is fixed to the world, unless it is called 'world'. A joint that
    closes a loop is written where its two frames coincide while all coordinates are zero.
    Parameters are evaluated, locked joints become fixed ones. Errors: `DescriptionError` listing
    all that SDF cannot say, by `SDF.cannot` of `kempe.description.formats`.
    """
    return _SdfWriter(mechanism).write_text()


class _SdfWriter(UrdfWriter):
    """Writer of the links and joints of a mechanism as SDF."""

    format = SDF

    def write_text(self) -> str:
        """Return the text of the file."""
        m = self.m
        self.check_names()
        self.check_constraints()
        self.resolve_couplings()
        name = m.ground.name
        needed = name != GROUND or bool(m.ground.shapes or m.ground.mass is not None)
        needed |= any(f.body == name for f in m.frames.values())
        needed |= any(j.child == name for j in m.joints.values())
        self.ground = (reserve_name("world_link", self.links) if name == GROUND else name) * needed
        self.taken = self.links | self.joints
        self.placed: dict[str, Joint] = {}
        self.poses: dict[str, Array] = {name: np.eye(4)}
        self.place_bodies()
        self.seats = {
            j.name: [reserve_name(f"{j.name}_{end}", self.taken) for end in ("parent", "child")]
            for j in m.joints.values()
            if j.type.type_name == "planar" or (j.type.type_name == "free" and m.dim == 2)
        }
        self.seats = {k: v for k, v in self.seats.items() if not self.is_locked_joint(m.joints[k])}
        for body in m.bodies.values():
            if body is not m.ground or needed:
                self.write_body(body)
        if needed:
            joint = reserve_name(f"{self.ground}_fixed", self.taken)
            ends = f"<parent>{GROUND}</parent><child>{self.escape_text(self.ground)}</child>"
            self.lines.append(
                f"    <joint name={self.quote_text(joint)} type='fixed'>{ends}</joint>"
            )
        for joint in m.joints.values():
            self.write_joint(joint)
        for frame in m.frames.values():
            pose = self.format_pose(frame.X_BF, "", f"frame {frame.name!r}")
            on = self.quote_text(self.choose_link_name(frame.body))
            self.lines.append(
                f"    <frame name={self.quote_text(frame.name)} attached_to={on}>{pose}</frame>"
            )
        version = "1.11" if self.mimics else "1.9"
        head = f'<?xml version="1.0" encoding="utf-8"?>\n<sdf version="{version}">\n'
        named = self.quote_text(m.name)
        self.findings.raise_problems()
        return f"{head}  <model name={named}>\n" + "\n".join(self.lines) + "\n  </model>\n</sdf>\n"

    # ---- what must hold

    def check_names(self) -> None:
        """Refuse names that SDF reserves, and names that two parts share."""
        kinds = {"joint": self.m.joints, "frame": self.m.frames, "body": self.m.bodies}
        seen: dict[str, str] = {}
        for kind, parts in kinds.items():
            for name, part in parts.items():
                reserved = name == GROUND or (name.startswith("__") and name.endswith("__"))
                said = ""
                if "::" in name or (reserved and name != self.m.ground.name):
                    said = "SDF keeps such a name for itself"
                elif name in seen:
                    said = f"a {seen[name]} has its name, too"
                if said:
                    allowed = self.format.cannot["names of its own, and equal ones"]
                    self.findings.add_problem(said, f"{kind} {name!r}", part.where, allowed)
                seen[name] = kind

    def place_bodies(self) -> None:
        """Compute the poses of all bodies where all coordinates are zero."""
        around: dict[str, list[Joint]] = {b: [] for b in self.m.bodies}
        for joint in self.m.joints.values():
            around[joint.parent].append(joint)
            around[joint.child].append(joint)
        queue = deque(self.poses)
        while queue:
            here = queue.popleft()
            for joint in around[here]:
                there = joint.child if joint.parent == here else joint.parent
                if there in self.poses:
                    continue
                X_PC = (self.place_on_parent(joint) @ joint.X_CM.invert_steps()).evaluate_pose(
                    self.m.parameters
                )
                forward = joint.parent == here
                self.poses[there] = self.poses[here] @ (X_PC if forward else spatial.inverse(X_PC))
                self.placed[there] = joint
                queue.append(there)
        lost = [b for b in self.m.bodies if b not in self.poses]
        if lost:
            shown = join_first_words([*map(repr, lost)], 8)
            self.findings.add_problem(
                f"no joints lead from the ground to {shown}",
                "mechanism",
                self.m.bodies[lost[0]].where,
                self.format.cannot["bodies that no joint carries"],
            )

    def is_locked_joint(self, joint: Joint) -> bool:
        """Whether all coordinates of a joint are locked."""
        return all(c in self.held for c in self.list_coordinates(joint))

    def place_on_parent(self, joint: Joint) -> Placement:
        """Return the placement of frame M on the parent at zero or locked coordinates."""
        if self.is_locked_joint(joint):
            return joint.X_PF @ self.compute_locked_pose(joint, self.list_coordinates(joint))
        return joint.X_PF

    # ---- elements

    def escape_text(self, text: str) -> str:
        """Return a text for the place between two tags."""
        self.quote_text(text)
        return escape(text)

    def choose_link_name(self, body: str) -> str:
        """Return the name of a body in the file."""
        return body if body != self.m.ground.name else self.ground or GROUND

    def format_pose(self, X: Placement, relative: str, subject: str) -> str:
        """Return the element <pose> of a placement; '' for the identity without a reference frame."""
        try:
            origin = self.compute_origin(X)
        except FloatingPointError as error:
            self.findings.add_problem(str(error), subject, None, "check its parameters")
            return ""
        numbers = [*origin.xyz, *origin.rpy]
        if not any(numbers) and not relative:
            return ""
        of = f" relative_to={self.quote_text(relative)}" if relative else ""
        return f"<pose{of}>{_format_numbers(numbers)}</pose>"

    def write_body(self, body: Body) -> None:
        """Write the link of a body."""
        subject = f"body {body.name!r}"
        if body.particle:
            allowed = self.format.cannot["particles"]
            self.findings.add_problem("it is a particle", subject, body.where, allowed)
        inside: list[str] = []
        joint = self.placed.get(body.name)
        if joint is not None:
            forward = joint.child == body.name
            X = joint.X_CM.invert_steps() if forward else self.place_on_parent(joint).invert_steps()
            seat = joint.name
            if joint.name in self.seats:  # a joint of Drake is no frame of SDF
                seat = self.seats[joint.name][not forward]
            inside.append(self.format_pose(X, seat, subject))
        if body.mass is not None or body.center is not None:
            center = (
                f"<pose>{_format_numbers([*body.center, 0.0, 0.0, 0.0])}</pose>"
                if body.center
                else ""
            )
            inside.append(f"<inertial><mass>{(body.mass or 0.0)!r}</mass>{center}</inertial>")
        taken: dict[str, set[str]] = {"visual": set(), "collision": set()}
        for shape in body.shapes:
            inside += self.format_shapes(shape, taken, subject)
        name = self.quote_text(self.choose_link_name(body.name))
        self.lines.append(f"    <link name={name}>{''.join(inside)}</link>")

    def format_shapes(
        self, shape: Shape, taken: dict[str, set[str]], subject: str
    ) -> Iterator[str]:
        """Iterate over the elements <visual> and <collision> of a shape.

        `taken` are the names of the elements before.
        """
        pose = self.format_pose(shape.X_BS, "", subject)
        try:
            geometry = shape.geometry.evaluate_sizes(self.m.parameters)
        except InputError as error:
            self.findings.add_problem(str(error), subject, shape.where, "check its parameters")
            return
        sizes: dict[str, Any] = {
            n: getattr(geometry, n) for n in list_size_names(type(shape.geometry))
        }
        uri = (
            f"<uri>{self.escape_text(sizes.pop('path'))}</uri>"
            if isinstance(geometry, Mesh)
            else ""
        )
        inside = uri + "".join(
            f"<{n}>{_format_numbers(x if np.ndim(x) else [x])}</{n}>" for n, x in sizes.items()
        )
        inside = f"<geometry><{shape.kind}>{inside}</{shape.kind}></geometry>"
        for use, flag in (("visual", shape.visual), ("collision", shape.collision)):
            color = shape.color if use == "visual" else None
            said = _format_numbers(color or ())
            light = f"<ambient>{said}</ambient><diffuse>{said}</diffuse>"
            material = f"<material>{light}</material>" if color else ""
            if flag:
                name = self.quote_text(reserve_name(shape.name or use, taken[use]))
                yield f"<{use} name={name}>{pose}{inside}{material}</{use}>"

    # ---- joints

    def write_joint(self, joint: Joint) -> None:
        """Write a joint."""
        subject = f"joint {joint.name!r}"
        kind = "fixed" if self.is_fixed_joint(joint) else self.choose_sdf_type(joint)
        if kind is None:
            return
        on_child = joint.X_CM
        if self.placed.get(joint.child) is not joint and self.placed.get(joint.parent) is not joint:
            self.check_closed_joint(joint)
        if self.placed.get(joint.child) is joint:
            parent = self.choose_link_name(joint.parent)
            pose = self.format_pose(
                self.place_on_parent(joint), MODEL if parent == GROUND else parent, subject
            )
        else:
            pose = self.format_pose(on_child, self.choose_link_name(joint.child), subject)
        ends = [self.escape_text(self.choose_link_name(b)) for b in (joint.parent, joint.child)]
        if kind == "planar":
            self.write_planar_joint(joint, ends, subject)
            return
        inside = f"<parent>{ends[0]}</parent><child>{ends[1]}</child>{pose}"
        if kind == "screw":
            given: Any = joint.type.options["pitch"]
            pitch = 2.0 * math.pi * float(given)
            inside += f"<screw_thread_pitch>{pitch!r}</screw_thread_pitch>"
        axes = {"universal": {"rx": "1 0 0", "ry": "0 1 0"}, "fixed": {}, "ball": {}}
        for number, (name, xyz) in enumerate(axes.get(kind, {"": "0 0 1"}).items()):
            tag = f"axis{number + 1}" if number else "axis"
            inside += f"<{tag}><xyz>{xyz}</xyz>{self.format_axis_limit(joint, name)}</{tag}>"
        if joint.cut:
            inside += "<physics><simbody><must_be_loop_joint>true</must_be_loop_joint></simbody></physics>"
        self.lines.append(
            f"    <joint name={self.quote_text(joint.name)} type='{kind}'>{inside}</joint>"
        )

    def write_planar_joint(self, joint: Joint, ends: list[str], subject: str) -> None:
        """Write a planar joint of Drake between two frames of its own."""
        frames = self.seats[joint.name]
        places = ((joint.parent, self.place_on_parent(joint)), (joint.child, joint.X_CM))
        for name, (body, X) in zip(frames, places, strict=True):
            on = self.choose_link_name(body)
            at = "" if on == GROUND else f" attached_to={self.quote_text(on)}"
            pose = self.format_pose(X, "", subject)
            self.lines.append(f"    <frame name={self.quote_text(name)}{at}>{pose}</frame>")
        self.lines.append(
            f"    <drake:joint name={self.quote_text(joint.name)} type='planar'>"
            f"<drake:parent>{self.escape_text(frames[0])}</drake:parent>"
            f"<drake:child>{self.escape_text(frames[1])}</drake:child>"
            "<drake:damping>0 0 0</drake:damping></drake:joint>"
        )

    def choose_sdf_type(self, joint: Joint) -> str | None:
        """Return the joint type in SDF; None after refusing a type that SDF lacks."""
        name = joint.type.type_name
        if name == "free" and self.m.dim == 2:
            name = "planar"
        angles = joint.type.options.get("angles")
        if name not in TYPES or angles:
            self.findings.add_problem(
                f"a {name} joint{' by angles' * bool(angles)} does not exist in SDF",
                f"joint {joint.name!r}",
                joint.where,
                self.format.cannot["joints of other types"],
            )
            return None
        bounded = {*joint.limits, *joint.velocity_limits, *joint.effort_limits}
        if name in ("planar", "spherical") and bounded:
            self.findings.add_problem(
                f"limits of a {name} joint do not exist in SDF",
                f"joint {joint.name!r}",
                joint.where,
                self.format.cannot["limits of joints with several coordinates"],
            )
        return TYPES[name]

    def format_axis_limit(self, joint: Joint, name: str) -> str:
        """Return the elements <limit> and <mimic> of a coordinate; '' without limits and relation."""
        lower, upper = joint.limits.get(name, (-math.inf, math.inf))
        bounds = {
            "lower": lower,
            "upper": upper,
            "velocity": joint.velocity_limits.get(name, math.inf),
            "effort": joint.effort_limits.get(name, math.inf),
        }
        said = "".join(f"<{k}>{x!r}</{k}>" for k, x in bounds.items() if math.isfinite(x))
        out = f"<limit>{said}</limit>" if said else ""
        if joint.name in self.mimics and not name:
            source, factor, offset = self.mimics[joint.name]
            numbers = f"<multiplier>{factor!r}</multiplier><offset>{offset!r}</offset>"
            out += f"<mimic joint={self.quote_text(source)}>{numbers}</mimic>"
        return out

    def check_closed_joint(self, joint: Joint) -> None:
        """Refuse a joint whose two frames do not coincide where all coordinates are zero."""
        if joint.parent not in self.poses or joint.child not in self.poses:
            return
        F = self.poses[joint.parent] @ self.place_on_parent(joint).evaluate_pose(self.m.parameters)
        M = self.poses[joint.child] @ joint.X_CM.evaluate_pose(self.m.parameters)
        apart = float(np.abs(F - M).max())
        if not apart <= CLOSED:
            self.findings.add_problem(
                f"it closes a loop, and its two frames are {apart:.3g} apart where all coordinates "
                "are zero",
                f"joint {joint.name!r}",
                joint.where,
                self.format.cannot["loops that are open where all coordinates are zero"],
            )


def _format_numbers(numbers: Iterable[Any]) -> str:
    """Return numbers as text, with blanks between them."""
    return " ".join(repr(float(x)) for x in numbers)
