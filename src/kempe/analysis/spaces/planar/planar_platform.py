"""Places of a platform whose legs end with joints that turn without limits: in some orientation
each leg holds.

At a place p, with the platform turned by the unit number u, its point b is at p + u b. So a leg
with the region W holds at the angles at which a circle about p is inside W, and p is reached if the
legs hold at a common angle. The workspace ends where such intervals shrink to nothing: where the
circle leaves W, beside its boundary or at a corner, and where two legs hold on different sides of
one angle, so that their points are on boundaries and p on a coupler curve. Source: Merlet,
Gosselin, Mouly, "Workspaces of planar parallel manipulators", Mechanism and Machine Theory 33
(1998).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, cast

import numpy as np

from kempe.analysis.spaces.planar.coupler_curves import CouplerCurve, FourBar, four_bars
from kempe.analysis.spaces.planar.planar_region import NOTHING, SAME, PlanarRegion
from kempe.analysis.spaces.planar.plane_curves import TURN, PlaneCurve, PlanePiece, merged

CHUNK = 2048
"""Points that are decided at a time."""
APART = 1e-9
"""Width of an interval of angles below which it is rounding."""


@dataclass(frozen=True)
class PlatformLeg:
    """The `region`, bounded by arcs and segments, in which a leg holds the point `b` of the
    platform.
    """

    region: PlanarRegion
    b: complex

    @cached_property
    def ends(self) -> list[PlanePiece]:
        """The curve that it is, or what bounds it."""
        return cast(
            "list[PlanePiece]", self.region.candidates if self.region.is_curve else self.region.ends
        )


@dataclass(frozen=True)
class RotationAbout:
    """Motions of the platform about its point `fixed`, which is at `centre`, by angles from `start`
    on by `sweep`.
    """

    centre: complex
    fixed: complex
    start: float
    sweep: float

    def of(self, point: complex) -> PlaneCurve:
        """The curve of a point of the platform."""
        arm = point - self.fixed
        return PlanePiece(self.centre, abs(arm), self.start + float(np.angle(arm)), self.sweep)

    def turns(self, t: float) -> complex:
        """The unit number by which the platform is turned."""
        return complex(np.exp(1j * (self.start + self.sweep * t)))


@dataclass(frozen=True)
class TranslationAlong:
    """Motions of the platform, turned by `turn`, with its point `fixed` on a piece."""

    piece: PlanePiece
    fixed: complex
    turn: complex

    def of(self, point: complex) -> PlaneCurve:
        """The curve of a point of the platform."""
        return replace(self.piece, centre=self.piece.centre + self.turn * (point - self.fixed))

    def turns(self, t: float) -> complex:
        """The unit number by which the platform is turned."""
        return self.turn


Motion = RotationAbout | TranslationAlong | CouplerCurve


@dataclass(frozen=True)
class RegionOfPlatform(PlanarRegion):
    """The places at which all legs hold the platform in some orientation.

    One of them may be a curve; then solutions are counted, where all others count theirs.
    """

    legs: tuple[PlatformLeg, ...]
    is_curve: bool = False

    @cached_property
    def size(self) -> float:
        """A length of the region."""
        return max(leg.region.size + abs(leg.b) for leg in self.legs)

    @property
    def limited(self) -> int:
        """How many joints with limits one chain has at most."""
        return max(leg.region.limited for leg in self.legs)

    @cached_property
    def curve(self) -> PlatformLeg | None:
        """The leg that is a curve."""
        return next((leg for leg in self.legs if leg.region.is_curve), None)

    @property
    def counted(self) -> bool:
        """Whether solutions are counted."""
        return self.curve is not None and all(
            leg is self.curve or leg.region.counted for leg in self.legs
        )

    # ---- curves on which it can end

    def _edges(self, leg: PlatformLeg) -> list[PlanePiece]:
        """Where a leg begins or ends to hold its point, or, where solutions are counted, does so in
        other ways.
        """
        if not self.counted or leg is self.curve:
            return leg.ends
        return [cast(PlanePiece, piece) for piece, left, right in leg.region.sides if left != right]

    @cached_property
    def candidates(self) -> list[PlaneCurve]:
        """Pieces of all curves on which it can end."""
        found = (path for motion, held in self._motions() for path in self._held(motion, held))
        return merged(found, SAME * self.size)

    def _motions(self) -> Iterator[tuple[Motion, tuple[PlatformLeg, ...]]]:
        """Motions along which intervals of angles begin or end, and the legs whose points then are
        on boundaries.
        """
        for leg in self.legs:
            if self.curve in (None, leg):
                for motion in _beside(leg):
                    yield motion, (leg,)
        for one, two in itertools.combinations(self.legs, 2):
            if self.curve in (None, one, two):
                for first, second in itertools.product(self._edges(one), self._edges(two)):
                    for motion in _four_bars(first, second, one.b, two.b):
                        yield motion, (one, two)

    def _held(self, motion: Motion, held: tuple[PlatformLeg, ...]) -> Iterator[PlaneCurve]:
        """The parts of a motion's curve on which all other legs hold, and intervals of these may
        end.
        """
        path = motion.of(0j)
        cuts = [
            motion.of(leg.b).meets(end)
            for leg in self.legs
            if leg not in held
            for end in self._edges(leg)
        ]
        rates: list[Callable[..., np.ndarray]] = []
        if isinstance(motion, CouplerCurve):
            rates = [partial(_rate, motion, leg) for leg in held]
            cuts += [motion.roots(rate) for rate in rates]
        t = np.unique(np.concatenate([[0.0, 1.0], *cuts]).clip(0.0, 1.0))
        for a, b in itertools.pairwise(t[np.concatenate([[True], np.diff(t) > NOTHING])]):
            x = 0.5 * (a + b)
            p = complex(path.at(x))
            u = motion.turns(x)
            if not all(
                bool(leg.region.holds(p + u * leg.b)) for leg in self.legs if leg not in held
            ):
                continue
            same_side = (
                len(rates) == 2 and self.curve is None and float(rates[0](x) * rates[1](x)) > 0.0
            )
            if not same_side:
                yield path.part(a, b)

    # ---- points

    def solutions(self, p: complex) -> int:
        """In how many ways a point is reached, or whether it is."""
        if not self.counted:
            return int(self.holds(np.array([p]))[0])
        assert self.curve is not None
        circle = PlanePiece(p, abs(self.curve.b), float(np.angle(self.curve.b)), TURN)
        t = np.concatenate([circle.meets(end, 0.0) for end in self.curve.ends])
        rest = [leg for leg in self.legs if leg is not self.curve]
        turns = [complex(np.exp(1j * TURN * x)) for x in t]
        return sum(math.prod(leg.region.solutions(p + u * leg.b) for leg in rest) for u in turns)

    def holds(self, p: Any) -> Any:
        """Whether points (...), which are not on the boundary, are inside it."""
        z = np.asarray(p, dtype=complex)
        flat = z.ravel()
        parts = [self._holds(flat[k : k + CHUNK]) for k in range(0, len(flat), CHUNK)]
        return np.concatenate([np.zeros(0, dtype=bool), *parts]).reshape(z.shape)

    def _holds(self, p: np.ndarray) -> np.ndarray:
        legs = self.legs if self.curve is None else (self.curve,)
        found = [_angles(p, leg.b, end) for leg in legs for end in leg.ends]
        angles = np.sort(np.concatenate([np.full((len(p), 1), np.nan), *found], axis=1), axis=1)
        if (
            self.curve is None
        ):  # the middles of intervals between which nothing changes, and an angle if there are none
            first = np.where(np.isfinite(angles[:, :1]), angles[:, :1], 0.0)
            angles = np.concatenate([angles, first + TURN], axis=1)
            angles = np.sort(np.where(np.isfinite(angles), angles, first + TURN), axis=1)
            wide = np.diff(angles, axis=1) > APART
            angles = np.where(wide, 0.5 * (angles[:, 1:] + angles[:, :-1]), np.nan)
            angles[:, -1] = np.where(wide.any(axis=1), angles[:, -1], 0.0)
        i, j = np.nonzero(np.isfinite(angles))
        for leg in self.legs:
            if leg is not self.curve:
                some = leg.region.holds(p[i] + np.exp(1j * angles[i, j]) * leg.b)
                i = i[some]
                j = j[some]
        return np.isin(np.arange(len(p)), i)


def _angles(p: np.ndarray, b: complex, end: PlanePiece) -> np.ndarray:
    """Angles (n, 2) in [0, 2 pi) at which the platform's point b, of places p (n,), is on a piece;
    NaN for none.
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
        foot = p + 1j * across * -end.off(p)
        along = np.abs(foot - p)
    half = np.sqrt(np.where(along**2 <= r**2, r**2 - along**2, np.nan))
    points = np.stack([foot - half * across, foot + half * across], axis=1)
    on = np.isfinite(points)
    on[on] = end.parameters(points[on])[1]
    return np.where(on, np.mod(np.angle((points - p[:, None]) / b), TURN), np.nan)


