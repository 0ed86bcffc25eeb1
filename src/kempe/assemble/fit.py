"""Small changes of dimensions with which a mechanism closes exactly all along a motion.

Relations that the dimensions nearly obey, such as parallel axes, are found, too.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.description.mechanism import unused_name
from kempe.equations.closure_rows import evaluate, full, scales
from kempe.joints import Fixed, Revolute
from kempe.model.characteristic_length import as_large_as, characteristic_length
from kempe.model.own_tree import own_tree
from kempe.model.packed_loops import PackedLoops, loops_of, plane_normal
from kempe.numerics.clock import TimeLimit
from kempe.numerics.newton import gauss_newton, gauss_newton_of_many
from kempe.poses import Placement, place
from kempe.singular_values import svd
from kempe.spatial import Array
from kempe.values import Expression, Value

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- relations that dimensions nearly obey

# Parallel, orthogonal and meeting axes, equal lengths, and angles that are simple fractions of pi.

STEP = math.pi / 12.0
"""Angles between axes that are multiples of this are meant to be."""
TURNS = ("rx", "ry", "rz")
DIFFERENCE = 1e-6
"""Step of the central differences."""

Place = tuple[str, str, str]
"""A placement: the name of the table, of what is in it, and of the side."""
Values = Callable[[dict[Place, Array]], Any]


class Relations:
    """Those relations between the axes on each body that hold within `near`, in characteristic
    lengths and radians.
    """

    def __init__(self, shape: Dimensions, near: float):
        self.shape = shape
        self.near = near
        m = shape.mechanism
        self.given = {
            (table, part.name, side): getattr(part, side).evaluate(m.parameters)
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
                lengths += self._pair(a, b)
            for three in itertools.combinations(places, 3):
                self._add(_flat(*three, shape.length)) if m.dim == 2 else None
        for j in m.joints.values() if m.dim == 3 else ():
            if isinstance(j.type, Revolute):
                own = ("joints", j.name, "X_PF"), ("joints", j.name, "X_CM")
                others = ([x for x in bodies[b] if x not in own] for b in (j.parent, j.child))
                for a, b in itertools.product(*others):
                    if self._skew(own[0], a) and self._skew(own[1], b):
                        self._add(_offset(own, (a, b), shape.length))
        lengths.sort(key=lambda x: x[0])
        for (x, f), (y, g) in itertools.pairwise(lengths):
            if y - x < near:
                self.rows.append(_same(f, g))

    def _add(self, row: Values) -> bool:
        """Take a relation where it nearly holds."""
        holds = bool(np.abs(row(self.given)).max() < self.near)
        if holds:
            self.rows.append(row)
        return holds

    def _skew(self, a: Place, b: Place) -> bool:
        """Whether two axes of a body are not nearly parallel."""
        return bool(np.abs(_parallel(a, b)(self.given)).max() >= self.near)

    def _pair(self, a: Place, b: Place) -> list[tuple[float, Values]]:
        """Take what nearly holds between two axes of a body; the length between them, if there is
        one.
        """
        length = self.shape.length
        if self.shape.mechanism.dim == 2:
            far = _apart(a, b, length)
            return [(float(far(self.given)[0]), far)]
        if self._add(_parallel(a, b)):
            far = _across(a, b, length)
        else:
            angle = math.acos(
                float(np.clip(self.given[a][:3, 2] @ self.given[b][:3, 2], -1.0, 1.0))
            )
            self._add(_inclined(a, b, math.cos(STEP * round(angle / STEP))))
            far = _normal(a, b, length)
        return [] if self._add(far) else [(abs(float(far(self.given)[0])), _size(far))]

    def values(self, p: Array) -> Array:
        """Values (k,) of all relations at the changes p."""
        poses = self._poses(p)
        return np.concatenate([np.zeros(0), *(np.atleast_1d(row(poses)) for row in self.rows)])

    def derivative(self, p: Array) -> Array:
        """Derivative (k, size) of `values` at the changes p, by central differences."""
        poses = self._poses(p)
        read = [_Read(poses) for _ in self.rows]
        sizes = [np.size(row(at)) for row, at in zip(self.rows, read, strict=True)]
        ends = np.cumsum([0, *sizes])
        out = np.zeros((ends[-1], self.shape.size))
        for spot in self.shape.places:
            users = [i for i, at in enumerate(read) if spot in at.used]
            part = self.shape.part[spot]
            for k in range(part.start, part.stop) if users else ():
                above, below = (
                    self._beside(poses, spot, p, k, s * DIFFERENCE) for s in (1.0, -1.0)
                )
                for i in users:
                    out[ends[i] : ends[i + 1], k] = (self.rows[i](above) - self.rows[i](below)) / (
                        2.0 * DIFFERENCE
                    )
        return out

    def _poses(self, p: Array) -> dict[Place, Array]:
        """All placements at the changes p."""
        return self.given | {
            place: self.given[place] @ _pose(d) for place, d in self.shape.steps(p).items()
        }

    def _beside(
        self, poses: dict[Place, Array], place: Place, p: Array, k: int, by: float
    ) -> dict[Place, Array]:
        """The poses where change k, which is one of this place, is larger by a number."""
        changed = p.copy()
        changed[k] += by
        return poses | {place: self.given[place] @ _pose(self.shape.steps_of(place, changed))}


class _Read(dict[Place, Array]):
    """Poses by their places, and those that were used."""

    def __init__(self, poses: dict[Place, Array]):
        super().__init__(poses)
        self.used: set[Place] = set()

    def __getitem__(self, place: Place) -> Array:
        self.used.add(place)
        return super().__getitem__(place)


def snapped(system: Model, most: float) -> Model | None:
    """The system with angles that are within `most` of simple fractions of pi made these; None
    where there is none.
    """
    m = system.mechanism
    found = False
    tables: Any = (m.joints, m.constraints)
    for table in tables:
        for name, part in table.items():
            for side in ("X_PF", "X_CM"):
                old = getattr(part, side).steps
                new = tuple(
                    (k, tuple(_simple(x, most) for x in xs) if k in TURNS else xs) for k, xs in old
                )
                if new != old:
                    part = table[name] = replace(part, **{side: Placement(new)})
                    found = True
    return as_large_as(type(system)(m, system.structure.topology), system) if found else None


def _simple(x: Value, most: float) -> Value:
    """The multiple of `STEP` that an angle is meant to be, where it is near one; 0 is one."""
    if isinstance(x, Expression):
        return x
    nice = math.pi * round(x / STEP) / 12.0
    return nice if abs(nice - x) <= most else x


def _pose(steps: tuple[Any, ...]) -> Array:
    """The pose of slides and turns, one after the other."""
    return Placement(steps).evaluate({})


def _cross(a: Array, b: Array) -> Array:
    """The cross product of two vectors (3,), for which numpy's `cross` takes ten times as long."""
    (ax, ay, az) = a.tolist()
    (bx, by, bz) = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _parallel(a: Place, b: Place) -> Values:
    return lambda at: _cross(at[a][:3, 2], at[b][:3, 2])


