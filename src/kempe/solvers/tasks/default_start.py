"""Where searches start: at home, beside a target, or anywhere."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from kempe.joints import P
from kempe.kernels.constraints import loop_layout as L
from kempe.kinematics.forward import fk, jacobian
from kempe.kinematics.tasks.task import Centred, PlacedTask
from kempe.model.kept import kept
from kempe.model.tree.own_tree import own_tree
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System
    from kempe.solvers.tasks.demands import Demands

FAR = 10.0
"""Characteristic lengths from a frame to its target from which on a base is moved before the first
start."""


def near_target(problem: Demands, home: Array) -> Array:
    """Homes (N or 1, nq) moved by a base that slides without limits to where the first hard task
    holds a frame.

    So a drive over the plane begins beside its target; what is near stays. A base that flies is
    moved by the kernels.
    """
    system = own_tree(problem.system)
    base = _slides(system)
    if not len(base) or problem.packed.loops.plan[L.BASE_TIE] >= 0:
        return home[None]
    for task in problem.tasks:
        if not isinstance(task, PlacedTask) or isinstance(task, Centred):
            continue
        placed = task.point and task.weight is None and task.hold(system).a is None
        if not placed:
            continue
        J = jacobian(system, home, task.hold(system).b)[:3, base]
        away = task.goal(system)[..., :3, 3] - task.place(system, partial(fk, system, home))[:3, 3]
        far = np.linalg.norm(away, axis=-1, keepdims=True) > FAR * problem.packed.loops.length
        if not J.any() or not far.any():
            continue
        dx = away @ np.linalg.pinv(J, rcond=1e-9).T
        moved = np.tile(home, (*dx.shape[:-1], 1))
        places = dict(
            zip(
                system.structure.layout.vector_v.tolist(),
                system.structure.layout.vector_q.tolist(),
                strict=True,
            )
        )
        moved[..., [places[v] for v in base]] += dx
        moved = np.where(far & np.isfinite(dx).all(axis=-1, keepdims=True), moved, home)
        return (
            np.broadcast_to(moved, (*(problem.lead if dx.ndim > 1 else ()), system.nq))
            .reshape(-1, system.nq)
            .copy()
        )
    return home[None]


@kept
def _slides(system: System) -> list[int]:
    """Velocity coordinates without limits that slide along axes that nothing turns."""
    table = system.structure.table
    out: list[int] = []
    straight: set[int] = {-1}
    for row, (kind, parent, v) in enumerate(zip(table.kind, table.parent, table.iv, strict=True)):
        if kind == P and int(parent) in straight:
            straight.add(row)
            if (
                np.isinf(system.lower[v])
                and np.isinf(system.upper[v])
                and np.sum(table.iv == v) == 1
            ):
                out.append(int(v))
    return out