def _rate(motion: CouplerCurve, leg: PlatformLeg, t: np.ndarray | float) -> np.ndarray:
    """How fast (...) a leg's point goes into its region if the platform turns about the place."""
    piece = motion.bar.first if leg.b == motion.bar.a else motion.bar.second
    u = motion.turns(t)
    inwards = 1j * piece.way
    if piece.is_arc:
        inwards = np.sign(piece.sweep) * (piece.centre - motion.of(leg.b).at(t))
    return np.real(np.conj(inwards) * 1j * u * leg.b)


def _beside(leg: PlatformLeg) -> Iterator[Motion]:
    """Motions with a leg's point where a circle about the place touches a boundary from outside, or
    at its corners.
    """
    r = abs(leg.b)
    curve = leg.region.is_curve
    for end in leg.ends:
        closed = end.is_arc and abs(end.sweep) > TURN - APART
        for corner in () if closed else (0.0, 1.0):
            yield RotationAbout(complex(end.at(corner)), leg.b, 0.0, TURN)
        if not end.is_arc:
            for side in (1.0, -1.0) if curve else (1.0,):
                yield TranslationAlong(end, leg.b, side * 1j * end.way / abs(end.way) * r / leg.b)
            continue
        # the place is on the line of the centre and the point, outside the circle or on the other
        # side of the centre
        outwards = r
        inwards = -r
        sides = (
            (outwards, inwards) if curve else (outwards, inwards) if r > end.radius else (outwards,)
        )
        if not curve and end.sweep < 0.0:
            sides = (inwards,) if r < end.radius else ()
        for side in sides:
            turn = -np.sign(side) * r / leg.b
            yield RotationAbout(
                end.centre,
                leg.b * (1.0 + end.radius / side),
                end.start + float(np.angle(turn)),
                end.sweep,
            )