def _inclined(a: Place, b: Place, cosine: float) -> Values:
    return lambda at: np.array([at[a][:3, 2] @ at[b][:3, 2] - cosine])


def _apart(a: Place, b: Place, length: float) -> Values:
    return lambda at: np.array([np.linalg.norm(at[b][:3, 3] - at[a][:3, 3]) / length])


def _across(a: Place, b: Place, length: float) -> Values:
    """Distance of parallel axes."""
    return lambda at: np.array(
        [np.linalg.norm(_cross(at[b][:3, 3] - at[a][:3, 3], at[a][:3, 2])) / length]
    )


def _normal(a: Place, b: Place, length: float) -> Values:
    """Length of the common normal of two axes, with a sign."""

    def value(at: dict[Place, Array]) -> Array:
        n = _cross(at[a][:3, 2], at[b][:3, 2])
        return np.array([(at[b][:3, 3] - at[a][:3, 3]) @ n / (np.linalg.norm(n) * length)])

    return value


def _offset(own: tuple[Place, Place], others: tuple[Place, Place], length: float) -> Values:
    """Distance along the axis of a hinge between its common normals with an axis on each of its
    bodies.
    """

    def value(at: dict[Place, Array]) -> Array:
        feet: list[Any] = []
        for a, b in zip(own, others, strict=True):
            X = np.linalg.inv(at[a]) @ at[b]
            u = X[:3, 2]
            p = X[:3, 3]
            feet.append((p[2] - u[2] * (u @ p)) / (1.0 - u[2] ** 2))
        return np.array([(feet[0] - feet[1]) / length])

    return value


