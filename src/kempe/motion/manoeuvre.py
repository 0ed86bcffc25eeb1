"""Manoeuvres: motions of rolling systems to a given configuration, by turns, arcs and lines.

Every velocity constraint holds along the whole way. A car with a turning radius takes the shortest
way of Reeds and Shepp (1990).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers.answer import Motion
from kempe.arguments import explain_errors, explain_method_errors, numbers, read_names
from kempe.arrays import is_real, is_whole, read_mapping
from kempe.budget import Budget, TimeUp, Usual
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.equations.velocity import list_velocity_row_names
from kempe.errors import InputError, KempeError, UnknownNameError, UnsupportedError
from kempe.mobility.classify import classify
from kempe.model.configurations import has_loops, make_q, read_q, refuse_large_numbers
from kempe.model.model import keep_answers
from kempe.motion.reeds_shepp import QUARTER, list_ways, wrap_angle
from kempe.motion.rolling import compute_slip
from kempe.motion.wheeled import Axle, find_axle
from kempe.numerics.clock import SHORT, TimeLimit, limit_preparation_time
from kempe.numerics.roots import find_sign_change
from kempe.spatial import Array
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model


# ---- the answer


class Piece(NamedTuple):
    """A part of a manoeuvre at constant speeds.

    It is "forwards", "in reverse", "turn" on the spot, or "steer" at rest.

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
        """Length of the way of the axle in metres, negative in reverse."""
        return self.forward * self.duration

    @property
    def angle(self) -> float:
        """Angle by which the axle turns, in radians."""
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


