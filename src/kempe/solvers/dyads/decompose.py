"""A planar mechanism as a program of dyads: which dyads of three rigid clusters close one after
another.

Bodies that cannot move against each other form one rigid *cluster*. A joint whose coordinate is
known merges two clusters; three clusters, joined in a circle by three joints of one freedom, are
rigid and merge too: with the ground among them that is a dyad (Assur, 1914), without it the closed
form is the same. Two clusters joined twice are over-constrained: two joints place them, the rest is
checked. Revolute joints that share a point of a body are one hinge of several bodies, so it does
not matter which pairs of them the description names.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kempe.constraints.base import Op, position_rows
from kempe.description.parts import Declared
from kempe.joints import P, Primitive, R
from kempe.kernels.dyads import dyads_layout as K
from kempe.kinematics.closure_errors import joint_pose
from kempe.model.tree.coordinates import coordinate_names
from kempe.model.tree.structural_order import natural
from kempe.spatial import Array
from kempe.words import InWords

if TYPE_CHECKING:
    from kempe.description.parts import Joint
    from kempe.model.system import System

NOWHERE = -1
"""In place of the number of a coordinate, or of a body: there is none."""
SAME = 1e-12
"""Points nearer than this share of the mechanism's size are one, and directions nearer than this
are parallel."""

Pose = tuple[float, float, float, float]
"""A pose in the plane: cosine and sine of the orientation, origin."""


@dataclass(frozen=True)
class PartLine:
    """A point (x, y) and a direction (dx, dy) on a part."""

    part: int
    x: float
    y: float
    dx: float = 1.0
    dy: float = 0.0

    @property
    def numbers(self) -> tuple[float, float]:
        """The point, as a program holds it."""
        return self.x, self.y

    @property
    def rail(self) -> tuple[float, float, float, float]:
        """Point and direction, as a program holds them."""
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

    def rails(self, base_is_a: bool) -> tuple[PartLine, PartLine]:
        """Rails on the base and on what slides; along both the coordinate grows."""
        a = PartLine(self.a, *self.F[2:], *self.F[:2])
        b = PartLine(self.b, *self.M[2:], *self.M[:2])
        return (a, b) if base_is_a else (_against(b), _against(a))


def _against(end: PartLine) -> PartLine:
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
    size: float = 1.0
    misfit: float = 0.0
    trouble: str = ""


@dataclass(frozen=True)
class Dyad(InWords):
    """A dyad that was closed: the joint types on the way round from the base, and what its two
    roots are.

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


def times(a: Pose, b: Pose) -> Pose:
    """The planar pose a b, b in the frame of a."""
    c, s, x, y = a
    return (
        c * b[0] - s * b[1],
        s * b[0] + c * b[1],
        x + c * b[2] - s * b[3],
        y + s * b[2] + c * b[3],
    )


def inverse(a: Pose) -> Pose:
    """The inverse of a pose."""
    c, s, x, y = a
    return c, -s, -(c * x + s * y), s * x - c * y


def turned(a: Pose, angle: float) -> Pose:
    """The planar pose a, turned by an angle [rad] about its own origin."""
    return times(a, (math.cos(angle), math.sin(angle), 0.0, 0.0))


def _flat(X: Array) -> Pose:
    return float(X[0, 0]), float(X[1, 0]), float(X[0, 3]), float(X[1, 3])


def _rail(X: Array, axis: int = 2) -> Pose:
    """Pose whose x axis is the given axis of X, z by default, which lies in the plane."""
    dx = float(X[0, axis])
    dy = float(X[1, axis])
    n = math.hypot(dx, dy)
    return dx / n, dy / n, float(X[0, 3]), float(X[1, 3])


def _slides(constraint: Declared) -> bool:
    """Whether it holds a point on the line along z of frame A, in the plane, and nothing else."""
    return [(r.op, r.args) for r in position_rows(constraint.of, 2)] == [(Op.POINT, (1,))]


def alone(joint: Joint) -> Primitive | None:
    """The only motion of a joint of the plane, a turn or a slide by its coordinate; None of one
    that has several.
    """
    primitives = joint.type.layout(2)[1]
    return primitives[0] if len(primitives) == 1 and primitives[0].multiplier == 1.0 else None


