"""The constraint zoo: each kind of constraint is one small class with its equations and their exact derivatives.

Every constraint has a `name`, row `names`, their number `size`, `residual(system, q) -> (..., m)` in metres and
radians, zero where it holds, and `jacobian(system, q) -> (..., m, nv)`, its derivatives by the velocity coordinates,
exact where the constraint is violated, too. `of_system` lists those that a system has.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.calls import explained
from kempe.errors import InputError, UnknownNameError
from kempe.kinematics.configuration import as_q
from kempe.kinematics.constraints import coordinate_row, coordinate_value
from kempe.kinematics.curves import Curve
from kempe.kinematics.derivatives import SUPPLIED, check_supplied, checked_value, jacobian_of, way_of
from kempe.kinematics.forward import fk
from kempe.kinematics.forward import jacobian as frame_jacobian
from kempe.kinematics.loops import evaluate, full
from kempe.model.loops import Loops, loops_of, must_carry
from kempe.model.reduced import flat_frame
from kempe.reals import reals
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

Rows = tuple[Array, Array]
"""Values (..., m) of rows that look at the pose X of B in A, and the matrix (..., m, 6) that takes the twist [v; w] of
B against A, at the origin of B and in axes of A, to their rates."""
_EYE = np.eye(4)

# ---- the zoo


class SystemConstraint(ABC):
    """A holonomic constraint f(q) = 0."""

    name: str

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """A name for each row."""

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.names)

    @abstractmethod
    def residual(self, system: System, q: Any) -> Array:
        """How far it is violated (..., size), in metres and radians."""

    @abstractmethod
    def jacobian(self, system: System, q: Any) -> Array:
        """Derivatives (..., size, nv) of the residual by the velocity coordinates."""


@dataclass(frozen=True, eq=False)
class Tied(SystemConstraint):
    """A constraint that a system has, by its rows of the packed equations."""

    name: str
    loops: Loops
    rows: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """What each row holds: 'x', 'rz', 'distance', ..."""
        return tuple(self.loops.names[i][1] for i in self.rows)

    def residual(self, system: System, q: Any) -> Array:
        """How far it is violated (..., size), in metres and radians."""
        return evaluate(system, q, False, loops=self.loops)[0][..., list(self.rows)]

    def jacobian(self, system: System, q: Any) -> Array:
        """Derivatives (..., size, nv) of the residual by the velocity coordinates."""
        return evaluate(system, q, loops=self.loops)[1][..., list(self.rows), :]


@dataclass(frozen=True, eq=False)
class Pair(SystemConstraint):
    """A constraint on where frame B is in frame A: `X_A` on the body or frame `a`, `X_B` on `b`."""

    name: str
    a: str
    b: str
    X_A: Array = field(default_factory=lambda: _EYE, kw_only=True)
    X_B: Array = field(default_factory=lambda: _EYE, kw_only=True)

    @abstractmethod
    def rows(self, X: Array) -> Rows:
        """Residual (..., size) and rates (..., size, 6) of the pose X of B in A."""

    def residual(self, system: System, q: Any) -> Array:
        """How far it is violated (..., size), in metres and radians."""
        return self.rows(self.pose(system, as_q(system, q)))[0]

    def jacobian(self, system: System, q: Any) -> Array:
        """Derivatives (..., size, nv) of the residual by the velocity coordinates."""
        return self.rows(self.pose(system, q := as_q(system, q)))[1] @ self.motion(system, q)

    def pose(self, system: System, q: Array) -> Array:
        """Pose (..., 4, 4) of B in A."""
        return spatial.inverse(fk(system, q, self.a) @ self.X_A) @ fk(system, q, self.b) @ self.X_B

    def motion(self, system: System, q: Array) -> Array:
        """Matrix (..., 6, nv): velocity coordinates to the twist of B against A, at the origin of B, in axes of A."""
        ends = ((self.a, self.X_A), (self.b, self.X_B))
        return _motion(*((fk(system, q, f), X, frame_jacobian(system, q, f)) for f, X in ends))


@dataclass(frozen=True, eq=False)
class Distance(Pair):
    """The origins of two frames are `length` metres apart: a rod with a ball joint at each end."""

    length: float

    @property
    def names(self) -> tuple[str, ...]:
        """One row."""
        return ("distance",)

    def rows(self, X: Array) -> Rows:
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

    def rows(self, X: Array) -> Rows:
        """Distances along x and y of A; in the plane along the normal of the line."""
        value, rates = _slides(X, "xy")
        if not self.planar:
            return value, rates
        across = flat_frame(self.X_A)[:3, 1] @ self.X_A[:3, :3]  # in axes of A
        return X[..., :3, 3] @ across[:, None], np.broadcast_to(np.r_[across, 0.0, 0.0, 0.0], (*X.shape[:-2], 1, 6))


@dataclass(frozen=True, eq=False)
class PointOnPlane(Pair):
    """The origin of B is in the xy-plane of A."""

    @property
    def names(self) -> tuple[str, ...]:
        """One row."""
        return ("z",)

    def rows(self, X: Array) -> Rows:
        """Height over the plane."""
        return _slides(X, "z")


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

    def rows(self, X: Array) -> Rows:
        """Distances along the normals at the nearest point."""
        value, rates = self.curve.distances(X[..., :3, 3], self.planar)
        return value, np.concatenate([rates, np.zeros_like(rates)], axis=-1)


@dataclass(frozen=True, eq=False)
class Coupling(SystemConstraint):
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


def _motion(a: tuple[Array, Array, Array], b: tuple[Array, Array, Array]) -> Array:
    """Matrix (..., 6, n) to the twist of B against A, at the origin of B, in axes of A.

    Each end is a pose X_WB, a pose on it, and the Jacobian (..., 6, n) of the first, world-aligned.
    """
    (p_A, J_A, R_A), (p_B, J_B, _) = (_placed(*end) for end in (a, b))
    v = J_B[..., :3, :] - J_A[..., :3, :] + spatial.skew(p_B - p_A) @ J_A[..., 3:, :]
    back = np.swapaxes(R_A, -1, -2)
    return np.concatenate([back @ v, back @ (J_B[..., 3:, :] - J_A[..., 3:, :])], axis=-2)


def _placed(X_WB: Array, X: Array, J: Array) -> tuple[Array, Array, Array]:
    """Origin, world-aligned Jacobian and rotation of a frame at X on one whose Jacobian is J."""
    X_W = X_WB @ X
    J = np.broadcast_to(J, (*X_W.shape[:-2], *J.shape[-2:]))
    shift = spatial.skew(X_WB[..., :3, 3] - X_W[..., :3, 3])
    J = np.concatenate([J[..., :3, :] + shift @ J[..., 3:, :], J[..., 3:, :]], axis=-2)
    return X_W[..., :3, 3], J, X_W[..., :3, :3]


def _slides(X: Array, axes: str) -> Rows:
    """Positions of M along some axes of F."""
    index = ["xyz".index(a) for a in axes]
    rates = np.zeros((*X.shape[:-2], len(index), 6))
    rates[..., np.arange(len(index)), index] = 1.0
    return X[..., index, 3], rates


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
class UserConstraint(SystemConstraint):
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


@explained
def of_system(system: System, own: bool = True) -> list[SystemConstraint]:
    """The constraints of a system: its closures, the declared ones, the relations of several coordinates.

    With `own=False` the coordinates of the joints that close loops are left out where nothing else depends on them.
    """
    loops = full(system, False) if own else loops_of(system, must_carry(system), length=1.0)
    rows: dict[tuple[str, bool], list[int]] = {}
    for i, (name, what) in enumerate(loops.names):
        rows.setdefault((name, what == "relation"), []).append(i)
    order = [(n, False) for n in (*system.closures, *system.mechanism.constraints)]
    order += [(r.of, True) for r in system.relations]
    return [Tied(key[0], loops, tuple(rows[key])) for key in order if key in rows]
