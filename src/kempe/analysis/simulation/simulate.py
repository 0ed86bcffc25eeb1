"""Motion in time without masses: inputs that are velocities, and one ball or particle that falls
and bounces.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.analysis.continuation.beginning import start_of
from kempe.analysis.continuation.path import Motion
from kempe.analysis.continuation.rolling import roll, slip
from kempe.analysis.simulation.bounces import MOST, Flight, MovingFlight
from kempe.analysis.simulation.falling import falling, start_of_flight
from kempe.budget import Budget, Usual
from kempe.calls import explained, explained_methods, interruptible, numbers
from kempe.errors import InputError, UnknownNameError
from kempe.reals import is_mapping, is_real, is_whole, named, reals
from kempe.solvers.common.clock import BROKEN_OFF, LONG, TimeLimit, TimeUp, begun_within
from kempe.spatial import Array
from kempe.words import InWords, counted

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

GRAVITY = 9.81
"""Acceleration of free fall [m/s^2], down z, in the plane down y, where none is given."""
TOLERANCE = 1e-11
"""Local error of a step of integration."""
MOST_SAMPLES = 10**7
USUAL = Usual("simulate", points=200, time_limit=LONG)


@dataclass(frozen=True)
class Bounce(InWords):
    """What happened to a ball at a `time` [s], at `q` (nq,): with the gap's rate `before` and
    `after` [m/s].

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


@explained_methods
@dataclass(frozen=True, eq=False)
class Simulation(Motion):
    """A motion in time: configurations `q` (n, nq) and velocities `v` (n, nv) at times `t` (n,)
    [s].

    `events` are bounces. `success` is false where the motion ends before its time, `status` says
    why. `slip` is the largest slip of a sample, of rows and speeds of size 1. Where the work was
    `interrupted`, or the time limit came (`late`), these are the samples that were done.
    """

    also = ("t", "v", "slip", "interrupted", "late")

    system: System
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
    _at: Callable[[Array], tuple[Array, Array]] | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        return (
            f"Simulation({self.system.name!r}, {counted(len(self.t), 'sample')}, "
            f"{counted(len(self.events), 'event')})"
        )

    def at(self, t: ArrayLike) -> Array:
        """Configurations (..., nq) at times `t` (...): of a ball that falls exactly, else between
        samples (cubic).

        Errors: `InputError` for times outside.
        """
        return self._sampled(t)[0]

    def velocity(self, t: ArrayLike) -> Array:
        """Velocities (..., nv) at times `t` (...), at a bounce those after it; as `at`."""
        return self._sampled(t)[1]

    def _when(self) -> Any:
        return self.t

    def _sampled(self, t: ArrayLike) -> tuple[Array, Array]:
        t = numbers(t, "t")
        if not ((t >= self.t[0]) & (t <= self.t[-1])).all():
            raise InputError(
                f"t is outside the motion, which is known from {self.t[0]:g} to {self.t[-1]:.9g} s"
            )
        q, v = (self._at or self._between)(t.ravel())
        return q.reshape(*t.shape, self.system.nq), v.reshape(*t.shape, self.system.nv)

    def _between(self, t: Array) -> tuple[Array, Array]:
        if len(self.t) == 1:
            return np.repeat(self.q, len(t), axis=0), np.repeat(self.v, len(t), axis=0)
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2)
        h = (self.t[k + 1] - self.t[k])[:, None]
        u = (t - self.t[k])[:, None] / h
        way = self.system.structure.layout.difference(self.q[k], self.q[k + 1])
        a = h * self.v[k]
        b = h * self.v[k + 1]
        y = u * (1 - u) ** 2 * a + u * u * (3 - 2 * u) * way - u * u * (1 - u) * b
        return self.system.structure.layout.integrate(self.q[k], y), (1 - u) * self.v[
            k
        ] + u * self.v[k + 1]

    def table(self, frames: Iterable[FrameLike] = ()) -> tuple[list[str], Array]:
        """Names and columns (n, k) for a file: time, all coordinates, x, y (and z) of frames."""
        return self._columns("time", self.t, frames)

    def _sentence(self, index: tuple[int, ...]) -> str:
        text = f"{self.t[-1]:.6g} s in {counted(len(self.t), 'sample')}"
        bounces = sum(e.kind == "bounce" for e in self.events)
        if self.events:
            text += f", {counted(bounces, 'bounce')}"
            ends = [e for e in self.events if e.kind != "bounce"]
            text += (
                f"; from {ends[-1].time:.10g} s on it stays on "
                f"{' and '.join(map(repr, ends[-1].contacts))}"
                if (ends and ends[-1] is self.events[-1] and ends[-1].kind != "leaves")
                else ""
            )
        return text + self._partial() + (f"; {self.reason}" if self.reason else "")

    def _notes(self) -> Sequence[str]:
        lines = [str(e) for e in self.events[:20]]
        if len(self.events) > 20:
            lines += [f"... {len(self.events)} events in all, the last one:", str(self.events[-1])]
        return [*lines, *super()._notes()]


