"""One step of the differential inverse model: velocities that give a frame a twist, within all limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.calls import brief, explained, explained_methods
from kempe.errors import InputError
from kempe.kinematics.configuration import as_q
from kempe.kinematics.forward import refuse_bad
from kempe.reals import reals
from kempe.solvers.chain import chain_of, obstacle
from kempe.solvers.least_squares import NEAR, damped, scaled
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

NONE = np.zeros(0)
BESIDE = 1e-12
"""How near to a bound a velocity is at it, where it is a sum of others."""


@explained_methods
@dataclass(frozen=True, eq=False)
class IkStep:
    """Velocities of one step: `q` (nq,) after it, `velocity` (nv,), and the `twist` (6,) that they give the frame.

    For tasks, `twist` are the rates (m,) of the equations of the hard ones, in radians and characteristic lengths.
    `fraction` is the part of the wanted twist in that, 1 where it is had in full; `saturated` names the coordinates
    that are at a limit of position or velocity.
    """

    __repr__ = brief

    q: Array
    velocity: Array
    twist: Array
    fraction: float
    saturated: tuple[str, ...]


class Servo:
    """All of a frame's steps that does not depend on the configuration, looked up once."""

    def __init__(self, system: System, frame: str):
        self.system, self.frame, self.query = system, frame, system.query(frame)
        chain = chain_of(system, frame)
        self.v, reach = chain.v_index, min((b.largest for b in chain.bounds), default=math.inf)
        self.near = NEAR * min(1.0, reach) if reach > 0.0 else NEAR
        """Singular values to be damped: metres, so less where the whole chain is shorter than one."""
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


@explained
def ik_step(
    system: System, q: Any, wanted: Any, frame: FrameLike | None = None, dt: float = 0.0, *,
    velocity_limits: Any = None, damping: float = 0.05, keep_direction: bool = False, weights: Any = None,
) -> IkStep:  # fmt: skip
    """The step that gives a frame the wanted twist for the time dt [s], as nearly as limits allow.

    `wanted` is a twist (6,), [linear; angular] of the frame's origin in ground axes, or a pose (4, 4) to be reached in
    dt; without a frame, tasks of `kempe.tasks` to be reached in dt, hard or soft and in strict priorities. The
    velocities make the squared error of the twist least (`weights` (6,) of its rows, zero where a row does not
    count) and, among those that do, their own size; near singularities the directions that are hard to move in are
    damped, by at most `damping` (Maciejewski and Klein, 1988). They stay in `velocity_limits` (a number or (nv,),
    default: those of the system), and no coordinate leaves its limits within dt: bounds are met by an active set, so
    that other joints take over (Stark and Parker, 1995). With `keep_direction` the twist is scaled instead of bent:
    what is had is the largest part of it that the limits allow, from 0 to 1, and that takes the place of damping.

    Loops and relations of several coordinates stay closed, those of the whole system for tasks and for a frame that
    they move: to first order by the velocities, and then in `q`, which is closed again (q may be open a little, as by
    drift). There sizes are measured in radians and characteristic lengths, and damping relative to the largest
    singular value. Errors: `InputError`, also where the loops are open.
    """
    q = as_q(system, q)
    if q.ndim != 1 or not (0.0 < dt < math.inf and 0.0 <= damping < math.inf):
        raise InputError(f"q has shape {q.shape}, dt is {dt!r}, damping {damping!r}; needed are one configuration "
                         f"({system.nq},), a positive time and a number not negative")  # fmt: skip
    speed = system.velocity_limits if velocity_limits is None else _numbers(velocity_limits, system.nv,
                                                                           "velocity_limits")  # fmt: skip
    w = _numbers(weights, 6, "weights") if weights is not None else None
    if frame is None:
        if keep_direction or w is not None:
            raise InputError("keep_direction and weights are for the twist of a frame; tasks have weights of their own")
        return _held_step(system, q, wanted, None, dt, speed, damping, False, None)
    name = system.frame_name(frame)
    if obstacle(system, name):
        return _held_step(system, q, wanted, name, dt, speed, damping, keep_direction, w)
    servo = system._queries.get(("step", name))
    if servo is None:
        servo = system._queries[("step", name)] = Servo(system, name)
    pose, J = servo.query.pose_and_jacobian(q)
    J = J[:, servo.v]
    twist = _twist(wanted, pose, dt)
    A, b = (J, twist) if w is None else (w[:, None] * J, w * twist)
    low, high = servo.box(q, dt, speed[servo.v])
    velocity = np.zeros(system.nv)
    own = scaled(A, b, low, high) if keep_direction else damped(A, b, low, high, damping, near=servo.near)
    velocity[servo.v] = own
    at = ((own <= low) | (own >= high)).nonzero()[0]
    return IkStep(servo.after(q, velocity, dt), velocity, J @ own, _part(A @ own, b), tuple(servo.names[i] for i in at))


def _held_step(
    system: System, q: Array, wanted: Any, frame: str | None, dt: float, speed: Array, damping: float, direction: bool,
    weights: Array | None,
) -> IkStep:  # fmt: skip
    """A step for a frame, or for tasks, while the system's loops and relations stay closed."""
    from kempe.solvers.servo_closed import Closed, posed, stages_of

    if not np.isfinite(q).all():
        refuse_bad(system, q)
    closed = system._queries.get(("step", None))
    if closed is None:
        closed = system._queries[("step", None)] = Closed(system)
    if frame is None:
        stages = stages_of(posed(system, wanted, q), q, dt)
    else:
        pose, J = system.query(frame).pose_and_jacobian(q)
        stages = [closed.twist(J, _twist(wanted, pose, dt), np.ones(6) if weights is None else weights)]
    low, high = closed.box(q, dt, speed)
    u = closed.velocity(q, stages, low, high, damping, direction)
    after, u = closed.after(q, u, dt, low, high)
    velocity = u * closed.scale
    near = BESIDE * np.maximum(1.0, np.abs(u))
    at = ((u <= low + near) | (u >= high - near)).nonzero()[0]
    asked = np.concatenate([NONE, *(s.b for s in stages if s.hard)])
    had = np.concatenate([NONE, *(s.A @ u for s in stages if s.hard)])
    twist = had if frame is None else J @ velocity
    return IkStep(after, velocity, twist, _part(had, asked), tuple(system.velocity_names[i] for i in at))


def _part(had: Array, asked: Array) -> float:
    """Which part of what is asked is had."""
    square = float(asked @ asked)
    return float(asked @ had) / square if square else 1.0


def _twist(wanted: Any, pose: Array, dt: float) -> Array:
    x = reals(wanted, "the wanted motion", "a twist (6,) or a pose (4, 4)")
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
        out = np.broadcast_to(reals(x, what, f"a number or ({n},) numbers"), (n,))
    except InputError:
        raise
    except ValueError:
        out = np.full(1, np.nan)
    if not (out >= 0.0).all():
        raise InputError(f"{what} is {x!r}; it must be a number or ({n},) numbers, none negative")
    return out
