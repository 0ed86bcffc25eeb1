"""Ends between which something may spin: consecutive joints in series whose axes meet in one point.

Where axes meet in a part that two joints share does not depend on the configuration, as long as it
is closed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.analysis.first_order.constraint_graph import ConstraintGraph
from kempe.analysis.first_order.screws import Screws
from kempe.analysis.first_order.series_joints import SeriesLoop, Star, all_series, stars
from kempe.model.kept import keep
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

ALONE = 1e-6
"""Sine of the angle between axes, or distance as a part of the mechanism's size, below which they
are one, or meet."""


class BallEnd(NamedTuple):
    """Consecutive edges of a series (by place, the one next to the group first) whose axes meet in
    one point.

    The point is on the first edge's axis, `along` from its origin. It is a `hinge` if that is its
    only axis.
    """

    edges: tuple[int, ...]
    along: float
    hinge: bool


class SignedEnd(NamedTuple):
    """An end, and the sense in which its series is passed: +1 towards what it holds, -1 from there."""

    series: SeriesLoop
    end: BallEnd
    sign: float


class Pair(NamedTuple):
    """Two ends of a series between which something may spin."""

    series: SeriesLoop
    left: BallEnd
    right: BallEnd

    @property
    def holds(self) -> tuple[SignedEnd, ...]:
        """Both ends as holds."""
        return SignedEnd(self.series, self.left, 1.0), SignedEnd(self.series, self.right, -1.0)


class HeldStar(NamedTuple):
    """A star with its ends."""

    star: Star
    holds: tuple[SignedEnd, ...]


def pairs_of(system: System, s: ConstraintGraph, at: Screws, driven: frozenset[int]) -> list[Pair]:
    """Pairs of ends between which something may spin, by what does not depend on the configuration.

    Where axes meet in a part that two joints share, they do so at every closed configuration, such
    as that of `at`.
    """
    answers = system._kept.setdefault(pairs_of, {})
    found = answers.get(driven)
    if found is None:
        found = keep(
            answers,
            driven,
            [p for series in all_series(system, driven) for p in _of_series(s, at, series)],
        )
    return found


def _of_series(s: ConstraintGraph, at: Screws, series: SeriesLoop) -> Iterator[Pair]:
    n = len(series.edges)
    meets = [_meet(s, at, series, k, k + 1) if series.joined[k] else None for k in range(n - 1)]
    turning = [k for k in range(n) if series.turns[k] is not None]
    ends = {(k, step): _grow(series, meets, k, step) for k in turning for step in (-1, 1)}
    balls = {
        step: {k for (k, d), end in ends.items() if d == step and not end.hinge} for step in (-1, 1)
    }
    chosen = {(p, q) for q in balls[1] for p in turning if p < q}
    chosen |= {(p, q) for p in balls[-1] for q in turning if p < q}
    chosen |= {(k, k + 1) for k, meet in enumerate(meets) if meet is not None and meet.one_axis}
    for p, q in sorted(chosen):
        pair = Pair(series, ends[p, -1], ends[q, 1])
        if not (pair.left.hinge or pair.right.hinge) or not (
            turning_inside(s, series, p, q) or _one_of_many(s, at, series, pair)
        ):
            yield pair


def held(system: System, s: ConstraintGraph, at: Screws, driven: frozenset[int]) -> list[HeldStar]:
    """Stars with their ends, which do not depend on the configuration either; nor does, without
    slides, their line.
    """
    answers = system._kept.setdefault(held, {})
    found = answers.get(driven)
    if found is None:
        found = keep(answers, driven, [])
        for star in stars(system, driven):
            holds: list[SignedEnd] = []
            if not (star.chains or star.points):  # nothing holds it
                continue
            for series in star.chains:
                meets = [_meet(s, at, series, k, k + 1) for k in range(len(series.edges) - 1)]
                holds.append(SignedEnd(series, _grow(series, meets, 0, 1), -1.0))
            simple = all(len(h.end.edges) == 1 for h in holds)
            if not simple and any(h.end.hinge for h in holds):  # it may be a spherical linkage
                continue
            if star.slides or line_through(at, HeldStar(star, tuple(holds))) is not None:
                found.append(HeldStar(star, tuple(holds)))
    return found


class _Meeting(NamedTuple):
    """Where the axes of two joints of one part meet: from their origins, along their axes; or they
    are one axis.
    """

    along: tuple[float, float]
    one_axis: bool


def _meet(s: ConstraintGraph, at: Screws, series: SeriesLoop, k: int, m: int) -> _Meeting | None:
    """Where the axes of the k-th and the m-th edge, which share a part, meet; None where they do
    not.
    """
    a = series.turns[k]
    b = series.turns[m]
    if a is None or b is None or not (a.columns and b.columns):
        return None
    (p, u), (r, v) = (line_of(at, series, i) for i in (k, m))
    away = (r - p) / at.length
    if u is None and v is None:
        return (
            _Meeting((0.0, 0.0), False)
            if np.linalg.norm(away) < ALONE and a.whole and b.whole
            else None
        )
    if u is not None and v is not None:
        normal = np.cross(u, v)
        size = np.linalg.norm(normal)
        if size < ALONE:
            return _Meeting((0.0, 0.0), True) if off(away, u) < ALONE else None
        if abs(away @ normal) > ALONE * size or not (a.whole and b.whole):
            return None
        x = np.cross(away, v) @ normal / size**2
        y = np.cross(away, u) @ normal / size**2
        return _Meeting((float(x), float(y)), False)
    if not (a.whole and b.whole):
        return None
    x = _along(u, away) if u is not None else _along(v, -away)
    if x is None:
        return None
    return _Meeting((x, 0.0) if u is not None else (0.0, x), False)


def _along(axis: Array | None, to: Array) -> float | None:
    """How far along an axis a point is, if it is on it."""
    assert axis is not None
    return float(to @ axis) if off(to, axis) < ALONE else None


def off(to: Array, axis: Array) -> float:
    """Distance of a point from the axis through the origin along a unit vector."""
    rest = to - (to @ axis) * axis
    return math.sqrt(rest @ rest)


def line_of(at: Screws, series: SeriesLoop, k: int) -> tuple[Array, Array | None]:
    """Origin of an edge, in the ground, and the direction of its axis if it can turn about one
    only.
    """
    i = series.edges[k]
    own = series.own(k)
    w = at.twists[i][3:, list(own)]
    return at.M[i, :3, 3], w[:, 0] / np.linalg.norm(w) if len(own) == 1 else None


def _grow(series: SeriesLoop, meets: Sequence[_Meeting | None], k: int, step: int) -> BallEnd:
    """The edges from the k-th on, in one direction, whose axes meet in one point, until they are as
    good as a ball.
    """
    edges = [k]
    columns = len(series.own(k))
    first = 0.0
    here = None
    while columns < 3:
        last = edges[-1]
        meet = meets[min(last, last + step)] if 0 <= last + step < len(series.edges) else None
        if meet is None or meet.one_axis:
            break
        near, far = meet.along if step > 0 else meet.along[::-1]
        if here is None:
            first = near
        elif abs(near - here) > ALONE:
            break
        here = far
        edges.append(last + step)
        columns += len(series.own(last + step))
    return BallEnd(tuple(edges), first, columns == 1)


def turning_inside(s: ConstraintGraph, series: SeriesLoop, p: int, q: int) -> bool:
    """Whether between two edges of a series there is more than slides."""
    inside = (s.edges[i] for i in series.edges[p + 1 : q])
    return any(not e.joint or any(c.index >= 0 and not c.slides for c in e.columns) for e in inside)


def _one_of_many(s: ConstraintGraph, at: Screws, series: SeriesLoop, pair: Pair) -> bool:
    """Whether a hinge and a ball made of several joints are but some of the joints about one point:
    of a spherical linkage, whose links are no parts of a ball.
    """
    hinge, ball = (pair.left, pair.right) if pair.left.hinge else (pair.right, pair.left)
    if ball.hinge or len(ball.edges) == 1:
        return False
    point = center_of(at, series, ball)
    n = len(series.edges)
    low = min(*hinge.edges, *ball.edges)
    high = max(*hinge.edges, *ball.edges)
    for k in {(low - 1) % n, (high + 1) % n} - set(range(low, high + 1)):
        edge = series.edges[k]
        T = at.twists[edge][:, [c for c, col in enumerate(s.edges[edge].columns) if not col.slides]]
        if T.size and np.abs(T[:3] - np.cross(point, T[3:], axis=0)).max() < ALONE:
            return True
    return False


def center_of(at: Screws, series: SeriesLoop, end: BallEnd) -> Array:
    """The point that all axes of an end go through, relative to the screws' centre, in their unit."""
    k = end.edges[0]
    point = (at.M[series.edges[k], :3, 3] - at.center) / at.length
    axis = line_of(at, series, k)[1] if len(series.own(k)) == 1 else None
    return point if axis is None else point + end.along * axis