@explain_method_errors
@dataclass(frozen=True, eq=False)
class Manoeuvre(Motion):
    """A motion from one configuration to another that obeys all velocity constraints.

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
        """Length of the path of the axle in metres, forwards and in reverse."""
        return math.fsum(abs(p.length) for p in self.pieces)

    @property
    def duration(self) -> float:
        """Duration of the manoeuvre in seconds."""
        return float(self.t[-1])

    @property
    def cusps(self) -> int:
        """Number of changes between forwards and reverse."""
        signs = [p.forward > 0.0 for p in self.pieces if p.forward]
        return sum(a != b for a, b in zip(signs, signs[1:], strict=False))

    def __repr__(self) -> str:
        what = (
            f"{format_count(len(self.pieces), 'piece')}, length={self.length:.6g}, "
            f"cusps={self.cusps}"
        )
        return f"Manoeuvre({self.system.name!r}, {what})"

    def at(self, t: ArrayLike) -> Array:
        """Return the exact configurations (..., nq) at times `t` (...) in seconds.

        Errors: `InputError` for times outside.
        """
        return self._evaluate_motion(t)[0]

    def velocity(self, t: ArrayLike) -> Array:
        """Return velocities (..., nv) at times `t` (...) in seconds.

        Where two pieces meet, they are those of the later one.
        """
        return self._evaluate_motion(t)[1]

    def _evaluate_motion(self, t: ArrayLike) -> tuple[Array, Array]:
        """Return configurations (..., nq) and velocities (..., nv) at times `t` (...)."""
        t = numbers(t, "t")
        if not ((t >= 0.0) & (t <= self.duration)).all():
            raise InputError(
                f"t is outside the manoeuvre, which takes from 0 to {self.duration:.9g} s"
            )
        if self._exact is None or not self.pieces:
            shape = (*t.shape, self.system.nq)
            return np.broadcast_to(self.q[0], shape).copy(), np.zeros((*t.shape, self.system.nv))
        q, v = self._exact.evaluate_motion(t.ravel())
        return q.reshape(*t.shape, self.system.nq), v.reshape(*t.shape, self.system.nv)

    def table(self, frames: Iterable[FrameLike] = ()) -> tuple[list[str], Array]:
        """Return names and columns (n, k) for a file: time, coordinates, x, y (and z) of frames."""
        return self._make_columns("time", self.t, frames)

    def _compose_sentence(self, index: tuple[int, ...]) -> str:
        if not self.success:
            return self.reason
        if not self.pieces:
            return "start and goal are the same"
        text = (
            f"{format_count(len(self.pieces), 'piece')}, {self.length:.6g} m in "
            f"{self.duration:.6g} s, "
        )
        text += f"{self.cusps or 'no'} cusp{'s' * (self.cusps != 1)}"
        if self.turns:
            text += (
                f"; the heading ends {format_count(abs(self.turns), 'whole turn')} from the number "
                "of the goal"
            )
        return text

    def _list_notes(self, degrees: bool = False) -> Sequence[str]:
        return [*(f"{p.start:8.4g} s: {p}" for p in self.pieces), *super()._list_notes()]


class ExactManoeuvre:
    """A manoeuvre in closed form: configurations and velocities at any time.

    In each piece the axle goes along a line or an arc, and every other coordinate has a constant
    rate: `Q` (n, nq) are the configurations and `places` (n, 3) those of the axle where pieces
    begin, `V` (n, nv) the rates.
    """

    def __init__(self, axle: Axle, q: Array, idle: Array, pieces: Sequence[Piece]):
        self.axle = axle
        self.pieces = pieces
        self.forward = np.array([p.forward for p in pieces])
        self.turning = np.array([p.turning for p in pieces])
        self.starts = np.array([p.start for p in pieces])
        self.total = pieces[-1].start + pieces[-1].duration
        self.gone = np.append(0.0, np.cumsum([abs(p.length) for p in pieces]))
        move = axle.system.structure.layout.integrate_velocity
        self.Q = np.empty((len(pieces), len(q)))
        self.V = np.tile(idle / self.total, (len(pieces), 1))
        self.places = np.empty((len(pieces), 3))
        place = axle.compute_place(q)
        for k, p in enumerate(pieces):
            self.Q[k] = q
            self.places[k] = place
            if axle.steering is not None:
                self.V[k, axle.steering] = p.steering
            if p.forward or p.turning:
                rates = axle.compute_driven_rates(q, p.forward, p.turning)
                if rates is None:
                    raise UnsupportedError(
                        f"{axle.system.name}: its velocity constraints do not allow to {p}"
                    )
                self.V[k, list(axle.driven)] = rates
            place = _move_along_arc(place[None], np.array([p.length]), np.array([p.angle]))[0]
            q = move(q, self.V[k] * p.duration)

    def evaluate_motion(self, t: Array) -> tuple[Array, Array]:
        """Return configurations (n, nq) and velocities (n, nv) at times (n,)."""
        axle = self.axle
        k = np.clip(np.searchsorted(self.starts, t, side="right") - 1, 0, len(self.starts) - 1)
        past = t - self.starts[k]
        v = self.V[k]
        q = axle.system.structure.layout.integrate_velocity(self.Q[k], v * past[:, None])
        q = axle.move_axle(
            q, _move_along_arc(self.places[k], self.forward[k] * past, self.turning[k] * past)
        )
        v[:, list(axle.own)] = axle.compute_own_rates(q, self.forward[k], self.turning[k])
        return q, v

    def compute_lengths(self, t: Array) -> Array:
        """Compute the lengths (n,) in metres of the axle's way up to times (n,)."""
        return np.interp(t, np.append(self.starts, self.total), self.gone)


def _move_along_arc(place: Array, length: Array, angle: Array) -> Array:
    """Return places (n, 3) of an axle after arcs of signed lengths (n,) with turns by angles (n,)."""
    h = place[:, 2] + 0.5 * angle
    chord = length * np.sinc(0.5 * angle / math.pi)
    return place + np.column_stack([chord * np.cos(h), chord * np.sin(h), angle])


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


class Refused(Exception):
    """Error inside a manoeuvre that has no plan; the text says why."""


class Move(NamedTuple):
    """A part of a plan: signed length [m], angle [rad], and values of the steering for it."""

    length: float
    angle: float
    steering: tuple[float, ...] = ()


Plan = tuple[Move, ...]


