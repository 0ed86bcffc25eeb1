"""Arcs and segments in the plane, as complex numbers, and regions that such curves bound."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self, cast

import numpy as np

TURN = 2.0 * np.pi
TOUCH = 1e-13
"""Square of half the chord that circles share, in squares of the radius, below which they touch."""
ENDS = 1e-9
"""Part of a curve by which it is taken as longer, so that curves that end on others meet these."""


# ---- curves


class PlaneCurve:
    """A piece of a curve, from its parameter 0 to 1, smooth but for its ends."""

    kind: Any
    """What it is, as a noun."""
    length: Any
    """Its length in metres."""
    moment: Any
    """Half of the integral of x dy - y dx along it: its part of the area that a closed curve has to
    its left."""
    extremes: Any
    """Its ends, and where x or y is largest or least on it (k,)."""

    def at(self, t: np.ndarray | float) -> np.ndarray:
        """Points (...) at parameters t (...)."""
        raise NotImplementedError

    def tangent(self, t: float) -> complex:
        """The unit tangent at a parameter."""
        raise NotImplementedError

    def part(self, a: float, b: float) -> Self:
        """The piece from the parameter a to b."""
        raise NotImplementedError

    def distance(self, p: np.ndarray) -> np.ndarray:
        """Distances (...) of points (...) from it."""
        raise NotImplementedError

    def directions(self, p: np.ndarray) -> np.ndarray:
        """Unit tangents (n,) at the points of it that are nearest to points (n,), which are close
        to it.
        """
        raise NotImplementedError

    def meets(self, other: PlaneCurve, slack: float = ENDS) -> np.ndarray:
        """Parameters (k,) of the points in which it meets or touches another piece."""
        raise NotImplementedError

    def points(self, fine: float) -> np.ndarray:
        """Points (k,) along it, between which it turns by less than an angle."""
        raise NotImplementedError

    def data(self) -> dict[str, Any]:
        """Its numbers, for JSON."""
        return {"kind": self.kind, "from": as_pair(self.at(0.0)), "to": as_pair(self.at(1.0))}


def as_pair(z: Any) -> list[float]:
    """A point as x and y."""
    point = complex(z)
    return [point.real, point.imag]


@dataclass(frozen=True)
class PlanePiece(PlaneCurve):
    """A piece of a curve, from its parameter 0 to 1: an arc about `centre` of `radius`, from the
    angle `start` on by `sweep`; where the radius is 0 a segment from `centre` by `way`.
    """

    centre: complex
    radius: float
    start: float = 0.0
    sweep: float = 0.0
    way: complex = 0j

    @property
    def is_arc(self) -> bool:
        """Whether it is an arc, not a segment."""
        return self.radius > 0.0

    @property
    def kind(self) -> str:
        """What it is, as a noun."""
        return "arc" if self.is_arc else "segment"

    def points(self, fine: float) -> np.ndarray:
        """Points (k,) along it, between which it turns by less than an angle."""
        return self.at(np.linspace(0.0, 1.0, max(2, int(abs(self.sweep) / fine) + 2)))

    def data(self) -> dict[str, Any]:
        """Its numbers, for JSON."""
        arc = {
            "centre": as_pair(self.centre),
            "radius": self.radius,
            "start": self.start,
            "sweep": self.sweep,
        }
        return super().data() | (arc if self.is_arc else {})

    @property
    def length(self) -> float:
        """Its length in metres."""
        return self.radius * abs(self.sweep) if self.is_arc else abs(self.way)

    def at(self, t: np.ndarray | float) -> np.ndarray:
        """Points (...) at parameters t (...)."""
        t = np.asarray(t, dtype=float)
        if self.is_arc:
            return self.centre + self.radius * np.exp(1j * (self.start + self.sweep * t))
        return self.centre + self.way * t

    def tangent(self, t: float) -> complex:
        """The unit tangent at a parameter."""
        if self.is_arc:
            return complex(1j * np.sign(self.sweep) * np.exp(1j * (self.start + self.sweep * t)))
        return self.way / abs(self.way)

    def part(self, a: float, b: float) -> PlanePiece:
        """The piece from the parameter a to b."""
        if self.is_arc:
            return PlanePiece(
                self.centre, self.radius, self.start + self.sweep * a, self.sweep * (b - a)
            )
        return PlanePiece(self.centre + self.way * a, 0.0, way=self.way * (b - a))

    def parameters(self, p: np.ndarray, slack: float = ENDS) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (...) of points (...) of its circle or line, and whether they are on it."""
        if not self.is_arc:
            t = np.real((p - self.centre) * np.conj(self.way)) / abs(self.way) ** 2
            return t, (t > -slack) & (t < 1.0 + slack)
        sense = np.sign(self.sweep)
        size = abs(self.sweep)
        turn: np.ndarray = np.mod(sense * (np.angle(p - self.centre) - self.start), TURN)
        turn = np.where(turn > size + 0.5 * (TURN - size), turn - TURN, turn)
        t = turn / max(size, 1e-300)  # an arc may have shrunk to a point
        return t, (t > -slack) & (t < 1.0 + slack)

    def directions(self, p: np.ndarray) -> np.ndarray:
        """Unit tangents (n,) at the points of it that are nearest to points (n,), which are close
        to it.
        """
        if not self.is_arc:
            return np.full(np.shape(p), self.way / abs(self.way))
        d = p - self.centre
        return 1j * np.sign(self.sweep) * d / np.maximum(np.abs(d), 1e-300)

    def off(self, p: np.ndarray) -> np.ndarray:
        """How far points (...) are outside its circle, or to the left of its line, in metres;
        negative on the other.
        """
        if self.is_arc:
            return np.abs(p - self.centre) - self.radius
        return np.imag((p - self.centre) * np.conj(self.way)) / abs(self.way)

    def meets(self, other: PlaneCurve, slack: float = ENDS) -> np.ndarray:
        """Parameters (k,) of the points in which it meets or touches another piece; none on the
        same circle or line.
        """
        if isinstance(other, PlanePiece):
            p = circle_points(self, other)
            p = p[other.parameters(p, slack)[1]] if len(p) else p
        else:
            p = other.at(other.meets(self, slack))
        t, on = self.parameters(p, slack)
        return t[on]

    def distance(self, p: np.ndarray) -> np.ndarray:
        """Distances (...) of points (...) from it."""
        t, on = self.parameters(p)
        near = (
            np.abs(np.abs(p - self.centre) - self.radius) if self.is_arc else np.abs(p - self.at(t))
        )
        return np.where(on, near, np.minimum(np.abs(p - self.at(0.0)), np.abs(p - self.at(1.0))))

    @property
    def extremes(self) -> np.ndarray:
        """Its ends, and where x or y is largest or least on it (k,)."""
        ends = self.at(np.array([0.0, 1.0]))
        if not self.is_arc:
            return ends
        sides = self.centre + self.radius * np.array([1.0, 1j, -1.0, -1j])
        return np.append(ends, sides[self.parameters(sides)[1]])

    @property
    def moment(self) -> float:
        """Half of the integral of x dy - y dx along it: its part of the area that a closed curve
        has to its left.
        """
        if not self.is_arc:
            return 0.5 * float((self.centre.conjugate() * self.way).imag)
        a = self.at(0.0)
        b = self.at(1.0)
        return (
            0.5 * float((self.centre.conjugate() * (b - a)).imag)
            + 0.5 * self.radius**2 * self.sweep
        )


