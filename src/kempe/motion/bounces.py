"""Flights and bounces of one ball or particle between planes, which may move.

Flights are parabolas in closed form. Planes are smooth, and an impact reverses the normal speed
times the restitution; masses are not needed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol, cast

import numpy as np

from kempe.budget import check_for_stop
from kempe.numerics.clock import TimeLimit
from kempe.numerics.rank import Level, Spectrum
from kempe.numerics.roots import find_sign_change
from kempe.spatial import Array

# ---- laws of flights and impacts

# The centre moves in a flat space of slides, on which an acceleration acts that does not depend on
# the mass. Planes push along their normals only: an impact reverses the normal speed times the
# restitution (Newton), in a corner by Moreau's law, v' = -e v + (1 + e) proj(v) with the projection
# on the velocities that no touched plane forbids; so no mass is needed. Bounces on one plane that
# get smaller and smaller end at a time that is the sum of a geometric series: from there on the
# ball rests on the plane, or slides. Sources: Moreau, *Unilateral contact and dry friction in
# finite freedom dynamics*, 1988; Brogliato, *Nonsmooth Mechanics*, 2016.

FADED = 1e-9
"""Part of the largest impact speed below which bounces on one plane count as the rest of their
geometric series."""
GONE = 1e-11
"""Part of it below which a normal speed counts as none: what falls through the rounding of places
gets that fast."""
ROUNDING = 4e-15
"""Part of the distances from the origin up to which a gap is rounding."""
TOUCH = 1e-9
"""Gap [m] below which a start touches a plane; more inside it is refused."""
SAME_TIME = 1e-13
"""Part of the time to an impact within which others happen at the same time."""
AGAIN = 64
"""Impacts at one instant after which the rest of them is taken as without rebound."""
FADED_MOVING = 1e-6
"""As `FADED`, on planes that move: the place of such a plane is known to rounding only, and so are
low hops."""
WINDOWS = 64
"""Parts of the duration, at least, in which impacts on moving planes are looked for."""
LOOKS = 16
"""Places in such a part at which gaps and their rates are evaluated."""
INTEGRATION = 1e-12
"""Local error of the motion along moving planes."""
MOST = 100_000
"""Events after which it is broken off."""


class Plane(NamedTuple):
    """A plane above which the centre stays: gap = `offset` + `normal` . y.

    `name` is that of the contact or limit.
    """

    name: str
    normal: Array
    offset: float


class Impact(NamedTuple):
    """An event of a flight: "bounce", "lands", "settles" or "leaves", on the `planes`.

    What lands stays on the plane; what settles does so after infinitely many bounces.

    `planes` says which.

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
    """An arc of a flight: y + v s + a s^2 / 2 at the time s in seconds after `time`."""

    time: float
    y: Array
    v: Array
    a: Array


class MovingPlanes(Protocol):
    """Planes that move and turn by a law of time: gap = `normals` . y + `offsets`."""

    names: tuple[str, ...]

    def evaluate_planes(self, t: Array | float) -> tuple[Array, Array]:
        """Return the normals (..., m, k) and offsets (..., m) at times (...)."""
        ...

    def evaluate_rates(self, t: Array | float) -> tuple[Array, Array]:
        """Return the rates of normals (..., m, k) and offsets (..., m) at times (...)."""
        ...

    def evaluate_accelerations(self, t: float) -> tuple[Array, Array]:
        """Return the second derivatives of normals (m, k) and offsets (m,) at a time."""
        ...


