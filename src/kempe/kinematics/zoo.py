"""The constraint zoo: each kind of constraint is one small class with its equations and their exact derivatives.

Every constraint has a `name`, row `names`, their number `size`, `residual(system, q) -> (..., m)` in metres and
radians, zero where it holds, and `jacobian(system, q) -> (..., m, nv)`, its derivatives by the velocity coordinates,
exact where the constraint is violated, too. `of_system` lists those that a system has.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.calls import explained
from kempe.constraints.base import position_rows
from kempe.description.parts import Declared
from kempe.errors import InputError, UnknownNameError
from kempe.kinematics import pairs
from kempe.kinematics.carried import Carried
from kempe.kinematics.configuration import as_q
from kempe.kinematics.constraint_base import Constraint, Pair
from kempe.kinematics.constraints import coordinate_row, coordinate_value
from kempe.kinematics.curves import Curve
from kempe.kinematics.derivatives import SUPPLIED, check_supplied, checked_value, jacobian_of, way_of
from kempe.kinematics.joint_motion import motion_of
from kempe.model.reduced import slides_along_z
from kempe.reals import reals
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

# ---- the zoo


@dataclass(frozen=True, eq=False)
class Closure(Pair):
    """A joint that closes a loop, by the rows that its type takes away: 5 of a revolute joint, 3 of a ball, ...

    `tied` are coordinates of the joint that have rows of their own, which ask that the value in q (or what it
    follows) is what is read off the pose; each (names, how they are read), three angles or a quaternion together.
    """

    hold: pairs.Hold
    pitch: float = 0.0
    tied: tuple[tuple[tuple[str, ...], str], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each row: held directions, then tied coordinates."""
        own = [x for names, _ in self.tied for x in (names if len(names) == 1 else (f"own r{a}" for a in "xyz"))]
        return (*self.hold.names, *own)

    def rows(self, X: Array) -> pairs.Rows:
        """The rows that the joint's type holds."""
        return self.hold.rows(X)

    def residual(self, system: System, q: Any) -> Array:
        """How far it is violated (..., size), in metres and radians."""
        return self._both(system, as_q(system, q))[0]

    def jacobian(self, system: System, q: Any) -> Array:
        """Derivatives (..., size, nv) of the residual by the velocity coordinates."""
        return self._both(system, as_q(system, q))[1]

    def _both(self, system: System, q: Array) -> tuple[Array, Array]:
        X, motion = self.pose(system, q), self.motion(system, q)
        value, rates = self.hold.rows(X)
        values, jacobians = [value], [rates @ motion]
        for names, kind in self.tied:
            if len(names) == 1:
                number, rates = pairs.read(X, kind, self.pitch)
                number = number - coordinate_value(system, q, names[0])
                if kind.startswith("turn"):
                    number = (number + np.pi) % (2.0 * np.pi) - np.pi  # a full turn more is the same pose
                number, J = number[..., None], rates[..., None, :] @ motion - coordinate_row(system, names[0])
            else:
                own = np.stack([coordinate_value(system, q, n) for n in names], axis=-1)
                number, rates, by_own = (pairs.angle_rows if len(names) == 3 else pairs.quaternion_rows)(X, own)
                J = rates @ motion + by_own @ _own_rows(system, names)
            values.append(number)
            jacobians.append(J)
        return np.concatenate(values, axis=-1), np.concatenate(jacobians, axis=-2)


def _own_rows(system: System, names: tuple[str, ...]) -> Array:
    """Matrix (3, nv) to the velocities of three angles or of a quaternion."""
    if len(names) == 3:
        return np.stack([coordinate_row(system, n) for n in names])
    out = np.zeros((3, system.nv))
    if names[0] not in system.couplings:
        first = system.coordinates.first[names[0]][1]
        out[:, first : first + 3] = np.eye(3)
    return out


@dataclass(frozen=True, eq=False)
class Distance(Pair):
    """The origins of two frames are `length` metres apart: a rod with a ball joint at each end."""

    length: float

    @property
    def names(self) -> tuple[str, ...]:
        """One row."""
        return ("distance",)

    def rows(self, X: Array) -> pairs.Rows:
        """Distance less length."""
        p = X[..., :3, 3]
        d = np.linalg.norm(p, axis=-1, keepdims=True)
        along = p / np.where(d > 0.0, d, 1.0)
        return d - self.length, np.concatenate([along, np.zeros_like(along)], axis=-1)[..., None, :]