class Steering:
    """Values of the steering coordinate at which the axle goes straight, turns, or takes an arc."""

    def __init__(self, axle: Axle, q: Array):
        system = axle.system
        i = axle.steering
        assert i is not None
        self.name = system.structure.velocity_names[i]
        self._axle = axle
        self._q = q
        self.unit = float(axle.units[0])
        self.now = float(q[axle.q_places[i]])
        reach = math.pi if system.structure.coordinates.turning[i] else FAR * self.unit
        low = float(system.lower[i])
        high = float(system.upper[i])
        low = low if math.isfinite(low) else min(self.now, high) - reach
        high = high if math.isfinite(high) else max(self.now, low) + reach
        self.grid = np.linspace(low, high, GRID + 1)
        self.bends = np.array([axle.compute_bend_angle(q, s) for s in self.grid.tolist()])
        self._known: dict[float, tuple[float, ...]] = {}

    def find_values(self, curvature: float) -> tuple[float, ...]:
        """Find the values at which the axle's path has this curvature [1/m].

        It is 0 straight, infinite on the spot.
        """
        if curvature not in self._known:
            self._known[curvature] = tuple(self._search_values(curvature))
        return self._known[curvature]

    def _search_values(self, curvature: float) -> list[float]:
        """Search the limits of the steering for values with this curvature [1/m]."""
        wanted = math.atan(curvature * self.unit)

        def compute_deviation(s: float) -> float:
            """Compute the difference of the bend angle from the requested one."""
            return math.remainder(self._axle.compute_bend_angle(self._q, s) - wanted, math.pi)

        found = [
            s for s in (self.now, 0.0, *self.grid[[0, -1]]) if abs(compute_deviation(s)) < EXACT
        ]
        found = [float(s) for s in found if self.grid[0] <= s <= self.grid[-1]]
        gap = np.array([math.remainder(b - wanted, math.pi) for b in self.bends])
        for k in np.flatnonzero((gap[:-1] * gap[1:] <= 0.0) & (np.abs(np.diff(gap)) < 1.0)):
            s = find_sign_change(compute_deviation, float(self.grid[k]), float(self.grid[k + 1]))
            if s is not None and all(abs(s - other) > 1e-9 for other in found):
                found.append(s)
        return found

    def find_smallest_radius(self) -> float:
        """Find the smallest radius of arcs to both sides within the limits, in metres.

        It is infinite where there is none.
        """
        bend = np.tan(self.bends) / self.unit
        least = min(float(bend.max()), float(-bend.min()))
        return 1.0 / least * (1.0 + 1e-12) if least > 0.0 else math.inf


def iterate_plans(
    axle: Axle, q: Array, goal: Array, radius: float | None, free: Sequence[int]
) -> Iterator[Plan]:
    """Iterate over plans from one configuration (nq,) to another, the best first.

    `free` are velocity indices of driven coordinates that may end anywhere. Errors: `Refused`.
    """
    steering = None if axle.loose or axle.steering is None else Steering(axle, q)

    if steering is not None:
        if not steering.find_values(0.0):
            raise Refused(f"no value of {steering.name!r} within its limits goes straight")
        if not radius and not steering.find_values(math.inf):
            least = steering.find_smallest_radius()
            if radius == 0.0 or math.isinf(least):
                hint = f"; radius={least:.6g} would do" if math.isfinite(least) else ""
                raise Refused(
                    f"within the limits of {steering.name!r} it does not turn on the spot{hint}"
                )
            radius = least

    def add_steering(plan: Plan) -> Plan:
        """Return the plan with values of the steering for its moves."""
        if steering is None:
            return plan
        moves: list[Move] = []
        for m in plan:
            arc = math.copysign(1.0 / radius, m.angle * m.length) if radius else math.inf
            bend = 0.0 if not m.angle else arc if m.length else math.inf
            moves.append(m._replace(steering=steering.find_values(bend)))
        return tuple(moves)

    start = axle.compute_place(q)
    end = axle.compute_place(goal)
    if not radius:
        i = axle.own_q_places[2]
        angle = axle.gear * float(goal[i] - q[i])
        (turn,) = add_steering((Move(0.0, 1.0),))
        (ahead,) = add_steering((Move(1.0, 0.0),))
        length = _find_signed_length(axle, q, goal, free, angle, ahead, turn)
        yield from map(add_steering, _iterate_spot_plans(start, end, angle, length))
        return
    if steering is not None and not all(steering.find_values(k / radius) for k in (1.0, -1.0)):
        raise Refused(
            f"within the limits of {steering.name!r} it does not take arcs of {radius:.6g} m to "
            f"both sides; the smallest radius is {steering.find_smallest_radius():.6g} m"
        )
    c = math.cos(start[2])
    s = math.sin(start[2])
    dx, dy = ((end - start)[:2] / radius).tolist()
    relative = c * dx + s * dy, c * dy - s * dx, float(end[2] - start[2])
    for way in list_ways(*relative):
        yield add_steering(tuple(Move(radius * x, k * x) for k, x in way))