def circle_points(a: PlanePiece, b: PlanePiece) -> np.ndarray:
    """Points in which the circles or lines of two pieces meet or touch, of the same circle or line
    none.
    """
    if not a.is_arc and not b.is_arc:
        across = np.imag(np.conj(a.way) * b.way)
        if abs(across) < 1e-12 * abs(a.way) * abs(b.way):
            return np.zeros(0, dtype=complex)
        t = np.imag(np.conj(b.centre - a.centre) * b.way) / across
        return np.array([a.centre + t * a.way])
    if not a.is_arc:
        a, b = b, a
    if b.is_arc:
        d = b.centre - a.centre
        far = abs(d)
        if far < 1e-12 * (a.radius + b.radius):
            return np.zeros(0, dtype=complex)
        along = (far**2 + a.radius**2 - b.radius**2) / (2.0 * far)
        foot = a.centre + along * d / far
        unit = 1j * d / far
    else:
        unit = b.way / abs(b.way)
        foot = b.centre + unit * np.real((a.centre - b.centre) * np.conj(unit))
        along = abs(foot - a.centre)
    rest = a.radius**2 - along**2
    if rest < -1e-10 * a.radius**2:
        return np.zeros(0, dtype=complex)
    half = np.sqrt(rest) if rest > TOUCH * a.radius**2 else 0.0
    return np.array([foot - half * unit, foot + half * unit])


