"""Arcs and segments in the plane, as complex numbers, and regions that such curves bound."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from kempe.numerics.intervals import unite_intervals

TURN = 2.0 * np.pi
TOUCH = 1e-13
"""Square of half the chord that circles share, in squares of the radius, below which they touch."""
ENDS = 1e-9
"""Part of a curve by which it is taken as longer, so that curves that end on others meet these."""


# ---- curves


def to_pair(z: Any) -> list[float]:
    """Convert a complex number to x and y."""
    point = complex(z)
    return [point.real, point.imag]


@dataclass(frozen=True)
class PlanePiece:
    """An arc or a segment with a parameter from 0 to 1. The arc is about `centre` with `radius`,
    from the angle `start` by `sweep`; the segment (radius 0) goes from `centre` by `way`.
    """

    centre: complex
    radius: float
    start: float = 0.0
    sweep: float = 0.0
    way: complex = 0j

    @property
    def is_arc(self) -> bool:
        """Whether the piece is an arc, not a segment."""
        return self.radius > 0.0

    @property
    def kind(self) -> str:
        """The kind of the piece, as a noun."""
        return "arc" if self.is_arc else "segment"

    def sample_points(self, fine: float) -> np.ndarray:
        """Sample points (k,) along the piece, which turns by less than an angle `fine` between
        them.
        """
        return self.evaluate_points(np.linspace(0.0, 1.0, max(2, int(abs(self.sweep) / fine) + 2)))

    def data(self) -> dict[str, Any]:
        """Return the numbers of the piece, for JSON."""
        arc = {
            "centre": to_pair(self.centre),
            "radius": self.radius,
            "start": self.start,
            "sweep": self.sweep,
        }
        ends = {
            "kind": self.kind,
            "from": to_pair(self.evaluate_points(0.0)),
            "to": to_pair(self.evaluate_points(1.0)),
        }
        return ends | (arc if self.is_arc else {})

    @property
    def length(self) -> float:
        """Length of the piece in metres."""
        return self.radius * abs(self.sweep) if self.is_arc else abs(self.way)

    def evaluate_points(self, t: np.ndarray | float) -> np.ndarray:
        """Evaluate points (...) at parameters t (...)."""
        t = np.asarray(t, dtype=float)
        if self.is_arc:
            return self.centre + self.radius * np.exp(1j * (self.start + self.sweep * t))
        return self.centre + self.way * t

    def evaluate_tangents(self, t: Any) -> np.ndarray:
        """Evaluate unit tangents (...) at parameters (...)."""
        if self.is_arc:
            return 1j * np.sign(self.sweep) * np.exp(1j * (self.start + self.sweep * t))
        return np.full(np.shape(t), self.way / abs(self.way))

    def evaluate_tangent(self, t: float) -> complex:
        """Evaluate the unit tangent at a parameter."""
        return complex(self.evaluate_tangents(t))

    @property
    def is_whole(self) -> bool:
        """Whether the piece is a whole circle."""
        return self.is_arc and abs(self.sweep) >= TURN - 1e-12

    def move_piece(self, turn: complex, by: complex) -> PlanePiece:
        """Turn the piece about the origin by a unit number, and move it."""
        angle = self.start + float(np.angle(turn))
        centre = turn * self.centre + by
        return PlanePiece(centre, self.radius, angle, self.sweep, turn * self.way)

    def cut_piece(self, a: float, b: float) -> PlanePiece:
        """Return the piece from the parameter a to b."""
        if self.is_arc:
            return PlanePiece(
                self.centre, self.radius, self.start + self.sweep * a, self.sweep * (b - a)
            )
        return PlanePiece(self.centre + self.way * a, 0.0, way=self.way * (b - a))

    def find_parameters(self, p: np.ndarray, slack: float = ENDS) -> tuple[np.ndarray, np.ndarray]:
        """Find the parameters (...) of points (...) of the circle or line. A mask tells which
        points are on the piece.
        """
        if not self.is_arc:
            t = np.real((p - self.centre) * np.conj(self.way)) / abs(self.way) ** 2
            return t, (t > -slack) & (t < 1.0 + slack)
        sense = np.sign(self.sweep)
        size = abs(self.sweep)
        turn: np.ndarray = np.mod(sense * (np.angle(p - self.centre) - self.start), TURN)
        turn = np.where(turn > size + 0.5 * (TURN - size), turn - TURN, turn)
        t = turn / max(size, 1e-300)  # an arc may have shrunk to a point
        return t, (t > -slack) & (t < 1.0 + slack)

    def compute_offsets(self, p: np.ndarray) -> np.ndarray:
        """Compute how far points (...) are outside the circle or left of the line [m]. Inside or to
        the right it is negative.
        """
        if self.is_arc:
            return np.abs(p - self.centre) - self.radius
        return np.imag((p - self.centre) * np.conj(self.way)) / abs(self.way)

    def find_meetings(self, other: PlanePiece, slack: float = ENDS) -> np.ndarray:
        """Find the parameters (k,) of points in which the piece meets another one. Pieces of the
        same circle or line have none.
        """
        p = intersect_carriers(self, other)
        p = p[other.find_parameters(p, slack)[1]] if len(p) else p
        t, on = self.find_parameters(p, slack)
        return t[on]

    def compute_distances(self, p: np.ndarray) -> np.ndarray:
        """Compute the distances (...) of points (...) from the piece."""
        t, on = self.find_parameters(p)
        near = (
            np.abs(np.abs(p - self.centre) - self.radius)
            if self.is_arc
            else np.abs(p - self.evaluate_points(t))
        )
        return np.where(
            on,
            near,
            np.minimum(
                np.abs(p - self.evaluate_points(0.0)), np.abs(p - self.evaluate_points(1.0))
            ),
        )

    @property
    def extremes(self) -> np.ndarray:
        """The ends of the piece, and its points (k,) with extreme x or y."""
        ends = self.evaluate_points(np.array([0.0, 1.0]))
        if not self.is_arc:
            return ends
        sides = self.centre + self.radius * np.array([1.0, 1j, -1.0, -1j])
        return np.append(ends, sides[self.find_parameters(sides)[1]])

    @property
    def moment(self) -> float:
        """Half of the integral of x dy - y dx along the piece: its share of the area of a closed
        curve.
        """
        if not self.is_arc:
            return 0.5 * float((self.centre.conjugate() * self.way).imag)
        a = self.evaluate_points(0.0)
        b = self.evaluate_points(1.0)
        return (
            0.5 * float((self.centre.conjugate() * (b - a)).imag)
            + 0.5 * self.radius**2 * self.sweep
        )


def intersect_circles(
    centres: np.ndarray, radius: float, carrier: PlanePiece
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Intersect circles about centres (...) with the circle or line of a piece.

    Points are on both sides of a foot (...), along a unit number (...), as far as the root of a
    number (...) says: there are none if that is negative, or NaN, as for the same centre.
    """
    if carrier.is_arc:
        way = carrier.centre - centres
        far = np.abs(way)
        apart = far > 0.0
        far = np.where(apart, far, 1.0)
        unit = way / far
        along = 0.5 * (far + (radius**2 - carrier.radius**2) / far)
        square = np.where(apart, radius**2 - along**2, np.nan)
        return centres + along * unit, 1j * unit, square
    unit = np.full(centres.shape, carrier.way / abs(carrier.way))
    foot = carrier.centre + unit * np.real((centres - carrier.centre) * np.conj(unit))
    return foot, unit, radius**2 - np.abs(foot - centres) ** 2


