"""Solids that planar regions sweep in space: moved along their normal, or turned about an axis.

They are the places that chains reach whose other joints move a frame in a plane.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kempe.errors import UnsupportedError
from kempe.forward.fk import fk, jacobian
from kempe.model.primitive_table import local_chain
from kempe.spatial import Array
from kempe.workspace.planar.planar_chain import PlanarChain, PlanarJoint
from kempe.workspace.planar.planar_workspace import MOST, at_zero
from kempe.workspace.planar.plane_curves import (
    NOTHING,
    SAME,
    PlanarRegion,
    PlaneCurve,
    PlanePiece,
    RegionOfArcs,
    merged,
)

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- solids

# About an axis in the plane or parallel to it, a point of the plane at x beside the axis describes
# a circle whose radius is the root of x^2 + d^2, with the distance d of the plane from the axis; so
# places at x and -x are one. The volume is that of Pappus (about 340).

FINE = 0.003
"""Angle between the points of an arc from which the nearest of it is looked for."""
TURNS = 721
"""Turns at which a box about a solid is read."""
NODES = 24
"""Nodes of Gauss and Legendre for an arc of at most a quarter of a turn."""


@dataclass(frozen=True)
class Folded(RegionOfArcs):
    """The points of a region, and those that are across the line x = 0 from them."""

    inner: PlanarRegion
    counted: bool = False
    is_curve: bool = False

    @property
    def size(self) -> float:
        """A length of the region."""
        return self.inner.size

    @property
    def limited(self) -> int:
        """How many joints of its chain have limits."""
        return self.inner.limited

    @cached_property
    def candidates(self) -> list[PlaneCurve]:
        """Pieces of all curves on which it can end."""
        pieces = [cast(PlanePiece, piece) for piece in self.inner.ends]
        across = [
            PlanePiece(
                -p.centre.conjugate(), p.radius, np.pi - p.start, -p.sweep, -p.way.conjugate()
            )
            for p in pieces
        ]
        return merged([*pieces, *across], SAME * self.size)

    def solutions(self, p: complex) -> int:
        """1 for a point that it holds, else 0."""
        return int(np.any(self.inner.holds(np.array([p, -p.conjugate()]))))


@dataclass(frozen=True, eq=False)
class SweptSolid:
    """The places that a frame reaches whose chain moves it in a plane, and that plane in space.

    `axes` (3, 3) are unit vectors along the plane and across it, from `origin` (3,), in the ground
    frame.
    """

    section: PlanarRegion
    origin: Array
    axes: Array = field(repr=False)

    @property
    def size(self) -> float:
        """A length of it."""
        return self.section.size

    @property
    def limited(self) -> int:
        """How many joints of the planar chain have limits: the work grows with a power of that."""
        return self.section.limited

    @property
    def measure(self) -> float:
        """Its volume in cubic metres, exact but for rounding."""
        raise NotImplementedError

    @property
    def extent(self) -> Array:
        """The least and the largest x, y and z (2, 3) in metres, of a box about it."""
        raise NotImplementedError

    def contains(self, points: Array) -> np.ndarray:
        """Whether points (n, 3) are inside; on the boundary rounding decides, and NaN is nowhere."""
        finite = np.flatnonzero(np.isfinite(points).all(axis=1))
        out = np.zeros(len(points), dtype=bool)
        out[finite] = self._holds(*self._local(points[finite]))
        return out

    def distance(self, points: Array) -> Array:
        """Distances (n,) >= 0 of points (n, 3) from the boundary, in metres; NaN for NaN."""
        finite = np.flatnonzero(np.isfinite(points).all(axis=1))
        out = np.where(np.isnan(points).any(axis=1), np.nan, np.inf)
        out[finite] = self._far(*self._local(points[finite]))
        return out

    def _holds(self, x: Array, y: Array, h: Array) -> np.ndarray:
        raise NotImplementedError

    def _far(self, x: Array, y: Array, h: Array) -> Array:
        raise NotImplementedError

    def _local(self, points: Array) -> Array:
        return ((points - self.origin) @ self.axes.T).T

    @cached_property
    def _rim(self) -> Array:
        """The x and y (2, k) of points that have the section inside the box about them."""
        found = np.concatenate([piece.extremes for piece in self.section.ends])
        return np.stack([np.real(found), np.imag(found)])


@dataclass(frozen=True, eq=False)
class Prism(SweptSolid):
    """The section, moved across its plane from `low` to `high` [m]."""

    low: float = 0.0
    high: float = 0.0

    @property
    def measure(self) -> float:
        """Its volume in cubic metres, exact but for rounding."""
        return float(sum(p.moment for p in self.section.ends)) * (self.high - self.low)

    @property
    def extent(self) -> Array:
        """The least and the largest x, y and z (2, 3) in metres, of a box about it."""
        x, y = self._rim
        sides = itertools.product((x.min(), x.max()), (y.min(), y.max()), (self.low, self.high))
        corners = np.array(list(sides)) @ self.axes + self.origin
        return np.stack([corners.min(axis=0), corners.max(axis=0)])

    def _holds(self, x: Array, y: Array, h: Array) -> np.ndarray:
        return self.section.holds(x + 1j * y) & (h >= self.low) & (h <= self.high)

    def _far(self, x: Array, y: Array, h: Array) -> Array:
        z = x + 1j * y
        beside = _nearest(self.section.ends, z)
        inside = self.section.holds(z)
        above = np.maximum(self.low - h, h - self.high)  # negative between the ends
        outside = np.hypot(np.where(inside, 0.0, beside), np.maximum(above, 0.0))
        return np.where(inside & (above < 0.0), np.minimum(beside, -above), outside)


@dataclass(frozen=True, eq=False)
class Revolved(SweptSolid):
    """The section, turned about the axis that is along its y, `beside` [m] across the plane from
    its origin.
    """

    beside: float = 0.0

    @property
    def measure(self) -> float:
        """Its volume in cubic metres, exact but for rounding: pi times the integral of |x| over the
        folded section.
        """
        return (
            0.5
            * np.pi
            * sum(
                _integral(cast(PlanePiece, p), lambda x: x * np.abs(x)) for p in self.section.ends
            )
        )

    @property
    def extent(self) -> Array:
        """The least and the largest x, y and z (2, 3) in metres, of a box about it."""
        x, y = self._rim
        radius = float(np.hypot(np.abs(x).max(), self.beside))
        axis = self.axes[1]
        ends = np.outer((y.min(), y.max()), axis) + self.origin
        wide = radius * np.sqrt(np.maximum(1.0 - axis**2, 0.0))
        return np.stack([ends.min(axis=0) - wide, ends.max(axis=0) + wide])

    def _holds(self, x: Array, y: Array, h: Array) -> np.ndarray:
        r = np.hypot(x, h)
        along = np.sqrt(np.maximum(r * r - self.beside**2, 0.0))
        return self.section.holds(along + 1j * y) & (r >= abs(self.beside))

    def _far(self, x: Array, y: Array, h: Array) -> Array:
        z = np.hypot(x, h) + 1j * y
        straight = abs(self.beside) <= NOTHING * self.size
        return _nearest(self.section.ends, z) if straight else _nearest_of_lines(self._outlines, z)

    @cached_property
    def _outlines(self) -> list[np.ndarray]:
        """Lines (k,) of the boundary over radius and height: images of that of the section, and of
        the line x = 0.
        """
        ends = [cast(PlanePiece, p) for p in self.section.ends]
        out: list[np.ndarray] = []
        for piece in ends:
            p = piece.points(FINE) if piece.is_arc else piece.at(np.linspace(0.0, 1.0, 400))
            out.append(np.hypot(np.real(p), self.beside) + 1j * np.imag(p))
        line = PlanePiece(-4j * self.size, 0.0, way=8j * self.size)
        t = np.unique(np.concatenate([[0.0, 1.0], *(line.meets(p) for p in ends)]))
        for a, b in itertools.pairwise(t.tolist()):
            if bool(self.section.holds(line.at(0.5 * (a + b)))):
                out.append(abs(self.beside) + line.at(np.array([a, b])))
        return out


@dataclass(frozen=True, eq=False)
class Turned(SweptSolid):
    """The section, turned from `low` to `high` [rad], less than once, about the axis that is along
    its y.

    It lies `beside` [m] across the plane. Places on both sides of the axis, x and -x, come at
    angles that differ by 2 arctan(x / beside): a place of both is reached twice where the intervals
    of these angles overlap.
    """

    beside: float = 0.0
    low: float = 0.0
    high: float = 0.0

    @property
    def measure(self) -> float:
        """Its volume in cubic metres, exact but for rounding: the angles at which each radius and
        height is reached.

        Of the section these are all, less those that the points across the axis reach, too, counted
        once.
        """
        wide = self.high - self.low
        d = abs(self.beside)
        bent = [
            s * x
            for x in (d * np.tan(0.5 * wide), d * np.tan(np.pi - 0.5 * wide))
            if x > 0.0
            for s in (-1.0, 1.0)
        ]

        def twice(x: Array) -> Array:
            return np.sign(x) * _overlapping(np.abs(x), wide, d)

        own, folded = (
            cast("list[PlanePiece]", r.ends) for r in (self.section, Folded(self.section))
        )
        once = sum(_integral(p, lambda x: 0.5 * wide * x * np.abs(x) - twice(x), bent) for p in own)
        return once + 0.5 * sum(_integral(p, twice, bent) for p in folded)

    @property
    def extent(self) -> Array:
        """The least and the largest x, y and z (2, 3) in metres, of a box about it, wider by some
        1e-5 of its size.
        """
        z = np.concatenate([cast(PlanePiece, piece).points(FINE) for piece in self.section.ends])
        turns = np.linspace(self.low, self.high, TURNS)
        least = np.full(3, np.inf)
        most = np.full(3, -np.inf)
        for turn in turns:
            u = (np.real(z) - 1j * self.beside) * np.exp(1j * turn)
            local: list[Array] = [np.real(u), np.imag(z), -np.imag(u)]
            p = np.stack(local, axis=-1) @ self.axes + self.origin
            least = np.minimum(least, p.min(axis=0))
            most = np.maximum(most, p.max(axis=0))
        step = max(float(turns[1] - turns[0]), FINE)  # between two the way is a chord of an arc
        room = 0.125 * step**2 * float(np.hypot(np.abs(z), self.beside).max())
        return np.stack([least - room, most + room])

    def _holds(self, x: Array, y: Array, h: Array) -> np.ndarray:
        r = np.hypot(x, h)
        out = np.zeros(x.shape, dtype=bool)
        along = np.sqrt(np.maximum(r * r - self.beside**2, 0.0))
        for side in (along, -along):
            turn = np.mod(
                np.angle((x - 1j * h) * np.conj(side - 1j * self.beside)) - self.low, 2.0 * np.pi
            )
            out |= self.section.holds(side + 1j * y) & (turn <= self.high - self.low)
        return out & (r >= abs(self.beside))

    def _far(self, x: Array, y: Array, h: Array) -> Array:
        raise UnsupportedError(
            "distances from a solid that is turned less than once are those of its map"
        )


def _overlapping(x: Array, wide: float, d: float) -> Array:
    """The integral from 0 to x (n,) >= 0 of t times the overlap of two intervals of angles, 2
    arctan(t / d) apart.
    """

    def apart(t: Any) -> Any:  # the integral of t times the angle between them
        return (t * t + d * d) * np.arctan2(t, d) - d * t

    near = np.minimum(x, d * np.tan(0.5 * wide)) if wide < np.pi else x
    out = 0.5 * wide * near**2 - apart(near)
    if wide > np.pi:  # and the other way round
        far = np.maximum(x, first := d * np.tan(np.pi - 0.5 * wide))
        out = out + 0.5 * (wide - 2.0 * np.pi) * (far**2 - first**2) + apart(far) - apart(first)
    return out


def _nearest(ends: list[PlaneCurve], z: np.ndarray) -> Array:
    best = np.full(z.shape, np.inf)
    for piece in ends:
        best = np.minimum(best, piece.distance(z))
    return best


def _nearest_of_lines(lines: list[np.ndarray], z: np.ndarray) -> Array:
    """Distances (n,) of points (n,) from lines of many corners."""
    best = np.full(z.shape, np.inf)
    for line in lines:
        corners: list[complex] = line.tolist()
        for a, b in itertools.pairwise(corners):
            way = b - a
            t = np.clip(np.real((z - a) * way.conjugate()) / max(abs(way) ** 2, 1e-300), 0.0, 1.0)
            best = np.minimum(best, np.abs(z - a - t * way))
    return best


def _integral(piece: PlanePiece, of: Callable[[Array], Array], bent: Iterable[float] = ()) -> float:
    """The integral of a function of x over y along a piece; it is smooth but at x = 0 and at those
    of `bent`.
    """
    across = piece.radius if piece.is_arc else abs(piece.way)
    cuts: list[Array] = [np.linspace(0.0, 1.0, 2 + int(abs(piece.sweep) / (0.5 * np.pi)))]
    for x in (0.0, *bent):
        cuts.append(
            piece.meets(
                PlanePiece(x + 1j * (piece.centre.imag - 2.0 * across), 0.0, way=4j * across)
            )
        )
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    total = 0.0
    for a, b in itertools.pairwise(np.unique(np.concatenate(cuts).clip(0.0, 1.0)).tolist()):
        p = piece.at(0.5 * (a + b) + 0.5 * (b - a) * nodes)
        dy = (
            np.real(p - piece.centre) * piece.sweep
            if piece.is_arc
            else np.full(NODES, piece.way.imag)
        )
        total += 0.5 * (b - a) * float(weights @ (of(np.real(p)) * dy))
    return total


# ---- the solid of a chain

PARALLEL = 1e-9
"""Sine of an angle below which directions are parallel, and cosine below which they are at right
angles."""


@dataclass(frozen=True)
class SpaceJoint:
    """A joint at zero: it turns about a line through `point` by `turn` a unit, or (turn 0) slides
    by `way` a unit.
    """

    turn: Array
    point: Array
    way: Array
    low: float
    high: float

    @property
    def direction(self) -> Array:
        """The unit vector of its axis."""
        v = self.turn if self.turns else self.way
        return v / np.linalg.norm(v)

    @property
    def turns(self) -> bool:
        """Whether it turns."""
        return bool(self.turn.any())

    def in_plane(self, o: Array, axes: Array) -> PlanarJoint | None:
        """The joint in the plane of two unit vectors (2, 3) through o; None if it does not move
        along that.
        """
        normal = np.cross(*axes)
        if self.turns:
            if np.linalg.norm(np.cross(self.direction, normal)) > PARALLEL:
                return None
            return PlanarJoint(
                _complex(axes @ (self.point - o)),
                float(self.turn @ normal),
                0j,
                self.low,
                self.high,
            )
        if abs(self.direction @ normal) > PARALLEL:
            return None
        return PlanarJoint(None, 0.0, _complex(axes @ self.way), self.low, self.high)


def swept_solid(system: Model, frame: str) -> SweptSolid | None:
    """The solid that a frame of a chain in space reaches; None where it is of another kind."""
    if (joints := _space_joints(system, frame)) is None:
        return None
    tip = fk(system, at_zero(system), frame)[:3, 3]
    for solid in (*_prisms(joints, tip), *_revolved(joints, tip)):
        if solid.section.ends:
            return solid
    return None


def _space_joints(system: Model, frame: str) -> list[SpaceJoint] | None:
    """The joints that move a frame's origin; None where there are others than turns and slides of
    their own.
    """
    table, _, v_index = local_chain(system.structure.table, frame)
    if system.nq != system.nv or len(table.iv) != len(v_index) or system.structure.closures:
        return None
    if system._mechanism.constraints or system.structure.relations or len(v_index) > 2 * MOST:
        return None
    q = at_zero(system)
    tip = fk(system, q, frame)[:3, 3]
    J = jacobian(system, q, frame)[:, v_index]
    out: list[SpaceJoint] = []
    for column, low, high in zip(
        J.T, system.lower[v_index].tolist(), system.upper[v_index].tolist(), strict=True
    ):
        v = column[:3]
        w = column[3:]
        rate = float(w @ w)
        if low == high:
            continue
        if rate == 0.0:
            if not np.isfinite(high - low):
                return None
            out.append(SpaceJoint(np.zeros(3), tip, v, low, high))
        elif abs(float(v @ w)) > PARALLEL * rate:
            return None  # a screw
        else:
            out.append(SpaceJoint(w, tip + np.cross(w, v) / rate, np.zeros(3), low, high))
    while (
        out
        and out[-1].turns
        and np.linalg.norm(np.cross(out[-1].direction, tip - out[-1].point))
        < NOTHING * 1e3 * (1.0 + np.linalg.norm(tip))
    ):
        out.pop()  # the tip is on its axis
    return out if len(out) <= MOST else None


def _prisms(joints: list[SpaceJoint], tip: Array) -> Iterator[SweptSolid]:
    """With one slide across the plane in which all other joints move the tip."""
    for slide in joints:
        if slide.turns:
            continue
        axes = _basis(slide.direction)
        rest = [j.in_plane(tip, axes[:2]) for j in joints if j is not slide]
        if rest and all(j is not None for j in rest):
            chain = PlanarChain.of(cast("list[PlanarJoint]", rest), 0j)
            if len(chain.joints) > 1:
                rate = float(np.linalg.norm(slide.way))
                yield Prism(chain, tip, axes, rate * slide.low, rate * slide.high)


def _revolved(joints: list[SpaceJoint], tip: Array) -> Iterator[SweptSolid]:
    """With a first joint that turns about an axis parallel to the plane in which the others move."""
    first = joints[0] if joints else None
    if first is None or not first.turns:
        return
    a = first.direction
    rate = float(np.linalg.norm(first.turn))
    low = rate * first.low
    high = rate * first.high
    origin = first.point + a * ((tip - first.point) @ a)
    for normal in [j.direction for j in joints[1:] if j.turns][:1] or [_basis(a)[0], _basis(a)[1]]:
        if abs(normal @ a) > PARALLEL:
            continue
        axes = np.stack([np.cross(a, normal), a, normal])
        rest = [j.in_plane(origin, axes[:2]) for j in joints[1:]]
        if rest and all(j is not None for j in rest):
            chain = PlanarChain.of(
                cast("list[PlanarJoint]", rest), _complex(axes[:2] @ (tip - origin))
            )
            if len(chain.joints) > 1:
                beside = float(normal @ (tip - origin))
                if high - low >= 2.0 * np.pi:
                    yield Revolved(Folded(chain), origin, axes, beside)
                else:
                    yield Turned(chain, origin, axes, beside, low, high)


def _complex(xy: Array) -> complex:
    return complex(float(xy[0]), float(xy[1]))


def _basis(normal: Array) -> Array:
    """Unit vectors (3, 3), the last of which is that one."""
    first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(normal, first), normal], dtype=float)
