"""Why tasks do not hold: which fail and by how much, and what is proven or speaks for it.

Proofs are the lengths of links and tasks that contradict each other. Else one asks again: all without the limits, each
hard task alone, two at a time. What is then found is true, what is not found is evidence and said with the starts.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import words
from kempe.kinematics.closure_rows import characteristic_length
from kempe.model.immovable import immovable
from kempe.solvers.common.freedoms import Local, freedoms_text
from kempe.solvers.common.proofs import Lengths, LowRank
from kempe.solvers.one_frame.explain_ik import rounded
from kempe.solvers.tasks.contradictions import Contradiction, contradictions
from kempe.solvers.tasks.ik_tasks import STARTS, judge
from kempe.solvers.tasks.reach_bounds import beyond
from kempe.solvers.tasks.reached import Reached, analyse
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.kinematics.tasks.task import Task
    from kempe.solvers.tasks.ik_tasks import Demands

MOST_PAIRS = 45
"""Pairs of tasks that are tried before they are no longer requested."""


def sentence(answer: Reached, index: tuple[int, ...]) -> str:
    """The sentence for one problem of an answer."""
    figures = (answer.code, answer.iterations, answer.starts)
    code, steps, starts = (int(np.asarray(x)[index]) for x in figures)
    if code == Status.BAD_INPUT:
        return "goals or seed are not finite, or no poses"
    row = int(np.ravel_multi_index(index, np.shape(answer.code))) if index else 0
    problem, q = answer.problem.of(row), answer.q[index]
    misses = {t.label: answer.errors[t.label][index] for t in problem.tasks}
    soft = [f"{t.label!r} stays off by {_amount(t, misses[t.label])}" for t in problem.tasks if t.weight is not None]
    more = "; " + ", ".join(soft) if soft else ""
    limit = f"the time limit of {problem.time_limit:g} s" if np.asarray(answer.late)[index] else ""
    if code == Status.SOLVED:
        work = words.work(steps, starts)
        hard = [t for t in problem.tasks if t.weight is None]
        if limit:
            more = f"; {limit} ended it before all was lowered as far as can be{more}"
        elif not hard:
            return f"lowered as far as the system allows ({work}){more}"
        if not hard:
            return f"no hard tasks ({work}){more}"
        worst = f"errors up to {_amounts(hard, misses)}"
        return f"all hard tasks hold: {worst} ({work}); {_freedoms(problem, q)}{more}"
    failing = [t for t in problem.tasks if t.weight is None and not _within(problem, t, misses[t.label])]
    what = ", ".join(f"{t.label!r} is missed by {_amount(t, misses[t.label])}" for t in failing)
    what = what or f"the hard tasks hold, but {_violated(problem, q) or 'not with closed loops'}"
    if code == Status.OUT_OF_TIME:
        said = words.late(problem.time_limit or 0.0, starts, problem.starts)
        return f"{said}: {what}; q is the nearest found{more}"
    worst = np.max([misses[t.label] for t in failing], axis=0) if failing else np.full(2, np.inf)
    if (reason := _reason(problem, q)).endswith(" freedoms)") or reason.endswith(" freedom)"):
        reason += rounded(float(worst[0]), float(worst[1]), characteristic_length(problem.system))
    still = immovable(problem.system)
    more = f"{more}; {still}" if still else more
    return f"not reached after {counted(starts, 'start')}: {what}; {reason}; q is the nearest found{more}"


def _amount(task: Task, error: Array) -> str:
    parts = [f"{error[0]:.6g} m"] if task.lengths else []
    return " and ".join([*parts, f"{error[1]:.3g} rad"] if task.angles else parts)


def _amounts(tasks: list[Task], misses: dict[str, Array]) -> str:
    worst = np.max([misses[t.label] for t in tasks], axis=0)
    parts = [f"{worst[0]:.1e} m"] if any(t.lengths for t in tasks) else []
    return ", ".join([*parts, f"{worst[1]:.1e} rad"] if any(t.angles for t in tasks) else parts)


def _within(problem: Demands, task: Task, error: Array) -> bool:
    linear, angular = problem.tolerance_of(task)
    return bool(error[0] <= linear * 1.000001 and error[1] <= angular * 1.000001)


def _freedoms(problem: Demands, q: Array) -> str:
    """How many freedoms are left, or that there are more equations than freedoms."""
    local = Local(problem, q)
    left = freedoms_text(local) if local.left.shape[1] else "no freedom is left"
    return f"{left}, though {local.m} equations meet {counted(local.n, 'freedom')}" if local.m > local.n else left


def _violated(problem: Demands, q: Array) -> str:
    """Which declared one-sided constraints are violated at q (nq,), and by how much."""
    rows = problem.packed.one_sided
    beyond = rows.beyond(q, declared=True)
    which = [(rows.names[k], float(beyond[k]), rows.units[k]) for k in np.flatnonzero(beyond)]
    return f"violating {words.violations(which)}" if which else ""


def _solved(
    problem: Demands, q: Array, tasks: list[int], limits: bool = True, one_sided: bool = True
) -> Array | None:  # fmt: skip
    """A configuration (nq,) that holds only these hard tasks, or None."""
    part = problem.only(tasks, limits, one_sided)
    found, info = part.run(q[None])
    return found[0] if judge(part, found, info) else None


def _reason(problem: Demands, q: Array) -> str:
    """Why the hard tasks of one problem do not hold together; q (nq,) is the nearest found."""
    hard = [i for i, t in enumerate(problem.tasks) if t.weight is None]
    proofs = [proof for i in hard if (proof := _out_of_reach(problem, i))] or _contradictory(problem)
    above = _solved(problem, q, hard, True, False) if problem.packed.one_sided.declared else None
    if above is not None and not proofs and (said := _violated(problem, above)):
        return f"without one-sided constraints it is reached, {said}"
    free = _solved(problem, q, hard, False)
    over = outside(problem, free) if free is not None else []
    names = words.limits_of(over)
    if proofs:
        return "; ".join([*proofs, f"without {names} it is reached"] if names else proofs)
    if names:
        return words.may_block(names, len(over) == 1)
    if free is not None:
        return "more starts find an answer"
    alone = [i for i in hard if len(hard) == 1 or _solved(problem, q, [i]) is None]
    if alone:
        return "; ".join(_alone(problem, q, i, len(hard) > 1) for i in alone)
    tried = counted(min(problem.starts, STARTS), "start")
    if len(hard) * (len(hard) - 1) // 2 <= MOST_PAIRS:
        labels = [t.label for t in problem.tasks]
        against = [(i, j) for i, j in combinations(hard, 2) if _solved(problem, q, [i, j]) is None]
        if against:
            pairs = ", ".join(f"{labels[i]!r} and {labels[j]!r}" for i, j in against)
            return f"{pairs}: each was reached alone, but not both together in {tried}{_more(problem, q, hard)}"
        if len(hard) > 2:
            return f"any two of the {len(hard)} hard tasks were reached, but not all together{_more(problem, q, hard)}"
    return f"each hard task was reached alone, but not all together{_more(problem, q, hard)}"


def proofs(answer: Reached, index: tuple[int, ...]) -> tuple[Any, ...]:
    """What proves that the tasks of one problem of an answer do not hold together."""
    row = int(np.ravel_multi_index(index, np.shape(answer.code))) if index else 0
    code, problem = np.asarray(answer.code)[index], answer.problem.of(row)
    if code == Status.CONTRADICTORY:
        return tuple(_contradicting(problem))
    hard = [i for i, t in enumerate(problem.tasks) if t.weight is None] if code == Status.OUT_OF_REACH else []
    return tuple(proof for i in hard if (proof := _lengths(problem, i)))


def _contradicting(problem: Demands) -> list[Contradiction]:
    """For each two tasks of one problem that exclude each other, how they do, first found."""
    out: dict[tuple[int, int], Contradiction] = {}
    for found in contradictions(problem):
        if (off := float(np.ravel(found.off)[0])) > 0.0:
            reported = found._replace(off=off, text=found.text.format(off=f"{off:.6g}"))
            out.setdefault((found.first, found.second), reported)
    return list(out.values())


def _contradictory(problem: Demands) -> list[str]:
    """Which tasks of one problem exclude each other, proven."""
    labels = [t.label for t in problem.tasks]
    texts = [f"{labels[x.first]!r} and {labels[x.second]!r}: {x.text}" for x in _contradicting(problem)]
    return [f"contradictory: {'; '.join(texts)}"] if texts else []


def _lengths(problem: Demands, i: int) -> Lengths:
    """How far lengths put a task out of reach."""
    place, turned = beyond(problem, problem.tasks[i], problem.goals[i]).reshape(-1, 2)[0].tolist()
    return Lengths(place, turned)


def _out_of_reach(problem: Demands, i: int) -> str:
    """That lengths put a task out of reach, and how far; empty if they do not."""
    proof = _lengths(problem, i)
    return f"{problem.tasks[i].label!r} is {proof.text}" if proof else ""


def _alone(problem: Demands, q: Array, i: int, among: bool) -> str:
    """Why one task is not reached even alone."""
    label = repr(problem.tasks[i].label)
    free = _solved(problem, q, [i], False)
    if free is not None and (names := outside(problem, free)):
        them = "that" if len(names) == 1 else "these"
        return f"{label} alone is reached without {words.limits_of(names)}, so {them} may be what blocks it"
    said = f"{label} is not found even alone" if among else "no configuration was found"
    return f"{said}{_more(problem, q, [i])}"


def _more(problem: Demands, q: Array, tasks: list[int]) -> str:
    """Whether tasks have more equations than the system has freedoms."""
    rank = LowRank(*analyse(problem.only(tasks), q)[:2])
    return f" ({rank.text})" if rank else ""


def outside(problem: Demands, q: Array) -> list[str]:
    """Coordinates that are outside their limits at q (nq,), whatever whole turns are added."""
    system, names = problem.system, []
    for i, v in zip(system.structure.layout.vector_q, system.structure.layout.vector_v, strict=True):
        low, high, x = system.lower[v], system.upper[v], q[i]
        if system.structure.coordinates.turning[v]:
            x -= 2.0 * np.pi * np.ceil((x - high) / (2.0 * np.pi)) if x > high else 0.0
            x += 2.0 * np.pi * np.ceil((low - x) / (2.0 * np.pi)) if x < low else 0.0
        if not low - 1e-9 <= x <= high + 1e-9:
            names.append(system.structure.velocity_names[v])
    return names