def intersect_carriers(a: PlanePiece, b: PlanePiece) -> np.ndarray:
    """Intersect the circles or lines of two pieces; the same circle or line has no points."""
    if not a.is_arc and not b.is_arc:
        across = np.imag(np.conj(a.way) * b.way)
        if abs(across) < 1e-12 * abs(a.way) * abs(b.way):
            return np.zeros(0, dtype=complex)
        t = np.imag(np.conj(b.centre - a.centre) * b.way) / across
        return np.array([a.centre + t * a.way])
    if not a.is_arc:
        a, b = b, a
    if b.is_arc and abs(b.centre - a.centre) < 1e-12 * (a.radius + b.radius):
        return np.zeros(0, dtype=complex)
    foot, unit, rest = intersect_circles(np.array(a.centre), a.radius, b)
    if rest < -1e-10 * a.radius**2:
        return np.zeros(0, dtype=complex)
    half = np.sqrt(rest) if rest > TOUCH * a.radius**2 else 0.0
    return np.array([foot - half * unit, foot + half * unit])


def merge_pieces(pieces: Iterable[PlanePiece], same: float) -> list[PlanePiece]:
    """Merge pieces on the same circle or line that overlap. Those shorter than `same` metres are
    dropped.
    """
    groups: list[tuple[PlanePiece, list[tuple[float, float]]]] = []
    for piece in pieces:
        if piece.length < same:
            continue
        for first, spans in groups:
            if _is_same_carrier(first, piece, same):
                spans += _list_spans(first, piece)
                break
        else:
            whole = extend_piece(piece)
            groups.append((whole, _list_spans(whole, piece)))
    return [
        first.cut_piece(a, b)
        for first, spans in groups
        for a, b in unite_intervals(spans, slack=1e-12)
    ]


