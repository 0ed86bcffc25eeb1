"""What can be steered like a car: recognised from velocity rows and the kinematics, whatever it is
made of.

A body moves in a plane by two slides and a turn. Velocity rows that depend on how the body moves in
its own axes, and not on where it is, allow twists (forward, sideways, turning) of it: those without
sideslip at one point, the middle of an axle. Coordinates beside those of the body are *idle* (no
row has them), *driven* (their rates follow from the twist, as a wheel's), or one is the *steering*:
rows depend on it, its own rate is in none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kempe.equations import closure_rows
from kempe.equations.one_sided import one_sided_rows
from kempe.equations.velocity import rates
from kempe.errors import UnsupportedError
from kempe.forward.fk import fk, jacobian
from kempe.model.configurations import random
from kempe.numerics.rank import Level, Spectrum
from kempe.singular_values import svd
from kempe.spatial import Array
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.model.model import Model

SAME = 1e-9
"""Difference of projections, derivatives or rows without unit that counts as rounding."""
RANK = 1e-8
"""Singular values below this part of the largest count as zero."""
TRIALS = 6
"""Random configurations at which each statement is checked."""
FINE = 720
"""Values of the steering, all around or between its limits, among which a wanted curvature is
looked for."""
SEED = 19900101


@dataclass(frozen=True, eq=False)
class PlanarPlace:
    """The place of a body in its plane: which coordinates it has, and how the plane lies.

    `slides` and `turn` are indices into q and into velocities; the heading is `gear` times the
    turn's coordinate. `plane` (2, 3) are the plane's axes in the ground frame.
    """

    system: Model
    body: str
    slides_q: np.ndarray
    slides_v: np.ndarray
    turn_q: int
    turn_v: int
    gear: float
    plane: Array

    @property
    def own(self) -> list[int]:
        """Velocity indices of the two slides and the turn."""
        return [*self.slides_v.tolist(), self.turn_v]

    def at(self, q: Array) -> tuple[Array, Array]:
        """Places (..., 2) of the body's origin in the plane, and headings (...)."""
        place = fk(self.system, q, self.body)[..., :3, 3] @ self.plane.T
        return place, self.gear * q[..., self.turn_q]

    def to_q(self, q: Array, place: Array, heading: Array) -> Array:
        """Configurations `q` (n, nq) with the body moved to places (n, 2) and headings (n,),
        exactly.
        """
        out = q.copy()
        out[:, self.turn_q] = heading / self.gear
        out[:, self.slides_q] = 0.0
        origin = self.at(out)[0]
        J = jacobian(self.system, out, self.body)[:, :3][..., self.slides_v]
        out[:, self.slides_q] = np.linalg.solve(self.plane @ J, (place - origin)[..., None])[..., 0]
        return out

    def spread(self, q: Array) -> Array:
        """Sine (n,) of the angle between the two slides, positive where it has the sign that it has
        at the first q.
        """
        D = self.plane @ np.asarray(jacobian(self.system, q, self.body))[:, :3][..., self.slides_v]
        sine = np.linalg.det(D / np.linalg.norm(D, axis=1, keepdims=True))
        return sine * np.sign(sine[0])

    def rates(self, q: Array, velocity: Array, turning: Array) -> Array:
        """Velocities (n, 3) of slides and turn that give the body's origin velocities (n, 2) and
        turning (n,).
        """
        J = self.plane @ jacobian(self.system, q, self.body)[:, :3]
        spin = turning / self.gear
        rest = velocity - J[..., self.turn_v] * spin[:, None]
        slides: Array = np.asarray(
            np.linalg.solve(J[..., self.slides_v], rest[..., None])[..., 0], dtype=float
        )
        return np.column_stack([slides, spin])

    def twist(self, q: Array) -> Array:
        """Matrix (3, 3): forward, sideways and turning rates of the body, in its axes, by the rates
        `own`.
        """
        J = jacobian(self.system, q, self.body)
        h = self.gear * q[self.turn_q]
        axes = np.array([[math.cos(h), math.sin(h)], [-math.sin(h), math.cos(h)]])
        out = np.zeros((3, 3))
        out[:2] = axes @ self.plane @ J[:3, self.own]
        out[2, 2] = self.gear
        return out