class Flight:
    """The motion of a centre above `planes`, in coordinates (k,) that have the metric of space."""

    def __init__(self, planes: Sequence[Plane], gravity: Array, restitution: float):
        self.planes = planes
        self.gravity = gravity
        self.restitution = restitution
        self.N = np.array([p.normal for p in planes]).reshape(len(planes), len(gravity))
        self.offsets = np.array([p.offset for p in planes])
        self.arcs: list[Parabola] = []
        self.impacts: list[Impact] = []
        self.broken = False
        self._largest = 0.0
        self.known = 0.0

    def compute_gaps(self, y: Array) -> Array:
        """Compute the height (m,) in metres of a place (k,) above each plane."""
        return self.N @ y + self.offsets

    def compute_flight(self, y: Array, v: Array, duration: float) -> None:
        """Compute the arcs and impacts that begin at a place and a velocity (k,).

        They last for a duration [s]; `known` is the time up to which they are computed.
        """
        time = 0.0
        again = 0
        touching = set(np.flatnonzero(self.compute_gaps(y) <= TOUCH).tolist())
        while True:
            v = self._apply_impact(time, y, v, touching, again > AGAIN)
            v, a, held = self._settle_contacts(v, touching)
            self.arcs.append(Parabola(time, y, v, a))
            self.known = time
            check_for_stop()
            step, hit = self._find_next_impact(y, v, a, touching, held)
            settling = self._find_last_bounce(y, v, a, touching - held, held)
            if settling is not None and time + settling[0] < duration:
                rest, i, tangent, pull = settling
                self.arcs[-1] = Parabola(time, y, tangent, pull)
                y = y + rest * (tangent + 0.5 * rest * pull)
                v = tangent + rest * pull
                time = time + rest
                touching = self._find_touched_planes(y, held | {i})
                self.impacts.append(Impact("settles", time, (i,), 0.0, 0.0, y, v))
            elif not time + step < duration or len(self.impacts) >= MOST:
                self.broken = time + step < duration
                return
            else:
                again = again + 1 if step <= 0.0 else 0
                time = time + step
                y = y + step * (v + 0.5 * step * a)
                v = v + step * a
                y = self._project_onto_planes(y, hit | held)
                touching = self._find_touched_planes(y, hit | held)

    def evaluate_flight(self, t: Array) -> tuple[Array, Array]:
        """Return places and velocities (n, k) at times (n,)."""
        starts = np.array([arc.time for arc in self.arcs])
        k = np.clip(np.searchsorted(starts, t, side="right") - 1, 0, len(starts) - 1)
        y, v, a = (np.array([getattr(arc, name) for arc in self.arcs])[k] for name in "yva")
        s = (t - starts[k])[:, None]
        return y + s * (v + 0.5 * s * a), v + s * a

    def _apply_impact(
        self, time: float, y: Array, v: Array, touching: set[int], soft: bool
    ) -> Array:
        """Return the velocity (k,) after impacts on touched planes; `soft` impacts have no rebound."""
        index = sorted(touching)
        N = self.N[index]
        for k in range(AGAIN + 1):
            rates = N @ v
            self._largest = max(self._largest, float(np.linalg.norm(v)))
            size = GONE * self._largest * np.linalg.norm(N, axis=1)
            if not (rates < -size).any():
                return v
            e = 0.0 if soft or k == AGAIN else self.restitution
            after = -e * v + (1.0 + e) * project_onto_cone(v, N)
            worst = int(np.argmin(rates))
            rebound = float(N[worst] @ after)
            rebound = rebound if rebound > size[worst] else 0.0
            kind = "bounce" if rebound else "lands"
            planes = tuple(index[i] for i in np.flatnonzero(rates < -size))
            self.impacts.append(Impact(kind, time, planes, float(rates[worst]), rebound, y, after))
            v = after
        return v

    def _settle_contacts(self, v: Array, touching: set[int]) -> tuple[Array, Array, set[int]]:
        """Return the velocity without rounding, the acceleration, and the planes that stay touched."""
        slow = GONE * self._largest
        still = [i for i in sorted(touching) if self.N[i] @ v <= slow * np.linalg.norm(self.N[i])]
        a = project_onto_cone(self.gravity, self.N[still])
        strength = 1e-12 * float(np.linalg.norm(self.gravity))
        held = {i for i in still if self.N[i] @ a <= strength * np.linalg.norm(self.N[i])}
        flat = self.N[sorted(held)]
        if len(flat):
            back = Spectrum(flat).compute_pseudo_inverse(Level.ROUNDING)
            v = v - back @ (flat @ v)
            a = a - back @ (flat @ a)
            a = np.where(np.linalg.norm(a) <= strength, 0.0, a)
            v = np.where(np.linalg.norm(v) <= slow and not a.any(), 0.0, v)
        return v, a, held

    def _find_next_impact(
        self, y: Array, v: Array, a: Array, touching: set[int], held: set[int]
    ) -> tuple[float, set[int]]:
        """Find the time to the next impact and its planes; it is infinite where there is none."""
        gaps = self.compute_gaps(y)
        times: dict[int, float] = {}
        for i in range(len(self.planes)):
            if i not in held:
                gap = 0.0 if i in touching else max(float(gaps[i]), 0.0)
                times[i] = find_first_zero(gap, float(self.N[i] @ v), float(self.N[i] @ a))
        step = min(times.values(), default=math.inf)
        return step, {i for i, t in times.items() if t <= step * (1.0 + SAME_TIME)}

    def _find_last_bounce(
        self, y: Array, v: Array, a: Array, leaving: set[int], held: set[int]
    ) -> tuple[float, int, Array, Array] | None:
        """Find the end of ever smaller bounces on one plane.

        Returned are the time until then, the plane, and velocity and acceleration along it.
        """
        hops = [i for i in leaving if self.N[i] @ a < 0.0]
        if len(hops) != 1 or self.restitution >= 1.0:
            return None
        n = self.N[hops[0]]
        rate = float(n @ v)
        pull = -float(n @ a)
        small = rate < FADED * self._largest * np.linalg.norm(n)
        if not small or any(
            abs(self.N[j] @ n) > 1e-12 * np.linalg.norm(self.N[j]) * np.linalg.norm(n) for j in held
        ):
            return None
        rest = 2.0 * rate / (pull * (1.0 - self.restitution))
        tangent = v - n * (rate / (n @ n))
        along = a + n * (pull / (n @ n))
        others = set(range(len(self.planes))) - held - set(hops)
        gaps = self.compute_gaps(y)
        for j in others:
            if (
                find_first_zero(
                    max(float(gaps[j]), 0.0), float(self.N[j] @ tangent), float(self.N[j] @ along)
                )
                <= rest
            ):
                return None
        return rest, hops[0], tangent, along

    def _find_touched_planes(self, y: Array, known: set[int]) -> set[int]:
        """Return the planes that a place touches, or is above only by rounding."""
        rounding = ROUNDING * (np.abs(self.N) @ np.abs(y) + np.abs(self.offsets))
        return known | set(np.flatnonzero(self.compute_gaps(y) <= rounding).tolist())

    def _project_onto_planes(self, y: Array, touching: set[int]) -> Array:
        """Return the place (k,) moved onto planes that it touches up to rounding."""
        index = sorted(touching)
        if not index:
            return y
        return (
            y
            - Spectrum(self.N[index]).compute_pseudo_inverse(Level.ROUNDING)
            @ self.compute_gaps(y)[index]
        )