def _find_signed_length(
    axle: Axle, q: Array, goal: Array, free: Sequence[int], angle: float, ahead: Move, turn: Move
) -> float | None:
    """Find the signed length [m] that brings the driven coordinates to those of the goal.

    It is None where all of them are free.

    Errors: `Refused` where none does.
    """
    bound = [k for k, v in enumerate(axle.driven) if v not in free]
    if not bound:
        return None

    def compute_rates(move: Move) -> Array:
        """Compute the rates of the driven coordinates in a move."""
        x = q.copy()
        if move.steering and axle.steering is not None:
            i = axle.q_places[axle.steering]
            x[i] = min(move.steering, key=lambda s: abs(s - q[i]))
        out = axle.compute_driven_rates(x, move.length, move.angle)
        return np.full(len(bound), np.nan) if out is None else out[bound]

    by_length = compute_rates(ahead)
    far = axle.system.structure.layout.compute_difference(q, goal)[[axle.driven[k] for k in bound]]
    missing = far - compute_rates(turn) * angle
    size = float(by_length @ by_length)
    length = float(by_length @ missing) / size if size > 0.0 else 0.0
    off = np.abs(by_length * length - missing)
    worst = int(np.argmax(off))
    if not off[worst] <= NEAR * 100.0 * (1.0 + float(np.abs(missing).max()) + abs(angle)):
        names = [axle.system.structure.velocity_names[axle.driven[k]] for k in bound]
        raise Refused(
            f"the goal cannot be reached: {names[worst]!r} would have to end {off[worst]:.6g} away "
            f"from what it is when {', '.join(map(repr, names))} roll along (free={names!r} lets "
            "them)"
        )
    return length


def _iterate_spot_plans(
    start: Array, end: Array, angle: float, signed: float | None
) -> Iterator[Plan]:
    """Iterate over plans of turns on the spot, by `angle` in all, and straight lines.

    The lines have a `signed` length in all, where one is given.
    """
    far = math.hypot(*(end - start)[:2])
    way = math.atan2(end[1] - start[1], end[0] - start[0])
    h = float(start[2])
    size = max(*np.abs([start[:2], end[:2]]).ravel(), 1e-300)
    if far <= 1e-16 * size:
        far = 0.0
        way = h - QUARTER
    if signed is not None and abs(abs(signed) - far) > NEAR * max(far, abs(signed), 1e-3 * size):
        for legs in _iterate_legs(far, way, signed):
            yield _drop_empty_moves(_make_leg_plan(h, angle, legs))
        return
    if not far:
        yield _drop_empty_moves((Move(0.0, angle),))
        return
    # half turns from the way on, near both ends of the turn: all between them cost the same
    near = {round((x - way + h) / math.pi) + k for x in (0.0, angle) for k in range(-2, 3)}
    options = [(way - h + k * math.pi, 1.0 if k % 2 == 0 else -1.0) for k in near]
    options.sort(key=lambda x: (round(abs(x[0]) + abs(angle - x[0]), 9), -x[1], abs(x[0])))
    for turn, sense in options:
        if signed is None or sense * signed > 0.0:
            yield _drop_empty_moves(
                (Move(0.0, turn), Move(sense * far, 0.0), Move(0.0, angle - turn))
            )


