"""Levels of tasks: their order, their packed ties, and what is found without the later ones.

Lowering never gives up what earlier levels have reached, and soft levels are added one by one, each
to what is found without it. Hard tasks behind a soft level are met first, and an angle that a later
level names does not turn on beyond its limits: there the search without the later ones is looked
at, too.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from kempe.kernels.base import search_layout as S
from kempe.kinematics.tasks.packed import Packed, lead_of
from kempe.kinematics.tasks.task import Task
from kempe.model.kept import keep
from kempe.solvers.assembly.ideal import ideal_of
from kempe.solvers.tasks.demands import FIRST, KEPT, Demands, Level, level_of
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

Search = Callable[[Demands, Array, "int | None"], tuple[Array, np.ndarray]]

GAIN = 1e-6
LITTLE = 1e-12
"""Part of the square that a level misses by which another must be less to count as lower, and the
least difference."""
MET = 1e-16
"""Square of what a soft level misses up to which it is met."""


def packed_for(system: System, tasks: tuple[Task, ...], turns: bool) -> Packed:
    """The packed ties of tasks, made once for each structure; the last few are kept."""
    levels: tuple[int, ...] = ()
    if len(tasks) > 1:
        order = sorted({level_of(t) for t in tasks})
        if any(soft for _, soft in order[:-1]):
            levels = tuple(order.index(level_of(t)) for t in tasks)
    key = (turns, levels, *((type(t), t.label, t.structure(system)) for t in tasks))
    answers = system._kept.setdefault(packed_for, {})
    found = answers.get(key)
    if found is None:
        found = Packed(system, tasks, turns=turns, levels=levels, closing=ideal_of(system))
        if all(t.lasting for t in tasks):
            keep(answers, key, found, KEPT)
    return found


def solve(
    problem: Demands,
    base: Array,
    search: Search,
    threads: int | None = 1,
    rows: np.ndarray | None = None,
) -> tuple[Array, np.ndarray]:
    """Configurations (N, nq) and (status, steps, starts) (N, 3), from starts (N or 1, nq); of some
    `rows` few starts.

    A soft last level behind another soft one is lowered from what is found without it.
    """
    end = _cut(problem, _is_added)
    if end is None:
        few = rows is not None
        q, info = (
            problem.run(base, threads, tries=FIRST, rows=rows)
            if few
            else search(problem, base, threads)
        )
        if len(problem.tasks) > 1:
            _compare(
                problem, base, q, info, search, threads, np.arange(len(q)) if rows is None else rows
            )
        return q, info
    q, info = solve(_part(problem, end), base, search, threads, rows)
    rows = np.arange(len(q)) if rows is None else rows
    at = np.flatnonzero((info[:, 0] < S.LATE) & (info[:, 0] != S.BAD_INPUT))
    if at.size:
        q[at], more = _lead_on(problem, rows[at], q[at], threads, -1)
        info[at, 0] = more[:, 0]
        info[at, 1] += more[:, 1]
    return q, info


def _compare(
    problem: Demands,
    base: Array,
    q: Array,
    info: np.ndarray,
    search: Search,
    threads: int | None,
    rows: np.ndarray,
) -> None:
    """Make q and info of some rows better in place where earlier levels come lower without the last
    ones.

    This is looked at where the last levels can change what the others reach, and that is missed.
    Where it comes lower, the last ones are lowered from there, as far as the others stay there. A
    success is given up only for what is one without them.
    """
    end = _cut(problem, _may_differ)
    if end is None:
        return
    soft = any(t.weight is not None and level_of(t) <= end for t in problem.tasks)
    at = np.flatnonzero((info[:, 0] == S.NOT_FOUND) | (soft & (info[:, 0] == S.SOLVED)))
    if not at.size:
        return
    part = _part(problem, end)
    here = values(part, q[at], rows[at])
    missed = (here > MET).any(axis=1)
    at = at[missed]
    here = here[missed]
    if not at.size or time.monotonic() >= problem.end:
        return
    alone, found = solve(part, base, search, threads, rows[at])
    info[at, 1] += found[:, 1]
    there = values(part, alone, rows[at])
    fair = (found[:, 0] == S.SOLVED) | ((found[:, 0] == S.NOT_FOUND) & (info[at, 0] == S.NOT_FOUND))
    better = fair & is_lower(there, here)
    at = at[better]
    alone = alone[better]
    there = there[better]
    if not at.size:
        return
    again, more = _lead_on(problem, rows[at], alone, threads, 0)
    lost = is_lower(there, values(part, again, rows[at]))
    again[lost] = alone[lost]
    more[lost, 0] = S.NOT_FOUND
    in_time = more[:, 0] < S.LATE
    q[at[in_time]] = again[in_time]
    info[at[in_time], 0] = more[in_time, 0]
    info[at, 1] += more[:, 1]


def _lead_on(
    problem: Demands, rows: np.ndarray, q: Array, threads: int | None, tries: int
) -> tuple[Array, np.ndarray]:
    """As `Demands.run` of some rows, from configurations of these."""
    starts = np.zeros((math.prod(problem.lead), q.shape[1]))
    starts[rows] = q
    return problem.run(starts, threads, tries=tries, rows=rows)


def _cut(problem: Demands, where: Callable[[Demands, Level], bool]) -> Level | None:
    """The last level that says so, before the last one."""
    levels = tuple([level_of(t) for t in problem.tasks])
    requested = where, levels
    ends = problem.packed.stages.get(requested)
    if ends is None:
        order = sorted(set(levels))
        ends = keep(
            problem.packed.stages,
            requested,
            [end for end in order[:-1] if where(problem, end)][-1:],
            KEPT,
        )
    return ends[0] if ends else None


def _is_added(problem: Demands, end: Level) -> bool:
    """Whether a soft level, the last one, stands behind this one, which is soft or has soft ones
    before it.
    """
    levels = sorted({level_of(t) for t in problem.tasks})
    return levels[-1][1] and end == levels[-2] and any(soft for _, soft in levels[:-1])


def _may_differ(problem: Demands, end: Level) -> bool:
    """Whether tasks behind this level can change what those up to it reach.

    Hard ones are met before soft ones are lowered, and angles that are named do not turn on beyond
    their limits.
    """
    later = [t for t in problem.tasks if level_of(t) > end]
    soft = any(t.weight is not None and level_of(t) <= end for t in problem.tasks)
    if soft and any(t.weight is None for t in later):
        return True
    named = any(t.coordinates(problem.system) for t in later)
    return named and bool(np.any(_part(problem, end).packed.wide & ~problem.packed.wide))


def _part(problem: Demands, end: Level) -> Demands:
    """The problem up to a level, nothing preferred."""
    levels = tuple([level_of(t) for t in problem.tasks])
    requested = _part, levels, end
    chosen, packed = problem.packed.stages.get(requested) or ((), None)
    if packed is None:
        chosen = tuple(i for i, level in enumerate(levels) if level <= end)
        packed = packed_for(
            problem.system, tuple(problem.tasks[i] for i in chosen), problem.packed.turns
        )
        keep(problem.packed.stages, requested, (chosen, packed), KEPT)
    tasks = tuple([problem.tasks[i] for i in chosen])
    goals = tuple([problem.goals[i] for i in chosen])
    pins = packed.pins(goals, problem.lead if lead_of(goals) else ())
    use = (True,) * len(tasks)
    return replace(
        problem,
        tasks=tasks,
        packed=packed,
        goals=goals,
        pins=pins,
        use=use,
        mode=S.NOTHING,
        aim=None,
        callback=None,
    )


def is_lower(values: Array, than: Array) -> np.ndarray:
    """Whether of rows of values (N, levels) the first one that differs is the lower one."""
    far = np.abs(values - than) > np.maximum(GAIN * np.maximum(values, than), LITTLE)
    first = far.argmax(axis=1)[:, None]
    return far.any(axis=1) & (np.take_along_axis(values - than, first, 1)[:, 0] < 0.0)


def values(problem: Demands, q: Array, rows: np.ndarray) -> Array:
    """What each level misses (N, levels), as the solver counts it, at configurations (N, nq) of
    some rows.

    A soft level counts its weighted square, a hard one the largest square by its tolerance where
    that is above 1.
    """
    from kempe.kernels.compiled import closure_batch

    loops = problem.packed.loops
    m = len(problem.packed.rows)
    stages, strengths, *_ = problem.levels
    pins = problem.pins[rows] if len(problem.pins) > 1 else problem.pins
    g = np.empty((len(q), m))
    none = np.empty((0, m, 0))
    ties = len(loops.ties)
    closure_batch.equations(
        loops.ints,
        loops.floats,
        loops.plan,
        loops.weights,
        pins,
        np.ascontiguousarray(q),
        False,
        g,
        none,
    )
    out = np.zeros((len(q), int(stages[:ties].max()) + 1))
    at = 0
    g -= np.clip(g, *loops.bounds)
    for k, (tie, lengths) in enumerate(zip(loops.ties, loops.lengths, strict=True)):
        count = len(tie.rows)
        stage = stages[k]
        error = g[:, at : at + count]
        at += count
        if stage < 1:
            continue
        if stages[ties + k]:
            linear, angular = (
                np.sum(x * x, axis=1) for x in (error[:, :lengths], error[:, lengths:])
            )
            worst = np.maximum(linear / strengths[k, 1] ** 2, angular / strengths[k, 2] ** 2)
            out[:, stage] = np.maximum(out[:, stage], np.where(worst > 1.0 + GAIN, worst, 0.0))
        else:
            out[:, stage] += strengths[k, 0] * np.sum(error * error, axis=1)
    return out[:, 1:]
