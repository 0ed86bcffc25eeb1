"""Motions in time without masses: given velocities, or one ball that falls and bounces.

A particle moves as a ball does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers.answer import Motion
from kempe.arguments import explain_errors, explain_method_errors, numbers, raise_interrupted
from kempe.arrays import is_mapping, is_real, is_whole, read_mapping, read_reals
from kempe.budget import Budget, TimeUp, Usual
from kempe.equations import closure_rows
from kempe.equations.one_sided import OneSided, pack_one_sided_rows
from kempe.equations.velocity import evaluate_velocity_rows
from kempe.errors import InputError, UnknownNameError, UnsupportedError, format_value
from kempe.forward.fk import fk, jacobian
from kempe.model.configurations import sample_configurations
from kempe.model.time_coordinate import add_time_coordinate, list_timed_constraints
from kempe.motion.bounces import MOST, TOUCH, Flight, MovingFlight, Plane
from kempe.motion.rolling import compute_slip, integrate_rolling
from kempe.motion.start import read_start_configuration
from kempe.motion.wheeled import find_binding_constraint
from kempe.numerics.clock import BROKEN_OFF, LONG, TimeLimit, limit_preparation_time
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array
from kempe.words import InWords, format_count

if TYPE_CHECKING:
    from kempe.argument_types import StartLike
    from kempe.model.model import FrameLike, Model


# ---- the falling body and the planes below it

# The centre of the one moving body moves in a flat space of slides; turns do not move it. One-sided
# rows that are planes in that space are what it bounces on, limits of its slides among them. So its
# mass does not matter.

SAME = 1e-9
TRIALS = 5
SEED = 1687
NEEDED = "simulate knows, without masses,"


@dataclass(frozen=True, eq=False)
class Falling:
    """A falling ball or particle: its slides (indices into q and velocities), and its turning.

    The centre is `basis` @ y + a point; y = `shape` @ slides, so that y has the metric of space.
    """

    system: Model
    body: str
    slides_q: np.ndarray
    slides_v: np.ndarray
    basis: Array
    shape: Array
    planes: tuple[Plane, ...]
    """The planes, those that move as they are at time 0."""
    moving: MovingRows | None = None
    """The planes where some of them move."""

    def compute_centre(self, q: Array) -> Array:
        """Compute the coordinates (..., k) of the centre."""
        return q[..., self.slides_q] @ self.shape.T

    def compute_motion(
        self, q: Array, v: Array, flight: Flight | MovingFlight, t: Array
    ) -> tuple[Array, Array]:
        """Compute configurations (n, nq) and velocities (n, nv) at times (n,) of a flight.

        It begins at q with velocities v (nv,).
        """
        y, dy = flight.evaluate_flight(t)
        turning = v.copy()
        turning[self.slides_v] = 0.0
        out = self.system.structure.layout.integrate_velocity(q, turning * t[:, None])
        back = np.linalg.inv(self.shape)
        out[:, self.slides_q] = y @ back.T
        rate = np.repeat(turning[None], len(t), axis=0)
        rate[:, self.slides_v] = dy @ back.T
        return out, rate


def find_falling_body(system: Model, q: Array, v: Array, duration: float) -> Falling:
    """Find the one ball or particle of a system, from q (nq,) with velocities v (nv,).

    Errors: `UnsupportedError`.
    """
    _refuse_other_constraints(system, q)
    body, point = _find_moving_body(system)
    samples = np.concatenate(
        [q[None], sample_configurations(system, np.random.default_rng(SEED), (TRIALS,))]
    )
    J = np.asarray(jacobian(system, samples, body))
    arm = fk(system, samples, body)[:, :3, :3] @ point
    centre = J[:, :3] + np.cross(J[:, 3:], arm[:, :, None], axis=1)
    turning = np.abs(J[:, 3:]).max(axis=(0, 1)) > SAME
    slides = ~turning & (np.abs(centre).max(axis=(0, 1)) > SAME)
    D = centre[0][:, slides]
    steady = np.abs(centre[:, :, slides] - D).max(initial=0.0) < SAME
    swung = np.flatnonzero(np.abs(centre[:, :, turning]).max(axis=(0, 1), initial=0.0) > SAME)
    if len(swung) or not steady:
        names = [system.structure.velocity_names[i] for i in np.flatnonzero(turning)]
        raise UnsupportedError(
            f"{system.name}: {', '.join(map(repr, names))} swings the centre of {body!r} about a "
            f"joint, as a pendulum: that needs its moments of inertia; {NEEDED} one ball or "
            "particle that slides freely"
        )
    basis, shape = np.linalg.qr(D)
    if Spectrum(shape, 1.0).compute_rank(Level.CLOSED) < shape.shape[1]:
        raise UnsupportedError(
            f"{system.name}: the slides of {body!r} are not independent; {NEEDED} one ball or "
            "particle with independent slides"
        )
    slides_v = np.flatnonzero(slides)
    place = dict(
        zip(
            system.structure.layout.vector_v.tolist(),
            system.structure.layout.vector_q.tolist(),
            strict=True,
        )
    )
    slides_q = np.array([place[int(i)] for i in slides_v], dtype=int)
    moving = (
        MovingRows(system, q, slides_q, slides_v, shape, duration)
        if list_timed_constraints(system)
        else None
    )
    planes = (
        _make_planes(system, body, q, slides_q, shape, samples)
        if moving is None
        else _make_moving_planes(system, body, moving, samples, duration)
    )
    _check_turning(system, body, q, v, turning, duration)
    return Falling(system, body, slides_q, slides_v, basis, shape, planes, moving)


class MovingRows:
    """One-sided rows that are moving planes in the space of the slides.

    Row k of `rows` is the lower bound, or with a sign of -1 the upper bound, of a one-sided row of
    the clocked system.
    """

    def __init__(
        self,
        system: Model,
        q: Array,
        slides_q: np.ndarray,
        slides_v: np.ndarray,
        shape: Array,
        duration: float,
    ):
        self.rows: OneSided = pack_one_sided_rows(add_time_coordinate(system))
        self.slides_q = slides_q
        self.slides_v = slides_v
        self.back = np.linalg.inv(shape)
        self.duration = duration
        self.base = np.append(q, 0.0)
        self.base[slides_q] = 0.0
        sides = [
            (k, sign)
            for k in range(len(self.rows))
            for sign in (1.0, -1.0)
            if (k < self.rows.declared or self.rows.at[k - self.rows.declared] in slides_q)
            and math.isfinite(self.rows.low[k] if sign > 0.0 else self.rows.high[k])
        ]
        self.at_row = np.array([k for k, _ in sides], dtype=int)
        self.sign = np.array([s for _, s in sides])
        self.bound = np.where(
            self.sign > 0.0, self.rows.low[self.at_row], self.rows.high[self.at_row]
        )
        self.names = tuple(self.rows.format_bound_name(k, sign < 0.0) for k, sign in sides)
        units = closure_rows.compute_coordinate_units(self.rows.system)
        self._unscale = 1.0 / (self.rows.scale[self.at_row, None] * units)

    def select_planes(self, which: np.ndarray) -> None:
        """Keep only some of the planes, by a mask or indices."""
        self.at_row = self.at_row[which]
        self.sign = self.sign[which]
        self.bound = self.bound[which]
        self._unscale = self._unscale[which]
        self.names = tuple(n for n, keep in zip(self.names, which, strict=True) if keep)

    def _evaluate_rows(self, slides: Array, t: Array | float) -> tuple[Array, Array]:
        """Return values (..., m), less their bounds, and gradients (..., m, nv) of the rows.

        They are at slides (k,) and times (...).
        """
        x = np.repeat(self.base[None], np.size(t), axis=0)
        x[:, self.slides_q], x[:, -1] = slides, np.ravel(t)
        values, J = self.rows.compute_rates(x)
        values = self.sign * (values[:, self.at_row] - self.bound)
        J = self.sign[:, None] * J[:, self.at_row] * self._unscale
        lead = np.shape(t)
        return values.reshape(*lead, len(self.sign)), J.reshape(*lead, *J.shape[1:])

    def evaluate_planes(self, t: Array | float) -> tuple[Array, Array]:
        """Return the normals (..., m, k) and offsets (..., m) at times (...)."""
        values, J = self._evaluate_rows(np.zeros(len(self.slides_q)), t)
        return J[..., self.slides_v] @ self.back, values

    def evaluate_rates(self, t: Array | float) -> tuple[Array, Array]:
        """Return the rates of normals (..., m, k) and offsets (..., m) at times (...)."""
        k = len(self.slides_q)
        shift = self._evaluate_rows(np.zeros(k), t)[1][..., -1]
        with np.errstate(invalid="ignore"):  # a law may begin at an infinite rate
            turn = np.stack(
                [self._evaluate_rows(row, t)[1][..., -1] - shift for row in np.eye(k)], axis=-1
            )
            return turn @ self.back, shift

    def evaluate_accelerations(self, t: float) -> tuple[Array, Array]:
        """Return the second derivatives of normals (m, k) and offsets (m,).

        They are by seven differences within the duration.
        """
        h = min(1e-3, self.duration / 8192.0)
        first = min(max(t - 3.0 * h, 0.0), self.duration - 6.0 * h)
        nodes = np.arange(7.0) + (first - t) / h
        powers = np.array([nodes**i for i in range(7)])
        weights: Array = np.asarray(np.linalg.solve(powers, np.eye(7)[1]), dtype=float) / h
        turn, shift = self.evaluate_rates(first + h * np.arange(7.0))
        return (weights[:, None, None] * turn).sum(axis=0), weights @ shift


def _make_moving_planes(
    system: Model, body: str, moving: MovingRows, samples: Array, duration: float
) -> tuple[Plane, ...]:
    """Return the planes at time 0, once they are planes at all times. Errors: `UnsupportedError`."""
    rows = moving.rows
    clocks = np.linspace(0.0, duration, 4 * len(samples))
    x = np.column_stack([np.repeat(samples, 4, axis=0), clocks])
    values = moving.sign * (rows.compute_values(x)[:, moving.at_row] - moving.bound)
    N, o = moving.evaluate_planes(clocks)
    predicted = (N @ np.linalg.solve(moving.back, x[:, moving.slides_q].T).T[..., None])[..., 0] + o
    off = np.abs(values - predicted).max(axis=0, initial=0.0)
    size = 1.0 + np.abs(predicted).max(axis=0, initial=0.0)
    for name, miss, large in zip(moving.names, off, size, strict=True):
        if not miss <= SAME * large:
            raise UnsupportedError(
                f"{system.name}: {name!r} is no plane for the centre of {body!r} at every time; "
                "simulate knows bounces on planes, which may move"
            )
    moving.select_planes(np.linalg.norm(N, axis=-1).max(axis=0, initial=0.0) >= SAME)
    N, o = moving.evaluate_planes(0.0)
    return tuple(Plane(*each) for each in zip(moving.names, N, o.tolist(), strict=True))


def check_flight_start(fall: Falling, q: Array) -> None:
    """Refuse a start (nq,) that is not above all planes. Errors: `InputError`, with the distance."""
    for plane in fall.planes:
        gap = plane.offset + float(plane.normal @ fall.compute_centre(q))
        if gap < -TOUCH:
            raise InputError(
                f"the start is {-gap:.6g} m inside {plane.name!r}; a start must be above it, or "
                "touch it"
            )


def _refuse_other_constraints(system: Model, q: Array) -> None:
    """Refuse systems with loops or rolling constraints. Errors: `UnsupportedError`."""
    if list_timed_constraints(system):
        system = add_time_coordinate(system)
        q = np.append(q, 0.0)
    if evaluate_velocity_rows(system, q)[0].shape[-2]:
        raise UnsupportedError(
            f"{system.name} rolls (it has velocity constraints): how it would roll by itself needs "
            "masses and moments of inertia; inputs={...} gives velocities instead"
        )
    if held := find_binding_constraint(system, q):
        raise UnsupportedError(
            f"{system.name}: {held!r} (a loop, a rod or another position constraint) would push: "
            f"that needs masses; {NEEDED} one ball or particle"
        )


def _find_moving_body(system: Model) -> tuple[str, Array]:
    """Find the one moving body, and its centre (3,) in its axes. Errors: `UnsupportedError`."""
    samples = sample_configurations(system, np.random.default_rng(SEED), (TRIALS,))
    moving = [
        b
        for b in system.body_names[1:]
        if np.abs(np.asarray(jacobian(system, samples, b))).max() > SAME
    ]
    if not moving:
        raise UnsupportedError(f"{system.name} has no body that moves")
    first = np.linalg.inv(fk(system, samples, moving[0]))
    for other in moving[1:]:
        X = first @ fk(system, samples, other)
        if np.abs(X - X[0]).max() > SAME:
            raise UnsupportedError(
                f"{system.name} has several moving bodies ({moving[0]!r}, {other!r}, ...): how "
                f"they push each other needs masses; {NEEDED} one ball or particle"
            )
    if len(moving) > 1:
        parts = ", ".join(map(repr, moving))
        raise UnsupportedError(
            f"{system.name}: {parts} are one rigid body of several parts: its centre of mass needs "
            f"their masses; {NEEDED} one ball or particle"
        )
    centre = system._mechanism.bodies[moving[0]].center
    return moving[0], np.zeros(3) if centre is None else np.asarray(centre, dtype=float)


def _make_planes(
    system: Model, body: str, q: Array, slides_q: np.ndarray, shape: Array, samples: Array
) -> tuple[Plane, ...]:
    """Return the planes of one-sided rows. Errors: `UnsupportedError`."""
    rows = pack_one_sided_rows(system)
    limited = [
        k for k in range(len(rows)) if k < rows.declared or rows.at[k - rows.declared] in slides_q
    ]
    if not limited:
        return ()
    base = q.copy()
    base[slides_q] = 0.0
    moved = np.repeat(base[None], len(slides_q), axis=0)
    moved[np.arange(len(slides_q)), slides_q] = 1.0
    origin = rows.compute_values(base)[limited]
    slope = rows.compute_values(moved)[:, limited] - origin
    trials = samples.copy()
    predicted = origin + trials[:, slides_q] @ slope
    off = np.abs(rows.compute_values(trials)[:, limited] - predicted).max(axis=0)
    size = 1.0 + np.abs(predicted).max(axis=0)
    for k, miss, large in zip(limited, off, size, strict=True):
        if miss > SAME * large:
            turned = np.repeat(base[None], len(trials), axis=0)
            turned[:, slides_q] = trials[:, slides_q]
            kept = np.abs(rows.compute_values(turned)[:, limited] - predicted).max(axis=0)[
                limited.index(k)
            ]
            if kept <= SAME * large:
                raise UnsupportedError(
                    f"{system.name}: how {rows.names[k]!r} is touched depends on how {body!r} is "
                    "turned (its point is not the centre): an impact there needs moments of "
                    f"inertia; {NEEDED} one ball or particle"
                )
            raise UnsupportedError(
                f"{system.name}: {rows.names[k]!r} is no plane for the centre; simulate knows "
                "bounces on planes"
            )
    planes: list[Plane] = []
    back = np.linalg.inv(shape)
    for k, at, column in zip(limited, origin, slope.T, strict=True):
        normal = column @ back
        if np.linalg.norm(normal) < SAME:
            continue
        for upper, end in ((False, rows.low[k]), (True, rows.high[k])):
            if math.isfinite(end):
                sign = -1.0 if upper else 1.0
                planes.append(
                    Plane(rows.format_bound_name(k, upper), sign * normal, float(sign * (at - end)))
                )
    return tuple(planes)


def _check_turning(
    system: Model, body: str, q: Array, v: Array, turning: np.ndarray, duration: float
) -> None:
    """Refuse bodies that do not turn at constant angular velocity. Errors: `UnsupportedError`."""
    moving = np.flatnonzero(turning & (v != 0.0))
    if not len(moving):
        return
    names = ", ".join(repr(system.structure.velocity_names[i]) for i in moving)
    vectors = set(system.structure.layout.vector_v.tolist())
    angles = [int(i) for i in moving if int(i) in vectors]
    if len(angles) and int(turning.sum()) > 1:
        raise UnsupportedError(
            f"{system.name}: {names} would not turn {body!r} evenly; give a free joint (with a "
            "quaternion), or no turning velocity"
        )
    for i in angles:
        place = int(
            system.structure.layout.vector_q[system.structure.layout.vector_v.tolist().index(i)]
        )
        end = q[place] + v[i] * duration
        if not system.lower[i] - 1e-12 <= end <= system.upper[i] + 1e-12:
            raise UnsupportedError(
                f"{system.name}: {names} would turn {body!r} to its limit: an impact there needs "
                "its moment of inertia"
            )


# ---- the answer and the verb

GRAVITY = 9.81
"""Acceleration of free fall [m/s^2], down z, in the plane down y, where none is given."""
TOLERANCE = 1e-11
"""Local error of a step of integration."""
MOST_SAMPLES = 10**7
USUAL = Usual("simulate", points=200, time_limit=LONG)


@dataclass(frozen=True)
class Bounce(InWords):
    """An event of a ball at a `time` [s], at `q` (nq,).

    `before` and `after` are rates of the gap [m/s].

    `kind` is "bounce", "lands" (it stays on the plane), "settles" (infinitely many bounces have
    ended), or "leaves" (a plane that moves would have to pull from then on). `contacts` are the
    names of the planes or limits.
    """

    kind: str
    time: float
    contacts: tuple[str, ...]
    before: float
    after: float
    q: Array = field(repr=False, compare=False)

    def __str__(self) -> str:
        where = " and ".join(map(repr, self.contacts))
        if self.kind == "settles":
            return f"{self.time:.10g} s: settles on {where}, after infinitely many bounces"
        if self.kind == "leaves":
            return f"{self.time:.10g} s: leaves {where}"
        rebound = f", {self.after:.6g} m/s after it" if self.kind == "bounce" else ", and stays"
        return f"{self.time:.10g} s: {self.kind} on {where} with {-self.before:.6g} m/s{rebound}"


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Motion):
    """Motion in time.

    Attributes
    ----------
    t, q, v
        Times (n,) in seconds, configurations (n, nq) and velocities (n, nv).
    events
        Bounces.
    success, status
        False if the motion ends before its time, and the reason.
    slip
        Largest slip of a sample, for rows and speeds of size 1.
    late, interrupted
        Whether the time limit or Ctrl-C ended the work; the finished samples remain.
    """

    _entries = ("t", "v", "slip", "interrupted", "late")

    system: Model
    t: Array
    q: Array
    v: Array
    events: tuple[Bounce, ...]
    success: bool
    reason: str = ""
    slip: float = 0.0
    interrupted: bool = False
    late: bool = False
    frames: tuple[str, ...] = ()
    _at: Callable[[Array], tuple[Array, Array]] | None = None

    def at(self, t: ArrayLike) -> Array:
        """Return configurations (..., nq) at times `t` (...) in seconds.

        Those of a falling ball are exact, others cubic between samples.

        Errors: `InputError` for times outside.
        """
        return self._evaluate_motion(t)[0]

    def velocity(self, t: ArrayLike) -> Array:
        """Return velocities (..., nv) at times `t` (...) in seconds; at a bounce, after the bounce.

        See `at`.
        """
        return self._evaluate_motion(t)[1]

    def _list_times(self) -> Any:
        return self.t

    def _evaluate_motion(self, t: ArrayLike) -> tuple[Array, Array]:
        """Return configurations (..., nq) and velocities (..., nv) at times `t` (...)."""
        t = numbers(t, "t")
        if not ((t >= self.t[0]) & (t <= self.t[-1])).all():
            raise InputError(
                f"t is outside the motion, which is known from {self.t[0]:g} to {self.t[-1]:.9g} s"
            )
        q, v = (self._at or self._interpolate_samples)(t.ravel())
        return q.reshape(*t.shape, self.system.nq), v.reshape(*t.shape, self.system.nv)

    def _interpolate_samples(self, t: Array) -> tuple[Array, Array]:
        """Return configurations and velocities between samples, at times (n,)."""
        if len(self.t) == 1:
            return np.repeat(self.q, len(t), axis=0), np.repeat(self.v, len(t), axis=0)
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2)
        h = (self.t[k + 1] - self.t[k])[:, None]
        u = (t - self.t[k])[:, None] / h
        way = self.system.structure.layout.compute_difference(self.q[k], self.q[k + 1])
        a = h * self.v[k]
        b = h * self.v[k + 1]
        y = u * (1 - u) ** 2 * a + u * u * (3 - 2 * u) * way - u * u * (1 - u) * b
        return self.system.structure.layout.integrate_velocity(self.q[k], y), (1 - u) * self.v[
            k
        ] + u * self.v[k + 1]

    def table(self, frames: Iterable[FrameLike] = ()) -> tuple[list[str], Array]:
        """Return names and columns (n, k) for a file: time, coordinates, x, y (and z) of frames."""
        return self._make_columns("time", self.t, frames)

    def _compose_sentence(self, index: tuple[int, ...]) -> str:
        text = f"{self.t[-1]:.6g} s in {format_count(len(self.t), 'sample')}"
        bounces = sum(e.kind == "bounce" for e in self.events)
        if self.events:
            text += f", {format_count(bounces, 'bounce')}"
            ends = [e for e in self.events if e.kind != "bounce"]
            text += (
                f"; from {ends[-1].time:.10g} s on it stays on "
                f"{' and '.join(map(repr, ends[-1].contacts))}"
                if (ends and ends[-1] is self.events[-1] and ends[-1].kind != "leaves")
                else ""
            )
        return text + self._describe_early_end() + (f"; {self.reason}" if self.reason else "")

    def _list_notes(self, degrees: bool = False) -> Sequence[str]:
        lines = [str(e) for e in self.events[:20]]
        if len(self.events) > 20:
            lines += [f"... {len(self.events)} events in all, the last one:", str(self.events[-1])]
        return [*lines, *super()._list_notes()]


@explain_errors
@raise_interrupted
def simulate(
    system: Model,
    duration: float,
    start: StartLike | None = None,
    *,
    inputs: Mapping[str, Any] | None = None,
    velocity: ArrayLike | Mapping[str, float] | None = None,
    acceleration: ArrayLike | None = None,
    restitution: float = 1.0,
    tolerance: float | None = None,
    budget: Budget | None = None,
) -> Simulation:
    """Simulate a system for a `duration` [s] from a start; see `System.simulate`."""
    if not is_real(duration) or not 0.0 < duration < math.inf:
        raise InputError(
            f"duration is {duration!r}; it must be a time in seconds, positive and finite"
        )
    spend = USUAL.complete_budget(budget)
    samples = spend.points
    if not is_whole(samples) or not 2 <= samples <= MOST_SAMPLES:
        raise InputError(
            f"points is {samples!r}; it must be a whole number, at least 2 and at most "
            f"{MOST_SAMPLES}"
        )
    limit = TimeLimit(spend.time_limit)
    with limit_preparation_time(USUAL, limit):
        q = read_start_configuration(system, start, {}).astype(float)
    times = np.linspace(0.0, float(duration), int(samples))
    if inputs is not None:
        allowed = TOLERANCE if tolerance is None else tolerance
        return _simulate_rolling(system, q, times, inputs, velocity, acceleration, allowed, limit)
    if not is_real(restitution) or not 0.0 <= restitution <= 1.0:
        raise InputError(
            f"restitution is {restitution!r}; it must be between 0 (no rebound) and 1 (no loss)"
        )
    v = _read_velocity(system, velocity)
    with limit_preparation_time(USUAL, limit):
        fall = find_falling_body(system, q, v, float(duration))
        check_flight_start(fall, q)
    g = _read_acceleration(system, acceleration)
    gravity = fall.basis.T @ g
    first = (fall.compute_centre(q), fall.shape @ v[fall.slides_v])
    broken: BaseException | None = None
    if fall.moving is None:
        flight = Flight(fall.planes, gravity, float(restitution))
        end = float(duration)
        try:
            with limit:
                flight.compute_flight(*first, float(duration))
        except BROKEN_OFF as error:
            broken = error
            end = flight.known
        end = flight.impacts[-1].time if flight.broken else end
        reason = f"broken off after {MOST} events" if flight.broken else ""
    else:
        flight = MovingFlight(fall.moving, gravity, float(restitution), limit)
        try:
            with limit:
                flight.compute_flight(*first, float(duration))
        except BROKEN_OFF as error:
            broken = error
        end = flight.known
        reason = flight.reason
    happened = np.array([e.time for e in flight.impacts])
    t = np.union1d(times[times <= end], happened)
    x, w = fall.compute_motion(q, v, flight, t)
    at = fall.compute_motion(q, v, flight, happened)[0]
    names = [p.name for p in fall.planes]
    events = tuple(
        Bounce(e.kind, e.time, tuple(names[i] for i in e.planes), e.before, e.after, at[k])
        for k, e in enumerate(flight.impacts)
    )
    return Simulation(
        system,
        t,
        x,
        w,
        events,
        not reason and broken is None,
        reason,
        interrupted=isinstance(broken, KeyboardInterrupt),
        late=isinstance(broken, TimeUp),
        frames=(fall.body,),
        _at=partial(fall.compute_motion, q, v, flight),
    )


def _simulate_rolling(
    system: Model,
    q: Array,
    times: Array,
    inputs: Any,
    velocity: Any,
    acceleration: Any,
    tolerance: Any,
    time: TimeLimit,
) -> Simulation:
    """Simulate a system under input velocities."""
    if not is_mapping(inputs):
        raise InputError(
            f"inputs is {format_value(inputs)}; it must be a dict of velocities by name"
        )
    if velocity is not None or acceleration is not None:
        name = "velocity" if velocity is not None else "acceleration"
        raise InputError(
            f"{name} is for what falls by itself; with inputs all velocities follow from these"
        )
    if not is_real(tolerance) or not 1e-14 <= tolerance <= 1e-3:
        raise InputError(f"tolerance is {tolerance!r}; it must be between 1e-14 and 1e-3")
    with limit_preparation_time(USUAL, time):
        found = integrate_rolling(system, inputs, q, times, float(tolerance), time)
    late = isinstance(found.broken, TimeUp)
    interrupted = isinstance(found.broken, KeyboardInterrupt)
    return Simulation(
        system,
        found.t,
        found.q,
        found.v,
        (),
        not found.reason and found.broken is None,
        found.reason,
        compute_slip(system, found.t, found.q, found.v),
        interrupted,
        late,
    )


def _read_velocity(system: Model, velocity: Any) -> Array:
    """Read the velocities (nv,) at the start. Errors: `InputError`, `UnknownNameError`."""
    v = np.zeros(system.nv)
    given = None if velocity is None else read_mapping(velocity)
    names = list(system.structure.velocity_names)
    if given is not None:
        for name, x in given.items():
            if name not in names:
                raise UnknownNameError("velocity", name, names, system.name)
            if not is_real(x):
                raise InputError(f"the velocity of {name!r} is {x!r}; it must be a number")
            v[names.index(name)] = x
    elif velocity is not None:
        v = read_reals(velocity, "velocity").astype(float)
    if v.shape != (system.nv,) or not np.isfinite(v).all():
        raise InputError(
            f"velocity has shape {v.shape}; it must be ({system.nv},) finite numbers: "
            f"{', '.join(names)}"
        )
    return v


def _read_acceleration(system: Model, acceleration: Any) -> Array:
    """Read the acceleration (3,) of the falling body in m/s^2. Errors: `InputError`."""
    if acceleration is None:
        return np.array([0.0, 0.0, -GRAVITY] if system.dim == 3 else [0.0, -GRAVITY, 0.0])
    a = read_reals(acceleration, "acceleration").astype(float)
    if system.dim == 2 and a.shape == (2,):
        a = np.append(a, 0.0)
    if a.shape != (3,) or not np.isfinite(a).all():
        size = "(3,) or (2,)" if system.dim == 2 else "(3,)"
        raise InputError(
            f"acceleration has shape {a.shape}; it must be {size} finite numbers in m/s^2"
        )
    return a