def pose_of(system: Model) -> PlanarPlace:
    """The body nearest to the ground that moves in a plane by two slides and a turn. Errors:
    `UnsupportedError`.
    """
    rng = np.random.default_rng(SEED)
    samples = random(system, rng, (TRIALS,))
    vectors = dict(
        zip(
            system.structure.layout.vector_v.tolist(),
            system.structure.layout.vector_q.tolist(),
            strict=True,
        )
    )
    for body in system.body_names[1:]:
        J = np.asarray(jacobian(system, samples, body))
        moved = np.flatnonzero(np.abs(J).max(axis=(0, 1)) > SAME)
        if len(moved) != 3 or not all(int(i) in vectors for i in moved):
            continue
        turning = [int(i) for i in moved if np.abs(J[:, 3:, i]).max() > SAME]
        if len(turning) != 1:
            continue
        turn = turning[0]
        slides = np.array([i for i in moved if i != turning[0]])
        spin = J[0, 3:, turn]
        gear = float(np.linalg.norm(spin))
        normal = spin / gear
        flat = (
            np.abs(J[:, 3:, turn] - spin).max() < SAME * gear
            and np.abs(J[:, :3].transpose(0, 2, 1) @ normal).max()
        )
        if not flat < SAME or np.linalg.matrix_rank(J[0, :3][:, slides], RANK) < 2:
            continue
        first = (
            np.eye(3)[int(np.argmin(np.abs(normal)))]
            if abs(normal[0]) > 0.9
            else np.array([1.0, 0.0, 0.0])
        )
        x = first - normal * (first @ normal)
        x /= np.linalg.norm(x)
        plane = np.array([x, np.cross(normal, x)])
        places = np.array([vectors[int(i)] for i in slides])
        return PlanarPlace(system, body, places, slides, vectors[turn], turn, gear, plane)
    raise UnsupportedError(
        f"{system.name}: no body moves in a plane by two slides and a turn; a manoeuvre is known "
        "for bodies whose place and heading in a plane are coordinates (a planar joint, or two "
        "slides and a turn)"
    )


@dataclass(frozen=True, eq=False)
class Wheeled:
    """A body on an axle: `axle` (2,) is a point of it in the body's axes, `angle` the heading of
    its wheels there.

    `driven` and `idle` are velocity indices; `steering` one or None, with its place in q in
    `steering_q`. `loose` says that the body may turn about the axle's middle, whatever the steering
    is.
    """

    pose: PlanarPlace
    axle: Array
    angle: float
    driven: tuple[int, ...]
    idle: tuple[int, ...]
    steering: int | None
    steering_q: int
    loose: bool

    @property
    def system(self) -> Model:
        """The system that moves."""
        return self.pose.system

    def wheel(self, q: Array) -> tuple[float, float, float]:
        """The axle's middle and heading (x, y, heading) at a configuration (nq,)."""
        place, heading = self.pose.at(q)
        h = float(heading)
        c = math.cos(h)
        s = math.sin(h)
        x, y = self.axle
        return float(place[0]) + c * x - s * y, float(place[1]) + s * x + c * y, h + self.angle

    def body(self, wheel: Array) -> tuple[Array, Array]:
        """Places (n, 2) and headings (n,) of the body, of the axle's (n, 3)."""
        h = wheel[:, 2] - self.angle
        c = np.cos(h)
        s = np.sin(h)
        x, y = self.axle
        return wheel[:, :2] - np.column_stack([c * x - s * y, s * x + c * y]), h

    def motions(self, q: Array) -> Array:
        """Basis (3 + driven, k) of allowed (forward, sideways, turning, driven rates) of the axle
        at q.
        """
        own = [*range(3), *(3 + i for i in self.driven)]
        A = _rows(self.pose, q)[:, own]
        unit = _unit(self.pose)[own]
        c = math.cos(self.angle)
        s = math.sin(self.angle)
        x, y = self.axle
        back = np.eye(A.shape[1])  # of the body's origin, in its axes, by those of the axle
        back[:3, :3] = [[c, -s, y], [s, c, -x], [0.0, 0.0, 1.0]]
        return Spectrum(A @ back * unit).null(Level.CLOSED) * unit[:, None]

    def follow(self, q: Array, forward: float, turning: float) -> Array | None:
        """Rates (driven,) at these speeds of the axle; None where they are not allowed at q."""
        N = self.motions(q)
        goal = np.array([forward, 0.0, turning])
        x = np.linalg.lstsq(N[:3], goal, rcond=RANK)[0]
        if np.abs(N[:3] @ x - goal).max() > 1e-7 * max(abs(forward), abs(turning)):
            return None
        return N[3:] @ x