def centers_of(at: Screws, of: Pair | HeldStar) -> list[Array]:
    """The points that hold a group, relative to the screws' centre, in their unit."""
    points = of.star.points if isinstance(of, HeldStar) else ()
    places = [(at.M if child else at.F)[i, :3, 3] for i, child in points]
    return [center_of(at, h.series, h.end) for h in of.holds] + [
        (p - at.center) / at.length for p in places
    ]


def line_through(at: Screws, of: Pair | HeldStar) -> tuple[Array, Array] | None:
    """A point and the direction of the line through all points that hold a group, and along all
    hinges that do.
    """
    centers = centers_of(at, of)
    a = next(
        (c for c, hold in zip(centers, of.holds, strict=False) if not hold.end.hinge), centers[0]
    )
    direction = None
    for series, end, _ in of.holds:
        along = line_of(at, series, end.edges[0])[1] if end.hinge else None
        direction = along if direction is None else direction
        if along is not None and direction is not None and off(along, direction) > ALONE:
            return None
    if direction is None:
        away = (
            centers[1] - a
            if len(centers) == 2
            else max((c - a for c in centers), key=lambda d: float(d @ d))
        )
        size = math.sqrt(away @ away)
        if size < ALONE:
            return None
        direction = away / size
        if len(centers) == 2:
            return a, direction
    return None if any(off(c - a, direction) > ALONE for c in centers) else (a, direction)
