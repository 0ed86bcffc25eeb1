"""Wheeled bodies: an axle, recognised from velocity constraints, whatever it is made of.

A body moves in a plane by two slides and a turn. Velocity rows that depend on how the body moves in
its own axes, and not on where it is, allow twists (forward, sideways, turning) of it: those without
sideslip at one point, the middle of an axle. Coordinates beside those of the body are *idle* (no
row has them), *driven* (their rates follow from the twist, as a wheel's), or one is the *steering*:
rows depend on it, its own rate is in none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from kempe.equations import closure_rows
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.equations.velocity import evaluate_velocity_rows
from kempe.errors import UnsupportedError
from kempe.forward.fk import fk, jacobian
from kempe.model.configurations import sample_configurations
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array, adjoint, align_z, inverse, make_rotation, pose
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.model.model import Model

SAME = 1e-9
"""Difference of projections, derivatives or rows without unit that counts as rounding."""
TRIALS = 6
"""Random configurations at which each statement is checked."""
SEED = 19900101


@dataclass(frozen=True, eq=False)
class Axle:
    """An axle on a body that moves in a plane, and the coordinates that go with it.

    `X_BA` is the pose of the axle on the body: x ahead, y along the axle, z across the plane, whose
    axes in the ground are `plane` (2, 3). `own` are velocity indices of two slides and the turn;
    the heading is the turn's coordinate times `gear`, plus `angle`. `driven`, `idle` and `steering`
    are velocity indices.
    """

    system: Model
    body: str
    X_BA: Array
    plane: Array
    own: tuple[int, ...]
    gear: float
    angle: float = 0.0
    driven: tuple[int, ...] = ()
    idle: tuple[int, ...] = ()
    steering: int | None = None

    @cached_property
    def q_places(self) -> dict[int, int]:
        """Index in q of each turn or slide, by its velocity index."""
        layout = self.system.structure.layout
        return dict(zip(layout.vector_v.tolist(), layout.vector_q.tolist(), strict=True))

    @cached_property
    def own_q_places(self) -> list[int]:
        """Indices in q of the two slides and the turn of the body."""
        return [self.q_places[v] for v in self.own]

    @cached_property
    def units(self) -> Array:
        """Units (3 + nv,) of the axle's twist and of velocities: rad, or characteristic lengths."""
        length = closure_rows.compute_characteristic_length(self.system)
        turning = self.system.structure.coordinates.turning.copy()
        turning[self.system.structure.layout.quaternion_v[:, None] + np.arange(3)] = True
        return np.concatenate([[length, length, 1.0], np.where(turning, 1.0, length)])

    def compute_place(self, q: Array) -> Array:
        """Compute middle and heading (..., 3) of the axle at configurations (..., nq)."""
        middle = (fk(self.system, q, self.body) @ self.X_BA)[..., :3, 3] @ self.plane.T
        heading = self.gear * q[..., self.own_q_places[2]] + self.angle
        return np.concatenate([middle, heading[..., None]], axis=-1)

    def move_axle(self, q: Array, place: Array) -> Array:
        """Return configurations (n, nq) with the axle moved exactly to places (n, 3)."""
        out = q.copy()
        out[:, self.own_q_places[2]] = (place[:, 2] - self.angle) / self.gear
        out[:, self.own_q_places[:2]] = 0.0
        J = self.plane @ jacobian(self.system, out, self.body)[:, :3][..., list(self.own[:2])]
        off = (place - self.compute_place(out))[:, :2]
        out[:, self.own_q_places[:2]] = np.linalg.solve(J, off[..., None])[..., 0]
        return out

    def compute_twist_matrices(self, q: Array) -> Array:
        """Compute matrices (n, 3, 3) from rates of slides and turn to the twist of the axle.

        The twist is forward, sideways and turning, at configurations (n, nq).
        """
        J = adjoint(inverse(self.X_BA)) @ jacobian(self.system, q, self.body, "body")
        return J[:, [0, 1, 5]][..., list(self.own)]

    def compute_own_rates(self, q: Array, forward: Array, turning: Array) -> Array:
        """Compute the rates (n, 3) of slides and turn at speeds (n,) of the axle."""
        twist = np.stack([forward, np.zeros(len(q)), turning], axis=1)
        rates = np.linalg.solve(self.compute_twist_matrices(q), twist[..., None])[..., 0]
        return np.asarray(rates, dtype=float)

    def compute_slide_sine(self, q: Array) -> Array:
        """Compute the sine (n,) of the angle between the two slides.

        It is positive where it has the sign that it has at the first q.
        """
        D = self.compute_twist_matrices(q)[:, :2, :2]
        sine = np.linalg.det(D / np.linalg.norm(D, axis=1, keepdims=True))
        return sine * np.sign(sine[0])

    def compute_rows(self, q: Array) -> Array:
        """Compute the scaled velocity rows (m, 3 + nv) of the axle's twist and of all coordinates.

        Those of the body's own coordinates are zero.
        """
        A = evaluate_velocity_rows(self.system, q)[0]
        own = list(self.own)
        by_rates: Array = np.linalg.inv(self.compute_twist_matrices(q[None]))[0]
        out = np.concatenate([A[:, own] @ by_rates, A], axis=1)
        out[:, [3 + v for v in own]] = 0.0
        return out * self.units

    def compute_motion_basis(self, q: Array) -> Array:
        """Compute a scaled basis (3 + driven, k) of allowed rates of axle and driven coordinates."""
        rows = self.compute_rows(q)[:, self._moved_columns]
        return Spectrum(rows).compute_null_space(Level.CLOSED)

    @cached_property
    def _moved_columns(self) -> list[int]:
        """Columns of the axle's twist and of the driven coordinates."""
        return [0, 1, 2, *(3 + v for v in self.driven)]

    def compute_driven_rates(self, q: Array, forward: float, turning: float) -> Array | None:
        """Compute the rates (driven,) at speeds of the axle; None where they are not allowed."""
        N = self.compute_motion_basis(q) * self.units[self._moved_columns][:, None]
        twist = np.array([forward, 0.0, turning])
        x = Spectrum(N[:3]).solve_least_squares(twist, Level.CLOSED)
        if np.abs(N[:3] @ x - twist).max() > 1e-7 * max(abs(forward), abs(turning)):
            return None
        return N[3:] @ x

    def compute_bend_angle(self, q: Array, steering: float) -> float:
        """Compute the angle in [0, pi) of (forward, turning), scaled, at a value of the steering.

        It is 0 straight ahead, and pi/2 for a turn on the spot.
        """
        assert self.steering is not None
        x = q.copy()
        x[self.q_places[self.steering]] = steering
        N = self.compute_motion_basis(x)
        return math.atan2(N[2, 0], N[0, 0]) % math.pi