def _flat(a: Place, b: Place, c: Place, length: float) -> Values:
    """How far three points of a plane are from one line."""

    def value(at: dict[Place, Array]) -> Array:
        u, v = (at[x][:2, 3] - at[a][:2, 3] for x in (b, c))
        return np.array(
            [
                (u[0] * v[1] - u[1] * v[0])
                / (length * max(np.linalg.norm(u), np.linalg.norm(v), 1e-300))
            ]
        )

    return value


def _size(f: Values) -> Values:
    return lambda at: np.abs(f(at))


def _same(f: Values, g: Values) -> Values:
    return lambda at: f(at) - g(at)


# ---- changes of dimensions

Steps = tuple[tuple[str, tuple[float]], ...]
"""Slides and turns by numbers, one after the other."""
Equations = Callable[..., tuple[Array, Array]]
"""Values (..., m) and derivatives (..., m, n) of equations at configurations (..., nq), the latter
if requested."""
STRIDE = 0.4
FAR = 20
NEAR = 10
"""Length of the steps along a motion, and how many each way: of one freedom, a whole turn; of
several, in each of some directions."""
STRIDES = (STRIDE, 0.25 * STRIDE)
"""The lengths that are tried, one after the other."""
MANY = 6
"""Directions of a motion with several freedoms at most."""
ENOUGH = 6
"""Configurations at which a motion must be followed at least, for it to be one."""
GROWN = 10.0
"""Ratio of what is open from which on configurations are of another motion."""
REGULAR = 1e-2
"""Smallest singular value, relative to the largest, of configurations at which dimensions are
fitted."""
ADDED = "change "
"""How names begin of the bodies and joints that are added to a mechanism where its dimensions
change."""
IN_SPACE = ("x", "y", "z", "rz", "ry", "rx")
"""Translations and rotations, one after the other, by which a placement changes."""
IN_PLANE = (("y", "z", "rx"), ("z", "x", "ry"), ("x", "y", "rz"))
"""The same for a placement of which x, y or z is the normal of the plane."""
TO_Z = {"rx": place(quat_wxyz=(0.5, 0.5, 0.5, 0.5)), "ry": place(quat_wxyz=(0.5, -0.5, -0.5, -0.5))}
"""Rotations to axes of which the third is the normal, by the motion about it."""
ROUNDS = 24
DAMPING = (3.0, 0.3, 30.0)
"""Steps of a fit at most, and its dampings as multiples of what is open, one after the other until
one ends."""
LEAST = 1e-6
LITTLE = 1e-8
SOON = 12
LATE = 1e-9
"""The least damping where `LITTLE` is open, so that rounding changes nothing, and elsewhere and
after some steps, for mechanisms about which several families meet."""
PATIENCE = 6
HOPEFUL = 1e-5
"""Steps in which a fit must gain, and what may stay open for another damping to be tried."""
AT_FIRST = 14
"""Configurations at most that dimensions are fitted to at first."""
MUCH = 3.0
"""Ratio of changes from which on those that make more configurations close are for another
motion."""
TRIES = 3
"""Fits, each with configurations between those of the one before."""
EXACT = 2e-14
"""Residual at which the fit ends."""
CLOSED = 8e-14
"""Residual up to which what was fitted is closed, at other configurations, too."""
ZERO = 1e-9
"""Singular values below this part of the largest are those of a motion, where dimensions were
fitted."""


