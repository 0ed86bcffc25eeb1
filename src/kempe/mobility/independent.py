"""Independent coordinates of systems with loops, and charts of their configurations.

A chart names coordinates that can be set, and computes the others from them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.arguments import explain_errors, explain_method_errors, numbers, read_names
from kempe.arrays import unwrap_scalar
from kempe.assemble.answer import Assembly
from kempe.assemble.assemble import assemble
from kempe.assemble.bound import TOLERANCE
from kempe.assemble.idle_freedoms import get_idle_freedoms
from kempe.assemble.nearest_exact import answer_within_tolerance, describe_nearest
from kempe.budget import Budget
from kempe.equations.closure_rows import compute_coordinate_units, evaluate_constraints
from kempe.errors import InputError, UnknownNameError
from kempe.forward.fk import fk, jacobian
from kempe.mobility.mobility import mobility
from kempe.model.configurations import read_finite_q, read_q
from kempe.model.own_tree import remove_cut_marks
from kempe.numerics.newton import run_gauss_newton
from kempe.numerics.rank import Level, Spectrum
from kempe.report import Report
from kempe.spatial import Array, skew
from kempe.status import Status, to_status
from kempe.words import choose_verb, format_count

if TYPE_CHECKING:
    from kempe.assemble.nearest_exact import Idealised
    from kempe.first_order.idle_freedoms import IdleFreedom
    from kempe.model.model import Model


# ---- null vectors that motions have

# Where the equations touch along all of a motion, the null space also has velocities that lead to
# no motion.

DIFFERENCE = 1e-5
"""Step of the central differences of the Jacobian, in radians and characteristic lengths."""
VANISHES = 1e-6
"""Second derivatives below this count as zero."""


def select_moving_part(
    system: Model, q: Array, left: Array, null_space: Array, scale: Array
) -> Array:
    """Select the part (nv, d) of a null space (nv, p) that consists of velocities of motions.

    It is that of the scaled Jacobian at q (nq,).

    `left` (rows, k) are the left null vectors. Along a motion at which the rank stays, the second
    derivatives of the equations vanish for `left`, a velocity and any of the null space; where
    these leave less than the null space, and as much as there are freedoms, the rest is shaky.
    Elsewhere the null space is returned as it is.
    """
    some = np.cos(np.arange(null_space.shape[1], dtype=float))[None]
    if (
        not np.abs(_compute_second_derivatives(system, q, left, null_space, scale, some)).max()
        > VANISHES
    ):
        return null_space
    blocks = _compute_second_derivatives(
        system, q, left, null_space, scale, np.eye(null_space.shape[1])
    )
    spectrum = Spectrum(blocks.reshape(-1, null_space.shape[1]), 1.0)
    shaky = spectrum.compute_rank(Level.GENERIC)
    if not 0 < shaky < null_space.shape[1]:
        return null_space

    if mobility(system, q).dof != null_space.shape[1] - shaky:
        return null_space
    return null_space @ spectrum.compute_null_space(Level.GENERIC)


def _compute_second_derivatives(
    system: Model, q: Array, left: Array, null_space: Array, scale: Array, along: Array
) -> Array:
    """Compute second derivatives (n, k, p) of the equations, projected on left null vectors.

    One direction is a combination (n, p) of the null space, the other runs over the null space.
    """
    steps = DIFFERENCE * scale * (along @ null_space.T)
    J = evaluate_constraints(
        system,
        system.structure.layout.integrate_velocity(q, np.concatenate([steps, -steps])),
        True,
        True,
    )[1]
    return left.T @ ((J[: len(steps)] - J[len(steps) :]) / (2.0 * DIFFERENCE)) @ null_space


# ---- charts

# Near a regular configuration the closed configurations form a surface of dimension p, and p of the
# n velocity coordinates can be its parameters: a *chart* (Haug, 1989, chapter 3; the lecture's
# generalised positions). It is as good as the smallest singular value of the tangent space's rows
# of these p coordinates: 1 where they are the tangent space, 0 where they no longer move the others
# (a turning point of a driver).
#
# The three angles of a ball would be such coordinates, but are not part of q: their place take the
# components of the rotation vector from where the chart was chosen (exponential coordinates,
# Murray, Li, Sastry, 1994, section 2.2).

ENOUGH = 0.1
"""Of the movement of a ball, the part that an angle or a length must have to be preferred to it."""
MANY = 300
"""Velocities from which idle spins are looked for only where there is no other choice."""
TRIES = 60
LONGEST = 0.5
"""Steps of a search for rotation vectors, and the longest, in radians and characteristic
lengths."""
REACHED = 1e-9
"""How far coordinates may be from what was requested."""
FARTHEST = 3.0
"""Angle of a ball from the origin up to which its rotation vector is used."""
WORST = 0.02
"""Conditioning below which a chart is given up, for up to four coordinates a freedom; with more,
less is usual."""


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Chart(Report):
    """Independent coordinates of a system near a closed configuration.

    Attributes
    ----------
    independent, dependent
        Names of the p chosen coordinates, and of all others. For a ball joint B, `B.ex`, `B.ey` and
        `B.ez` are the rotation vector [rad] from its orientation at `origin`, in axes of its child.
    origin
        Configuration (nq,) at which the coordinates were chosen.
    quality
        Conditioning at the origin, from 0 (useless) to 1.
    idle
        The last of the independent coordinates that only move idle bodies.
    """

    _entries = ("system", "independent", "dependent", "idle", "useful", "dim", "quality", "origin")

    system: Model
    independent: tuple[str, ...]
    dependent: tuple[str, ...]
    origin: Array
    quality: float
    idle: tuple[str, ...] = ()

    @property
    def within(self) -> Idealised | None:  # type: ignore[override]
        """Nearest mechanism that closes exactly, if the chart is for that mechanism; else None."""
        return self.system._ideal

    @property
    def dim(self) -> int:
        """Number p of independent coordinates."""
        return len(self.independent)

    @cached_property
    def _plain(self) -> bool:
        """Whether all independent coordinates are entries of q: angles and lengths."""
        return all(n in self.system.coordinate_names for n in self.independent)

    @property
    def useful(self) -> tuple[str, ...]:
        """The independent coordinates that are not idle."""
        return self.independent[: self.dim - len(self.idle)]

    def u(self, q: Any) -> Array:
        """Return the independent coordinates (..., p) of configurations (..., nq)."""
        q = read_q(self.system, q)
        if self._plain:
            return q[..., [self.system.coordinate_names.index(n) for n in self.independent]]
        way = self.system.structure.layout.compute_difference(self.origin, q)
        way[..., self.system.structure.layout.vector_v] = q[
            ..., self.system.structure.layout.vector_q
        ]
        return way[..., self._list_velocity_indices()]

    def q(self, u: Any, start: Any = None) -> Assembly:
        """Find the configuration with given independent coordinates, by a search from a start.

        Parameters
        ----------
        u
            Independent coordinates (..., p). Idle ones may be left out; idle bodies then stay about
            as they are at `start`.
        start
            Configuration at which the search starts (default: the origin). Far from it the result
            may be on another branch; approach it in steps.
        """
        u = numbers(u, "u")
        given = self.independent
        if u.ndim == 0 and 1 in (self.dim, len(self.useful)):
            u = u[None]
        if u.shape[-1:] != (self.dim,):
            given = self.useful
        if u.shape[-1:] != (len(given),):
            names = ", ".join(self.useful) + (
                f" (and, idle, {', '.join(self.idle)})" if self.idle else ""
            )
            raise InputError(f"u has shape {u.shape}; needed is (..., {self.dim}): {names}")
        start = self.origin if start is None else start
        if self._plain:
            return assemble(
                self.system,
                {n: u[..., i] for i, n in enumerate(given)},
                start,
                budget=Budget(starts=1),
            )
        known = {n: u[..., i] for i, n in enumerate(given) if not _is_exponential(self.system, n)}
        if len(known) < len(given):
            start = self._solve_configurations(u, given, start)
        answer = assemble(self.system, known, start, budget=Budget(starts=1))
        if len(known) == len(given):
            return answer
        off = np.abs(self.u(answer.q)[..., : len(given)] - u).max(axis=-1, initial=0.0)
        success = np.logical_and(answer.success, off < REACHED)
        code = np.where(np.logical_and(answer.success, ~success), Status.NOT_FOUND, answer.code)
        bound = copy(answer.assembler)
        own = self.system.structure.velocity_names
        # rotation vectors are given, too: they leave nothing open
        bound.held |= {own[i] for i in self._list_velocity_indices(given)}
        return replace(
            answer, success=unwrap_scalar(success), code=to_status(code), assembler=bound
        )

    def _list_velocity_indices(self, names: Iterable[str] | None = None) -> list[int]:
        """List the velocity indices of the independent coordinates, or of given ones."""
        names = self.independent if names is None else tuple(names)
        own = self.system.structure.velocity_names
        exponential = {} if {*names} <= {*own} else _number_coordinates(self.system)
        return [own.index(n) if n in own else exponential[n] for n in names]

    def _compute_rates(self, q: Array, names: tuple[str, ...]) -> Array:
        """Compute rates (len(names), nv) of independent coordinates from velocities, at q (nq,)."""
        system = self.system
        rows = self._list_velocity_indices(names)
        out = np.eye(system.nv)
        way = system.structure.layout.compute_difference(self.origin, q)
        for i in system.structure.layout.quaternion_v.tolist():
            out[i : i + 3, i : i + 3] = _compute_log_rates(way[i : i + 3])
        return out[rows]

    def _solve_configurations(self, u: Array, given: tuple[str, ...], near: Any) -> Array:
        """Solve for the closed configurations (..., nq) with given coordinates, nearest to `near`."""
        system = self.system
        scale = compute_coordinate_units(self.system)
        rows = self._list_velocity_indices(given)
        start = read_q(system, near)
        lead = np.broadcast_shapes(u.shape[:-1], start.shape[:-1])
        starts = np.broadcast_to(start, (*lead, system.nq)).reshape(-1, system.nq)
        wanted = np.broadcast_to(u, (*lead, len(given))).reshape(-1, len(given))
        out = np.array(starts)

        def evaluate_all_rows(q: Array, target: Array) -> tuple[Array, Array]:
            """Evaluate loop equations and coordinate errors, with their Jacobian."""
            error, J = evaluate_constraints(system, q, True, True)
            more = self._compute_rates(q, given) * scale / scale[rows, None]
            return np.append(
                error, (self.u(q)[: len(given)] - target) / scale[rows]
            ), np.concatenate([J, more])

        for k, target in enumerate(wanted):
            out[k] = run_gauss_newton(
                lambda q, u=target: evaluate_all_rows(q, u),
                out[k],
                TRIES,
                level=Level.CLOSED,
                longest=LONGEST,
                move=lambda q, y: system.structure.layout.integrate_velocity(q, scale * y),
            ).x
        return out.reshape(*lead, system.nq)

    def tangent(self, q: Any) -> Array:
        """Compute rates (nv, p) of all velocities per independent rate, at a closed q (nq,)."""
        N, scale = compute_tangent_space(self.system, q, self.dim)
        N = scale[:, None] * N
        if self._plain:
            return N @ np.linalg.inv(N[self._list_velocity_indices()])
        return N @ np.linalg.inv(self._compute_rates(read_q(self.system, q), self.independent) @ N)

    def condition(self, q: Any) -> float:
        """Compute the conditioning of the independent coordinates at q (nq,), from 0 to 1 (best).

        It is 0 where a ball with exponential coordinates has turned by nearly half a turn, where
        these jump.
        """
        N, scale = compute_tangent_space(self.system, q, self.dim)
        if self._plain:
            return _measure_quality(N, self._list_velocity_indices())
        q = read_q(self.system, q)
        way = self.system.structure.layout.compute_difference(self.origin, q)
        rows = {*self._list_velocity_indices()}
        own = {
            i
            for i in self.system.structure.layout.quaternion_v.tolist()
            if {i, i + 1, i + 2} & rows
        }
        if any(np.linalg.norm(way[i : i + 3]) > FARTHEST for i in own):
            return 0.0
        rates = (
            self._compute_rates(q, self.independent)
            * scale
            / scale[self._list_velocity_indices(), None]
        )
        return min(1.0, float(Spectrum(rates @ N).smallest)) if self.dim else 1.0

    def valid(self, q: Any) -> bool:
        """Return whether the chart is usable at the closed configuration q (nq,)."""
        return self.condition(q) >= _bound_quality(self.dim, self.system.nv)

    def next(self, q: Any) -> Chart:
        """Return the best chart at the closed configuration q (nq,)."""
        return independent(self.system, q)

    @property
    def status(self) -> str:
        """Sentence that names independent and dependent coordinates, with the conditioning."""
        idle = f"; idle: {', '.join(self.idle)}" if self.idle else ""
        return (
            f"{format_count(self.dim, 'independent coordinate')}: "
            f"{', '.join(self.useful) or 'none'}{idle} (conditioning {self.quality:.2g}); "
            f"dependent: {', '.join(self.dependent) or 'none'}{describe_nearest(self.within)}"
        )


@explain_errors
@answer_within_tolerance("q")
def independent(
    system: Model,
    q: Any = None,
    prefer: Iterable[str] = (),
    *,
    tolerance: float | str | None = None,
) -> Chart:
    """Choose independent coordinates at a closed configuration; see `System.independent`.

    Source: QR with column pivoting of the tangent space (Golub, 1965).
    """
    if q is None:
        answer = assemble(system)
        if not answer:
            raise InputError(f"{system.name} could not be assembled: {answer.status}")
        q = answer.q
    q = read_q(system, q)
    N, scale = compute_tangent_space(system, q)
    p = N.shape[1]
    wish = read_names(prefer, "prefer")
    rows = _find_preferred_indices(system, wish) if wish else []
    if len(set(rows)) < len(rows) or len(rows) > p:
        given = (
            f"{format_count(len(rows), 'coordinate')} {choose_verb(len(rows), 'is', 'are')} "
            "preferred"
        )
        raise InputError(
            f"{given}; q has {format_count(p, 'degree')} of freedom here, so prefer at most "
            f"{p}, each of them once"
        )
    least = _bound_quality(p, system.nv)
    if rows and _measure_quality(N, rows) < least:
        best = independent(system, q)
        raise InputError(
            f"{', '.join(wish)} cannot be set independently here: conditioning "
            f"{_measure_quality(N, rows):.2g}, at least {least:.2g} is needed; the best choice is "
            f"{', '.join(best.independent)}"
        )
    plain = sorted(system.structure.layout.vector_v.tolist())
    found = _extend_rows(N, rows, plain)
    idle = []
    quality = _measure_quality(N, found)
    sure = len(found) == p and quality >= least
    if not sure or (1 < p < system.nv < MANY and system.dim == 3):
        spins = get_idle_freedoms(system, q)
        if spins or not sure:
            found, idle = _choose_rows(
                N, rows, plain, spins, _find_idle_part(system, q, N, scale, spins)
            )
            quality = _measure_quality(N, found)
    if len(found) < p or (p and quality < least):
        raise InputError(
            f"no choice of coordinates is independent here: the best has conditioning {quality:.2g}"
        )
    idle = sorted(idle)
    chosen = [*sorted({*found} - {*idle}), *idle]
    names = (
        system.structure.velocity_names
        if {*chosen} <= {*plain}
        else tuple(_number_coordinates(system))
    )
    rest = tuple(n for v, n in enumerate(system.structure.velocity_names) if v not in chosen)
    return Chart(
        system,
        tuple(names[v] for v in chosen),
        rest,
        q.copy(),
        quality,
        tuple(names[v] for v in idle),
    )


def _find_preferred_indices(system: Model, names: Iterable[str]) -> list[int]:
    """Find the velocity indices of the preferred coordinates.

    Errors: `UnknownNameError`.
    """
    number = _number_coordinates(system)
    for name in names:
        if name not in number:
            raise UnknownNameError("coordinate", name, sorted(number), system.name)
    return [number[n] for n in names]


def _choose_rows(
    N: Array, rows: list[int], plain: list[int], spins: tuple[IdleFreedom, ...], idle: Array
) -> tuple[list[int], list[int]]:
    """Choose the rows of p coordinates, and those of them that are idle.

    Useful coordinates come before idle ones, and among each angles and lengths first.
    """
    nv, p = N.shape
    moved = (
        np.any([s.moving_velocities for s in spins], axis=0) if spins else np.zeros(nv, dtype=bool)
    )
    others = [v for v in range(nv) if v not in plain]
    found = list(rows)
    requested = sum(bool(moved[v]) for v in rows)
    for still in (True, False):
        most = min(p, p - idle.shape[1] + requested) if still else p
        own = [v for v in range(nv) if moved[v] != still]
        for stage in (plain, others):
            usable = [v for v in stage if moved[v] != still and v not in found]
            found = _extend_rows(N, found, usable, most, own if stage is plain else ())
    spinning = [v for v in found if moved[v]]
    return found, spinning if len(spinning) == idle.shape[1] else []


def _find_idle_part(
    system: Model, q: Array, N: Array, scale: Array, spins: tuple[IdleFreedom, ...]
) -> Array:
    """Find the combinations (p, k) of a tangent basis (nv, p) that are idle spins.

    They are orthonormal.
    """
    tree = remove_cut_marks(system)
    parts = [np.zeros((N.shape[1], 0))]
    for spin in spins:
        rests = N[~spin.moving_velocities]
        part = Spectrum(rests, 1.0).compute_null_space(Level.CLOSED)
        if part.shape[1] > 1:  # they move what is useful as well: the spin is what keeps the line
            J = jacobian(tree, q, spin.bodies[0])
            arm, line = spin.in_body @ fk(tree, q, spin.bodies[0])[:3, :3].T
            keeps = np.concatenate([J[:3] - skew(arm) @ J[3:], skew(line) @ J[3:]])
            part = Spectrum(
                np.concatenate([rests, keeps @ (scale[:, None] * N)]), 1.0
            ).compute_null_space(Level.CLOSED)
        parts.append(part)
    return Spectrum(np.concatenate(parts, axis=1), 1.0).compute_column_space(Level.CLOSED)


def _is_exponential(system: Model, name: str) -> bool:
    """Return whether this is the name of a component of a rotation vector."""
    return name not in system.coordinate_names


def _number_coordinates(system: Model) -> dict[str, int]:
    """Number the names that coordinates of a chart can have, by velocity index."""
    names = system.structure.velocity_names
    vector = {*system.structure.layout.vector_v.tolist()}
    return {n if v in vector else f"{n[:-2]}e{n[-1]}": v for v, n in enumerate(names)}


def _compute_log_rates(w: Array) -> Array:
    """Compute rates (3, 3) of a rotation vector (3,) from the body's angular velocity.

    After Bullo and Murray, 1995.
    """
    angle = float(np.linalg.norm(w))
    K = skew(w)
    if angle < 1e-4:
        factor = 1.0 / 12.0 + angle**2 / 720.0
    else:
        factor = (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
    return np.eye(3) + 0.5 * K + factor * K @ K


def compute_tangent_space(system: Model, q: Any, dim: int | None = None) -> tuple[Array, Array]:
    """Compute an orthonormal basis (nv, p) of the velocities that keep all loops closed at q (nq,).

    Also returns the scales (nv,).

    Those are left out that lead to no motion, where the equations touch all along
    (`kempe.motion.crossings`); this need not be looked at where p is known (`dim`).

    Slides are measured in characteristic lengths: velocities in units are ``scale * N``. Errors:
    `InputError` if q is not closed.
    """
    q = read_finite_q(system, q)
    error, J = evaluate_constraints(system, q, True, True)
    if not np.linalg.norm(error) <= 10.0 * TOLERANCE:
        raise InputError(
            f"q does not close the loops: their equations have a residual of "
            f"{np.linalg.norm(error):.3g}; assemble closes them"
        )
    spectrum = Spectrum(J, 1.0)
    N = spectrum.compute_null_space(Level.CLOSED)
    rank = spectrum.compute_rank(Level.CLOSED)
    scale = compute_coordinate_units(system)
    if rank < len(J) and 1 < N.shape[1] != dim:
        N = select_moving_part(system, q, spectrum.compute_left_null_space(Level.CLOSED), N, scale)
    return N, scale


def _measure_quality(N: Array, rows: list[int]) -> float:
    """Compute the smallest singular value of these rows of an orthonormal basis."""
    return min(1.0, float(Spectrum(N[rows]).smallest)) if rows else 1.0


def _bound_quality(p: int, n: int) -> float:
    """Bound the acceptable conditioning of p of n coordinates from below.

    Even the best choice has no more than sqrt(p / n).
    """
    return WORST * min(1.0, 2.0 * np.sqrt(p / max(n, 1)))


def _extend_rows(
    N: Array,
    rows: list[int],
    usable: list[int],
    most: int | None = None,
    better: Sequence[int] = (),
) -> list[int]:
    """Extend rows to p (or `most`), each time by the row farthest from the span.

    It ends where one of the `better` rows is much farther.
    """
    rows = list(rows)
    p = N.shape[1] if most is None else most
    rest = N.copy()
    for row in rows:
        rest = _remove_direction(rest, rest[row])
    while len(rows) < p and usable:
        size = np.linalg.norm(rest[usable], axis=1)
        # rounding does not decide between equals: the first is taken
        row = usable[int(np.argmax(size.round(9)))]
        if better and size.max() < ENOUGH * np.linalg.norm(rest[better], axis=1).max():
            break
        rows.append(row)
        rest = _remove_direction(rest, rest[row])
    return rows


def _remove_direction(N: Array, direction: Array) -> Array:
    """Remove the component along a direction from the rows of N."""
    size = np.linalg.norm(direction)
    if size < 1e-300:
        return N
    u = direction / size
    return N - np.outer(N @ u, u)
