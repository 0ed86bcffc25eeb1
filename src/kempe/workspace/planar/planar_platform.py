"""Places of a planar platform on legs, where all legs hold it in some orientation.

The last joint of each leg turns without limits. Boundary curves are arcs, segments and coupler
curves, which are traced; the area is sampled.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from kempe.numerics.curves import Curve, find_next_node, make_node, walk_curve
from kempe.spatial import Array
from kempe.workspace.planar.plane_curves import (
    SAME,
    TURN,
    PlanarRegion,
    PlanePiece,
    extend_piece,
    intersect_carriers,
    merge_pieces,
    offset_pieces,
    to_pair,
)

STARTS = 96
"""Places on each of two circles or lines from which curves are looked for."""
LONGEST = 0.1
"""Longest step along a curve, in sizes of the platform and radians."""
MOST_STEPS = 4000
AWAY = 3.0
"""Distance from the origin, in sizes, from which a curve is followed no further."""
SEEN = 0.01
"""Distance from a traced curve, in sizes and radians, below which a start is on it."""
CORNER = 1e-6
"""Residual, in sizes, below which a corner is on a curve."""
FINE = 16
"""Points of a traced curve that are tried for each of its steps."""
TRIED = 721
"""Points of an arc or a segment that are tried."""
SIDE = 1e-8
"""Distance, in sizes, of the points that are tried on both sides of a curve."""
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


# ---- coupler curves


@dataclass(frozen=True, eq=False)
class HeldPoints(Curve):
    """Motions of a platform with points `a` and `b` on the circles or lines of two pieces.

    Unknowns are the place in units of `size`, and the angle. Source: Wunderlich, "Ebene Kinematik",
    Bibliographisches Institut (1970).
    """

    first: PlanePiece
    second: PlanePiece
    a: complex
    b: complex
    size: float

    n = 3

    def evaluate_residuals(self, x: Array) -> tuple[Array, Array]:
        """Evaluate residuals (k, 2) at motions x (k, 3), and derivatives (k, 2, 3)."""
        F = np.empty((len(x), 2))
        J = np.empty((len(x), 2, 3))
        u = np.exp(1j * x[:, 2])
        for k, (piece, b) in enumerate(((self.first, self.a), (self.second, self.b))):
            arm = u * b / self.size
            z = x[:, 0] + 1j * x[:, 1] + arm - piece.centre / self.size
            normal = 1j * piece.way / abs(piece.way) + 0.0 * z if not piece.is_arc else z
            normal = normal / np.maximum(np.abs(normal), 1e-300)
            F[:, k] = np.real(np.conj(normal) * z) - piece.radius / self.size
            J[:, k] = np.stack(
                [normal.real, normal.imag, np.real(np.conj(normal) * 1j * arm)], axis=1
            )
        return F, J

    def evaluate_equations(self, x: Array) -> tuple[Array, Array]:
        """Evaluate residuals (3,) and derivatives (3, 3), of which the last row is zero."""
        F, J = self.evaluate_residuals(x[None])
        return np.append(F[0], 0.0), np.vstack([J[0], np.zeros(3)])

    def locate_origins(self, x: Array) -> np.ndarray:
        """Locate the platform's origin (k,) in motions (k, 3)."""
        return self.size * (x[:, 0] + 1j * x[:, 1])

    def compute_tangents(self, x: Array) -> Array:
        """Compute tangents (k, 3) of the curve at motions (k, 3), of any length."""
        J = self.evaluate_residuals(x)[1]
        return np.cross(J[:, 0], J[:, 1])

    def list_starts(self) -> Array:
        """List motions (k, 3) with one point spread over its circle, or over its segment."""
        out: list[tuple[float, float, float]] = []
        ends = (
            (self.first, self.a, self.second, self.b),
            (self.second, self.b, self.first, self.a),
        )
        for piece, a, other, b in ends:
            for z in piece.evaluate_points((np.arange(STARTS) + 0.37) / STARTS).tolist():
                for w in intersect_carriers(PlanePiece(z, abs(b - a), 0.0, TURN), other).tolist():
                    u = (w - z) / (b - a)
                    p = (z - u * a) / self.size
                    out.append((p.real, p.imag, float(np.angle(u))))
        return self.correct_motions(np.array(out).reshape(-1, 3))

    def correct_motions(self, x: Array) -> Array:
        """Correct motions (k, 3) near the curve to the nearest ones on it."""
        for _ in range(4):
            F, J = self.evaluate_residuals(x)
            square = J @ J.transpose(0, 2, 1) + 1e-14 * np.eye(2)
            x = x - (J.transpose(0, 2, 1) @ np.linalg.solve(square, F[..., None]))[..., 0]
        return x

    def trace_motions(self, start: Array) -> Array:
        """Trace motions (k, 3) along the curve through one of them, to its ends or once round."""
        first = make_node(self, start)
        halves: list[list[Array]] = []
        for begin in (first, first.reverse_direction()):
            points = [begin.x]
            for b in walk_curve(begin, lambda a, h: _take_step(self, a, h), LONGEST, 0.2 * LONGEST):
                points.append(b.x)
                chord = points[-1] - points[-2]
                back = begin.x - points[-2]
                back[2] = np.mod(back[2] + np.pi, TURN) - np.pi
                along = float(back @ chord) / float(chord @ chord)
                beside = float(np.linalg.norm(back - along * chord))
                if len(points) > 3 and 0.0 <= along <= 1.0 and beside < SEEN:
                    points[-1] = points[-2] + back
                    return np.array(points)
                if len(points) > MOST_STEPS or np.hypot(b.x[0], b.x[1]) > AWAY:
                    break
            halves.append(points)
        return np.array(halves[1][:0:-1] + halves[0])


