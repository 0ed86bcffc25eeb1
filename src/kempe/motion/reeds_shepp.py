"""Shortest ways of Reeds and Shepp, for a car with a smallest turning radius that drives both ways.

A way is a sequence of (curvature, length) pairs of unit radius: curvature 1 turns left, -1 right, 0
goes straight; a negative length goes in reverse. Source: Reeds and Shepp, *Optimal paths for a car
that goes both forwards and backwards*, Pacific J. Math. 145, 1990: one of their 48 words is
shortest. Each way that a formula gives is followed to its end, and counts only where that is the
goal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from kempe.numerics.newton import run_gauss_newton
from kempe.numerics.rank import Level
from kempe.spatial import Array

Way = tuple[tuple[float, float], ...]
"""(curvature, signed length) of each piece, for the radius 1."""
L = 1.0
S = 0.0
R = -1.0
QUARTER = 0.5 * math.pi
MISS = 1e-6
"""By how much a formula's way may miss the goal before it is corrected: more is another word's
domain."""
HIT = 1e-13
"""By how much a way may miss the goal in the end, relative to the distances in it."""
TRIES = 8
"""Steps of the correction at most; it ends where a step brings no digit."""
NOTHING = 1e-14
"""Length of a piece that is left out."""


def wrap_angle(angle: float) -> float:
    """Return the angle, in radians, wrapped into [-pi, pi]."""
    return math.remainder(angle, 2.0 * math.pi)


def advance_pose(
    pose: tuple[float, float, float], curvature: float, length: float
) -> tuple[float, float, float]:
    """Return the pose (x, y, heading) after a piece of constant curvature and signed length."""
    x, y, h = pose
    half = 0.5 * curvature * length
    chord = length * (math.sin(half) / half if half else 1.0)
    return x + chord * math.cos(h + half), y + chord * math.sin(h + half), h + 2.0 * half


def compute_end_pose(way: Way) -> tuple[float, float, float]:
    """Compute the pose at the end of a way from (0, 0, 0)."""
    pose = (0.0, 0.0, 0.0)
    for curvature, length in way:
        pose = advance_pose(pose, curvature, length)
    return pose


def compute_length(way: Way) -> float:
    """Compute the length of a way; reverse pieces count like the others."""
    return math.fsum(abs(length) for _, length in way)


def list_ways(x: float, y: float, heading: float) -> list[Way]:
    """List ways from (0, 0, 0) to a pose for the radius 1, the shortest first.

    There is one for each word that leads to the pose.
    """
    found: dict[tuple[tuple[float, bool], ...], Way] = {}
    for way in _iterate_candidates(x, y, heading):
        exact = _correct_way(way, x, y, heading)
        if exact is not None:
            word = tuple((c, length > 0.0) for c, length in exact)
            if word not in found or compute_length(exact) < compute_length(found[word]):
                found[word] = exact
    return sorted(found.values(), key=compute_length)


def _iterate_candidates(x: float, y: float, h: float) -> Iterator[Way]:
    """Iterate over the words of section 8 and their mirror images, also reversed in time.

    Words from the goal backwards are among them.
    """
    c = math.cos(h)
    s = math.sin(h)
    for a, b, backwards in ((x, y, False), (x * c + y * s, x * s - y * c, True)):
        for time in (1.0, -1.0):
            for side in (1.0, -1.0):
                for word in WORDS:
                    for way in word(time * a, side * b, time * side * h):
                        own = tuple((side * k, time * length) for k, length in way)
                        yield own[::-1] if backwards else own


def _correct_way(way: Way, x: float, y: float, h: float) -> Way | None:
    """Return the way with its lengths corrected to the last digits (Newton, smallest change).

    It is None where it does not lead to the goal.
    """
    size = 1.0 + math.hypot(x, y)

    def make_way(lengths: Array) -> Way:
        """Return the way with other lengths."""
        return tuple((k, s) for (k, _), s in zip(way, lengths.tolist(), strict=True))

    def evaluate_miss(lengths: Array) -> tuple[Array, Array]:
        """Return the difference of the end from the goal, and its derivatives."""
        end = compute_end_pose(make_way(lengths))
        miss = np.array([end[0] - x, end[1] - y, wrap_angle(end[2] - h)])
        near = np.abs(miss).max() < MISS * size
        return (miss if near else np.full(3, math.inf)), _compute_derivatives(make_way(lengths))

    found = run_gauss_newton(
        evaluate_miss, np.array([length for _, length in way]), TRIES, level=Level.GENERIC
    )
    if not np.abs(found.r).max() < HIT * size:
        return None
    return tuple(piece for piece in make_way(found.x) if abs(piece[1]) > NOTHING)


def _compute_derivatives(way: Way) -> Array:
    """Compute derivatives (3, n) of the pose at the end by the lengths of the pieces."""
    x, y, _ = compute_end_pose(way)
    pose = (0.0, 0.0, 0.0)
    columns: list[list[float]] = []
    for k, length in way:
        pose = advance_pose(pose, k, length)
        columns.append(
            [math.cos(pose[2]) - k * (y - pose[1]), math.sin(pose[2]) + k * (x - pose[0]), k]
        )
    return np.array(columns).T


def _iterate_csc(x: float, y: float, h: float) -> Iterator[Way]:
    """Iterate over words arc, straight piece, arc: (8.1) to the same side, (8.2) to the other one."""
    a = x - math.sin(h)
    b = y - 1.0 + math.cos(h)
    t = math.atan2(b, a)
    yield (L, t), (S, math.hypot(a, b)), (L, wrap_angle(h - t))
    a = x + math.sin(h)
    b = y - 1.0 - math.cos(h)
    square = a * a + b * b - 4.0
    if square >= 0.0:
        u = math.sqrt(square)
        t = wrap_angle(math.atan2(b, a) + math.atan2(2.0, u))
        yield (L, t), (S, u), (R, wrap_angle(t - h))


def _iterate_ccc(x: float, y: float, h: float) -> Iterator[Way]:
    """Iterate over words of three arcs: (8.3) to (8.6)."""
    a = x - math.sin(h)
    b = y - 1.0 + math.cos(h)
    rho = math.hypot(a, b)
    if rho <= 4.0:
        u = -2.0 * math.asin(0.25 * rho)
        t = wrap_angle(math.atan2(b, a) + 0.5 * u + math.pi)
        yield (L, t), (R, u), (L, wrap_angle(h - t + u))


def _iterate_cccc(x: float, y: float, h: float) -> Iterator[Way]:
    """Iterate over words of four arcs, with equal ones in the middle: (8.7), (8.8)."""
    a = x + math.sin(h)
    b = y - 1.0 - math.cos(h)
    rho = math.hypot(a, b)
    inner = 0.25 * (2.0 + rho)
    outer = (20.0 - rho * rho) / 16.0
    if inner <= 1.0:
        u = math.acos(inner)
        t, v = _compute_outer_arcs(u, -u, a, b, h)
        yield (L, t), (R, u), (L, -u), (R, v)
    if 0.0 <= outer <= 1.0:
        u = -math.acos(outer)
        t, v = _compute_outer_arcs(u, u, a, b, h)
        yield (L, t), (R, u), (L, u), (R, v)


def _compute_outer_arcs(u: float, v: float, a: float, b: float, h: float) -> tuple[float, float]:
    """Compute the first and the last of four arcs, those in the middle being u and v."""
    d = u - v
    p = math.sin(u) - math.sin(d)
    r = math.cos(u) - math.cos(d) - 1.0
    t = math.atan2(b * p - a * r, a * p + b * r)
    if 2.0 * (math.cos(d) - math.cos(v) - math.cos(u)) + 3.0 < 0.0:
        t += math.pi
    return wrap_angle(t), wrap_angle(t - u + v - h)


def _iterate_ccsc(x: float, y: float, h: float) -> Iterator[Way]:
    """Iterate over words arc, quarter circle back, straight piece, arc: (8.9), (8.10)."""
    a = x - math.sin(h)
    b = y - 1.0 + math.cos(h)
    rho = math.hypot(a, b)
    if rho >= 2.0:
        r = math.sqrt(rho * rho - 4.0)
        t = wrap_angle(math.atan2(b, a) + math.atan2(r, -2.0))
        yield (L, t), (R, -QUARTER), (S, 2.0 - r), (L, wrap_angle(h - QUARTER - t))
    a = x + math.sin(h)
    b = y - 1.0 - math.cos(h)
    rho = math.hypot(a, b)
    if rho >= 2.0:
        t = math.atan2(a, -b)
        yield (L, t), (R, -QUARTER), (S, 2.0 - rho), (R, wrap_angle(t + QUARTER - h))


def _iterate_ccscc(x: float, y: float, h: float) -> Iterator[Way]:
    """Iterate over words arc, quarter circle, straight piece, quarter circle, arc: (8.11)."""
    a = x + math.sin(h)
    b = y - 1.0 - math.cos(h)
    rho = math.hypot(a, b)
    if rho >= 2.0:
        u = 4.0 - math.sqrt(rho * rho - 4.0)
        t = wrap_angle(math.atan2((4.0 - u) * a - 2.0 * b, -2.0 * a + (u - 4.0) * b))
        yield (L, t), (R, -QUARTER), (S, u), (L, -QUARTER), (R, wrap_angle(t - h))


WORDS: tuple[Callable[[float, float, float], Iterator[Way]], ...] = (
    _iterate_csc,
    _iterate_ccc,
    _iterate_cccc,
    _iterate_ccsc,
    _iterate_ccscc,
)
"""The kinds of words, each a function of the goal."""
