"""Places of a planar platform on legs, where all legs hold it in some orientation.

The last joint of each leg turns without limits. Boundary curves are arcs, segments and coupler
curves; the area is sampled.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from kempe.spatial import Array
from kempe.workspace.planar.plane_curves import (
    NOTHING,
    SAME,
    TURN,
    PlanarRegion,
    PlanePiece,
    extend_piece,
    intersect_carriers,
    intersect_circles,
    merge_pieces,
    offset_pieces,
    to_pair,
)

MEET = 1e-5
"""Distance of ends of pieces, in sizes, up to which these are the same corner."""
CORNER = 1e-6
"""Distance, in sizes, up to which points are on a curve, and two curves are the same."""
TRIED = 721
"""Points of a curve that are tried at first."""
SIDE = 1e-10
"""Distance, in sizes, of the points that are tried on both sides of a curve."""
BESIDE = 1e-3
"""Distance from an event, in sizes, below which curves that touch there are not told apart."""
HALVINGS = 45
NEVER = 1e-9
"""Largest number that is zero all along a curve."""
TOGETHER = 1e-7
"""Difference of parameters up to which events are one."""
CHUNK = 2048
"""Points that are decided at a time."""
APART = 1e-11
"""Width of an interval of angles below which it is rounding."""
SQUARES = 200
"""Squares along each edge of a box, in each of which two random points are decided."""
REFINEMENTS = 6
"""Times at most that curves are tried again near open ends of the boundary."""
FINER = 16
"""Parts into which steps near an open end are divided for that."""


# ---- coupler curves


@dataclass(frozen=True, eq=False)
class CouplerCurve:
    """Places of a platform with points `a` and `b` on the circles or lines of two pieces.

    The platform's origin is at p and the platform is turned by the unit number u, so its point a is
    at p + u a. That point goes along the `first` piece from the parameter `low` to `high`. The
    point b is on one `side` of the way from there to the centre of the second circle. With `side` 0
    it comes back on the other side: at `high` both sides meet. The piece of the curve goes from its
    parameter `start` on by `sweep`. Source: Wunderlich, "Ebene Kinematik", Bibliographisches
    Institut (1970).
    """

    first: PlanePiece
    second: PlanePiece
    a: complex
    b: complex
    low: float
    high: float
    side: int = 0
    is_whole: bool = False
    """Whether the curve is closed."""
    start: float = 0.0
    sweep: float = 1.0

    kind = "coupler curve"

    def evaluate_motions(self, t: Any) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate places p and unit numbers u (...) at parameters t (...)."""
        x = self.start + self.sweep * np.asarray(t, dtype=float)
        if self.side:
            s = self.low + (self.high - self.low) * x
            side = self.side
        else:
            # the distance to an end is a square, as that of both sides from each other is
            s = self.low + (self.high - self.low) * np.sin(0.5 * TURN * x) ** 2
            side = np.sign(np.sin(TURN * x))
        z = self.first.evaluate_points(s)
        foot, unit, square = intersect_circles(z, abs(self.b - self.a), self.second)
        w = foot + side * np.sqrt(np.maximum(square, 0.0)) * unit
        u = (w - z) / (self.b - self.a)
        u = u / np.abs(u)
        return z - u * self.a, u

    def evaluate_points(self, t: Any) -> np.ndarray:
        """Evaluate points (...) at parameters t (...)."""
        return self.evaluate_motions(t)[0]

    def evaluate_tangents(self, t: Any) -> np.ndarray:
        """Evaluate tangents (...) at parameters (...), of any length."""
        p, u = self.evaluate_motions(t)
        rod = u * (self.b - self.a)
        z = p + u * self.a
        ways = [_compute_directions(self.first, z), _compute_directions(self.second, z + rod)]
        # the rod keeps its length: both ends have the same velocity along it
        along, speed = (np.real(np.conj(rod) * way) for way in ways)
        turning = np.imag(np.conj(rod) * (along * ways[1] - speed * ways[0])) / abs(rod) ** 2
        # the sign of the speed is that of the side, and on circles the other one
        sense = np.sign((self.high - self.low) * self.sweep) * (self.side or 1)
        sense = -sense if self.second.is_arc else sense
        return sense * (speed * ways[0] - 1j * turning * u * self.a)

    def evaluate_tangent(self, t: float) -> complex:
        """Evaluate the unit tangent at a parameter."""
        v = complex(self.evaluate_tangents(t))
        return v / max(abs(v), 1e-300)

    def cut_piece(self, a: float, b: float) -> CouplerCurve:
        """Return the piece from the parameter a to b; of a closed curve both may be beyond 1."""
        return replace(self, start=self.start + self.sweep * a, sweep=self.sweep * (b - a))

    @cached_property
    def _dense_points(self) -> np.ndarray:
        """Points along the curve with small steps."""
        return self.evaluate_points(np.linspace(0.0, 1.0, 17 + int(2.0 * TRIED * abs(self.sweep))))

    @property
    def length(self) -> float:
        """Length of the curve in metres, by short chords."""
        return float(np.abs(np.diff(self._dense_points)).sum())

    @property
    def moment(self) -> float:
        """Half of the integral of x dy - y dx along the curve, by short chords."""
        p = self._dense_points
        return 0.5 * float(np.imag(np.conj(p[:-1]) * p[1:]).sum())

    @property
    def extremes(self) -> np.ndarray:
        """Points (k,) along the curve, dense enough for its extent."""
        return self._dense_points

    def sample_points(self, fine: float) -> np.ndarray:
        """Sample points (k,) along the curve, with small steps."""
        return self._dense_points

    def compute_distances(self, p: np.ndarray) -> np.ndarray:
        """Compute the distances (...) of points (...) from the curve."""
        z = np.asarray(p, dtype=complex)
        best = np.full(z.shape, np.inf)
        for a, b in itertools.pairwise(self._dense_points.tolist()):
            way = b - a
            t = np.clip(np.real((z - a) * way.conjugate()) / max(abs(way) ** 2, 1e-300), 0.0, 1.0)
            best = np.minimum(best, np.abs(z - a - t * way))
        return best

    def data(self) -> dict[str, Any]:
        """Return points on the curve, for JSON."""
        p = self.evaluate_points(np.linspace(0.0, 1.0, 3 + int(64.0 * abs(self.sweep))))
        ends = {"kind": self.kind, "from": to_pair(p[0]), "to": to_pair(p[-1])}
        return ends | {"points": [to_pair(z) for z in p]}