def find_first_zero(gap: float, rate: float, acceleration: float) -> float:
    """Find the first time at which a gap, not negative now, falls through zero.

    The time is infinite where there is none.

    A gap of zero that opens counts when it closes again. By the form of the roots that does not
    cancel.
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


def project_onto_cone(v: Array, N: Array) -> Array:
    """Return the vector nearest to v (k,) among those with N x >= 0, N (m, k)."""
    found = project_onto_half_spaces(v, N, np.zeros(len(N)))
    return np.zeros(len(v)) if found is None else found


def project_onto_half_spaces(v: Array, N: Array, w: Array) -> Array | None:
    """Return the vector nearest to v (k,) among those with N x + w >= 0, N (m, k).

    All sets of planes that may hold it back are tried.

    None where there is no such vector.
    """
    lengths = np.linalg.norm(N, axis=1)
    if not (N @ v + w < 0.0).any():
        return v
    if not lengths.all():
        return None
    unit = N / lengths[:, None]
    w = w / lengths
    size = float(np.linalg.norm(v)) + float(np.abs(w).max())
    for count in range(1, len(v) + 1):
        for some in itertools.combinations(range(len(N)), count):
            A: Array = unit[list(some)]
            if Spectrum(A, 1.0).compute_rank(Level.CLOSED) < count:
                continue
            push = np.linalg.solve(A @ A.T, -A @ v - w[list(some)])
            x = v + A.T @ push
            if (push >= -1e-15 * size).all() and (unit @ x + w >= -1e-13 * size).all():
                return x
    return None


class Stretch(NamedTuple):
    """A part of a motion that begins at `time`; `held` are the touched planes.

    `at` gives places and velocities (n, k) at times (n,).
    """

    time: float
    at: Callable[[Array], tuple[Array, Array]]
    held: tuple[int, ...]


class MovingFlight:
    """The motion of a centre above moving planes, in coordinates (k,) with the metric of space.

    Between impacts it is a parabola, along planes that are touched a motion that they push along
    their normals (integrated). An impact reverses the rate of the gap, times the restitution: v' =
    -e v + (1 + e) x, with x the velocity nearest to v that closes no touched gap. The times of
    impacts are zeros of gaps, looked for at `LOOKS` places of `WINDOWS` parts of the duration and
    between the extremes there: a gap that closes and opens again twice within one such step is not
    seen.
    """

    def __init__(self, planes: MovingPlanes, gravity: Array, restitution: float, time: TimeLimit):
        self.planes = planes
        self.gravity = gravity
        self.restitution = restitution
        self.budget = time
        self.stretches: list[Stretch] = []
        self.impacts: list[Impact] = []
        self.reason = ""
        self.known = 0.0
        self._largest = 0.0

    def compute_flight(self, y: Array, v: Array, duration: float) -> None:
        """Compute the stretches and impacts that begin at a place and a velocity (k,).

        They last for a duration [s].
        """
        t = 0.0
        again = 0
        leaving = set[int]()
        touching = set(np.flatnonzero(self._compute_gaps(0.0, y) <= TOUCH).tolist())
        while t < duration:
            self.budget.check_time()
            self.known = t
            after = self._apply_impact(t, y, v, touching, again > AGAIN)
            if after is None or len(self.impacts) >= MOST:
                closing = " and ".join(repr(self.planes.names[i]) for i in sorted(touching))
                self.reason = (
                    f"at {t:.10g} s {closing} leave it no room"
                    if after is None
                    else f"broken off after {MOST} events"
                )
                return
            v, held = self._settle_contacts(t, y, after, touching - leaving)
            rest = self._find_last_bounce(t, y, v, touching - held - leaving, held)
            if rest is not None and t + rest[0] < duration:
                touching = held | {rest[1]}
                self.stretches.append(
                    Stretch(
                        t, partial(_evaluate_parabola, t, y, v, 0.0 * v), tuple(sorted(touching))
                    )
                )
                t = t + rest[0]
                y, v = self._project_onto_planes(t, y + rest[0] * v, v, touching)
                self.impacts.append(Impact("settles", t, (rest[1],), 0.0, 0.0, y, v))
                continue
            before = t
            t, y, v, hit, leaving = self._advance_to_event(t, y, v, touching, held, duration)
            again = again + 1 if t - before <= SAME_TIME * duration else 0
            if again > 2 * AGAIN:
                self.reason = f"from {t:.10g} s on one impact follows the other at once"
                return
            y, v = self._project_onto_planes(t, y, v, hit | held, places_only=True)
            touching = self._find_touched_planes(t, y, hit | held)
        self.known = duration

    def evaluate_flight(self, t: Array) -> tuple[Array, Array]:
        """Return places and velocities (n, k) at times (n,) up to `known`."""
        starts = np.array([s.time for s in self.stretches])
        which = np.clip(np.searchsorted(starts, t, side="right") - 1, 0, len(starts) - 1)
        y = np.empty((len(t), len(self.gravity)))
        v = np.empty((len(t), len(self.gravity)))
        for k, stretch in enumerate(self.stretches):
            some = which == k
            if not some.any():
                continue
            y[some], v[some] = stretch.at(t[some])
            for i in np.flatnonzero(some) if stretch.held else ():
                y[i], v[i] = self._project_onto_planes(float(t[i]), y[i], v[i], set(stretch.held))
        return y, v

    # ---- gaps

    def _compute_gaps(self, t: Array | float, y: Array) -> Array:
        """Compute the gaps (..., m) at times (...) and places (..., k), in metres."""
        N, o = self.planes.evaluate_planes(t)
        return (N @ y[..., None])[..., 0] + o

    def _compute_gap_rates(self, t: Array | float, y: Array, v: Array) -> tuple[Array, Array]:
        """Compute the normals (..., m, k) and the rates (..., m) of the gaps.

        They are taken at times (...), places and velocities (..., k).
        """
        N, _ = self.planes.evaluate_planes(t)
        turn, shift = self.planes.evaluate_rates(t)
        return N, (N @ v[..., None] + turn @ y[..., None])[..., 0] + shift

    def _compute_gap_accelerations(self, t: float, y: Array, v: Array) -> Array:
        """Compute the second derivatives (m,) of the gaps where the centre does not accelerate."""
        turn, _ = self.planes.evaluate_rates(t)
        more, shift = self.planes.evaluate_accelerations(t)
        return 2.0 * turn @ v + more @ y + shift

    def _project_onto_planes(
        self, t: float, y: Array, v: Array, planes: set[int], places_only: bool = False
    ) -> tuple[Array, Array]:
        """Return place and velocity (k,) moved onto planes that are touched up to rounding."""
        index = sorted(planes)
        if not index:
            return y, v
        N, o = self.planes.evaluate_planes(t)
        back = Spectrum(N[index]).compute_pseudo_inverse(Level.ROUNDING)
        y = y - back @ (N[index] @ y + o[index])
        return y, v if places_only else v - back @ self._compute_gap_rates(t, y, v)[1][index]

    def _find_touched_planes(self, t: float, y: Array, known: set[int]) -> set[int]:
        """Return the planes that a place touches, or is above only by rounding."""
        N, o = self.planes.evaluate_planes(t)
        rounding = ROUNDING * (np.abs(N) @ np.abs(y) + np.abs(o))
        return known | set(np.flatnonzero(N @ y + o <= rounding).tolist())

    # ---- what happens at an instant

    def _apply_impact(
        self, t: float, y: Array, v: Array, touching: set[int], soft: bool
    ) -> Array | None:
        """Return the velocity (k,) after impacts on touched planes; `soft` impacts have no rebound.

        It is None where no velocity opens all gaps.
        """
        index = sorted(touching)
        for k in range(AGAIN + 1):
            N, rates = (x[index] for x in self._compute_gap_rates(t, y, v))
            self._largest = max(
                self._largest, float(np.linalg.norm(v)), float(np.abs(rates).max(initial=0.0))
            )
            size = GONE * self._largest * np.linalg.norm(N, axis=1)
            if not (rates < -size).any():
                return v
            nearest = project_onto_half_spaces(v, N, rates - N @ v)
            if nearest is None:
                return None
            e = 0.0 if soft or k == AGAIN else self.restitution
            after = -e * v + (1.0 + e) * nearest
            worst = int(np.argmin(rates))
            rebound = float((rates + N @ (after - v))[worst])
            rebound = rebound if rebound > size[worst] else 0.0
            planes = tuple(index[i] for i in np.flatnonzero(rates < -size))
            kind = "bounce" if rebound else "lands"
            self.impacts.append(Impact(kind, t, planes, float(rates[worst]), rebound, y, after))
            v = after
        return v

    def _settle_contacts(
        self, t: float, y: Array, v: Array, touching: set[int]
    ) -> tuple[Array, set[int]]:
        """Return the velocity without rounding, and the planes that stay touched."""
        N, rates = self._compute_gap_rates(t, y, v)
        lengths = np.linalg.norm(N, axis=1)
        still = [i for i in sorted(touching) if rates[i] <= 1e2 * GONE * self._largest * lengths[i]]
        _, held = self._solve_acceleration(t, y, v, still)
        return self._project_onto_planes(t, y, v, held)[1], held

    def _solve_acceleration(
        self, t: float, y: Array, v: Array, still: list[int]
    ) -> tuple[Array, set[int]]:
        """Solve the acceleration (k,) on planes that are touched at no rate.

        Those of them that stay touched are returned, too.
        """
        N = self.planes.evaluate_planes(t)[0][still]
        c = self._compute_gap_accelerations(t, y, v)[still]
        a = project_onto_half_spaces(self.gravity, N, c)
        if a is None:
            a = self.gravity - Spectrum(N).compute_pseudo_inverse(Level.ROUNDING) @ (
                N @ self.gravity + c
            )
        strength = 1e-9 * (float(np.linalg.norm(self.gravity)) + np.abs(c))
        return a, {
            i
            for i, x in zip(still, N @ a + c - strength * np.linalg.norm(N, axis=1), strict=True)
            if x <= 0.0
        }

    def _find_last_bounce(
        self, t: float, y: Array, v: Array, leaving: set[int], held: set[int]
    ) -> tuple[float, int] | None:
        """Find the end of ever smaller bounces on one plane: the time until then, and the plane."""
        if self.restitution >= 1.0 or not leaving:
            return None
        N, rates = self._compute_gap_rates(t, y, v)
        a = self._solve_acceleration(t, y, v, sorted(held))[0]
        pull = -(N @ a + self._compute_gap_accelerations(t, y, v))
        slow = 1e2 * GONE * self._largest * np.linalg.norm(N, axis=1)
        hops = [i for i in leaving if pull[i] > 0.0 and rates[i] > slow[i]]
        if len(hops) != 1:
            return None
        i = hops[0]
        n = N[i]
        small = rates[i] < FADED_MOVING * self._largest * np.linalg.norm(n)
        if not small or any(
            abs(N[j] @ n) > 1e-12 * np.linalg.norm(N[j]) * np.linalg.norm(n) for j in held
        ):
            return None
        return 2.0 * float(rates[i]) / (float(pull[i]) * (1.0 - self.restitution)), i

    # ---- what happens in between

    def _advance_to_event(
        self, t: float, y: Array, v: Array, touching: set[int], held: set[int], duration: float
    ) -> tuple[float, Array, Array, set[int], set[int]]:
        """Advance to the next impact, or to where a held plane is left.

        Returned are time, place, velocity, and the planes that are hit, or left.
        """
        window = duration / WINDOWS
        fresh = touching - held
        if fresh:  # low hops: the window fits the first of them
            N, rates = self._compute_gap_rates(t, y, v)
            pull = -(
                N @ self._solve_acceleration(t, y, v, sorted(held))[0]
                + self._compute_gap_accelerations(t, y, v)
            )
            hops = [
                2.0 * float(rates[i] / pull[i]) for i in fresh if pull[i] > 0.0 and rates[i] > 0.0
            ]
            window = min([window, *(4.0 * h for h in hops)])
        begin = t
        solver: Any = self._make_solver(t, y, v, held, duration) if held else None
        while True:
            self.budget.check_time()
            end = min(begin + window, duration)
            at = (
                self._step_solver(solver)
                if held
                else partial(_evaluate_parabola, t, y, v, self.gravity)
            )
            end = float(solver.t) if held else end
            hit = self._find_first_impact(
                at, begin, end, set(range(len(self.planes.names))) - held, fresh
            )
            left = self._find_release(at, begin, end, sorted(held)) if held else None
            stop = min(x for x in (hit and hit[0], left and left[0], end) if x is not None)
            self.stretches.append(Stretch(begin, at, tuple(sorted(held))))
            z, w = (x[0] for x in at(np.array([stop])))
            if held:
                z, w = self._project_onto_planes(stop, z, w, held)
            if hit is not None and hit[0] <= stop:
                return stop, z, w, hit[1], set()
            if left is not None and left[0] <= stop:
                self.impacts.append(Impact("leaves", stop, (left[1],), 0.0, 0.0, z, w))
                return stop, z, w, set(), {left[1]}
            if stop >= duration:
                return stop, z, w, set(), set()
            if held:
                solver.y, solver.f = (
                    np.concatenate([z, w]),
                    solver.fun(stop, np.concatenate([z, w])),
                )
            begin = end
            window = duration / WINDOWS
            gaps = self._compute_gaps(begin, z)
            fresh = {i for i in fresh if gaps[i] <= 0.0}

    def _make_solver(self, t: float, y: Array, v: Array, held: set[int], duration: float) -> Any:
        """Make the integrator of the motion along held planes."""
        from scipy import integrate

        index = sorted(held)
        k = len(y)

        def compute_slope(s: float, x: Array) -> Array:
            """Return velocity and acceleration, with all held planes pushing or pulling."""
            N = self.planes.evaluate_planes(s)[0][index]
            c = self._compute_gap_accelerations(s, x[:k], x[k:])[index]
            return np.concatenate(
                [
                    x[k:],
                    self.gravity
                    - Spectrum(N).compute_pseudo_inverse(Level.ROUNDING) @ (N @ self.gravity + c),
                ]
            )

        return cast(Any, integrate).DOP853(
            compute_slope,
            t,
            np.concatenate([y, v]),
            duration,
            rtol=INTEGRATION,
            atol=INTEGRATION,
            max_step=duration / WINDOWS,
        )

    def _step_solver(self, solver: Any) -> Callable[[Array], tuple[Array, Array]]:
        """Make one step of the integrator, and return places and velocities within it."""
        said = solver.step()
        if solver.status == "failed":
            raise ArithmeticError(f"at {solver.t:.6g} s the planes move too fast: {said}")
        dense = solver.dense_output()
        k = len(self.gravity)
        return lambda s: (dense(s)[:k].T, dense(s)[k:].T)

    def _find_first_impact(
        self,
        at: Callable[[Array], tuple[Array, Array]],
        begin: float,
        end: float,
        planes: set[int],
        fresh: set[int],
    ) -> tuple[float, set[int]] | None:
        """Find the first zero of a gap that closes within a step, and its planes.

        Gaps of `fresh` planes open first.
        """
        s = np.linspace(begin, end, LOOKS + 1)
        y, v = at(s)
        gaps = self._compute_gaps(s, y)
        rates = self._compute_gap_rates(s, y, v)[1]

        def compute_gap(i: int, x: float) -> float:
            """Compute the gap of plane i at a time."""
            return float(self._compute_gaps(x, at(np.array([x]))[0][0])[i])

        def compute_gap_rate(i: int, x: float) -> float:
            """Compute the rate of the gap of plane i at a time."""
            p, w = (z[0] for z in at(np.array([x])))
            return float(self._compute_gap_rates(x, p, w)[1][i])

        found: dict[int, float] = {}
        for i in sorted(planes):
            for k in range(LOOKS):
                a = float(s[k])
                b = float(s[k + 1])
                opens = i in fresh and k == 0  # it touches at a, and may close again at once
                if opens and rates[0, i] > 0.0 and rates[1, i] < 0.0:
                    a = find_zero(partial(compute_gap_rate, i), a, b)
                    if compute_gap(i, a) <= 0.0:  # a hop lower than rounding
                        found[i] = a
                        break
                elif (
                    rates[k, i] < 0.0 < rates[k + 1, i]
                    and gaps[k + 1, i] > 0.0
                    and (gaps[k, i] > 0.0 or opens)
                ):
                    b = find_zero(partial(compute_gap_rate, i), a, b)
                if compute_gap(i, b) <= 0.0 and (
                    compute_gap(i, a) > 0.0 or (not opens and k == 0 and rates[0, i] < 0.0)
                ):
                    found[i] = (
                        find_zero(partial(compute_gap, i), a, b) if compute_gap(i, a) > 0.0 else a
                    )
                    break
        if not found:
            return None
        first = min(found.values())
        return first, {i for i, x in found.items() if x <= first + SAME_TIME * (end - begin)}

    def _find_release(
        self, at: Callable[[Array], tuple[Array, Array]], begin: float, end: float, held: list[int]
    ) -> tuple[float, int] | None:
        """Find the time within a step after which a held plane would have to pull, and the plane."""

        def compute_pushes(x: float) -> Array:
            """Compute the pushes of the held planes at a time."""
            p, w = (z[0] for z in at(np.array([x])))
            N = self.planes.evaluate_planes(x)[0][held]
            c = self._compute_gap_accelerations(x, p, w)[held]
            return Spectrum(N @ N.T).solve_least_squares(
                -(N @ self.gravity + c), Level.CLOSED
            ) * np.linalg.norm(N, axis=1)

        def find_least_push(x: float) -> float:
            """Return the least push of the held planes at a time."""
            return float(compute_pushes(x).min())

        s = np.linspace(begin, end, LOOKS // 4 + 1).tolist()
        weak = [
            k
            for k in range(len(s) - 1)
            if find_least_push(s[k + 1]) < -1e-9 * float(np.linalg.norm(self.gravity))
        ]
        if not weak:
            return None
        a = s[weak[0]]
        b = s[weak[0] + 1]
        time = find_zero(find_least_push, a, b) if find_least_push(a) > 0.0 else a
        return time, held[int(np.argmin(compute_pushes(b)))]


def _evaluate_parabola(t: float, y: Array, v: Array, a: Array, s: Array) -> tuple[Array, Array]:
    """Return places and velocities (n, k) at times s (n,) of a parabola that begins at t."""
    u = (s - t)[:, None]
    return y + u * (v + 0.5 * u * a), v + u * a


def find_zero(f: Callable[[float], float], a: float, b: float) -> float:
    """Find a zero between a and b, at which the signs of f differ; b where they do not."""
    zero = find_sign_change(f, a, b)
    return b if zero is None else zero
