"""Closed configurations at which ranks are computed: the given one, and others nearby."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kempe.budget import Budget
from kempe.equations.closure_rows import evaluate_constraints
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.errors import InputError
from kempe.first_order.idle_freedoms import can_have_idle_freedom
from kempe.first_order.rank import Rank, compute_rank
from kempe.model.configurations import (
    compute_mid_configuration,
    make_q,
    refuse_large_numbers,
)
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

EXACT = 1e-13
"""Residual, in radians and characteristic lengths, up to which a configuration is closed as it
is."""
NEAR = 1e-6
"""Residual up to which a configuration is closed by a few steps; above, the nearest closed one is
searched."""
POINTS = 3
MORE = 12
"""Generic configurations that are looked at, and those besides where several branches may meet."""
STEP = 0.1
"""Length of the step along the null space to a generic configuration, for each freedom, in radians
and mean lengths."""
AWAY = 0.3
"""Part of the step that must be left after closing the loops: else the mechanism has snapped
back."""


@dataclass(frozen=True, eq=False)
class NearestClosed:
    """A configuration and whether it is closed.

    `given` is the residual as given, `why` the reason why it is not closed.
    """

    q: Array
    closed: bool
    given: float
    residual: float
    why: str = ""


def close_configuration(system: Model, q: Array) -> NearestClosed:
    """Close the loops at the configuration nearest to `q` (nq,), to machine precision."""
    given = _compute_residual(system, refuse_large_numbers(system, q, "q"))
    if not np.isfinite(given):
        raise InputError(
            "q leads to residuals of the loops that are not finite: a coordinate is too large"
        )
    if given <= EXACT:
        return NearestClosed(q, True, given, given)
    from kempe.assemble.bound import get_equation_assembler

    answer = get_equation_assembler(system)(
        start=q, limits=False, prefer="nearest" if given > NEAR else None, budget=Budget(starts=1)
    )
    if answer.success:
        return NearestClosed(answer.q, True, given, float(answer.residual))
    return NearestClosed(answer.q, False, given, float(answer.residual), str(answer.status))


def find_closed_configuration(system: Model) -> NearestClosed:
    """Find a closed configuration: the posture 'closed', the middle of the limits, or by search."""
    at = close_configuration(
        system,
        make_q(system, "closed")
        if "closed" in system.structure.posture_names
        else compute_mid_configuration(system),
    )
    if at.closed and not pack_one_sided_rows(system).compute_excess(at.q, declared=True).any():
        return at
    from kempe.assemble.assemble import assemble

    answer = assemble(system, limits=False)
    if answer.success:
        return close_configuration(system, answer.q)
    if at.closed:
        return at
    return NearestClosed(answer.q, False, at.given, float(answer.residual), str(answer.status))


def _compute_residual(system: Model, q: Array) -> float:
    """Compute the norm of the residual of all loops at q (nq,)."""
    values = evaluate_constraints(system, q, False, True)[0]
    return float(np.linalg.norm(values))


def sample_useful_ranks(
    system: Model, rank: Rank, motors: Iterable[int] | None, rng: np.random.Generator
) -> list[Rank]:
    """Compute ranks at configurations nearby, if the rank at one configuration may not suffice.

    `motors` are the driven velocities.
    """
    return (
        sample_nearby_ranks(system, rank, rng)
        if rank.n_dependent or motors or can_have_idle_freedom(system, rank, motors)
        else []
    )


def sample_nearby_ranks(system: Model, rank: Rank, rng: np.random.Generator) -> list[Rank]:
    """Compute ranks at random closed configurations along the null space.

    The list is empty if every step snaps back.
    """
    if not rank.nullity:
        return []
    # a point of full rank is generic itself
    found = _compute_nearby_ranks(system, rank, rng, POINTS if rank.n_dependent else 1)
    if rank.n_dependent and (len(found) < POINTS or any(r.nullity != rank.nullity for r in found)):
        found += _compute_nearby_ranks(system, rank, rng, MORE)
    return found


def _compute_nearby_ranks(
    system: Model, rank: Rank, rng: np.random.Generator, count: int
) -> list[Rank]:
    """Compute ranks at closed configurations next to random steps along the null space.

    Each is one step, because there is no curve to follow where the rank drops.
    """
    from kempe.assemble.bound import get_equation_assembler

    z = rng.normal(size=(count, rank.nullity)) @ rank.null_space.T
    size = STEP * np.sqrt(rank.nullity)
    z *= size / np.linalg.norm(z, axis=1, keepdims=True)
    starts = system.structure.layout.integrate_velocity(
        np.broadcast_to(rank.q, (count, system.nq)), z * rank.units
    )
    answer = get_equation_assembler(system)(start=starts, limits=False, budget=Budget(starts=1))
    moved = np.linalg.norm(
        system.structure.layout.compute_difference(rank.q, answer.q) / rank.units, axis=1
    )
    good = np.asarray(answer.success) & (moved > AWAY * size)
    return [compute_rank(system, q) for q in answer.q[good]]
