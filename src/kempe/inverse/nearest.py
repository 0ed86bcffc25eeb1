"""The configuration that comes closest to a target of `ik_all`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from kempe.answers.problem import Problem, solve_problem
from kempe.answers.targets import Z_AXIS, parse_task_targets
from kempe.arguments import quiet
from kempe.inverse.closed_forms.descent import Aim, find_closest
from kempe.inverse.numeric import SOLVERS
from kempe.kernels.base.search_layout import LARGEST
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.inverse.all_answer import Solutions
    from kempe.inverse.answer import Solution
    from kempe.inverse.closed_forms.problem import ChainProblem


def make_aim(solutions: Solutions, index: int, spare: bool = False) -> Aim:
    """Make the aim of target number `index`.

    With `spare`, joints that are locked only because they are spare may move.
    """
    problem = solutions.problem
    plan = solutions.plan
    return Aim.from_target(
        problem, plan, problem.targets[index], plan.fixed if spare else plan.locked
    )


def list_held_coordinates(solutions: Solutions, index: int) -> Array:
    """List the coordinates (n,) of the chain at `near`, with locked joints at their values."""
    lines = solutions.plan.lines
    base = solutions._base[index if len(solutions._base) > 1 else 0]
    q = base[lines.q_index].copy()
    at = list(solutions.plan.locked)
    if at:
        locked = getattr(solutions, "_locked", None)
        low, high = lines.limits[:, at]
        q[at] = (
            np.clip(q[at], low, high)
            if locked is None
            else locked[index if len(locked) > 1 else 0, at]
        )
    return q


@quiet
def find_nearest_configuration(solutions: Solutions, index: int) -> tuple[Array, float, float]:
    """Find the configuration (nq,) inside the limits that is nearest to a target.

    Also returns its position and orientation error.

    The errors are those of position [m] and of orientation, or direction [rad]; 0 where the task
    does not ask for it. Position and orientation are weighed by the length of the chain. Poses and
    positions are left to `ik`; other tasks, and chains with joints held, to descents from several
    starts (Levenberg, 1944; Byrd, Lu, Nocedal and Zhu, 1995). What is found is a local minimum:
    seldom, another one is closer. NaN for targets that are no poses.
    """
    problem = solutions.problem
    plan = solutions.plan
    base = solutions._base[index if len(solutions._base) > 1 else 0]
    target = problem.targets[index]
    if solutions._counts[index, 0] < 0 or np.abs(target).max() >= LARGEST:
        return np.full(problem.system.nq, math.nan), math.nan, math.nan
    if problem.task in ("pose", "position") and not plan.fixed:
        answer = _solve_by_numbers(problem, target, base)
        return answer.q, answer.position_error, answer.orientation_error
    aim = make_aim(solutions, index, spare=True)
    theta = find_closest(aim, plan.lines.compute_theta(list_held_coordinates(solutions, index)))
    q = base.copy()
    q[plan.lines.q_index] = (theta - plan.lines.offset) / plan.lines.multiplier
    R, p, _, _ = aim.compute_line_placements(theta[None])
    e = aim.compute_errors(R, p)[0]
    return q, float(np.linalg.norm(e[:3])) * plan.lines.length, float(np.linalg.norm(e[3:]))


def _solve_by_numbers(problem: ChainProblem, target: Array, start: Array) -> Solution:
    """Solve `ik` for a target (4, 4) by a search that starts at `start` (nq,)."""
    system = problem.system
    task = (problem.task, Z_AXIS)
    goal = target if problem.task == "pose" else target[:3, 3]
    targets, lead, _ = parse_task_targets(system, goal, problem.task, Z_AXIS)
    verb_problem = Problem(
        system, "one", start=start, frame=problem.frame, task=task, targets=targets, lead=lead
    )
    return solve_problem(SOLVERS, verb_problem)
