"""Explanations of open loops: which loop, how far open, and whether limits prevent closing."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from kempe.answers import wording
from kempe.answers.answer import Row
from kempe.answers.evidence import (
    Evidence,
    make_evidence,
    make_limit_evidence,
    make_loop_length_evidence,
    make_one_sided_evidence,
)
from kempe.answers.problem import Choice, Problem, select_solver
from kempe.answers.wording import describe_immovable_coordinates
from kempe.assemble.answer import Assembly
from kempe.assemble.bound import LOOSEST, Assembler, get_assembler_as_given, get_equation_assembler
from kempe.assemble.nearest_exact import find_ideal_system, find_nearest_quickly
from kempe.equations import closure_rows
from kempe.forward.fk import fk
from kempe.model.configurations import has_loops, sample_configurations
from kempe.spatial import Array
from kempe.status import Status

if TYPE_CHECKING:
    from kempe.model.model import Model

MOST = 1000
"""Equations up to which the freedoms that are left are counted: it takes a dense decomposition."""
NEARLY = 0.05
"""Residual up to which it is checked whether the loops close within a larger tolerance."""
GLANCE = 1.0
"""Seconds that the search for what would close without limits may take."""
COINCIDE = 1e-6
"""Distance of joints, in characteristic lengths, below which they are at one place."""


def choose_solver(answer: Assembly) -> Choice:
    """Choose the solver for the known names of an answer."""
    from kempe.assemble.assemble import SOLVERS

    assembler = answer.assembler
    return select_solver(SOLVERS, Problem(assembler.system, "one", dict.fromkeys(assembler.known)))[
        1
    ]


def describe_configuration(answer: Assembly, index: tuple[int, ...]) -> str:
    """Describe one configuration of an assembly in a sentence."""
    undecided = answer.late and np.asarray(answer.code)[index] == Status.OUT_OF_TIME
    return (
        wording.describe_late_nearest_mechanism(answer.limit)
        if undecided
        else _describe_outcome(answer, index)
    )


def _describe_outcome(answer: Assembly, index: tuple[int, ...]) -> str:
    """Describe the outcome of one configuration: closed, open, outside limits or out of time."""
    bound: Assembler = answer.assembler
    code, residual, steps, starts = (
        np.asarray(x)[index].item()
        for x in (answer.code, answer.residual, answer.iterations, answer.starts)
    )
    q = answer.q[index]
    if code == Status.BAD_INPUT:
        return "known values, places or start have numbers that are not finite or too large"
    if code == Status.SOLVED:
        left = _describe_freedoms(bound, q)
        if has_loops(bound.system) or bound.frames or len(bound.loops.names):
            return wording.describe_closed_loops(residual, steps, starts, left)
        return f"no loops to close{left}"
    if code == Status.OUTSIDE_LIMITS:
        return f"a known value is outside its limits: {_describe_outside_limits(bound, q)}"
    if code == Status.OTHER_BRANCH:
        return "the branch requested cannot be closed with these values; q is closed on another one"
    what = _find_largest_violation(bound, q, residual)
    near = "q is the nearest to closing"
    if code == Status.OUT_OF_TIME:
        late = wording.describe_late_search(answer.limit, starts, done="closed")
        return wording.describe_failure(late, what, f"{near} so far")
    why = (
        _find_one_sided_evidence(bound, q)
        or _find_limit_evidence(bound, q)
        or _find_excess_evidence(bound)
        or _find_short_links_evidence(bound, q)
        or make_evidence("not closed")
    )
    still = describe_immovable_coordinates(bound.system)
    return wording.describe_failure(
        wording.describe_vain_starts("closed", starts),
        what,
        why,
        _suggest_tolerance(bound, residual),
        near,
        still,
    )


def _suggest_tolerance(bound: Assembler, residual: float) -> Evidence | None:
    """Suggest the tolerance with which the loops would close; None where they are open by more."""
    wider = find_nearest_quickly(bound.system) if residual < NEARLY else None
    if wider is not None:
        return make_evidence("nearly closed", nearest=wider.least)
    if residual <= LOOSEST / 2.0:
        return make_evidence("nearly closed", tolerance=1.1 * residual)
    return None


def _describe_freedoms(bound: Assembler, q: Array) -> str:
    """Describe the freedoms that are left, with a warning where they are more than intended."""
    if bound.frames or len(bound.loops.names) > MOST:
        return ""
    system = bound.system
    left = closure_rows.count_remaining_freedoms(system, q, bound.held)
    if not left:
        return ""
    count = system.nv - len(bound.held) - len(closure_rows.list_row_names(system))
    who = "by the count"
    sure = count >= 0 or 0 <= bound.freedoms < left
    if count < 0:
        # overconstrained, as linkages of a plane in space are: joints that stand anywhere obey
        # their group
        somewhere = sample_configurations(system, np.random.default_rng(0))
        count = closure_rows.count_remaining_freedoms(system, somewhere, bound.held)
        who = "in general"
    folded = find_coinciding_joints(system, q) if count < left else []
    return wording.explain_open_freedoms(
        left, count, who, folded, sure, bound.freedoms if bound.freedoms < left else -1
    )


def find_coinciding_joints(system: Model, q: Array) -> list[tuple[str, str]]:
    """Find pairs of joints that coincide here though no body connects them at that point."""
    joints = [*system.mechanism.joints.values()]
    number = {b: i for i, b in enumerate(system.body_names)}
    bodies = fk(system, q)
    m = system.mechanism
    places = np.array(
        [bodies[number[j.child]] @ j.X_CM.evaluate_pose(m.parameters)[:, 3] for j in joints]
    )[:, :3]
    cells: dict[tuple[int, ...], list[int]] = {}
    for i, cell in enumerate(
        np.round(places / (COINCIDE * closure_rows.compute_characteristic_length(system))).tolist()
    ):
        cells.setdefault(tuple(int(x) for x in cell), []).append(i)
    out: list[tuple[str, str]] = []
    for members in cells.values():
        groups: list[tuple[set[str], str]] = []  # bodies that meet there, and the first joint
        for i in members:
            ends = {joints[i].parent, joints[i].child}
            met = [g for g in groups if g[0] & ends]
            groups = [g for g in groups if not g[0] & ends]
            groups.append((ends.union(*(g[0] for g in met)), met[0][1] if met else joints[i].name))
        out += [(groups[0][1], g[1]) for g in groups[1:]]
    return out


def _describe_outside_limits(bound: Assembler, q: Array) -> str:
    """List the known values that are outside their limits."""
    texts: list[str] = []
    limits = zip(bound.sources, bound.places, bound.bounds, bound.limits.T, strict=True)
    for name, i, (least, most), (low, high) in limits:
        if not least <= q[i] <= most:
            texts.append(f"{name} = {q[i]:.6g} is not in [{low:.6g}, {high:.6g}]")
    return ", ".join(texts)


def _find_largest_violation(bound: Assembler, q: Array, missed: float) -> Evidence:
    """Find the loop, constraint or place that is violated most, in metres and radians.

    `missed` is the norm of all residuals.
    """
    system = bound.system
    length = bound.loops.length
    parts: dict[tuple[str, bool], list[float]] = {}
    plain = [
        tie.unscaled
        for tie in closure_rows.pack_full_loops(system, False).ties
        for _ in tie.row_names
    ]
    for (name, row), off, value in zip(
        closure_rows.list_row_names(system),
        plain,
        closure_rows.compute_residual(system, q).tolist(),
        strict=True,
    ):
        part = parts.setdefault((name, off), [0.0, 0.0])
        kind = int(row.startswith("r") or off)
        part[kind] = math.hypot(part[kind], value)
    worst = 0.0
    found = make_evidence("open", what="nothing")
    if bound.frames:  # loops that are open by next to nothing are not the reason
        worst = 0.1 * missed
        found = make_evidence("open", what="place", names=list(bound.frames), place=missed * length)
    for (name, related), (apart, turned) in parts.items():
        size = math.hypot(apart / length, turned)
        if size <= worst:
            continue
        worst = size
        declared = name in system._mechanism.constraints
        if related:
            what = "equation" if declared else "relation"
        else:
            what = "loop" if name in system.structure.joints else "constraint"
        found = make_evidence("open", what=what, names=[name], place=apart, turn=turned)
    for v in bound.one_sided.list_violations(q) if bound.one_sided is not None else ():
        if v.size > worst:
            found = make_evidence("open", what="one-sided", names=[v.name], amount=v.amount)
            worst = v.size
    return found


def _find_short_links_evidence(bound: Assembler, q: Array) -> Evidence | None:
    """Find a proof that a loop is open in all configurations with the known values of q (nq,)."""
    known = dict(zip(bound.sources, q[bound.places].tolist(), strict=True))
    return make_loop_length_evidence(bound.system, known)


def _find_one_sided_evidence(bound: Assembler, q: Array) -> Evidence | None:
    """Find out which one-sided constraints keep the loops from closing.

    With no freedom left that is a contradiction of what is known with them.
    """
    if bound.one_sided is None or bound.frames:
        return None
    answer = (
        get_equation_assembler(bound.system, bound.known)(q[bound.places] * 1.0, q)
        if bound.plain
        else None
    )
    if answer is None or not answer.success:
        return None
    known = bool(bound.known) and not closure_rows.count_remaining_freedoms(
        bound.system, answer.q, bound.held
    )
    return make_one_sided_evidence(bound.one_sided, answer.q, done="closes", known=known)


def _find_limit_evidence(bound: Assembler, q: Array) -> Evidence | None:
    """Find out whether the loops close without limits, and which coordinates are outside then."""
    if bound.frames or not np.isfinite(bound.system.structure.limits).any():
        return None

    def close_loops(start: Array, limits: bool = True) -> Array | None:
        """Close the loops from a start (nq,); None where they stay open."""
        found, _, info = bound.run(start[None], bound.no_pins, limits=limits, limit=GLANCE)
        return found[0] if info[0, 0] == Status.SOLVED else None

    free = close_loops(q, limits=False)
    return make_limit_evidence(bound.system, free, close_loops, done="closes")


def _find_excess_evidence(bound: Assembler) -> Evidence | None:
    """Find out whether more is given than the closed system has freedoms.

    Coordinates count, and the positions of frames.
    """
    freedoms = get_assembler_as_given(find_ideal_system(bound.system)).freedoms
    given = len(bound.held) + bound.system.dim * len(bound.frames)
    if not 0 <= freedoms < given:
        return None
    return make_evidence(
        "too many given",
        given=len(bound.held),
        freedoms=freedoms,
        frames=list(bound.frames),
        numbers=bound.system.dim,
    )


ROW = Row(describe_configuration, choose_solver)
"""What `assemble` says of its answers."""
