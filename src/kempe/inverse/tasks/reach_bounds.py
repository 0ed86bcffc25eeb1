"""Tasks that lengths alone put out of reach, with loops or without.

A loop, a relation or another task only takes away from what the chain from the ground to the frame
can reach.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from kempe.equations.tasks import Goal, Task
from kempe.inverse.chain.length_bounds import ReachBound, compute_reach_bounds, measure_bound_excess
from kempe.kernels.constraints import loop_layout as L
from kempe.model.gauge import regauge_table
from kempe.model.own_tree import remove_cut_marks
from kempe.model.primitive_table import extract_chain
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.inverse.tasks.demands import Demands
    from kempe.model.model import Model


def find_unreachable_problems(problem: Demands) -> np.ndarray:
    """Find the problems (...) with a hard task that is out of reach."""
    out = np.zeros(problem.lead, dtype=bool)
    for i, (task, goal) in enumerate(zip(problem.tasks, problem.goals, strict=True)):
        if problem.use[i] and task.weight is None:
            out = out | compute_excess_distances(problem, task, goal).any(axis=-1)
    return out


def compute_excess_distances(problem: Demands, task: Task, goal: Goal) -> Array:
    """Compute how far (..., 2) [m] a task's position, and its pose, are out of reach.

    It is a lower bound of the error in its place; zero where lengths say nothing, or within the
    tolerances.
    """
    system = remove_cut_marks(problem.system)
    none = np.zeros((1, 2))
    shape = task.frame_shape
    pose = goal.pose
    a, b = task.frames
    if shape is None or task.bounded or pose is None or b is None:
        return none
    if not shape.mask or shape.turns not in (L.NO_TURN, L.FULL, L.ANGLE):
        return none
    if a is not None:
        row, X, particle = system.structure.table.at[a]
        if row >= 0 or particle:
            return none
        pose = X @ pose
    bounds, freedoms = _list_reach_bounds(system, b, np.reshape(task.tool, (4, 4)))
    # else that is the reason
    turned = shape.turned and freedoms >= (3 if system.dim == 2 else 6)
    axes = sorted(shape.axes)
    return measure_bound_excess(bounds, pose, problem.get_tolerance(task), turned, axes, system.dim)


def _list_reach_bounds(system: Model, frame: str, tool: Array) -> tuple[list[ReachBound], int]:
    """List the bounds for the point that a task holds, and count coordinates that move it."""
    table, _, v_index = extract_chain(system.structure.table, frame)
    row, X, particle = table.at[frame]
    table = replace(table, at={frame: (row, X @ tool, particle)})
    packed = table.pack_arrays([frame])
    limits = system.structure.limits[v_index].T
    return [
        b
        for arrays in (packed, regauge_table(*packed))
        for b in compute_reach_bounds(*arrays, limits)
    ], len(v_index)
