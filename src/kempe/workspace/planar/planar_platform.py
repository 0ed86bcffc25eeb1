"""Places of a planar platform on legs: where all legs hold it in some orientation.

The last joint of each leg turns without limits. The workspace ends on circles and coupler curves.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Any, cast

import numpy as np

from kempe.workspace.planar.plane_curves import (
    ENDS,
    NOTHING,
    SAME,
    TURN,
    PlanarRegion,
    PlaneCurve,
    PlanePiece,
    as_pair,
    merged,
)

# ---- coupler curves

# Points of a body describe them while two others of its points move on arcs or segments. Source:
# Wunderlich, "Ebene Kinematik", Bibliographisches Institut (1970): of order six, with arcs for both
# points.

SAMPLES = 257
"""Points of a curve between which its roots and meetings are looked for."""
HALVINGS = 50
NODES = (16, 32, 64, 128, 256, 512, 1024)
"""Numbers of nodes of Gauss and Legendre that are tried for an integral, until two agree."""
NEAR = 1e-7
"""Distance of s from the ends of an interval at which derivatives are read there: at dead centres
they are 0 / 0."""
ROUNDING = 1e-14
FLAT = 1e-12
"""Square of half a chord, in squares of the radius, below which circles touch at the end of an
interval."""
BESIDE = 1e-4
"""Distance of s from a dead centre below which chords are read from there."""
NARROW = 1e-9
"""Width of an interval of angles below which it is rounding."""
TOUCHING = 1e-9
"""Distance, in lengths of two curves, below which they touch."""
CURVE_CHUNK = 4096
"""Points whose distances are found at a time."""
MARGIN = 0.2
"""By which part of its length a chord's box is widened, so that the curve is inside."""
CONVERGED = 1e-13
"""Step of a parameter below which a nearest point is found."""
GROUP = 16
"""Successive chords whose boxes are compared as one."""
AT_END = 1e-3
FLAT_ANGLE = 1e-2
"""Difference of parameters, and angle, within which curves that meet at an end touch there."""
ITSELF = 0.01
"""Difference of parameters below which a curve meets itself because it goes on."""


def cosine_intervals(middle: float, low: float, high: float) -> list[tuple[float, float]]:
    """Intervals of angles within one turn in which low <= cos(angle - middle) <= high."""
    if high < -1.0 or low > 1.0 or high < low:
        return []
    near = float(np.arccos(min(high, 1.0)))
    far = float(np.arccos(max(low, -1.0)))
    whole = [(middle - far, middle - near), (middle + near, middle + far)]
    if near > 0.0:
        return whole if far < np.pi else [(middle + near, middle + TURN - near)]
    return [(middle - far, middle + far)]