def _take_step(curve: Curve, a: Any, h: float) -> list[Any] | None:
    """Take one step along a curve; None if it fails."""
    b = find_next_node(curve, a, h)
    return None if b is None else [b]


@dataclass(frozen=True, eq=False)
class CouplerCurve:
    """The places of a platform along a traced curve of motions, with parameters from 0 to 1.

    `nodes` (k, 3) are motions along the curve; what is between them is brought to the curve by
    Newton's method. It goes from the node `start` on by `sweep` nodes, which may be fractions.
    """

    motions: HeldPoints
    nodes: Array = field(repr=False)
    start: float
    sweep: float

    kind = "coupler curve"

    def _locate_parameters(self, t: Any) -> tuple[np.ndarray, np.ndarray]:
        """Locate parameters (k,) between nodes, and return the nodes (k,) before them."""
        x = np.clip(self.start + self.sweep * np.atleast_1d(t), 0.0, len(self.nodes) - 1.0)
        return x, np.minimum(x.astype(int), len(self.nodes) - 2)

    def evaluate_motions(self, t: Any) -> Array:
        """Evaluate motions (k, 3) at parameters t (k,)."""
        x, k = self._locate_parameters(t)
        part = (x - k)[:, None]
        guess = (1.0 - part) * self.nodes[k] + part * self.nodes[k + 1]
        return self.motions.correct_motions(guess)

    def evaluate_points(self, t: Any) -> np.ndarray:
        """Evaluate points (...) at parameters t (...)."""
        return self.motions.locate_origins(self.evaluate_motions(t)).reshape(np.shape(t))

    def evaluate_tangents(self, t: Any) -> np.ndarray:
        """Evaluate tangents (k,) at parameters (k,), of any length."""
        along = self.motions.compute_tangents(self.evaluate_motions(t))
        _, k = self._locate_parameters(t)
        chord = self.nodes[k + 1] - self.nodes[k]
        sense = np.sign(self.sweep * np.einsum("ij,ij->i", along, chord))
        return sense * (along[:, 0] + 1j * along[:, 1])

    def evaluate_tangent(self, t: float) -> complex:
        """Evaluate the unit tangent at a parameter."""
        v = complex(self.evaluate_tangents(t)[0])
        return v / max(abs(v), 1e-300)

    def cut_piece(self, a: float, b: float) -> CouplerCurve:
        """Return the piece from the parameter a to b."""
        return replace(self, start=self.start + self.sweep * a, sweep=self.sweep * (b - a))

    @cached_property
    def _dense_points(self) -> tuple[np.ndarray, np.ndarray]:
        """Parameters and points along the curve with small steps."""
        t = np.linspace(0.0, 1.0, 2 + int(FINE * abs(self.sweep)))
        return t, self.evaluate_points(t)

    @property
    def length(self) -> float:
        """Length of the curve in metres, by short chords."""
        return float(np.abs(np.diff(self._dense_points[1])).sum())

    @property
    def moment(self) -> float:
        """Half of the integral of x dy - y dx along the curve, by short chords."""
        p = self._dense_points[1]
        return 0.5 * float(np.imag(np.conj(p[:-1]) * p[1:]).sum())

    @property
    def extremes(self) -> np.ndarray:
        """Points (k,) along the curve, dense enough for its extent."""
        return self._dense_points[1]

    def sample_points(self, fine: float) -> np.ndarray:
        """Sample points (k,) along the curve, closer than the tracing steps."""
        return self._dense_points[1]

    def compute_distances(self, p: np.ndarray) -> np.ndarray:
        """Compute the distances (...) of points (...) from the curve."""
        z = np.asarray(p, dtype=complex).ravel()
        best = np.full(z.shape, np.inf)
        for a, b in itertools.pairwise(self._dense_points[1].tolist()):
            way = b - a
            t = np.clip(np.real((z - a) * way.conjugate()) / max(abs(way) ** 2, 1e-300), 0.0, 1.0)
            best = np.minimum(best, np.abs(z - a - t * way))
        return best.reshape(np.shape(p))

    def data(self) -> dict[str, Any]:
        """Return points on the curve, for JSON."""
        p = self._dense_points[1]
        ends = {"kind": self.kind, "from": to_pair(p[0]), "to": to_pair(p[-1])}
        return ends | {"points": [to_pair(z) for z in p[::FINE]]}


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