def _four_bars(first: PlanePiece, second: PlanePiece, a: complex, b: complex) -> Iterator[Motion]:
    """Motions with two points of the platform on two pieces."""
    if not first.is_arc and second.is_arc:
        first, second, a, b = second, first, b, a
    d = b - a
    if not first.is_arc and abs(np.imag(np.conj(first.way) * second.way)) < 1e-9 * abs(
        first.way * second.way
    ):
        yield from _between_parallels(first, second, a, b)
        return
    base = second.centre - first.centre
    if first.is_arc and second.is_arc and abs(first.radius - second.radius) <= 1e-9 * first.radius:
        if abs(abs(base) - abs(d)) <= 1e-9 * abs(d):  # a parallelogram
            yield from _common(first, second, a, b, base / d)
    for bar in four_bars(first, second, a, b):
        yield from _on_pieces(bar)


def _between_parallels(
    first: PlanePiece, second: PlanePiece, a: complex, b: complex
) -> Iterator[Motion]:
    """Motions along two parallel segments."""
    w = first.way / abs(first.way)
    d = b - a
    height = float(first.off(np.array(second.centre))) / abs(d)
    if abs(height) < 1.0 - APART:
        x = math.sqrt(1.0 - height * height)
        for across in (x + 1j * height, -x + 1j * height):
            yield from _common(first, second, a, b, w * across * abs(d) / d)


def _common(
    first: PlanePiece, second: PlanePiece, a: complex, b: complex, turn: complex
) -> Iterator[Motion]:
    """Motions without turning, with two points of the platform on two pieces, which then lie on
    each other.
    """
    moved = replace(second, centre=second.centre - turn * (b - a))
    ends = first.parameters(moved.at(np.array([0.0, 1.0])))[0]
    t = np.unique(np.concatenate([[0.0, 1.0], ends]).clip(0.0, 1.0))
    for x, y in itertools.pairwise(t):
        if bool(moved.parameters(first.at(0.5 * (x + y)))[1]):
            yield TranslationAlong(first.part(x, y), a, turn)


def _on_pieces(bar: FourBar) -> Iterator[CouplerCurve]:
    """The parts of a four-bar's motion on which both points are inside their pieces."""
    cuts = [0.0, 1.0]
    for piece, other, d in (
        (bar.first, bar.second, bar.b - bar.a),
        (bar.second, bar.first, bar.a - bar.b),
    ):
        for end in piece.at(np.array([0.0, 1.0])).tolist():
            circle = PlanePiece(end, abs(d), float(np.angle(d)), TURN)
            angles = bar.low + np.mod(TURN * circle.meets(other) - bar.low, TURN)
            cuts += [bar.parameter(x) for x in angles.tolist() if x < bar.high]
    whole = CouplerCurve(bar)
    for x, y in itertools.pairwise(sorted(cuts)):
        middle = 0.5 * (x + y)
        if y - x > NOTHING and all(
            bool(piece.parameters(whole.of(point).at(middle))[1])
            for piece, point in ((bar.first, bar.a), (bar.second, bar.b))
        ):
            yield whole.part(x, y)