@explained
@interruptible
def simulate(
    system: System,
    duration: float,
    start: ArrayLike | Mapping[str, float] | str | None = None,
    *,
    inputs: Mapping[str, Any] | None = None,
    velocity: ArrayLike | Mapping[str, float] | None = None,
    acceleration: ArrayLike | None = None,
    restitution: float = 1.0,
    tolerance: float | None = None,
    budget: Budget | None = None,
) -> Simulation:
    """The motion of a system in time, for a `duration` [s] from a configuration on, as a
    `Simulation`.

    With `inputs`: velocities by name, numbers or functions of time [s]. A name is a velocity
    coordinate, or a twist of a frame in its own axes: "car.vx" [m/s], "car.wz" [rad/s]. All others
    follow from the velocity constraints and the closed loops, and are integrated with the local
    error `tolerance` (1e-11); position constraints are met at each sample to rounding. It ends
    where a coordinate meets its limit, or the inputs cannot be had.

    Without `inputs`: one ball or particle that falls from `start` with a `velocity` (nv,) (default:
    at rest) by a uniform `acceleration` (3,) [m/s^2] (default: 9.81 down z, in the plane down y),
    and bounces on what keeps it on one side of a plane: contacts, other inequalities, limits of its
    slides. Smooth planes: the normal speed is reversed times `restitution`, from 0 to 1. The answer
    is exact (times in closed form), and goes on after the infinitely many bounces that end at t1 +
    2 v / (a (1 - e)), v the speed after the impact at t1. What would need masses is refused.

    The time is 0 at the start. Equations and inequalities in time hold at every time. Planes may
    move: an impact reverses the rate of the gap, and a body that rests on a plane moves with it as
    long as the plane pushes. With planes that move, times of impacts are found numerically, from
    the gaps at 1024 places of the duration.

    Of the `budget` are read: points (200) and time_limit (600 s). `t` are so many evenly spread
    times, and those of all events. Errors: `UnsupportedError` with the reason; `InputError`, also
    for a start inside a plane, with the distance; `UnknownNameError`.
    """
    if not is_real(duration) or not 0.0 < duration < math.inf:
        raise InputError(
            f"duration is {duration!r}; it must be a time in seconds, positive and finite"
        )
    spend = USUAL.of(budget)
    samples = spend.points
    if not is_whole(samples) or not 2 <= samples <= MOST_SAMPLES:
        raise InputError(
            f"points is {samples!r}; it must be a whole number, at least 2 and at most "
            f"{MOST_SAMPLES}"
        )
    limit = TimeLimit(spend.time_limit)
    with begun_within(USUAL, limit):
        q = start_of(system, start, {}).astype(float)
    times = np.linspace(0.0, float(duration), int(samples))
    if inputs is not None:
        allowed = TOLERANCE if tolerance is None else tolerance
        return _rolls(system, q, times, inputs, velocity, acceleration, allowed, limit)
    if not is_real(restitution) or not 0.0 <= restitution <= 1.0:
        raise InputError(
            f"restitution is {restitution!r}; it must be between 0 (no rebound) and 1 (no loss)"
        )
    v = _velocity(system, velocity)
    with begun_within(USUAL, limit):
        fall = falling(system, q, v, float(duration))
        start_of_flight(fall, q)
    g = _acceleration(system, acceleration)
    gravity = fall.basis.T @ g
    first = (fall.y(q), fall.shape @ v[fall.slides_v])
    broken: BaseException | None = None
    if fall.moving is None:
        flight = Flight(fall.planes, gravity, float(restitution))
        end = float(duration)
        try:
            with limit:
                flight.run(*first, float(duration))
        except BROKEN_OFF as error:
            broken = error
            end = flight.known
        end = flight.impacts[-1].time if flight.broken else end
        reason = f"broken off after {MOST} events" if flight.broken else ""
    else:
        flight = MovingFlight(fall.moving, gravity, float(restitution), limit)
        try:
            with limit:
                flight.run(*first, float(duration))
        except BROKEN_OFF as error:
            broken = error
        end = flight.known
        reason = flight.reason
    happened = np.array([e.time for e in flight.impacts])
    t = np.union1d(times[times <= end], happened)
    x, w = fall.motion(q, v, flight, t)
    at = fall.motion(q, v, flight, happened)[0]
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
        _at=partial(fall.motion, q, v, flight),
    )