def wheeled(system: Model, q: Array) -> Wheeled:
    """What of the system is steered like a car, beside its configuration q (nq,). Errors:
    `UnsupportedError`.
    """
    A, b = rates(system, q)
    if not A.shape[-2] and (held := binding(system, q)):
        raise UnsupportedError(
            f"{system.name} has no velocity constraints; {held!r} holds positions on the way: "
            "system.configuration_space.path(start, goal)"
        )
    if not A.shape[-2] and len(one_sided_rows(system)):
        raise UnsupportedError(
            f"{system.name} has no velocity constraints; limits or one-sided constraints hold on "
            "the way: system.configuration_space.path(start, goal)"
        )
    if not A.shape[-2]:
        raise UnsupportedError(
            f"{system.name} has no velocity constraints: nothing keeps it from going straight "
            "there (system.configuration_space.interpolate)"
        )
    if np.abs(b).max(initial=0.0) > 0.0:
        raise UnsupportedError(
            f"{system.name}: a velocity constraint asks for a speed of its own (b is not zero): "
            "the system cannot rest, and a manoeuvre is not known"
        )
    if held := binding(system, q):
        raise UnsupportedError(
            f"{system.name}: {held!r} ties coordinates to each other (a loop, a relation or a "
            "position constraint); a manoeuvre is known for open systems only"
        )
    pose = pose_of(system)
    driven, idle, steering = _kinds(pose, q)
    steering_q = -1
    if steering is not None:
        steering_q = int(
            system.structure.layout.vector_q[
                system.structure.layout.vector_v.tolist().index(steering)
            ]
        )
    a, loose = _normal(pose, q, driven, steering, steering_q)
    if math.hypot(a[0], a[1]) < SAME * abs(a[2]):
        raise UnsupportedError(
            f"{system.name}: {pose.body!r} cannot turn; its heading stays, and that is a "
            "constraint on its position, no nonholonomic one"
        )
    a = a / math.hypot(a[0], a[1])
    forward = np.array([a[1], -a[0]])
    forward = (
        -forward
        if forward[0] < -SAME or (abs(forward[0]) <= SAME and forward[1] < 0.0)
        else forward
    )
    axle, sense = _middle(pose, q, -a[2] * np.array([-a[1], a[0]]), forward)
    forward = sense * forward
    return Wheeled(
        pose, axle, math.atan2(forward[1], forward[0]), driven, idle, steering, steering_q, loose
    )


