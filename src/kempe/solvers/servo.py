"""One step of the differential inverse model: velocities that give a frame a twist, within all limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.errors import InputError
from kempe.kinematics.configuration import as_q
from kempe.solvers.chain import chain_of
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

NEAR = 0.05
"""Singular values below it are damped, those at zero fully."""
FLAT = 1e-13
"""Singular values below this fraction of the largest are zero: freedoms that the frame does not see."""
LEAST = 1e-5
"""Weight of small velocities against the twist, so that the best ones are unique."""
SHRINK, LEAST_SCALED = 1e-4, 1e-8
"""Weights, against the direction of a twist, of having it in full and of small velocities."""
INWARD = 1e-14
"""Gradients below this fraction of what is asked release no bound: rounding."""


@dataclass(frozen=True, eq=False)
class IkStep:
    """Velocities of one step: `q` (nq,) after it, `velocity` (nv,), and the `twist` (6,) that they give the frame.

    `fraction` is the part of the wanted twist in that, 1 where it is had in full; `saturated` names the coordinates
    that are at a limit of position or velocity.
    """

    q: Array
    velocity: Array
    twist: Array
    fraction: float
    saturated: tuple[str, ...]


class Servo:
    """All of a frame's steps that does not depend on the configuration, looked up once."""

    def __init__(self, system: System, frame: str):
        self.system, self.frame, self.query = system, frame, system.query(frame)
        self.v = chain_of(system, frame).v_index
        layout = system.layout
        place = dict(zip(layout.vector_v.tolist(), layout.vector_q.tolist(), strict=True))
        limited = [(k, place[v]) for k, v in enumerate(self.v.tolist()) if v in place]
        self.at_v = np.array([k for k, _ in limited], dtype=np.int64)
        self.at_q = np.array([i for _, i in limited], dtype=np.int64)
        own = self.v[self.at_v]
        self.lower, self.upper, self.speed = system.lower[own], system.upper[own], system.velocity_limits[self.v]
        self.plain = len(limited) == len(self.v)
        self.names = [system.velocity_names[i] for i in self.v]

    def box(self, q: Array, dt: float, speed: Array) -> tuple[Array, Array]:
        """Least and largest velocities (n,) for which limits of position and speed hold after dt.

        What is outside its limits comes back as fast as it may.
        """
        x = q[self.at_q]
        low, high = -speed, speed.copy()
        low[self.at_v] = np.minimum(np.maximum(low[self.at_v], (self.lower - x) / dt), speed[self.at_v])
        high[self.at_v] = np.maximum(np.minimum(high[self.at_v], (self.upper - x) / dt), -speed[self.at_v])
        return low, high

    def after(self, q: Array, velocity: Array, dt: float) -> Array:
        """The configuration (nq,) after dt, limits kept to the last bit where q kept them."""
        if not self.plain:
            out = self.system.integrate(q, velocity * dt)
        else:
            out = q.copy()
            out[self.at_q] += velocity[self.v] * dt
        x = q[self.at_q]
        out[self.at_q] = np.minimum(np.maximum(out[self.at_q], np.minimum(self.lower, x)), np.maximum(self.upper, x))
        return out


def ik_step(
    system: System, q: Any, wanted: Any, frame: FrameLike, dt: float, *, velocity_limits: Any = None,
    damping: float = 0.05, keep_direction: bool = False, weights: Any = None,
) -> IkStep:  # fmt: skip
    """The step that gives a frame the wanted twist for the time dt [s], as nearly as limits allow.

    `wanted` is a twist (6,), [linear; angular] of the frame's origin in ground axes, or a pose (4, 4) to be reached in
    dt. The velocities make the squared error of the twist least (`weights` (6,) of its rows, zero where a row does not
    count) and, among those that do, their own size; near singularities the directions that are hard to move in are
    damped, by at most `damping` (Maciejewski and Klein, 1988). They stay in `velocity_limits` (a number or (nv,),
    default: those of the system), and no coordinate leaves its limits within dt: bounds are met by an active set, so
    that other joints take over (Stark and Parker, 1995). With `keep_direction` the twist is scaled instead of bent:
    what is had is the largest part of it that the limits allow, from 0 to 1, and that takes the place of damping.
    Errors: `InputError`, and `UnsupportedError` where loops or relations move the frame.
    """
    name = system.frame_name(frame)
    servo = system._queries.get(("step", name))
    if servo is None:
        servo = system._queries[("step", name)] = Servo(system, name)
    q = as_q(system, q)
    if q.ndim != 1 or not (0.0 < dt < math.inf and 0.0 <= damping < math.inf):
        raise InputError(f"q has shape {q.shape}, dt is {dt!r}, damping {damping!r}; needed are one configuration "
                         f"({system.nq},), a positive time and a number not negative")  # fmt: skip
    pose, J = servo.query.pose_and_jacobian(q)
    J = J[:, servo.v]
    twist = _twist(wanted, pose, dt)
    w = _numbers(weights, 6, "weights") if weights is not None else None
    A, b = (J, twist) if w is None else (w[:, None] * J, w * twist)
    speed = servo.speed if velocity_limits is None else _numbers(velocity_limits, system.nv, "velocity_limits")[servo.v]
    low, high = servo.box(q, dt, speed)
    velocity = np.zeros(system.nv)
    own = _scaled(A, b, low, high) if keep_direction else _bent(A, b, low, high, damping)
    velocity[servo.v] = own
    had, square = J @ own, float(b @ b)
    fraction = float(b @ (A @ own)) / square if square else 1.0
    at = ((own <= low) | (own >= high)).nonzero()[0]
    return IkStep(servo.after(q, velocity, dt), velocity, had, fraction, tuple(servo.names[i] for i in at))


