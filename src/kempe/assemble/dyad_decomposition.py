"""Decomposition of a planar mechanism into dyads, and the program that solves them in turn.

A dyad is an Assur group of two rigid clusters of bodies, which three joints connect.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.budget import check_for_stop
from kempe.constraints.base import Op, list_position_rows
from kempe.description.parts import Declared
from kempe.equations.judge import compute_joint_pose
from kempe.joints import P, Primitive, R
from kempe.kernels.dyads import dyads_layout as K
from kempe.model.coordinates import list_coordinate_names
from kempe.model.structural_order import make_sort_key
from kempe.spatial import Array
from kempe.words import InWords

if TYPE_CHECKING:
    from kempe.description.parts import Joint
    from kempe.model.coordinates import Relation
    from kempe.model.model import Model


# ---- parts, links and hinges of a planar system

# Bodies that cannot move against each other form one rigid *cluster*. A joint whose coordinate is
# known merges two clusters; three clusters, joined in a circle by three joints of one freedom, are
# rigid and merge too: with the ground among them that is a dyad (Assur, 1914), without it the
# closed form is the same. Two clusters joined twice are over-constrained: two joints place them,
# the rest is checked. Revolute joints that share a point of a body are one hinge of several bodies,
# so it does not matter which pairs of them the description names.

NOWHERE = -1
"""In place of the number of a coordinate, or of a body: there is none."""
SAME = 1e-12
"""Points nearer than this share of the mechanism's size are one, and directions nearer than this
are parallel."""

Number = Any
"""A number, or one of each design (n,): designs differ in their lengths and angles, and share one
decomposition, as they share bodies and joints."""
Pose = tuple[Number, Number, Number, Number]
"""A pose in the plane: cosine and sine of the orientation, origin."""


@dataclass(frozen=True)
class PartLine:
    """A point (x, y) and a direction (dx, dy) on a part."""

    part: int
    x: Number
    y: Number
    dx: Number = 1.0
    dy: Number = 0.0

    @property
    def numbers(self) -> tuple[Number, Number]:
        """Coordinates (x, y) of the point, as operands of a program."""
        return self.x, self.y

    @property
    def rail(self) -> Pose:
        """Coordinates of point and direction (x, y, dx, dy), as operands of a program."""
        return self.x, self.y, self.dx, self.dy


@dataclass(frozen=True)
class Link:
    """A joint of one freedom between two parts: frames F on the first and M on the second.

    A revolute joint turns by multiplier * q[slot] + offset, a prismatic one slides by that along x
    of F. Constraints that are not joints have links too, whose motion is no coordinate: their slot
    is NOWHERE.
    """

    name: str
    kind: int
    a: int
    b: int
    F: Pose
    M: Pose
    slot: int
    multiplier: float
    offset: float

    def make_rails(self, base_is_a: bool) -> tuple[PartLine, PartLine]:
        """Return the rails of a prismatic joint on the base and on the sliding part.

        The joint's coordinate grows along both.
        """
        a = PartLine(self.a, *self.F[2:], *self.F[:2])
        b = PartLine(self.b, *self.M[2:], *self.M[:2])
        return (a, b) if base_is_a else (_reverse_direction(b), _reverse_direction(a))


def _reverse_direction(end: PartLine) -> PartLine:
    """Return the point with the opposite direction."""
    return PartLine(end.part, end.x, end.y, -end.dx, -end.dy)


@dataclass(frozen=True)
class Parts:
    """The graph that is decomposed: parts (bodies without motion between them), links and hinges.

    A distance between two points is a part too, a rod on two pins, and a point on a line a block on
    a rail and a pin. `hinges` are lists of ends that coincide, with the names of their joints;
    `reps` the body whose frame is the part's; `misfit` the largest opening of a loop of fixed
    joints; `trouble` says why there is no such graph.
    """

    names: tuple[tuple[str, ...], ...] = ()
    reps: tuple[int, ...] = ()
    links: tuple[Link, ...] = ()
    hinges: tuple[tuple[tuple[str, ...], tuple[PartLine, ...]], ...] = ()
    size: Number = 1.0
    misfit: Number = 0.0
    trouble: str = ""


@dataclass(frozen=True)
class Dyad(InWords):
    """A dyad: the types of its three joints, and the meaning of its branch sign.

    `bodies` are those of the two clusters that it places; `joints` lie between base and first,
    first and second, and second and base. `sign` is its number among the branch signs, None where
    there is one root only. For `branch_of`: the signed height of `ends[2]` above the line from
    `ends[0]` to `ends[1]`, or, with `along`, the distance from `ends[0]` to `ends[2]` along the
    direction of `ends[1]`.
    """

    kind: str
    base: int
    bodies: tuple[tuple[str, ...], tuple[str, ...]]
    joints: tuple[str, str, str]
    sign: int | None = None
    meaning: str = ""
    ends: tuple[PartLine, ...] = ()
    along: bool = False

    def __str__(self) -> str:
        first, second = (", ".join(b) for b in self.bodies)
        text = f"{self.kind} dyad of {first} and {second}, joints {', '.join(self.joints)}"
        return f"{text}: {self.meaning}"


def multiply_poses(a: Pose, b: Pose) -> Pose:
    """Multiply two planar poses."""
    c, s, x, y = a
    return (
        c * b[0] - s * b[1],
        s * b[0] + c * b[1],
        x + c * b[2] - s * b[3],
        y + s * b[2] + c * b[3],
    )


def invert_pose(a: Pose) -> Pose:
    """Invert a planar pose."""
    c, s, x, y = a
    return c, -s, -(c * x + s * y), s * x - c * y


def turn_pose(a: Pose, angle: float) -> Pose:
    """Turn a planar pose by an angle [rad] about its own origin."""
    return multiply_poses(a, (math.cos(angle), math.sin(angle), 0.0, 0.0))


def _flatten_pose(X: Array) -> Pose:
    """Return a pose (4, 4) that lies in the plane as a planar pose."""
    return X[..., 0, 0], X[..., 1, 0], X[..., 0, 3], X[..., 1, 3]


def _make_rail_pose(X: Array, axis: int = 2) -> Pose:
    """Return the planar pose whose x axis is the given axis (default z) of X (4, 4)."""
    dx = X[..., 0, axis]
    dy = X[..., 1, axis]
    n = np.hypot(dx, dy)
    return dx / n, dy / n, X[..., 0, 3], X[..., 1, 3]


def _is_point_on_line(constraint: Declared) -> bool:
    """Return whether a constraint of the plane holds a point on a line, and nothing else."""
    return [(r.op, r.args) for r in list_position_rows(constraint.of, 2)] == [(Op.POINT, (1,))]


def find_single_motion(joint: Joint) -> Primitive | None:
    """Return the only motion of a planar joint, a turn or a slide; None if it has several."""
    primitives = joint.type.layout(2)[1]
    return primitives[0] if len(primitives) == 1 and primitives[0].multiplier == 1.0 else None


def build_parts(system: Model, parameters: Mapping[str, Number]) -> Parts:
    """Build the graph of a planar system, for values of its parameters: parts, links and hinges."""
    mechanism = system.mechanism
    if system.dim != 2:
        return Parts(trouble=f"{system.name!r} is not planar")
    particles = [b.name for b in mechanism.bodies.values() if b.particle]
    if particles:
        return Parts(trouble=f"{particles[0]!r} is a particle")
    other = [
        c
        for c in mechanism.constraints.values()
        if c.count_equations(2) and not (c.rod or _is_point_on_line(c))
    ]
    if other:
        return Parts(trouble=f"constraint {other[0].name!r} is of kind {other[0].kind}")
    held: dict[str, tuple[str, str, Pose]] = {}
    moving: list[Joint] = []
    for name in sorted(mechanism.joints, key=make_sort_key):
        joint = mechanism.joints[name]
        followers = [
            system.structure.couplings.get(c) for c in list_coordinate_names(mechanism, joint)
        ]
        if all(f is not None and f.source is None for f in followers):
            values = np.array([f.offset for f in followers if f is not None])
            X_PF, X_CM = (X.evaluate_pose(parameters) for X in (joint.X_PF, joint.X_CM))
            X_PC = X_PF @ compute_joint_pose(joint.type, values, 2) @ np.linalg.inv(X_CM)
            held[name] = joint.parent, joint.child, _flatten_pose(X_PC)
        elif find_single_motion(joint) is not None:
            moving.append(joint)
        else:
            return Parts(trouble=f"joint {name!r} is of type {joint.type.type_name}")
    return _connect_parts(system, held, moving, parameters)


def _connect_parts(
    system: Model,
    held: dict[str, tuple[str, str, Pose]],
    moving: list[Joint],
    parameters: Mapping[str, Number],
) -> Parts:
    """Build the graph from fixed joints `held` and moving joints."""
    order = [system.body_names[0], *sorted(system.body_names[1:], key=make_sort_key)]
    at, groups, misfit = _merge_fixed_bodies(order, held)
    number = {b: i for i, b in enumerate(system.body_names)}
    slots = {c: i for i, c in enumerate(system.coordinate_names)}
    mechanism = system.mechanism  # a copy: it takes long
    links: list[Link] = []
    for joint in moving:
        (a, X_A) = at[joint.parent]
        (b, X_B) = at[joint.child]
        X_PF = joint.X_PF.evaluate_pose(parameters)
        X_CM = joint.X_CM.evaluate_pose(parameters)
        motion = find_single_motion(joint)
        assert motion is not None
        turns = motion.kind == R
        axis = "xyz".index(motion.axis)
        F, M = (
            multiply_poses(X, _flatten_pose(Y) if turns else _make_rail_pose(Y, axis))
            for X, Y in ((X_A, X_PF), (X_B, X_CM))
        )
        source = list_coordinate_names(mechanism, joint)[0]
        multiplier = 1.0
        offset = 0.0
        follower = system.structure.couplings.get(source)
        if follower is not None:
            source = follower.source or ""
            multiplier = follower.multiplier
            offset = follower.offset
        links.append(
            Link(joint.name, R if turns else P, a, b, F, M, slots[source], multiplier, offset)
        )
    constraints = mechanism.constraints
    for name in sorted(
        (n for n, c in constraints.items() if c.count_equations(2)), key=make_sort_key
    ):
        links += _make_constraint_links(constraints[name], len(groups), at, parameters)
        groups.append([name])
    size = _measure_parts(links)
    hinges = _group_hinges([k for k in links if k.kind == R], links, SAME * size)
    reps = tuple(number.get(g[0], NOWHERE) for g in groups)
    return Parts(tuple(tuple(g) for g in groups), reps, tuple(links), hinges, size, misfit)


def _make_constraint_links(
    constraint: Declared,
    part: int,
    at: dict[str, tuple[int, Pose]],
    parameters: Mapping[str, Number],
) -> list[Link]:
    """Return the two links of a distance or point-on-line constraint, which is a part itself."""
    name = constraint.name
    (a, X_A) = at[constraint.parent]
    (b, X_B) = at[constraint.child]
    X_PF, X_CM = constraint.frames(parameters, 2)
    here, there = (f"{name} ({body})" for body in (constraint.parent, constraint.child))
    start = (1.0, 0.0, 0.0, 0.0)
    end = multiply_poses(X_B, _flatten_pose(X_CM))
    length: Number = 0.0
    if constraint.rod:
        first = Link(
            here, R, a, part, multiply_poses(X_A, _flatten_pose(X_PF)), start, NOWHERE, 1.0, 0.0
        )
        length = constraint.length(parameters)
    else:
        first = Link(
            here, P, a, part, multiply_poses(X_A, _make_rail_pose(X_PF)), start, NOWHERE, 1.0, 0.0
        )
    return [first, Link(there, R, part, b, (1.0, 0.0, length, 0.0), end, NOWHERE, 1.0, 0.0)]


def _merge_fixed_bodies(
    order: list[str], held: dict[str, tuple[str, str, Pose]]
) -> tuple[dict[str, tuple[int, Pose]], list[list[str]], Number]:
    """Merge bodies that fixed joints connect into parts.

    Returns part and pose of each body, the bodies of each part, and the largest misfit of a loop of
    fixed joints.
    """
    ways: dict[str, list[tuple[str, Pose]]] = {b: [] for b in order}
    for parent, child, X in held.values():
        ways[parent].append((child, X))
        ways[child].append((parent, invert_pose(X)))
    at: dict[str, tuple[int, Pose]] = {}
    groups: list[list[str]] = []
    misfit: Number = 0.0
    for start in order:
        if start in at:
            continue
        at[start] = len(groups), (1.0, 0.0, 0.0, 0.0)
        groups.append([start])
        for here in groups[-1]:  # grows on the way
            for there, X in ways[here]:
                pose = multiply_poses(at[here][1], X)
                if there not in at:
                    at[there] = len(groups) - 1, pose
                    groups[-1].append(there)
                for u, w in zip(pose, at[there][1], strict=True):
                    misfit = np.maximum(misfit, abs(u - w))
    return at, groups, misfit


def _measure_parts(links: list[Link]) -> Number:
    """Return the largest distance of two joints on one part; 1 where there is none."""
    points: dict[int, list[tuple[Number, Number]]] = {}
    for k in links:
        points.setdefault(k.a, []).append(k.F[2:])
        points.setdefault(k.b, []).append(k.M[2:])
    size: Number = 0.0
    for ends in points.values():
        spans = (np.ptp(np.stack(np.broadcast_arrays(*x)), axis=0) for x in zip(*ends, strict=True))
        size = np.maximum(size, np.hypot(*spans))
    return np.where(size > 0.0, size, 1.0)[()]


def _coincide(p: tuple[Number, Number], q: tuple[Number, Number], same: Number) -> bool:
    """Return whether two points of a part are one, in all designs."""
    return not np.any(np.hypot(p[0] - q[0], p[1] - q[1]) > same)


def _take_first(x: Number) -> float:
    """Return a number, or that of the first design."""
    return float(np.ravel(x)[0])


def _group_hinges(
    pins: list[Link], links: list[Link], same: Number
) -> tuple[tuple[tuple[str, ...], tuple[PartLine, ...]], ...]:
    """Group the revolute joints that share a point of a part with several points."""
    points: dict[int, list[tuple[int, tuple[Number, Number]]]] = {}
    for i, k in enumerate(pins):
        points.setdefault(k.a, []).append((i, k.F[2:]))
        points.setdefault(k.b, []).append((i, k.M[2:]))
    slides = {p for k in links if k.kind == P for p in (k.a, k.b)}
    root = list(range(len(pins)))

    def find_root(i: int) -> int:
        """Return the representative of the group of a joint (union-find)."""
        while root[i] != i:
            root[i] = i = root[root[i]]
        return i

    for part, ends in points.items():
        if part not in slides and all(_coincide(p, ends[0][1], same) for _, p in ends):
            # a link without length: to merge its ends would leave its orientation to nothing
            continue
        ends.sort(key=lambda e: _take_first(e[1][0]))
        for n, (i, p) in enumerate(ends):
            for j, q in ends[n + 1 :]:
                if _take_first(q[0] - p[0] - same) > 0.0:
                    break
                if _coincide(p, q, same):
                    root[max(find_root(i), find_root(j))] = min(find_root(i), find_root(j))
    groups: dict[int, list[int]] = {}
    for i in range(len(pins)):
        groups.setdefault(find_root(i), []).append(i)
    out: list[tuple[tuple[str, ...], tuple[PartLine, ...]]] = []
    for group in groups.values():
        ends_of: dict[int, PartLine] = {}
        for k in (pins[i] for i in group):
            ends_of.setdefault(k.a, PartLine(k.a, *k.F[2:]))
            ends_of.setdefault(k.b, PartLine(k.b, *k.M[2:]))
        out.append((tuple(pins[i].name for i in group), tuple(ends_of.values())))
    return tuple(out)


# ---- the program for the dyad kernel


class Code:
    """A program for the dyad kernel under construction: operations and memory addresses."""

    def __init__(self, n_parts: int, nq: int):
        self.registers = n_parts + 3
        self.nq = nq
        self.n_parts = n_parts
        self.signs = 0
        self.ops: list[tuple[list[int], list[Number]]] = []

    def get_register(self, part: int) -> int:
        """Return the address of a part's pose.

        Parts beyond the last are the three working registers.
        """
        return K.REGISTERS + 4 * part

    def get_coordinate(self, slot: int) -> int:
        """Return the address of a coordinate."""
        return K.REGISTERS + 4 * self.registers + slot

    def get_target(self, slot: int) -> int:
        """Return the address of the value near which a coordinate is chosen."""
        return self.get_coordinate(self.nq) + slot

    def add_sign(self) -> int:
        """Add a branch sign and return its address."""
        self.signs += 1
        return self.get_target(self.nq) + self.signs - 1

    def append_operation(self, code: int, ints: list[int], floats: object = ()) -> None:
        """Append an operation: its number in `dyads_layout` with integer and float operands."""
        self.ops.append(([code, *ints], list(floats)))  # type: ignore[call-overload]

    def append_pin_operation(
        self, code: int, ends: list[PartLine], more: list[int], rails: int = 0
    ) -> None:
        """Append an operation on points of parts, the first `rails` of which are rails."""
        floats = [x for i, e in enumerate(ends) for x in (e.rail if i < rails else e.numbers)]
        self.append_operation(code, [*(self.get_register(e.part) for e in ends), *more], floats)

    def pack_arrays(self, known: list[int]) -> tuple[np.ndarray, Array]:
        """Pack the program into the integers that the kernel reads, and floats (k,) or (n, k)."""
        n = len(self.ops)
        spare = self.get_target(self.nq) + self.signs
        head = [n, spare + 1, self.registers, self.nq, len(known), self.signs]
        head += [self.get_coordinate(0), self.get_target(0), self.get_target(self.nq)]
        ints = np.zeros(K.HEADER + len(known) + K.OP_INTS * n, dtype=np.int64)
        lead = np.broadcast_shapes(*(np.shape(x) for _, numbers in self.ops for x in numbers))
        floats = np.zeros((*lead, K.OP_FLOATS * n))
        ints[: len(head)] = head
        ints[K.HEADER : K.HEADER + len(known)] = known
        for k, (i, f) in enumerate(self.ops):
            at = K.HEADER + len(known) + K.OP_INTS * k
            ints[at : at + len(i)] = i
            for j, x in enumerate(f):
                floats[..., K.OP_FLOATS * k + j] = x
        return ints, floats


def unpack_program(
    program: tuple[np.ndarray, Array],
) -> tuple[list[int], list[tuple[list[int], list[float]]]]:
    """Unpack a program: indices of its known coordinates, and its operations.

    An operation has integer and float operands.
    """
    ints: list[int] = program[0].tolist()
    floats: list[float] = program[1].tolist()
    start = K.HEADER + ints[K.N_KNOWN]
    each = range(ints[K.N_OPS])
    ops = [
        (ints[start + K.OP_INTS * k :][: K.OP_INTS], floats[K.OP_FLOATS * k :][: K.OP_FLOATS])
        for k in each
    ]
    return ints[K.HEADER : start], ops


# ---- the search for dyads

Edge = tuple[int, int]
"""What joins clusters: (R, number of a hinge) or (P, number of a link)."""

GROUND = 0


class Decomposition:
    """Decomposition of a mechanism: rigid clusters that grow with each solved dyad.

    `code` is the program so far, `dyads` those it solves.
    """

    def __init__(self, system: Model, parts: Parts, known: list[int]):
        self.parts = parts
        self.system = system
        n = len(parts.names)
        self.code = Code(n, system.nq)
        self.dyads: list[Dyad] = []
        self.cluster = list(range(n))
        self.members: dict[int, list[int]] = {p: [p] for p in range(n)}
        self.incident: list[list[Edge]] = [[] for _ in range(n)]
        self.of_part: list[list[int]] = [[] for _ in range(n)]
        self.by_slot: dict[int, list[int]] = {}
        for h, (_, ends) in enumerate(parts.hinges):
            for end in ends:
                self.incident[end.part].append((R, h))
        for i, link in enumerate(parts.links):
            if link.slot != NOWHERE:
                self.by_slot.setdefault(link.slot, []).append(i)
            for part in {link.a, link.b}:
                self.of_part[part].append(i)
                if link.kind == P:
                    self.incident[part].append((P, i))
        self.done: set[int] = set()
        self.known: set[int] = set()
        self.drives: deque[int] = deque()
        self.near: deque[int] = deque(range(n))
        self.relations: list[Relation] = list(system.structure.relations)
        self.number = {link.name: i for i, link in enumerate(parts.links)}
        layout = system.structure.layout
        bounds = zip(
            layout.vector_q.tolist(), system.structure.limits[layout.vector_v].tolist(), strict=True
        )
        self.limits: dict[int, list[float]] = {NOWHERE: [-math.inf, math.inf], **dict(bounds)}
        if np.any(parts.misfit > 0.0):
            self._append_check(parts.misfit, {})
        for part in range(n):
            self._read_closed_joints([part])
        for slot in known:
            self._learn_coordinate(slot)

    def close_dyads(self) -> list[int]:
        """Solve dyads until no further one is found.

        Returns the clusters that remain beside the ground's.
        """
        while (
            self._merge_driven_joint()
            or self._use_relation()
            or self._close_grounded_dyad()
            or self._close_floating_dyad()
        ):
            check_for_stop()
        return [c for c in self.members if c != GROUND]

    def count_freedoms(self) -> int:
        """Count the degrees of freedom of the clusters against each other (Gruebler, 1883)."""
        count = 3 * (len(self.members) - 1)
        for _, ends in self.parts.hinges:
            count -= 2 * (len({self.cluster[e.part] for e in ends}) - 1)
        for link in self.parts.links:
            count -= 2 * (link.kind == P and self.cluster[link.a] != self.cluster[link.b])
        return count - len(self.relations)

    # ---- what is known

    def _learn_coordinate(self, slot: int) -> None:
        """Note that a coordinate is known."""
        if slot not in self.known and slot != NOWHERE:
            self.known.add(slot)
            self.drives += self.by_slot.get(slot, [])

    def _use_relation(self) -> bool:
        """Use a relation of coordinates to compute its one unknown, or as a check if it has none.

        Returns whether one was used.
        """
        slots = {c: i for i, c in enumerate(self.system.coordinate_names)} if self.relations else {}
        for relation in self.relations:
            terms = {slots[relation.of]: 1.0, **{slots[k]: -m for k, m in relation.sources.items()}}
            unknown = [s for s in terms if s not in self.known]
            if len(unknown) > 1:
                continue
            self.relations.remove(relation)
            if not unknown:
                self._append_check(-relation.offset, terms)
                return True
            c = terms.pop(unknown[0])
            place = self.code.get_coordinate(unknown[0])
            self.code.append_operation(K.SET, [place], [relation.offset / c])
            for slot, m in terms.items():
                self.code.append_operation(K.ADD, [place, self.code.get_coordinate(slot)], [-m / c])
            self._learn_coordinate(unknown[0])
            return True
        return False

    def _append_check(self, constant: Number, terms: dict[int, float]) -> None:
        """Append a check to the program: a constant plus multiples of coordinates is zero."""
        self.code.append_operation(K.SET, [K.SPARE], [constant])
        for slot, m in terms.items():
            self.code.append_operation(K.ADD, [K.SPARE, self.code.get_coordinate(slot)], [m])
        self.code.append_operation(K.EXPECT_ZERO, [K.SPARE], [self.parts.size])

    def _merge_driven_joint(self) -> bool:
        """Merge the two clusters of a joint with a known coordinate; return whether there is one."""
        while self.drives:
            i = self.drives.popleft()
            link = self.parts.links[i]
            a = self.cluster[link.a]
            b = self.cluster[link.b]
            if i in self.done or a == b:
                continue
            self.done.add(i)
            base, other = self._sort_clusters(a, b)
            forward = base == a
            start, end = (link.F, link.M) if forward else (link.M, link.F)
            sign = 1.0 if forward else -1.0
            start = _move_pose(link.kind, start, sign * link.offset)
            part, on = (link.b, link.a) if forward else (link.a, link.b)
            out = self._choose_register(other, 0)
            numbers = [sign * link.multiplier, *start, *invert_pose(end)]
            register = self.code.get_register
            coordinate = self.code.get_coordinate(link.slot)
            self.code.append_operation(
                K.TURN if link.kind == R else K.SLIDE, [out, register(on), coordinate], numbers
            )
            if len(self.members[other]) > 1:
                self.code.append_operation(K.DIVIDE, [out, register(part)])
            self._join_clusters(base, {other: out})
            return True
        return False

    def _read_closed_joints(self, parts: list[int]) -> None:
        """Read, or check, the joints of these parts whose two bodies are in the same cluster."""
        for part in parts:
            for i in self.of_part[part]:
                link = self.parts.links[i]
                if i not in self.done and self.cluster[link.a] == self.cluster[link.b]:
                    self.done.add(i)
                    self._read_joint(link)

    def _read_joint(self, link: Link) -> None:
        """Append the operation that reads, or checks, the coordinate of a joint."""
        code = self.code
        size = self.parts.size
        check = link.slot in self.known
        ints = [code.get_register(link.a), code.get_register(link.b), K.SPARE, K.SPARE + 1, False]
        if link.slot != NOWHERE:
            ints[2:] = code.get_coordinate(link.slot), code.get_target(link.slot), check
        m = link.multiplier
        o = link.offset
        if link.kind == R:
            between = multiply_poses(
                (link.F[0], -link.F[1], 0.0, 0.0), (link.M[0], link.M[1], 0.0, 0.0)
            )
            numbers = [
                *between[:2],
                1.0 / m,
                -o / m,
                2.0 * math.pi / abs(m),
                *self.limits[link.slot],
            ]
            code.append_operation(
                K.READ_TURN, ints, [*numbers, *link.F[2:], *link.M[2:], abs(m) * size]
            )
        else:
            a, b = link.make_rails(True)
            code.append_operation(
                K.READ_SLIDE, ints, [*a.rail, *b.rail, 1.0 / m, -o / m, abs(m), size]
            )
        self._learn_coordinate(link.slot)

    # ---- clusters

    def _sort_clusters(self, *clusters: int) -> list[int]:
        """Sort clusters: the ground first, then by number of parts."""
        return sorted(clusters, key=lambda c: (c != GROUND, -len(self.members[c]), c))

    def _choose_register(self, cluster: int, spare: int) -> int:
        """Choose the register for the pose of a cluster.

        It is that of its only part, or a spare one where the cluster has several parts.
        """
        members = self.members[cluster]
        return self.code.get_register(
            members[0] if len(members) == 1 else self.code.n_parts + spare
        )

    def _join_clusters(self, base: int, others: dict[int, int]) -> None:
        """Join clusters to a base cluster; registers hold their poses in its frame."""
        moved: list[int] = []
        for cluster, register in others.items():
            members = self.members.pop(cluster)
            if len(members) > 1:
                for part in members:
                    self.code.append_operation(K.CARRY, [self.code.get_register(part), register])
            for part in members:
                self.cluster[part] = base
            moved += members
        self.members[base] += moved
        self._read_closed_joints(moved)
        self.near += [
            base,
            *(self.cluster[p] for part in moved for p in self._iterate_neighbours(part)),
        ]

    def _iterate_neighbours(self, part: int) -> Iterator[int]:
        """Iterate over the parts that are joined to a part."""
        for edge in self.incident[part]:
            yield from self._list_edge_parts(edge)

    def _list_edge_parts(self, edge: Edge) -> list[int]:
        """Return the parts that an edge joins."""
        kind, k = edge
        return [e.part for e in self.parts.hinges[k][1]] if kind == R else self._list_link_parts(k)

    def _list_link_parts(self, link: int) -> list[int]:
        """Return the two parts of a link."""
        return [self.parts.links[link].a, self.parts.links[link].b]

    def _group_edges(self, cluster: int) -> dict[int, list[Edge]]:
        """Group the joints between a cluster and others, by the other cluster."""
        out: dict[int, list[Edge]] = {}
        for part in self.members[cluster]:
            for edge in self.incident[part]:
                for p in self._list_edge_parts(edge):
                    there = self.cluster[p]
                    if there != cluster and edge not in out.setdefault(there, []):
                        out[there].append(edge)
        return out

    # ---- dyads

    def _close_grounded_dyad(self) -> bool:
        """Close a dyad, or place a cluster, on the ground; return whether one was found."""
        while self.near:
            here = self.near.popleft()
            if here == GROUND or here not in self.members:
                continue
            edges = self._group_edges(here)
            if GROUND not in edges:
                continue
            if self._place_cluster(GROUND, here, edges[GROUND]):
                return True
            for there in sorted(edges):
                if there != GROUND and self._close_dyad(GROUND, here, there, edges):
                    return True
        return False

    def _close_floating_dyad(self) -> bool:
        """Close a dyad, or place a cluster, without the ground; return whether one was found."""
        for here in list(self.members):
            if here == GROUND:
                continue
            edges = self._group_edges(here)
            others = sorted(c for c in edges if c != GROUND)
            for there in others:
                base, other = self._sort_clusters(here, there)
                if self._place_cluster(base, other, edges[there]):
                    return True
            for k, a in enumerate(others):
                known = self._group_edges(a)
                for b in others[k + 1 :]:
                    if b in known:
                        base, *rest = self._sort_clusters(here, a, b)
                        if self._close_dyad(base, rest[0], rest[1], self._group_edges(rest[0])):
                            return True
        return False

    def _place_cluster(self, base: int, other: int, edges: list[Edge]) -> bool:
        """Place a cluster by two of its joints to another one; return whether that is possible.

        Contradictions of further joints show when these are read.
        """
        pins = [e for e in edges if e[0] == R]
        rails = [e for e in edges if e[0] == P]
        out = self._choose_register(other, 0)
        if len(pins) > 1:
            a, b = (self._find_hinge_ends(e, base, other) for e in pins[:2])
            self.code.append_pin_operation(K.PIN_PIN, [a[0], b[0], a[1], b[1]], [out])
        elif pins and rails:
            self.code.append_pin_operation(
                K.PIN_RAIL,
                [*self._find_rails(rails[0], base), *self._find_hinge_ends(pins[0], base, other)],
                [out],
                2,
            )
        else:
            ends = [self._find_rails(e, base) for e in rails]
            crossing = next((e for e in ends[1:] if not _are_parallel(ends[0][0], e[0])), None)
            if crossing is None:
                return False
            self.code.append_pin_operation(K.RAIL_RAIL, [*ends[0], *crossing], [out], 4)
        self._join_clusters(base, {other: out})
        return True

    def _close_dyad(self, base: int, first: int, second: int, edges: dict[int, list[Edge]]) -> bool:
        """Close the dyad of three clusters if its joints make it rigid; return whether they do."""
        back = self._group_edges(second).get(base, [])
        for group in product(edges.get(base, []), edges.get(second, []), back):
            hinges = [k for kind, k in group if kind == R]
            if len(set(hinges)) < len(hinges) or not hinges:
                continue
            if group[2] < group[0]:
                first, second, group = second, first, group[::-1]
            if len(hinges) == 3:
                self._close_three_hinges(base, first, second, group)
            elif len(hinges) == 2:
                self._close_slider_bar(base, first, second, group)
            elif not self._close_two_sliders(base, first, second, group):
                continue
            return True
        return False

    def _close_three_hinges(
        self, base: int, first: int, second: int, group: tuple[Edge, ...]
    ) -> None:
        """Append the operations of a dyad with three hinges, an intersection of two circles."""
        (a, a1) = self._find_hinge_ends(group[0], base, first)
        (b1, b2) = self._find_hinge_ends(group[1], first, second)
        (c, c2) = self._find_hinge_ends(group[2], base, second)
        sign = self.code.add_sign()
        outs = [self._choose_register(first, 0), self._choose_register(second, 1)]
        self.code.append_pin_operation(K.CIRCLES, [a, c, a1, b1, b2, c2], [sign, *outs])
        A, B, C = self._list_joint_names(base, first, second, group)
        meaning = f"+ where {B} lies to the left of the way from {A} to {C}"
        ends = (
            self._find_body_end(group[0], a),
            self._find_body_end(group[2], c),
            self._find_body_end(group[1], b1),
        )
        self._record_dyad(base, first, second, group, meaning, ends, False)
        self._join_clusters(base, {first: outs[0], second: outs[1]})

    def _close_slider_bar(
        self, base: int, first: int, second: int, group: tuple[Edge, ...]
    ) -> None:
        """Append the operations of a dyad with one slide, an intersection of line and circle."""
        rail = next(e for e in group if e[0] == P)
        clusters = {self.cluster[p] for p in self._list_link_parts(rail[1])}
        link = self.parts.links[rail[1]]
        still = base if base in clusters else self.cluster[link.a]
        slider = next(c for c in clusters if c != still)
        other = next(c for c in (base, first, second) if c not in clusters)
        pairs = (base, first), (first, second), (second, base)
        between = {frozenset(pair): e for pair, e in zip(pairs, group, strict=True)}
        moving = between[frozenset((slider, other))]
        fixed = between[frozenset((still, other))]
        b1, b2 = self._find_hinge_ends(moving, slider, other)
        a, a2 = self._find_hinge_ends(fixed, still, other)
        rails = self._find_rails(rail, still)
        sign, outs, rebase = (
            self.code.add_sign(),
            *self._choose_registers(base, still, slider, other),
        )
        self.code.append_pin_operation(
            K.LINE_CIRCLE, [*rails, b1, b2, a2, a], [sign, *outs.values()], 2
        )
        meaning = f"+ where {link.name} slides farther than where its two roots meet"
        pins = self._find_body_end(fixed, a), self._find_body_end(moving, b1)
        if self.cluster[link.a] != still:
            pins = pins[::-1]
        self._record_dyad(
            base, first, second, group, meaning, (pins[0], link.make_rails(True)[0], pins[1]), True
        )
        self._finish_dyad(base, outs, rebase)

    def _close_two_sliders(
        self, base: int, first: int, second: int, group: tuple[Edge, ...]
    ) -> bool:
        """Append the operations of a dyad with two slides, an intersection of two lines."""
        rails = [e for e in group if e[0] == P]
        sides = [{self.cluster[p] for p in self._list_link_parts(e[1])} for e in rails]
        still = next(iter(sides[0] & sides[1]))
        y, z = (next(c for c in s if c != still) for s in sides)
        one = self._find_rails(rails[0], still)
        two = self._find_rails(rails[1], still)
        if _are_parallel(one[0], two[0]):
            return False
        pins = self._find_hinge_ends(next(e for e in group if e[0] == R), y, z)
        outs, rebase = self._choose_registers(base, still, y, z)
        self.code.append_pin_operation(K.LINES, [*one, *two, *pins], list(outs.values()), 4)
        self._record_dyad(base, first, second, group, "one root only", (), False, None)
        self._finish_dyad(base, outs, rebase)
        return True

    def _choose_registers(
        self, base: int, still: int, y: int, z: int
    ) -> tuple[dict[int, int], tuple[int, int] | None]:
        """Choose registers for the poses of clusters y and z seen from `still`.

        Where `still` is not the base, also returns the pair of clusters whose poses must be
        inverted.
        """
        if still == base:
            return {y: self._choose_register(y, 0), z: self._choose_register(z, 1)}, None
        spare = {c: self.code.get_register(self.code.n_parts + k) for k, c in enumerate((y, z))}
        return spare, (still, y if z == base else z)

    def _finish_dyad(self, base: int, outs: dict[int, int], rebase: tuple[int, int] | None) -> None:
        """Express the poses of a dyad in the frame of its base, and join its clusters."""
        if rebase is not None:
            still, other = rebase
            new = {
                still: self._choose_register(still, 2),
                other: self._choose_register(other, 0 if len(self.members[other]) == 1 else 1),
            }
            self.code.append_operation(K.REBASE, [outs[base], outs[other], new[still], new[other]])
            outs = new
        self._join_clusters(base, outs)

    def _record_dyad(
        self,
        base: int,
        first: int,
        second: int,
        group: tuple[Edge, ...],
        meaning: str,
        ends: tuple[PartLine, ...],
        along: bool,
        sign: int | None = 0,
    ) -> None:
        """Record a dyad with its joint types, bodies, joints and branch sign."""
        bodies = tuple(
            tuple(b for p in self.members[c] for b in self.parts.names[p]) for c in (first, second)
        )
        kind = "".join("RP"[e[0] == P] for e in group)
        number = None if sign is None else self.code.signs - 1
        names = self._list_joint_names(base, first, second, group)
        root = next(
            (self.parts.reps[p] for p in self.members[base] if self.parts.reps[p] != NOWHERE), 0
        )
        self.dyads.append(Dyad(kind, root, bodies, names, number, meaning, ends, along))  # type: ignore[arg-type]

    def _list_joint_names(
        self, base: int, first: int, second: int, group: tuple[Edge, ...]
    ) -> tuple[str, str, str]:
        """Return the names of the three joints of a dyad.

        Of a hinge of several bodies, a joint that connects the two clusters is preferred.
        """
        names: list[str] = []
        for (kind, k), pair in zip(
            group, ({base, first}, {first, second}, {second, base}), strict=True
        ):
            if kind == P:
                names.append(self.parts.links[k].name)
                continue
            here = self.parts.hinges[k][0]
            direct = [
                n
                for n in here
                if {self.cluster[p] for p in self._list_link_parts(self.number[n])} == pair
            ]
            names.append((direct or list(here))[0])
        return names[0], names[1], names[2]

    def _find_hinge_ends(self, edge: Edge, one: int, two: int) -> tuple[PartLine, PartLine]:
        """Return the points of a hinge on two clusters."""
        ends = self.parts.hinges[edge[1]][1]
        a, b = (next(e for e in ends if self.cluster[e.part] == c) for c in (one, two))
        return a, b

    def _find_body_end(self, edge: Edge, end: PartLine) -> PartLine:
        """Return the point of a hinge, or another one of it that is on a body."""
        ends = (end, *self.parts.hinges[edge[1]][1])
        return next(e for e in ends if self.parts.reps[e.part] != NOWHERE)

    def _find_rails(self, edge: Edge, base: int) -> tuple[PartLine, PartLine]:
        """Return the rails of a prismatic joint on the base and on the sliding cluster."""
        link = self.parts.links[edge[1]]
        return link.make_rails(self.cluster[link.a] == base)


def _move_pose(kind: int, pose: Pose, by: float) -> Pose:
    """Return a planar pose after a constant motion of a joint, a turn [rad] or a slide [m]."""
    return turn_pose(pose, by) if kind == R else multiply_poses(pose, (1.0, 0.0, by, 0.0))


def _are_parallel(a: PartLine, b: PartLine) -> bool:
    """Return whether two rails lie on one part and are parallel, in all designs."""
    return a.part == b.part and not np.any(abs(a.dx * b.dy - a.dy * b.dx) > SAME)