def find_axle(system: Model, q: Array) -> Axle:
    """Find the axle of a rolling system at its configuration q (nq,). Errors: `UnsupportedError`."""
    A, b = evaluate_velocity_rows(system, q)
    tie = find_binding_constraint(system, q)
    if not A.shape[-2]:
        held = "limits or one-sided constraints hold" if len(pack_one_sided_rows(system)) else ""
        held = f"{tie!r} holds positions" if tie else held
        advice = (
            f"; {held} on the way: system.configuration_space.path(start, goal)"
            if held
            else ": nothing keeps it from going straight there "
            "(system.configuration_space.interpolate)"
        )
        raise UnsupportedError(f"{system.name} has no velocity constraints{advice}")
    if np.abs(b).max(initial=0.0) > 0.0:
        raise UnsupportedError(
            f"{system.name}: a velocity constraint asks for a speed of its own (b is not zero): "
            "the system cannot rest, and a manoeuvre is not known"
        )
    if tie:
        raise UnsupportedError(
            f"{system.name}: {tie!r} ties coordinates to each other (a loop, a relation or a "
            "position constraint); a manoeuvre is known for open systems only"
        )
    samples = [q, *_sample(system)]
    return _place_axle(_sort_coordinates(_find_planar_body(system), samples), samples)


def find_binding_constraint(system: Model, q: Array) -> str | None:
    """Find a position constraint, loop or relation that restricts configurations around q (nq,).

    Returned is its name, or None.
    """
    error, J = closure_rows.evaluate_constraints(system, np.stack([q, *_sample(system)]))
    size = np.maximum(np.abs(error).max(axis=0), np.abs(J).max(axis=(0, 2), initial=0.0))
    rows = np.flatnonzero(size > SAME)
    return closure_rows.list_row_names(system)[int(rows[0])][0] if len(rows) else None


