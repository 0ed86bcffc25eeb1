"""Spatial loops of four joints as branches over the first crank: rods between balls, and loops of
four turns.

The ends p and r of two cranks, or of a crank and a slide, on one body are a rod's length L apart:
|p(a) - r(b)| = L. For a crank that is A cos b + B sin b + C = 0 with A, B and C of the first degree
in cos a and sin a: b is real where D = A^2 + B^2 - C^2 >= 0 (Freudenstein, Kiss, "Type
determination of skew four-bar mechanisms", J. Eng. Ind. 91, 1969). For a slide it is a quadratic
equation. Four turns about axes through one point are such a loop, too: p and r are the directions
of the axes of the coupler, on the unit sphere; and so are four turns about parallel axes, seen
along them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.analysis.spaces.curves.branch_functions import (
    BranchFunctions,
    Function,
    within,
    within_turn,
)
from kempe.analysis.spaces.curves.loops import loop_of, pin, primitives_of
from kempe.joints import P, Q, R
from kempe.kinematics.common.enclosures import Enclosure, cos_sin
from kempe.kinematics.configuration import circles
from kempe.kinematics.measure import motion
from kempe.kinematics.one_sided import one_sided_rows
from kempe.model.kept import kept
from kempe.solvers.modes.modes import assembly_modes
from kempe.spatial import Array, inverse

if TYPE_CHECKING:
    from kempe.description.parts import Joint
    from kempe.model.system import System

SAME = 1e-12
"""Part of the size up to which points are one and directions parallel."""
NEAR = 1e-7
"""Sign of a branch, of size 1 at most, up to which it is not sure."""


class Rod(NamedTuple):
    """A rod of a `length` between p = sum (1, cos a, sin a) p[k] and r, the same of b, or r[0] + b
    r[1] on a slide.
    """

    p: Array
    r: Array
    length: float
    slides: bool


@kept
def skew_branches(system: System) -> tuple[BranchFunctions, ...] | str:
    """The branches over each crank whose neighbour is the other one, or a slide, or why there are
    none.
    """
    found = loop_of(system)
    if isinstance(found, str) or system.dim != 3:
        return found if isinstance(found, str) else "it is planar"
    bodies, names = found
    if one_sided_rows(system).declared or len(bodies) != 4:
        return "it has one-sided constraints, or other than four joints in its loop"
    out: list[BranchFunctions] = []
    for k in range(4):
        for order in ((0, 1, 2, 3), (0, -1, -2, -3)):
            at = [(k + i) % 4 for i in order]
            # joint k lies between bodies k and k + 1: going back, the bodies shift by one
            ring = [bodies[i if order[1] > 0 else (i + 1) % 4] for i in at]
            out += _over(system, ring, [system.structure.joints[names[i]] for i in at])
    return (
        tuple(out)
        or "it is not a rod between two cranks, or a crank and a slide, nor four turns of one sphere"
    )


def _over(system: System, ring: list[str], joints: list[Joint]) -> list[BranchFunctions]:
    """The branches over the first of four joints, with the last one as the other: none where they
    do not fit.
    """
    first, ball, other, last = joints
    base, crank, rod, rocker = ring
    turns = dict(zip(system.structure.velocity_names, circles(system), strict=True))
    limits = _limits(system)
    given = first.name in limits and (
        turns[first.name] or math.isfinite(np.ptp(limits[first.name]))
    )
    if not given or any(
        n != first.name and n != last.name and _limited(system, n) for n in (ball.name, other.name)
    ):
        return []
    found = _rod(system, (base, crank, rod, rocker), joints)
    if found is None or last.name not in limits:
        return []
    low, high = limits[last.name]
    if not found.slides and not turns[last.name] and not high - low < 2.0 * math.pi * (1.0 - 1e-9):
        return []
    size = max(found.length, float(np.ptp(np.concatenate([found.p, found.r]), axis=0).max()))
    walk = RodWalk(
        Rod(found.p / size, found.r / size, found.length / size, found.slides), low, high, size
    )
    ends = (0.1 - math.pi, 0.1 + math.pi + 1e-15) if turns[first.name] else limits[first.name]
    a, b = (system.coordinate_names.index(j.name) for j in (first, last))

    def signs_of(q: Array) -> Array:
        s = walk.sign(q[:, a], q[:, b])
        return np.where(np.abs(s) > NEAR, np.sign(s), 0.0)[:, None]

    def at(x: Array, signs: Array) -> Array:
        out = np.full((len(x), system.nq), np.nan)
        for i, (value, sign) in enumerate(zip(x, signs, strict=True)):
            q = assembly_modes(system, {first.name: value}).q
            same = q[signs_of(q)[:, 0] * sign[0] >= 0.0]
            out[i] = same[0] if len(same) else np.nan
        return out

    return [
        BranchFunctions(system, first.name, *ends, bool(turns[first.name]), 1, walk, at, signs_of)
    ]


def _limits(system: System) -> dict[str, tuple[float, float]]:
    """Limits of each coordinate that is alone in its joint."""
    own = {*system.coordinate_names}
    return {
        n: (float(a), float(b))
        for n, (a, b) in zip(system.structure.velocity_names, system.structure.limits, strict=True)
        if n in own
    }


def _limited(system: System, joint: str) -> bool:
    """Whether a joint has limits of any kind."""
    return any(n == joint or n.startswith(f"{joint}.") for n in one_sided_rows(system).names)


def _rod(system: System, ring: tuple[str, ...], joints: list[Joint]) -> Rod | None:
    """The rod, between points, between directions of axes through one point, or between parallel
    axes.
    """
    base, crank, rod, rocker = ring
    first, ball, other, last = joints
    kinds = [[p.kind for p in primitives_of(system, j)] for j in joints]
    if kinds[0] != [R] or kinds[3] not in ([R], [P]):
        return None
    ends = pin(system, ball, crank)[0], pin(system, other, rocker)[0]
    if kinds[1:3] == [[Q], [Q]]:
        length = float(np.linalg.norm(pin(system, ball, rod)[0] - pin(system, other, rod)[0]))
        p = _curve(system, first, base, crank, ends[0], 1.0)
        r = _curve(system, last, base, rocker, ends[1], 1.0)
        return Rod(p, r, length, kinds[3] == [P])
    if kinds[1:] != [[R], [R], [R]]:
        return None
    axes = {
        (joints[k].name, b): _axis(system, joints[k], b)
        for k in range(4)
        for b in (ring[k], ring[(k + 1) % 4])
    }
    pairs = [[axes[joints[k - 1].name, b], axes[joints[k].name, b]] for k, b in enumerate(ring)]
    (_, u) = axes[ball.name, crank]
    (_, v) = axes[other.name, rocker]
    if _concurrent(pairs):
        length = float(np.linalg.norm(axes[ball.name, rod][1] - axes[other.name, rod][1]))
        p = _curve(system, first, base, crank, u, 0.0)
        r = _curve(system, last, base, rocker, v, 0.0)
        return Rod(p, r, length, False) if SAME < 0.25 * length**2 < 1.0 - SAME else None
    if not _parallel(pairs):
        return None
    n = axes[first.name, base][1]
    (x, _) = axes[ball.name, rod]
    (y, m) = axes[other.name, rod]
    length = float(np.linalg.norm((y - x) - m * (m @ (y - x))))
    p = _curve(system, first, base, crank, ends[0], 1.0)
    r = _curve(system, last, base, rocker, ends[1], 1.0)
    return Rod(p - (p @ n)[:, None] * n, r - (r @ n)[:, None] * n, length, False)


def _curve(
    system: System, joint: Joint, base: str, crank: str, point: Array, weight: float
) -> Array:
    """Coefficients of 1, cos and sin, or of 1 and the slide, of a point (or, of weight 0, a
    direction) on a crank, seen from the base.
    """
    F = joint.X_PF.evaluate(system.mechanism.parameters)
    M = joint.X_CM.evaluate(system.mechanism.parameters)
    turns = primitives_of(system, joint)[0].kind == R
    at = 2.0 * np.pi / 3.0 * np.arange(3.0) if turns else np.array([0.0, 1.0])
    X = F @ motion(primitives_of(system, joint), at[:, None]) @ inverse(M)
    X = X if joint.parent == base else inverse(X)
    wave = (
        np.stack([np.ones(3), np.cos(at), np.sin(at)], axis=1)
        if turns
        else np.array([[1.0, 0.0], [1.0, 1.0]])
    )
    return np.asarray(np.linalg.solve(wave, (X @ np.append(point, weight))[:, :3]), dtype=float)


def _axis(system: System, joint: Joint, body: str) -> tuple[Array, Array]:
    """A point and the direction of the axis of a turn, in the axes of one of its bodies."""
    X = pin(system, joint, body)[1]
    return X[:3, 3], X[:3, "xyz".index(primitives_of(system, joint)[0].axis)]


Axis = tuple[Array, Array]


def _concurrent(pairs: list[list[Axis]]) -> bool:
    """Whether the axes of each body (of joint k - 1 and k, by body) meet, and each is met at one
    place from both.
    """
    places: list[tuple[float, float]] = []
    for (x, u), (y, v) in pairs:
        c = float(u @ v)
        w = y - x
        det = 1.0 - c * c
        if det < SAME:
            return False
        s = float(w @ (u - c * v)) / det
        t = float(w @ (c * u - v)) / det
        if np.linalg.norm(x + s * u - y - t * v) > SAME * (1.0 + np.linalg.norm(w)):
            return False
        places.append((s, t))
    size = 1.0 + max(abs(x) for two in places for x in two)
    return all(abs(places[k][1] - places[(k + 1) % 4][0]) < SAME * size for k in range(4))


def _parallel(pairs: list[list[Axis]]) -> bool:
    """Whether the axes of each body are parallel, and the steps along them add up to nothing."""
    step = 0.0
    sense = 1.0
    size = 1.0
    for (x, u), (y, v) in pairs:
        if np.linalg.norm(np.cross(u, v)) > SAME:
            return False
        step = step + sense * float(u @ (y - x))
        sense = sense * float(u @ v)
        size = size + float(np.linalg.norm(y - x))
    return abs(step) < SAME * size and sense > 0.0


class RodWalk:
    """The functions of a rod between two cranks, or a crank and a slide from `low` to `high`."""

    def __init__(self, rod: Rod, low: float, high: float, size: float):
        self.rod = rod
        self.low = low
        self.high = high
        self.size = size

    def __call__(self, x: Enclosure, signs: Array) -> list[Function]:
        """What is positive where the branches with these signs (n, 1) exist, on intervals of the
        crank's angle.
        """
        p, r, length, slides = self.rod
        c, s = cos_sin(x)
        way = [c * p[1, i] + s * p[2, i] + (p[0, i] - r[0, i]) for i in range(3)]
        far = way[0] * way[0] + way[1] * way[1] + way[2] * way[2]
        if slides:
            along = way[0] * r[1, 0] + way[1] * r[1, 1] + way[2] * r[1, 2]
            size = float(r[1] @ r[1])
            D = along * along - (far - length**2) * size
            return [
                (D, 0),
                *within((along + D.root() * signs[:, 0]) * (1.0 / size), self.low, self.high),
            ]
        A, B = ((way[0] * r[k, 0] + way[1] * r[k, 1] + way[2] * r[k, 2]) * -2.0 for k in (1, 2))
        C = far + (float(r[1] @ r[1]) - length**2)
        square = A * A + B * B
        D = square - C * C
        if not (math.isfinite(self.low) or math.isfinite(self.high)):
            return [(D, 0)]
        high = D.root() * signs[:, 0]
        angle = -(C * A + B * high) / square, -(C * B - A * high) / square
        return [(D, 0), *within_turn(angle, self.low, self.high)]

    def sign(self, a: Array, b: Array) -> Array:
        """The sign of the branch (n,) on which two angles, or an angle and a slide, are; as a size
        up to about 1.
        """
        p, r, _, slides = self.rod
        way = np.stack([np.ones_like(a), np.cos(a), np.sin(a)], axis=1) @ p - r[0]
        if slides:
            return b * math.sqrt(float(r[1] @ r[1])) - (way @ r[1]) / math.sqrt(float(r[1] @ r[1]))
        A, B = (way @ r[k] * -2.0 for k in (1, 2))
        return (A * np.sin(b) - B * np.cos(b)) / np.maximum(np.hypot(A, B), 1e-300)