def _twist(wanted: Any, pose: Array, dt: float) -> Array:
    x = np.asarray(wanted, dtype=float)
    if x.shape == (4, 4):
        out = np.empty(6)
        out[:3] = x[:3, 3] - pose[:3, 3]
        out[3:] = spatial.log_so3(x[:3, :3] @ pose[:3, :3].T)
        x = out / dt
    if x.shape != (6,) or not math.isfinite(x.dot(x)):
        raise InputError(f"the wanted motion has shape {x.shape}; it must be a twist (6,) or a pose (4, 4), finite")
    return x


def _numbers(x: Any, n: int, what: str) -> Array:
    try:
        out = np.broadcast_to(np.asarray(x, dtype=float), (n,))
    except (TypeError, ValueError):
        out = np.full(1, np.nan)
    if not (out >= 0.0).all():
        raise InputError(f"{what} is {x!r}; it must be a number or ({n},) numbers, none negative")
    return out


def _bent(A: Array, b: Array, low: Array, high: Array, damping: float) -> Array:
    """Velocities (n,) in the box that make |A v - b| least, damped and small."""
    n = A.shape[1]
    U, s, Vt = np.linalg.svd(A, full_matrices=True)
    seen = s > FLAT * s[:1].max(initial=0.0)
    hard = np.where(seen & (s < NEAR), damping * np.sqrt(np.maximum(1.0 - (s / NEAR) ** 2, 0.0)), 0.0)
    k = len(s)
    part = np.where(seen, s / np.where(seen, s * s + hard * hard, 1.0), 0.0)
    v = Vt[:k].T @ (part * (U[:, :k].T @ b))
    if (v >= low).all() and (v <= high).all():
        return v
    rows = np.full(n, LEAST)
    rows[:k][seen] = np.maximum(hard[seen], LEAST * (s[seen] < NEAR))
    kept = rows > 0.0
    return bounded(np.concatenate([A, rows[kept, None] * Vt[kept]]), np.concatenate([b, np.zeros(kept.sum())]), low,
                   high, v)  # fmt: skip


def _scaled(A: Array, b: Array, low: Array, high: Array) -> Array:
    """Velocities (n,) in the box that give the largest part of b, its direction kept, and are small."""
    size, n = math.sqrt(b @ b), A.shape[1]
    inside = np.minimum(np.maximum(0.0, low), high)
    if not size:
        return inside
    # the part of b is one more unknown, in [0, 1], wished to be 1 with little weight
    B = np.zeros((7 + n, n + 1))
    B[:6, :n], B[:6, n], B[6, n] = A / size, -b / size, SHRINK
    B[range(7, 7 + n), range(n)] = LEAST_SCALED / size
    wish = np.zeros(7 + n)
    wish[6] = SHRINK
    x: Array = np.asarray(np.linalg.lstsq(B, wish, rcond=None)[0], dtype=float)
    if (x[:n] < low).any() or (x[:n] > high).any():
        x = bounded(B, wish, np.append(low, 0.0), np.append(high, 1.0), x)
    return x[:n]


def bounded(A: Array, b: Array, low: Array, high: Array, first: Array) -> Array:
    """The x (n,) in a box that makes |A x - b| least, for A of full column rank: active set (Stark and Parker, 1995).

    `first` (n,) says which bounds are tried first: those that it violates.
    """
    x = np.minimum(np.maximum(first, low), high)
    held = (first <= low) | (first >= high)
    for _ in range(10 * len(x) + 10):
        free = ~held
        if free.any():
            z = x.copy()
            z[free] = np.linalg.lstsq(A[:, free], b - A[:, held] @ x[held], rcond=None)[0]
            over = free & ((z < low) | (z > high))
            if over.any():
                step, way = np.inf, z - x
                ratio = np.where(way < 0.0, low - x, high - x)[over] / way[over]
                step = min(max(float(ratio.min()), 0.0), 1.0)
                x = np.where(free, np.minimum(np.maximum(x + step * way, low), high), x)
                block = np.flatnonzero(over)[ratio <= step]
                x[block] = np.where(way[block] < 0.0, low[block], high[block])
                held[block] = True
                continue
            x = z
        slope = A.T @ (A @ x - b)
        pull = np.where(held & (low < high), np.where(x <= low, -slope, slope), 0.0)
        worst = int(np.argmax(pull))
        if pull[worst] <= INWARD * max(1.0, float(np.abs(b).max())):
            break
        held[worst] = False
    return x
