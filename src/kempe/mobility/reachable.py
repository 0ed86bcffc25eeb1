"""How far motions reach that obey rows A(q) v = b: growth vectors at a configuration, around it,
and along motions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kempe.equations.velocity import VelocityRows, tangent_rows, velocity_rows
from kempe.mobility.growth_vectors import Distribution, Growth, distribution, growth
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

STEP = 0.7
"""Mean length of the step of a velocity to a configuration drawn at random, in radians and
characteristic lengths."""
TRIES = 8
"""Draws of such a configuration."""
PIECES = 3
"""Random motions, one after the other, to a configuration that is reached from a given one."""
EXACT = 1e-12
"""Tolerance of the integration of such motions."""
DRIFT = 1e-9
"""How far it leads away from what such motions reach, at most."""


def velocity_freedoms(system: Model, q: Array) -> int | None:
    """Freedoms of velocity at q (nq,) that all constraints leave; None without constraints of
    velocity.
    """
    if not velocity_rows(system).names:
        return None
    rows = tangent_rows(system)
    which = [i for i, row in enumerate(rows.names) if not row.sided]
    return distribution(rows, q, which).dimension - (0 if rows.steady else 1)


@dataclass(frozen=True, eq=False)
class EvaluationPoint:
    """Where rows are looked at: configuration, time, the rows that hold positions and how to close
    loops.

    `closed` gives for a configuration one with all loops closed near it, or None.
    """

    rows: VelocityRows
    q: Array
    t: float
    holding: tuple[int, ...]
    closed: Callable[[Array], Array | None]
    error: float = 1e-15
    """How far the configuration is from where it should be, in units."""

    def at(self, q: Array) -> EvaluationPoint:
        """The same at another configuration."""
        return replace(self, q=q)

    @property
    def extra(self) -> int:
        """1 where the time is among the directions."""
        return 0 if self.rows.steady else 1

    def null_space(self, which: Sequence[int] = ()) -> Distribution:
        """Velocities that what holds positions, and further rows, leave free."""
        return distribution(self.rows, self.q, (*self.holding, *which), self.t, self.error)


@dataclass(frozen=True, eq=False)
class Reach:
    """What motions reach: growth vectors here and around, the dimension reached from here and from
    around.

    `growth` and `dimension` are None where the rows lose rank here; the other numbers do not count
    the time.
    """

    free: int
    growth: tuple[int, ...] | None
    around: tuple[int, ...]
    dimension: int | None
    dimension_around: int
    degree: int | None
    doubtful: bool


def random_place(place: EvaluationPoint, rng: np.random.Generator) -> EvaluationPoint | None:
    """A configuration drawn at random around, with loops closed; None if none is found."""
    basis = place.null_space().basis[: place.rows.layout.nv]
    units = place.rows.units[:-1]
    step = STEP
    for _ in range(TRIES):
        z = basis @ rng.normal(size=len(basis.T))
        q = place.closed(place.rows.layout.integrate(place.q, step * units * z))
        if q is not None:
            return place.at(q)
        step *= 0.6
    return None


def moved_place(
    place: EvaluationPoint, which: Sequence[int], rng: np.random.Generator
) -> EvaluationPoint:
    """A configuration that random motions reach which obey the rows."""
    from scipy import integrate

    rows = place.rows
    layout = rows.layout
    units = rows.units[: rows.layout.nv + place.extra]
    start = place.q
    state = np.append(np.zeros(layout.nv), place.t)
    for _ in range(PIECES):
        wish = rng.normal(size=len(units))
        chosen = place.at(start).null_space(which).chosen

        def rate(_: float, x: Array, chosen: np.ndarray = chosen, wish: Array = wish) -> Array:
            A, b = rows.values(x[: layout.nq], x[layout.nq])
            whole = (np.concatenate([A, -b[:, None]], axis=1) if place.extra else A)[chosen] * units
            v = (wish - np.linalg.lstsq(whole, whole @ wish, rcond=None)[0]) * units
            out = np.zeros(layout.nq + 1)
            out[layout.vector_q] = v[layout.vector_v]
            for iq, iv in zip(layout.quaternion_q, layout.quaternion_v, strict=True):
                (w, x_, y, z) = x[iq : iq + 4]
                (a, b_, c) = v[iv : iv + 3]
                out[iq : iq + 4] = (
                    -x_ * a - y * b_ - z * c,
                    w * a + y * c - z * b_,
                    w * b_ + z * a - x_ * c,
                    w * c + x_ * b_ - y * a,
                )
                out[iq : iq + 4] *= 0.5
            out[-1] = v[layout.nv] if place.extra else 0.0
            return out

        begin = np.append(start, state[-1])
        solved = cast(Any, integrate).solve_ivp(
            rate, (0.0, STEP), begin, "DOP853", rtol=EXACT, atol=EXACT
        )
        end = solved.y[:, -1]
        start = layout.integrate(end[:-1], np.zeros(layout.nv))
        state[-1] = end[-1]
    return replace(place, q=start, t=float(state[-1]), error=DRIFT)


def reach(
    place: EvaluationPoint,
    around: EvaluationPoint | None,
    which: Sequence[int],
    rng: np.random.Generator,
) -> Reach:
    """What motions reach from a place that obey further rows; `around` is a place drawn at random."""
    extra = place.extra
    whole = place.null_space().dimension
    here = place.null_space(which)
    there = here if around is None else around.null_space(which)
    far = growth(there, rng, whole, False)
    if far.dimensions[-1] < whole and around is not None:  # the end is confirmed at another place
        other = random_place(around, rng)
        more = far if other is None else growth(other.null_space(which), rng, whole, False)
        far = max(far, more, key=lambda g: g.dimensions[-1])
    most = far.dimensions[-1]
    if here.dimension > there.dimension:  # no field of velocities at q goes on smoothly around
        return Reach(
            here.dimension - extra, None, _less(far, extra), None, most - extra, None, far.doubtful
        )
    near = growth(here, rng, most, False)
    doubtful = far.doubtful or near.doubtful
    least = most
    if near.dimensions[-1] < most:
        along = growth(moved_place(place, which, rng).null_space(which), rng, most, False)
        least = along.dimensions[-1]
        doubtful = doubtful or along.doubtful
        near = growth(here, rng, least, True) if near.dimensions[-1] < least else near
        doubtful |= near.doubtful
    found = near.dimensions
    degree = found.index(least) + 1 if least in found else None
    # what is decided is that so many are reached, not that no more are
    if doubtful and least < whole:
        degree = None
    found = found[:degree] + (least,) * (least < whole) if degree else found
    return Reach(
        here.dimension - extra,
        tuple(d - extra for d in found),
        _less(far, extra),
        least - extra,
        most - extra,
        degree,
        doubtful,
    )


def _less(found: Growth, extra: int) -> tuple[int, ...]:
    return tuple(d - extra for d in found.dimensions)