def _compute_directions(piece: PlanePiece, p: np.ndarray) -> np.ndarray:
    """Compute unit vectors (...) along the circle or line of a piece at points (...)."""
    if piece.is_arc:
        return 1j * (p - piece.centre) / piece.radius
    return np.full(p.shape, piece.way / abs(piece.way))


def find_coupler_curves(
    first: PlanePiece, second: PlanePiece, a: complex, b: complex
) -> Iterator[CouplerCurve]:
    """Find all coupler curves of a platform with its points a and b on two circles or lines.

    Of lines the pieces bound the place of the points.
    """
    yield from _find_curves_over(first, second, a, b)
    if len(_find_centre(first, second, abs(b - a))):
        # with the point a in the centre the platform turns about that
        yield from _find_curves_over(second, first, b, a)


def _find_centre(first: PlanePiece, second: PlanePiece, rod: float) -> np.ndarray:
    """Find the parameter (k,) of the first piece where a rod's end is in the centre of the second,
    about which the rod can turn there.
    """
    if not second.is_arc or abs(second.radius - rod) > SAME * rod:
        return np.zeros(0)
    centre = np.array([second.centre])
    t, on = first.find_parameters(centre)
    return t[on & (np.abs(first.compute_offsets(centre)) <= SAME * rod)]


def _find_curves_over(
    first: PlanePiece, second: PlanePiece, a: complex, b: complex
) -> Iterator[CouplerCurve]:
    """Find coupler curves along which the point a moves on the first piece.

    Between the places of that point from which the point b can just be reached there are two places
    of b, one on each side.
    """
    rod = abs(b - a)
    turns = [piece for piece, touched in offset_pieces([second], rod) if touched is second]
    dead = [intersect_carriers(first, piece) for piece in turns]
    cuts, on = first.find_parameters(np.concatenate([np.zeros(0), *dead]))
    centre = _find_centre(first, second, rod)  # there the sides change
    cuts = np.concatenate([cuts[on], centre - SAME, centre + SAME])
    closed = first.is_arc and not len(cuts)
    if first.is_arc and len(cuts):
        cuts = np.sort(cuts)
        cuts = np.append(cuts, cuts[0] + 1.0)
    else:
        cuts = np.sort(np.append(cuts.clip(0.0, 1.0), [0.0, 1.0]))
    for low, high in itertools.pairwise(cuts.tolist()):
        at = np.array([low, 0.5 * (low + high), high])
        square = intersect_circles(first.evaluate_points(at), rod, second)[2] / rod**2
        if high - low < TOGETHER or not square[1] > 0.0:
            continue
        low_is_dead, _, high_is_dead = np.abs(square) < CORNER
        curve = CouplerCurve(first, second, a, b, low, high)
        if high_is_dead:
            yield replace(curve, is_whole=bool(low_is_dead))
        elif low_is_dead:
            yield replace(curve, low=high, high=low)
        else:
            yield from (replace(curve, side=side, is_whole=closed) for side in (1, -1))