def _iterate_legs(far: float, way: float, signed: float) -> Iterator[list[tuple[float, float]]]:
    """Iterate over pairs of straight legs (direction, signed length) to a point.

    They lead `far` metres in the direction `way`, with the sum `signed` of their lengths.
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


def _make_leg_plan(h: float, angle: float, legs: list[tuple[float, float]]) -> Plan:
    """Make the plan of turns and legs with the least turning that ends at h + `angle`.

    Legs are (direction, signed length).
    """
    plans: list[Plan] = []
    for rounds in itertools.product((-1, 0, 1), repeat=len(legs)):
        plan: list[Move] = []
        done = 0.0
        for (direction, length), k in zip(legs, rounds, strict=True):
            ahead = direction if length >= 0.0 else direction + math.pi
            turn = wrap_angle(ahead - h - done) + 2.0 * math.pi * k
            plan += [Move(0.0, turn), Move(length, 0.0)]
            done += turn
        plans.append((*plan, Move(0.0, angle - done)))
    return min(plans, key=lambda plan: round(math.fsum(abs(m.angle) for m in plan), 9))


def _drop_empty_moves(plan: Plan) -> Plan:
    """Return the plan without moves of no size."""
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


@explain_errors
def manoeuvre(
    system: Model,
    start: ArrayLike | Mapping[str, float] | None,
    goal: ArrayLike | Mapping[str, float],
    *,
    radius: float | None = None,
    free: Iterable[str] = (),
    budget: Budget | None = None,
) -> Manoeuvre:
    """Find a `Manoeuvre` of a rolling system from one configuration to another.

    Every velocity constraint is obeyed.

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
    q = _read_configuration(system, start, "start")
    goals = _read_configuration(system, goal, "goal")
    if radius is not None and (not is_real(radius) or not 0.0 <= radius < math.inf):
        raise InputError(
            f"radius is {radius!r}; it must be a length in metres, or 0 for turns on the spot"
        )
    spend = USUAL.complete_budget(budget)
    samples = spend.points
    time = TimeLimit(spend.time_limit)
    if not is_whole(samples) or not 2 <= samples <= MOST:
        raise InputError(
            f"points is {samples!r}; it must be a whole number, at least 2 and at most {MOST}"
        )
    time.release_reserved_time()  # there is nothing to do afterwards
    with limit_preparation_time(USUAL, time):
        axle = find_axle(system, q)
        loose = _read_free_coordinates(system, goal, free, axle)
    motion = None
    said = ""
    late = False
    try:
        with time:
            for plan in iterate_plans(
                axle, q, goals, None if radius is None else float(radius), loose
            ):
                time.check_time()
                found = _make_exact_manoeuvre(axle, q, goals, plan)
                said = "" if found is None else _describe_violation(system, found, int(samples))
                if not said:
                    motion = found
                    break
    except Refused as refusal:
        said = str(refusal)
    except TimeUp as error:
        late = True
        said = f"not found: {time.describe_end_reason(error)} came" + (f"; {said}" if said else "")
    zero = np.zeros(1)
    if motion is None:
        return Manoeuvre(
            system, q[None], zero, zero, (), 0.0, 0, not said, said, (axle.body,), late=late
        )
    t = _list_times(motion, int(samples))
    x, v = motion.evaluate_motion(t)
    slipped = compute_slip(system, t, x, v)
    if slipped > SLIP:
        raise UnsupportedError(
            f"{system.name}: the manoeuvre slips by {slipped:.2g}: its velocity constraints are "
            "not those of an axle everywhere"
        )
    turns = _correct_ends(axle, motion, x, q, goals, loose)
    return Manoeuvre(
        system,
        x,
        t,
        motion.compute_lengths(t),
        tuple(motion.pieces),
        slipped,
        turns,
        True,
        "",
        (axle.body,),
        motion,
    )


