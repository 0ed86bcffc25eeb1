"""Small changes of the dimensions of a mechanism, and relations that the dimensions nearly obey."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.description.mechanism import choose_unused_name
from kempe.equations.closure_rows import evaluate_constraints, pack_full_loops
from kempe.joints import Fixed, Revolute
from kempe.model.characteristic_length import (
    adopt_characteristic_length,
    compute_characteristic_length,
)
from kempe.model.own_tree import remove_cut_marks
from kempe.model.packed_loops import PackedLoops, compute_plane_normal, get_packed_loops
from kempe.poses import Placement, place
from kempe.spatial import Array
from kempe.values import Expression, Value

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- changes of dimensions

Place = tuple[str, str, str]
"""A placement: the name of the table, of what is in it, and of the side."""
Steps = tuple[tuple[str, tuple[float]], ...]
"""Slides and turns by numbers, one after the other."""
Equations = Callable[..., tuple[Array, Array]]
"""Values (..., m) and derivatives (..., m, n) of equations at configurations (..., nq), the latter
if requested."""


ADDED = "change "
"""How names begin of the bodies and joints that are added to a mechanism where its dimensions
change."""
IN_SPACE = ("x", "y", "z", "rz", "ry", "rx")
"""Translations and rotations, one after the other, by which a placement changes."""
IN_PLANE = (("y", "z", "rx"), ("z", "x", "ry"), ("x", "y", "rz"))
"""The same for a placement of which x, y or z is the normal of the plane."""
TO_Z = {"rx": place(quat_wxyz=(0.5, 0.5, 0.5, 0.5)), "ry": place(quat_wxyz=(0.5, -0.5, -0.5, -0.5))}
"""Rotations to axes of which the third is the normal, by the motion about it."""


class Dimensions:
    """The placements of all joints and constraints of a system, and small changes `p` of them.

    `p` (size,) are translations and rotations by the motions of `places`, in characteristic lengths
    and radians, after each placement (table, name, side); in the plane those that stay in it.
    `unit` (size,) are metres or radians of one unit.
    """

    def __init__(self, system: Model):
        self.system = remove_cut_marks(system)
        m = self.mechanism = self.system.mechanism
        self.length = compute_characteristic_length(self.system)
        joints = [("joints", j.name) for j in m.joints.values() if not isinstance(j.type, Fixed)]
        declared = [("constraints", c.name) for c in m.constraints.values() if c.parent]
        every = [(*part, side) for part in joints + declared for side in ("X_PF", "X_CM")]
        # which is its only point
        places = [place for place in every if not m.bodies[self.find_body(*place)].particle]
        self.places = {
            place: self._choose_motions(*place) if m.dim == 2 else IN_SPACE for place in places
        }
        of = (x for motions in self.places.values() for x in motions)
        self.unit = np.array([self.length if len(x) == 1 else 1.0 for x in of])
        self.size = len(self.unit)
        each = 3 * (m.dim - 1)
        self._last: tuple[Array, Model] | None = None
        self.part = {place: slice(each * k, each * (k + 1)) for k, place in enumerate(self.places)}

    def find_body(self, table: str, name: str, side: str) -> str:
        """Return the name of the body that a placement is on."""
        part = getattr(self.mechanism, table)[name]
        return part.parent if side == "X_PF" else part.child

    def _choose_motions(self, table: str, name: str, side: str) -> tuple[str, ...]:
        """Return names of the two translations and the rotation of a placement within the plane."""
        X = getattr(getattr(self.mechanism, table)[name], side).evaluate_pose(
            self.mechanism.parameters
        )
        bodies = self.system.structure.table
        normal = X[:3, :3].T @ compute_plane_normal(
            bodies.at[self.find_body(table, name, side)], bodies
        )
        return IN_PLANE[int(np.argmax(np.abs(normal)))]

    def compute_steps(self, p: Array) -> dict[Place, Steps]:
        """Return the slides [m] and turns [rad] that changes p (size,) append to each placement."""
        return {
            place: found for place in self.places if (found := self.compute_place_steps(place, p))
        }

    def compute_place_steps(self, place: Place, p: Array) -> Steps:
        """Return the slides [m] and turns [rad] that changes p (size,) append to one placement."""
        part = self.part[place]
        changes = (p[part] * self.unit[part]).tolist()
        return tuple(
            (motion, (x,)) for motion, x in zip(self.places[place], changes, strict=True) if x
        )

    def change_dimensions(self, p: Array, system: Model | None = None) -> Model:
        """Return the system, or `system`, with its dimensions changed by p (size,).

        Its spanning tree is kept.
        """
        own = system is None or system is self.system
        if own and self._last is not None and np.array_equal(self._last[0], p):
            return self._last[1]
        given = self.system if system is None else system
        m = given.mechanism
        for (table, name, side), more in self.compute_steps(p).items():
            parts = getattr(m, table)
            parts[name] = replace(
                parts[name], **{side: Placement(getattr(parts[name], side).steps + more)}
            )
        found = adopt_characteristic_length(type(given)(m, given.structure.topology), self.system)
        if own:
            self._last = p.copy(), found
        return found

    @cached_property
    def _extended_loops(self) -> tuple[PackedLoops, Model, np.ndarray, np.ndarray, np.ndarray]:
        """Packed loops of the mechanism extended by a free joint at each placement.

        The coordinates of these joints are the changes of dimensions. The extended system follows,
        and indices of the own coordinates, of the changes, and of the equations in it.

        Indices say where the coordinates of the mechanism, those of the changes, and the equations
        are in it.
        """
        m = self.system.mechanism
        given = self.system.structure
        for name, joint in m.joints.items():
            m.joints[name] = replace(joint, cut=name in given.closures)
        added: list[str] = []
        for k, ((table, name, side), motions) in enumerate(self.places.items()):
            parts = getattr(m, table)
            end = "parent" if side == "X_PF" else "child"
            here = m.body(choose_unused_name(m, f"{ADDED}{k}"))
            turned = TO_Z.get(motions[-1], Placement()) if m.dim == 2 else Placement()
            joint = m.free(here.name, self.find_body(table, name, side), here, angles=True)
            m.joints[joint.name] = replace(joint, X_PF=getattr(parts[name], side) @ turned)
            parts[name] = replace(parts[name], **{end: here.name, side: turned.invert_steps()})
            added += [
                f"{joint.name}.{motion}" for motion in (IN_PLANE[2] if m.dim == 2 else IN_SPACE)
            ]
        system = adopt_characteristic_length(type(self.system)(m), self.system)
        own = np.array(
            [system.coordinate_names.index(name) for name in self.system.coordinate_names],
            dtype=int,
        )
        loops = get_packed_loops(system, frozenset(system.structure.closures))
        first = system.structure.coordinates.first
        rows = {row: i for i, row in enumerate(_number_names(loops.names))}
        order = np.array(
            [rows[row] for row in _number_names(pack_full_loops(self.system, True).names)],
            dtype=int,
        )
        return (
            loops,
            system,
            own,
            np.array([first[name] for name in added], dtype=int).reshape(-1, 2).T,
            order,
        )

    def bind_equations(self, p: Array) -> Equations:
        """Return the loop equations at the changes p as a function of configurations q (N, nq).

        No other system is built for them.
        """
        loops, system, own, (iq, _), order = self._extended_loops
        names = system.structure.velocity_names
        columns = np.array(
            [names.index(name) for name in self.system.structure.velocity_names], dtype=int
        )

        def evaluate_equations(q: Array, with_jacobian: bool = True) -> tuple[Array, Array]:
            """Return values (N, m) and, if asked for, derivatives (N, m, nv) of the loop equations."""
            x = np.empty((*q.shape[:-1], system.nq))
            x[..., own] = q
            x[..., iq] = p * self.unit
            f, J = evaluate_constraints(system, x, with_jacobian, loops=loops)
            return f[..., order], J[..., order, :][..., columns] if with_jacobian else J

        return evaluate_equations

    def differentiate_equations(self, p: Array, q: Array) -> Array:
        """Return the derivatives (N, m, size) of the m loop equations with respect to p (size,).

        They are taken at configurations q (N, nq).
        """
        loops, system, own, (iq, iv), order = self._extended_loops
        x = np.empty((len(q), system.nq))
        x[:, own] = q
        x[:, iq] = p * self.unit
        return evaluate_constraints(system, x, loops=loops)[1][:, order][..., iv]


def _number_names(names: Iterable[tuple[str, str]]) -> list[tuple[str, str, int]]:
    """Number the names of equations, for names that occur several times."""
    seen: Counter[tuple[str, str]] = Counter()
    out: list[tuple[str, str, int]] = []
    for name in names:
        out.append((*name, seen[name]))
        seen[name] += 1
    return out


# ---- relations that dimensions nearly obey

# Parallel, orthogonal and meeting axes, equal lengths, and angles that are simple fractions of pi.

STEP = math.pi / 12.0
"""Angles between axes that are multiples of this are meant to be."""
TURNS = ("rx", "ry", "rz")
DIFFERENCE = 1e-6
"""Step of the central differences."""
Values = Callable[[dict[Place, Array]], Any]


class Relations:
    """Relations between axes of a body that nearly hold, such as parallel axes or equal lengths.

    `near` is the largest error of such a relation, in characteristic lengths and radians.
    """

    def __init__(self, shape: Dimensions, near: float):
        self.shape = shape
        self.near = near
        m = shape.mechanism
        self.given = {
            (table, part.name, side): getattr(part, side).evaluate_pose(m.parameters)
            for table, parts in (("joints", m.joints), ("constraints", m.constraints))
            for part in parts.values()
            if part.parent
            for side in ("X_PF", "X_CM")
        }
        bodies: dict[str, list[Place]] = {}
        for j in m.joints.values():
            if not isinstance(j.type, Fixed):
                bodies.setdefault(j.parent, []).append(("joints", j.name, "X_PF"))
                bodies.setdefault(j.child, []).append(("joints", j.name, "X_CM"))
        self.rows: list[Values] = []
        lengths: list[tuple[float, Values]] = []
        for places in bodies.values():
            for a, b in itertools.combinations(places, 2):
                lengths += self._relate_axes(a, b)
            for three in itertools.combinations(places, 3):
                self._add_relation(
                    _make_collinear_relation(*three, shape.length)
                ) if m.dim == 2 else None
        for j in m.joints.values() if m.dim == 3 else ():
            if isinstance(j.type, Revolute):
                own = ("joints", j.name, "X_PF"), ("joints", j.name, "X_CM")
                others = ([x for x in bodies[b] if x not in own] for b in (j.parent, j.child))
                for a, b in itertools.product(*others):
                    if self._are_skew(own[0], a) and self._are_skew(own[1], b):
                        self._add_relation(_make_axis_offset(own, (a, b), shape.length))
        lengths.sort(key=lambda x: x[0])
        for (x, f), (y, g) in itertools.pairwise(lengths):
            if y - x < near:
                self.rows.append(_make_difference(f, g))

    def _add_relation(self, row: Values) -> bool:
        """Add a relation if it nearly holds; return whether it does."""
        holds = bool(np.abs(row(self.given)).max() < self.near)
        if holds:
            self.rows.append(row)
        return holds

    def _are_skew(self, a: Place, b: Place) -> bool:
        """Return whether two axes of a body are clearly not parallel."""
        return bool(np.abs(_make_parallel_relation(a, b)(self.given)).max() >= self.near)

    def _relate_axes(self, a: Place, b: Place) -> list[tuple[float, Values]]:
        """Add the relations that nearly hold between two axes of a body.

        Returns the length between them, if there is one that is not zero.
        """
        length = self.shape.length
        if self.shape.mechanism.dim == 2:
            far = _make_distance(a, b, length)
            return [(float(far(self.given)[0]), far)]
        if self._add_relation(_make_parallel_relation(a, b)):
            far = _make_axis_distance(a, b, length)
        else:
            angle = math.acos(
                float(np.clip(self.given[a][:3, 2] @ self.given[b][:3, 2], -1.0, 1.0))
            )
            self._add_relation(_make_angle_relation(a, b, math.cos(STEP * round(angle / STEP))))
            far = _make_normal_length(a, b, length)
        return (
            []
            if self._add_relation(far)
            else [(abs(float(far(self.given)[0])), _make_absolute_value(far))]
        )

    def compute_values(self, p: Array) -> Array:
        """Compute the values (k,) of all relations at the changes p."""
        poses = self._compute_poses(p)
        return np.concatenate([np.zeros(0), *(np.atleast_1d(row(poses)) for row in self.rows)])

    def differentiate_values(self, p: Array) -> Array:
        """Compute derivatives (k, size) of all relations at the changes p, by central differences."""
        poses = self._compute_poses(p)
        read = [_Read(poses) for _ in self.rows]
        sizes = [np.size(row(at)) for row, at in zip(self.rows, read, strict=True)]
        ends = np.cumsum([0, *sizes])
        out = np.zeros((ends[-1], self.shape.size))
        for spot in self.shape.places:
            users = [i for i, at in enumerate(read) if spot in at.used]
            part = self.shape.part[spot]
            for k in range(part.start, part.stop) if users else ():
                above, below = (
                    self._change_pose(poses, spot, p, k, s * DIFFERENCE) for s in (1.0, -1.0)
                )
                for i in users:
                    out[ends[i] : ends[i + 1], k] = (self.rows[i](above) - self.rows[i](below)) / (
                        2.0 * DIFFERENCE
                    )
        return out

    def _compute_poses(self, p: Array) -> dict[Place, Array]:
        """Compute the poses of all placements at the changes p."""
        return self.given | {
            place: self.given[place] @ _compute_pose(d)
            for place, d in self.shape.compute_steps(p).items()
        }

    def _change_pose(
        self, poses: dict[Place, Array], place: Place, p: Array, k: int, by: float
    ) -> dict[Place, Array]:
        """Return the poses with change k, one of this placement, increased by a number."""
        changed = p.copy()
        changed[k] += by
        return poses | {
            place: self.given[place] @ _compute_pose(self.shape.compute_place_steps(place, changed))
        }


class _Read(dict[Place, Array]):
    """Poses by placement, which records the placements that were read."""

    def __init__(self, poses: dict[Place, Array]):
        super().__init__(poses)
        self.used: set[Place] = set()

    def __getitem__(self, place: Place) -> Array:
        self.used.add(place)
        return super().__getitem__(place)


def simplify_angles(system: Model, most: float) -> Model | None:
    """Round angles that are nearly multiples of 15 degrees to these multiples.

    `most` is the largest change [rad]; None where no angle changes.
    """
    m = system.mechanism
    found = False
    tables: Any = (m.joints, m.constraints)
    for table in tables:
        for name, part in table.items():
            for side in ("X_PF", "X_CM"):
                old = getattr(part, side).steps
                new = tuple(
                    (k, tuple(_simplify_angle(x, most) for x in xs) if k in TURNS else xs)
                    for k, xs in old
                )
                if new != old:
                    part = table[name] = replace(part, **{side: Placement(new)})
                    found = True
    return (
        adopt_characteristic_length(type(system)(m, system.structure.topology), system)
        if found
        else None
    )


def _simplify_angle(x: Value, most: float) -> Value:
    """Round an angle to a multiple of `STEP` if it is within `most` of one."""
    if isinstance(x, Expression):
        return x
    nice = math.pi * round(x / STEP) / 12.0
    return nice if abs(nice - x) <= most else x


def _compute_pose(steps: tuple[Any, ...]) -> Array:
    """Compute the pose of slides and turns, one after the other."""
    return Placement(steps).evaluate_pose({})


def _compute_cross_product(a: Array, b: Array) -> Array:
    """Compute the cross product of two vectors (3,), ten times as fast as numpy's `cross`."""
    (ax, ay, az) = a.tolist()
    (bx, by, bz) = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _make_parallel_relation(a: Place, b: Place) -> Values:
    """Return the relation that is zero where two axes are parallel."""
    return lambda at: _compute_cross_product(at[a][:3, 2], at[b][:3, 2])


