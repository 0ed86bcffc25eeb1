"""What is seen of a system at one configuration: links, joints, frames and rods in the ground
frame; no matplotlib.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.constraints.base import Op, evaluate_number_fields, list_position_rows
from kempe.description.parts import Declared
from kempe.equations.judge import closure_error, compute_coordinate_value
from kempe.errors import UnsupportedError
from kempe.forward.fk import fk
from kempe.joints import Primitive
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.description.mechanism import Mechanism
    from kempe.model.model import Model

FARTHEST = 1e100
"""Largest coordinate of a point that is drawn: squares and cubes of lengths are still finite."""


@dataclass(frozen=True)
class SeenJoint:
    """A joint that can move: its frames F (4, 4) on link `parent` and M (4, 4) on link `child`."""

    name: str
    kind: str
    parent: int
    child: int
    F: Array
    M: Array
    driven: bool = False
    limits: tuple[float, float] = (-np.inf, np.inf)
    motions: tuple[Primitive, ...] = ()
    gap: Array | None = None
    """How far (3,) M is from where the coordinates of a joint that closes a loop put it [m]."""

    def find_pose_on(self, link: int) -> Array:
        """Return the pose (4, 4) of the joint's frame on one of its two links."""
        return self.F if link == self.parent else self.M

    @property
    def centre(self) -> Array:
        """Origin (3,) of the joint's frame M [m]."""
        return self.M[:3, 3]

    @property
    def axis(self) -> Array:
        """Unit vector z (3,) of the joint's frame F."""
        return self.F[:3, 2]


@dataclass(frozen=True)
class SeenLink:
    """Bodies that fixed joints make one: poses (4, 4) by body name, frames likewise, and numbers of
    its joints.
    """

    number: int
    name: str
    bodies: dict[str, Array]
    frames: dict[str, Array] = field(default_factory=dict[str, Array])
    joints: tuple[int, ...] = ()
    particle: bool = False

    @property
    def is_ground(self) -> bool:
        """Whether the link is the ground."""
        return self.number == 0


@dataclass(frozen=True)
class SeenMark:
    """Where a constraint that is no joint, rod or line takes hold: frame B (4, 4) on a link, and
    how it is drawn.

    `symbol` is that of its kind. `plane` is the foot (3,) of B on the plane that it touches, with
    the normal, and `radius` that of what touches it, `disc` whether that is flat, with y of B as
    its axle.
    """

    name: str
    link: int
    B: Array
    symbol: str
    plane: tuple[Array, Array] | None = None
    radius: float = 0.0
    disc: bool = False

    @property
    def point(self) -> Array:
        """Position (3,) of the constraint [m]."""
        return self.B[:3, 3]


