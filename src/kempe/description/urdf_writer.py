"""Writer of URDF text; features that URDF lacks raise an error at once."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np

from kempe import spatial
from kempe.constraints.kinds import list_point_rows
from kempe.description.formats import URDF
from kempe.description.length_units import convert_to_metres
from kempe.description.mechanism import Mechanism
from kempe.description.parts import Body, Declared, Joint, Shape
from kempe.description.source import Findings, choose_numbered_name
from kempe.description.urdf_elements import UNLIMITED, WITHOUT_AXIS
from kempe.description.urdf_loops import BALL, BODIES, LOOP_TYPES, POINTS
from kempe.description.urdf_reader import find_reachable_bodies
from kempe.description.urdf_shapes import NEWER, format_shape, is_writable_shape
from kempe.errors import InputError, Where
from kempe.joints import Q, R
from kempe.poses import Placement
from kempe.values import evaluate_value
from kempe.words import format_count, join_first_words

ON_AXIS = 1e-12
"""Metres that a body's origin may lie off the axis of its joint and still count as on it."""

_FORBIDDEN = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


@dataclass(frozen=True)
class _Origin:
    """Numbers of an <origin>: the placement of a joint's frame on its parent link."""

    xyz: Sequence[float]
    rpy: Sequence[float]


def write_urdf(mechanism: Mechanism) -> str:
    """Return the URDF text of a mechanism; `read_urdf` gives all bodies and frames the same poses.

    Parameters are evaluated, locked joints become fixed ones, named frames become links without
    mass. A body whose origin lies off the axis of its joint gets a link of its own for the joint's
    frame. Unlimited prismatic joints get limits of +-1e308, since URDF demands some. A joint that
    closes a loop becomes a <loop_joint>, two points that coincide a <drake:ball_constraint>.
    Postures, notes and the marks of actuated joints are left out. Errors: `DescriptionError`
    listing all that URDF cannot say, by `URDF.cannot` of `kempe.description.formats`.
    """
    return UrdfWriter(convert_to_metres(mechanism)).write_text()