def _middle(pose: PlanarPlace, q: Array, foot: Array, forward: Array) -> tuple[Array, float]:
    """The middle (2,) of the axle in the body's axes, and whether `forward` (2,) is forwards (1) or
    in reverse (-1).

    By the ends of velocity constraints that are fixed on the axle: their middle, and the sense of
    their x axes. Where there is none, the middle is the `foot`, next to the body's origin.
    """
    system = pose.system
    sense = 0.0
    found: list[float] = []
    across = np.array([-forward[1], forward[0]])
    samples = np.concatenate([q[None], random(system, np.random.default_rng(SEED), (2,))])
    place, heading = pose.at(samples)
    c = np.cos(heading)
    s = np.sin(heading)

    def own(x: Array) -> Array:
        """Vectors (n, 3) of the ground in the body's axes (n, 2)."""
        x = x @ pose.plane.T
        return np.column_stack([c * x[:, 0] + s * x[:, 1], c * x[:, 1] - s * x[:, 0]])

    for body, X in ends_of_velocity_constraints(system):
        end = fk(system, samples, body) @ X
        far = own(end[:, :3, 3] - place @ pose.plane)
        ahead = own(end[:, :3, 0])
        reach = 1.0 + float(np.abs(far).max()) + float(np.abs(place).max())
        if max(np.abs(far - far[0]).max(), abs(float(forward @ (far[0] - foot)))) < SAME * reach:
            found.append(float(across @ (far[0] - foot)))
            sense += float(forward @ ahead[0]) if np.abs(ahead - ahead[0]).max() < SAME else 0.0
    middle = foot + across * float(np.mean(found)) if found else foot
    return middle, -1.0 if sense < -0.5 else 1.0


def ends_of_velocity_constraints(system: Model) -> list[tuple[str, Array]]:
    """For each declared velocity constraint between frames the body of its end B, and the pose of
    that end on it.
    """
    found = [
        c
        for c in system._mechanism.constraints.values()
        if any(r.velocity for r in c.of.rows(system.dim))
    ]
    return [
        (c.child, c.frames(system.structure.parameters, system.dim)[1]) for c in found if c.child
    ]


def binding(system: Model, q: Array) -> str | None:
    """The name of a position constraint, loop or relation that restricts configurations around q
    (nq,), if one does.
    """
    some = np.concatenate([q[None], random(system, np.random.default_rng(SEED), (TRIALS,))])
    error, J = closure_rows.evaluate(system, some)
    held = np.flatnonzero(
        np.maximum(np.abs(error).max(axis=0), np.abs(J).max(axis=(0, 2), initial=0.0)) > SAME
    )
    return closure_rows.row_names(system)[int(held[0])][0] if len(held) else None


def _rows(pose: PlanarPlace, q: Array) -> Array:
    """Velocity rows (m, 3 + nv) of the body's own twist, then of all coordinates but those of its
    pose (zero there).
    """
    A = rates(pose.system, q)[0]
    out = np.concatenate([A[:, pose.own] @ np.linalg.inv(pose.twist(q)), A], axis=1)
    out[:, [3 + i for i in pose.own]] = 0.0
    return out


def _unit(pose: PlanarPlace) -> Array:
    """What one unit is (3 + nv,): radians, and characteristic lengths."""
    length = closure_rows.characteristic_length(pose.system)
    turning = pose.system.structure.coordinates.turning.copy()
    turning[pose.system.structure.layout.quaternion_v[:, None] + np.arange(3)] = True
    return np.concatenate([[length, length, 1.0], np.where(turning, 1.0, length)])


def _projection(A: Array) -> Array:
    """The projection on the space of the rows."""
    _, s, Vt = svd(A, full_matrices=False)
    V = Vt[: int(np.sum(s > RANK * max(float(s.max(initial=0.0)), 1e-300)))]
    return V.T @ V