@dataclass(frozen=True)
class Scene:
    """All that there is to draw; link 0 is the ground.

    `rods` are distance constraints: name, links, ends (2, 3), what the ends are too far apart [m].
    `lines` are points on lines: name, links, pose (4, 4) of the line's frame, position of the
    point. `marks` are where other constraints take hold.
    """

    system: Model
    q: Array
    links: tuple[SeenLink, ...]
    joints: tuple[SeenJoint, ...]
    rods: tuple[tuple[str, tuple[int, int], Array, float], ...] = ()
    lines: tuple[tuple[str, tuple[int, int], Array, Array], ...] = ()
    marks: tuple[SeenMark, ...] = ()

    def list_points(self, link: SeenLink) -> Array:
        """List the distinct joint centres, rod ends and frame origins (k, 3) of a link [m]."""
        return self._points[link.number]

    @cached_property
    def _points(self) -> list[Array]:
        """Distinct joint centres, rod ends and frame origins (k, 3) of each link [m]."""
        found: list[list[Array]] = [
            [self.joints[j].find_pose_on(link.number)[:3, 3] for j in link.joints]
            for link in self.links
        ]
        for _, links, ends, _ in self.rods:
            for link, end in zip(links, ends, strict=True):
                found[link].append(end)
        for _, links, _, p in self.lines:
            found[links[1]].append(p)
        for m in self.marks:
            found[m.link].append(m.point)
        for link in self.links:
            found[link.number] += [X[:3, 3] for X in link.frames.values()]
        return [remove_duplicates(np.array(points).reshape(-1, 3)) for points in found]

    @cached_property
    def size(self) -> float:
        """Diagonal of the bounding box of all joint centres and frames [m]; 1 for a single point."""
        p = np.concatenate(self._points)
        span = float(np.linalg.norm(np.ptp(p, axis=0))) if len(p) else 0.0
        return span if np.isfinite(span) and span > 1e-9 else 1.0

    @cached_property
    def lengths(self) -> Array:
        """Distances of all pairs of points on the same moving link [m], without zeros."""
        out = [0.0]
        for link in self.links[1:]:
            p = self.list_points(link)
            out += [float(np.linalg.norm(a - b)) for i, a in enumerate(p) for b in p[:i]]
        lengths = np.array(out)
        return lengths[lengths > 1e-9 * self.size]

    def compute_reach(self, joint: SeenJoint, link: int) -> float:
        """Compute the largest distance of a link's points from a joint on it [m]."""
        p = self.list_points(self.links[link])
        return float(
            np.max(np.linalg.norm(p - joint.find_pose_on(link)[:3, 3], axis=1), initial=0.0)
        )

    def is_telescopic(self, joint: SeenJoint, r: float) -> bool:
        """Whether a prismatic joint is drawn as cylinder and rod instead of a block on a rail.

        `r` is the radius of a pin [m]. Kinematically they are one: a motor, or links that go on at
        both ends, decide.
        """
        if joint.kind != "prismatic" or 0 in (joint.parent, joint.child):
            return False
        both = (
            min(self.compute_reach(joint, joint.parent), self.compute_reach(joint, joint.child))
            > 6 * r
        )
        return (joint.driven or both) and float(
            np.linalg.norm(joint.centre - joint.F[:3, 3])
        ) > 6 * r

    def find_seat(self, joint: SeenJoint, r: float) -> Array:
        """Find the point (3,) of a joint's symbol: the origin of M, or the middle of its cylinder."""
        return (
            0.64 * joint.F[:3, 3] + 0.36 * joint.centre
            if self.is_telescopic(joint, r)
            else joint.centre
        )


def remove_duplicates(points: Array) -> Array:
    """Remove repeated points from (k, d); the tolerance is 1e-7 of their extent."""
    scale = 1e-7 * max(float(np.ptp(points, axis=0).max()) if len(points) else 0.0, 1e-9)
    out: list[Array] = []
    for p in points:
        if all(np.linalg.norm(p - o) > scale for o in out):
            out.append(p)
    return np.array(out).reshape(-1, points.shape[1])