def extend_piece(piece: PlanePiece) -> PlanePiece:
    """Extend an arc to its circle, and a segment to a unit segment of its line. The circle begins
    at the angle 0, the unit segment at the point nearest to the origin.
    """
    if piece.is_arc:
        return PlanePiece(piece.centre, piece.radius, 0.0, TURN)
    unit = piece.way / abs(piece.way)
    return PlanePiece(piece.centre - unit * np.real(piece.centre * np.conj(unit)), 0.0, way=unit)


def _is_same_carrier(a: PlanePiece, b: PlanePiece, same: float) -> bool:
    """Whether two pieces lie on the same circle or line, up to `same` metres."""
    if a.is_arc != b.is_arc:
        return False
    if a.is_arc:
        return abs(a.centre - b.centre) < same and abs(a.radius - b.radius) < same
    off = [abs(np.imag((b.evaluate_points(t) - a.centre) * np.conj(a.way))) for t in (0.0, 1.0)]
    return max(off) < same


def _list_spans(first: PlanePiece, piece: PlanePiece) -> list[tuple[float, float]]:
    """List the intervals of parameters that a piece takes on a whole circle (0 to 1) or line."""
    if not first.is_arc:
        t = np.real(
            (piece.evaluate_points(np.array([0.0, 1.0])) - first.centre) * np.conj(first.way)
        )
        return [(float(t.min()), float(t.max()))]
    if piece.is_whole:
        return [(0.0, 1.0)]
    a = np.mod(min(piece.start, piece.start + piece.sweep), TURN) / TURN
    b = a + abs(piece.sweep) / TURN
    return [(a, b)] if b <= 1.0 else [(a, 1.0), (0.0, b - 1.0)]


# ---- regions

# The number of solutions of a point is constant where no curve of an arrangement passes: it is read
# on both sides of each piece. Both the area (Green) and the number at a point (by how often the
# pieces go round it) are sums over pieces.

NOTHING = 1e-12
SAME = 1e-10
"""Difference, in sizes of a region, up to which circles and lines are the same."""
ROUNDING = 1e-9
"""Error of an exact area or volume, in powers of the size of a region."""
BESIDE = 1e-6
"""How far beside a curve points are tried, in sizes of a region, at most as a part of the curve's
length, and nearer where another curve is near."""
PART = 0.02


