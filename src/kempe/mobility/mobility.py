"""Mobility: degrees of freedom by Grübler count, by rank and exact; redundant constraints."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers import wording
from kempe.arguments import explain_errors, make_generator
from kempe.assemble.explain import find_coinciding_joints
from kempe.assemble.generic_configurations import (
    NearestClosed,
    close_configuration,
    find_closed_configuration,
    sample_useful_ranks,
)
from kempe.assemble.nearest_exact import answer_within_tolerance, find_nearest_quickly
from kempe.budget import Budget, TimeUp, Usual
from kempe.equations.velocity import record_tangent_rows, record_velocity_rows
from kempe.errors import InputError
from kempe.first_order.constraint_graph import (
    ConstraintGraph,
    build_constraint_graph,
    list_function_constraints,
)
from kempe.first_order.control import analyse_control, find_driven_velocities
from kempe.first_order.counting import count_freedoms, count_loop_freedoms
from kempe.first_order.idle_freedoms import find_idle_freedoms
from kempe.first_order.rank import Rank, compute_rank
from kempe.first_order.redundant_constraints import find_redundancy
from kempe.first_order.wrenches import Wrenches
from kempe.mobility.answer import ClusterMobility, Mobility, format_dimensions
from kempe.mobility.dof_proofs import has_full_rank
from kempe.mobility.growth_vectors import compute_distribution
from kempe.mobility.one_sided import report_if_relevant, report_one_sided
from kempe.model.ball_angles import make_regular_chart
from kempe.model.configurations import find_home, has_loops, read_q
from kempe.model.own_tree import remove_cut_marks
from kempe.numerics.clock import SHORT, TimeLimit, find_time_limit, limit_time
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.constraints.base import Constraint
    from kempe.mobility.local_dimension import Branch, LocalDimension
    from kempe.model.model import Model

USUAL = Usual("mobility", time_limit=SHORT)


def _make_late_answer(
    time: TimeLimit, system: Model, q: Any = None, *_: Any, **__: Any
) -> Mobility:
    """Return the Grübler count alone, where the time ended before more was known."""
    given = None if q is None else _read_configuration(system, q)
    tree = remove_cut_marks(system)
    why = (
        f"the time limit of {time.limit:g} s came before a closed configuration and its ranks were "
        "known"
    )
    at = NearestClosed(find_home(tree) if given is None else given, False, math.nan, math.nan, why)
    return replace(_make_open_answer(tree, system, at), late=True)


@explain_errors
@limit_time(USUAL, _make_late_answer)
@answer_within_tolerance()
def mobility(
    system: Model,
    q: Any = None,
    actuated: Iterable[str] | None = None,
    *,
    local: bool = True,
    rng: np.random.Generator | int = 0,
    clearance: Constraint | Sequence[Constraint] | None = None,
    tolerance: float | str | None = None,
    budget: Budget | None = None,
) -> Mobility:
    """Compute the degrees of freedom of a system, with the reasoning; see `System.mobility`."""
    time = find_time_limit(USUAL)
    time.release_reserved_time()  # there is nothing to do afterwards
    shown = system
    system = remove_cut_marks(system)
    find_driven_velocities(system, actuated)  # a wrong name is refused before any work
    given = None if q is None else _read_configuration(system, q)
    found = _analyze_system(system, shown, given, actuated, local, make_generator(rng), time)
    if clearance is not None and found.closed:
        sides = report_one_sided(shown, found.q, clearance=clearance)
        found = replace(found, one_sided=sides)
    return replace(found, searched=given is None)


def _analyze_system(
    system: Model,
    shown: Model,
    given: Array | None,
    actuated: Iterable[str] | None,
    local: bool,
    rng: np.random.Generator,
    time: TimeLimit,
) -> Mobility:
    """Analyze a system at the given closed configuration, or at one that is searched."""
    at = (
        close_configuration(system, given)
        if given is not None
        else find_closed_configuration(system)
    )
    if not at.closed:
        return _make_open_answer(system, shown, at)
    other, q, turned = make_regular_chart(system, at.q)
    if not turned:
        found = _analyze_configuration(system, shown, at, actuated, local, rng, time)
    else:  # angles of a ball have velocities there that move nothing
        found = _analyze_configuration(other, shown, replace(at, q=q), actuated, local, rng, time)
        from kempe.mobility.local_dimension import convert_to_system

        truth = None if found.local is None else convert_to_system(system, found.local, turned)
        found = replace(found, q=at.q, local=truth, one_sided=report_if_relevant(shown, at.q))
    return replace(found, hint=_find_hint(system, found)) if local and not found.late else found


def _find_hint(system: Model, found: Mobility) -> str:
    """Find what may have been meant by a mechanism with fewer or more freedoms than expected.

    That is a mechanism nearby that moves where this one cannot, or a configuration that is not
    folded. It is "" where nothing speaks for either.
    """
    if not has_loops(system) or found.dof is None:
        return ""
    if found.dof == 0:
        near = find_nearest_quickly(system)
        if near is None or not near.freedoms:
            return ""
        return wording.suggest_near_mechanism(near.least, near.freedoms)
    more = found.dof > found.gruebler and not found.singular  # else branches are told apart
    folded = find_coinciding_joints(system, found.q) if more else []
    return wording.describe_fold(folded) if folded else ""


def _analyze_configuration(
    system: Model,
    shown: Model,
    at: NearestClosed,
    actuated: Iterable[str] | None,
    local: bool,
    rng: np.random.Generator,
    time: TimeLimit,
) -> Mobility:
    """Analyze a system at a closed configuration with regular coordinates.

    It is counted over the tree of `shown`.
    """
    s = build_constraint_graph(system)
    motors = find_driven_velocities(system, actuated)
    rank = compute_rank(system, at.q)
    generic = sample_useful_ranks(system, rank, motors, rng)
    truth = None
    late = False
    try:
        truth = _find_wanted_dimension(system, rank, local, rng, time)
    except TimeUp:
        if not time.spent:
            raise
        late = True
    best = min([rank, *generic, *_compute_branch_ranks(system, truth)], key=lambda r: r.nullity)
    idle = find_idle_freedoms(system, [rank, *generic], motors)
    dof = (
        truth.dim
        if truth is not None
        else rank.nullity
        if not rank.n_dependent or not rank.nullity
        else None
    )
    singular, kind = _classify_singularity(rank, best, truth)
    sure = truth is None and dof is not None and has_full_rank(system, rank, at.residual)
    return Mobility(
        system,
        system.dim,
        at.q,
        True,
        at.residual,
        at.given,
        "",
        count_freedoms(shown),
        count_loop_freedoms(shown, rank.screws),
        _list_clusters(s, rank),
        _count_outside_freedoms(system, s),
        rank,
        best.nullity,
        truth,
        dof,
        find_redundancy(system, best),
        idle,
        analyse_control(system, rank, generic, idle, actuated),
        singular,
        kind,
        _count_velocity_freedoms(system, at.q),
        sure,
        report_if_relevant(shown, at.q),
        list_function_constraints(system) if dof is None and local else (),
        Wrenches(system, at.q),
        late=late,
    )


def _read_configuration(system: Model, q: Any) -> Array:
    """Return q as one configuration (nq,). Errors: `InputError`."""
    given = read_q(system, q)
    if given.ndim != 1:
        raise InputError(
            f"q has shape {given.shape}; mobility is found at one configuration ({system.nq},)"
        )
    return given


def _make_open_answer(system: Model, shown: Model, at: NearestClosed) -> Mobility:
    """Return the answer for a mechanism that cannot be closed: the count alone."""
    s = build_constraint_graph(system)
    return Mobility(
        system,
        system.dim,
        at.q,
        False,
        at.residual,
        at.given,
        at.why,
        count_freedoms(shown),
        count_loop_freedoms(shown, None),
        _list_clusters(s, None),
        _count_outside_freedoms(system, s),
        None,
        None,
        None,
        None,
        None,
        (),
        None,
        None,
        "",
    )


def _find_wanted_dimension(
    system: Model, rank: Rank, wanted: bool, rng: np.random.Generator, time: TimeLimit
) -> LocalDimension | None:
    """Find the local dimension where it is `wanted` and the rank does not prove it, else None."""
    if not wanted or not rank.n_dependent or not rank.nullity or list_function_constraints(system):
        return None
    from kempe.mobility.local_dimension import find_local_dimension

    return find_local_dimension(system, rank.q, rng=rng, time=time)


def _compute_branch_ranks(system: Model, truth: LocalDimension | None) -> list[Rank]:
    """Compute ranks at points of the branches that meet here, one for each dimension."""
    if truth is None or truth.smooth:
        return []
    ranks = {b.dim: compute_rank(system, b.q) for b in truth.branches if not b.multiple}
    return [r for dim, r in ranks.items() if r.nullity == dim]


def _list_clusters(s: ConstraintGraph, rank: Rank | None) -> tuple[ClusterMobility, ...]:
    """List the groups of loops, with their counts and ranks."""
    out: list[ClusterMobility] = []
    for k, c in enumerate(s.clusters):
        rows = sum(s.loops[i].rows for i in c.loops) + sum(s.laws[i].n_rows for i in c.laws)
        r = None if rank is None else rank.clusters[k]
        out.append(
            ClusterMobility(
                tuple(s.edges[i].name for i in c.edges),
                tuple(s.edges[s.loops[i].edge].name for i in c.loops),
                len(c.velocities) - rows,
                None if r is None else r.nullity,
                None if r is None else r.n_dependent,
            )
        )
    return tuple(out)


def _count_outside_freedoms(system: Model, s: ConstraintGraph) -> int:
    """Count the freedoms of joints that are in no loop."""
    return system.nv - sum(len(c.velocities) for c in s.clusters)


def _classify_singularity(rank: Rank, best: Rank, truth: LocalDimension | None) -> tuple[bool, str]:
    """Return whether the configuration is singular in the configuration space, and its kind.

    `best` is the rank of least nullity around it, `truth` the local dimension, where it was
    computed.
    """
    drop = rank.nullity - best.nullity
    if truth is None:
        if not drop:
            return False, ""
        return True, f"the rank is lower than at other configurations of the branch (by {drop})"
    if truth.smooth:
        return False, ""
    if len(truth.branches) == 0:
        return True, "shaky: it can move to first order, but is rigid"
    dims = format_dimensions(truth.branch_dims)
    if len(truth.branches) > 1:
        found = "meet" if truth.counted else "were found"
        kind = f"bifurcation: {len(truth.branches)} branches {found}, of dimensions {dims}"
    else:
        kind = _describe_branch_motion(truth.branches[0])
    return True, "; ".join([kind, *truth.more])


def _describe_branch_motion(branch: Branch) -> str:
    """Describe the singular point of a single branch."""
    if branch.multiple:
        return (
            "shaky at every configuration of the branch: it can move more to first order than it "
            "truly does"
        )
    if branch.cusp:
        return "cusp: the motion comes to rest here and goes back beside the way it came"
    if branch.ends == 1:
        return "end of the motion: one half of a branch only leads here"
    return "the rank is lower here, but only one branch passes through"


def _count_velocity_freedoms(system: Model, q: Array) -> int | None:
    """Count the freedoms of velocity at q (nq,); None without constraints of velocity."""
    if not record_velocity_rows(system).names:
        return None
    rows = record_tangent_rows(system)
    which = [i for i, row in enumerate(rows.names) if not row.sided]
    return compute_distribution(rows, q, which).dimension - (0 if rows.steady else 1)