def _make_angle_relation(a: Place, b: Place, cosine: float) -> Values:
    """Return the relation that is zero where the angle of two axes has this cosine."""
    return lambda at: np.array([at[a][:3, 2] @ at[b][:3, 2] - cosine])


def _make_distance(a: Place, b: Place, length: float) -> Values:
    """Return the function that computes the distance of two points, in lengths."""
    return lambda at: np.array([np.linalg.norm(at[b][:3, 3] - at[a][:3, 3]) / length])


def _make_axis_distance(a: Place, b: Place, length: float) -> Values:
    """Return the function that computes the distance of two parallel axes, in lengths."""
    return lambda at: np.array(
        [np.linalg.norm(_compute_cross_product(at[b][:3, 3] - at[a][:3, 3], at[a][:3, 2])) / length]
    )


def _make_normal_length(a: Place, b: Place, length: float) -> Values:
    """Return the function that computes the signed length of the common normal of two axes."""

    def compute_length(at: dict[Place, Array]) -> Array:
        n = _compute_cross_product(at[a][:3, 2], at[b][:3, 2])
        return np.array([(at[b][:3, 3] - at[a][:3, 3]) @ n / (np.linalg.norm(n) * length)])

    return compute_length


def _make_axis_offset(
    own: tuple[Place, Place], others: tuple[Place, Place], length: float
) -> Values:
    """Return the function that computes the offset between two common normals of an axis.

    The axis is that of a hinge; each common normal leads to an axis on one of its bodies.
    """

    def compute_offset(at: dict[Place, Array]) -> Array:
        feet: list[Any] = []
        for a, b in zip(own, others, strict=True):
            X = np.linalg.inv(at[a]) @ at[b]
            u = X[:3, 2]
            p = X[:3, 3]
            feet.append((p[2] - u[2] * (u @ p)) / (1.0 - u[2] ** 2))
        return np.array([(feet[0] - feet[1]) / length])

    return compute_offset


def _make_collinear_relation(a: Place, b: Place, c: Place, length: float) -> Values:
    """Return the relation that is zero where three points of the plane are on one line."""

    def compute_height(at: dict[Place, Array]) -> Array:
        u, v = (at[x][:2, 3] - at[a][:2, 3] for x in (b, c))
        return np.array(
            [
                (u[0] * v[1] - u[1] * v[0])
                / (length * max(np.linalg.norm(u), np.linalg.norm(v), 1e-300))
            ]
        )

    return compute_height


def _make_absolute_value(f: Values) -> Values:
    """Return the function that computes the absolute value of a relation."""
    return lambda at: np.abs(f(at))


def _make_difference(f: Values, g: Values) -> Values:
    """Return the relation that is zero where two functions have the same value."""
    return lambda at: f(at) - g(at)
