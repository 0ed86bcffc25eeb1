"""Levels of tasks: their order, their packed ties, and a look at the same search without the later ones.

Lowering never gives up what earlier levels have reached. But where it begins depends on the later ones in two ways:
hard tasks behind a soft level are met first, and an angle that a later level names does not turn on beyond its limits.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.kernels import loop_layout as L
from kempe.kernels import search_layout as S
from kempe.kinematics.task import Packed, Task, lead_of
from kempe.solvers import effort
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System
    from kempe.solvers.tasks import Problem

KEPT = 64
"""Structures of tasks whose packed ties a system keeps, and sets of weights and tolerances kept with each."""
GAIN, LITTLE = 1e-6, 1e-12
"""Part of the square that a level misses by which another must be less to count as lower, and the least difference."""
MET = 1e-16
"""Square of what a soft level misses up to which it is met."""


def level_of(task: Task) -> tuple[int, bool]:
    """What levels of tasks are ordered by: priority, hard before soft."""
    return int(task.priority), task.weight is not None


def packed_for(system: System, tasks: tuple[Task, ...], turns: bool) -> Packed:
    """The packed ties of tasks, made once for each structure; the last few are kept."""
    levels: tuple[int, ...] = ()
    if len(tasks) > 1:
        order = sorted({level_of(t) for t in tasks})
        if any(soft for _, soft in order[:-1]):
            levels = tuple(order.index(level_of(t)) for t in tasks)
    key = (turns, levels, *((type(t), t.label, t.structure(system)) for t in tasks))
    kept = system._queries.setdefault("tasks", {})
    found = kept.get(key)
    if found is None:
        found = Packed(system, tasks, turns=turns, levels=levels)
        if all(t.lasting for t in tasks):
            keep(kept, key, found)
    return found


def keep(kept: dict[Any, Any], key: Any, value: Any) -> Any:
    """The value, kept in place of the oldest where there are many."""
    while len(kept) >= KEPT:
        kept.pop(next(iter(list(kept)), None), None)
    kept[key] = value
    return value


def keep_levels(problem: Problem, base: Array, q: Array, info: np.ndarray, threads: int | None = 1) -> None:
    """Nothing; makes rows of q and info better in place where earlier levels come lower without the later ones.

    This is looked at where later levels can change where a soft level begins, and the level is missed. Where it comes
    lower, the later ones are lowered from there, as far as the earlier ones stay there.
    """
    for part in _parts(problem):
        rows = np.flatnonzero((info[:, 0] < S.LATE) & (info[:, 0] != S.BAD_INPUT))
        here = values(part, q[rows], rows)
        missed = (here > MET).any(axis=1)
        rows, here = rows[missed], here[missed]
        if not rows.size or time.monotonic() >= problem.end:
            continue
        alone, found = part.run(base, threads, tries=effort.FIRST, rows=rows)
        there = values(part, alone, rows)
        better = (found[:, 0] == S.SOLVED) & is_lower(there, here)
        info[rows, 1] += found[:, 1]
        rows, there = rows[better], there[better]
        if not rows.size:
            continue
        starts = q.copy()
        starts[rows] = alone[better]
        again, more = problem.run(starts, threads, tries=0, rows=rows)
        lost = is_lower(there, values(part, again, rows))
        again[lost], more[lost, 0] = starts[rows[lost]], S.NOT_FOUND
        in_time = more[:, 0] < S.LATE
        q[rows[in_time]], info[rows[in_time], 0] = again[in_time], more[in_time, 0]
        info[rows, 1] += more[:, 1]


def _parts(problem: Problem) -> list[Problem]:
    """The problem up to each level, from the first soft one on, that hard tasks follow, or tasks that name angles
    which could turn on without them."""
    levels = tuple(level_of(t) for t in problem.tasks)
    order = sorted(set(levels))
    if len(order) < 2 or not any(soft for _, soft in order[:-1]):
        return []
    ends = problem.packed.stages.get(levels)
    if ends is None:
        first = [soft for _, soft in order].index(True)
        ends = [end for end in order[first:-1] if _may_differ(problem, end)]
        keep(problem.packed.stages, levels, ends)
    return [_part(problem, end) for end in ends]


def _may_differ(problem: Problem, end: tuple[int, bool]) -> bool:
    """Whether tasks behind this level can change where it begins."""
    later = [t for t in problem.tasks if level_of(t) > end]
    if any(t.weight is None for t in later):
        return True
    named = any(t.coordinates(problem.system) for t in later)
    return named and bool(np.any(_part(problem, end).packed.wide & ~problem.packed.wide))


def _part(problem: Problem, end: tuple[int, bool]) -> Problem:
    """The problem up to a level, nothing preferred."""
    chosen = [i for i, t in enumerate(problem.tasks) if level_of(t) <= end]
    tasks, goals = tuple(problem.tasks[i] for i in chosen), tuple(problem.goals[i] for i in chosen)
    packed = packed_for(problem.system, tasks, problem.packed.turns)
    pins = packed.pins(goals, problem.lead if lead_of(goals) else ())
    use = (True,) * len(tasks)
    return replace(
        problem, tasks=tasks, packed=packed, goals=goals, pins=pins, use=use, mode=S.NOTHING, aim=None, callback=None
    )


def is_lower(values: Array, than: Array) -> np.ndarray:
    """Whether of rows of values (N, levels) the first one that differs is the lower one."""
    far = np.abs(values - than) > np.maximum(GAIN * np.maximum(values, than), LITTLE)
    first = far.argmax(axis=1)[:, None]
    return far.any(axis=1) & (np.take_along_axis(values - than, first, 1)[:, 0] < 0.0)


def values(problem: Problem, q: Array, rows: np.ndarray) -> Array:
    """What each level misses (N, levels), as the solver counts it, at configurations (N, nq) of some rows.

    A soft level counts its weighted square, a hard one the largest square by its tolerance where that is above 1.
    """
    from kempe.kernels.compiled import equations

    loops, m = problem.packed.loops, len(problem.packed.rows)
    stages, strengths, *_ = problem.levels
    pins = problem.pins[rows] if len(problem.pins) > 1 else problem.pins
    g, none, ties = np.empty((len(q), m)), np.empty((0, m, 0)), len(loops.ties)
    equations.equations(
        loops.ints, loops.floats, loops.plan, loops.weights, pins, np.ascontiguousarray(q), False, g, none
    )
    out, at = np.zeros((len(q), int(stages[:ties].max()) + 1)), 0
    for k, tie in enumerate(loops.ties):
        place = loops.plan[L.TIE_INTS * k + loops.plan[L.AT_TIES] :]
        count, lengths, stage = place[L.ROWS], place[L.LENGTHS], stages[k]
        error = g[:, at : at + count]
        at += count
        if stage < 1:
            continue
        if tie.bounds:
            begin = loops.plan[L.AT_BOUNDS] + place[L.BOUND]
            low, high = loops.weights[begin : begin + 2 * count].reshape(-1, 2).T
            error = error - np.clip(error, low, high)
        if stages[ties + k]:
            linear, angular = (np.sum(x * x, axis=1) for x in (error[:, :lengths], error[:, lengths:]))
            worst = np.maximum(linear / strengths[k, 1] ** 2, angular / strengths[k, 2] ** 2)
            out[:, stage] = np.maximum(out[:, stage], np.where(worst > 1.0 + GAIN, worst, 0.0))
        else:
            out[:, stage] += strengths[k, 0] * np.sum(error * error, axis=1)
    return out[:, 1:]
