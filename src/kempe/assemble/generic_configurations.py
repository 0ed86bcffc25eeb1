"""Closed configurations at which ranks are computed: the given one, and others nearby.

What is idle is read there, too, since an idle freedom is there at the configurations around as
well.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kempe.arguments import quiet
from kempe.budget import Budget
from kempe.equations.closure_rows import evaluate_constraints
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.errors import InputError
from kempe.first_order.control import find_driven_velocities
from kempe.first_order.idle_freedoms import IdleFreedom, can_have_idle_freedom, find_idle_freedoms
from kempe.first_order.rank import Rank, compute_rank
from kempe.forward.fk import jacobian
from kempe.model.ball_angles import make_regular_chart
from kempe.model.configurations import (
    compute_mid_configuration,
    has_loops,
    make_q,
    refuse_large_numbers,
)
from kempe.model.model import keep_answers
from kempe.model.own_tree import remove_cut_marks
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


@quiet
def find_idle_freedoms_at(system: Model, q: Array) -> tuple[IdleFreedom, ...]:
    """Find the idle freedoms at the closed configuration nearest to q (nq,).

    There are none where the loops cannot be closed.

    Joints are driven that are marked so. Velocities are those of the angles in which balls are
    regular there.
    """
    at = close_configuration(system, q)
    if not at.closed:
        return ()
    system, q, _ = make_regular_chart(system, at.q)
    motors = find_driven_velocities(system, None)
    rank = compute_rank(system, q)
    return find_idle_freedoms(
        system, [rank, *sample_useful_ranks(system, rank, motors, np.random.default_rng(0))], motors
    )


def get_idle_freedoms(system: Model, q: Array | None = None) -> tuple[IdleFreedom, ...]:
    """Find the idle freedoms of a system at a closed configuration.

    The search is made once; where it finds no closed configuration, q (nq,) is taken.
    """
    tree = remove_cut_marks(system)
    found = _find_home_idle_freedoms(tree)
    if found is None:
        return () if q is None else find_idle_freedoms_at(tree, q)
    return found


@keep_answers
def _find_home_idle_freedoms(system: Model) -> tuple[IdleFreedom, ...] | None:
    """Find the idle freedoms at a closed configuration; None if there is none."""
    at = find_closed_configuration(system)
    return find_idle_freedoms_at(system, at.q) if at.closed else None


def find_idle_coordinates(system: Model, q: Array | None = None) -> np.ndarray:
    """Return a mask (nv,) of the velocity coordinates that idle freedoms change.

    Of a rotation, all three are marked.
    """
    moves = [f.moving_velocities for f in get_idle_freedoms(system, q)] if has_loops(system) else []
    out = np.any([np.zeros(system.nv, dtype=bool), *moves], axis=0)
    for iv in system.structure.layout.quaternion_v:
        out[iv : iv + 3] = out[iv : iv + 3].any()
    return np.asarray(out)


def compute_idle_rates(system: Model, q: Array) -> Array:
    """Compute the rows (k, s, nv) that map velocities at q (k, nq) to s idle spin rates [rad/s]."""
    tree = remove_cut_marks(system)
    found = get_idle_freedoms(system) if system.dim == 3 else ()
    rows = [f.in_body[1] @ jacobian(tree, q, f.bodies[0], "body")[:, 3:] for f in found]
    return np.stack(rows, axis=1) if rows else np.zeros((len(q), 0, system.nv))


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
