"""Manoeuvres: motions of rolling systems to a given configuration, by turns, arcs and lines.

Every velocity constraint holds along the whole way. A car with a turning radius takes the shortest
way of Reeds and Shepp (1990).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers.answer import Motion
from kempe.arguments import explained, explained_methods, listed, numbers
from kempe.arrays import is_real, is_whole, named
from kempe.budget import Budget, TimeUp, Usual
from kempe.equations import closure_rows
from kempe.equations.one_sided import one_sided_rows
from kempe.equations.velocity import row_names
from kempe.errors import InputError, KempeError, UnknownNameError, UnsupportedError
from kempe.mobility.classify import classify
from kempe.model.configurations import as_q, has_loops, q_from_dict, refuse_far
from kempe.model.model import kept
from kempe.motion.reeds_shepp import QUARTER, refined, ways, wrapped
from kempe.motion.rolling import slip
from kempe.motion.wheeled import Wheeled, wheeled
from kempe.numerics.clock import SHORT, TimeLimit, begun_within
from kempe.spatial import Array
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model


# ---- the answer


class Piece(NamedTuple):
    """A part of a manoeuvre in which the speeds stay: "forwards", "in reverse", "turn" on the spot,
    or "steer" at rest.

    `forward` [m/s] and `turning` [rad/s] are those of the axle, `steering` the rate of the steering
    coordinate.
    """

    kind: str
    start: float
    duration: float
    forward: float
    turning: float
    steering: float

    @property
    def length(self) -> float:
        """Metres that the axle goes, negative in reverse."""
        return self.forward * self.duration

    @property
    def angle(self) -> float:
        """Radians that it turns."""
        return self.turning * self.duration

    def __str__(self) -> str:
        if self.kind == "steer":
            return f"steer by {self.steering * self.duration:.6g}"
        if self.kind == "turn":
            return f"turn by {self.angle:.6g} rad on the spot"
        arc = (
            f" on an arc of {abs(self.forward / self.turning):.6g} m to the "
            if self.turning
            else ""
        )
        side = ("left" if self.turning * self.forward > 0.0 else "right") if self.turning else ""
        return f"{abs(self.length):.6g} m {self.kind}{arc}{side}"


@explained_methods
@dataclass(frozen=True, eq=False)
class Manoeuvre(Motion):
    """The way from a configuration to another one that obeys all velocity constraints.

    `q` (n, nq) are configurations at times `t` (n,), `s` (n,) the length that the axle has gone by
    then. `pieces` are the parts with constant speeds; `at` and `velocity` give any time. `slip` is
    the largest slip of a sample, of rows and speeds of size 1. `success` is false where no way was
    found: `status` says why, and `q` is the start only.
    """

    also = ("t", "s", "length", "duration", "cusps", "turns", "slip")
    interrupted = False

    system: Model
    q: Array
    t: Array
    s: Array
    pieces: tuple[Piece, ...]
    slip: float
    turns: int
    success: bool
    reason: str = ""
    frames: tuple[str, ...] = ()
    _exact: ExactManoeuvre | None = field(default=None, repr=False)
    late: bool = False

    @property
    def length(self) -> float:
        """Metres that the axle goes, forwards and in reverse."""
        return math.fsum(abs(p.length) for p in self.pieces)

    @property
    def duration(self) -> float:
        """Time that it takes [s]."""
        return float(self.t[-1])

    @property
    def cusps(self) -> int:
        """How often it changes between forwards and reverse."""
        signs = [p.forward > 0.0 for p in self.pieces if p.forward]
        return sum(a != b for a, b in zip(signs, signs[1:], strict=False))

    def __repr__(self) -> str:
        what = f"{counted(len(self.pieces), 'piece')}, length={self.length:.6g}, cusps={self.cusps}"
        return f"Manoeuvre({self.system.name!r}, {what})"

    def at(self, t: ArrayLike) -> Array:
        """Configurations (..., nq) at times `t` (...), exactly. Errors: `InputError` for times
        outside.
        """
        return self._at(t)[0]

    def velocity(self, t: ArrayLike) -> Array:
        """Velocities (..., nv) at times `t` (...); where two pieces meet, those of the later one."""
        return self._at(t)[1]

    def _at(self, t: ArrayLike) -> tuple[Array, Array]:
        t = numbers(t, "t")
        if not ((t >= 0.0) & (t <= self.duration)).all():
            raise InputError(
                f"t is outside the manoeuvre, which takes from 0 to {self.duration:.9g} s"
            )
        if self._exact is None or not self.pieces:
            shape = (*t.shape, self.system.nq)
            return np.broadcast_to(self.q[0], shape).copy(), np.zeros((*t.shape, self.system.nv))
        q, v = self._exact.at(t.ravel())
        return q.reshape(*t.shape, self.system.nq), v.reshape(*t.shape, self.system.nv)

    def table(self, frames: Iterable[FrameLike] = ()) -> tuple[list[str], Array]:
        """Names and columns (n, k) for a file: time, all coordinates, x, y (and z) of frames."""
        return self._columns("time", self.t, frames)

    def _sentence(self, index: tuple[int, ...]) -> str:
        if not self.success:
            return self.reason
        if not self.pieces:
            return "start and goal are the same"
        text = (
            f"{counted(len(self.pieces), 'piece')}, {self.length:.6g} m in {self.duration:.6g} s, "
        )
        text += f"{self.cusps or 'no'} cusp{'s' * (self.cusps != 1)}"
        if self.turns:
            text += (
                f"; the heading ends {counted(abs(self.turns), 'whole turn')} from the number of "
                "the goal"
            )
        return text

    def _notes(self) -> Sequence[str]:
        return [*(f"{p.start:8.4g} s: {p}" for p in self.pieces), *super()._notes()]


class ExactManoeuvre:
    """A manoeuvre in closed form: configurations and velocities at any time."""

    def __init__(self, car: Wheeled, q: Array, idle: Array, pieces: Sequence[Piece]):
        self.car = car
        self.pieces = pieces
        self.q = q
        self.starts = np.array([p.start for p in pieces])
        self.forward, self.turning, self.steering = (
            np.array([getattr(p, name) for p in pieces])
            for name in ("forward", "turning", "steering")
        )
        self.total = pieces[-1].start + pieces[-1].duration
        self.idle = idle / self.total
        n = len(pieces)
        layout = car.system.structure.layout
        place = dict(zip(layout.vector_v.tolist(), layout.vector_q.tolist(), strict=True))
        self.driven_q = [place[v] for v in car.driven]
        wheel = np.empty((n, 3))
        steer = np.empty(n)
        driven = np.empty((n, len(car.driven)))
        self.follow = np.empty((n, len(car.driven)))
        now = np.array(car.wheel(q))
        angle = float(q[car.steering_q])
        phases = q[self.driven_q].astype(float)
        for k, p in enumerate(pieces):
            wheel[k] = now
            steer[k] = angle
            driven[k] = phases
            x = q.copy()
            if car.steering is not None:
                x[car.steering_q] = angle
            rate = (
                car.follow(x, p.forward, p.turning)
                if p.forward or p.turning
                else np.zeros(len(car.driven))
            )
            if rate is None:
                raise UnsupportedError(
                    f"{car.system.name}: its velocity constraints do not allow to {p}"
                )
            self.follow[k] = rate
            now = _moved(now[None], np.array([p.length]), np.array([p.angle]))[0]
            angle = angle + p.steering * p.duration
            phases = phases + rate * p.duration
        self.wheel = wheel
        self.steer = steer
        self.driven = driven
        self.ends = now, angle, phases

    def at(self, t: Array) -> tuple[Array, Array]:
        """Configurations (n, nq) and velocities (n, nv) at times (n,)."""
        car = self.car
        system = self.car.system
        k = np.clip(np.searchsorted(self.starts, t, side="right") - 1, 0, len(self.starts) - 1)
        past = t - self.starts[k]
        wheel = _moved(self.wheel[k], self.forward[k] * past, self.turning[k] * past)
        v = np.zeros((len(t), system.nv))
        v[:, list(car.idle)] = self.idle[list(car.idle)]
        q = system.structure.layout.integrate(
            np.broadcast_to(self.q, (len(t), system.nq)), v * t[:, None]
        )
        if car.steering is not None:
            q[:, car.steering_q] = self.steer[k] + self.steering[k] * past
            v[:, car.steering] = self.steering[k]
        q[:, self.driven_q] = self.driven[k] + self.follow[k] * past[:, None]
        v[:, list(car.driven)] = self.follow[k]
        place, heading = car.body(wheel)
        q = car.pose.to_q(q, place, heading)
        h = wheel[:, 2]
        w = self.turning[k]
        arm = place - wheel[:, :2]
        ahead = np.column_stack([np.cos(h), np.sin(h)]) * self.forward[k][:, None]
        moving = ahead + w[:, None] * np.column_stack([-arm[:, 1], arm[:, 0]])
        v[:, car.pose.own] = car.pose.rates(q, moving, w)
        return q, v

    def lengths(self, t: Array) -> Array:
        """Lengths (n,) that the axle has gone at times (n,)."""
        k = np.clip(np.searchsorted(self.starts, t, side="right") - 1, 0, len(self.starts) - 1)
        before = np.concatenate([[0.0], np.cumsum([abs(p.length) for p in self.pieces])])[:-1]
        return before[k] + np.abs(self.forward[k]) * (t - self.starts[k])


def _moved(wheel: Array, length: Array, angle: Array) -> Array:
    """Axles (n, 3) after signed lengths (n,) in which they turn by angles (n,) evenly."""
    half = 0.5 * angle
    chord = length * np.sinc(half / math.pi)
    h = wheel[:, 2] + half
    return np.column_stack(
        [wheel[:, 0] + chord * np.cos(h), wheel[:, 1] + chord * np.sin(h), wheel[:, 2] + angle]
    )


# ---- plans

# Which straight pieces, arcs and turns lead an axle from one place in the plane to another.

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
    for way in ways(*relative):
        exact = refined(way, *relative)
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
        way = h - QUARTER
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
            turn = wrapped(ahead - h - done) + 2.0 * math.pi * k
            plan += [Move(0.0, turn), Move(length, 0.0)]
            done += turn
        plans.append((*plan, Move(0.0, angle - done)))
    return min(plans, key=lambda plan: round(math.fsum(abs(m.angle) for m in plan), 9))


def _spare(plan: Plan) -> Plan:
    """The plan without moves of no size."""
    return tuple(m for m in plan if abs(m.length) > 1e-300 or abs(m.angle) > 1e-15)


# ---- the verb

# The path is put together of pieces in which the axle keeps its speed and its turning, so that it
# is known in closed form and obeys the velocity rows at every time. A car without steering limits
# turns on the spot between two straight lines; one with a turning radius takes the ways of Reeds
# and Shepp, by alternation where there is no room. Each sample is held against the velocity rows of
# the system itself.

SLIP = 1e-9
"""Slip, of rows and speeds of size 1, above which a sample is not on the constraint."""
PARALLEL = 1e-3
"""Sine of the angle between the two slides, of the sign that it has at the start, from which on
they go on."""
MOST = 10**6
"""Samples at most."""
USUAL = Usual("manoeuvre", points=200, time_limit=SHORT)


@explained
def manoeuvre(
    system: Model,
    start: ArrayLike | Mapping[str, float] | None,
    goal: ArrayLike | Mapping[str, float],
    *,
    radius: float | None = None,
    free: Iterable[str] = (),
    budget: Budget | None = None,
) -> Manoeuvre:
    """The `Manoeuvre` from one configuration to another of a system that rolls: every velocity
    constraint is obeyed.

    `start` and `goal` are configurations (nq,) or dicts by coordinate name (what is not named is
    neutral). `radius` [m] is the smallest turning circle of the axle's middle: 0 allows turns on
    the spot. By default it is 0, or what the limits of the steering allow. `free` names coordinates
    that may end anywhere, such as the angles of wheels that roll along; a dict as the goal leaves
    those free that it does not name. With a radius the axle takes the shortest way of Reeds and
    Shepp (1990), and the heading may end whole turns from the goal's number; without one it ends at
    that number. The axle goes at 1 m/s and turns at 1 rad/s at most, or slower by the velocity
    limits of the system. `q` has about as many configurations as the `budget` has points (200), the
    ends of all pieces among them; its time_limit (30 s) ends the search, see `late`.

    It is known for a body that moves in a plane by two slides and a turn, with an axle that does
    not slip sideways (knife edge, unicycle, coin that stands upright, differential drive, car with
    one steering angle), wherever that is on the body; other coordinates may be idle, steer, or
    follow. All else is refused with the reason. Errors: `UnsupportedError`; `InputError`;
    `UnknownNameError`.
    """
    q = _one(system, start, "start")
    goals = _one(system, goal, "goal")
    if radius is not None and (not is_real(radius) or not 0.0 <= radius < math.inf):
        raise InputError(
            f"radius is {radius!r}; it must be a length in metres, or 0 for turns on the spot"
        )
    spend = USUAL.of(budget)
    samples = spend.points
    time = TimeLimit(spend.time_limit)
    if not is_whole(samples) or not 2 <= samples <= MOST:
        raise InputError(
            f"points is {samples!r}; it must be a whole number, at least 2 and at most {MOST}"
        )
    time.put_in_order()  # there is nothing to do afterwards
    with begun_within(USUAL, time):
        car = wheeled(system, q)
        loose = _loose(system, goal, free, car)
    motion = None
    said = ""
    late = False
    try:
        with time:
            for plan in plans(car, q, goals, None if radius is None else float(radius), loose):
                time.check()
                found = _exact(car, q, goals, plan)
                said = "" if found is None else _outside(system, found, int(samples))
                if not said:
                    motion = found
                    break
    except Refused as refusal:
        said = str(refusal)
    except TimeUp as error:
        late = True
        said = f"not found: {time.reason(error)} came" + (f"; {said}" if said else "")
    zero = np.zeros(1)
    if motion is None:
        return Manoeuvre(
            system, q[None], zero, zero, (), 0.0, 0, not said, said, (car.pose.body,), late=late
        )
    t = _times(motion, int(samples))
    x, v = motion.at(t)
    slipped = slip(system, t, x, v)
    if slipped > SLIP:
        raise UnsupportedError(
            f"{system.name}: the manoeuvre slips by {slipped:.2g}: its velocity constraints are "
            "not those of an axle everywhere"
        )
    turns = _arrive(car, motion, x, q, goals, loose)
    return Manoeuvre(
        system,
        x,
        t,
        motion.lengths(t),
        tuple(motion.pieces),
        slipped,
        turns,
        True,
        "",
        (car.pose.body,),
        motion,
    )


def _one(system: Model, q: Any, what: str) -> Array:
    """One configuration (nq,), closed or not. Errors: `InputError`."""
    if q is None:
        q = system.neutral
    given = named(q)
    array = (
        as_q(system, q) if given is None or not has_loops(system) else q_from_dict(system, given)
    )
    if array.shape != (system.nq,):
        raise InputError(
            f"{what} has shape {array.shape}; it must be one configuration ({system.nq},)"
        )
    refuse_far(system, array, what)
    rows = one_sided_rows(system)
    if (over := rows.beyond(array)).any():
        k = int(np.argmax(over))
        raise InputError(
            f"{what} has {rows.names[k]!r} = {rows.values(array)[k]:.9g}; it must be between "
            f"{rows.low[k]:.9g} and {rows.high[k]:.9g}"
        )
    return array.astype(float)


def _loose(system: Model, goal: Any, free: Iterable[str], car: Wheeled) -> tuple[int, ...]:
    """Velocity indices of what may end anywhere. Errors: `InputError`, `UnknownNameError`."""
    names = list(system.structure.velocity_names)
    out: list[int] = []
    for name in listed(free, "free"):
        if name not in names:
            raise UnknownNameError("coordinate", name, names, system.name)
        if names.index(name) not in car.driven:
            those = ", ".join(repr(names[v]) for v in car.driven) or "none"
            raise InputError(
                f"{name!r} does not roll along, so its goal counts; those that do: {those}"
            )
        out.append(names.index(name))
    given = named(goal)
    return (*out, *(v for v in car.driven if given is not None and names[v] not in given))


def _exact(car: Wheeled, q: Array, goal: Array, plan: Plan) -> ExactManoeuvre | None:
    """A plan in closed form, with the steering between its moves, as fast as limits allow; None for
    nothing to do.
    """
    pieces: list[Piece] = []
    now = float(q[car.steering_q])

    def steer(values: Sequence[float]) -> None:
        nonlocal now
        s = min(values, key=lambda s: abs(s - now)) if values else now
        if s != now:
            at = pieces[-1].start + pieces[-1].duration if pieces else 0.0
            pieces.append(Piece("steer", at, abs(s - now), 0.0, 0.0, math.copysign(1.0, s - now)))
        now = s

    for move in plan:
        steer(move.steering)
        time = max(abs(move.length), abs(move.angle))
        kind = "turn" if not move.length else "forwards" if move.length > 0.0 else "in reverse"
        at = pieces[-1].start + pieces[-1].duration if pieces else 0.0
        pieces.append(Piece(kind, at, time, move.length / time, move.angle / time, 0.0))
    if car.steering is not None:
        steer((float(goal[car.steering_q]),))
    idle = np.zeros(car.system.nv)
    idle[list(car.idle)] = car.system.structure.layout.difference(q, goal)[list(car.idle)]
    if not pieces and idle.any():
        pieces.append(Piece("rest", 0.0, float(np.abs(idle).max()), 0.0, 0.0, 0.0))
    if not pieces:
        return None
    motion = ExactManoeuvre(car, q, idle, pieces)
    limits = car.system.structure.velocity_limits
    if not np.isfinite(limits).any():
        return motion
    return ExactManoeuvre(car, q, idle, _slower(motion, limits))


def _slower(motion: ExactManoeuvre, limits: Array) -> list[Piece]:
    """The pieces, each slower where a coordinate would exceed its velocity limit (nv,)."""
    idle = np.zeros(len(limits), dtype=bool)
    idle[list(motion.car.idle)] = True
    still = np.where(idle, np.inf, limits)
    out: list[Piece] = []
    for p in motion.pieces:
        n = 65
        inside = p.start + p.duration * (np.arange(n) + 0.5) / n
        v = np.abs(motion.at(inside)[1]).max(axis=0) / math.cos(min(0.5 * abs(p.angle) / n, 1.0))
        out.append(_stretched(p, out, max(1.0, float((v / still).max(initial=0.0)))))
    total = out[-1].start + out[-1].duration
    most = float((np.abs(motion.idle) * motion.total / limits)[idle].max(initial=0.0)) / total
    if most > 1.0:
        pieces = out
        out = []
        for p in pieces:
            out.append(_stretched(p, out, most))
    return out


def _stretched(p: Piece, before: Sequence[Piece], by: float) -> Piece:
    """A piece that takes `by` times as long, after the pieces before it."""
    at = before[-1].start + before[-1].duration if before else 0.0
    return Piece(p.kind, at, p.duration * by, p.forward / by, p.turning / by, p.steering / by)


def _times(motion: ExactManoeuvre, samples: int) -> Array:
    """Times (n,): the ends of all pieces, and evenly spread ones between them."""
    out = [np.zeros(1)]
    for p in motion.pieces:
        n = max(1, math.ceil(p.duration / motion.total * (samples - 1)))
        out.append(p.start + p.duration * np.arange(1, n + 1) / n)
    out[-1][-1] = motion.total
    return np.concatenate(out)


def _outside(system: Model, motion: ExactManoeuvre, samples: int) -> str:
    """What a motion does that it must not, in words: it leaves limits, or violates one-sided
    constraints.
    """
    q = motion.at(_times(motion, max(samples, 200)))[0]
    if (motion.car.pose.spread(q) <= PARALLEL).any():
        slides = " and ".join(
            repr(system.structure.velocity_names[int(v)]) for v in motion.car.pose.slides_v
        )
        return f"on the way {slides} would be parallel, and cannot go on"
    rows = one_sided_rows(system)
    over = rows.beyond(q)
    if not over.any():
        return ""
    n, k = np.unravel_index(int(np.argmax(over)), over.shape)
    return (
        f"not found within the limits: {rows.names[k]!r} would get to {rows.values(q[n])[k]:.6g}, "
        f"and must be between {rows.low[k]:.6g} and {rows.high[k]:.6g}"
    )


def _arrive(
    car: Wheeled, motion: ExactManoeuvre, x: Array, q: Array, goal: Array, free: Sequence[int]
) -> int:
    """Put the ends of samples (n, nq) right to the last bit; returns by how many whole turns the
    heading is off.

    Errors: `UnsupportedError` where the motion does not lead to the goal.
    """
    system = car.system
    end = goal.copy()
    place = dict(
        zip(
            system.structure.layout.vector_v.tolist(),
            system.structure.layout.vector_q.tolist(),
            strict=True,
        )
    )
    for v in free:
        end[place[v]] = x[-1, place[v]]
    i = car.pose.turn_q
    turns = round(float(car.pose.gear * (x[-1, i] - goal[i])) / (2.0 * math.pi))
    end[i] += 2.0 * math.pi * turns / car.pose.gear
    off = np.abs(system.structure.layout.difference(x[-1], end))
    scale = (
        1.0 + float(np.abs(x[:, system.structure.layout.vector_q]).max(initial=0.0)) + motion.total
    )
    if off.max() > 1e-12 * scale:
        name = system.structure.velocity_names[int(np.argmax(off))]
        if int(np.argmax(off)) not in car.driven:
            raise UnsupportedError(
                f"{system.name}: {name!r} would miss the goal by {off.max():.3g}: this radius is "
                "too large beside the distance for the digits of numbers"
            )
        raise UnsupportedError(
            f"{system.name}: with this radius {name!r} ends {off.max():.6g} away from the goal: "
            f"let it end anywhere (free={[name]!r}), or turn on the spot (radius=0)"
        )
    x[0] = q
    x[-1] = end
    return turns


# ---- what is said of ways to a configuration


def way_there(system: Model) -> str:
    """End of a sentence about a configuration: whether motions get there, of a system that rolls.

    A manoeuvre is named only where brackets show that motions reach every configuration around.
    """
    names = list(dict.fromkeys(name for name, *_ in row_names(system)))
    said = ", ".join(map(repr, names[:3])) + ", ..." * (len(names) > 3)
    hold = "holds" if len(names) == 1 else "hold"
    return f"; {_motions_there(system).format(hold=f'{said} {hold} on the way')}"


@kept
def _motions_there(system: Model) -> str:
    """What is known of motions to other configurations, with a field {hold} for the constraints."""
    unknown = "{hold}: whether a motion gets there is not known"
    try:
        found = classify(system)
    except KempeError:
        return unknown
    if found.doubtful or found.reachable_around is None:
        return unknown
    lost = found.position_dof - found.reachable_around
    if lost > 0:
        keep = (
            "1 function of position keeps its value"
            if lost == 1
            else f"{lost} functions of position keep their values"
        )
        return (
            f"{{hold}}, where {keep} (system.classify): a motion gets there only if the start has "
            "the same"
        )
    try:
        manoeuvre(system, found.q, found.q)
    except UnsupportedError:
        return (
            "going there takes a motion: {hold}; there are such motions (system.classify), none is "
            "known here"
        )
    except KempeError:
        pass
    return "going there is a manoeuvre ({hold}): system.manoeuvre(start, q)"