def parts_of(system: System) -> Parts:
    """The parts, links and hinges of a system."""
    mechanism = system.mechanism
    if system.dim != 2:
        return Parts(trouble=f"{system.name!r} is not planar")
    particles = [b.name for b in mechanism.bodies.values() if b.particle]
    if particles:
        return Parts(trouble=f"{particles[0]!r} is a particle")
    other = [
        c for c in mechanism.constraints.values() if c.equations(2) and not (c.rod or _slides(c))
    ]
    if other:
        return Parts(trouble=f"constraint {other[0].name!r} is of kind {other[0].kind}")
    held: dict[str, tuple[str, str, Pose]] = {}
    moving: list[Joint] = []
    for name in sorted(mechanism.joints, key=natural):
        joint = mechanism.joints[name]
        followers = [system.structure.couplings.get(c) for c in coordinate_names(mechanism, joint)]
        if all(f is not None and f.source is None for f in followers):
            values = np.array([f.offset for f in followers if f is not None])
            X_PF, X_CM = (X.evaluate(mechanism.parameters) for X in (joint.X_PF, joint.X_CM))
            X_PC = X_PF @ joint_pose(joint.type, values, 2) @ np.linalg.inv(X_CM)
            held[name] = joint.parent, joint.child, _flat(X_PC)
        elif alone(joint) is not None:
            moving.append(joint)
        else:
            return Parts(trouble=f"joint {name!r} is of type {joint.type.type_name}")
    return _assemble(system, held, moving)


def _assemble(system: System, held: dict[str, tuple[str, str, Pose]], moving: list[Joint]) -> Parts:
    order = [system.body_names[0], *sorted(system.body_names[1:], key=natural)]
    at, groups, misfit = _merge(order, held)
    number = {b: i for i, b in enumerate(system.body_names)}
    slots = {c: i for i, c in enumerate(system.coordinate_names)}
    # a copy: it takes long
    parameters = system.structure.parameters
    mechanism = system.mechanism
    links: list[Link] = []
    for joint in moving:
        (a, X_A) = at[joint.parent]
        (b, X_B) = at[joint.child]
        X_PF = joint.X_PF.evaluate(parameters)
        X_CM = joint.X_CM.evaluate(parameters)
        motion = alone(joint)
        assert motion is not None
        turns = motion.kind == R
        axis = "xyz".index(motion.axis)
        F, M = (
            times(X, _flat(Y) if turns else _rail(Y, axis)) for X, Y in ((X_A, X_PF), (X_B, X_CM))
        )
        source = coordinate_names(mechanism, joint)[0]
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
    for name in sorted((n for n, c in constraints.items() if c.equations(2)), key=natural):
        links += _tie(system, name, len(groups), at)
        groups.append([name])
    size = _size(links)
    hinges = _hinges([k for k in links if k.kind == R], links, SAME * size)
    reps = tuple(number.get(g[0], NOWHERE) for g in groups)
    return Parts(tuple(tuple(g) for g in groups), reps, tuple(links), hinges, size, misfit)


def _tie(system: System, name: str, part: int, at: dict[str, tuple[int, Pose]]) -> list[Link]:
    """The two links of a constraint, on a part of its own."""
    constraint = system._mechanism.constraints[name]
    parameters = system.structure.parameters
    (a, X_A) = at[constraint.parent]
    (b, X_B) = at[constraint.child]
    X_PF, X_CM = constraint.frames(parameters, 2)
    here, there = (f"{name} ({body})" for body in (constraint.parent, constraint.child))
    start = (1.0, 0.0, 0.0, 0.0)
    end = times(X_B, _flat(X_CM))
    length = 0.0
    if constraint.rod:
        first = Link(here, R, a, part, times(X_A, _flat(X_PF)), start, NOWHERE, 1.0, 0.0)
        length = constraint.length(parameters)
    else:
        first = Link(here, P, a, part, times(X_A, _rail(X_PF)), start, NOWHERE, 1.0, 0.0)
    return [first, Link(there, R, part, b, (1.0, 0.0, length, 0.0), end, NOWHERE, 1.0, 0.0)]


def _merge(
    order: list[str], held: dict[str, tuple[str, str, Pose]]
) -> tuple[dict[str, tuple[int, Pose]], list[list[str]], float]:
    """Part and pose in it of each body, the bodies of each part, and the largest misfit of a loop
    of fixed joints.
    """
    ways: dict[str, list[tuple[str, Pose]]] = {b: [] for b in order}
    for parent, child, X in held.values():
        ways[parent].append((child, X))
        ways[child].append((parent, inverse(X)))
    at: dict[str, tuple[int, Pose]] = {}
    groups: list[list[str]] = []
    misfit = 0.0
    for start in order:
        if start in at:
            continue
        at[start] = len(groups), (1.0, 0.0, 0.0, 0.0)
        groups.append([start])
        for here in groups[-1]:  # grows on the way
            for there, X in ways[here]:
                pose = times(at[here][1], X)
                if there not in at:
                    at[there] = len(groups) - 1, pose
                    groups[-1].append(there)
                misfit = max(
                    misfit, max(abs(u - w) for u, w in zip(pose, at[there][1], strict=True))
                )
    return at, groups, misfit


def _size(links: list[Link]) -> float:
    """The largest distance of two joints on one part; 1 where there is none."""
    points: dict[int, list[tuple[float, float]]] = {}
    for k in links:
        points.setdefault(k.a, []).append(k.F[2:])
        points.setdefault(k.b, []).append(k.M[2:])
    spans = [math.hypot(*np.ptp(np.array(p), axis=0)) for p in points.values()]
    return max(spans, default=0.0) or 1.0