@dataclass(frozen=True, eq=False)
class PointOnLine(Pair):
    """The origin of B is on the z axis of A; in planar systems z lies in the plane."""

    planar: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Two rows, in the plane one."""
        return ("y",) if self.planar else ("x", "y")

    def rows(self, X: Array) -> pairs.Rows:
        """Distances along x and y of A; in the plane along the normal of the line."""
        value, rates = pairs.slides(X, "xy")
        if not self.planar:
            return value, rates
        across = pairs.flat_frame(self.X_A)[:3, 1] @ self.X_A[:3, :3]  # in axes of A
        return X[..., :3, 3] @ across[:, None], np.broadcast_to(np.r_[across, 0.0, 0.0, 0.0], (*X.shape[:-2], 1, 6))


@dataclass(frozen=True, eq=False)
class PointOnPlane(Pair):
    """The origin of B is in the xy-plane of A."""

    @property
    def names(self) -> tuple[str, ...]:
        """One row."""
        return ("z",)

    def rows(self, X: Array) -> pairs.Rows:
        """Height over the plane."""
        return pairs.slides(X, "z")


@dataclass(frozen=True, eq=False)
class PointOnCurve(Pair):
    """The origin of B is on a curve that is fixed in frame A: the distances from its nearest point, across the curve.

    Beyond the ends of an open curve its tangents go on. `how` says where the tangent came from. Off the curve the
    rows turn by jumps where the tangent passes the xy-plane of A; their length does not.
    """

    curve: Curve
    planar: bool = False

    @property
    def how(self) -> str:
        """'spline', 'supplied', 'complex step' or 'central differences'."""
        return self.curve.how

    @property
    def names(self) -> tuple[str, ...]:
        """Two rows, in the plane one."""
        return ("normal",) if self.planar else ("normal 1", "normal 2")

    def rows(self, X: Array) -> pairs.Rows:
        """Distances along the normals at the nearest point."""
        value, rates = self.curve.distances(X[..., :3, 3], self.planar)
        return value, np.concatenate([rates, np.zeros_like(rates)], axis=-1)


@dataclass(frozen=True, eq=False)
class Coupling(Constraint):
    """A linear relation of coordinates: value of `of` = sum of multiplier * source + `offset`; a gear has one source.

    Coordinates may be ones that follow others or are held, so that they are not in q.
    """

    name: str
    of: str
    sources: Mapping[str, float]
    offset: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """One row."""
        return ("relation",)

    def residual(self, system: System, q: Any) -> Array:
        """How far it is violated (..., 1), in the unit of `of`."""
        q = as_q(system, q)
        check_coordinates(system, (self.of, *self.sources))
        value = coordinate_value(system, q, self.of) - self.offset
        return (value - sum(m * coordinate_value(system, q, s) for s, m in self.sources.items()))[..., None]

    def jacobian(self, system: System, q: Any) -> Array:
        """Derivatives (..., 1, nv)."""
        check_coordinates(system, (self.of, *self.sources))
        row = coordinate_row(system, self.of) - sum(m * coordinate_row(system, s) for s, m in self.sources.items())
        return np.array(np.broadcast_to(row, (*as_q(system, q).shape[:-1], 1, system.nv)))


def gear(driven: str, driver: str, ratio: float, offset: float = 0.0) -> Coupling:
    """Two coordinates in gear: driven = ratio * driver + offset."""
    return Coupling(f"gear {driven}", driven, {driver: ratio}, offset)


def check_coordinates(system: System, names: Iterable[str]) -> None:
    """Refuse names that are no coordinates, or that are parts of quaternions."""
    known = (*system.coordinate_names, *system.couplings)
    balls = {system.coordinate_names[i + k] for i in system.layout.quaternion_q for k in range(4)}
    for name in names:
        if name not in known:
            raise UnknownNameError("coordinate", name, known, system.name)
        if name in balls:
            raise InputError(f"{name!r} is part of a quaternion; only angles and lengths can be coupled")


@dataclass(frozen=True, eq=False)
class UserConstraint(Constraint):
    """A function of q that must be zero. `how` says where derivatives come from; see `user_constraint`."""

    name: str
    function: Callable[[Array], Any]
    count: int
    how: str
    derivative: Callable[[Array], Any] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """A number for each row."""
        return tuple(str(i) for i in range(self.count))

    def residual(self, system: System, q: Any) -> Array:
        """Values (..., size) of the function; it is called with one configuration (nq,) at a time."""
        shape = (self.count,)
        return _each(
            lambda x: reals(self.function(x), f"constraint {self.name!r}").reshape(shape), as_q(system, q), shape
        )

    def jacobian(self, system: System, q: Any) -> Array:
        """Derivatives (..., size, nv)."""
        shape = (self.count, system.nv)

        def one(x: Array) -> Array:
            return jacobian_of(self.function, self.derivative, self.how, system.layout, x).reshape(shape)

        return _each(one, as_q(system, q), shape)


def _each(function: Callable[[Array], Array], q: Array, shape: tuple[int, ...]) -> Array:
    out = np.empty((*q.shape[:-1], *shape))
    for index in np.ndindex(q.shape[:-1]):
        out[index] = function(q[index])
    return out


def user_constraint(
    system: System, name: str, function: Callable[[Array], Any], jacobian: Callable[[Array], Any] | None = None,
    at: Any = None,
) -> UserConstraint:  # fmt: skip
    """The constraint function(q) = 0; the function takes q (nq,) and gives one number or an array (m,).

    `jacobian`, where given, gives (m, nv) by the velocity coordinates, and is checked against central differences at
    the configuration `at` (default: a random one). Else derivatives are by complex steps where the function takes
    complex numbers and is analytic at `at`, else by central differences; `.how` says which.
    Errors: `InputError` for a wrong Jacobian, with its worst entry, or values that are not finite.
    """
    q = system.random(0) if at is None else as_q(system, at)
    found = checked_value(name, function, q)
    if jacobian is None:
        return UserConstraint(name, function, found.size, way_of(function, system.layout, q))
    rows = jacobian if found.ndim else lambda q: np.atleast_2d(jacobian(q))
    check_supplied(name, function, rows, system.layout, q, system.velocity_names)
    return UserConstraint(name, function, found.size, SUPPLIED, rows)


# ---- what a system has


def closure_of(system: System, joint: str, own: bool = False) -> Closure | Carried:
    """The closure of a joint, by the rows that its type takes away.

    Coordinates of the joint that follow others, are held, or are part of a relation have a row each besides, for
    they are not free; with `own=True` all of them do, so that the residual is zero only where q has their values, too.
    So they do in any case where what the type takes away has no fixed axes: its closure is `Carried`.
    """
    mechanism = system.mechanism
    if joint not in mechanism.joints:
        raise UnknownNameError("joint", joint, mechanism.joints, system.name)
    j = mechanism.joints[joint]
    particle = mechanism.bodies[j.child].particle
    X_PF, X_CM = (X.evaluate(mechanism.parameters) for X in (j.X_PF, j.X_CM))
    X_PF, X_CM = pairs.frames_of(j.type, X_PF, X_CM, system.dim, particle)
    names, hold = system.coordinates_of_joint(joint), pairs.hold_of(j.type, system.dim, particle)
    if hold is None:
        motion = motion_of(system, j, slides_along_z(j.type, system.dim, particle))
        return Carried(joint, j.parent, j.child, motion, X_A=X_PF, X_B=X_CM)
    related = {n for r in system.relations for n in (r.of, *r.sources)} | system.couplings.keys()
    groups = pairs.reading_groups(j.type, system.dim, particle)
    tied = [(tuple(names[i] for i in group), kind) for group, kind in groups]
    tied = [t for t in tied if own or related & {*t[0]}]
    return Closure(joint, j.parent, j.child, hold, hold.pitch or 0.0, tuple(tied), X_A=X_PF, X_B=X_CM)


def declared(system: System, constraint: Declared) -> Pair:
    """The constraint of a record of the description."""
    X_A, X_B = constraint.frames(system.parameters, system.dim)
    ends: Any = {"X_A": X_A, "X_B": X_B}
    names = constraint.name, constraint.parent, constraint.child
    if constraint.rod:
        return Distance(*names, constraint.length(system.parameters), **ends)
    if len(position_rows(constraint.of, 3)) == 2:
        return PointOnLine(*names, system.dim == 2, **ends)
    return PointOnPlane(*names, **ends)


@explained
def of_system(system: System, own: bool = True) -> list[Constraint]:
    """The constraints of a system: its closures, the declared ones, the relations of several coordinates.

    With `own=False` the coordinates of the joints that close loops are left out where nothing else depends on them.
    """
    out: list[Constraint] = [closure_of(system, name, own) for name in system.closures]
    out += [declared(system, c) for c in system.mechanism.constraints.values()]
    return out + [Coupling(r.of, r.of, r.sources, r.offset) for r in system.relations]