def _sample(system: Model) -> Array:
    """Draw the random configurations (TRIALS, nq) at which statements are checked."""
    return sample_configurations(system, np.random.default_rng(SEED), (TRIALS,))


def _find_planar_body(system: Model) -> Axle:
    """Find the body nearest to the ground that moves in a plane by two slides and a turn.

    It is returned as an axle at its origin. Errors: `UnsupportedError`.
    """
    samples = _sample(system)
    vectors = {*system.structure.layout.vector_v.tolist()}
    for body in system.body_names[1:]:
        J = np.asarray(jacobian(system, samples, body))
        moved = np.flatnonzero(np.abs(J).max(axis=(0, 1)) > SAME).tolist()
        turns = [v for v in moved if np.abs(J[:, 3:, v]).max() > SAME]
        if len(moved) != 3 or len(turns) != 1 or not vectors.issuperset(moved):
            continue
        slides = [v for v in moved if v not in turns]
        spin = J[0, 3:, turns[0]]
        gear = float(np.linalg.norm(spin))
        leaves = np.abs(J[:, :3].transpose(0, 2, 1) @ spin).max() / gear
        tilts = np.abs(J[:, 3:, turns[0]] - spin).max() / gear
        rank = Spectrum(J[0, :3][:, slides]).compute_rank(Level.CLOSED)
        if max(leaves, tilts) > SAME or rank < 2:
            continue
        R_GA = align_z(spin)
        start = Axle(system, body, np.eye(4), R_GA[:, :2].T, (*slides, turns[0]), gear)
        q = samples[0].copy()
        q[start.own_q_places[2]] = 0.0
        R_GB = fk(system, q, body)[:3, :3]
        return replace(start, X_BA=pose(R_GB.T @ R_GA))
    raise UnsupportedError(
        f"{system.name}: no body moves in a plane by two slides and a turn; a manoeuvre is known "
        "for bodies whose place and heading in a plane are coordinates (a planar joint, or two "
        "slides and a turn)"
    )


def _sort_coordinates(axle: Axle, samples: list[Array]) -> Axle:
    """Return the axle with its driven, idle and steering coordinates. Errors: `UnsupportedError`."""
    system = axle.system
    layout = system.structure.layout
    places = {v: [i] for v, i in axle.q_places.items()}
    for v, i in zip(layout.quaternion_v.tolist(), layout.quaternion_q.tolist(), strict=True):
        places |= {v + k: list(range(i, i + 4)) for k in range(3)}

    def compute_projection(q: Array) -> Array:
        """Compute the projection onto the row space at q."""
        V = Spectrum(axle.compute_rows(q)).compute_row_space(Level.CLOSED)
        return V @ V.T

    projections = [compute_projection(q) for q in samples]
    used = np.max([np.abs(P).max(axis=0) for P in projections], axis=0)[3:] > SAME

    def has_effect_on_rows(columns: list[int]) -> bool:
        """Tell whether the row space depends on these coordinates."""
        for k, q in enumerate(samples):
            moved = q.copy()
            moved[columns] = samples[k - 1][columns]
            if np.abs(compute_projection(moved) - projections[k]).max() > 10.0 * SAME:
                return True
        return False

    if has_effect_on_rows(axle.own_q_places):
        raise UnsupportedError(
            f"{system.name}: what the velocity constraints allow depends on where {axle.body!r} "
            "is, not only on how it moves in its own axes; a manoeuvre is not known"
        )
    names = system.structure.velocity_names
    driven: list[int] = []
    idle: list[int] = []
    steering: list[int] = []
    for v in sorted({*places} - {*axle.own}):
        has_effect = has_effect_on_rows(places[v])
        if used[v] and has_effect:
            raise UnsupportedError(
                f"{system.name}: the rate of {names[v]!r} depends on {names[v]!r} itself, as a "
                "trailer's does; a manoeuvre is not known for that"
            )
        (driven if used[v] else steering if has_effect else idle).append(v)
    if len(steering) > 1:
        both = " and ".join(repr(names[v]) for v in steering)
        raise UnsupportedError(
            f"{system.name}: {both} steer together; a manoeuvre is known for one steering angle"
        )
    return replace(
        axle,
        driven=tuple(driven),
        idle=tuple(idle),
        steering=steering[0] if steering else None,
    )