@dataclass(frozen=True)
class PlatformRegion:
    """The places at which all legs hold the platform in some orientation.

    One of the legs may hold its point on a curve. Which points are inside is decided by angles,
    without the boundary.
    """

    legs: tuple[PlatformLeg, ...]

    counted = False
    is_curve = False

    @cached_property
    def size(self) -> float:
        """A characteristic length of the region in metres."""
        return max(leg.region.size + abs(leg.b) for leg in self.legs)

    @cached_property
    def boundary_pieces(self) -> list[PlanePiece | CouplerCurve]:
        """The boundary: pieces that have the region to their left.

        Curves are tried at `TRIED` places each: a piece between two neighbouring ones may be
        missing, and the boundary is open there. `contains` does not depend on the boundary. Where
        two pieces cross with the platform turned otherwise, their ends are found to 1e-8 of the
        size.
        """
        found: list[PlanePiece | CouplerCurve] = []
        corners = [np.zeros((0, 3))]
        t = np.linspace(0.0, 1.0, TRIED)
        for leg in self.legs:
            beside = dict(offset_pieces(leg.region.edges, abs(leg.b)))
            for piece, touched in beside.items():
                if piece.length > SAME * self.size:
                    motions = partial(_find_touching_motions, piece, touched, leg.b, self.size)
                    for a, b in self._find_bounding_parts(piece, motions, t):
                        found.append(piece.cut_piece(a, b))
                        corners.append(motions(np.array([a, b])))
        for curve in self._find_coupler_curves(corners):
            t = np.linspace(0.0, 1.0, FINE * len(curve.nodes) + 1)
            for a, b in self._find_bounding_parts(curve, curve.evaluate_motions, t):
                found.append(curve.cut_piece(a, b))
                corners.append(curve.evaluate_motions(np.array([a, b])))
        # in symmetric mechanisms two legs, or two pieces of one, have boundaries on one curve
        marks = np.array(
            [piece.evaluate_points(np.array([0.0, 0.5, 1.0])) for piece in found]
        ).reshape(-1, 3)
        same = np.abs(marks[:, None] - marks).max(axis=2) < CORNER * self.size
        return [piece for k, piece in enumerate(found) if not same[k, :k].any()]

    def _find_coupler_curves(self, corners: list[Array]) -> Iterator[CouplerCurve]:
        """Find coupler curves with a start on the boundary or through a corner of it. Corners are
        motions (k, 3), to which more may be added.
        """
        held: list[HeldPoints] = []
        for one, two in itertools.combinations([leg for leg in self.legs if leg.b], 2):
            for first, second in itertools.product(
                *(_list_carriers(x, self.size) for x in (one, two))
            ):
                held.append(HeldPoints(first, second, one.b, two.b, self.size))
        seen = [np.zeros((0, 3)) for _ in held]
        starts = [motions.list_starts() for motions in held]
        starts = [
            x[self._find_boundary_side(*_locate_curve_points(motions, x)) != 0]
            for motions, x in zip(held, starts, strict=True)
        ]
        while any(len(x) for x in starts):
            for k, motions in enumerate(held):
                left = starts[k]
                while len(left := left[_is_untraced(left, seen[k])]):
                    nodes = motions.trace_motions(left[0])
                    seen[k] = np.concatenate([seen[k], left[:1]])
                    if len(nodes) > 2:
                        nodes = self._start_off_boundary(motions, nodes)
                        curve = CouplerCurve(motions, nodes, 0.0, len(nodes) - 1.0)
                        dense = curve.evaluate_motions(np.linspace(0.0, 1.0, 8 * len(nodes)))
                        seen[k] = np.concatenate([seen[k], dense])
                        yield curve
            known = np.concatenate(corners)
            corners.clear()
            corners.append(np.zeros((0, 3)))
            starts = [
                known[(np.abs(m.evaluate_residuals(known)[0]) < CORNER).all(axis=1)] for m in held
            ]

    def _start_off_boundary(self, motions: HeldPoints, nodes: Array) -> Array:
        """Rotate the nodes (k, 3) of a closed curve to start off the boundary. Then the start
        divides no piece of the boundary.
        """
        once = nodes[-1] - nodes[0]
        aside = np.flatnonzero(self._find_boundary_side(*_locate_curve_points(motions, nodes)) == 0)
        if not len(aside) or np.hypot(once[0], once[1]) > SEEN:
            return nodes
        k = int(aside[0])
        return np.concatenate([nodes[k:-1], nodes[: k + 1] + once])

    def _find_boundary_side(self, p: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Find the side of tangents (n,) at points (n,) with the region: 1 left, -1 right, else 0."""
        aside = SIDE * self.size * 1j * along / np.maximum(np.abs(along), 1e-300)
        both = self.contains_points(np.concatenate([p + aside, p - aside])).reshape(2, -1)
        return both[0].astype(int) - both[1]

    def _find_bounding_parts(
        self, curve: Any, motions: Callable[[np.ndarray], Array], t: np.ndarray
    ) -> Iterator[tuple[float, float]]:
        """Find parameters at the ends of those parts of a curve that bound the region, to their
        left. They are sought between parameters t (n,).

        Parts begin and end at events, where the point of a leg comes to a boundary, a corner, or a
        place from which on the leg holds to the other side; or where the curve meets another.
        """

        def find_sides(x: np.ndarray) -> np.ndarray:
            """Find the sides of the region at parameters of the curve."""
            return self._find_boundary_side(curve.evaluate_points(x), curve.evaluate_tangents(x))

        events = self._evaluate_events(motions(t))
        signs = (events >= 0.0) & (np.abs(events).max(axis=0) > NEVER)
        i, j = np.nonzero(signs[1:] != signs[:-1])
        roots = _find_switches(
            lambda x: self._evaluate_events(motions(x), j) >= 0.0, t[i], t[i + 1]
        )
        roots = np.unique(np.concatenate([[t[0], t[-1]], roots]))
        roots = roots[np.concatenate([[True], np.diff(roots) > TOGETHER])]
        # beside an event two curves touch: what is nearer than half a step is not told apart
        clear = np.abs(t[:, None] - roots).min(axis=1) > 0.5 * (t[1] - t[0])
        cuts = np.sort(np.concatenate([roots, t[clear]]))
        middles = 0.5 * (cuts[1:] + cuts[:-1])
        values = find_sides(middles)
        changes = np.flatnonzero(values[1:] != values[:-1])
        meetings = changes[~np.isin(cuts[changes + 1], roots)]
        cuts[meetings + 1] = _find_switches(find_sides, middles[meetings], middles[meetings + 1])
        ends = np.concatenate([[0], changes + 1, [len(values)]])
        for k, m in itertools.pairwise(ends):
            if values[k]:
                a = float(cuts[k])
                b = float(cuts[m])
                yield (a, b) if values[k] > 0 else (b, a)

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

    def _evaluate_events(self, x: Array, which: np.ndarray | None = None) -> Array:
        """Evaluate event functions (k, m) of motions (k, 3), or one for each motion (k,). They
        change sign at events.
        """
        table = self._event_table if which is None else self._event_table[:, which]
        b, c, s, n, h, e, g, k = table
        p = self.size * (x[:, 0] + 1j * x[:, 1])
        u = np.exp(1j * x[:, 2])
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

    def estimate_area(self, low: Array, high: Array) -> tuple[float, float]:
        """Estimate the area inside a box [m^2], with two standard errors. Two random points lie in
        each of many squares.
        """
        rng = np.random.default_rng(0)
        corners = np.stack(np.meshgrid(*[np.arange(SQUARES)] * 2, indexing="ij"), axis=-1)
        parts = (corners[..., None, :] + rng.random((SQUARES, SQUARES, 2, 2))) / SQUARES
        xy = low + parts * (high - low)
        inside = self.contains_points(xy[..., 0] + 1j * xy[..., 1])
        each = float(np.prod(high - low)) / SQUARES**2
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
    place: PlanePiece, touched: PlanePiece, b: complex, size: float, t: Any
) -> Array:
    """Find motions (k, 3) with the origin on one piece and the point b on another, at equal
    parameters.
    """
    p = place.evaluate_points(t)
    turns = np.angle((touched.evaluate_points(t) - p) / b) if b else np.zeros(len(p))
    return np.stack([np.real(p) / size, np.imag(p) / size, turns], axis=1)


def _list_carriers(leg: PlatformLeg, size: float) -> list[PlanePiece]:
    """List the circles of a leg's boundary, and long segments of its lines."""
    out: list[PlanePiece] = []
    for piece in leg.region.edges:
        way = piece.way and size * piece.way / abs(piece.way)
        line = PlanePiece(complex(piece.evaluate_points(0.5)) - way, 0.0, way=2.0 * way)
        out.append(extend_piece(piece) if piece.is_arc else line)
    return merge_pieces(out, SAME * size)


def _locate_curve_points(motions: HeldPoints, x: Array) -> tuple[np.ndarray, np.ndarray]:
    """Locate the points (k,) of the coupler curve at motions (k, 3), with its tangents."""
    along = motions.compute_tangents(x)
    return motions.locate_origins(x), along[:, 0] + 1j * along[:, 1]


def _is_untraced(x: Array, nodes: Array) -> np.ndarray:
    """Whether (n,) motions x (n, 3) are off the traced curves with nodes (k, 3)."""
    off = np.abs(x[:, None, :] - nodes)
    off[..., 2] = np.abs(np.mod(off[..., 2] + np.pi, TURN) - np.pi)
    return np.linalg.norm(off, axis=2).min(axis=1, initial=np.inf) > SEEN


def _compute_angles(p: np.ndarray, b: complex, end: PlanePiece) -> np.ndarray:
    """Compute angles (n, 2) in [0, 2 pi) at which the platform's point b is on a piece. Its origin
    is at p (n,); NaN means none.
    """
    r = abs(b)
    if end.is_arc:
        to = end.centre - p
        far = np.where(to == 0.0, np.nan, np.abs(to))
        along = (far**2 + r**2 - end.radius**2) / (2.0 * far)
        foot = p + along * to / far
        across = 1j * to / far
    else:
        across = np.full(p.shape, end.way / abs(end.way))
        foot = p + 1j * across * -end.compute_offsets(p)
        along = np.abs(foot - p)
    half = np.sqrt(np.where(along**2 <= r**2, r**2 - along**2, np.nan))
    points = np.stack([foot - half * across, foot + half * across], axis=1)
    on = np.isfinite(points)
    on[on] = end.find_parameters(points[on])[1]
    return np.where(on, np.mod(np.angle((points - p[:, None]) / b), TURN), np.nan)