def merged(curves: Iterable[PlaneCurve], same: float) -> list[PlaneCurve]:
    """The curves longer than `same` metres; pieces on the same circle or line are joined where they
    overlap.
    """
    groups: list[tuple[PlanePiece, list[tuple[float, float]]]] = []
    others: list[PlaneCurve] = []
    for piece in curves:
        if piece.length < same:
            continue
        if not isinstance(piece, PlanePiece):
            others.append(piece)
            continue
        for first, spans in groups:
            if _same_curve(first, piece, same):
                spans += _spans(first, piece)
                break
        else:
            groups.append((_whole(piece), _spans(_whole(piece), piece)))
    return [first.part(a, b) for first, spans in groups for a, b in _joined(spans)] + others


def _whole(piece: PlanePiece) -> PlanePiece:
    """The circle of an arc from the angle 0 on, or the line of a segment with its nearest point to
    the origin.
    """
    if piece.is_arc:
        return PlanePiece(piece.centre, piece.radius, 0.0, TURN)
    unit = piece.way / abs(piece.way)
    return PlanePiece(piece.centre - unit * np.real(piece.centre * np.conj(unit)), 0.0, way=unit)


def _same_curve(a: PlanePiece, b: PlanePiece, same: float) -> bool:
    if a.is_arc != b.is_arc:
        return False
    if a.is_arc:
        return abs(a.centre - b.centre) < same and abs(a.radius - b.radius) < same
    off = [abs(np.imag((b.at(t) - a.centre) * np.conj(a.way))) for t in (0.0, 1.0)]
    return max(off) < same


def _spans(first: PlanePiece, piece: PlanePiece) -> list[tuple[float, float]]:
    """Intervals of parameters of a whole circle (0 to 1) or line, that a piece of it takes."""
    if not first.is_arc:
        t = np.real((piece.at(np.array([0.0, 1.0])) - first.centre) * np.conj(first.way))
        return [(float(t.min()), float(t.max()))]
    if abs(piece.sweep) >= TURN - 1e-12:
        return [(0.0, 1.0)]
    a = np.mod(min(piece.start, piece.start + piece.sweep), TURN) / TURN
    b = a + abs(piece.sweep) / TURN
    return [(a, b)] if b <= 1.0 else [(a, 1.0), (0.0, b - 1.0)]


def _joined(spans: list[tuple[float, float]]) -> list[tuple[float, float]]:
    out: list[tuple[float, float]] = []
    for a, b in sorted(spans):
        if out and a <= out[-1][1] + 1e-12:
            out[-1] = (out[-1][0], max(out[-1][1], b))
        else:
            out.append((a, b))
    return out


# ---- regions

# Of the curves on which a region can end, those bound it that have the region on one side only.

