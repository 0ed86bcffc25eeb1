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
from kempe.description.length_units import convert_to_metres
from kempe.description.mechanism import Mechanism
from kempe.description.parts import Body, Declared, Joint, Shape
from kempe.description.sdf_scopes import GROUND, MODEL
from kempe.description.shapes import Mesh, list_size_names
from kempe.description.urdf_writer import UrdfWriter, reserve_name
from kempe.errors import InputError
from kempe.poses import Placement, place
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

    The ground becomes a link that is fixed to the world, unless it is called 'world'. Parts called
    'arm::hand' are written in a nested model 'arm'. A joint that closes a loop is written where its
    two frames coincide while all coordinates are zero. A free joint on the ground is left out, since
    what nothing ties to the world moves freely in SDF.
    Parameters are evaluated, locked joints become fixed ones. Errors: `DescriptionError` listing
    all that SDF cannot say, by `SDF.cannot` of `kempe.description.formats`.
    """
    return _SdfWriter(convert_to_metres(mechanism)).write_text()


class _SdfWriter(UrdfWriter):
    """Writer of the links and joints of a mechanism as SDF."""

    format = SDF

    def write_text(self) -> str:
        """Return the text of the file."""
        m = self.m
        self.check_constraints()
        self.resolve_couplings()
        self.floating = {j.name for j in m.joints.values() if self.is_floating_joint(j)}
        self.check_names()
        name = m.ground.name
        needed = name != GROUND or bool(m.ground.shapes or m.ground.mass is not None)
        needed |= any(f.body == name for f in m.frames.values())
        needed |= any(j.child == name for j in m.joints.values())
        self.ground = (reserve_name("world_link", self.links) if name == GROUND else name) * needed
        self.taken = self.links | self.joints
        self.placed: dict[str, Joint] = {}
        self.floating_bodies: dict[str, Joint] = {}
        self.poses: dict[str, Array] = {name: np.eye(4)}
        self.place_bodies()
        self.inside: dict[str, list[str]] = {"": []}
        """Elements in each nested model, by its prefix 'arm::hand::'."""
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
            child = self.escape_text(get_local_name(self.ground))
            ends = f"<parent>{GROUND}</parent><child>{child}</child>"
            self.add_element("joint", joint, " type='fixed'", ends)
        for joint in m.joints.values():
            if joint.name not in self.floating:
                self.write_joint(joint)
        for frame in m.frames.values():
            subject = f"frame {frame.name!r}"
            pose = self.format_pose(frame.X_BF, "", subject)
            on = self.choose_seen_name(self.choose_link_name(frame.body), frame.name, subject)
            self.add_element("frame", frame.name, f" attached_to={self.quote_text(on)}", pose)
        version = "1.11" if self.mimics else "1.9"
        head = f'<?xml version="1.0" encoding="utf-8"?>\n<sdf version="{version}">\n'
        text = self.format_model(m.name, "", "  ")
        self.findings.raise_problems()
        return f"{head}{text}\n</sdf>\n"

    def add_element(self, tag: str, name: str, attributes: str, inside: str) -> None:
        """Add an element to the model that its name says."""
        prefix = get_prefix(name)
        for end in (i + 2 for i in range(len(prefix)) if prefix.startswith("::", i)):
            self.inside.setdefault(prefix[:end], [])
        named = self.quote_text(get_local_name(name))
        self.inside[prefix].append(f"<{tag} name={named}{attributes}>{inside}</{tag}>")

    def format_model(self, name: str, prefix: str, indent: str) -> str:
        """Return the element <model> with the parts of a prefix, and the models nested in it."""
        lines = [f"{indent}  {line}" for line in self.inside[prefix]]
        lines += [
            self.format_model(get_local_name(inner[:-2]), inner, indent + "  ")
            for inner in self.inside
            if inner and get_prefix(inner[:-2]) == prefix
        ]
        named = self.quote_text(name)
        return "\n".join([f"{indent}<model name={named}>", *lines, f"{indent}</model>"])

    def choose_seen_name(self, name: str, of: str, subject: str) -> str:
        """Return the name of a part as the model of another part sees it.

        A nested model sees its own parts and the world only.
        """
        prefix = get_prefix(of)
        if not name.startswith(prefix) and name != GROUND:
            self.findings.add_problem(
                f"its name puts it in the nested model {prefix[:-2]!r}, which does not see {name!r}",
                subject,
                None,
                self.format.cannot["parts of a nested model that are tied to parts outside"],
            )
        return name.removeprefix(prefix)

    # ---- what must hold

    def check_names(self) -> None:
        """Refuse names that SDF reserves, and names that two parts share."""
        joints = {k: j for k, j in self.m.joints.items() if k not in self.floating}
        kinds = {"joint": joints, "frame": self.m.frames, "body": self.m.bodies}
        models = {
            prefix[:-2]
            for parts in kinds.values()
            for name in parts
            if (prefix := get_prefix(name))
        }
        seen = dict.fromkeys(models, "nested model")
        for kind, parts in kinds.items():
            for name, part in parts.items():
                pieces = name.split("::")
                reserved = any(
                    p == GROUND or p.startswith("__") and p.endswith("__") for p in pieces
                )
                said = ""
                if not all(pieces) or (reserved and name != self.m.ground.name):
                    said = "SDF keeps such a name for itself"
                elif name in seen:
                    said = f"a {seen[name]} has its name, too"
                if said:
                    allowed = self.format.cannot["names of its own, and equal ones"]
                    self.findings.add_problem(said, f"{kind} {name!r}", part.where, allowed)
                seen[name] = kind

    def is_writable_constraint(self, constraint: Declared) -> bool:
        """Whether a constraint can be written: SDF has joints only."""
        return False

    def place_bodies(self) -> None:
        """Compute the poses of all bodies where all coordinates are zero."""
        around: dict[str, list[Joint]] = {b: [] for b in self.m.bodies}
        for joint in self.m.joints.values():
            if joint.name not in self.floating:
                around[joint.parent].append(joint)
                around[joint.child].append(joint)
        queue = deque(self.poses)
        # bodies that other joints lead to are placed by these
        floating = deque(self.m.joints[name] for name in self.m.joints if name in self.floating)
        while queue or floating:
            if not queue:
                joint = floating.popleft()
                if joint.child not in self.poses:
                    self.place_body(joint, joint.child)
                    self.floating_bodies[joint.child] = joint
                    queue.append(joint.child)
                continue
            here = queue.popleft()
            for joint in around[here]:
                there = joint.child if joint.parent == here else joint.parent
                if there not in self.poses:
                    self.place_body(joint, there)
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

    def place_body(self, joint: Joint, body: str) -> None:
        """Compute the pose of a body from that of the other body of a joint."""
        X_PC = (self.place_on_parent(joint) @ joint.X_CM.invert_steps()).evaluate_pose(
            self.m.parameters
        )
        if body == joint.child:
            self.poses[body] = self.poses[joint.parent] @ X_PC
        else:
            self.poses[body] = self.poses[joint.child] @ spatial.inverse(X_PC)

    def is_floating_joint(self, joint: Joint) -> bool:
        """Whether a joint leaves a body free on the ground, which SDF says by no joint."""
        free = joint.type.type_name == "free" and not joint.type.options and self.m.dim == 3
        bounded = {*joint.limits, *joint.velocity_limits, *joint.effort_limits}
        held = any(c in self.held for c in self.list_coordinates(joint))
        return free and joint.parent == self.m.ground.name and not bounded and not held

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
        name = self.choose_link_name(body.name)
        joint = self.placed.get(body.name)
        if joint is not None:
            forward = joint.child == body.name
            X = joint.X_CM.invert_steps() if forward else self.place_on_parent(joint).invert_steps()
            seat = joint.name
            if joint.name in self.seats:  # a joint of Drake is no frame of SDF
                seat = self.seats[joint.name][not forward]
            if seat.startswith(get_prefix(name)):
                inside.append(self.format_pose(X, seat.removeprefix(get_prefix(name)), subject))
            else:  # nested models do not see it, and stand where the outer one does
                inside.append(self.format_pose(place(self.poses[body.name]), "", subject))
        elif body.name in self.floating_bodies:
            free = self.floating_bodies[body.name]
            X = free.X_PF @ free.X_CM.invert_steps()
            inside.append(self.format_pose(X, "", subject))
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
        self.add_element("link", name, "", "".join(inside))

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
        parent, child = (
            self.choose_seen_name(self.choose_link_name(b), joint.name, subject)
            for b in (joint.parent, joint.child)
        )
        if kind == "planar":
            self.write_planar_joint(joint, subject)
            return
        if self.placed.get(joint.child) is joint:
            pose = self.format_pose(
                self.place_on_parent(joint), MODEL if parent == GROUND else parent, subject
            )
        else:
            pose = self.format_pose(on_child, child, subject)
        inside = f"<parent>{self.escape_text(parent)}</parent><child>{self.escape_text(child)}</child>{pose}"
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
        self.add_element("joint", joint.name, f" type='{kind}'", inside)

    def write_planar_joint(self, joint: Joint, subject: str) -> None:
        """Write a planar joint of Drake between two frames of its own."""
        frames = self.seats[joint.name]
        places = ((joint.parent, self.place_on_parent(joint)), (joint.child, joint.X_CM))
        for name, (body, X) in zip(frames, places, strict=True):
            on = self.choose_link_name(body)
            if on == GROUND:
                on = MODEL if not get_prefix(name) else ""
            if on != MODEL:
                on = self.choose_seen_name(on, name, subject)
            at = "" if on == MODEL else f" attached_to={self.quote_text(on)}"
            self.add_element("frame", name, at, self.format_pose(X, "", subject))
        parent, child = (self.escape_text(get_local_name(name)) for name in frames)
        inside = (
            f"<drake:parent>{parent}</drake:parent><drake:child>{child}</drake:child>"
            "<drake:damping>0 0 0</drake:damping>"
        )
        self.add_element("drake:joint", joint.name, " type='planar'", inside)

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
            seen = self.choose_seen_name(source, joint.name, f"joint {joint.name!r}")
            out += f"<mimic joint={self.quote_text(seen)}>{numbers}</mimic>"
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


def get_prefix(name: str) -> str:
    """Return the prefix of the nested models that a name stands in: 'arm::hand::' or ''."""
    model, separator, _ = name.rpartition("::")
    return model + separator


def get_local_name(name: str) -> str:
    """Return a name without the nested models that it stands in."""
    return name.rpartition("::")[2]


def _format_numbers(numbers: Iterable[Any]) -> str:
    """Return numbers as text, with blanks between them."""
    return " ".join(repr(float(x)) for x in numbers)