def _read_configuration(system: Model, q: Any, what: str) -> Array:
    """Read one configuration (nq,), closed or not. Errors: `InputError`."""
    if q is None:
        q = system.neutral
    given = read_mapping(q)
    array = read_q(system, q) if given is None or not has_loops(system) else make_q(system, given)
    if array.shape != (system.nq,):
        raise InputError(
            f"{what} has shape {array.shape}; it must be one configuration ({system.nq},)"
        )
    refuse_large_numbers(system, array, what)
    rows = pack_one_sided_rows(system)
    if (over := rows.compute_excess(array)).any():
        k = int(np.argmax(over))
        raise InputError(
            f"{what} has {rows.names[k]!r} = {rows.compute_values(array)[k]:.9g}; it must be between "
            f"{rows.low[k]:.9g} and {rows.high[k]:.9g}"
        )
    return array.astype(float)


def _read_free_coordinates(
    system: Model, goal: Any, free: Iterable[str], axle: Axle
) -> tuple[int, ...]:
    """Return the velocity indices of coordinates that may end anywhere.

    Errors: `InputError`, `UnknownNameError`.
    """
    names = list(system.structure.velocity_names)
    out: list[int] = []
    for name in read_names(free, "free"):
        if name not in names:
            raise UnknownNameError("coordinate", name, names, system.name)
        if names.index(name) not in axle.driven:
            those = ", ".join(repr(names[v]) for v in axle.driven) or "none"
            raise InputError(
                f"{name!r} does not roll along, so its goal counts; those that do: {those}"
            )
        out.append(names.index(name))
    given = read_mapping(goal)
    return (*out, *(v for v in axle.driven if given is not None and names[v] not in given))


def _make_exact_manoeuvre(axle: Axle, q: Array, goal: Array, plan: Plan) -> ExactManoeuvre | None:
    """Make the manoeuvre of a plan in closed form, as fast as limits allow.

    The steering moves between the moves of the plan. None for nothing to do.
    """
    system = axle.system
    i = None if axle.steering is None else axle.q_places[axle.steering]
    now = 0.0 if i is None else float(q[i])
    end = Move(0.0, 0.0, () if i is None else (float(goal[i]),))
    pieces: list[Piece] = []
    for move in (*plan, end):
        s = min(move.steering, key=lambda s: abs(s - now), default=now)
        if s != now:
            pieces.append(Piece("steer", 0.0, abs(s - now), 0.0, 0.0, math.copysign(1.0, s - now)))
        now = s
        time = max(abs(move.length), abs(move.angle))
        kind = "turn" if not move.length else "forwards" if move.length > 0.0 else "in reverse"
        if time:
            pieces.append(Piece(kind, 0.0, time, move.length / time, move.angle / time, 0.0))
    idle = np.zeros(system.nv)
    own = list(axle.idle)
    idle[own] = system.structure.layout.compute_difference(q, goal)[own]
    if not pieces and idle.any():
        pieces.append(Piece("rest", 0.0, float(np.abs(idle).max()), 0.0, 0.0, 0.0))
    if not pieces:
        return None
    pieces = _stretch_pieces(pieces, np.ones(len(pieces)))
    limits = system.structure.velocity_limits
    if np.isfinite(limits).any():
        factors = _compute_slowness(ExactManoeuvre(axle, q, np.zeros(system.nv), pieces), limits)
        total = sum(f * p.duration for f, p in zip(factors, pieces, strict=True))
        most = max(1.0, float((np.abs(idle) / limits).max()) / total)
        pieces = _stretch_pieces(pieces, factors * most)
    return ExactManoeuvre(axle, q, idle, pieces)


