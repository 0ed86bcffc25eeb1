"""What falls and bounces without that its mass matters: one ball or particle, recognised from the
kinematics.

The centre of the one moving body moves in a flat space of slides; turns do not move it. One-sided
rows that are planes in that space are what it bounces on, limits of its slides among them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kempe.analysis.manoeuvre.wheeled import binding
from kempe.analysis.simulation.bounces import TOUCH, Flight, MovingFlight, Plane
from kempe.errors import InputError, UnsupportedError
from kempe.kinematics import closure_rows
from kempe.kinematics.configuration import random
from kempe.kinematics.forward import fk, jacobian
from kempe.kinematics.one_sided import OneSided, one_sided_rows
from kempe.kinematics.velocity.velocity import rates
from kempe.model.clocked import clocked, timed
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

SAME = 1e-9
TRIALS = 5
SEED = 1687
NEEDED = "simulate knows, without masses,"


@dataclass(frozen=True, eq=False)
class Falling:
    """A ball or particle: its slides (indices into q and velocities), and what turns it.

    The centre is `basis` @ y + a point; y = `shape` @ slides, so that y has the metric of space.
    """

    system: System
    body: str
    slides_q: np.ndarray
    slides_v: np.ndarray
    basis: Array
    shape: Array
    planes: tuple[Plane, ...]
    """The planes, those that move as they are at time 0."""
    moving: MovingRows | None = None
    """The planes where some of them move."""

    def y(self, q: Array) -> Array:
        """Coordinates (..., k) of the centre."""
        return q[..., self.slides_q] @ self.shape.T

    def motion(
        self, q: Array, v: Array, flight: Flight | MovingFlight, t: Array
    ) -> tuple[Array, Array]:
        """Configurations (n, nq) and velocities (n, nv) at times (n,), of a flight from q with
        velocities v (nv,).
        """
        y, dy = flight.at(t)
        turning = v.copy()
        turning[self.slides_v] = 0.0
        out = self.system.structure.layout.integrate(q, turning * t[:, None])
        back = np.linalg.inv(self.shape)
        out[:, self.slides_q] = y @ back.T
        rate = np.repeat(turning[None], len(t), axis=0)
        rate[:, self.slides_v] = dy @ back.T
        return out, rate


def falling(system: System, q: Array, v: Array, duration: float) -> Falling:
    """The one ball or particle of a system, from q (nq,) with velocities v (nv,). Errors:
    `UnsupportedError`.
    """
    _no_others(system, q)
    body, point = _body(system)
    samples = np.concatenate([q[None], random(system, np.random.default_rng(SEED), (TRIALS,))])
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
    if np.linalg.matrix_rank(shape, 1e-9) < shape.shape[1]:
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
    moving = MovingRows(system, q, slides_q, slides_v, shape, duration) if timed(system) else None
    planes = (
        _planes(system, body, q, slides_q, shape, samples)
        if moving is None
        else _moving_planes(system, body, moving, samples, duration)
    )
    _turns(system, body, q, v, turning, duration)
    return Falling(system, body, slides_q, slides_v, basis, shape, planes, moving)


class MovingRows:
    """One-sided rows that are planes in the space of the slides, as laws of time.

    Row k of `rows` is the lower bound, or with a sign of -1 the upper bound, of a one-sided row of
    the clocked system.
    """

    def __init__(
        self,
        system: System,
        q: Array,
        slides_q: np.ndarray,
        slides_v: np.ndarray,
        shape: Array,
        duration: float,
    ):
        self.rows: OneSided = one_sided_rows(clocked(system))
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
        self.names = tuple(self.rows.side(k, sign < 0.0) for k, sign in sides)
        units = closure_rows.scales(self.rows.system)
        self._unscale = 1.0 / (self.rows.scale[self.at_row, None] * units)

    def only(self, which: np.ndarray) -> None:
        """Keep only some of the planes."""
        self.at_row = self.at_row[which]
        self.sign = self.sign[which]
        self.bound = self.bound[which]
        self._unscale = self._unscale[which]
        self.names = tuple(n for n, keep in zip(self.names, which, strict=True) if keep)

    def _read(self, slides: Array, t: Array | float) -> tuple[Array, Array]:
        """Values (..., m), less their bounds, and gradients (..., m, nv) at slides (k,) and times
        (...).
        """
        x = np.repeat(self.base[None], np.size(t), axis=0)
        x[:, self.slides_q], x[:, -1] = slides, np.ravel(t)
        values, J = self.rows.rates(x)
        values = self.sign * (values[:, self.at_row] - self.bound)
        J = self.sign[:, None] * J[:, self.at_row] * self._unscale
        lead = np.shape(t)
        return values.reshape(*lead, len(self.sign)), J.reshape(*lead, *J.shape[1:])

    def at(self, t: Array | float) -> tuple[Array, Array]:
        """Normals (..., m, k) and offsets (..., m) at times (...)."""
        values, J = self._read(np.zeros(len(self.slides_q)), t)
        return J[..., self.slides_v] @ self.back, values

    def rates(self, t: Array | float) -> tuple[Array, Array]:
        """Rates of normals (..., m, k) and offsets (..., m) at times (...)."""
        k = len(self.slides_q)
        shift = self._read(np.zeros(k), t)[1][..., -1]
        with np.errstate(invalid="ignore"):  # a law may begin at an infinite rate
            turn = np.stack([self._read(row, t)[1][..., -1] - shift for row in np.eye(k)], axis=-1)
            return turn @ self.back, shift

    def accelerations(self, t: float) -> tuple[Array, Array]:
        """Second derivatives of normals (m, k) and offsets (m,), by seven differences within the
        duration.
        """
        h = min(1e-3, self.duration / 8192.0)
        first = min(max(t - 3.0 * h, 0.0), self.duration - 6.0 * h)
        nodes = np.arange(7.0) + (first - t) / h
        powers = np.array([nodes**i for i in range(7)])
        weights: Array = np.asarray(np.linalg.solve(powers, np.eye(7)[1]), dtype=float) / h
        turn, shift = self.rates(first + h * np.arange(7.0))
        return (weights[:, None, None] * turn).sum(axis=0), weights @ shift


def _moving_planes(
    system: System, body: str, moving: MovingRows, samples: Array, duration: float
) -> tuple[Plane, ...]:
    """The planes at time 0, once they are planes at all times. Errors: `UnsupportedError`."""
    rows = moving.rows
    clocks = np.linspace(0.0, duration, 4 * len(samples))
    x = np.column_stack([np.repeat(samples, 4, axis=0), clocks])
    values = moving.sign * (rows.values(x)[:, moving.at_row] - moving.bound)
    N, o = moving.at(clocks)
    predicted = (N @ np.linalg.solve(moving.back, x[:, moving.slides_q].T).T[..., None])[..., 0] + o
    off = np.abs(values - predicted).max(axis=0, initial=0.0)
    size = 1.0 + np.abs(predicted).max(axis=0, initial=0.0)
    for name, miss, large in zip(moving.names, off, size, strict=True):
        if not miss <= SAME * large:
            raise UnsupportedError(
                f"{system.name}: {name!r} is no plane for the centre of {body!r} at every time; "
                "simulate knows bounces on planes, which may move"
            )
    moving.only(np.linalg.norm(N, axis=-1).max(axis=0, initial=0.0) >= SAME)
    N, o = moving.at(0.0)
    return tuple(Plane(*each) for each in zip(moving.names, N, o.tolist(), strict=True))


def start_of_flight(fall: Falling, q: Array) -> None:
    """Refuse a start (nq,) that is not above all planes. Errors: `InputError`, with the distance."""
    for plane in fall.planes:
        gap = plane.offset + float(plane.normal @ fall.y(q))
        if gap < -TOUCH:
            raise InputError(
                f"the start is {-gap:.6g} m inside {plane.name!r}; a start must be above it, or "
                "touch it"
            )


def _no_others(system: System, q: Array) -> None:
    """Refuse systems on which loops or rolling act. Errors: `UnsupportedError`."""
    if timed(system):
        system = clocked(system)
        q = np.append(q, 0.0)
    if rates(system, q)[0].shape[-2]:
        raise UnsupportedError(
            f"{system.name} rolls (it has velocity constraints): how it would roll by itself needs "
            "masses and moments of inertia; inputs={...} gives velocities instead"
        )
    if held := binding(system, q):
        raise UnsupportedError(
            f"{system.name}: {held!r} (a loop, a rod or another position constraint) would push: "
            f"that needs masses; {NEEDED} one ball or particle"
        )


def _body(system: System) -> tuple[str, Array]:
    """The one moving body, and its centre (3,) in its axes. Errors: `UnsupportedError`."""
    samples = random(system, np.random.default_rng(SEED), (TRIALS,))
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
    centre = system.mechanism.bodies[moving[0]].center
    return moving[0], np.zeros(3) if centre is None else np.asarray(centre, dtype=float)


def _planes(
    system: System, body: str, q: Array, slides_q: np.ndarray, shape: Array, samples: Array
) -> tuple[Plane, ...]:
    """The planes of one-sided rows. Errors: `UnsupportedError`."""
    rows = one_sided_rows(system)
    limited = [
        k for k in range(len(rows)) if k < rows.declared or rows.at[k - rows.declared] in slides_q
    ]
    if not limited:
        return ()
    base = q.copy()
    base[slides_q] = 0.0
    moved = np.repeat(base[None], len(slides_q), axis=0)
    moved[np.arange(len(slides_q)), slides_q] = 1.0
    origin = rows.values(base)[limited]
    slope = rows.values(moved)[:, limited] - origin
    trials = samples.copy()
    predicted = origin + trials[:, slides_q] @ slope
    off = np.abs(rows.values(trials)[:, limited] - predicted).max(axis=0)
    size = 1.0 + np.abs(predicted).max(axis=0)
    for k, miss, large in zip(limited, off, size, strict=True):
        if miss > SAME * large:
            turned = np.repeat(base[None], len(trials), axis=0)
            turned[:, slides_q] = trials[:, slides_q]
            kept = np.abs(rows.values(turned)[:, limited] - predicted).max(axis=0)[limited.index(k)]
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
                planes.append(Plane(rows.side(k, upper), sign * normal, float(sign * (at - end))))
    return tuple(planes)


def _turns(
    system: System, body: str, q: Array, v: Array, turning: np.ndarray, duration: float
) -> None:
    """Refuse bodies whose turning does not go on evenly. Errors: `UnsupportedError`."""
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
