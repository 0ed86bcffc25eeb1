"""What falls and bounces without that its mass matters: one ball or particle, recognised from the kinematics.

The centre of the one moving body moves in a flat space of slides; turns do not move it. One-sided rows that are planes
in that space are what it bounces on, limits of its slides among them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kempe.analysis.manoeuvre.wheeled import binding
from kempe.analysis.simulation.bounces import TOUCH, Flight, Plane
from kempe.errors import InputError, UnsupportedError
from kempe.kinematics.configuration import random
from kempe.kinematics.one_sided import one_sided_rows
from kempe.kinematics.velocity.velocity import rates
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

    def y(self, q: Array) -> Array:
        """Coordinates (..., k) of the centre."""
        return q[..., self.slides_q] @ self.shape.T

    def motion(self, q: Array, v: Array, flight: Flight, t: Array) -> tuple[Array, Array]:
        """Configurations (n, nq) and velocities (n, nv) at times (n,), of a flight from q with velocities v (nv,)."""
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
    """The one ball or particle of a system, from q (nq,) with velocities v (nv,). Errors: `UnsupportedError`."""
    _no_others(system, q)
    body, point = _body(system)
    samples = np.concatenate([q[None], random(system, np.random.default_rng(SEED), (TRIALS,))])
    J = np.asarray(system.jacobian(samples, body))
    arm = system.fk(samples, body)[:, :3, :3] @ point
    centre = J[:, :3] + np.cross(J[:, 3:], arm[:, :, None], axis=1)
    turning = np.abs(J[:, 3:]).max(axis=(0, 1)) > SAME
    slides = ~turning & (np.abs(centre).max(axis=(0, 1)) > SAME)
    D = centre[0][:, slides]
    steady = np.abs(centre[:, :, slides] - D).max(initial=0.0) < SAME
    swung = np.flatnonzero(np.abs(centre[:, :, turning]).max(axis=(0, 1), initial=0.0) > SAME)
    if len(swung) or not steady:
        names = [system.structure.velocity_names[i] for i in np.flatnonzero(turning)]
        raise UnsupportedError(f"{system.name}: {', '.join(map(repr, names))} swings the centre of {body!r} about a "
                               f"joint, as a pendulum: that needs its moments of inertia; {NEEDED} one ball or "
                               "particle that slides freely")  # fmt: skip
    basis, shape = np.linalg.qr(D)
    if np.linalg.matrix_rank(shape, 1e-9) < shape.shape[1]:
        raise UnsupportedError(f"{system.name}: the slides of {body!r} are not independent; {NEEDED} one ball or "
                               "particle with independent slides")  # fmt: skip
    slides_v = np.flatnonzero(slides)
    place = dict(zip(system.structure.layout.vector_v.tolist(), system.structure.layout.vector_q.tolist(), strict=True))
    slides_q = np.array([place[int(i)] for i in slides_v], dtype=int)
    planes = _planes(system, body, q, slides_q, shape, samples)
    _turns(system, body, q, v, turning, duration)
    return Falling(system, body, slides_q, slides_v, basis, shape, planes)


def start_of_flight(fall: Falling, q: Array) -> None:
    """Refuse a start (nq,) that is not above all planes. Errors: `InputError`, with the distance."""
    for plane in fall.planes:
        gap = plane.offset + float(plane.normal @ fall.y(q))
        if gap < -TOUCH:
            raise InputError(f"the start is {-gap:.6g} m inside {plane.name!r}; a start must be above it, or touch it")


def _no_others(system: System, q: Array) -> None:
    """Refuse systems on which loops or rolling act. Errors: `UnsupportedError`."""
    if rates(system, q)[0].shape[-2]:
        raise UnsupportedError(f"{system.name} rolls (it has velocity constraints): how it would roll by itself needs "
                               "masses and moments of inertia; inputs={...} gives velocities instead")  # fmt: skip
    if held := binding(system, q):
        raise UnsupportedError(f"{system.name}: {held!r} (a loop, a rod or another position constraint) would push: "
                               f"that needs masses; {NEEDED} one ball or particle")  # fmt: skip


def _body(system: System) -> tuple[str, Array]:
    """The one moving body, and its centre (3,) in its axes. Errors: `UnsupportedError`."""
    samples = random(system, np.random.default_rng(SEED), (TRIALS,))
    moving = [b for b in system.body_names[1:] if np.abs(np.asarray(system.jacobian(samples, b))).max() > SAME]
    if not moving:
        raise UnsupportedError(f"{system.name} has no body that moves")
    first = np.linalg.inv(system.fk(samples, moving[0]))
    for other in moving[1:]:
        X = first @ system.fk(samples, other)
        if np.abs(X - X[0]).max() > SAME:
            raise UnsupportedError(f"{system.name} has several moving bodies ({moving[0]!r}, {other!r}, ...): how they "
                                   f"push each other needs masses; {NEEDED} one ball or particle")  # fmt: skip
    if len(moving) > 1:
        parts = ", ".join(map(repr, moving))
        raise UnsupportedError(f"{system.name}: {parts} are one rigid body of several parts: its centre of mass needs "
                               f"their masses; {NEEDED} one ball or particle")  # fmt: skip
    centre = system.mechanism.bodies[moving[0]].center
    return moving[0], np.zeros(3) if centre is None else np.asarray(centre, dtype=float)


def _planes(
    system: System, body: str, q: Array, slides_q: np.ndarray, shape: Array, samples: Array
) -> tuple[Plane, ...]:  # fmt: skip
    """The planes of one-sided rows. Errors: `UnsupportedError`."""
    rows = one_sided_rows(system)
    limited = [k for k in range(len(rows)) if k < rows.declared or rows.at[k - rows.declared] in slides_q]
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
                raise UnsupportedError(f"{system.name}: how {rows.names[k]!r} is touched depends on how {body!r} is "
                                       "turned (its point is not the centre): an impact there needs moments of "
                                       f"inertia; {NEEDED} one ball or particle")  # fmt: skip
            raise UnsupportedError(f"{system.name}: {rows.names[k]!r} is no plane for the centre; simulate knows "
                                   "bounces on planes")  # fmt: skip
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
) -> None:  # fmt: skip
    """Refuse bodies whose turning does not go on evenly. Errors: `UnsupportedError`."""
    moving = np.flatnonzero(turning & (v != 0.0))
    if not len(moving):
        return
    names = ", ".join(repr(system.structure.velocity_names[i]) for i in moving)
    vectors = set(system.structure.layout.vector_v.tolist())
    angles = [int(i) for i in moving if int(i) in vectors]
    if len(angles) and int(turning.sum()) > 1:
        raise UnsupportedError(f"{system.name}: {names} would not turn {body!r} evenly; give a free joint (with a "
                               "quaternion), or no turning velocity")  # fmt: skip
    for i in angles:
        place = int(system.structure.layout.vector_q[system.structure.layout.vector_v.tolist().index(i)])
        end = q[place] + v[i] * duration
        if not system.lower[i] - 1e-12 <= end <= system.upper[i] + 1e-12:
            raise UnsupportedError(f"{system.name}: {names} would turn {body!r} to its limit: an impact there needs "
                                   "its moment of inertia")  # fmt: skip
