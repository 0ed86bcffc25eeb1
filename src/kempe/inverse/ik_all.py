"""Inverse kinematics with all solutions: every configuration in which a frame reaches a target."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers.problem import Problem, record_choice, select_solver
from kempe.answers.targets import (
    choose_axis,
    choose_task,
    explain_refused_target,
    is_axis_task,
    make_planar_target,
    parse_task_targets,
    read_target,
    refuse_position,
    split_task,
)
from kempe.arguments import explain_errors
from kempe.arrays import FARTHEST
from kempe.budget import Budget
from kempe.errors import InputError, UnsupportedError
from kempe.geometry.path_clearance import read_clearances
from kempe.inverse.all_answer import Solutions
from kempe.inverse.closed_forms.problem import read_fixed_values
from kempe.inverse.solve_all import BATCH, SOLVERS, USUAL, select_clear_solutions
from kempe.numerics.clock import TimeLimit, limit_preparation_time

if TYPE_CHECKING:
    from kempe.argument_types import PoseLike
    from kempe.assemble.modes import Modes
    from kempe.model.model import FrameLike, Model

LIMITS = (False, True, "turns")


@explain_errors
def ik_all(
    system: Model,
    target: PoseLike,
    frame: FrameLike,
    start: Any = None,
    *,
    task: str | tuple[str, ArrayLike] | None = None,
    fixed: Mapping[str, Any] | None = None,
    limits: bool | str = False,
    clearance: Any = None,
    tolerance: float | None = None,
    budget: Budget | None = None,
) -> Solutions | Modes:
    """Find all configurations in which a frame reaches a target; see `System.ik_all`."""
    name = system.structure.frame_name(frame)
    target = read_target(system, target)
    (said, axis) = split_task(task)
    if limits not in LIMITS:
        raise InputError(f"limits is {limits!r}; it must be False, True or 'turns'")
    if system.dim == 2 and is_axis_task(said):
        target, said = make_planar_target(target, said, axis)
    direction = choose_axis(axis, said)
    targets, lead, is_position = parse_task_targets(system, target, said, direction)
    task = choose_task(said, is_position, bool(system.structure.table.at[name][2]))
    refuse_position(task, is_position, system.dim)
    if lead == () and not np.all(np.abs(targets) < FARTHEST):
        raise InputError(explain_refused_target(targets[0]))
    known = read_fixed_values(fixed)
    problem = Problem(
        system,
        "all",
        known,
        start,
        None,
        limits,
        tolerance,
        budget,
        frame=name,
        task=(task, direction),
        targets=targets,
        lead=lead,
    )
    time = TimeLimit((BATCH if lead else USUAL).complete_budget(budget).time_limit)
    time.release_reserved_time()  # a plan is made as a whole, or not at all
    with limit_preparation_time(USUAL, time):
        solver, choice = select_solver(SOLVERS, problem)
    problem = problem._replace(options={"time": time})
    answer = solver.run(problem)
    if clearance is not None:
        clearances = read_clearances(clearance)
        if not isinstance(answer, Solutions):
            raise UnsupportedError(
                "clearance: the frame moves with loops, or with joints that follow others; "
                "system.geometry.clearance measures the modes"
            )
        answer = select_clear_solutions(answer, clearances)
    return record_choice(answer, choice)
