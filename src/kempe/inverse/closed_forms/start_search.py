"""Solutions found by many starts, for chains without closed form or elimination.

They are never known to be complete.

The search of `ik`, without limits, leads each start to the target or gives it up; what is reached
is made exact.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from kempe.answers.targets import turn_targets_to_axis
from kempe.inverse.chain.problem import ITERATIONS, MOST, FrameProblem, pack_row_flags
from kempe.inverse.chain.serial_chain import find_chain
from kempe.inverse.closed_forms.descent import Aim
from kempe.inverse.closed_forms.plan import ChainPlan
from kempe.inverse.closed_forms.problem import ChainProblem
from kempe.kernels.base.search_layout import ANSWER, SOLVED, STATUS
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.compiled import schedule
from kempe.kernels.forward.table_layout import SLIDE
from kempe.model.configurations import shorten_turns
from kempe.numerics.newton import run_many_gauss_newton
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.inverse.chain.serial_chain import Chain
    from kempe.inverse.closed_forms.chain_lines import Lines

STARTS = 400
STEPS = 80
LONGEST = 0.7
"""Starts, damped Newton steps that make each exact, and the longest change of a joint in one."""

REACHED = 1e-6
MANY = 64
ALIKE = 1e-4
"""Errors [m, rad] up to which a start is led; how many of those that are reached are made exact, at
most; and how far these are apart."""

FLOOR = 1e-14
"""Damping that is always there, and as a part of the trace."""

APART = 1e-6
"""Solutions nearer than this are one."""


def search_targets(
    problem: ChainProblem,
    plan: ChainPlan,
    near: Array,
    locked: Array,
    out: Array,
    counts: np.ndarray,
    which: np.ndarray,
) -> None:
    """Search for solutions of the targets `which`; fill `out` (N, K, n + 2) and `counts` (N, 2)."""
    out[which, :, -A.INFO + A.CODE] = A.UNUSED
    counts[which, 1] = 1
    for k, i in enumerate(which):
        if problem.check_time(which[k:]):
            bad = ~np.isfinite(problem.targets[which[k:]]).all(axis=(1, 2))
            counts[which[k:], 0] = np.where(bad, -1, 0)
            break
        target = problem.targets[i]
        if not np.isfinite(target).all():
            counts[i, 0] = -1
            continue
        at = i if len(locked) > 1 else 0
        found, error = _find_solutions(problem, plan, target, locked[at])
        _write_rows(
            plan, found, error, near[i if len(near) > 1 else 0], out[i], problem.lead is None
        )
        counts[i, 0] = int((out[i, :, -A.INFO + A.CODE] >= 0.0).sum())


def _find_solutions(
    problem: ChainProblem, plan: ChainPlan, target: Array, locked: Array
) -> tuple[Array, Array]:
    """Find distinct solutions (k, n) of a target, and their errors (k,)."""
    lines = plan.lines
    rng = np.random.default_rng(0)
    aim = Aim.from_target(problem, plan, target, plan.locked)
    theta = np.where(
        lines.kinds == SLIDE,
        rng.uniform(-2.0, 2.0, (STARTS, len(lines))),
        rng.uniform(-np.pi, np.pi, (STARTS, len(lines))),
    )
    theta[:, list(plan.locked)] = lines.compute_theta(locked)[list(plan.locked)]
    if not lines.span.wide:
        theta = _search_from_starts(problem, plan, target, theta)
    if not len(theta):
        return theta, np.zeros(0)

    def compute_damped_step(e: Array, J: Array) -> Array:
        damping = np.minimum(0.05 * (e * e).sum(axis=1), 0.1) + FLOOR
        N = np.swapaxes(J, 1, 2) @ J
        damping += FLOOR * np.trace(N, axis1=1, axis2=2)  # else LU may find it singular
        N += damping[:, None, None] * np.eye(len(aim.moves))
        y = np.zeros((len(e), len(lines)))
        y[:, aim.moves] = np.linalg.solve(N, np.swapaxes(J, 1, 2) @ e[..., None])[..., 0]
        return y

    theta = run_many_gauss_newton(
        lambda x, _: aim.linearise_errors(x),
        theta,
        STEPS,
        step=compute_damped_step,
        met=1e-15,
        last=0.0,
        longest=LONGEST,
    )
    size = np.linalg.norm(aim.linearise_errors(theta)[0], axis=1)
    found: list[Array] = []
    error: list[float] = []
    for k in np.flatnonzero(size <= problem.tolerance / max(lines.length, 1.0)):
        if all(_compute_gap(lines, theta[k], x) > APART for x in found):
            found.append(theta[k])
            error.append(size[k] * max(lines.length, 1.0))
        if len(found) == plan.method.slots:
            break
    return np.array(found, dtype=float).reshape(-1, len(lines)), np.array(error)


def make_frame_problem(problem: ChainProblem) -> FrameProblem:
    """Make the problem in the form that numerical solvers read."""
    chain = find_chain(problem.system, problem.frame, problem.axis)
    tolerance = (problem.tolerance, problem.angular)
    return FrameProblem(
        problem.system,
        problem.frame,
        problem.targets,
        problem.task,
        problem.axis,
        tolerance,
        MOST,
        0,
        chain,
    )


def find_chain_columns(chain: Chain, lines: Lines) -> np.ndarray:
    """Find, for each line (n,), the coordinate of the packed chain."""
    return np.argsort(chain.q_index)[np.argsort(np.argsort(lines.q_index))]


def _search_from_starts(
    problem: ChainProblem, plan: ChainPlan, target: Array, theta: Array
) -> Array:
    """Search from starts theta (m, n); return distinct variables (k, n) close to the target."""
    lines = plan.lines
    task = make_frame_problem(problem)
    chain = task.chain
    n = len(lines)
    at = find_chain_columns(chain, lines)
    pins = list(plan.locked)
    goal = turn_targets_to_axis(target[None], problem.axis)
    seeds = np.empty((len(theta), 1, n))
    limits = np.tile([[-np.inf], [np.inf]], n)
    circular = chain.circular.copy()
    seeds[:, 0, at] = (theta - lines.offset) / lines.multiplier
    limits[:, at[pins]] = seeds[0, 0, at[pins]]
    circular[at[pins]] = 0
    wanted = pack_row_flags(replace(task, chain=replace(chain, circular=circular)))
    goals = np.repeat(goal, len(theta), axis=0)
    out = np.empty((len(theta), n + ANSWER))
    schedule.reach_goals(
        chain.ints,
        chain.floats,
        limits,
        wanted,
        goals,
        seeds,
        0,
        0,
        1,
        ITERATIONS,
        REACHED,
        REACHED,
        0.0,
        out,
    )
    found = lines.compute_theta(out[out[:, n + STATUS] == SOLVED][:, at])
    kept: list[Array] = []
    for x in found:
        if all(_compute_gap(lines, x, y) > ALIKE for y in kept):
            kept.append(x)
        if len(kept) == MANY:
            break
    return np.array(kept).reshape(-1, n)


def _compute_gap(lines: Lines, x: Array, y: Array) -> float:
    """Compute the largest difference of a joint between two configurations."""
    return float(np.abs(shorten_turns(x - y, lines.kinds != SLIDE)).max())


def _write_rows(
    plan: ChainPlan, found: Array, error: Array, near: Array, out: Array, sort: bool
) -> None:
    """Write the rows of one target, each angle with the turn inside the limits nearest to `near`."""
    lines = plan.lines
    period = np.where(lines.kinds == SLIDE, np.inf, 2.0 * math.pi / np.abs(lines.multiplier))
    low, high = lines.limits
    q = (found - lines.offset) / lines.multiplier
    with np.errstate(invalid="ignore"):
        turns = np.where(np.isinf(period), 0.0, period)
        q = q + turns * np.round(np.where(turns > 0.0, (near - q) / period, 0.0))
        q = np.where((q > high) & (turns > 0.0), q - turns * np.ceil((q - high) / period), q)
        q = np.where((q < low) & (turns > 0.0), q + turns * np.ceil((low - q) / period), q)
    inside = ((q >= low) & (q <= high)).all(axis=1)
    order = np.lexsort((np.linalg.norm(q - near, axis=1), ~inside)) if sort else np.arange(len(q))
    for row, k in zip(out, order, strict=False):
        row[: len(lines)], row[-A.INFO + A.ERROR] = q[k], error[k]
        row[-A.INFO + A.CODE] = A.MULTIPLICITY_UNIT + float(inside[k])
