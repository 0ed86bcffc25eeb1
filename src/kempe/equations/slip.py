"""Velocity constraints for solvers: rows at a configuration, and where a path slips."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.equations.velocity import (
    evaluate_velocity_rows,
    list_velocity_row_names,
    record_velocity_rows,
)
from kempe.errors import InputError
from kempe.model.model import keep_answers
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

if TYPE_CHECKING:
    from collections.abc import Sequence

    from kempe.model.model import Model

RELATIVE = 1e-6
ABSOLUTE = 1e-9
"""Slip, of the sizes that add up to it and in metres or radians, up to which a path counts as
without."""
EXPLAINED = 0.5
"""Part of the change from one way to two by which a slip must exceed what the bend between samples
explains."""
CONTRADICTION = 1e-9
"""By how much velocity rows may contradict loops, of rows of size 1."""


@keep_answers
def has_velocity_constraints(system: Model) -> bool:
    """Whether the system has velocity constraints."""
    return bool(list_velocity_row_names(system))


def compute_unit_rows(system: Model, q: Array, scale: Array) -> tuple[Array, Array]:
    """Compute the velocity rows A (m, nv), scaled to length 1, and their values b (m,), at q.

    The columns are of scaled velocities; the time is 0.
    """
    A, b = evaluate_velocity_rows(system, q)
    A = A * scale
    size = np.linalg.norm(A, axis=1)
    size = np.where(size > 0.0, size, 1.0)
    return A / size[:, None], b / size


def find_shortest_velocity(C: Array, A: Array, b: Array) -> Array:
    """Find the shortest velocity vector (nv,) with C v = 0 (loops) and A v = b (velocity rows).

    Errors: `InputError` where they contradict each other.
    """
    if not b.any():
        return np.zeros(len(A.T))
    M = np.concatenate([C, A])
    wanted = np.concatenate([np.zeros(len(C)), b])
    u = Spectrum(M).solve_least_squares(wanted, Level.CLOSED)
    if (gap := float(np.abs(M @ u - wanted).max())) > CONTRADICTION * max(
        1.0, float(np.abs(b).max())
    ):
        raise InputError(
            "the velocity constraints cannot be satisfied at q: they contradict loops or each "
            f"other by {gap:.2g} (rows of size 1)"
        )
    return u


@dataclass(frozen=True)
class Slip:
    """The first slip of a path: before sample `index`, in the row called `name`.

    It slips by `amount` within the `time`.
    """

    index: int
    name: str
    amount: float
    time: float
    unit: str

    @property
    def text(self) -> str:
        """Amount and place of the slip, as text."""
        return f"slips by {abs(self.amount):.3g} {self.unit} across {self.name!r}"


def find_first_slip(
    system: Model, q: Array, times: Sequence[float] | Array | None = None
) -> Slip | None:
    """Find where a path of configurations (n, nq) slips first; None if it does not slip.

    The rows times the way between two samples, at its middle, are what they slip there, but for the
    third power of the distance. Ways over two samples are compared with those over one to tell that
    apart (Richardson).
    """
    if len(q) < 2 or not has_velocity_constraints(system):
        return None
    clock = np.arange(float(len(q))) if times is None else np.asarray(times, dtype=float)
    one = _compute_slip_velocities(system, q, clock, 1)
    if len(q) == 2:
        way = system.structure.layout.compute_difference(q[0], q[1])
        bend = np.abs(
            (
                evaluate_velocity_rows(system, q[1], clock[1])[0]
                - evaluate_velocity_rows(system, q[0], clock[0])[0]
            )
            @ way
        )
        slips = one.slip
        allowed = EXPLAINED * bend[None] + ABSOLUTE + RELATIVE * one.size
        span = one.time
        first = 1
    else:
        two = _compute_slip_velocities(system, q, clock, 2)
        h = one.length
        a = h[:-1]
        b = h[1:]
        odd = (a + b) ** 3 - a**3 - b**3
        share = np.where(odd > 0.0, (a**3 + b**3) / np.where(odd > 0.0, odd, 1.0), 0.0)
        slips = one.slip[:-1] + one.slip[1:]
        explained = (share + EXPLAINED)[:, None] * _compute_explained_sizes(
            system, two.slip - slips
        )
        allowed = explained + ABSOLUTE + RELATIVE * (one.size[:-1] + one.size[1:])
        span = two.time
        first = 2
    over = np.abs(slips) - allowed
    bad = np.flatnonzero((over > 0.0).any(axis=1))
    if not len(bad):
        return None
    k = int(bad[0])
    row = int(np.argmax(over[k]))
    name = record_velocity_rows(system).names[row].of
    unit = record_velocity_rows(system).names[row].unit.removesuffix("/s")
    return Slip(k + first, name, float(slips[k, row]), float(span[k]), unit)


def _compute_explained_sizes(system: Model, bend: Array) -> Array:
    """Compute the slip (n, m) that the curvature (n, m) of the path between samples explains.

    It is the largest near each sample, over all rows of one unit.
    """
    units = np.array([row.unit for row in record_velocity_rows(system).names])
    out = np.empty_like(bend)
    for unit in set(units.tolist()):
        size = np.linalg.norm(bend[:, units == unit], axis=1)
        near = np.pad(size, 1, mode="edge")
        out[:, units == unit] = np.maximum(np.maximum(near[:-2], near[1:-1]), near[2:])[:, None]
    return out


class _SlipVelocities(NamedTuple):
    """Slip, sum of the sizes of its terms, length and time of each way between samples."""

    slip: Array
    size: Array
    length: Array
    time: Array


def _compute_slip_velocities(system: Model, q: Array, clock: Array, step: int) -> _SlipVelocities:
    """Compute the slip of each row over each way between samples that are `step` apart."""
    way = system.structure.layout.compute_difference(q[:-step], q[step:])
    middle = q[1:-1] if step == 2 else system.structure.layout.integrate_velocity(q[:-1], 0.5 * way)
    time = clock[step:] - clock[:-step]
    when = 0.5 * (clock[step:] + clock[:-step])
    A, b = evaluate_velocity_rows(system, middle, when)
    slip = np.einsum("nij,nj->ni", A, way) - b * time[:, None]
    size = np.einsum("nij,nj->ni", np.abs(A), np.abs(way)) + np.abs(b) * time[:, None]
    return _SlipVelocities(slip, size, np.linalg.norm(way, axis=1), time)
