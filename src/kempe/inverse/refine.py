"""Refinement of solutions by undamped steps, where lengths of a chain differ widely.

Damping drowns a joint whose lever is a millionth of another's. Near a solution a Gauss-Newton step
needs none; each column of the Jacobian is scaled to its size, so that small levers count.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from kempe import spatial
from kempe.answers.targets import is_axis_task, make_rotations_along
from kempe.forward.fk import fk, jacobian
from kempe.inverse.chain.problem import FrameProblem, compute_errors
from kempe.inverse.chain.serial_chain import find_motion_masks
from kempe.inverse.closed_forms.plan import ChainPlan, find_plan_or_reason
from kempe.inverse.closed_forms.problem import ChainProblem
from kempe.inverse.closed_forms.solve import estimate_attainable_error, solve_locked_chain
from kempe.kernels.base.search_layout import ANSWER, LINEAR, NOT_FOUND, SOLVED, STATUS
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.compiled import schedule
from kempe.kernels.forward.table_layout import get_tip_placement
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

TRIES = 24
"""Starts that are sharpened."""

STEPS = 30
LONGEST = 0.5
DONE = 1e-4
"""Steps at most, the longest change of an angle in one, and the part of the tolerances at which
they end.

A step may make the error larger: what a millionth of a long lever turns beside the mark, the next
step makes good."""


def repeat_search(problem: FrameProblem, targets: Array, head: tuple[Any, ...], out: Array) -> int:
    """Improve the answers in `out` where possible, and count the unreached targets.

    head: the first arguments of the kernels. Starts are the ends of the first search and of further
    ones, then closed forms. For poses the tip is moved to the last axis, which changes nothing but
    the lever of the tool.
    """
    ints, floats, limits, rows, goals, seeds, rng = head
    n = out.shape[1] - ANSWER
    if problem.name == "pose" and not np.any(rows[6]):
        floats = floats.copy()
        goals = goals.copy()
        tip = get_tip_placement(ints, floats)
        goals[:, :3, 3] -= (goals[:, :3, :3] @ (tip[:, :3].T @ tip[:, 3])[:, None])[..., 0]
        tip[:, 3] = 0.0
    left = np.flatnonzero(out[:, n + STATUS] == NOT_FOUND)
    for k in range(TRIES + 1):
        if not len(left):
            break
        q = out[left, :n]
        if k == TRIES:
            q = _solve_equations(problem, targets[left], q)
        elif k:
            own = seeds[left] if len(seeds) > 1 else seeds
            found = np.empty((len(left), out.shape[1]))
            schedule.reach_goals(
                ints,
                floats,
                limits,
                rows,
                goals[left],
                own,
                rng,
                k - 1,
                1,
                problem.iterations,
                *problem.tolerance,
                0.0,
                found,
            )
            q = found[:, :n]
        q, error = sharpen_solutions(problem, targets[left], q, limits)
        better = np.max(error / problem.tolerance, axis=1) < np.max(
            out[left, n:][:, :2] / problem.tolerance, axis=1
        )
        at = left[better]
        out[at, :n], out[at, n + LINEAR : n + STATUS] = q[better], error[better]
        out[left[np.all(error <= problem.tolerance, axis=1)], n + STATUS] = SOLVED
        left = left[out[left, n + STATUS] == NOT_FOUND]
    return len(left)


def _solve_equations(problem: FrameProblem, targets: Array, q: Array) -> Array:
    """Find configurations (N, n) by closed form or elimination inside the limits, else q."""

    plan = find_plan_or_reason(problem.system, problem.frame, problem.name, problem.axis)
    return q if isinstance(plan, str) else choose_exact_solutions(problem, plan, targets, q)


def sharpen_solutions(
    problem: FrameProblem, targets: Array, q: Array, limits: Array
) -> tuple[Array, Array]:
    """Sharpen configurations (N, n) inside the limits (2, n); also return errors (N, 2)."""
    best = q.copy()
    least = compute_errors(problem, targets, q)
    score = np.max(least / problem.tolerance, axis=1)
    left = np.flatnonzero(np.isfinite(score))
    x = q[np.isfinite(score)]
    turns = find_motion_masks(problem.chain)[0]
    for _ in range(STEPS):
        if not len(left):
            break
        step = _compute_newton_steps(problem, targets[left], x)
        far = np.abs(step * turns).max(axis=1, initial=LONGEST)
        x = np.clip(x + step * (LONGEST / far)[:, None], *limits)
        error = compute_errors(problem, targets[left], x)
        value = np.max(error / problem.tolerance, axis=1)
        better = value < score[left]
        at = left[better]
        best[at], least[at], score[at] = x[better], error[better], value[better]
        go_on = (score[left] > DONE) & np.isfinite(value)
        left = left[go_on]
        x = x[go_on]
    return best, least


def _compute_newton_steps(problem: FrameProblem, targets: Array, q: Array) -> Array:
    """Compute scaled Gauss-Newton steps (N, n)."""
    chain = problem.chain
    system = problem.system
    turn = make_rotations_along(np.array(problem.axis))
    full = np.repeat(chain.base, len(q), axis=0)
    full[:, chain.q_index] = q
    X = fk(system, full, problem.frame, threads=1)
    J = jacobian(system, full, problem.frame, "body")[..., chain.v_index]
    J = np.concatenate([turn.T @ J[:, :3], turn.T @ J[:, 3:]], axis=1)
    back = np.swapaxes(X[:, :3, :3] @ turn, 1, 2)
    e = np.zeros((len(q), 6))
    e[:, :3] = (back @ (targets[:, :3, 3] - X[:, :3, 3])[..., None])[..., 0]
    D = back @ targets[:, :3, :3] @ turn
    if is_axis_task(problem.name):
        z = D[:, :, 2]
        across = np.stack([-z[:, 1], z[:, 0], np.zeros(len(z))], axis=1)
        sine = np.linalg.norm(across, axis=1, keepdims=True)
        e[:, 3:] = across * np.arctan2(sine, z[:, 2:]) / np.maximum(sine, 1e-300)
    else:
        e[:, 3:] = spatial.log_so3(D)
    size = np.array([1.0 / max(chain.span.largest, 1e-300)] * 3 + [1.0] * 3) * problem.mask
    J = J * size[:, None]
    e = e * size
    column = np.linalg.norm(J, axis=1, keepdims=True)
    column = np.where(column > 0.0, column, 1.0)
    return (Spectrum(J / column).compute_pseudo_inverse(Level.ROUNDING) @ e[..., None])[
        ..., 0
    ] / column[:, 0]


# ---- solutions in closed form, where there is one


def choose_exact_solutions(
    problem: FrameProblem, plan: ChainPlan, targets: Array, q: Array
) -> Array:
    """Choose solutions (N, n) of the equations inside the limits where they exist, else q."""
    lines = plan.lines
    base = problem.chain.base[:, plan.lines.q_index]
    sure = max(*problem.tolerance, estimate_attainable_error(targets, lines))
    chain_problem = ChainProblem(
        problem.system,
        problem.frame,
        problem.name,
        problem.axis,
        targets,
        (len(targets),),
        sure,
        max(problem.tolerance),
    )
    rows, _ = solve_locked_chain(chain_problem, plan, base, base, 1)
    code = rows[..., len(lines) + A.CODE]
    error = np.where((code >= 0.0) & (code % 2.0 == 1.0), rows[..., len(lines) + A.ERROR], np.inf)
    best = np.argmin(error, axis=1)
    at = {int(x): i for i, x in enumerate(lines.q_index)}
    found = rows[np.arange(len(q)), best][:, [at[int(x)] for x in problem.chain.q_index]]
    return np.where(np.isfinite(error.min(axis=1))[:, None], found, q)
