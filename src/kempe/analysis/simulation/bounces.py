"""One ball or particle that falls and bounces between planes: parabolas in closed form, and what happens between them.

The centre moves in a flat space of slides, on which an acceleration acts that does not depend on the mass. Planes are
smooth and push along their normals only: an impact reverses the normal speed times the restitution (Newton), in a
corner by Moreau's law, v' = -e v + (1 + e) proj(v) with the projection on the velocities that no touched plane
forbids; so no mass is needed. Bounces on one plane that get smaller and smaller end at a time that is the sum of a
geometric series: from there on the ball rests on the plane, or slides. Sources: Moreau, *Unilateral contact and dry
friction in finite freedom dynamics*, 1988; Brogliato, *Nonsmooth Mechanics*, 2016.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kempe.spatial import Array

FADED = 1e-9
"""Part of the largest impact speed below which bounces on one plane count as the rest of their geometric series."""
GONE = 1e-11
"""Part of it below which a normal speed counts as none: what falls through the rounding of places gets that fast."""
ROUNDING = 4e-15
"""Part of the distances from the origin up to which a gap is rounding."""
TOUCH = 1e-9
"""Gap [m] below which a start touches a plane; more inside it is refused."""
SAME_TIME = 1e-13
"""Part of the time to an impact within which others happen at the same time."""
AGAIN = 64
"""Impacts at one instant after which the rest of them is taken as without rebound."""
MOST = 100_000
"""Events after which it is broken off."""


class Plane(NamedTuple):
    """A plane that the centre stays above: gap = `offset` + `normal` . y; `name` is that of the contact or limit."""

    name: str
    normal: Array
    offset: float


class Impact(NamedTuple):
    """What happened: "bounce", "lands" (and stays) or "settles" (after infinitely many bounces), on which planes.

    `before` and `after` are rates of the gap [m/s], of the plane that was hit hardest.
    """

    kind: str
    time: float
    planes: tuple[int, ...]
    before: float
    after: float
    y: Array
    v: Array


class Parabola(NamedTuple):
    """A parabola: from `time` on the place is y + v s + a s^2 / 2, with s the time since then."""

    time: float
    y: Array
    v: Array
    a: Array


class Flight:
    """The motion of the centre in coordinates (k,) that have the metric of space, above `planes`."""

    def __init__(self, planes: Sequence[Plane], gravity: Array, restitution: float):
        self.planes, self.gravity, self.restitution = planes, gravity, restitution
        self.N = np.array([p.normal for p in planes]).reshape(len(planes), len(gravity))
        self.offsets = np.array([p.offset for p in planes])
        self.arcs: list[Parabola] = []
        self.impacts: list[Impact] = []
        self.broken, self._largest = False, 0.0

    def gaps(self, y: Array) -> Array:
        """How far (m,) a place (k,) is above each plane."""
        return self.N @ y + self.offsets

    def run(self, y: Array, v: Array, duration: float) -> None:
        """Compute arcs and impacts from a place and a velocity (k,) on, for a duration [s]."""
        time, again = 0.0, 0
        touching = set(np.flatnonzero(self.gaps(y) <= TOUCH).tolist())
        while True:
            v = self._impact(time, y, v, touching, again > AGAIN)
            v, a, held = self._pressed(v, touching)
            self.arcs.append(Parabola(time, y, v, a))
            step, hit = self._next(y, v, a, touching, held)
            settling = self._settling(y, v, a, touching - held, held)
            if settling is not None and time + settling[0] < duration:
                rest, i, tangent, pull = settling
                self.arcs[-1] = Parabola(time, y, tangent, pull)
                y, v = y + rest * (tangent + 0.5 * rest * pull), tangent + rest * pull
                time, touching = time + rest, self._touched(y, held | {i})
                self.impacts.append(Impact("settles", time, (i,), 0.0, 0.0, y, v))
            elif not time + step < duration or len(self.impacts) >= MOST:
                self.broken = time + step < duration
                return
            else:
                again = again + 1 if step <= 0.0 else 0
                time, y, v = time + step, y + step * (v + 0.5 * step * a), v + step * a
                y = self._onto(y, hit | held)
                touching = self._touched(y, hit | held)

    def at(self, t: Array) -> tuple[Array, Array]:
        """Places and velocities (n, k) at times (n,)."""
        starts = np.array([arc.time for arc in self.arcs])
        k = np.clip(np.searchsorted(starts, t, side="right") - 1, 0, len(starts) - 1)
        y, v, a = (np.array([getattr(arc, name) for arc in self.arcs])[k] for name in "yva")
        s = (t - starts[k])[:, None]
        return y + s * (v + 0.5 * s * a), v + s * a

    def _impact(self, time: float, y: Array, v: Array, touching: set[int], soft: bool) -> Array:
        """The velocity after what it makes hit; `soft` impacts have no rebound."""
        index = sorted(touching)
        N = self.N[index]
        for k in range(AGAIN + 1):
            rates = N @ v
            self._largest = max(self._largest, float(np.linalg.norm(v)))
            size = GONE * self._largest * np.linalg.norm(N, axis=1)
            if not (rates < -size).any():
                return v
            e = 0.0 if soft or k == AGAIN else self.restitution
            after = -e * v + (1.0 + e) * nearest_in_cone(v, N)
            worst = int(np.argmin(rates))
            rebound = float(N[worst] @ after)
            rebound = rebound if rebound > size[worst] else 0.0
            kind = "bounce" if rebound else "lands"
            planes = tuple(index[i] for i in np.flatnonzero(rates < -size))
            self.impacts.append(Impact(kind, time, planes, float(rates[worst]), rebound, y, after))
            v = after
        return v

    def _pressed(self, v: Array, touching: set[int]) -> tuple[Array, Array, set[int]]:
        """The velocity without rounding, the acceleration, and the planes that stay touched."""
        slow = GONE * self._largest
        still = [i for i in sorted(touching) if self.N[i] @ v <= slow * np.linalg.norm(self.N[i])]
        a = nearest_in_cone(self.gravity, self.N[still])
        strength = 1e-12 * float(np.linalg.norm(self.gravity))
        held = {i for i in still if self.N[i] @ a <= strength * np.linalg.norm(self.N[i])}
        flat = self.N[sorted(held)]
        if len(flat):
            v, a = v - np.linalg.pinv(flat) @ (flat @ v), a - np.linalg.pinv(flat) @ (flat @ a)
            a = np.where(np.linalg.norm(a) <= strength, 0.0, a)
            v = np.where(np.linalg.norm(v) <= slow and not a.any(), 0.0, v)
        return v, a, held

    def _next(self, y: Array, v: Array, a: Array, touching: set[int], held: set[int]) -> tuple[float, set[int]]:
        """The time to the next impact, infinite where there is none, and its planes."""
        gaps = self.gaps(y)
        times: dict[int, float] = {}
        for i in range(len(self.planes)):
            if i not in held:
                gap = 0.0 if i in touching else max(float(gaps[i]), 0.0)
                times[i] = first_zero(gap, float(self.N[i] @ v), float(self.N[i] @ a))
        step = min(times.values(), default=math.inf)
        return step, {i for i, t in times.items() if t <= step * (1.0 + SAME_TIME)}

    def _settling(
        self, y: Array, v: Array, a: Array, leaving: set[int], held: set[int]
    ) -> tuple[float, int, Array, Array] | None:  # fmt: skip
        """Where bounces on one plane get small: the time in which they end, the plane, and the motion along it."""
        hops = [i for i in leaving if self.N[i] @ a < 0.0]
        if len(hops) != 1 or self.restitution >= 1.0:
            return None
        n = self.N[hops[0]]
        rate, pull = float(n @ v), -float(n @ a)
        small = rate < FADED * self._largest * np.linalg.norm(n)
        if not small or any(abs(self.N[j] @ n) > 1e-12 * np.linalg.norm(self.N[j]) * np.linalg.norm(n) for j in held):
            return None
        rest = 2.0 * rate / (pull * (1.0 - self.restitution))
        tangent, along = v - n * (rate / (n @ n)), a + n * (pull / (n @ n))
        others = set(range(len(self.planes))) - held - set(hops)
        gaps = self.gaps(y)
        for j in others:
            if first_zero(max(float(gaps[j]), 0.0), float(self.N[j] @ tangent), float(self.N[j] @ along)) <= rest:
                return None
        return rest, hops[0], tangent, along

    def _touched(self, y: Array, known: set[int]) -> set[int]:
        """The planes that a place touches, or is above only by rounding."""
        rounding = ROUNDING * (np.abs(self.N) @ np.abs(y) + np.abs(self.offsets))
        return known | set(np.flatnonzero(self.gaps(y) <= rounding).tolist())

    def _onto(self, y: Array, touching: set[int]) -> Array:
        """The place (k,) put onto planes that it touches but for rounding."""
        index = sorted(touching)
        return y - np.linalg.pinv(self.N[index]) @ self.gaps(y)[index] if index else y


def first_zero(gap: float, rate: float, acceleration: float) -> float:
    """The first time at which a gap, not negative now, falls through zero; infinite where it does not.

    A gap of zero that opens counts when it closes again. By the form of the roots that does not cancel.
    """
    if gap <= 0.0:
        if rate > 0.0:
            return -2.0 * rate / acceleration if acceleration < 0.0 else math.inf
        return 0.0 if rate < 0.0 or acceleration < 0.0 else math.inf
    square = rate * rate - 2.0 * acceleration * gap
    if acceleration == 0.0:
        return -gap / rate if rate < 0.0 else math.inf
    if square <= 0.0 or (rate >= 0.0 and acceleration > 0.0):
        return math.inf
    root = math.sqrt(square)
    return 2.0 * gap / (root - rate) if rate < 0.0 else (rate + root) / -acceleration


def nearest_in_cone(v: Array, N: Array) -> Array:
    """The vector nearest to v (k,) of those with N x >= 0, N (m, k): by the sets of planes that may hold it back."""
    size = float(np.linalg.norm(v))
    lengths = np.linalg.norm(N, axis=1)
    if not size or not (N @ v < 0.0).any():
        return v
    unit = N / lengths[:, None]
    for count in range(1, len(v) + 1):
        for some in itertools.combinations(range(len(N)), count):
            A: Array = unit[list(some)]
            if np.linalg.svd(A, compute_uv=False)[-1] < 1e-9:
                continue
            push = np.linalg.solve(A @ A.T, -A @ v)
            x = v + A.T @ push
            if (push >= -1e-15 * size).all() and (unit @ x >= -1e-13 * size).all():
                return x
    return np.zeros(len(v))
