"""Plans of manoeuvres: which straight pieces, arcs and turns lead an axle from one place in the
plane to another.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from kempe.analysis.manoeuvre import reeds_shepp
from kempe.analysis.manoeuvre.wheeled import Wheeled
from kempe.kinematics import closure_rows
from kempe.spatial import Array

GRID = 240
"""Values of the steering, all around or between its limits, between which a wanted curvature is
looked for."""
FAR = 10.0
"""Characteristic lengths to both sides within which a steering that slides is looked through."""
EXACT = 1e-14
"""Angle between the wanted motion and the allowed one that is rounding."""
NEAR = 1e-12
"""Lengths relative to those of the task that count as none."""
NEAREST = 100
"""Half turns that are tried near each end of a turn on the spot."""


class Refused(Exception):
    """There is no plan; the text says why. Raised inside a manoeuvre, and caught there."""


class Move(NamedTuple):
    """A part of a plan: signed length [m], angle [rad], and values of the steering at which the
    axle moves so.
    """

    length: float
    angle: float
    steering: tuple[float, ...] = ()


Plan = tuple[Move, ...]


class Steering:
    """Values of the steering coordinate at which the axle goes straight, turns, or takes an arc."""

    def __init__(self, car: Wheeled, q: Array):
        self.car = car
        self.q = q
        self.unit = closure_rows.characteristic_length(car.system)
        i = car.steering
        assert i is not None
        self.name = car.system.structure.velocity_names[i]
        here = float(q[car.steering_q])
        reach = math.pi if car.system.structure.coordinates.turning[i] else FAR * self.unit
        low = float(car.system.lower[i])
        high = float(car.system.upper[i])
        low = low if math.isfinite(low) else min(here, high) - reach
        high = high if math.isfinite(high) else max(here, low) + reach
        self.grid = np.linspace(low, high, GRID + 1)
        self.slope = np.unwrap([self.direction(s) for s in self.grid], period=math.pi)

    def direction(self, s: float) -> float:
        """Angle in [0, pi) of (forward, turning) without unit, at a value of the steering: 0
        straight, pi/2 a turn.
        """
        x = self.q.copy()
        x[self.car.steering_q] = s
        N = self.car.motions(x)
        forward = N[0, 0] / self.unit
        turning = N[2, 0]
        return math.atan2(turning, forward) % math.pi

    def values(self, curvature: float) -> tuple[float, ...]:
        """Values at which the axle's path has this curvature [1/m]: 0 straight, infinite on the
        spot.
        """
        from scipy import optimize

        wanted = math.atan(curvature * self.unit) if math.isfinite(curvature) else 0.5 * math.pi

        def off(s: float) -> float:
            return math.remainder(self.direction(s) - wanted, math.pi)

        found: list[float] = []
        for k in range(GRID):
            a = (self.slope[k] - wanted) / math.pi
            b = (self.slope[k + 1] - wanted) / math.pi
            if math.floor(a) == math.floor(b) and round(a) != a and round(b) != b:
                continue
            low = float(self.grid[k])
            high = float(self.grid[k + 1])
            ends = [s for s in (low, high) if abs(off(s)) < EXACT]
            s = ends[0] if ends else None
            if s is None and off(low) * off(high) < 0.0:
                s = float(cast(Any, optimize).brentq(off, low, high, xtol=1e-15))
            for simple in (float(self.q[self.car.steering_q]), 0.0):
                s = (
                    simple
                    if s is not None and abs(s - simple) < 1e-9 and abs(off(simple)) < EXACT
                    else s
                )
            if s is not None and all(abs(s - other) > 1e-9 for other in found):
                found.append(s)
        return tuple(found)

    def tightest(self) -> float:
        """The smallest radius of arcs to both sides within the limits; infinite where there is
        none.
        """
        bend = np.tan(self.slope) / self.unit
        left = float(bend.max())
        right = float(-bend.min())
        return 1.0 / min(left, right) * (1.0 + 1e-12) if min(left, right) > 0.0 else math.inf


def plans(
    car: Wheeled, q: Array, goal: Array, radius: float | None, free: Sequence[int]
) -> Iterator[Plan]:
    """Plans from one configuration (nq,) to another, the best first.

    `free` are velocity indices of driven coordinates that may end anywhere. Errors: `Refused`.
    """
    steering = None if car.loose or car.steering is None else Steering(car, q)
    straight, turn = (
        ((), ()) if steering is None else (steering.values(0.0), steering.values(math.inf))
    )
    if steering is not None and not straight:
        raise Refused(f"no value of {steering.name!r} within its limits goes straight")
    if steering is not None and not turn and not radius:
        least = steering.tightest()
        if radius == 0.0 or math.isinf(least):
            said = f"; radius={least:.6g} would do" if math.isfinite(least) else ""
            raise Refused(
                f"within the limits of {steering.name!r} it does not turn on the spot{said}"
            )
        radius = least
    start = car.wheel(q)
    end = car.wheel(goal)
    pose = car.pose
    whole = pose.gear * float(goal[pose.turn_q] - q[pose.turn_q])
    if not radius:
        length = _signed_length(car, q, goal, free, whole, straight, turn)
        yield from (
            _labelled(plan, straight, turn) for plan in _on_the_spot(start, end, whole, length)
        )
        return
    left, right = (
        ((), ())
        if steering is None
        else (steering.values(1.0 / radius), steering.values(-1.0 / radius))
    )
    if steering is not None and not (left and right):
        raise Refused(
            f"within the limits of {steering.name!r} it does not take arcs of {radius:.6g} m to "
            f"both sides; the smallest radius is {steering.tightest():.6g} m"
        )
    c = math.cos(start[2])
    s = math.sin(start[2])
    dx = (end[0] - start[0]) / radius
    dy = (end[1] - start[1]) / radius
    relative = c * dx + s * dy, c * dy - s * dx, end[2] - start[2]
    for way in reeds_shepp.ways(*relative):
        exact = reeds_shepp.refined(way, *relative)
        yield tuple(
            Move(radius * x, k * x, straight if k == 0.0 else left if k > 0.0 else right)
            for k, x in exact
        )


def _labelled(plan: Plan, straight: tuple[float, ...], turn: tuple[float, ...]) -> Plan:
    return tuple(m._replace(steering=turn if m.length == 0.0 else straight) for m in plan)


def _signed_length(
    car: Wheeled,
    q: Array,
    goal: Array,
    free: Sequence[int],
    angle: float,
    straight: tuple[float, ...],
    turn: tuple[float, ...],
) -> float | None:
    """The signed length [m] that brings the driven coordinates to the goal's, None where all of
    them are free.

    Errors: `Refused` where none does.
    """
    bound = [k for k, v in enumerate(car.driven) if v not in free]
    if not bound:
        return None

    def rate(forward: float, turning: float, values: tuple[float, ...]) -> Array:
        x = q.copy()
        if values:
            x[car.steering_q] = min(values, key=lambda s: abs(s - q[car.steering_q]))
        out = car.follow(x, forward, turning)
        return np.full(len(bound), np.nan) if out is None else out[bound]

    ahead = rate(1.0, 0.0, straight)
    about = rate(0.0, 1.0, turn)
    missing = (
        car.system.structure.layout.difference(q, goal)[[car.driven[k] for k in bound]]
        - about * angle
    )
    names = [car.system.structure.velocity_names[car.driven[k]] for k in bound]
    size = float(ahead @ ahead)
    length = float(ahead @ missing) / size if size > 0.0 else 0.0
    off = np.abs(ahead * length - missing)
    worst = int(np.argmax(off))
    if not off[worst] <= NEAR * 100.0 * (1.0 + float(np.abs(missing).max()) + abs(angle)):
        raise Refused(
            f"the goal cannot be reached: {names[worst]!r} would have to end {off[worst]:.6g} away "
            f"from what it is when {', '.join(map(repr, names))} roll along (free={names!r} lets "
            "them)"
        )
    return length


def _on_the_spot(
    start: tuple[float, float, float],
    end: tuple[float, float, float],
    angle: float,
    signed: float | None,
) -> Iterator[Plan]:
    """Plans of turns on the spot, by `angle` in all, and straight lines, of a `signed` length in
    all where given.
    """
    dx = end[0] - start[0]
    dy = end[1] - start[1]
    far = math.hypot(dx, dy)
    way = math.atan2(dy, dx)
    h = start[2]
    size = max(abs(x) for x in (*start[:2], *end[:2], 1e-300))
    if far <= 1e-16 * size:
        far = 0.0
        way = h - reeds_shepp.QUARTER
    small = NEAR * max(far, abs(signed or 0.0), 1e-3 * size)
    if signed is None or abs(abs(signed) - far) <= small:
        if not far:
            yield _spare((Move(0.0, angle),))
            return
        first = (way - h) % math.pi
        options = [first + k * math.pi for k in _half_turns(angle, first)]

        def ahead_by(a: float) -> float:
            return 1.0 if round((a - (way - h)) / math.pi) % 2 == 0 else -1.0

        for a in sorted(
            options, key=lambda a: (round(abs(a) + abs(angle - a), 9), -ahead_by(a), abs(a))
        ):
            ahead = ahead_by(a)
            if signed is None or ahead * signed > 0.0:
                yield _spare((Move(0.0, a), Move(ahead * far, 0.0), Move(0.0, angle - a)))
        return
    for legs in _legs(far, way, signed):
        yield _spare(_through(h, angle, legs))


def _half_turns(angle: float, first: float) -> list[int]:
    """Whole half turns k for which first + k pi covers both ends of a turn by an angle, and a half
    turn around.

    Of very many those near both ends: all between them cost the same.
    """
    low = min(0.0, angle) - math.pi
    high = max(0.0, angle) + math.pi
    k = math.floor((low - first) / math.pi)
    stop = math.ceil((high - first) / math.pi) + 1
    if stop - k <= 2 * NEAREST:
        return list(range(k, stop))
    return [*range(k, k + NEAREST), *range(stop - NEAREST, stop)]


def _legs(far: float, way: float, signed: float) -> Iterator[list[tuple[float, float]]]:
    """Two straight legs (direction, signed length) that lead `far` in the direction `way`, with a
    sum of lengths.
    """
    if abs(signed) >= far:  # by the tip of an isosceles triangle
        sense = math.copysign(1.0, signed)
        half = 0.5 * abs(signed)
        for side in (1.0, -1.0):
            tip = side * math.atan2(math.sqrt(max(half * half - 0.25 * far * far, 0.0)), 0.5 * far)
            yield [(way + tip, sense * half), (way - tip, sense * half)]
    else:
        yield [(way, 0.5 * (far + signed)), (way, 0.5 * (signed - far))]
        yield [(way, 0.5 * (signed - far)), (way, 0.5 * (far + signed))]


def _through(h: float, angle: float, legs: list[tuple[float, float]]) -> Plan:
    """Turns and legs (direction, signed length) with the least turning that ends at h + `angle`."""
    plans: list[Plan] = []
    for rounds in itertools.product((-1, 0, 1), repeat=len(legs)):
        plan: list[Move] = []
        done = 0.0
        for (direction, length), k in zip(legs, rounds, strict=True):
            ahead = direction if length >= 0.0 else direction + math.pi
            turn = reeds_shepp.wrapped(ahead - h - done) + 2.0 * math.pi * k
            plan += [Move(0.0, turn), Move(length, 0.0)]
            done += turn
        plans.append((*plan, Move(0.0, angle - done)))
    return min(plans, key=lambda plan: round(math.fsum(abs(m.angle) for m in plan), 9))


def _spare(plan: Plan) -> Plan:
    """The plan without moves of no size."""
    return tuple(m for m in plan if abs(m.length) > 1e-300 or abs(m.angle) > 1e-15)