def build_scene(system: Model, q: Array, drivers: tuple[str, ...] = ()) -> Scene:
    """Build the scene of a system at a configuration (nq,): its links, joints and constraints.

    `drivers` are joints to be marked as driven besides the actuated ones.

    Errors: `UnsupportedError` where a body is too far away to be drawn.
    """
    mechanism = system.mechanism
    poses = dict(zip(system.body_names, fk(system, q), strict=True))
    for name, X in poses.items():
        if np.abs(X[:3, 3]).max() > FARTHEST:
            far = np.abs(X[:3, 3]).max()
            raise UnsupportedError(
                f"body {name!r} is {far:g} from the origin; up to {FARTHEST:g} can be drawn"
            )
    number = number_links(system)
    gaps = dict(zip(system.structure.closures, closure_error(system, q)[:, :3], strict=True))
    joints: list[SeenJoint] = []
    mine: dict[int, list[int]] = {}
    for joint in mechanism.joints.values():
        if not joint.type.dof(system.dim, mechanism.bodies[joint.child].particle):
            continue
        X_PF, X_CM = (X.evaluate_pose(mechanism.parameters) for X in (joint.X_PF, joint.X_CM))
        ends = number[joint.parent], number[joint.child]
        for end in ends:
            mine.setdefault(end, []).append(len(joints))
        driven = bool(joint.actuated) or joint.name in drivers
        limits = next(iter(joint.limits.values()), (-np.inf, np.inf))
        motions = joint.type.layout(system.dim, mechanism.bodies[joint.child].particle)[1]
        M = poses[joint.child] @ X_CM
        gap = M[:3, :3] @ gaps[joint.name] if joint.name in gaps else None
        joints.append(
            SeenJoint(
                joint.name,
                joint.type.type_name,
                *ends,
                poses[joint.parent] @ X_PF,
                M,
                driven,
                limits,
                tuple(motions),
                gap,
            )
        )
    links: list[SeenLink] = []
    for k in range(max(number.values()) + 1):
        bodies = {b: poses[b] for b in system.body_names if number[b] == k}
        frames = {
            f.name: poses[f.body] @ f.X_BF.evaluate_pose(mechanism.parameters)
            for f in mechanism.frames.values()
            if f.body in bodies
        }
        if len(mine.get(k, ())) == bool(k or joints) and not frames:
            frames = _find_end_frame(mechanism, bodies)
        particle = all(mechanism.bodies[b].particle for b in bodies)
        links.append(
            SeenLink(k, next(iter(bodies)), bodies, frames, tuple(mine.get(k, ())), particle)
        )
    return Scene(system, q, tuple(links), tuple(joints), *_list_constraints(system, poses, number))


BESIDE = 2.7
"""Distance of a bearing from the centre of another one that it does not touch, in radii."""
ROOM = 0.6
"""Part of the way along its axis to the next point of its link that a bearing is moved at most."""


def separate_bearings(scene: Scene, r: float) -> Scene:
    """Move revolute joints along their axes to where their bearings of radius r [m] lie side by side.

    The axes of some joints meet in a point, as in a wrist. Of these joints the one nearest to the
    ground moves towards the other end of its parent, and the farthest one towards that of its child.
    A revolute joint is the same anywhere on its axis.
    """
    near = 1e-6 * scene.size
    joints = list(scene.joints)
    for k, joint in enumerate(scene.joints):
        if joint.kind != "revolute":
            continue
        meets = {
            link: any(
                np.linalg.norm(scene.joints[n].find_pose_on(link)[:3, 3] - centre) < near
                for n in scene.links[link].joints
                if n != k
            )
            for link, centre in ((joint.parent, joint.F[:3, 3]), (joint.child, joint.centre))
        }
        if meets[joint.parent] == meets[joint.child]:
            continue
        free = joint.child if meets[joint.parent] else joint.parent
        X = joint.find_pose_on(free)
        points = scene.list_points(scene.links[free])
        if free == 0:
            points = np.concatenate([points, [next(iter(scene.links[0].bodies.values()))[:3, 3]]])
        points = points[np.linalg.norm(points - X[:3, 3], axis=1) > near]
        along = (points - X[:3, 3]) @ X[:3, 2]
        along = along[np.abs(along) > near]
        if len(along):
            nearest = float(along[np.argmin(np.abs(along))])
            by = float(np.sign(nearest)) * min(BESIDE * r, ROOM * abs(nearest))
        elif len(points) or free == 0:  # the link lies across the axis
            continue
        else:
            by = BESIDE * r
        joints[k] = replace(joint, F=_shift_along_z(joint.F, by), M=_shift_along_z(joint.M, by))
    return replace(scene, joints=tuple(joints))


def _shift_along_z(X: Array, by: float) -> Array:
    """Move a pose (4, 4) along its z axis by a length [m]."""
    X = X.copy()
    X[:3, 3] += by * X[:3, 2]
    return X


