"""Shortest ways of Reeds and Shepp, for a car with a smallest turning radius that drives both ways.

A way is a sequence of (curvature, length) pairs of unit radius: curvature 1 turns left, -1 right, 0
goes straight; a negative length goes in reverse. Source: Reeds and Shepp, *Optimal paths for a car
that goes both forwards and backwards*, Pacific J. Math. 145, 1990: one of their 48 words is
shortest. Each way that a formula gives is followed to its end, and counts only where that is the
goal.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

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


def follow_way(start: Array, lengths: Array, angles: Array) -> Array:
    """Follow lines and arcs of signed lengths (n,) that turn by angles (n,) from a pose (3,).

    Returned are the poses (n + 1, 3) in the plane, x, y and heading, at the ends of all pieces.
    """
    headings = start[2] + np.append(0.0, np.cumsum(angles))
    steps = compute_arc_steps(headings[:-1], lengths, angles)
    places = start[:2] + np.append(np.zeros((1, 2)), np.cumsum(steps, axis=0), axis=0)
    return np.column_stack([places, headings])


def compute_arc_steps(headings: Array, lengths: Array, angles: Array) -> Array:
    """Compute the displacements (n, 2) by arcs that begin with headings (n,)."""
    middle = headings + 0.5 * angles
    chords = lengths * np.sinc(0.5 * angles / math.pi)
    return np.column_stack([chords * np.cos(middle), chords * np.sin(middle)])


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
                for way in _iterate_words(time * a, side * b, time * side * h):
                    own = tuple((side * k, time * length) for k, length in way)
                    yield own[::-1] if backwards else own


def _correct_way(way: Way, x: float, y: float, h: float) -> Way | None:
    """Return the way with its lengths corrected to the last digits (Newton, smallest change).

    It is None where it does not lead to the goal.
    """
    size = 1.0 + math.hypot(x, y)
    curvatures, formula = np.array(way).T

    def evaluate_miss(lengths: Array) -> tuple[Array, Array]:
        """Return the difference of the end from the goal, and its derivatives."""
        poses = follow_way(np.zeros(3), lengths, curvatures * lengths)
        end = poses[-1]
        ahead = poses[1:]
        J = np.array(
            [
                np.cos(ahead[:, 2]) - curvatures * (end[1] - ahead[:, 1]),
                np.sin(ahead[:, 2]) + curvatures * (end[0] - ahead[:, 0]),
                curvatures,
            ]
        )
        miss = np.array([end[0] - x, end[1] - y, wrap_angle(end[2] - h)])
        near = np.abs(miss).max() < MISS * size
        return (miss if near else np.full(3, math.inf)), J

    found = run_gauss_newton(evaluate_miss, formula, TRIES, level=Level.GENERIC)
    if not np.abs(found.r).max() < HIT * size:
        return None
    lengths = found.x.tolist()
    return tuple((k, s) for (k, _), s in zip(way, lengths, strict=True) if abs(s) > NOTHING)


def _iterate_words(x: float, y: float, h: float) -> Iterator[Way]:
    """Iterate over the words that begin with a left arc; the numbers are those of the formulas."""
    yield from _iterate_words_to_the_left(x, y, h)
    yield from _iterate_words_to_the_right(x, y, h)


def _iterate_words_to_the_left(x: float, y: float, h: float) -> Iterator[Way]:
    """Iterate over the words whose last arc is a left one, too: the circles of both have a distance."""
    a = x - math.sin(h)
    b = y - 1.0 + math.cos(h)
    rho = math.hypot(a, b)
    direction = math.atan2(b, a)
    yield (L, direction), (S, rho), (L, wrap_angle(h - direction))  # (8.1)
    if rho <= 4.0:  # (8.3) to (8.6)
        u = -2.0 * math.asin(0.25 * rho)
        t = wrap_angle(direction + 0.5 * u + math.pi)
        yield (L, t), (R, u), (L, wrap_angle(h - t + u))
    if rho >= 2.0:  # (8.9)
        r = math.sqrt(rho * rho - 4.0)
        t = wrap_angle(direction + math.atan2(r, -2.0))
        yield (L, t), (R, -QUARTER), (S, 2.0 - r), (L, wrap_angle(h - QUARTER - t))


def _iterate_words_to_the_right(x: float, y: float, h: float) -> Iterator[Way]:
    """Iterate over the words whose last arc is a right one."""
    a = x + math.sin(h)
    b = y - 1.0 - math.cos(h)
    rho = math.hypot(a, b)
    inner = 0.25 * (2.0 + rho)
    outer = (20.0 - rho * rho) / 16.0
    if inner <= 1.0:  # (8.7)
        u = math.acos(inner)
        t, v = _compute_outer_arcs(u, -u, a, b, h)
        yield (L, t), (R, u), (L, -u), (R, v)
    if 0.0 <= outer <= 1.0:  # (8.8)
        u = -math.acos(outer)
        t, v = _compute_outer_arcs(u, u, a, b, h)
        yield (L, t), (R, u), (L, u), (R, v)
    if rho >= 2.0:
        u = math.sqrt(rho * rho - 4.0)
        t = wrap_angle(math.atan2(b, a) + math.atan2(2.0, u))
        yield (L, t), (S, u), (R, wrap_angle(t - h))  # (8.2)
        t = math.atan2(a, -b)
        yield (L, t), (R, -QUARTER), (S, 2.0 - rho), (R, wrap_angle(t + QUARTER - h))  # (8.10)
        t = wrap_angle(math.atan2(u * a - 2.0 * b, -2.0 * a - u * b))
        yield (L, t), (R, -QUARTER), (S, 4.0 - u), (L, -QUARTER), (R, wrap_angle(t - h))  # (8.11)


def _compute_outer_arcs(u: float, v: float, a: float, b: float, h: float) -> tuple[float, float]:
    """Compute the first and the last of four arcs, those in the middle being u and v."""
    d = u - v
    p = math.sin(u) - math.sin(d)
    r = math.cos(u) - math.cos(d) - 1.0
    t = math.atan2(b * p - a * r, a * p + b * r)
    if 2.0 * (math.cos(d) - math.cos(v) - math.cos(u)) + 3.0 < 0.0:
        t += math.pi
    return wrap_angle(t), wrap_angle(t - u + v - h)