def _rolls(
    system: System,
    q: Array,
    times: Array,
    inputs: Any,
    velocity: Any,
    acceleration: Any,
    tolerance: Any,
    time: TimeLimit,
) -> Simulation:
    if not is_mapping(inputs):
        raise InputError(
            f"inputs is {type(inputs).__name__}; it must be a dict of velocities by name"
        )
    if velocity is not None or acceleration is not None:
        name = "velocity" if velocity is not None else "acceleration"
        raise InputError(
            f"{name} is for what falls by itself; with inputs all velocities follow from these"
        )
    if not is_real(tolerance) or not 1e-14 <= tolerance <= 1e-3:
        raise InputError(f"tolerance is {tolerance!r}; it must be between 1e-14 and 1e-3")
    with begun_within(USUAL, time):
        found = roll(system, inputs, q, times, float(tolerance), time)
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
        slip(system, found.t, found.q, found.v),
        interrupted,
        late,
    )


def _velocity(system: System, velocity: Any) -> Array:
    """Velocities (nv,) at the start. Errors: `InputError`, `UnknownNameError`."""
    v = np.zeros(system.nv)
    given = None if velocity is None else named(velocity)
    names = list(system.structure.velocity_names)
    if given is not None:
        for name, x in given.items():
            if name not in names:
                raise UnknownNameError("velocity", name, names, system.name)
            if not is_real(x):
                raise InputError(f"the velocity of {name!r} is {x!r}; it must be a number")
            v[names.index(name)] = x
    elif velocity is not None:
        v = reals(velocity, "velocity").astype(float)
    if v.shape != (system.nv,) or not np.isfinite(v).all():
        raise InputError(
            f"velocity has shape {v.shape}; it must be ({system.nv},) finite numbers: "
            f"{', '.join(names)}"
        )
    return v


def _acceleration(system: System, acceleration: Any) -> Array:
    """The acceleration (3,) of what falls. Errors: `InputError`."""
    if acceleration is None:
        return np.array([0.0, 0.0, -GRAVITY] if system.dim == 3 else [0.0, -GRAVITY, 0.0])
    a = reals(acceleration, "acceleration").astype(float)
    if system.dim == 2 and a.shape == (2,):
        a = np.append(a, 0.0)
    if a.shape != (3,) or not np.isfinite(a).all():
        size = "(3,) or (2,)" if system.dim == 2 else "(3,)"
        raise InputError(
            f"acceleration has shape {a.shape}; it must be {size} finite numbers in m/s^2"
        )
    return a
