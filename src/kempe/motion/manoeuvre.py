"""Manoeuvres: motions of rolling systems to a given configuration, by turns, arcs and lines.

Every velocity constraint holds along the whole way. A car with a turning radius takes the shortest
way of Reeds and Shepp (1990).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers.answer import Motion
from kempe.arguments import explain_errors, explain_method_errors, numbers
from kempe.arrays import is_real, is_whole, read_mapping
from kempe.budget import Budget, TimeUp, Usual
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.equations.velocity import list_velocity_row_names
from kempe.errors import InputError, KempeError, UnsupportedError
from kempe.mobility.classify import classify
from kempe.model.configurations import has_loops, make_q, read_q, refuse_large_numbers
from kempe.model.model import keep_answers
from kempe.motion.reeds_shepp import compute_arc_steps, follow_way, list_ways
from kempe.motion.rolling import compute_slip
from kempe.motion.wheeled import Axle, find_axle
from kempe.numerics.clock import SHORT, TimeLimit, limit_preparation_time
from kempe.numerics.roots import find_sign_change
from kempe.spatial import Array
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.argument_types import StartLike
    from kempe.model.model import FrameLike, Model


# ---- the answer


class Piece(NamedTuple):
    """A part of a manoeuvre at constant speeds.

    `forward` [m/s] and `turning` [rad/s] are those of the axle, `steering` the rate of the steering
    coordinate.
    """

    start: float
    duration: float
    forward: float
    turning: float
    steering: float

    @property
    def kind(self) -> str:
        """It is "forwards", "in reverse", "turn" on the spot, "steer" at rest, or "rest"."""
        if self.forward:
            return "forwards" if self.forward > 0.0 else "in reverse"
        return "turn" if self.turning else "steer" if self.steering else "rest"

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
        text = f"{abs(self.length):.6g} m {self.kind}"
        if self.turning:
            side = "left" if self.turning * self.forward > 0.0 else "right"
            text += f" on an arc of {abs(self.forward / self.turning):.6g} m to the {side}"
        return text


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Manoeuvre(Motion):
    """Motion from one configuration to another that obeys all velocity constraints.

    Attributes
    ----------
    q, t
        Configurations (n, nq) at times (n,) in seconds.
    pieces
        Parts with constant speeds. `at` and `velocity` give any time.
    slip
        Largest slip of a sample, for rows and speeds of size 1.
    success, status
        False if no motion was found, and the reason; `q` is then the start only.
    """

    _entries = ("t", "length", "duration", "cusps", "slip")
    interrupted = False

    system: Model
    q: Array
    t: Array
    pieces: tuple[Piece, ...]
    slip: float
    success: bool
    reason: str = ""
    frames: tuple[str, ...] = ()
    _exact: ExactManoeuvre | None = None
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
        return sum(a != b for a, b in itertools.pairwise(signs))

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
        if self._exact is None:
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
        end = f"; {self.reason}" if self.reason else ""
        if not self.pieces:
            return f"the axle stays where it is{end}" if end else "start and goal are the same"
        text = (
            f"{format_count(len(self.pieces), 'piece')}, {self.length:.6g} m in "
            f"{self.duration:.6g} s, {self.cusps or 'no'} cusp{'s' * (self.cusps != 1)}"
        )
        return text + end

    def _list_notes(self, degrees: bool = False) -> Sequence[str]:
        return [*(f"{p.start:8.4g} s: {p}" for p in self.pieces), *super()._list_notes()]


class ExactManoeuvre:
    """A manoeuvre in closed form: configurations and velocities at any time.

    In each piece the axle goes along a line or an arc, and every other coordinate has a constant
    rate: `Q` (n, nq) are the configurations and `places` (n + 1, 3) those of the axle where pieces
    begin, `V` (n, nv) the rates. `idle` (nv,) are the distances that idle coordinates go in all.
    """

    def __init__(self, axle: Axle, q: Array, idle: Array, pieces: Sequence[Piece]):
        self.axle = axle
        self.pieces = tuple(pieces)
        self.forward = np.array([p.forward for p in pieces])
        self.turning = np.array([p.turning for p in pieces])
        self.starts = np.array([p.start for p in pieces])
        duration = np.array([p.duration for p in pieces])
        self.total = pieces[-1].start + pieces[-1].duration
        self.places = follow_way(
            axle.compute_place(q), self.forward * duration, self.turning * duration
        )
        self.Q = np.empty((len(pieces), len(q)))
        self.V = np.tile(idle / self.total, (len(pieces), 1))
        for k, p in enumerate(pieces):
            self.Q[k] = q
            if axle.steering is not None:
                self.V[k, axle.steering] = p.steering
            if p.forward or p.turning:
                rates = axle.compute_driven_rates(q, p.forward, p.turning)
                if rates is None:
                    raise UnsupportedError(
                        f"{axle.system.name}: its velocity constraints do not allow to {p}"
                    )
                self.V[k, list(axle.driven)] = rates
            q = axle.system.structure.layout.integrate_velocity(q, self.V[k] * p.duration)

    def evaluate_motion(self, t: Array) -> tuple[Array, Array]:
        """Return configurations (n, nq) and velocities (n, nv) at times (n,)."""
        axle = self.axle
        k = np.clip(np.searchsorted(self.starts, t, side="right") - 1, 0, len(self.starts) - 1)
        past = t - self.starts[k]
        place = self.places[k]
        angle = self.turning[k] * past
        place[:, :2] += compute_arc_steps(place[:, 2], self.forward[k] * past, angle)
        place[:, 2] += angle
        v = self.V[k]
        q = axle.system.structure.layout.integrate_velocity(self.Q[k], v * past[:, None])
        q = axle.move_axle(q, place)
        v[:, list(axle.own)] = axle.compute_own_rates(q, self.forward[k], self.turning[k])
        return q, v

    def list_times(self, samples: int) -> Array:
        """Return times (n,): the ends of all pieces, and evenly spread ones between them."""
        out = [np.zeros(1)]
        for p in self.pieces:
            n = max(1, math.ceil(p.duration / self.total * (samples - 1)))
            out.append(p.start + p.duration * np.arange(1, n + 1) / n)
        out[-1][-1] = self.total
        return np.concatenate(out)


# ---- plans

# Which straight pieces, arcs and turns lead an axle from one place in the plane to another.

GRID = 240
"""Values of the steering, all around or between its limits, between which a wanted curvature is
looked for."""
FAR = 10.0
"""Characteristic lengths to both sides within which a steering that slides is looked through."""
EXACT = 1e-14
"""Angle between the wanted motion and the allowed one that is rounding."""


class Refused(Exception):
    """Error inside a manoeuvre that has no plan; the text says why."""


class Move(NamedTuple):
    """A part of a plan: signed length [m], angle [rad], and values of the steering for it."""

    length: float
    angle: float
    steering: tuple[float, ...] = ()


Plan = list[Move]


class Steering:
    """Values of the steering coordinate at which the axle goes straight, turns, or takes an arc."""

    def __init__(self, axle: Axle, q: Array, index: int):
        system = axle.system
        self.name = system.structure.velocity_names[index]
        self._axle = axle
        self._q = q
        self.unit = float(axle.units[0])
        self.now = float(q[axle.q_places[index]])
        reach = math.pi if system.structure.coordinates.turning[index] else FAR * self.unit
        low = float(system.lower[index])
        high = float(system.upper[index])
        low = low if math.isfinite(low) else min(self.now, high) - reach
        high = high if math.isfinite(high) else max(self.now, low) + reach
        self.grid = np.linspace(low, high, GRID + 1)
        self.bends = np.array([axle.compute_bend_angle(q, s) for s in self.grid.tolist()])

    def find_values(self, curvature: float) -> tuple[float, ...]:
        """Find the values within the limits at which the axle's path has a curvature [1/m].

        It is 0 straight, infinite on the spot.
        """
        wanted = math.atan(curvature * self.unit)

        def compute_deviation(s: float) -> float:
            """Compute the difference of the bend angle from the requested one."""
            return math.remainder(self._axle.compute_bend_angle(self._q, s) - wanted, math.pi)

        low, high = self.grid[[0, -1]].tolist()
        found = [
            s
            for s in (self.now, 0.0, low, high)
            if low <= s <= high and abs(compute_deviation(s)) < EXACT
        ]
        gap = np.array([math.remainder(b - wanted, math.pi) for b in self.bends])
        for k in np.flatnonzero((gap[:-1] * gap[1:] <= 0.0) & (np.abs(np.diff(gap)) < 1.0)):
            s = find_sign_change(compute_deviation, float(self.grid[k]), float(self.grid[k + 1]))
            if s is not None and all(abs(s - other) > 1e-9 for other in found):
                found.append(s)
        return tuple(found)

    def find_smallest_radius(self) -> float:
        """Find the smallest radius of arcs to both sides within the limits, in metres.

        It is infinite where there is none.
        """
        bend = np.tan(self.bends) / self.unit
        least = min(float(bend.max()), float(-bend.min()))
        return 1.0 / least * (1.0 + 1e-12) if least > 0.0 else math.inf


def list_plans(axle: Axle, q: Array, goal: Array, radius: float | None) -> list[Plan]:
    """List plans from one configuration (nq,) to another, the best first. Errors: `Refused`."""
    start = axle.compute_place(q)
    end = axle.compute_place(goal)
    if axle.steering is None:
        return _list_place_plans(start, end, radius or 0.0)
    steering = Steering(axle, q, axle.steering)
    values = {0.0: steering.find_values(0.0)}
    if not values[0.0]:
        raise Refused(f"no value of {steering.name!r} within its limits goes straight")
    least = steering.find_smallest_radius()
    if not radius:
        values[math.inf] = steering.find_values(math.inf)
        if values[math.inf]:
            radius = 0.0
        elif radius is None and math.isfinite(least):
            radius = least
        else:
            hint = f"; radius={least:.6g} would do" if math.isfinite(least) else ""
            raise Refused(
                f"within the limits of {steering.name!r} it does not turn on the spot{hint}"
            )
    if radius:
        values |= {bend: steering.find_values(bend) for bend in (1.0 / radius, -1.0 / radius)}
        if not (values[1.0 / radius] and values[-1.0 / radius]):
            raise Refused(
                f"within the limits of {steering.name!r} it does not take arcs of {radius:.6g} m "
                f"to both sides; the smallest radius is {least:.6g} m"
            )
    return [
        [m._replace(steering=values[_compute_bend(m, radius)]) for m in plan]
        for plan in _list_place_plans(start, end, radius)
    ]


def _compute_bend(move: Move, radius: float) -> float:
    """Compute the curvature [1/m] of a move, infinite for a turn on the spot."""
    if not move.angle:
        return 0.0
    return math.copysign(1.0 / radius, move.angle * move.length) if move.length else math.inf


def _list_place_plans(start: Array, end: Array, radius: float) -> list[Plan]:
    """List plans from one place (3,) of the axle to another, the best first."""
    dx, dy, angle = (end - start).tolist()
    if not radius:
        far = math.hypot(dx, dy)
        if far > 1e-16 * np.abs([start[:2], end[:2]]).max():
            return _list_turning_plans(math.atan2(dy, dx) - float(start[2]), far, angle)
        return [[Move(0.0, angle)] if abs(angle) > 1e-15 else []]
    c = math.cos(start[2])
    s = math.sin(start[2])
    ways = list_ways((c * dx + s * dy) / radius, (c * dy - s * dx) / radius, angle)
    return [[Move(radius * x, k * x) for k, x in way] for way in ways]


def _list_turning_plans(ahead: float, far: float, angle: float) -> list[Plan]:
    """List plans of a turn on the spot, a line of `far` metres, and a turn, by `angle` in all.

    The line leads in the direction `ahead` of the heading at the start, forwards or in reverse.
    Those with the least turning are first.
    """
    # half turns from the way on, near both ends of the turn: all between them cost the same
    near = {round((x - ahead) / math.pi) + k for x in (0.0, angle) for k in range(-2, 3)}
    options = [(ahead + k * math.pi, far if k % 2 == 0 else -far) for k in near]
    options.sort(key=lambda x: (round(abs(x[0]) + abs(angle - x[0]), 9), -x[1], abs(x[0])))
    plans = [[Move(0.0, turn), Move(line, 0.0), Move(0.0, angle - turn)] for turn, line in options]
    return [[m for m in plan if abs(m.length) > 1e-300 or abs(m.angle) > 1e-15] for plan in plans]


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
LOOKS = 65
"""Samples of a piece at which its velocities are held against their limits."""
USUAL = Usual("manoeuvre", points=200, time_limit=SHORT)


@explain_errors
def manoeuvre(
    system: Model,
    start: StartLike,
    goal: StartLike,
    *,
    radius: float | None = None,
    budget: Budget | None = None,
) -> Manoeuvre:
    """Find a motion of a rolling system between two configurations; see `System.manoeuvre`."""
    q = _read_configuration(system, start, "start")
    end = _read_configuration(system, goal, "goal")
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
    motion = None
    reason = ""
    late = False
    try:
        with time:
            for plan in list_plans(axle, q, end, None if radius is None else float(radius)):
                time.check_time()
                made = _make_exact_manoeuvre(axle, q, end, plan)
                reason = "" if made is None else _describe_violation(made, int(samples))
                if not reason:
                    motion = made
                    break
            else:
                reason = reason or "no way was found to rounding"
    except Refused as refusal:
        reason = str(refusal)
    except TimeUp as error:
        late = True
        reason = f"not found: {time.describe_end_reason(error)} came" + (reason and f"; {reason}")
    if motion is None:
        x = q[None].copy()
        good = not reason
        if good:
            x[0], reason = _find_end(axle, 0.0, x, end, read_mapping(goal))
        return Manoeuvre(system, x, np.zeros(1), (), 0.0, good, reason, (axle.body,), late=late)
    t = motion.list_times(int(samples))
    x, v = motion.evaluate_motion(t)
    slip = compute_slip(system, t, x, v)
    if slip > SLIP:
        raise UnsupportedError(
            f"{system.name}: the manoeuvre slips by {slip:.2g}: its velocity constraints are "
            "not those of an axle everywhere"
        )
    x[0] = q
    x[-1], note = _find_end(axle, motion.total, x, end, read_mapping(goal))
    return Manoeuvre(system, x, t, motion.pieces, slip, True, note, (axle.body,), motion)


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


def _make_exact_manoeuvre(axle: Axle, q: Array, goal: Array, plan: Plan) -> ExactManoeuvre | None:
    """Make the manoeuvre of a plan in closed form, as fast as limits allow.

    The steering moves between the moves of the plan. None for nothing to do.
    """
    system = axle.system
    i = None if axle.steering is None else axle.q_places[axle.steering]
    now = 0.0 if i is None else float(q[i])
    end = Move(0.0, 0.0, () if i is None else (float(goal[i]),))
    speeds: list[tuple[float, float, float, float]] = []
    for move in (*plan, end):
        steering = min(move.steering, key=lambda s: abs(s - now), default=now)
        if steering != now:
            by = steering - now
            speeds.append((abs(by), 0.0, 0.0, math.copysign(1.0, by)))
        now = steering
        time = max(abs(move.length), abs(move.angle))
        if time:
            speeds.append((time, move.length / time, move.angle / time, 0.0))
    idle = np.zeros(system.nv)
    own = list(axle.idle)
    idle[own] = system.structure.layout.compute_difference(q, goal)[own]
    if not speeds and idle.any():
        speeds.append((float(np.abs(idle).max()), 0.0, 0.0, 0.0))
    if not speeds:
        return None
    pieces = _stretch_pieces([Piece(0.0, *x) for x in speeds], np.ones(len(speeds)))
    limits = system.structure.velocity_limits
    if np.isfinite(limits).any():
        factors = _compute_slowness(ExactManoeuvre(axle, q, np.zeros(system.nv), pieces), limits)
        total = sum(f * p.duration for f, p in zip(factors, pieces, strict=True))
        most = max(1.0, float((np.abs(idle) / limits).max()) / total)
        pieces = _stretch_pieces(pieces, factors * most)
    return ExactManoeuvre(axle, q, idle, pieces)


def _compute_slowness(motion: ExactManoeuvre, limits: Array) -> Array:
    """Compute the factors (n,) by which pieces must be slower to obey velocity limits (nv,)."""
    factors: list[float] = []
    for p in motion.pieces:
        inside = p.start + p.duration * (np.arange(LOOKS) + 0.5) / LOOKS
        v = np.abs(motion.evaluate_motion(inside)[1]).max(axis=0)
        between = math.cos(min(0.5 * abs(p.angle) / LOOKS, 1.0))
        factors.append(max(1.0, float((v / limits).max()) / between))
    return np.array(factors)


def _stretch_pieces(pieces: Sequence[Piece], by: Array) -> list[Piece]:
    """Return the pieces one after the other, each `by` (n,) times as long."""
    out: list[Piece] = []
    start = 0.0
    for p, x in zip(pieces, by.tolist(), strict=True):
        out.append(Piece(start, p.duration * x, p.forward / x, p.turning / x, p.steering / x))
        start += p.duration * x
    return out


def _describe_violation(motion: ExactManoeuvre, samples: int) -> str:
    """Describe the first limit or one-sided constraint that a motion violates; "" if none."""
    axle = motion.axle
    q = motion.evaluate_motion(motion.list_times(max(samples, 200)))[0]
    if (axle.compute_slide_sine(q) <= PARALLEL).any():
        names = axle.system.structure.velocity_names
        slides = " and ".join(repr(names[v]) for v in axle.own[:2])
        return f"on the way {slides} would be parallel, and cannot go on"
    rows = pack_one_sided_rows(axle.system)
    over = rows.compute_excess(q)
    if not over.any():
        return ""
    n, k = np.unravel_index(int(np.argmax(over)), over.shape)
    return (
        f"not found within the limits: {rows.names[k]!r} would get to {rows.compute_values(q[n])[k]:.6g}, "
        f"and must be between {rows.low[k]:.6g} and {rows.high[k]:.6g}"
    )


def _find_end(
    axle: Axle, length: float, x: Array, goal: Array, named: Mapping[str, Any] | None
) -> tuple[Array, str]:
    """Find the end (nq,) to the last bit, and describe in what it differs from the goal.

    It is the goal, with the wheels and whole turns of the last of the samples (n, nq) of a motion
    of this length; `named` are the coordinates that the goal names, None for all. Errors:
    `UnsupportedError` where the samples do not lead there.
    """
    system = axle.system
    layout = system.structure.layout
    names = system.structure.velocity_names
    end = goal.copy()
    notes: list[str] = []
    i = axle.own_q_places[2]
    turns = round(float(axle.gear * (x[-1, i] - goal[i])) / (2.0 * math.pi))
    if turns:
        end[i] += 2.0 * math.pi * turns / axle.gear
        whole = format_count(abs(turns), "whole turn")
        notes.append(f"the heading ends {whole} from the number of the goal")
    for v in axle.driven:
        i = axle.q_places[v]
        end[i] = x[-1, i]
        if (named is None or names[v] in named) and abs(end[i] - goal[i]) > SLIP:
            notes.append(f"{names[v]!r} rolls along, and ends at {end[i]:.6g}")
    off = np.abs(layout.compute_difference(x[-1], end))
    size = float(np.abs(x[:, layout.vector_q]).max(initial=0.0))
    if off.max() > 1e-12 * (1.0 + size + length):
        raise UnsupportedError(
            f"{system.name}: {names[int(np.argmax(off))]!r} would miss the goal by "
            f"{off.max():.3g}: this radius is too large beside the distance for the digits of numbers"
        )
    return end, "; ".join(notes)


# ---- what is said of ways to a configuration


def describe_way_there(system: Model) -> str:
    """Return the end of a sentence on whether motions lead to a configuration of a rolling system.

    A manoeuvre is named only where brackets show that motions reach every configuration around.
    """
    names = list(dict.fromkeys(name for name, *_ in list_velocity_row_names(system)))
    said = ", ".join(map(repr, names[:3])) + ", ..." * (len(names) > 3)
    hold = "holds" if len(names) == 1 else "hold"
    return f"; {_describe_motions(system).replace('HOLD', f'{said} {hold} on the way')}"


@keep_answers
def _describe_motions(system: Model) -> str:
    """Describe what is known of motions to other configurations.

    The text has the word HOLD in place of the constraints.
    """
    unknown = "HOLD: whether a motion gets there is not known"
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
            f"HOLD, where {keep} (system.classify): a motion gets there only if the start has "
            "the same"
        )
    try:
        axle = find_axle(system, found.q)
    except UnsupportedError:
        return (
            "going there takes a motion: HOLD; there are such motions (system.classify), none is "
            "known here"
        )
    except KempeError:
        return unknown
    wheels = ", ".join(repr(system.structure.velocity_names[v]) for v in axle.driven)
    rolling = f", which lets {wheels} roll along" if wheels else ""
    return f"going there is a manoeuvre (HOLD): system.manoeuvre(start, q){rolling}"