PlaneCurve = PlanePiece | CouplerCurve

# ---- regions of platforms

# At a place p, with the platform turned by the unit number u, its point b is at p + u b. So a leg
# with the region W holds at the angles at which a circle about p is inside W, and p is reached if
# the legs hold at a common angle. The workspace ends where such intervals shrink to nothing: where
# the circle touches the boundary of a W or meets a corner of it, and where the points of two legs
# are on boundaries, so that p is on a coupler curve. Sources: Gosselin, Angeles, "The optimum
# kinematic design of a planar three-degree-of-freedom parallel manipulator", J. Mechanisms 110
# (1988); Merlet, Gosselin, Mouly, "Workspaces of planar parallel manipulators", Mechanism and
# Machine Theory 33 (1998).


@dataclass(frozen=True)
class PlatformLeg:
    """A leg: the `region` or curve in which it holds the platform's point `b`; 0 is its origin."""

    region: PlanarRegion
    b: complex

    def is_at_edge(self, z: np.ndarray, same: float) -> np.ndarray:
        """Whether points (n,) are on the boundary of the region, up to `same` metres."""
        on = [
            (np.abs(edge.compute_offsets(z)) < same) & edge.find_parameters(z)[1]
            for edge in self.region.edges
        ]
        return np.any(on, axis=0)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A curve that may bound the region, the motions of the platform along it, and the legs whose
    points are then on boundaries.
    """

    curve: PlaneCurve
    evaluate_motions: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    legs: tuple[PlatformLeg, ...]


@dataclass(frozen=True)
class PlatformRegion:
    """The places at which all legs hold the platform in some orientation.

    One of the legs may hold its point on a curve. Which points are inside is decided by angles,
    without the boundary.
    """

    legs: tuple[PlatformLeg, ...]

    counted = False
    is_curve = False
    is_exact = False
    """Whether the area is exact, not sampled."""

    @cached_property
    def size(self) -> float:
        """A characteristic length of the region in metres."""
        return max(leg.region.size + abs(leg.b) for leg in self.legs)

    @cached_property
    def boundary_pieces(self) -> list[PlaneCurve]:
        """The boundary: pieces that have the region to their left.

        Curves are tried at `TRIED` places each, and where the boundary is left open once more at
        nearer ones. `contains` does not depend on the boundary. Where two pieces cross with the
        platform turned otherwise, their ends are found to 1e-10 of the size.
        """
        candidates = [*self._list_touching_curves(), *self._list_coupler_curves()]
        tried = [np.linspace(0.0, 1.0, TRIED)] * len(candidates)
        parts = [
            self._find_bounding_parts(x, t, BESIDE) for x, t in zip(candidates, tried, strict=True)
        ]
        for k in range(REFINEMENTS):
            open_ends = find_open_ends(list(itertools.chain(*parts)), MEET * self.size)
            if not len(open_ends):
                break
            better = list(parts)
            for i, candidate in enumerate(candidates):
                tried[i], near = _divide_steps(candidate.curve, tried[i], open_ends)
                if near:
                    better[i] = self._find_bounding_parts(candidate, tried[i], BESIDE / 4.0**k)
            if len(find_open_ends(list(itertools.chain(*better)), MEET * self.size)) < len(
                open_ends
            ):
                parts = better
        # in symmetric mechanisms two legs, or two pieces of one, have boundaries on one curve
        found = list(itertools.chain(*parts))
        marks = np.array(
            [piece.evaluate_points(np.array([0.0, 0.5, 1.0])) for piece in found]
        ).reshape(-1, 3)
        same = np.abs(marks[:, None] - marks).max(axis=2) < CORNER * self.size
        return [piece for k, piece in enumerate(found) if not same[k, :k].any()]

    @property
    def sides(self) -> list[tuple[PlaneCurve, int, int]]:
        """Pieces of the boundary, with 1 on their left side for inside, and 0 on their right."""
        return [(piece, 1, 0) for piece in self.boundary_pieces]

    def _list_touching_curves(self) -> Iterator[Candidate]:
        """List curves on which the circle of a leg's point touches the boundary of its region."""
        for leg in self.legs:
            for place, touched in dict(offset_pieces(leg.region.edges, abs(leg.b))).items():
                if place.length > SAME * self.size:
                    motions = partial(_find_touching_motions, place, touched, leg.b)
                    yield Candidate(place, motions, ())

    def _list_coupler_curves(self) -> Iterator[Candidate]:
        """List curves on which the points of two legs are on the boundaries of their regions."""
        for two in itertools.combinations([leg for leg in self.legs if leg.b], 2):
            for first, second in itertools.product(*(_list_carriers(x, self.size) for x in two)):
                for curve in find_coupler_curves(first, second, two[0].b, two[1].b):
                    yield Candidate(curve, curve.evaluate_motions, two)

    def _find_boundary_sides(self, candidate: Candidate, t: np.ndarray) -> np.ndarray:
        """Find the side (n,) of a curve with the region, at parameters (n,): 1 left, -1 right, 0
        none.
        """
        p, u = candidate.evaluate_motions(t)
        on = np.ones(len(t), dtype=bool)
        for leg in candidate.legs:
            on &= leg.is_at_edge(p + u * leg.b, CORNER * self.size)
        p = p[on]
        along = candidate.curve.evaluate_tangents(t[on])
        aside = SIDE * self.size * 1j * along / np.maximum(np.abs(along), 1e-300)
        both = self.contains_points(np.concatenate([p + aside, p - aside])).reshape(2, -1)
        sides = np.zeros(len(t), dtype=int)
        sides[on] = both[0].astype(int) - both[1]
        return sides

    def _find_bounding_parts(
        self, candidate: Candidate, t: np.ndarray, beside: float
    ) -> list[PlaneCurve]:
        """Find the parts of a curve that bound the region, to their left.

        They are sought between parameters t (n,), of which those nearer than `beside`, in sizes, to
        an event are not tried: curves may touch there.
        """
        roots = self._find_events(candidate, t)
        at_roots = candidate.curve.evaluate_points(roots)
        far = np.abs(candidate.curve.evaluate_points(t)[:, None] - at_roots)
        clear = far.min(axis=1, initial=np.inf) > beside * self.size
        cuts = np.unique(np.concatenate([roots, t[clear]]))
        whole = candidate.curve.is_whole
        if whole:  # the last interval goes on to the first one
            cuts = np.unique(np.mod(cuts, 1.0))
            cuts = np.append(cuts, cuts[:2] + 1.0)
        middles = 0.5 * (cuts[1:] + cuts[:-1])
        sides = self._find_boundary_sides(candidate, middles)
        changes = np.flatnonzero(sides[1:] != sides[:-1])
        meetings = changes[~np.isin(np.mod(cuts[changes + 1], 1.0), roots)]
        cuts[meetings + 1] = _find_switches(
            partial(self._find_boundary_sides, candidate), middles[meetings], middles[meetings + 1]
        )
        ends = cuts[changes + 1]
        values = sides[changes]
        if not whole:
            ends = np.concatenate([cuts[:1], ends, cuts[-1:]])
            values = np.append(values, sides[-1:])
        elif len(changes):
            ends = np.append(ends[-1] - 1.0, ends)
        else:
            ends = np.array([0.0, 1.0])
            values = sides[:1]
        return [
            candidate.curve.cut_piece(*((a, b) if side > 0 else (b, a)))
            for a, b, side in zip(ends[:-1].tolist(), ends[1:].tolist(), values, strict=True)
            if side
        ]

    def _find_events(self, candidate: Candidate, t: np.ndarray) -> np.ndarray:
        """Find events between parameters t (n,) of a curve, and its ends.

        There the point of a leg comes to a boundary, a corner, or a place from which on the leg
        holds to the other side.
        """

        def find_signs(x: np.ndarray, which: np.ndarray) -> np.ndarray:
            """Find the signs of event functions at parameters of the curve."""
            return self._evaluate_events(*candidate.evaluate_motions(x), which) >= 0.0

        events = self._evaluate_events(*candidate.evaluate_motions(t))
        signs = (events >= 0.0) & (np.abs(events).max(axis=0) > NEVER)
        i, j = np.nonzero(signs[1:] != signs[:-1])
        roots = np.unique(_find_switches(lambda x: find_signs(x, j), t[i], t[i + 1]))
        if not candidate.curve.is_whole:
            roots = np.concatenate([[0.0], roots, [1.0]])
        return roots[np.diff(roots, prepend=-1.0) > TOGETHER]

    @cached_property
    def _event_table(self) -> np.ndarray:
        """Coefficients (8, m) b, c, s, n, h, e, g, k of events. These are zeros of the real part of
        (s (z - c) + n)' (h (z - e) + g u b) - k, with z = p + u b.

        With them the point of a leg is on the circle or line of a boundary, or beside its end, or
        would move along it if the platform turned.
        """
        out: list[tuple[complex, ...]] = []
        for leg in self.legs:
            for piece in leg.region.edges:
                c = piece.centre
                s, n = (1.0, 0.0) if piece.is_arc else (0.0, 1j * piece.way / abs(piece.way))
                out.append((leg.b, c, s, n, 1.0, c, 0.0, piece.radius**2))
                if leg.b:
                    out.append((leg.b, c, s, n, 0.0, c, 1j, 0.0))
                for end in (
                    () if piece.is_whole else piece.evaluate_points(np.array([0.0, 1.0])).tolist()
                ):
                    across = 1j * (end - c) if piece.is_arc else piece.way / abs(piece.way)
                    out.append((leg.b, c, 0.0, across, 1.0, end, 0.0, 0.0))
        return np.array(out).T

    def _evaluate_events(
        self, p: np.ndarray, u: np.ndarray, which: np.ndarray | None = None
    ) -> Array:
        """Evaluate event functions (k, m) of places and unit numbers (k,), or one for each (k,).
        They change sign at events.
        """
        table = self._event_table if which is None else self._event_table[:, which]
        b, c, s, n, h, e, g, k = table
        if which is None:
            p = p[:, None]
            u = u[:, None]
        z = p + u * b
        normal = np.conj(s * (z - c) + n)
        return np.real(normal * (h * (z - e) + g * u * b) - k) / self.size ** (1.0 + np.real(s))

    # ---- points

    def contains_points(self, p: Any) -> np.ndarray:
        """Whether (...) points (...), which are not on the boundary, are inside."""
        z = np.asarray(p, dtype=complex)
        flat = z.ravel()
        parts = [self._contains_points(flat[k : k + CHUNK]) for k in range(0, len(flat), CHUNK)]
        return np.concatenate([np.zeros(0, dtype=bool), *parts]).reshape(z.shape)

    def _contains_points(self, p: np.ndarray) -> np.ndarray:
        """Whether (n,) points (n,), which are not on the boundary, are inside."""
        curves = [leg for leg in self.legs if leg.region.is_curve]
        legs = curves or self.legs
        found = [
            _compute_angles(p, leg.b, end) for leg in legs if leg.b for end in leg.region.edges
        ]
        angles = np.sort(np.concatenate([np.full((len(p), 1), np.nan), *found], axis=1), axis=1)
        # the middles of intervals between which nothing changes, and an angle if there are none
        if not curves:
            first = np.where(np.isfinite(angles[:, :1]), angles[:, :1], 0.0)
            angles = np.concatenate([angles, first + TURN], axis=1)
            angles = np.sort(np.where(np.isfinite(angles), angles, first + TURN), axis=1)
            wide = np.diff(angles, axis=1) > APART
            angles = np.where(wide, 0.5 * (angles[:, 1:] + angles[:, :-1]), np.nan)
            angles[:, -1] = np.where(wide.any(axis=1), angles[:, -1], 0.0)
        i, j = np.nonzero(np.isfinite(angles))
        for leg in self.legs:
            if not leg.region.is_curve:
                some = leg.region.contains_points(p[i] + np.exp(1j * angles[i, j]) * leg.b)
                i = i[some]
                j = j[some]
        return np.isin(np.arange(len(p)), i)

    def measure_area(self) -> tuple[float, float]:
        """Estimate the area [m^2], with two standard errors. Two random points lie in each of many
        squares.
        """
        if not self.boundary_pieces:
            return 0.0, 0.0
        extent = compute_extent(self.boundary_pieces)
        low: Array = extent[0]
        size: Array = extent[1] - low
        rng = np.random.default_rng(0)
        corners = np.stack(np.meshgrid(*[np.arange(SQUARES)] * 2, indexing="ij"), axis=-1)
        parts = (corners[..., None, :] + rng.random((SQUARES, SQUARES, 2, 2))) / SQUARES
        xy = low + parts * size
        inside = self.contains_points(xy[..., 0] + 1j * xy[..., 1])
        each = float(np.prod(size)) / SQUARES**2
        differ = np.count_nonzero(inside[..., 0] != inside[..., 1])
        return each * float(inside.mean(axis=-1).sum()), each * float(np.sqrt(differ + 1.0))


