"""Which tasks lengths alone put out of reach: how far a frame can be from where its chain begins,
loops or not.

A loop, a relation or another task only takes away from what the chain from the ground to the frame
can reach.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from kempe.equations.tasks import Centred, Goals, PlacedTask, Task, TaskTie
from kempe.inverse.chain.length_bounds import ReachBound, by_lengths, reach_bounds
from kempe.kernels.constraints import loop_layout as L
from kempe.model.gauge import regauge
from kempe.model.own_tree import own_tree
from kempe.model.primitive_table import local_chain
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.inverse.tasks.demands import Demands
    from kempe.model.model import Model


def unreachable(problem: Demands) -> np.ndarray:
    """Which problems (...) have a hard task that is out of reach."""
    out = np.zeros(problem.lead, dtype=bool)
    for i, (task, goals) in enumerate(zip(problem.tasks, problem.goals, strict=True)):
        if problem.use[i] and task.weight is None:
            out = out | beyond(problem, task, goals).any(axis=-1)
    return out


def beyond(problem: Demands, task: Task, goals: Goals) -> Array:
    """How far (..., 2) in metres a task is out of reach, as to its place, and together with its
    orientation.

    It is a lower bound of the error in its place; zero where lengths say nothing, or within the
    tolerances.
    """
    system = own_tree(problem.system)
    (goal, _) = goals[0]
    none = np.zeros((1, 2))
    if (
        not isinstance(task, PlacedTask)
        or isinstance(task, Centred)
        or task.bounded
        or goal is None
    ):
        return none
    if not task.shape.mask or task.shape.turns not in (L.NO_TURN, L.FULL, L.ANGLE):
        return none
    hold = task.hold(system)
    if hold.a is not None:
        row, X, particle = system.structure.table.at[hold.a]
        if row >= 0 or particle:
            return none
        goal = X @ goal
    axes = [i for i in range(3) if hold.mask >> i & 1]
    bounds, freedoms = _bounds(system, hold)
    # else that is the reason
    turned = hold.turns in (L.FULL, L.ANGLE) and freedoms >= (3 if system.dim == 2 else 6)
    return by_lengths(bounds, goal, problem.tolerance_of(task), turned, axes, system.dim)


def _bounds(system: Model, hold: TaskTie) -> tuple[list[ReachBound], int]:
    """Bounds for the point that a task holds, and how many coordinates move it."""
    table, _, v_index = local_chain(system.structure.table, hold.b)
    row, X, particle = table.at[hold.b]
    table = replace(table, at={hold.b: (row, X @ np.reshape(hold.X_B, (4, 4)), particle)})
    packed = table.pack([hold.b])
    limits = system.structure.limits[v_index].T
    return [b for arrays in (packed, regauge(*packed)) for b in reach_bounds(*arrays, limits)], len(
        v_index
    )