class Dimensions:
    """The placements of all joints and constraints of a system, and small changes `p` of these
    dimensions.

    `p` (size,) are translations and rotations by the motions of `places`, in characteristic lengths
    and radians, after each placement (table, name, side); in the plane those that stay in it.
    `unit` (size,) are metres or radians of one unit.
    """

    def __init__(self, system: Model):
        self.system = own_tree(system)
        m = self.mechanism = self.system.mechanism
        self.length = characteristic_length(self.system)
        joints = [("joints", j.name) for j in m.joints.values() if not isinstance(j.type, Fixed)]
        declared = [("constraints", c.name) for c in m.constraints.values() if c.parent]
        every = [(*part, side) for part in joints + declared for side in ("X_PF", "X_CM")]
        # which is its only point
        places = [place for place in every if not m.bodies[self.body(*place)].particle]
        self.places = {place: self._motions(*place) if m.dim == 2 else IN_SPACE for place in places}
        of = (x for motions in self.places.values() for x in motions)
        self.unit = np.array([self.length if len(x) == 1 else 1.0 for x in of])
        self.size = len(self.unit)
        each = 3 * (m.dim - 1)
        self._last: tuple[Array, Model] | None = None
        self.part = {place: slice(each * k, each * (k + 1)) for k, place in enumerate(self.places)}

    def body(self, table: str, name: str, side: str) -> str:
        """The body that a placement is on."""
        part = getattr(self.mechanism, table)[name]
        return part.parent if side == "X_PF" else part.child

    def _motions(self, table: str, name: str, side: str) -> tuple[str, ...]:
        """Two translations and the rotation along axes of a placement that stay in the plane."""
        X = getattr(getattr(self.mechanism, table)[name], side).evaluate(self.mechanism.parameters)
        bodies = self.system.structure.table
        normal = X[:3, :3].T @ plane_normal(bodies.at[self.body(table, name, side)], bodies)
        return IN_PLANE[int(np.argmax(np.abs(normal)))]

    def steps(self, p: Array) -> dict[Place, Steps]:
        """The steps that follow each placement that changes, in metres and radians."""
        return {place: found for place in self.places if (found := self.steps_of(place, p))}

    def steps_of(self, place: Place, p: Array) -> Steps:
        """The steps that follow one placement, in metres and radians."""
        part = self.part[place]
        changes = (p[part] * self.unit[part]).tolist()
        return tuple(
            (motion, (x,)) for motion, x in zip(self.places[place], changes, strict=True) if x
        )

    def changed(self, p: Array, system: Model | None = None) -> Model:
        """The system, or `system`, with its dimensions changed by p (size,); its spanning tree is
        kept.
        """
        own = system is None or system is self.system
        if own and self._last is not None and np.array_equal(self._last[0], p):
            return self._last[1]
        given = self.system if system is None else system
        m = given.mechanism
        for (table, name, side), more in self.steps(p).items():
            parts = getattr(m, table)
            parts[name] = replace(
                parts[name], **{side: Placement(getattr(parts[name], side).steps + more)}
            )
        found = as_large_as(type(given)(m, given.structure.topology), self.system)
        if own:
            self._last = p.copy(), found
        return found

    @cached_property
    def _freed(self) -> tuple[PackedLoops, Model, np.ndarray, np.ndarray, np.ndarray]:
        """The packed loops of the mechanism with a joint at each place, whose coordinates are the
        changes, and it.

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
            here = m.body(unused_name(m, f"{ADDED}{k}"))
            turned = TO_Z.get(motions[-1], Placement()) if m.dim == 2 else Placement()
            joint = m.free(here.name, self.body(table, name, side), here, angles=True)
            m.joints[joint.name] = replace(joint, X_PF=getattr(parts[name], side) @ turned)
            parts[name] = replace(parts[name], **{end: here.name, side: turned.inverse()})
            added += [
                f"{joint.name}.{motion}" for motion in (IN_PLANE[2] if m.dim == 2 else IN_SPACE)
            ]
        system = as_large_as(type(self.system)(m), self.system)
        own = np.array(
            [system.coordinate_names.index(name) for name in self.system.coordinate_names],
            dtype=int,
        )
        loops = loops_of(system, frozenset(system.structure.closures))
        first = system.structure.coordinates.first
        rows = {row: i for i, row in enumerate(_numbered(loops.names))}
        order = np.array([rows[row] for row in _numbered(full(self.system, True).names)], dtype=int)
        return (
            loops,
            system,
            own,
            np.array([first[name] for name in added], dtype=int).reshape(-1, 2).T,
            order,
        )

    def equations(self, p: Array) -> Equations:
        """The loop equations at the changes p, as a function of configurations q (N, nq), without
        another system.
        """
        loops, system, own, (iq, _), order = self._freed
        names = system.structure.velocity_names
        columns = np.array(
            [names.index(name) for name in self.system.structure.velocity_names], dtype=int
        )

        def at(q: Array, with_jacobian: bool = True) -> tuple[Array, Array]:
            x = np.empty((*q.shape[:-1], system.nq))
            x[..., own] = q
            x[..., iq] = p * self.unit
            f, J = evaluate(system, x, with_jacobian, loops=loops)
            return f[..., order], J[..., order, :][..., columns] if with_jacobian else J

        return at

    def derivative(self, p: Array, q: Array) -> Array:
        """Derivatives (N, m, size) of the m loop equations, at configurations q (N, nq), with
        respect to p (size,).
        """
        loops, system, own, (iq, iv), order = self._freed
        x = np.empty((len(q), system.nq))
        x[:, own] = q
        x[:, iq] = p * self.unit
        return evaluate(system, x, loops=loops)[1][:, order][..., iv]


def _numbered(names: Iterable[tuple[str, str]]) -> list[tuple[str, str, int]]:
    """The names of equations, numbered where one occurs several times."""
    seen: Counter[tuple[str, str]] = Counter()
    out: list[tuple[str, str, int]] = []
    for name in names:
        out.append((*name, seen[name]))
        seen[name] += 1
    return out


# ---- valleys: where loop equations are nearest to zero


class Step(NamedTuple):
    """Where a step along a valley leads, the direction (n,) in which it goes on, and what stays
    open there.

    `regular` tells whether the combinations of equations that count are independent there.
    """

    q: Array
    way: Array
    left: float
    regular: bool


class Valley:
    """Where the loop equations of a system are nearest to zero, if only their `rank` strongest
    combinations count.

    `equations` are those of other dimensions, by default of the system's.
    """

    def __init__(self, system: Model, rank: int, equations: Equations | None = None):
        tree = self.system = own_tree(system)
        self.rank = rank
        self.scale = scales(tree)
        self.equations: Equations = equations or partial(evaluate, tree, scaled=True)

    def at(self, q: Array) -> tuple[Array, Array, Array, Array]:
        """Residual (m,), left vectors (m, m), singular values (rank + 1 or rank,), right vectors
        (n, n) at q (nq,).
        """
        f, J = self.equations(q)
        U, s, Vt = svd(J)
        return f, U, s, Vt

    def converge(self, q: Array, rounds: int = 12) -> Array:
        """The configuration of the valley that Gauss-Newton steps lead to from q (nq,)."""
        r = self.rank
        system = self.system

        def step(q: Array, f: Array, J: Array) -> Array:
            U, s, Vt = svd(J)
            return -Vt[:r].T @ ((U[:, :r].T @ f) / np.maximum(s[:r], 1e-300))

        return gauss_newton(
            lambda q: self.equations(q),
            q,
            rounds,
            step=step,
            last=1e-13,
            longest=0.3,
            move=lambda q, y: system.structure.layout.integrate(q, self.scale * y),
        ).x

    def converge_all(self, q: Array, rounds: int = 12) -> Array:
        """As `converge`, of many configurations (N, nq)."""
        r = self.rank
        system = self.system

        def step(f: Array, J: Array) -> Array:
            U, s, Vt = svd(J)
            part = (np.swapaxes(U[..., :r], -1, -2) @ f[..., None])[..., 0] / np.maximum(
                s[..., :r], 1e-300
            )
            return -(np.swapaxes(Vt[..., :r, :], -1, -2) @ part[..., None])[..., 0]

        return gauss_newton_of_many(
            lambda q, _: self.equations(q),
            q,
            rounds,
            step=step,
            longest=0.3,
            move=lambda q, y: system.structure.layout.integrate(q, self.scale * y),
        )

    def residual(self, q: Array) -> Array:
        """Norms (...) of the residual at configurations (..., nq)."""
        return np.linalg.norm(self.equations(q, False)[0], axis=-1)

    def regular(self, q: Array) -> bool:
        """Whether the combinations that count are independent at q (nq,)."""
        s = self.at(q)[2]
        return self.rank == 0 or bool(s[self.rank - 1] > REGULAR * s[0])

    def ahead(self, q: Array, direction: Array, length: float) -> Step:
        """One step ahead along the valley from q in a direction (n,)."""
        r = self.rank
        there = self.converge(
            self.system.structure.layout.integrate(q, self.scale * direction * length)
        )
        f, _, s, Vt = self.at(there)
        onward = Vt[r:].T @ (Vt[r:] @ direction)
        onward = onward / max(float(np.linalg.norm(onward)), 1e-300)
        return Step(
            there, onward, float(np.linalg.norm(f)), r == 0 or bool(s[r - 1] > REGULAR * s[0])
        )

    def between(self, q: Array) -> list[Array]:
        """Regular configurations some way along the valley from q (N, nq)."""
        if self.rank == self.system.nv:
            return []
        ways = svd(self.equations(q)[1])[2][:, -1]
        found = self.converge_all(
            self.system.structure.layout.integrate(q, 0.37 * STRIDE * self.scale * ways)
        )
        return [x for x in found if np.isfinite(x).all() and self.regular(x)]

    def walk(self, q: Array, most: float, rng: np.random.Generator) -> Array:
        """Regular configurations (N, nq) along the valley on both sides of q, where at most `most`
        stays open.

        The first are those that the fewest steps lead to. Where long steps lead to few, as the
        valley bends much, they are shorter. Where much more is open than on the way to the `ENOUGH`
        that are closest to closed, the steps went over to another valley: a way ends there.
        """
        freedoms = self.system.nv - self.rank
        null_space = self.at(q)[3][self.rank :]
        ways = (
            null_space
            if freedoms == 1
            else rng.normal(size=(min(2 * freedoms, MANY), freedoms)) @ null_space
        )
        ways = [sign * w / np.linalg.norm(w) for w in ways for sign in (1.0, -1.0)]
        found: list[tuple[int, float, Array]] = []
        for length in STRIDES:
            found = [(0, float(self.residual(q)), q)] if self.regular(q) else []
            for way in ways:
                found += self._one_way(q, way, length, most, FAR if freedoms == 1 else NEAR)
            if len(found) >= ENOUGH:
                break
        found.sort(key=lambda x: x[0])
        if len(found) > ENOUGH:
            most = max(GROWN * sorted(left for _, left, _ in found)[ENOUGH - 1], EXACT)
        near = [x for _, left, x in found if left <= most]
        return np.array(near).reshape(len(near), self.system.nq)

    def _one_way(
        self, q: Array, way: Array, length: float, most: float, steps: int
    ) -> list[tuple[int, float, Array]]:
        """For each regular configuration ahead: steps to it, what stays open at most on the way,
        and it.
        """
        found: list[tuple[int, float, Array]] = []
        left = float(self.residual(q))
        for k in range(steps):
            ahead = self.ahead(q, way, length)
            moved = float(
                np.linalg.norm(self.system.structure.layout.difference(q, ahead.q) / self.scale)
            )
            left = max(left, ahead.left)
            if not left <= most or not 0.5 * length < moved < 2.0 * length or ahead.way @ way < 0.5:
                break
            q = ahead.q
            way = ahead.way
            if ahead.regular:
                found.append((k + 1, left, q))
        return found


# ---- dimensions fitted to configurations


class Fit(NamedTuple):
    """Changes `p` (size,) with which configurations `q` (N, nq) close, and what stays open at most,
    `left`.

    Where they do not all close with small changes, `closed` is false, and `p` and `q` are where the
    fit ended.
    """

    closed: bool
    p: Array
    q: Array
    left: float


def fitted_all_along(
    shape: Dimensions,
    rank: int,
    q: Array,
    most: float,
    time: TimeLimit,
    also: Relations | None = None,
    tries: int = len(DAMPING),
) -> Fit:
    """As `fitted`, of configurations q (N, nq) that begin with the nearest ones.

    What closes along a part of a motion closes all along, so that a fit to the nearest is enough,
    unless it leaves dimensions undetermined. Far ones may lie on another motion, which crosses the
    first where the mechanism is flat: then the changes with which that one closes, too, are much
    larger, if there are any. Where the nearest are on both sides of a crossing, those of one side
    are enough, too.
    """
    first = q[:AT_FIRST] if rank == shape.system.nv - 1 else q
    near = fitted(shape, rank, first, most, time, also, tries)
    for part in _sides(shape, rank, q) if tries > 1 else ():
        if near.closed:
            break
        near = fitted(shape, rank, part, most, time, also, tries)
    if (
        not near.closed
        or len(q) <= len(first)
        or moves_all_along(Valley(shape.changed(near.p), rank), q)
    ):
        return near
    far = fitted(shape, rank, q, most, time, also, tries)
    return far if far.closed and np.abs(far.p).max() <= MUCH * np.abs(near.p).max() else near


def _sides(shape: Dimensions, rank: int, q: Array) -> list[Array]:
    """Of configurations q (N, nq) along a motion of one freedom those on each side of the first, as
    many as needed.
    """
    valley = Valley(shape.system, rank)
    if rank != shape.system.nv - 1 or len(q) < ENOUGH:
        return []
    along = (
        shape.system.structure.layout.difference(np.tile(q[0], (len(q), 1)), q)
        / valley.scale
        @ valley.at(q[0])[3][-1]
    )
    return [
        side for sign in (1.0, -1.0) if len(side := q[sign * along >= 0.0][:AT_FIRST]) >= ENOUGH
    ]


def fitted(
    shape: Dimensions,
    rank: int,
    q: Array,
    most: float,
    time: TimeLimit,
    also: Relations | None = None,
    tries: int = len(DAMPING),
) -> Fit:
    """The changes nearest to none with which all configurations q (N, nq) close, and these then.

    `most` is the largest change, in metres and radians. What is fitted must close at configurations
    in between, too; where they do not they are fitted as well. `also` are relations that must hold;
    `tries` are the dampings that are tried.
    """
    p = np.zeros(shape.size)
    every = q
    q = q[:: -(-len(q) // AT_FIRST)]
    end: tuple[Array, Array, float] = p, q, np.inf
    left = np.inf
    for _ in range(TRIES):
        for damped in DAMPING[:tries]:
            end = _fit(shape, rank, p, q, most, time, damped, also)
            if not CLOSED < end[2] < HOPEFUL:
                break
        if CLOSED < end[2] < LITTLE:  # the last digits, without damping
            end = _fit(shape, rank, end[0], end[1], most, time, 0.0, also)
        p, q, left = end
        if left > CLOSED or np.abs(p * shape.unit).max(initial=0.0) > most:
            break
        valley = Valley(shape.changed(p), rank)
        every = valley.converge_all(every)
        if not moves(valley, q) or not np.isfinite(every).all():
            break
        between = valley.between(q)
        if valley.residual(np.array([*every, *between])).max() <= CLOSED and moves(valley, every):
            return Fit(True, p, every, left)
        q = np.array([*every, *between])
    return Fit(False, p, q, left)


def _fit(
    shape: Dimensions,
    rank: int,
    p: Array,
    q: Array,
    most: float,
    time: TimeLimit,
    damped: float,
    also: Relations | None,
) -> tuple[Array, Array, float]:
    """Changes from p on with which configurations q close, by Levenberg's method, these, and what
    stays open.

    It acts on those combinations of equations that the configurations cannot answer for.
    """
    H = np.zeros((0, shape.size))
    P = np.zeros((0, 0, 0))
    at = np.full(shape.size, np.inf)
    before = [np.inf] * PATIENCE
    left = np.inf
    for k in range(ROUNDS):
        time.check()
        valley = Valley(shape.system, rank, shape.equations(p))
        q = valley.converge_all(q, 4)
        F, J = valley.equations(q)
        h = also.values(p) if also is not None else np.zeros(0)
        left = float(max(np.linalg.norm(F, axis=-1).max(), np.abs(h).max(initial=0.0)))
        # one more for the last digit
        if not left < 0.9 * before[-PATIENCE] or (left <= EXACT and before[-1] <= EXACT):
            return p, q, left
        if not np.isfinite(left) or np.abs(p * shape.unit).max() > 3.0 * most:
            return p, q, np.inf
        before.append(left)
        # the last digits count where roots are nearly double
        if np.abs(p - at).max() > (1e-6 if damped else 0.0):
            P = shape.derivative(p, q)
            at = p
            H = also.derivative(p) if also is not None else H
        U = svd(J)[0][:, :, rank:]
        G = np.concatenate([*(np.swapaxes(U, -1, -2) @ P), H])
        g = np.concatenate([*(np.swapaxes(U, -1, -2) @ F[..., None])[..., 0], h])
        if not U.size:  # no equation too many
            return p, q, np.inf
        L, s, Rt = svd(G, full_matrices=False)
        least = LEAST if damped and left < LITTLE and k < SOON else LATE
        damping = max(least, damped * left) * max(float(s[0]), 1e-300)
        p = p - Rt.T @ (s * (L.T @ g) / (s * s + damping * damping))
    return p, q, left


def moves(valley: Valley, q: Array) -> bool:
    """Whether the equations have no more than their rank at all configurations q (N, nq)."""
    s = svd(valley.equations(q)[1], compute_uv=False)
    few = valley.rank < valley.system.nv and s.shape[-1] > valley.rank
    return not (few and np.any(s[:, valley.rank] > ZERO * s[:, 0]))


def moves_all_along(valley: Valley, q: Array) -> bool:
    """Whether loops close exactly along the valley near configurations q (N, nq), and between, with
    its freedoms.
    """
    q = valley.converge_all(q)
    return bool(valley.residual(np.array([*q, *valley.between(q)])).max() <= CLOSED) and moves(
        valley, q
    )
