"""Reasons why tasks do not hold together: which fail, by how much, and proofs.

Proofs are the lengths of links and tasks that contradict each other. Else one asks again: all
without the limits, each hard task alone, two at a time. What is then found is true, what is not
found is evidence and said with the starts. Reasons of targets of one frame stand in `explain`,
which does not load the search for tasks.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from kempe.answers import wording
from kempe.answers.evidence import (
    Evidence,
    make_evidence,
    make_limit_evidence,
    make_one_sided_evidence,
    make_reach_evidence,
)
from kempe.answers.problem import Choice, Problem, select_solver
from kempe.answers.wording import describe_immovable_coordinates
from kempe.assemble.bound import get_assembler_as_given
from kempe.assemble.nearest_exact import find_ideal_system
from kempe.inverse.answer import Reached, SolutionRow
from kempe.inverse.explain import suggest_tolerance
from kempe.inverse.numeric import SOLVERS
from kempe.inverse.tasks.demands import STARTS
from kempe.inverse.tasks.freedoms import Local, analyse_freedoms
from kempe.inverse.tasks.proofs import compute_excess_distances, list_contradictions
from kempe.inverse.tasks.search import make_checked_answer
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.own_tree import remove_cut_marks
from kempe.numerics.length_bounds import list_sliding_coordinates
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import join_words

if TYPE_CHECKING:
    from kempe.equations.tasks import Task
    from kempe.inverse.tasks.demands import Demands

MOST_COORDINATES = 400
"""Velocity coordinates up to which a sentence counts freedoms: it takes about forty dense
decompositions."""
MOST_PAIRS = 45
"""Pairs of tasks that are tried before they are no longer requested."""


def explain_target(answer: Reached, index: tuple[int, ...]) -> str:
    """Write the sentence about one problem of an answer."""
    figures = (answer.code, answer.iterations, answer.starts)
    number, steps, starts = (int(np.asarray(x)[index]) for x in figures)
    code = Status(number)
    if code is Status.BAD_INPUT:
        return (
            "goals or start have numbers that are not finite or too large, or a goal is not a pose"
        )
    problem = answer.problem.select_row(answer._count_row(index))
    q = answer.q[index]
    misses = {t.label: answer.errors[t.label][index] for t in problem.tasks}
    soft = ", ".join(
        f"{t.label!r} stays off by {_describe_miss(t, misses)}"
        for t in problem.tasks
        if t.weight is not None
    )
    hard = [t for t in problem.tasks if t.weight is None]
    apart = _describe_closest(answer, answer._count_row(index))
    if code is Status.SOLVED:
        work = wording.describe_search(steps, starts)
        cut = (
            wording.describe_unfinished_tasks(problem.time_limit)
            if np.asarray(answer.late)[index]
            else ""
        )
        if not hard:
            said = "no hard tasks" if cut else "lowered as far as the system allows"
            return wording.describe_failure("", f"{said} ({work})", apart, cut, soft)
        worst = np.max([misses[t.label] for t in hard], axis=0)
        left = _describe_freedoms(problem, q)
        return wording.describe_failure(
            "",
            wording.describe_hard_tasks(*_merge_errors(hard, worst), work, left),
            apart,
            cut,
            soft,
        )
    failing = [t for t in hard if not _is_within_tolerance(problem, t, misses[t.label])]
    what = ", ".join(f"{t.label!r} is missed by {_describe_miss(t, misses)}" for t in failing)
    what = (
        what
        or f"the hard tasks hold, but {_describe_violations(problem, q) or 'not with closed loops'}"
    )
    near = "q is the nearest found"
    if apart and not failing:
        what = f"{'the other tasks hold, but ' * bool(hard)}{apart}"
    if code is Status.OUT_OF_TIME:
        return wording.describe_failure(
            wording.describe_late_search(problem.time_limit, starts, problem.starts),
            what,
            near,
            soft,
        )
    if problem.given_up:
        calls = wording.describe_vain_calls(problem.given_up)
        return wording.describe_failure(
            wording.describe_vain_starts("reached", starts), what, calls, near, soft
        )
    if apart and not failing:
        return wording.describe_failure(
            wording.describe_vain_starts("reached", starts), what, near, soft
        )
    why = _list_reasons(problem, q)
    rounded = None
    if failing and any(x.figures.get("rank") for x in why):
        place, turn = np.max([misses[t.label] for t in failing], axis=0).tolist()
        rounded = suggest_tolerance(
            problem.system, place, turn, compute_characteristic_length(problem.system)
        )
    still = describe_immovable_coordinates(problem.system)
    return wording.describe_failure(
        wording.describe_vain_starts("reached", starts), what, *why, rounded, near, soft, still
    )


def _describe_freedoms(problem: Demands, q: Array) -> str:
    """Describe how many freedoms the hard tasks leave; '' for large systems."""
    if problem.system.nv > MOST_COORDINATES:
        return ""
    local = Local(problem, q)
    first = local.allowed_velocities.shape[1]
    return wording.describe_remaining_freedoms(
        first, local.finite_freedoms if first else 0, local.n_equations, local.n_freedoms
    )


def _describe_closest(answer: Reached, row: int) -> str:
    """Describe the pair of bodies of one problem that clearances let come closest; '' without."""
    closest = answer.closest
    pair = None if closest is None else closest.pairs[row]
    if closest is None or pair is None:
        return ""
    return wording.describe_closest(pair, closest.distance[row], closest.at_least[row])


def _merge_errors(tasks: Sequence[Task], error: Array) -> tuple[float | None, float | None]:
    """Merge the errors of tasks into one in metres and one in radians; None where there is none."""
    return (
        float(error[0]) if any(t.lengths for t in tasks) else None,
        float(error[1]) if any(t.angles for t in tasks) else None,
    )


def _describe_miss(task: Task, misses: dict[str, Array]) -> str:
    """Describe by how much a task is missed."""
    return wording.format_errors(
        *_merge_errors([task], misses[task.label]), radians=".3g", by=" and "
    )


def _is_within_tolerance(problem: Demands, task: Task, error: Array) -> bool:
    """Return whether the error of a task is within its tolerance."""
    linear, angular = problem.get_tolerance(task)
    return bool(error[0] <= linear * 1.000001 and error[1] <= angular * 1.000001)


def _describe_violations(problem: Demands, q: Array) -> str:
    """Describe declared one-sided constraints and limits that are violated at q (nq,)."""
    rows = problem.packed.one_sided
    which = ", ".join(v.text for v in rows.list_violations(q))
    if which:
        return f"violating {which}"
    over = rows.list_violated_names(q)
    return f"outside the limits of {join_words([repr(name) for name in over])}" if over else ""


def _solve_tasks(
    problem: Demands, q: Array, tasks: list[int], limits: bool = True, one_sided: bool = True
) -> Array | None:
    """Solve for a configuration (nq,) that holds only the given hard tasks, or None."""
    part = problem.select_tasks(tasks, limits, one_sided)
    found, info = part.run_search(q[None])
    return found[0] if make_checked_answer(part, found, info) else None


def _list_reasons(problem: Demands, q: Array) -> list[Evidence]:
    """List reasons why the hard tasks do not hold together; q (nq,) is the nearest found."""
    hard = [i for i, t in enumerate(problem.tasks) if t.weight is None]
    proofs = _find_proofs(problem)
    one_sided = problem.packed.one_sided
    if one_sided.declared and not proofs:
        above = _solve_tasks(problem, q, hard, one_sided=False)
        if over := make_one_sided_evidence(one_sided, above):
            return [over]
    blocked = make_limit_evidence(
        problem.system,
        _solve_tasks(problem, q, hard, limits=False),
        lambda free: _solve_tasks(problem, free, hard),
        proof="; ".join(proof.text for proof in proofs),
    )
    if blocked and (blocked.kind == "limits" or not proofs):
        return [blocked]
    if proofs:
        return proofs
    alone = [i for i in hard if len(hard) == 1 or _solve_tasks(problem, q, [i]) is None]
    if alone:
        return [_explain_single_task(problem, q, i, len(hard) > 1) for i in alone]
    few = len(hard) * (len(hard) - 1) // 2 <= MOST_PAIRS
    against = [
        (i, j) for i, j in combinations(hard, 2) if few and _solve_tasks(problem, q, [i, j]) is None
    ]
    pairs = [(problem.tasks[i].label, problem.tasks[j].label) for i, j in against]
    return [
        make_evidence(
            "not together",
            pairs=pairs,
            starts=min(problem.starts, STARTS),
            tasks=len(hard),
            rank=_prove_overdetermined(problem, q, hard),
            two=few and len(hard) > 2,
        )
    ]


def list_proofs(answer: Reached, index: tuple[int, ...]) -> tuple[Evidence, ...]:
    """List the proofs that the tasks of one problem do not hold together."""
    if np.asarray(answer.code)[index] not in (Status.OUT_OF_REACH, Status.CONTRADICTORY):
        return ()
    return tuple(_find_proofs(answer.problem.select_row(answer._count_row(index))))


def _find_proofs(problem: Demands) -> list[Evidence]:
    """Find the hard tasks that are out of reach; without one, those that exclude each other."""
    hard = [i for i, t in enumerate(problem.tasks) if t.weight is None]
    far = [proof for i in hard if (proof := _prove_out_of_reach(problem, i))]
    return far or _find_contradictions(problem)


def _find_contradictions(problem: Demands) -> list[Evidence]:
    """Find pairs of tasks that exclude each other, with the reason."""
    out: dict[tuple[int, int], Evidence] = {}
    for i, j, found in list_contradictions(problem):
        off = float(np.ravel(found.off)[0])
        if off > 0.0 and (i, j) not in out:
            first = problem.tasks[i].label
            second = problem.tasks[j].label
            out[i, j] = make_evidence(
                "contradiction",
                how=found.how,
                off=off,
                first=first,
                second=second,
                longest=found.longest,
            )
    return list(out.values())


def _prove_out_of_reach(problem: Demands, i: int) -> Evidence | None:
    """Prove that lengths put a task out of reach, and by how much."""
    task = problem.tasks[i]
    place, turned = (
        compute_excess_distances(problem, task, problem.goals[i]).reshape(-1, 2)[0].tolist()
    )
    slides: list[str] = []
    if place or turned:
        system = remove_cut_marks(problem.system)
        at = system.structure.table.at
        slides = list_sliding_coordinates(system, *(at[f] for f in task.frames[::-1] if f))
    return make_reach_evidence(problem.system, place, turned, task=task.label, slides=slides)


def _explain_single_task(problem: Demands, q: Array, i: int, among: bool) -> Evidence:
    """Explain why one task is not reached even alone."""
    label = problem.tasks[i].label
    free = _solve_tasks(problem, q, [i], limits=False)
    blocked = make_limit_evidence(problem.system, free, task=label)
    if blocked and blocked.kind == "limits":
        return blocked
    return make_evidence(
        "not alone", task=label if among else "", rank=_prove_overdetermined(problem, q, [i])
    )


def _prove_overdetermined(problem: Demands, q: Array, tasks: list[int]) -> Evidence | None:
    """Prove that tasks have more equations than the system has freedoms; None for large systems."""
    if problem.system.nv > MOST_COORDINATES:
        return None
    equations, freedoms = analyse_freedoms(problem.select_tasks(tasks), q)[:2]
    if problem.system.structure.closures:
        # the tasks open the loops where they are missed, and ranks are not clear there
        home = get_assembler_as_given(find_ideal_system(problem.system)).freedoms
        freedoms = min(freedoms, home) if home >= 0 else freedoms
    return (
        make_evidence("rank", equations=equations, freedoms=freedoms)
        if freedoms < equations
        else None
    )


def describe_solver(answer: Reached) -> Choice:
    """Describe the solver that searches for answers of tasks."""
    return select_solver(SOLVERS, Problem(answer.problem.system, "one"))[1]


def _compute_derivatives(answer: Reached) -> dict[str, Array]:
    """Compute the derivatives of an answer by its tasks' goals."""
    from kempe.inverse.derivative import compute_task_derivatives  # only here: seldom asked for

    return compute_task_derivatives(answer)


def _analyse_answer(answer: Reached) -> tuple[int, int, int, Array]:
    """Compute equations m, freedoms n, rank, and a basis (nv, k) of self-motions of an answer."""
    return analyse_freedoms(answer.problem, answer.q)


ROW = SolutionRow(
    explain_target, describe_solver, list_proofs, _compute_derivatives, _analyse_answer
)
"""What `ik` says of its answers for tasks."""