def _kinds(pose: PlanarPlace, q: Array) -> tuple[tuple[int, ...], tuple[int, ...], int | None]:
    """Driven and idle velocity indices, and the steering. Errors: `UnsupportedError`."""
    system = pose.system
    unit = _unit(pose)
    rng = np.random.default_rng(SEED)
    samples = random(system, rng, (TRIALS,))
    places = {
        int(v): [int(i)]
        for v, i in zip(
            system.structure.layout.vector_v, system.structure.layout.vector_q, strict=True
        )
    }
    for v, i in zip(
        system.structure.layout.quaternion_v.tolist(),
        system.structure.layout.quaternion_q.tolist(),
        strict=True,
    ):
        places |= {v + k: list(range(i, i + 4)) for k in range(3)}

    def space(x: Array) -> Array:
        return _projection(_rows(pose, x) * unit)

    def varies(columns: list[int], base: Array) -> bool:
        here = space(base)
        for other in samples:
            x = base.copy()
            x[columns] = other[columns]
            if np.abs(space(x) - here).max() > 1e-8:
                return True
        return False

    own = [*pose.slides_q.tolist(), pose.turn_q]
    if any(varies(own, base) for base in (q, samples[0])):
        raise UnsupportedError(
            f"{system.name}: what the velocity constraints allow depends on where {pose.body!r} "
            "is, not only on how it moves in its own axes; a manoeuvre is not known"
        )
    driven: list[int] = []
    idle: list[int] = []
    steering: list[int] = []
    for v in sorted(set(places) - set(pose.own)):
        column = max(float(np.abs(space(x)[3 + v]).max()) for x in (q, *samples)) > SAME
        shape = any(varies(places[v], base) for base in (q, samples[0], samples[1]))
        name = system.structure.velocity_names[v]
        if column and shape:
            raise UnsupportedError(
                f"{system.name}: the rate of {name!r} depends on {name!r} itself, as a trailer's "
                "does; a manoeuvre is not known for that"
            )
        (driven if column else steering if shape else idle).append(v)
    if len(steering) > 1 or any(len(places[v]) > 1 for v in steering):
        both = " and ".join(repr(system.structure.velocity_names[v]) for v in steering)
        raise UnsupportedError(
            f"{system.name}: {both} steer together; a manoeuvre is known for one steering angle"
        )
    return tuple(driven), tuple(idle), steering[0] if steering else None


def _normal(
    pose: PlanarPlace, q: Array, driven: tuple[int, ...], steering: int | None, steering_q: int
) -> tuple[Array, bool]:
    """The row (3,) that vanishes on every twist which is allowed, and whether these are all that it
    leaves.

    Errors: `UnsupportedError` where the twists are too many, too few, or the driven coordinates do
    not follow.
    """
    system = pose.system
    unit = _unit(pose)
    own = [*range(3), *(3 + i for i in driven)]
    twists: list[Array] = []
    for k in range(TRIALS if steering is not None else 1):
        x = q.copy()
        if steering is not None and k:
            x[steering_q] = random(system, np.random.default_rng([SEED, k]))[steering_q]
        N = Spectrum(_rows(pose, x)[:, own] * unit[own]).null(Level.CLOSED)
        s = svd(N[:3], compute_uv=False)
        if N.shape[1] > 3 or (N.shape[1] and s[N.shape[1] - 1] < RANK):
            names = ", ".join(repr(system.structure.velocity_names[v]) for v in driven)
            raise UnsupportedError(
                f"{system.name}: with {pose.body!r} at rest some of {names} still turn: a "
                "manoeuvre is not known for that"
            )
        twists.append(N[:3] * unit[:3, None])
    counts = {N.shape[1] for N in twists[1:] or twists}
    if counts == {2}:
        return np.cross(twists[0][:, 0], twists[0][:, 1]), True
    if counts == {3}:
        raise UnsupportedError(
            f"{system.name}: the velocity constraints let {pose.body!r} move in every direction: "
            "no manoeuvre is needed (system.configuration_space.interpolate)"
        )
    if counts == {1} and steering is not None:
        _, s, Vt = svd(np.concatenate([N.T / unit[:3] for N in twists]))
        if s[2] < SAME * s[0] and s[1] > RANK * s[0]:
            return Vt[2] / unit[:3], False
        name = system.structure.velocity_names[steering]
        raise UnsupportedError(
            f"{system.name}: no point of {pose.body!r} is without sideslip for every value of "
            f"{name!r}: a manoeuvre is known for a body with an axle of its own"
        )
    left = counted(min(counts), "freedom")
    raise UnsupportedError(
        f"{system.name}: the velocity constraints leave {pose.body!r} {left} of motion: "
        "it moves along one curve only"
    )
