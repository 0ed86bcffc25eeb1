"""Sentences of `ik_all`: how many solutions a target has, and why it has no others, or none."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from kempe.answers import wording
from kempe.answers.evidence import Evidence, make_evidence
from kempe.answers.problem import Choice, Problem, select_solver
from kempe.answers.targets import explain_refused_target
from kempe.answers.wording import describe_immovable_coordinates
from kempe.inverse.all_answer import SolutionsRow
from kempe.inverse.chain.problem import MOST
from kempe.inverse.closed_forms.plan import ChainPlan, compute_outer_terms, count_task_freedoms
from kempe.inverse.closed_forms.start_search import make_frame_problem
from kempe.inverse.closed_forms.structure import Strategy
from kempe.inverse.explain import prove_beyond_lengths, suggest_tolerance
from kempe.inverse.families import Family, find_families
from kempe.inverse.nearest import find_nearest_configuration, list_held_coordinates, make_aim
from kempe.kernels.base.search_layout import LARGEST
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.closed_form.analytic_layout import AT_REST, COUPLED, PLANE, POINT, X_FIRST
from kempe.kernels.forward.table_layout import SLIDE
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.inverse.all_answer import Solutions


# ---- the sentence of a target

BEYOND = 1e-8
"""How far (lengths of the chain, cosines) an equation must be from having a root, to be named as
the reason."""

REACHED = 2e-6
"""Error [m, rad] below which a search, which stops there, has found a solution."""

TURNS = ("orientation", "direction")
"""Tasks of which no place counts."""


def explain_target(solutions: Solutions, index: int) -> str:
    """Write the sentence about target number `index`: its solutions, or why it has none."""
    if solutions._counts[index, 0] < 0:
        return explain_refused_target(solutions.problem.targets[index])
    limit, late = (
        (0.0, False)
        if solutions._ended is None
        else (solutions._ended[0], solutions._ended[1][index])
    )
    if solutions._used_rows[index].any():
        return _describe_found(solutions, index) + (
            wording.describe_incomplete_search(limit) if late else ""
        )
    if late:
        return wording.describe_empty_search(limit)
    size = float(np.abs(solutions.problem.targets[index]).max())
    if size >= LARGEST:
        return (
            f"no solution: the target has an entry of {size:.3g}; allowed are numbers below "
            f"{LARGEST:g}"
        )
    _, position, angle = find_nearest_configuration(solutions, index)
    problem = solutions.problem
    plan = solutions.plan
    spare = plan.spare_joints
    miss = math.hypot(position, angle)
    why, proven = _list_reasons(solutions, index)
    if spare and not proven:
        tried = int(np.ravel(solutions.tried)[index])
        head = ""
        why = [
            make_evidence(
                "tried", held=_list_held_values(solutions, index, spare), values=tried, starts=MOST
            )
        ]
    else:
        head = "no solution"
    if miss <= REACHED:
        near = f"a configuration within {miss:.1g} of the target: see nearest()"
        return f"{head or why[0]} within {problem.tolerance:.1g}, but {near}"
    rounded = None
    if why[0].kind == "rank":
        longest = make_frame_problem(problem).chain.span.largest
        rounded = suggest_tolerance(problem.system, position, angle, longest, one=True)
    limits = " inside the limits" if np.isfinite(plan.lines.limits).any() else ""
    place = None if problem.task in TURNS else position
    turn = None if problem.task == "position" else angle
    off = wording.format_errors(place, turn)
    return wording.describe_failure(
        head, *why, rounded, f"the closest configuration found{limits} misses it by {off}"
    )


def describe_held_joints(solutions: Solutions) -> str:
    """Describe which joints of a redundant chain are held, and where; '' for other chains."""
    if not solutions.spare:
        return ""
    parts: list[str] = []
    for name in solutions.spare:
        values = np.ravel(solutions.held[name])[solutions._used_rows.any(axis=1)]
        if len(values):
            place, count = np.unique(values, return_counts=True)
            usual = float(place[np.argmax(count)])
            times = int(count.max())
            parts.append(
                wording.describe_held_values(name, usual, times, len(values), place[0], place[-1])
            )
    return wording.describe_spare_joints(
        len(solutions.spare), f", held: {', '.join(parts)}" if parts else ""
    )


# ---- targets with solutions


def _describe_found(solutions: Solutions, index: int) -> str:
    """Describe the solutions that were found."""
    plan = solutions.plan
    spare = plan.spare_joints
    equations, _ = count_task_freedoms(plan, plan.fixed)
    deficient = bool(spare) and len(plan.lines) - len(plan.fixed) <= equations
    none: list[Family] = []
    unknown: tuple[list[Family], np.ndarray] = (none, np.full(len(solutions._used_rows.T), -1))
    families, member = unknown if spare and not deficient else solutions._families[index]
    alone = solutions._used_rows[index] & (member < 0)
    sampled = 0
    if spare:  # what belongs to a family is no isolated solution
        isolated = alone & (solutions._code[index] >= A.MULTIPLICITY_UNIT)
        sampled = int(alone.sum() - isolated.sum())
        alone = isolated
    code = solutions._code[index, alone]
    inside = int((code % 2).sum())
    times = code // int(A.MULTIPLICITY_UNIT)
    text = wording.describe_solutions(
        len(code),
        inside,
        plan.method.word,
        not solutions._counts[index, 1],
        bool(spare),
        times[times > 1].tolist(),
        _describe_violated_limit(solutions, index, alone)
        if len(code) and not inside and not families
        else "",
        [(f.freedoms, f.text) for f in families],
        _explain_closed_form(plan),
        sampled,
    )
    if not spare or deficient and not len(code):
        return text
    now = _list_held_values(solutions, index, spare)
    first = solutions._first
    tried = int(np.ravel(solutions.tried)[index])
    if first is None:
        tried = 1
    before = np.zeros(0) if first is None else first[index if len(first) > 1 else 0][spare]
    first_values = () if np.array_equal([x for _, x in now], before) else before.tolist()
    held = f": {wording.describe_held_joints(now)}"
    spares = wording.describe_spare_joints(len(spare), held, first_values, tried, inside > 0)
    return f"{text}; {spares}"


def _list_held_values(
    solutions: Solutions, index: int, joints: list[int]
) -> list[tuple[str, float]]:
    """List the held joints with their values for target number `index`."""
    q = list_held_coordinates(solutions, index)
    names = solutions.plan.lines.names
    return [(names[i], float(q[i])) for i in joints]


def _explain_closed_form(plan: ChainPlan) -> str:
    """Explain why there is a closed form."""
    way = plan.way
    inner = sorted(way.order[way.inner : way.inner + 3]) if way is not None else []
    if way is None or inner[-1] >= len(plan.lines) or np.any(plan.lines.kinds[inner] == SLIDE):
        return wording.explain_closed_form((), False)
    return wording.explain_closed_form(inner, way.what == POINT)


def _describe_violated_limit(solutions: Solutions, index: int, alone: np.ndarray) -> str:
    """Describe the limit that the solution with the smallest violation exceeds."""
    lines = solutions.plan.lines
    q = solutions._rows[index, alone, : len(lines)]
    over = np.maximum(q - lines.limits[1], lines.limits[0] - q)
    row = over[int(np.argmin(over.max(axis=1)))]
    worst = int(np.argmax(row))
    names = solutions.system.structure.velocity_names
    still = describe_immovable_coordinates(
        solutions.system, [i for i, name in enumerate(names) if name in lines.names]
    )
    return wording.describe_limit_excess(
        lines.names[worst], row[worst], "m" if lines.kinds[worst] == SLIDE else "rad", still
    )


# ---- targets without solutions

CONSTANT = 1e-9
"""Factor of an unknown below which an equation does not depend on it."""


def _list_reasons(solutions: Solutions, index: int) -> tuple[list[Evidence], bool]:
    """List reasons why a target has no solutions, and whether they hold for all held values."""
    plan = solutions.plan
    problem = make_frame_problem(solutions.problem)
    far = prove_beyond_lengths(problem, problem.targets[index : index + 1])
    if far is not None and far.plane:
        return [far], True
    span = plan.lines.span
    closed_form = plan.method.word == "closed form" and not plan.spare_joints and not span.wide
    failed = _prove_no_root(solutions, index) if closed_form else None
    if far or failed:
        return [x for x in (far, failed) if x], far is not None
    over = _prove_overdetermined(solutions)
    if span.wide and not over:
        return [make_evidence("wide span", span=span.format_ratio())], True
    return [over or make_evidence("no root found", method=plan.method.word)], over is not None


def _prove_overdetermined(solutions: Solutions) -> Evidence | None:
    """Prove that the task has more equations than the chain has freedoms."""
    plan = solutions.plan
    equations, freedoms = count_task_freedoms(plan, plan.fixed)
    if freedoms >= equations:
        return None
    return make_evidence(
        "rank",
        equations=equations,
        freedoms=freedoms,
        frame=solutions.problem.frame,
        held=bool(plan.fixed),
    )


def _prove_no_root(solutions: Solutions, index: int) -> Evidence | None:
    """Prove that the equation of a closed form has no root; None without such a proof."""
    plan = solutions.plan
    way = solutions.plan.way
    if way is None or way.mode in (AT_REST, COUPLED):
        return None
    theta = plan.lines.compute_theta(list_held_coordinates(solutions, index))
    terms = compute_outer_terms(plan, theta, make_aim(solutions, index).target)
    slides = np.concatenate([plan.lines.kinds, plan.extra.kinds]) == SLIDE
    first, second = (0, 1) if way.mode == X_FIRST else (1, 0)
    joint = [way.order[(way.inner + 3) % 6], way.order[(way.inner + 5) % 6]]
    measures = way.measure, 1 - way.measure
    # the other joint does not appear in the first measure: its constant is what is wanted
    t = terms[first, measures[0]]
    wanted = terms[second, measures[0], 0]
    roots = _find_roots(t, wanted, bool(slides[joint[first]]))
    if not len(roots):
        return _make_root_evidence(solutions, way, joint[first], measures[0], t, wanted)
    found: list[tuple[float, Evidence | None]] = []
    for f, g in roots:
        if math.isnan(f):
            return None
        known = terms[first, measures[1]] @ (1.0, f, g)
        t = terms[second, measures[1]]
        if len(_find_roots(t, known, bool(slides[joint[second]]))):
            return None
        found.append(
            (
                _compute_range(t, known)[0],
                _make_root_evidence(solutions, way, joint[second], measures[1], t, known),
            )
        )
    return min(found, key=lambda x: x[0])[1]


def _compute_range(t: Array, wanted: float) -> tuple[float, float, float]:
    """Compute the range of t0 + t1 cos + t2 sin of a turn, and its distance from a value."""
    size = math.hypot(t[1], t[2])
    return max(t[0] - size - wanted, wanted - t[0] - size, 0.0), t[0] - size, t[0] + size


def _find_roots(t: Array, wanted: float, slides: bool) -> list[tuple[float, float]]:
    """Find solutions (f, g) of t0 + t1 f + t2 g = wanted.

    f and g are cosine and sine of a turn, d and d^2 of a slide.

    NaN where any value solves it.
    """
    k = wanted - t[0]
    if slides:
        if abs(t[2]) <= CONSTANT:
            return [(k / t[1], (k / t[1]) ** 2)] if abs(t[1]) > CONSTANT else [(math.nan, math.nan)]
        d = np.roots([t[2], t[1], -k])
        return [(float(x.real), float(x.real) ** 2) for x in d if abs(x.imag) < 1e-6]
    size = math.hypot(t[1], t[2])
    if abs(k) > size + BEYOND:
        return []
    if size <= CONSTANT:
        return [(math.nan, math.nan)]
    middle = math.atan2(t[2], t[1])
    half = math.acos(min(1.0, max(-1.0, k / size)))
    return [(math.cos(middle + s * half), math.sin(middle + s * half)) for s in (1.0, -1.0)]


def _make_root_evidence(
    solutions: Solutions, way: Strategy, joint: int, measure: int, t: Array, wanted: float
) -> Evidence | None:
    """Make the evidence that a joint cannot bring the inner joints to the target."""
    plan = solutions.plan
    n = len(plan.lines)
    length = plan.lines.length
    if joint >= n or plan.lines.kinds[joint] == SLIDE:
        return None
    _, low, high = _compute_range(t, wanted)
    inner = sorted(i for i in way.order[way.inner : way.inner + 3] if i < n)
    middle = way.order[(way.inner + 4) % 6]
    turning = (
        middle >= n
        and plan.extra.kinds[middle - n] != SLIDE
        or middle < n
        and plan.lines.kinds[middle] != SLIDE
    )
    what = "plane"
    off = 0.0
    edge = low if wanted < low else high
    if way.what == PLANE:
        if measure == 0 and turning:
            what = "direction"
            off = abs(math.acos(min(1.0, max(-1.0, wanted))) - math.acos(min(1.0, max(-1.0, edge))))
    elif measure == 1 and turning:
        what = "far" if wanted > high else "near"
        off = abs(math.sqrt(max(wanted, 0.0)) - math.sqrt(max(edge, 0.0))) * length
    else:
        what = "height"
        off = max(low - wanted, wanted - high) * length
    return make_evidence("no root", joint=plan.lines.names[joint], axes=inner, what=what, off=off)


# ---- choice of the solver


def describe_solver(solutions: Solutions) -> Choice:
    """Describe the solver that finds all configurations of a target."""
    from kempe.inverse.solve_all import SOLVERS

    problem = solutions.problem
    plan = solutions.plan
    verb_problem = Problem(
        problem.system,
        "all",
        dict.fromkeys(plan.lines.names[i] for i in plan.fixed),
        frame=problem.frame,
        task=(problem.task, problem.axis),
    )
    return select_solver(SOLVERS, verb_problem)[1]


ROW = SolutionsRow(
    explain_target, describe_solver, describe_held_joints, find_nearest_configuration, find_families
)
"""What `ik_all` says of its answers."""