def _hinges(
    pins: list[Link], links: list[Link], same: float
) -> tuple[tuple[tuple[str, ...], tuple[PartLine, ...]], ...]:
    """Groups of revolute joints that share a point of a part which has other points too."""
    points: dict[int, list[tuple[int, tuple[float, float]]]] = {}
    for i, k in enumerate(pins):
        points.setdefault(k.a, []).append((i, k.F[2:]))
        points.setdefault(k.b, []).append((i, k.M[2:]))
    slides = {p for k in links if k.kind == P for p in (k.a, k.b)}
    root = list(range(len(pins)))

    def find(i: int) -> int:
        while root[i] != i:
            root[i] = i = root[root[i]]
        return i

    for part, ends in points.items():
        if part not in slides and all(math.dist(p, ends[0][1]) <= same for _, p in ends):
            # a link without length: to merge its ends would leave its orientation to nothing
            continue
        ends.sort(key=lambda e: e[1])
        for n, (i, p) in enumerate(ends):
            for j, q in ends[n + 1 :]:
                if q[0] - p[0] > same:
                    break
                if math.dist(p, q) <= same:
                    root[max(find(i), find(j))] = min(find(i), find(j))
    groups: dict[int, list[int]] = {}
    for i in range(len(pins)):
        groups.setdefault(find(i), []).append(i)
    out: list[tuple[tuple[str, ...], tuple[PartLine, ...]]] = []
    for group in groups.values():
        ends_of: dict[int, PartLine] = {}
        for k in (pins[i] for i in group):
            ends_of.setdefault(k.a, PartLine(k.a, *k.F[2:]))
            ends_of.setdefault(k.b, PartLine(k.b, *k.M[2:]))
        out.append((tuple(pins[i].name for i in group), tuple(ends_of.values())))
    return tuple(out)


class Code:
    """A program for the dyad kernel while it is written: operations, and the places of registers
    and coordinates.
    """

    def __init__(self, n_parts: int, nq: int):
        self.registers = n_parts + 3
        self.nq = nq
        self.n_parts = n_parts
        self.signs = 0
        self.ops: list[tuple[list[int], list[float]]] = []

    def register(self, part: int) -> int:
        """Place of a part's pose; parts beyond the last are the three registers to work with."""
        return K.REGISTERS + 4 * part

    def coordinate(self, slot: int) -> int:
        """Place of a coordinate."""
        return K.REGISTERS + 4 * self.registers + slot

    def target(self, slot: int) -> int:
        """Place of the value near which a coordinate is wanted."""
        return self.coordinate(self.nq) + slot

    def sign(self) -> int:
        """Place of a new branch sign."""
        self.signs += 1
        return self.target(self.nq) + self.signs - 1

    def append(self, code: int, ints: list[int], floats: object = ()) -> None:
        """Append an operation: its number `code` (of `dyad_layout`) with its integer and float
        operands.
        """
        self.ops.append(([code, *ints], [float(x) for x in floats]))  # type: ignore[attr-defined]

    def pins(self, code: int, ends: list[PartLine], more: list[int], rails: int = 0) -> None:
        """Append an operation on ends, the first `rails` of which are rails."""
        floats = [x for i, e in enumerate(ends) for x in (e.rail if i < rails else e.numbers)]
        self.append(code, [*(self.register(e.part) for e in ends), *more], floats)

    def pack(self, known: list[int]) -> tuple[np.ndarray, Array]:
        """The arrays that the kernel walks."""
        n = len(self.ops)
        spare = self.target(self.nq) + self.signs
        head = [n, spare + 1, self.registers, self.nq, len(known), self.signs]
        head += [self.coordinate(0), self.target(0), self.target(self.nq)]
        ints = np.zeros(K.HEADER + len(known) + K.OP_INTS * n, dtype=np.int64)
        floats = np.zeros(K.OP_FLOATS * n)
        ints[: len(head)] = head
        ints[K.HEADER : K.HEADER + len(known)] = known
        for k, (i, f) in enumerate(self.ops):
            at = K.HEADER + len(known) + K.OP_INTS * k
            ints[at : at + len(i)] = i
            floats[K.OP_FLOATS * k : K.OP_FLOATS * k + len(f)] = f
        return ints, floats


def operations(
    program: tuple[np.ndarray, Array],
) -> tuple[list[int], list[tuple[list[int], list[float]]]]:
    """Slots of the known coordinates of a program, and its operations: code and places, numbers."""
    ints: list[int] = program[0].tolist()
    floats: list[float] = program[1].tolist()
    start = K.HEADER + ints[K.N_KNOWN]
    each = range(ints[K.N_OPS])
    ops = [
        (ints[start + K.OP_INTS * k :][: K.OP_INTS], floats[K.OP_FLOATS * k :][: K.OP_FLOATS])
        for k in each
    ]
    return ints[K.HEADER : start], ops