def _find_switches(value: Callable[[np.ndarray], np.ndarray], low: Array, high: Array) -> Array:
    """Find parameters (k,) between `low` and `high` at which values (k,) change."""
    before = value(low) if len(low) else low
    for _ in range(HALVINGS if len(low) else 0):
        middle = 0.5 * (low + high)
        same = value(middle) == before
        low = np.where(same, middle, low)
        high = np.where(same, high, middle)
    return 0.5 * (low + high)


def _find_touching_motions(
    place: PlanePiece, touched: PlanePiece, b: complex, t: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Find motions with the origin on one piece and the point b on another, at equal parameters."""
    p = place.evaluate_points(t)
    u = (touched.evaluate_points(t) - p) / b if b else np.ones(p.shape, dtype=complex)
    return p, u / np.abs(u)


def _list_carriers(leg: PlatformLeg, size: float) -> list[PlanePiece]:
    """List the circles of a leg's boundary, and long segments of its lines."""
    out: list[PlanePiece] = []
    for piece in leg.region.edges:
        way = piece.way and size * piece.way / abs(piece.way)
        line = PlanePiece(complex(piece.evaluate_points(0.5)) - way, 0.0, way=2.0 * way)
        out.append(extend_piece(piece) if piece.is_arc else line)
    return merge_pieces(out, SAME * size)


def compute_extent(pieces: Sequence[PlaneCurve]) -> Array:
    """Compute the least and the largest x and y (2, 2) of pieces; zero without any."""
    points = [z for piece in pieces for z in piece.extremes.tolist()] or [0j]
    x = np.array([[z.real for z in points], [z.imag for z in points]])
    return np.stack([x.min(axis=1), x.max(axis=1)])


def find_open_ends(pieces: Sequence[PlaneCurve], same: float) -> np.ndarray:
    """Find ends (k,) of pieces at which no other one begins, and beginnings at which none ends."""
    begin, end = (np.array([complex(p.evaluate_points(t)) for p in pieces]) for t in (0.0, 1.0))
    far = np.abs(begin[:, None] - end) > same
    return np.concatenate([begin[far.all(axis=1)], end[far.all(axis=0)]])


def _divide_steps(curve: PlaneCurve, t: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, bool]:
    """Divide the steps between parameters t (n,) of a curve that are near open ends (k,), and tell
    whether there are any.
    """
    p = curve.evaluate_points(t)
    step = np.abs(np.diff(p))
    far = np.abs(p[:, None] - ends).min(axis=1)
    near = np.flatnonzero(np.minimum(far[1:], far[:-1]) < 2.0 * step)
    part = np.arange(1, FINER) / FINER
    inner = t[near, None] + part * (t[near + 1] - t[near])[:, None]
    return np.unique(np.append(t, inner)), len(near) > 0


def _compute_angles(p: np.ndarray, b: complex, end: PlanePiece) -> np.ndarray:
    """Compute angles (n, 2) in [0, 2 pi) at which the platform's point b is on a piece. Its origin
    is at p (n,); NaN means none.
    """
    foot, across, square = intersect_circles(p, abs(b), end)
    half = np.sqrt(np.where(square >= 0.0, square, np.nan))
    points = np.stack([foot - half * across, foot + half * across], axis=1)
    on = np.isfinite(points)
    on[on] = end.find_parameters(points[on], NOTHING)[1]
    return np.where(on, np.mod(np.angle((points - p[:, None]) / b), TURN), np.nan)