@dataclass(frozen=True)
class PlanarRegion:
    """A region of the plane bounded by arcs and segments, or such a curve without area.

    `sides` are pieces with the numbers of solutions to their left and, less, to their right; where
    these are not `counted` they are 1 inside and 0 outside. `size` is a length in metres.
    """

    size: float
    sides: tuple[tuple[PlanePiece, int, int], ...] = ()
    counted: bool = False
    curve: tuple[PlanePiece, ...] = ()

    is_exact = True

    @property
    def is_curve(self) -> bool:
        """Whether the region is a curve, without area."""
        return bool(self.curve)

    @cached_property
    def boundary_pieces(self) -> list[PlanePiece]:
        """The pieces of the boundary, each with the region to its left, or the curve."""
        return [p for p, _, right in self.sides if not right] + list(self.curve)

    @cached_property
    def edges(self) -> list[PlanePiece]:
        """The pieces of the boundary without direction, joined where one continues another."""
        return merge_pieces(self.boundary_pieces, SAME * self.size)

    def count_solutions(self, p: np.ndarray) -> np.ndarray:
        """Count the solutions (...) at points (...) that are on no piece."""
        turns = np.zeros(np.shape(p))
        for piece, left, right in self.sides:
            turns += (left - right) * _compute_turn_angles(piece, np.asarray(p))
        return np.round(turns / TURN).astype(np.int64)

    def contains_points(self, p: np.ndarray) -> np.ndarray:
        """Whether (...) points (...), which are not on the boundary, are inside."""
        turns = np.zeros(np.shape(p))
        for piece in () if self.curve else self.boundary_pieces:
            turns += _compute_turn_angles(piece, np.asarray(p))
        return np.round(turns / TURN) != 0

    def measure_area(self) -> tuple[float, float]:
        """Measure the area [m^2], exact up to rounding, and that."""
        if self.is_curve:
            return 0.0, 0.0
        area = sum(piece.moment for piece in self.boundary_pieces)
        return float(area), ROUNDING * self.size**2

    def move_region(self, by: complex) -> PlanarRegion:
        """Return the region moved as a whole."""
        return replace(
            self,
            sides=tuple((p.move_piece(1.0, by), left, right) for p, left, right in self.sides),
            curve=tuple(p.move_piece(1.0, by) for p in self.curve),
        )


def arrange_region(
    pieces: Iterable[PlanePiece],
    numbers: Callable[[np.ndarray], np.ndarray],
    size: float,
    counted: bool = False,
) -> PlanarRegion:
    """Make the region of points with solutions, whose number changes on the pieces only.

    `numbers` (n,) of points (n,) that are on no piece are read on both sides of each piece between
    two meetings with others.
    """
    curves = merge_pieces(pieces, SAME * size)
    parts: list[PlanePiece] = []
    owners: list[int] = []
    for k, piece in enumerate(curves):
        cuts = [piece.find_meetings(other) for other in curves if other is not piece]
        t = np.unique(np.concatenate([[0.0, 1.0], *cuts]).clip(0.0, 1.0))
        t = t[np.concatenate([[True], np.diff(t) * piece.length > 10.0 * SAME * size])]
        t[-1] = 1.0
        parts += [piece.cut_piece(a, b) for a, b in itertools.pairwise(t)]
        owners += [k] * (len(t) - 1)
    if not parts:
        return PlanarRegion(size, counted=counted)
    middles = np.array([complex(part.evaluate_points(0.47)) for part in parts])
    room = np.array([min(BESIDE * size, PART * part.length) for part in parts])
    for k, piece in enumerate(curves):
        far = piece.compute_distances(middles)
        other = (np.array(owners) != k) & (far > 0.1 * SAME * size)
        room = np.where(other, np.minimum(room, 0.3 * far), room)
    beside = room * 1j * np.array([part.evaluate_tangent(0.47) for part in parts])
    found = numbers(np.concatenate([middles + beside, middles - beside]))
    found = found if counted else np.minimum(found, 1)
    sides: list[tuple[PlanePiece, int, int]] = []
    for part, a, b in zip(parts, *np.split(found, 2), strict=True):
        if a != b:
            sides.append(
                (part if a > b else part.cut_piece(1.0, 0.0), int(max(a, b)), int(min(a, b)))
            )
    return PlanarRegion(size, tuple(sides), counted)