@dataclass(frozen=True)
class FourBar:
    """A body whose point `a` is on the circle or line of one piece, and `b` on that of another,
    over an interval.

    Points of the body are complex numbers: at the place p, turned by the unit number u, a is at p +
    u a. Of the two places that a turn leaves, `branch` 1 or -1 says which. If one of the pieces is
    a segment it is the second. Motions are functions of s from 0 to 1: the angle is that of the
    middle between `low` and `high` less half the width times cos(pi s), so that they are smooth at
    dead centres, where the branches meet.
    """

    first: PlanePiece
    second: PlanePiece
    a: complex
    b: complex
    branch: float
    low: float
    high: float

    def turns(self, s: np.ndarray) -> np.ndarray:
        """The unit numbers (...) by which the body is turned."""
        return np.exp(
            1j * (0.5 * (self.low + self.high) - 0.5 * (self.high - self.low) * np.cos(np.pi * s))
        )

    def parameter(self, angle: float) -> float:
        """The s of an angle inside the interval."""
        c = np.clip(
            (0.5 * (self.low + self.high) - angle) / (0.5 * (self.high - self.low)), -1.0, 1.0
        )
        return float(np.arccos(c) / np.pi)

    def _chord(self, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The middle (...) and the direction of the chord in which a's circle meets b's curve, and
        its square.
        """
        one = self.first
        two = self.second
        ud = turns * (self.b - self.a)
        if two.is_arc:
            to = two.centre - ud - one.centre
            far = np.maximum(np.abs(to), 1e-300)
            along = (far**2 + one.radius**2 - two.radius**2) / (2.0 * far)
            return one.centre + along * to / far, 1j * to / far, one.radius**2 - along**2
        w = two.way / abs(two.way)
        foot = two.centre - ud + w * np.real((one.centre - two.centre + ud) * np.conj(w))
        return foot, w + 0.0 * ud, one.radius**2 - np.abs(foot - one.centre) ** 2

    @cached_property
    def _dead(self) -> np.ndarray:
        """Whether each end (2,) of the interval is a dead centre."""
        return self._chord(self.turns(np.array([0.0, 1.0])))[2] < FLAT * self.first.radius**2

    def _of_first(self, s: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Where the point a is (...); u (...) are the turns there."""
        if not self.first.is_arc:  # both are segments, which are not parallel
            one = self.first
            two = self.second
            gap = two.centre - u * (self.b - self.a) - one.centre
            return one.centre + one.way * np.imag(gap * np.conj(two.way)) / np.imag(
                one.way * np.conj(two.way)
            )
        foot, way, square = self._chord(u)
        s = np.asarray(s)
        half = np.asarray(np.sqrt(np.maximum(square, 0.0)))
        # beside a dead centre the chord grows with sin(pi s): there its square is lost in rounding
        low, high = np.where(self._dead, (BESIDE, 1.0 - BESIDE), (-1.0, 2.0))
        beside = (s < low) | (s > high)
        if beside.any():
            inside = np.clip(s[beside], low, high)
            there = np.sqrt(np.maximum(self._chord(self.turns(inside))[2], 0.0))
            half[beside] = there * np.sin(np.pi * s[beside]) / np.sin(np.pi * inside)
        return foot + self.branch * half * way

    def place(self, s: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Where the body is (...); u (...) are the turns there."""
        return self._of_first(s, u) - u * self.a

    def velocities(self, s: np.ndarray, point: complex) -> np.ndarray:
        """Derivatives (...) by s of a point of the body. At dead centres they are those close to
        it.
        """
        s = np.clip(s, NEAR, 1.0 - NEAR)
        u = self.turns(s)
        p = self.place(s, u)
        turning = 0.5 * (self.high - self.low) * np.sin(np.pi * s) * np.pi
        one, two = (
            p + u * x - piece.centre if piece.is_arc else 1j * piece.way / abs(piece.way) + 0.0 * u
            for piece, x in ((self.first, self.a), (self.second, self.b))
        )
        e, f = (-np.real(np.conj(n) * 1j * u * x) for n, x in ((one, self.a), (two, self.b)))
        across = np.imag(np.conj(one) * two)
        across = np.where(across == 0.0, np.inf, across)
        return turning * -1j * (e * two - f * one) / across + turning * 1j * u * point


def four_bars(first: PlanePiece, second: PlanePiece, a: complex, b: complex) -> Iterator[FourBar]:
    """The bodies with a point a on a circle or line and b on another, over all intervals in which
    they assemble.
    """
    for branch in (1.0, -1.0) if first.is_arc else (1.0,):
        for low, high in _intervals(first, second, b - a):
            if high - low > NARROW:
                yield FourBar(first, second, a, b, branch, low, high)


def _intervals(one: PlanePiece, two: PlanePiece, d: complex) -> list[tuple[float, float]]:
    """Intervals of angles of a body, whose point is on `one` and another, d from it, on `two`."""
    if not one.is_arc:
        return [(0.0, TURN)]
    if not two.is_arc:
        w = two.way / abs(two.way)
        off = ((one.centre - two.centre) * w.conjugate()).imag
        middle = 0.5 * np.pi - float(np.angle(d * w.conjugate()))
        return cosine_intervals(middle, (-one.radius - off) / abs(d), (one.radius - off) / abs(d))
    base = two.centre - one.centre
    scale = 2.0 * abs(base) * abs(d)
    total = abs(base) ** 2 + abs(d) ** 2
    least = (one.radius - two.radius) ** 2
    most = (one.radius + two.radius) ** 2
    if scale <= ROUNDING * total:
        return [(0.0, TURN)] if least <= total <= most else []
    middle = float(np.angle(base / d))
    found = cosine_intervals(middle, (total - most) / scale, (total - least) / scale)
    # with equal cranks both circles may fall together there, and the branches change
    same = abs(one.radius - two.radius) <= 1e-9 * one.radius
    return [x for lo, hi in found for x in _cut(lo, hi, middle if same else np.nan)]


def _cut(low: float, high: float, at: float) -> list[tuple[float, float]]:
    """An interval, cut at an angle modulo whole turns that is inside."""
    x = low + np.mod(at - low, TURN)
    return [(low, float(x)), (float(x), high)] if low + 1e-12 < x < high - 1e-12 else [(low, high)]


@cache
def _gauss(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights (n,) of Gauss and Legendre for integrals from 0 to 1."""
    x, w = np.polynomial.legendre.leggauss(n)
    return 0.5 * (x + 1.0), 0.5 * w


def _overlapping(one: np.ndarray, two: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (k,), (k,) of boxes (2, 2, n) of two curves that overlap: first of groups of them, then
    of single ones.
    """
    groups = [
        np.stack([b[0].reshape(2, -1, GROUP).min(axis=2), b[1].reshape(2, -1, GROUP).max(axis=2)])
        for b in (one, two)
    ]
    inside = np.arange(GROUP)
    i, j = (
        x[:, None] * GROUP + inside
        for x in np.nonzero(_overlap(groups[0][..., None], groups[1][:, :, None]))
    )
    i, j = np.broadcast_arrays(i[:, :, None], j[:, None, :])
    i = i.ravel()
    j = j.ravel()
    both = _overlap(one[..., i], two[..., j])
    return i[both], j[both]


def _overlap(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    return ((one[0] <= two[1]) & (two[0] <= one[1])).all(axis=0)


@dataclass(frozen=True)
class CouplerCurve(PlaneCurve):
    """The curve of the point `point` of a four-bar's body, with its s from `start` to
    `start + sweep`.
    """

    bar: FourBar
    point: complex = 0j
    start: float = 0.0
    sweep: float = 1.0

    kind = "coupler curve"

    def _s(self, t: np.ndarray | float) -> np.ndarray:
        return self.start + self.sweep * np.asarray(t, dtype=float)

    def turns(self, t: np.ndarray | float) -> np.ndarray:
        """The unit numbers (...) by which the body is turned at parameters t (...)."""
        return self.bar.turns(self._s(t))

    def at(self, t: np.ndarray | float) -> np.ndarray:
        """Points (...) at parameters t (...)."""
        s = self._s(t)
        u = self.bar.turns(s)
        return self.bar.place(s, u) + u * self.point

    def velocity(self, t: np.ndarray | float) -> np.ndarray:
        """Derivatives (...) by t."""
        return self.sweep * self.bar.velocities(self._s(t), self.point)

    def of(self, point: complex) -> CouplerCurve:
        """The curve of another point of the body, with the same parameters."""
        return replace(self, point=point)

    def part(self, a: float, b: float) -> CouplerCurve:
        """The piece from the parameter a to b."""
        return replace(self, start=self.start + self.sweep * a, sweep=self.sweep * (b - a))

    def points(self, fine: float) -> np.ndarray:
        """Points (k,) along it, between which it turns by less than an angle."""
        t, p = self._fine
        bends = np.abs(np.angle(p[2:] - p[1:-1]) - np.angle(p[1:-1] - p[:-2]))
        total = float(np.minimum(bends, TURN - bends).sum())
        return self.at(np.linspace(0.0, 1.0, max(len(t), int(2.0 * total / fine))))

    def data(self) -> dict[str, Any]:
        """Its numbers, for JSON: points on it."""
        return super().data() | {"points": [as_pair(p) for p in self._fine[1][::4]]}

    def tangent(self, t: float) -> complex:
        """The unit tangent at a parameter."""
        v = complex(self.velocity(t))
        return v / abs(v)

    @cached_property
    def _fine(self) -> tuple[np.ndarray, np.ndarray]:
        t = np.linspace(0.0, 1.0, SAMPLES)
        return t, self.at(t)

    @cached_property
    def length(self) -> float:
        """Its length in metres, as that of chords."""
        return float(np.abs(np.diff(self._fine[1])).sum())

    @cached_property
    def moment(self) -> float:
        """Half of the integral of x dy - y dx along it: its part of the area that a closed curve
        has to its left.
        """
        value = np.inf
        rounding = ROUNDING * self.length * (self.length + float(np.abs(self._fine[1]).max()))
        for n in NODES:
            before = value
            x, w = _gauss(n)
            value = 0.5 * float(w @ np.imag(np.conj(self.at(x)) * self.velocity(x)))
            if abs(value - before) <= rounding:
                break
        return value

    @property
    def extremes(self) -> np.ndarray:
        """Its ends, and where x or y is largest or least on it (k,)."""
        t = [
            self.roots(lambda x, axis=axis: np.real(self.velocity(x) * axis)) for axis in (1.0, -1j)
        ]
        return self.at(np.concatenate([[0.0, 1.0], *t]))

    def nearest(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (n,) of the points of it that are nearest to points (n,), and their distances."""
        t, fine = self._fine
        far = np.abs(p[:, None] - fine)
        best = np.argmin(far, axis=1)
        x = t[best]
        least = far[np.arange(len(p)), best]
        for _ in range(5):  # towards the foot of the perpendicular
            v = self.velocity(x)
            foot = x + np.real(np.conj(v) * (p - self.at(x))) / np.maximum(np.abs(v) ** 2, 1e-300)
            foot = np.clip(foot, 0.0, 1.0)
            off = np.abs(p - self.at(foot))
            still = np.abs(foot - x).max(initial=0.0)
            x = np.where(off <= least, foot, x)
            least = np.minimum(off, least)
            if still < CONVERGED:
                break
        return x, least

    def distance(self, p: np.ndarray) -> np.ndarray:
        """Distances (...) of points (...) from it."""
        z = np.asarray(p, dtype=complex).ravel()
        parts = [self.nearest(z[k : k + CURVE_CHUNK])[1] for k in range(0, len(z), CURVE_CHUNK)]
        return np.concatenate([np.zeros(0), *parts]).reshape(np.shape(p))

    def directions(self, p: np.ndarray) -> np.ndarray:
        """Unit tangents (n,) at the points of it that are nearest to points (n,)."""
        v = self.velocity(self.nearest(p)[0])
        return v / np.maximum(np.abs(v), 1e-300)

    @cached_property
    def _boxes(self) -> np.ndarray:
        """Least and largest x and y (2, 2, n) of boxes about chords between samples, wide enough
        for the curve.
        """
        z = self._fine[1]
        corners = np.stack([z[:-1], z[1:]])
        xy = np.stack([np.real(corners), np.imag(corners)])
        wide = MARGIN * np.abs(np.diff(z))
        return np.stack([xy.min(axis=1) - wide, xy.max(axis=1) + wide])

    def roots(self, f: Callable[[np.ndarray], np.ndarray], touch: float = 0.0) -> np.ndarray:
        """Parameters between 0 and 1 at which a function changes sign, or comes as near to 0 as
        `touch`.
        """
        t = self._fine[0]
        y = f(t)
        middle = (
            np.flatnonzero((np.abs(y[1:-1]) < np.abs(y[:-2])) & (np.abs(y[1:-1]) <= np.abs(y[2:])))
            + 1
        )
        middle = middle[(y[middle] * y[middle - 1] > 0.0) & (y[middle] * y[middle + 1] > 0.0)]
        falls = np.maximum(np.abs(y[middle - 1] - y[middle]), np.abs(y[middle + 1] - y[middle]))
        # else it does not come to 0 between two samples
        middle = middle[np.abs(y[middle]) <= falls + touch]
        low = t[middle - 1]
        high = t[middle + 1]
        for _ in range(HALVINGS if len(middle) else 0):  # the least of |f|, by thirds
            a = low + (high - low) / 3.0
            b = high - (high - low) / 3.0
            left = f(a) * np.sign(y[middle]) < f(b) * np.sign(y[middle])
            low = np.where(left, low, a)
            high = np.where(left, b, high)
        nearest = 0.5 * (low + high)
        t = np.sort(np.concatenate([t, nearest]))
        y = f(t)
        k = np.flatnonzero(y[:-1] * y[1:] < 0.0)
        low = t[k]
        high = t[k + 1]
        sign = np.sign(y[k])
        for _ in range(HALVINGS if len(k) else 0):
            x = 0.5 * (low + high)
            same = f(x) * sign > 0.0
            low = np.where(same, x, low)
            high = np.where(same, high, x)
        close = nearest[np.abs(f(nearest)) <= touch] if len(nearest) else nearest
        return np.concatenate([0.5 * (low + high), t[y == 0.0], close])

    def meets(self, other: PlaneCurve, slack: float = ENDS) -> np.ndarray:
        """Parameters (k,) at which it meets or touches another curve, or crosses itself.

        Where one touches the other with its end, rounding finds meetings beside that: they are left
        out.
        """
        near = TOUCHING * (self.length + other.length)
        if self._passes(other):
            return np.zeros(0)
        if isinstance(other, PlanePiece):
            t = self.roots(lambda x: other.off(self.at(x)), near)
            t = t[other.parameters(self.at(t), slack)[1]]
        else:
            assert isinstance(other, CouplerCurve)
            t = self._crossed(other, near)
        if other is self:
            return t
        ends = np.array([0.0, 1.0])
        x, off = self.nearest(other.at(ends))
        ends = np.concatenate([ends[other.distance(self.at(ends)) <= near], x[off <= near]])
        p = self.at(t)
        across = np.abs(np.imag(np.conj(self.directions(p)) * other.directions(p)))
        beside = (np.abs(t[:, None] - ends) < AT_END).any(axis=1) & (across < FLAT_ANGLE)
        return np.append(t[~beside], ends)

    def _passes(self, other: PlaneCurve) -> bool:
        """Whether it is seen at once that it does not come near another curve."""
        if isinstance(other, CouplerCurve):
            one, two = ((b[0].min(axis=1), b[1].max(axis=1)) for b in (self._boxes, other._boxes))
            return bool((one[0] > two[1]).any() or (two[0] > one[1]).any())
        assert isinstance(other, PlanePiece)
        off = np.abs(other.off(self._fine[1]))
        chord = np.abs(np.diff(self._fine[1])).max()
        return bool(off.min() > chord)

    def _crossed(self, other: CouplerCurve, near: float) -> np.ndarray:
        """Parameters (k,) where it comes as near as that to another one: Newton's method from where
        boxes overlap.
        """
        t = self._fine[0]
        s = other._fine[0]
        i, j = _overlapping(self._boxes, other._boxes)
        if not len(i):
            return np.zeros(0)
        x = 0.5 * (t[i] + t[i + 1])
        y = 0.5 * (s[j] + s[j + 1])
        step = 1.0 / (SAMPLES - 1)
        for _ in range(12):
            gap = other.at(y) - self.at(x)
            v = self.velocity(x)
            w = other.velocity(y)
            across = np.imag(np.conj(v) * w)
            across = np.where(np.abs(across) < 1e-300, 1e-300, across)
            x = np.clip(x + np.clip(np.imag(np.conj(gap) * w) / across, -step, step), 0.0, 1.0)
            y = np.clip(y + np.clip(np.imag(np.conj(gap) * v) / across, -step, step), 0.0, 1.0)
        met = np.abs(other.at(y) - self.at(x)) <= near
        if other is self:
            apart = np.abs(x - y)
            met &= (apart > ITSELF) & (
                (apart < 1.0 - ITSELF) | (abs(self.at(0.0) - self.at(1.0)) > near)
            )
        return x[met]


# ---- regions of platforms

# At a place p, with the platform turned by the unit number u, its point b is at p + u b. So a leg
# with the region W holds at the angles at which a circle about p is inside W, and p is reached if
# the legs hold at a common angle. The workspace ends where such intervals shrink to nothing: where
# the circle leaves W, beside its boundary or at a corner, and where two legs hold on different
# sides of one angle, so that their points are on boundaries and p on a coupler curve. Source:
# Merlet, Gosselin, Mouly, "Workspaces of planar parallel manipulators", Mechanism and Machine
# Theory 33 (1998).

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
        # the middles of intervals between which nothing changes, and an angle if there are none
        if self.curve is None:
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
