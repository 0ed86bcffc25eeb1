"""`Manoeuvre`: the answer of `manoeuvre`, a way in pieces of even speed that is known in closed
form.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from kempe.analysis.continuation.path import Motion
from kempe.analysis.manoeuvre.wheeled import Wheeled
from kempe.calls import explained_methods, numbers
from kempe.errors import InputError, UnsupportedError
from kempe.spatial import Array
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System


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

    system: System
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