def intersect_regions(one: PlanarRegion, two: PlanarRegion) -> PlanarRegion:
    """Intersect two regions; numbers of solutions are multiplied."""
    counted = one.counted and two.counted

    def count_common_solutions(p: np.ndarray) -> np.ndarray:
        """Count the solutions at points, as products of those of both regions."""
        return (
            one.count_solutions(p) * two.count_solutions(p)
            if counted
            else one.contains_points(p) & two.contains_points(p)
        )

    pieces = [
        p for r in (one, two) for p in ([s[0] for s in r.sides] if counted else r.boundary_pieces)
    ]
    return arrange_region(pieces, count_common_solutions, max(one.size, two.size), counted)


def mirror_region(region: PlanarRegion) -> PlanarRegion:
    """Return the union of a region and its mirror image across the line x = 0."""
    across = [
        PlanePiece(-p.centre.conjugate(), p.radius, np.pi - p.start, -p.sweep, -p.way.conjugate())
        for p in region.boundary_pieces
    ]
    return arrange_region(
        [*region.boundary_pieces, *across],
        lambda p: region.contains_points(p) | region.contains_points(-p.conj()),
        region.size,
    )


def offset_pieces(
    pieces: Iterable[PlanePiece], radius: float
) -> list[tuple[PlanePiece, PlanePiece]]:
    """Return curves of the centres of circles of a radius that touch pieces or meet their ends.
    Each comes with the piece, or point, that the circle touches, with the same parameters.
    """
    out: list[tuple[PlanePiece, PlanePiece]] = []
    for piece in pieces:
        if piece.is_arc:
            for r in (piece.radius + radius, piece.radius - radius):
                start = piece.start + (0.0 if r > 0.0 else np.pi)
                if r != 0.0:
                    out.append((replace(piece, radius=abs(r), start=start), piece))
        else:
            aside = 1j * piece.way / abs(piece.way) * radius
            out += [(replace(piece, centre=piece.centre + s * aside), piece) for s in (1.0, -1.0)]
        for t in () if piece.is_whole else (0.0, 1.0):
            corner = complex(piece.evaluate_points(t))
            out.append((PlanePiece(corner, radius, 0.0, TURN), PlanePiece(corner, 0.0)))
    return out


def shrink_region(region: PlanarRegion, radius: float) -> PlanarRegion:
    """Return the centres of circles of a radius that lie within a region."""

    def count_circles(p: np.ndarray) -> np.ndarray:
        """Count the circles about points that lie within the region: 1 or 0."""
        circles = [PlanePiece(z, radius, 0.0, TURN) for z in p.tolist()]
        return np.array(
            [region.contains_points(list_middles(c, region.edges)).all() for c in circles]
        )

    pieces = [piece for piece, _ in offset_pieces(region.edges, radius)]
    return arrange_region(pieces, count_circles, region.size + radius)


def list_middles(piece: PlanePiece, others: Iterable[PlanePiece]) -> np.ndarray:
    """List points (k,) of a piece, one between any two neighbouring meetings with others."""
    t = np.concatenate([[0.0, 1.0], *(piece.find_meetings(other) for other in others)])
    t = np.unique(t.clip(0.0, 1.0))
    return piece.evaluate_points(0.5 * (t[1:] + t[:-1]))


def _compute_turn_angles(piece: PlanePiece, p: np.ndarray) -> np.ndarray:
    """Compute the angles by which the direction from points (...) turns along a piece."""
    a = complex(piece.evaluate_points(0.0)) - p
    b = complex(piece.evaluate_points(1.0)) - p
    if not piece.is_arc:
        return np.angle(b * a.conj())
    # the angle is that of the chord, and a full turn more where p is between the arc and that
    parts = max(1, int(np.ceil(abs(piece.sweep) / 1.5)))
    total = np.zeros(p.shape)
    for k in range(parts):
        small = piece.cut_piece(k / parts, (k + 1) / parts)
        ends = complex(small.evaluate_points(0.0)), complex(small.evaluate_points(1.0))
        inside = np.abs(p - small.centre) < small.radius
        side = np.sign(small.sweep)
        beyond = np.imag((p - ends[0]) * np.conj(ends[1] - ends[0])) * side < 0.0
        total += np.angle((ends[1] - p) * (ends[0] - p).conj()) + TURN * side * (inside & beyond)
    return total