class UrdfWriter:
    """Writer of links and joints; what its `format` cannot hold becomes a problem."""

    format = URDF

    def __init__(self, mechanism: Mechanism):
        self.m = mechanism
        self.findings = Findings()
        self.lines: list[str] = []
        self.links = {*mechanism.bodies, *mechanism.frames}
        self.joints = set(mechanism.joints)
        self.held = dict(mechanism.locks)
        self.mimics: dict[str, tuple[str, float, float]] = {}

    def write_text(self) -> str:
        """Return the text of the file."""
        self.resolve_couplings()
        loops = self.choose_loop_joints()
        self.check_constraints()
        left_out = [f"posture {name!r}" for name in self.m.postures]
        left_out += [f"group {name!r}" for name in self.m.groups]
        if pairs := len(self.m.ignored_pairs):
            left_out.append(format_count(pairs, "ignored pair"))
        if left_out:
            said = ", ".join(left_out).replace("--", "- -")
            self.lines.append(f"  <!-- left out, since URDF cannot say it: {said} -->")
        for body in self.m.bodies.values():
            self.write_body(body)
        for joint in self.m.joints.values():
            with self.record_bad_placement(f"joint {joint.name!r}", joint.where):
                if joint.name in loops:
                    self.write_loop_joint(joint)
                else:
                    self.write_joint(joint)
        for frame in self.m.frames.values():
            self.write_link(frame.name)
            name = reserve_name(f"{frame.name}_fixed", self.joints)
            with self.record_bad_placement(f"frame {frame.name!r}", frame.where):
                self.write_fixed_joint(
                    name, frame.body, frame.name, self.compute_origin(frame.X_BF)
                )
        for constraint in self.m.constraints.values():
            if self.is_writable_constraint(constraint):
                self.write_ball_constraint(constraint)
        self.findings.raise_problems()
        newer = any(s.kind in NEWER for body in self.m.bodies.values() for s in body.shapes)
        attributes = ' version="1.1"' if newer else ""
        if any(map(self.is_writable_constraint, self.m.constraints.values())):
            attributes += ' xmlns:drake="http://drake.mit.edu"'
        name = self.quote_text(self.m.name)
        head = f'<?xml version="1.0" encoding="utf-8"?>\n<robot name={name}{attributes}>\n'
        self.findings.raise_problems()
        return head + "\n".join(self.lines) + "\n</robot>\n"

    @contextmanager
    def record_bad_placement(self, subject: str, where: Where | None) -> Generator[None]:
        """Record a placement that is not a number as a problem of `subject`."""
        try:
            yield
        except FloatingPointError as error:
            self.findings.add_problem(str(error), subject, where, "check its parameters")

    # ---- what must hold

    def choose_loop_joints(self) -> set[str]:
        """Return the names of the joints that close loops; the others are a tree from the ground.

        A joint can close a loop where the other joints lead to the same bodies, from parent to
        child. Joints that a <loop_joint> can say are taken first, of these the ones marked `cut`,
        then those that stand last. Bodies to which no joints lead are a problem.
        """
        ground = self.m.ground.name
        tree = dict(self.m.joints)
        incoming = Counter(joint.child for joint in tree.values())

        def find_bodies(without: str = "") -> set[str]:
            """Return the bodies that the joints of the tree reach, all or all but one."""
            ends = ((j.parent, j.child) for j in tree.values() if j.name != without)
            return find_reachable_bodies(ground, ends)

        reached = find_bodies()

        def is_replaceable(joint: Joint) -> bool:
            """Whether another joint leads to the child of a joint; none needs to lead to the ground."""
            return incoming[joint.child] > (joint.child != ground)

        candidates = filter(is_replaceable, reversed(self.m.joints.values()))
        for joint in sorted(candidates, key=lambda j: (not self.is_loop_joint(j), not j.cut)):
            if is_replaceable(joint) and find_bodies(without=joint.name) == reached:
                del tree[joint.name]
                incoming[joint.child] -= 1
        lost = [b for b in self.m.bodies if b not in reached]
        if lost:
            shown = join_first_words([*map(repr, lost[1:])], 8)
            self.findings.add_problem(
                "no joints lead to it from the ground in their own direction, from parent to child"
                + f"; nor to {shown}" * bool(shown),
                f"body {lost[0]!r}",
                self.m.bodies[lost[0]].where,
                self.format.cannot["bodies that no joint carries"],
            )
        return self.m.joints.keys() - tree.keys()

    def is_loop_joint(self, joint: Joint) -> bool:
        """Whether a <loop_joint> can say a joint: it has neither limits nor a mimic."""
        if self.is_locked_joint(joint):
            return True
        bounded = {*joint.limits, *joint.velocity_limits, *joint.effort_limits}
        coupled = {*self.mimics, *(source for source, _, _ in self.mimics.values())}
        known = joint.type.type_name in LOOP_TYPES.values() and not joint.type.options
        return known and not bounded and joint.name not in coupled

    def is_locked_joint(self, joint: Joint) -> bool:
        """Whether all coordinates of a joint are locked."""
        return all(c in self.held for c in self.list_coordinates(joint))

    def check_constraints(self) -> None:
        """Refuse constraints that cannot be written."""
        for constraint in self.m.constraints.values():
            if self.is_writable_constraint(constraint):
                continue
            self.findings.add_problem(
                f"a {constraint.kind} does not exist in {self.format.title}",
                f"constraint {constraint.name!r}",
                constraint.where,
                self.format.cannot["constraints that are not joints"],
            )

    def is_writable_constraint(self, constraint: Declared) -> bool:
        """Whether a constraint holds two points together, and no more."""
        dim = self.m.dim
        return constraint.of.list_rows(dim) == list_point_rows(dim)

    def is_fixed_joint(self, joint: Joint) -> bool:
        """Whether a joint does not move; locks of only a part of its coordinates are refused."""
        coordinates = self.list_coordinates(joint)
        held = [c for c in coordinates if c in self.held]
        if held and len(held) < len(coordinates):
            self.findings.add_problem(
                f"only {', '.join(held)} of its coordinates are locked",
                f"joint {joint.name!r}",
                joint.where,
                self.format.cannot["locks of a part of a joint"],
            )
        return len(held) == len(coordinates)

    def resolve_couplings(self) -> None:
        """Sort couplings into constants (all sources locked) and mimics (one source left).

        Others are problems.
        """
        pending = dict(self.m.couplings)
        while True:
            open_: dict[str, tuple[dict[str, float], float]] = {}
            for of, c in pending.items():
                sources = {
                    k: float(evaluate_value(v, self.m.parameters)) for k, v in c.sources.items()
                }
                offset = float(evaluate_value(c.offset, self.m.parameters))
                offset += sum(v * self.held[k] for k, v in sources.items() if k in self.held)
                free = {k: v for k, v in sources.items() if k not in self.held}
                if of not in self.held and not free:
                    self.held[of] = offset
                    continue
                open_[of] = (free, offset)
            if len(open_) == len(pending):
                break
            pending = {of: self.m.couplings[of] for of in open_}
        for of, (free, offset) in open_.items():
            subject = f"coordinate {of!r}"
            where = self.m.couplings[of].where
            if of in self.held:
                allowed = self.format.cannot["locks of coordinates that follow others"]
                self.findings.add_problem(
                    "it is locked, but follows others", subject, where, allowed
                )
            elif len(free) > 1:
                self.findings.add_problem(
                    f"it follows several coordinates ({', '.join(free)})",
                    subject,
                    where,
                    self.format.cannot["couplings with several sources"],
                )
            elif not {of, *free} <= self.m.joints.keys():
                self.findings.add_problem(
                    "it is one of several coordinates of a joint, or follows one",
                    subject,
                    where,
                    self.format.cannot["couplings of a part of a joint"],
                )
            else:
                source, factor = next(iter(free.items()))
                self.mimics[of] = (source, factor, offset)

    # ---- links

    def quote_text(self, text: str) -> str:
        """Return a text as the value of an attribute; characters that XML forbids are refused."""
        if _FORBIDDEN.search(text):
            allowed = self.format.cannot["control characters in names"]
            self.findings.add_problem(
                "it has a character that XML forbids", f"name {text!r}", None, allowed
            )
        return quoteattr(text)

    def write_link(self, name: str, inside: Iterable[str] = ()) -> None:
        """Write the element <link>."""
        lines = list(inside)
        if not lines:
            self.lines.append(f"  <link name={self.quote_text(name)}/>")
            return
        self.lines += [
            f"  <link name={self.quote_text(name)}>",
            *(f"    {line}" for line in lines),
            "  </link>",
        ]

    def write_body(self, body: Body) -> None:
        """Write the link of a body."""
        subject = f"body {body.name!r}"
        if body.particle:
            self.findings.add_problem(
                "it is a particle", subject, body.where, self.format.cannot["particles"]
            )
        inside: list[str] = []
        if body.mass is not None or body.center is not None:
            center = (
                f'<origin xyz="{_format_numbers(body.center)}"/>' if body.center is not None else ""
            )
            mass = f'<mass value="{(body.mass or 0.0)!r}"/>'
            inertia = '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>'
            inside.append(f"<inertial>{center}{mass}{inertia}</inertial>")
        for shape in body.shapes:
            inside += self.format_shape(shape, subject)
        self.write_link(body.name, inside)

    def format_shape(self, shape: Shape, subject: str) -> list[str]:
        """Return the elements of a shape."""
        if not is_writable_shape(shape):
            said = f"{shape.kind} does not exist in URDF as a shape"
            self.findings.add_problem(said, subject, shape.where, self.format.cannot["ellipsoids"])
            return []
        try:
            origin = format_origin(self.compute_origin(shape.X_BS)) if shape.X_BS.steps else ""
            return list(format_shape(shape, origin, self.m.parameters, self.quote_text))
        except (FloatingPointError, InputError) as error:
            self.findings.add_problem(str(error), subject, shape.where, "check its parameters")
            return []

    # ---- joints

    def write_joint(self, joint: Joint) -> None:
        """Write a joint."""
        coordinates = self.list_coordinates(joint)
        if self.is_fixed_joint(joint):
            X_PC = (
                joint.X_PF
                @ self.compute_locked_pose(joint, coordinates)
                @ joint.X_CM.invert_steps()
            )
            self.write_fixed_joint(
                joint.name,
                joint.parent,
                joint.child,
                self.compute_origin(X_PC if coordinates else _compute_fixed_placement(joint)),
            )
            return
        kind = self.choose_urdf_type(joint)
        if kind is None:
            return
        inside = self.format_limit(joint, kind)
        if joint.name in self.mimics:
            source, factor, offset = self.mimics[joint.name]
            inside.append(
                f'<mimic joint={self.quote_text(source)} multiplier="{factor!r}" offset="{offset!r}"/>'
            )
        direct = self.find_origin_and_axis(joint, kind)
        if direct is not None:
            self.write_joint_element(joint.name, kind, joint.parent, joint.child, *direct, inside)
            return
        between = reserve_name(f"{joint.name}_frame", self.links)
        self.write_link(between)
        self.write_joint_element(
            joint.name,
            kind,
            joint.parent,
            between,
            self.compute_origin(joint.X_PF),
            (0.0, 0.0, 1.0),
            inside,
        )
        end = self.compute_origin(joint.X_CM.invert_steps())
        self.write_fixed_joint(
            reserve_name(f"{joint.name}_fixed", self.joints), between, joint.child, end
        )

    def write_loop_joint(self, joint: Joint) -> None:
        """Write a joint that closes a loop, between a frame on each of its two links."""
        if not self.is_loop_joint(joint):
            self.findings.add_problem(
                "it closes a loop, and cannot be said as a <loop_joint>",
                f"joint {joint.name!r}",
                joint.where,
                self.format.cannot["loops closed by other joints, or by ones with limits"],
            )
            return
        coordinates = self.list_coordinates(joint)
        kind = joint.type.type_name
        on_parent = joint.X_PF
        if self.is_locked_joint(joint):
            kind = "fixed"
            on_parent = on_parent @ self.compute_locked_pose(joint, coordinates)
        self.lines.append("  <!-- loop_joint: of Isaac Sim and older versions of Drake -->")
        self.lines.append(f'  <loop_joint name={self.quote_text(joint.name)} type="{kind}">')
        ends = ((joint.parent, on_parent), (joint.child, joint.X_CM))
        for number, (link, X) in enumerate(ends, 1):
            place = _format_place(self.compute_origin(X))
            self.lines.append(f"    <link{number} link={self.quote_text(link)} {place}/>")
        if kind not in ("fixed", "spherical"):
            self.lines.append('    <axis xyz="0.0 0.0 1.0"/>')
        self.lines.append("  </loop_joint>")

    def write_ball_constraint(self, constraint: Declared) -> None:
        """Write a constraint of Drake that two points coincide."""
        self.lines.append(f"  <{BALL} name={self.quote_text(constraint.name)}>")
        links = (constraint.parent, constraint.child)
        frames = constraint.frames(self.m.parameters, self.m.dim)
        for link, X, body, point in zip(links, frames, BODIES, POINTS, strict=True):
            self.lines.append(f"    <{body} name={self.quote_text(link)}/>")
            self.lines.append(f'    <{point} value="{_format_numbers(X[:3, 3])}"/>')
        self.lines.append(f"  </{BALL}>")

    def list_coordinates(self, joint: Joint) -> list[str]:
        """Return the names of the coordinates of a joint."""
        names = joint.type.list_coordinate_names(self.m.dim, self.m.bodies[joint.child].particle)
        return [f"{joint.name}.{n}" if n else joint.name for n in names]

    def compute_locked_pose(self, joint: Joint, coordinates: list[str]) -> Placement:
        """Return the placement X_FM of a joint whose coordinates are all locked."""
        steps: list[tuple[str, tuple[float, ...]]] = []
        primitives = joint.type.layout(self.m.dim, self.m.bodies[joint.child].particle)[1]
        for kind, axis, first, multiplier in primitives:
            if kind == Q:
                steps.append(
                    ("quat_wxyz", tuple(self.held[c] for c in coordinates[first : first + 4]))
                )
            else:
                steps.append(
                    ("r" * (kind == R) + axis, (multiplier * self.held[coordinates[first]],))
                )
        return Placement(tuple(steps))

    def choose_urdf_type(self, joint: Joint) -> str | None:
        """Return the joint type in URDF; None after refusing a type that URDF lacks."""
        subject = f"joint {joint.name!r}"
        name = joint.type.type_name
        if name == "free" and self.m.dim == 2:
            name = "planar"
        kinds = {
            "revolute": "revolute" if joint.limits else "continuous",
            "prismatic": "prismatic",
            "planar": "planar",
            "free": "floating",
            "spherical": "spherical",
        }
        if name not in kinds or joint.type.options:
            angles = " by angles" if joint.type.options.get("angles") else ""
            self.findings.add_problem(
                f"a {name} joint{angles} does not exist in URDF",
                subject,
                joint.where,
                self.format.cannot["joints of other types"],
            )
            return None
        bounded = {*joint.limits, *joint.velocity_limits, *joint.effort_limits}
        if name in ("planar", "free", "spherical") and bounded:
            allowed = self.format.cannot["limits of joints with several coordinates"]
            self.findings.add_problem(
                f"limits of a {name} joint do not exist in URDF", subject, joint.where, allowed
            )
        return kinds[name]

    def format_limit(self, joint: Joint, kind: str) -> list[str]:
        """Return the element <limit>; [] without limits."""
        given = {"velocity": joint.velocity_limits.get(""), "effort": joint.effort_limits.get("")}
        if kind in ("planar", "floating", "spherical") or (
            kind == "continuous" and set(given.values()) == {None}
        ):
            return []
        lower, upper = joint.limits.get("", (-math.inf, math.inf))
        bounds = {} if kind == "continuous" else {"lower": lower, "upper": upper}
        bounds |= {k: math.inf if v is None else v for k, v in given.items()}
        said = " ".join(f'{k}="{max(-UNLIMITED, min(UNLIMITED, v))!r}"' for k, v in bounds.items())
        return [f"<limit {said}/>"]

    def find_origin_and_axis(
        self, joint: Joint, kind: str
    ) -> tuple[_Origin, Sequence[float]] | None:
        """Return origin and axis of a joint that needs no extra link for its frame, else None."""
        on_child = joint.X_CM.steps
        before = joint.X_PF.steps[: len(joint.X_PF.steps) - len(on_child)]
        if joint.X_PF.steps == before + on_child and len(on_child) <= 1:
            motion, numbers = on_child[0] if on_child else ("align", (0.0, 0.0, 1.0))
            if motion == "align" and kind not in WITHOUT_AXIS:
                return self.compute_origin(Placement(before)), [float(x) for x in numbers]  # type: ignore[arg-type]
        X_CM = joint.X_CM.evaluate_pose(self.m.parameters)
        a = X_CM[:3, 2]
        p = X_CM[:3, 3]
        fits = {
            "revolute": np.linalg.norm(p - (p @ a) * a) <= ON_AXIS,
            "prismatic": True,
            "planar": np.allclose(X_CM, spatial.pose(spatial.align_z(a)), rtol=0.0, atol=ON_AXIS),
            "floating": np.allclose(X_CM, np.eye(4), rtol=0.0, atol=ON_AXIS),
            "spherical": np.allclose(X_CM, np.eye(4), rtol=0.0, atol=ON_AXIS),
        }
        if not fits["revolute" if kind == "continuous" else kind]:
            return None
        return self.compute_origin(joint.X_PF @ joint.X_CM.invert_steps()), a.tolist()

    # ---- elements

    def compute_origin(self, X: Placement) -> _Origin:
        """Return the numbers of a placement as position and roll, pitch, yaw.

        They are those of the placement itself where it is a shift and roll, pitch, yaw; else they
        are computed.
        """
        steps = X.drop_identity_steps().steps
        if [s[0] for s in steps] == [
            k for k in ("x", "y", "z", "rz", "ry", "rx") if k in dict(steps)
        ]:
            given = {k: float(evaluate_value(v[0], self.m.parameters)) for k, v in steps}
            numbers = [given.get(k, 0.0) for k in ("x", "y", "z", "rx", "ry", "rz")]
        else:
            numbers = spatial.xyz_rpy_from_pose(X.evaluate_pose(self.m.parameters)).tolist()
        if not all(map(math.isfinite, numbers)):
            raise FloatingPointError("its placement is not a number with these parameters")
        return _Origin(numbers[:3], numbers[3:])

    def write_fixed_joint(self, name: str, parent: str, child: str, origin: _Origin) -> None:
        """Write a fixed joint."""
        self.write_joint_element(name, "fixed", parent, child, origin, None, [])

    def write_joint_element(
        self,
        name: str,
        kind: str,
        parent: str,
        child: str,
        origin: _Origin,
        axis: Sequence[float] | None,
        inside: list[str],
    ) -> None:
        """Write the element <joint>."""
        if kind == "spherical":
            self.lines.append(
                "  <!-- spherical: a type of MuJoCo and Bullet, which ROS refuses -->"
            )
        self.lines.append(f'  <joint name={self.quote_text(name)} type="{kind}">')
        self.lines.append(
            f"    <parent link={self.quote_text(parent)}/><child link={self.quote_text(child)}/>"
        )
        self.lines.append(f"    {format_origin(origin)}")
        if axis is not None and kind not in WITHOUT_AXIS:
            self.lines.append(f'    <axis xyz="{_format_numbers(axis)}"/>')
        self.lines += [f"    {line}" for line in inside]
        self.lines.append("  </joint>")


def _compute_fixed_placement(joint: Joint) -> Placement:
    """Return X_PF X_CM^-1 of a fixed joint, without steps that cancel."""
    a = joint.X_PF.steps
    b = joint.X_CM.steps
    while a and b and a[-1] == b[-1]:
        a = a[:-1]
        b = b[:-1]
    return Placement(a) @ Placement(b).invert_steps()


def reserve_name(name: str, taken: set[str]) -> str:
    """Return `name`, with a number where it is taken, and add it to the taken names."""
    out = choose_numbered_name(name, taken)
    taken.add(out)
    return out


def format_origin(origin: _Origin) -> str:
    """Return the element <origin>."""
    return f"<origin {_format_place(origin)}/>"


def _format_place(origin: _Origin) -> str:
    """Return a position and roll, pitch, yaw as attributes."""
    return f'xyz="{_format_numbers(origin.xyz)}" rpy="{_format_numbers(origin.rpy)}"'


def _format_numbers(numbers: Iterable[float]) -> str:
    """Return numbers as text, with blanks between them."""
    return " ".join(repr(float(x)) for x in numbers)