def _find_end_frame(mechanism: Mechanism, bodies: dict[str, Array]) -> dict[str, Array]:
    """Find the last body of a link of several bodies, as a frame, such as a tool.

    Of several, such as cameras of a head, the one farthest from the body that the others are fixed
    to.
    """
    fixed = [j for j in mechanism.joints.values() if j.parent in bodies and j.child in bodies]
    inner = {j.parent for j in fixed}
    outer = {j.child for j in fixed}
    ends = [name for name in bodies if name in outer and name not in inner]
    head = next(iter(bodies.values()))[:3, 3]
    far = max(
        ends, key=lambda name: float(np.linalg.norm(bodies[name][:3, 3] - head)), default=None
    )
    return {} if far is None else {far: bodies[far]}


def number_links(system: Model) -> dict[str, int]:
    """Number the link of each body; bodies connected by joints without freedom are one link."""
    mechanism = system.mechanism
    root = {b: b for b in system.body_names}

    def find_root(body: str) -> str:
        """Find the body that represents the link of a body."""
        while root[body] != body:
            body = root[body]
        return body

    order = {b: i for i, b in enumerate(system.body_names)}
    for joint in mechanism.joints.values():
        if not joint.type.dof(system.dim, mechanism.bodies[joint.child].particle):
            a, b = sorted((find_root(joint.parent), find_root(joint.child)), key=order.__getitem__)
            root[b] = a
    heads = [b for b in system.body_names if root[b] == b]
    return {b: heads.index(find_root(b)) for b in system.body_names}


def _list_constraints(
    system: Model, poses: dict[str, Array], number: dict[str, int]
) -> tuple[Any, ...]:
    """List rods, lines and symbols of the constraints that are no joints."""
    mechanism = system.mechanism
    rods: list[tuple[str, tuple[int, int], Array, float]] = []
    lines: list[tuple[str, tuple[int, int], Array, Array]] = []
    marks: list[SeenMark] = []
    for c in (c for c in mechanism.constraints.values() if c.parent):
        X_A, X_B = c.frames(mechanism.parameters, system.dim)
        A = poses[c.parent] @ X_A
        B = poses[c.child] @ X_B
        ends = number[c.parent], number[c.child]
        if c.rod:
            p = np.stack([A[:3, 3], B[:3, 3]])
            rods.append(
                (
                    c.name,
                    ends,
                    p,
                    float(np.linalg.norm(p[1] - p[0])) - c.length(mechanism.parameters),
                )
            )
        elif [r.op for r in list_position_rows(c.of, system.dim)] == [Op.POINT] * (system.dim - 1):
            lines.append((c.name, ends, A, B[:3, 3]))
        else:
            marks.append(_make_mark(system, c, number[c.child], A, B))
    return tuple(rods), tuple(lines), tuple(marks)


def _make_mark(system: Model, c: Declared, link: int, A: Array, B: Array) -> SeenMark:
    """Make the symbol of a constraint that is no rod or line, with its plane if it has one."""
    made = evaluate_number_fields(c.of, system.structure.parameters)
    plane = None
    rows = [r for r in made.list_rows(system.dim) if not r.velocity]
    flat = system.dim == 2
    point = bool(rows) and rows[0].op is Op.POINT
    if len(rows) == 1 and (made.symbol in ("contact", "wheel") or (point and not flat)):
        normal = A[:3, rows[0].args[0] if point else 1 if flat else 2]
        plane = B[:3, 3] - normal * float(normal @ (B - A)[:3, 3]), normal
    radius = float(getattr(made, "radius", None) or 0.0)
    return SeenMark(
        c.name, link, B, made.symbol, plane, radius, getattr(made, "shape", "") == "disc"
    )


def compute_travel(
    scene: Scene, joint: SeenJoint, configurations: Array | None
) -> tuple[float, float]:
    """Compute the smallest and largest slide [m] of a prismatic joint over configurations (n, nq)."""
    system = scene.system
    values = [float(compute_coordinate_value(system, scene.q, joint.name))]
    if configurations is not None:
        along = np.asarray(compute_coordinate_value(system, configurations, joint.name))
        values += [float(x) for x in along[np.isfinite(along)]]
    values += [x for x in joint.limits if np.isfinite(x)] if np.isfinite(joint.limits).all() else []
    return min(values), max(values)