def _place_axle(axle: Axle, samples: list[Array]) -> Axle:
    """Return the axle at the place on its body that no allowed twist moves sideways.

    Errors: `UnsupportedError` where the twists are too many, too few, or the driven coordinates do
    not follow.
    """
    system = axle.system
    names = system.structure.velocity_names
    twists: list[Array] = []
    for q in samples if axle.steering is not None else samples[:1]:
        N = axle.compute_motion_basis(q)
        if Spectrum(N[:3], 1.0).compute_rank(Level.CLOSED) < N.shape[1]:
            raise UnsupportedError(
                f"{system.name}: with {axle.body!r} at rest some of "
                f"{', '.join(repr(names[v]) for v in axle.driven)} still turn: a manoeuvre is not "
                "known for that"
            )
        twists.append(N[:3])
    left = twists[-1].shape[1]
    if left == 3:
        raise UnsupportedError(
            f"{system.name}: the velocity constraints let {axle.body!r} move in every direction: "
            "no manoeuvre is needed (system.configuration_space.interpolate)"
        )
    if left == 0 or (left == 1 and axle.steering is None):
        raise UnsupportedError(
            f"{system.name}: the velocity constraints leave {axle.body!r} "
            f"{format_count(left, 'freedom')} of motion: it moves along one curve only"
        )
    rows = Spectrum(np.concatenate(twists, axis=1).T).compute_null_space(Level.CLOSED)
    if rows.shape[1] != 1 or left == 2 and axle.steering is not None:
        raise UnsupportedError(
            f"{system.name}: no point of {axle.body!r} is without sideslip for every value of "
            f"{names[axle.steering or 0]!r}: a manoeuvre is known for a body with an axle of its "
            "own"
        )
    a = rows[:, 0] / axle.units[:3]
    size = math.hypot(a[0], a[1])
    if size < SAME * abs(a[2]):
        raise UnsupportedError(
            f"{system.name}: {axle.body!r} cannot turn, so its rolling is a constraint on positions; "
            "a manoeuvre needs a nonholonomic constraint"
        )
    ahead = np.array([a[1], -a[0]]) / size
    foot = a[2] / size * ahead
    if ahead[0] < -SAME or (abs(ahead[0]) <= SAME and ahead[1] < 0.0):
        ahead = -ahead
    middle, sense = _find_axle_middle(axle, samples, foot, ahead)
    angle = math.atan2(sense * ahead[1], sense * ahead[0])
    return replace(
        axle, X_BA=axle.X_BA @ pose(make_rotation(angle, "z"), [*middle, 0.0]), angle=angle
    )


def _find_axle_middle(
    axle: Axle, samples: list[Array], foot: Array, ahead: Array
) -> tuple[Array, float]:
    """Find the middle (2,) of the axle, and 1 where `ahead` (2,) is forwards, -1 in reverse.

    By the ends of velocity constraints that are fixed on the axle: their middle, and the sense of
    their x axes. Where there is none, the middle is the `foot`, next to the body's origin.
    """
    system = axle.system
    q = np.stack(samples)
    X_AG = inverse(fk(system, q, axle.body) @ axle.X_BA)
    reach = 1.0 + float(np.abs(X_AG[:, :3, 3]).max())
    sense = 0.0
    middles: list[Array] = []
    for declared in system._mechanism.constraints.values():
        if not declared.child or not any(r.velocity for r in declared.of.list_rows(system.dim)):
            continue
        X_CE = declared.frames(system.structure.parameters, system.dim)[1]
        X_AE = X_AG @ fk(system, q, declared.child) @ X_CE
        at = X_AE[:, :2, 3]
        along = X_AE[:, :2, 0]
        if max(np.abs(at - at[0]).max(), abs(float(ahead @ (at[0] - foot)))) < SAME * reach:
            middles.append(at[0])
            sense += float(ahead @ along[0]) if np.abs(along - along[0]).max() < SAME else 0.0
    return np.mean(middles or [foot], axis=0), -1.0 if sense < -0.5 else 1.0
