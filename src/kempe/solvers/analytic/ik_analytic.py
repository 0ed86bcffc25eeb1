"""Where `ik` is answered by `ik_all`: the nearest of all solutions, and numbers for the rest."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from kempe.errors import UnsupportedError
from kempe.kernels.base.search_layout import SOLVED
from kempe.kernels.closed_form import analytic_layout as A
from kempe.solvers.analytic.ik_all import (
    TOLERANCE,
    attainable,
    chain_lines,
    plan_for,
    solve,
    solve_held,
)
from kempe.solvers.analytic.plans.plan import ChainPlan
from kempe.solvers.analytic.plans.question import Question, Watch
from kempe.solvers.common.clock import TimeLimit
from kempe.solvers.one_frame.inverse import run
from kempe.solvers.one_frame.multi_start import FrameProblem, misses
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System


PIECE = 2**15
"""Targets that are solved, and whose solutions are compared, before the clock is looked at
again."""


def plan_of(
    system: System, frame: str, task: str, axis: tuple[float, float, float]
) -> ChainPlan | str:
    """The plan that answers a task of a frame, or why numbers have to."""
    try:
        plan = plan_for(system, frame, chain_lines(system, frame, axis), task, axis, ())
    except UnsupportedError as error:
        return str(error)
    if plan.method != "search" and not plan.locked:
        return plan
    why = (
        "has more joints than the task needs"
        if plan.locked
        else "has neither a closed form nor an elimination"
    )
    return f"the chain of {frame!r} {why}: method 'analytic' has no single answer for it"


def kept(task: FrameProblem, plan: ChainPlan, targets: Array, q: Array) -> Array:
    """Configurations (N, n) of the chain: a solution inside the limits where the equations have
    one, else q (N, n).
    """
    lines = plan.lines
    base = task.chain.base[:, plan.lines.q_index]
    sure = max(*task.tolerance, attainable(targets, lines))
    question = Question(
        task.system,
        task.frame,
        task.name,
        task.axis,
        targets,
        (len(targets),),
        sure,
        max(task.tolerance),
    )
    rows, _ = solve_held(question, plan, base, base, 1)
    code = rows[..., len(lines) + A.CODE]
    error = np.where((code >= 0.0) & (code % 2.0 == 1.0), rows[..., len(lines) + A.ERROR], np.inf)
    best = np.argmin(error, axis=1)
    at = {int(x): i for i, x in enumerate(lines.q_index)}
    found = rows[np.arange(len(q)), best][:, [at[int(x)] for x in task.chain.q_index]]
    return np.where(np.isfinite(error.min(axis=1))[:, None], found, q)


def answer(
    task: FrameProblem, plan: ChainPlan, near: Array, seeds: Array, threads: int | None
) -> tuple[Array, Array, np.ndarray]:
    """As `inverse.run`: the solution inside the limits nearest to `near` (1 or N, nq); where there
    is none, numbers.
    """
    n = len(task.targets)
    q = np.empty((n, len(task.chain.q_index)))
    residual = np.zeros((n, 2))
    there = np.zeros(n, dtype=bool)
    for k in range(0, max(n, 1), PIECE):
        if k and time.monotonic() >= task.end:
            break
        at = slice(k, k + PIECE)
        base = near[k : k + PIECE] if len(near) > 1 else near
        q[at], residual[at], there[at] = _solved(
            replace(task, targets=task.targets[at]), plan, base, threads
        )
    info = np.zeros((n, 3), dtype=np.int64)
    info[:, 0] = SOLVED
    rest = np.flatnonzero(~there)
    if len(rest):
        some = seeds[rest] if len(seeds) > 1 else seeds
        q[rest], residual[rest], info[rest] = run(task, some, threads, targets=task.targets[rest])
    return q, residual, info


def _solved(
    task: FrameProblem, plan: ChainPlan, near: Array, threads: int | None
) -> tuple[Array, Array, np.ndarray]:
    """The nearest solutions (n, k) to `near` (1 or n, nq), their errors (n, 2), and where there are
    any (n,).
    """
    n = len(task.targets)
    chain = task.chain
    within = min(*task.tolerance, TOLERANCE)
    limit = TimeLimit(task.time_limit)
    limit.end = task.end  # that of the whole batch
    question = Question(
        task.system,
        task.frame,
        task.name,
        task.axis,
        task.targets,
        (n,),
        within,
        watch=Watch(limit, n),
    )
    found = solve(question, plan, near, {}, threads)
    own = found._rows[..., : len(plan.lines)]
    inside = found.inside
    unit = np.abs(plan.lines.multiplier)
    away = np.where(
        inside, np.linalg.norm((own - near[:, None, plan.lines.q_index]) * unit, axis=-1), np.inf
    )
    best = np.argmin(away, axis=1)
    there = np.asarray(inside.any(axis=1))
    residual = np.zeros((n, 2))
    at = {int(x): i for i, x in enumerate(plan.lines.q_index)}
    q = own[np.arange(n), best][:, [at[int(x)] for x in chain.q_index]]
    residual[there] = misses(task, task.targets[there], q[there])
    return q, residual, there