NOTHING = 1e-12
SAME = 1e-10
"""Difference, in sizes of a region, up to which circles and lines are the same."""
BESIDE = 1e-6
"""How far beside a curve points are tried, in sizes of a region, at most as a part of the curve's
length, and nearer where another curve is near."""
PART = 0.02


class PlanarRegion:
    """A region by the curves on which it can end, and by what it says of single points."""

    size: Any
    """A length of it in metres."""
    candidates: Any
    """Pieces of all curves on which it can end: a list of `PlaneCurve`."""
    counted: Any
    """Whether `solutions` counts, or else is 0 or 1."""
    is_curve: Any
    """Whether it is a curve, without area."""

    @property
    def limited(self) -> int:
        """How many joints with limits one chain has at most: the work grows with a power of that."""
        raise NotImplementedError

    def solutions(self, p: complex) -> int:
        """In how many ways a point that is on no candidate is reached."""
        raise NotImplementedError

    @cached_property
    def ends(self) -> list[PlaneCurve]:
        """The boundary of the workspace: pieces that have the workspace to their left only."""
        return [p for p, left, right in self.sides if left and not right]

    @cached_property
    def sides(self) -> list[tuple[PlaneCurve, int, int]]:
        """Pieces of the candidates, cut where these meet, with the numbers of solutions to the left
        and to the right.

        Each piece is directed so that the number to its left is no less.
        """
        out: list[tuple[PlaneCurve, int, int]] = []
        for piece in self.candidates:
            cuts = [piece.meets(other) for other in self.candidates]
            t = np.unique(np.concatenate([[0.0, 1.0], *cuts]).clip(0.0, 1.0))
            t = t[np.concatenate([[True], np.diff(t) * piece.length > 10.0 * SAME * self.size])]
            t[-1] = 1.0
            for a, b in itertools.pairwise(t):
                part = piece.part(a, b)
                middle = complex(part.at(0.47))
                others = (
                    float(c.distance(np.asarray(middle))) for c in self.candidates if c is not piece
                )
                thin = min((0.3 * x for x in others if x > 0.1 * SAME * self.size), default=np.inf)
                beside = min(BESIDE * self.size, PART * part.length, thin) * 1j * part.tangent(0.47)
                left, right = (self.solutions(middle + s * beside) for s in (1.0, -1.0))
                if left >= right:
                    out.append((part, left, right))
                else:
                    out.append((part.part(1.0, 0.0), right, left))
        return out

    def holds(self, p: Any) -> Any:
        """Whether points (...), which are not on the boundary, are inside it."""
        raise NotImplementedError


class RegionOfArcs(PlanarRegion):
    """A region that is bounded by arcs and segments only."""

    def holds(self, p: Any) -> Any:
        """Whether points (...), which are not on the boundary, are inside it: by how often this
        goes round them.
        """
        z = np.asarray(p)
        turns = sum(
            (_turn_about(cast(PlanePiece, piece), z) for piece in self.ends), np.zeros(z.shape)
        )
        return np.round(turns / TURN) != 0


def _turn_about(piece: PlanePiece, p: np.ndarray) -> np.ndarray:
    """The angles by which the way from points (...) to a point turns as this goes along a piece."""
    a = complex(piece.at(0.0)) - p
    b = complex(piece.at(1.0)) - p
    if not piece.is_arc:
        return np.angle(b * a.conj())
    # along the arc the angle is that of the chord, and a full turn more where p lies between the
    # two
    parts = max(1, int(np.ceil(abs(piece.sweep) / 1.5)))
    total = np.zeros(p.shape)
    for k in range(parts):
        small = piece.part(k / parts, (k + 1) / parts)
        ends = complex(small.at(0.0)), complex(small.at(1.0))
        inside = np.abs(p - small.centre) < small.radius
        side = np.sign(small.sweep)
        beyond = np.imag((p - ends[0]) * np.conj(ends[1] - ends[0])) * side < 0.0
        total += np.angle((ends[1] - p) * (ends[0] - p).conj()) + TURN * side * (inside & beyond)
    return total