def _compute_slowness(motion: ExactManoeuvre, limits: Array) -> Array:
    """Compute the factors (n,) by which pieces must be slower to obey velocity limits (nv,)."""
    n = 65
    factors: list[float] = []
    for p in motion.pieces:
        inside = p.start + p.duration * (np.arange(n) + 0.5) / n
        v = np.abs(motion.evaluate_motion(inside)[1]).max(axis=0) / math.cos(
            min(0.5 * abs(p.angle) / n, 1.0)
        )
        factors.append(max(1.0, float((v / limits).max())))
    return np.array(factors)


def _stretch_pieces(pieces: Sequence[Piece], by: Array) -> list[Piece]:
    """Return the pieces one after the other, each `by` (n,) times as long."""
    out: list[Piece] = []
    start = 0.0
    for p, x in zip(pieces, by.tolist(), strict=True):
        out.append(
            Piece(p.kind, start, p.duration * x, p.forward / x, p.turning / x, p.steering / x)
        )
        start += p.duration * x
    return out


def _list_times(motion: ExactManoeuvre, samples: int) -> Array:
    """Return times (n,): the ends of all pieces, and evenly spread ones between them."""
    out = [np.zeros(1)]
    for p in motion.pieces:
        n = max(1, math.ceil(p.duration / motion.total * (samples - 1)))
        out.append(p.start + p.duration * np.arange(1, n + 1) / n)
    out[-1][-1] = motion.total
    return np.concatenate(out)


def _describe_violation(system: Model, motion: ExactManoeuvre, samples: int) -> str:
    """Describe the first limit or one-sided constraint that a motion violates; "" if none."""
    q = motion.evaluate_motion(_list_times(motion, max(samples, 200)))[0]
    if (motion.axle.compute_slide_sine(q) <= PARALLEL).any():
        slides = " and ".join(repr(system.structure.velocity_names[v]) for v in motion.axle.own[:2])
        return f"on the way {slides} would be parallel, and cannot go on"
    rows = pack_one_sided_rows(system)
    over = rows.compute_excess(q)
    if not over.any():
        return ""
    n, k = np.unravel_index(int(np.argmax(over)), over.shape)
    return (
        f"not found within the limits: {rows.names[k]!r} would get to {rows.compute_values(q[n])[k]:.6g}, "
        f"and must be between {rows.low[k]:.6g} and {rows.high[k]:.6g}"
    )


def _correct_ends(
    axle: Axle, motion: ExactManoeuvre, x: Array, q: Array, goal: Array, free: Sequence[int]
) -> int:
    """Set the first and last sample of (n, nq) to start and goal, to the last bit.

    Returned is by how many whole turns the heading is off.

    Errors: `UnsupportedError` where the motion does not lead to the goal.
    """
    system = axle.system
    end = goal.copy()
    for v in free:
        end[axle.q_places[v]] = x[-1, axle.q_places[v]]
    i = axle.own_q_places[2]
    turns = round(float(axle.gear * (x[-1, i] - goal[i])) / (2.0 * math.pi))
    end[i] += 2.0 * math.pi * turns / axle.gear
    off = np.abs(system.structure.layout.compute_difference(x[-1], end))
    size = float(np.abs(x[:, system.structure.layout.vector_q]).max(initial=0.0))
    if off.max() > 1e-12 * (1.0 + size + motion.total):
        v = int(np.argmax(off))
        name = system.structure.velocity_names[v]
        if v not in axle.driven:
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


def describe_way_there(system: Model) -> str:
    """Return the end of a sentence on whether motions lead to a configuration of a rolling system.

    A manoeuvre is named only where brackets show that motions reach every configuration around.
    """
    names = list(dict.fromkeys(name for name, *_ in list_velocity_row_names(system)))
    said = ", ".join(map(repr, names[:3])) + ", ..." * (len(names) > 3)
    hold = "holds" if len(names) == 1 else "hold"
    return f"; {_describe_motions(system).format(hold=f'{said} {hold} on the way')}"


@keep_answers
def _describe_motions(system: Model) -> str:
    """Describe what is known of motions to other configurations.

    The text has a field {hold} for the constraints.
    """
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
