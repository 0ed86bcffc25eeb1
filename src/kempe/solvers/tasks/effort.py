"""How many starts the search for several tasks is given: few where nothing speaks for an answer, many where much does.

Without the limits, nearly every start finds an answer where there is one. So where some starts without them fail too,
more are hardly worth their time; where they do not, an answer within the limits may take thousands of starts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from kempe.kernels.base import search_layout as S
from kempe.kernels.constraints import loop_layout as L
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.kinematics.tasks.packed import Packed
    from kempe.model.system import System
    from kempe.solvers.tasks.ik_tasks import Demands

FIRST = 60
"""Starts after which one looks whether more are worth their time."""
EACH, MOST, HOPELESS = 30, 15_000, 10
"""Starts by the square of the number of limited coordinates that the tasks move, their largest number, and the part of
them that is tried where no answer without limits is found either. With 30, 1470 are for an arm with seven joints."""


def most_starts(system: System, packed: Packed) -> int:
    """Starts before tasks are given up: they grow with the number of limits that an answer may touch. Kept."""
    found = packed.stages.get(most_starts)
    if found is None:
        plan, weights, nv = packed.loops.plan, packed.loops.weights, system.nv
        places = plan[plan[L.AT_PLACES] :][: L.PLACE_INTS * nv].reshape(nv, L.PLACE_INTS)
        moves = np.diff(plan[plan[L.AT_VARS] :][: nv + 1]) > 0
        _, low, high, *_ = L.velocity_lists(weights, nv)
        limited = np.isfinite(low) | np.isfinite(high)
        count = int(np.sum(moves & limited & (places[:, 1] <= L.BOUND_TURN) & (places[:, 2] == 0)))
        found = packed.stages[most_starts] = min(max(EACH * count * count, 5 * FIRST), MOST)
    return found


def search(problem: Demands, base: Array, threads: int | None = 1) -> tuple[Array, np.ndarray]:
    """As `Demands.run`, with as many starts as each problem deserves: `FIRST` first, then up to those of the problem.

    No more than these where a proof says that there is no answer.
    """
    q, info = problem.run(base, threads, tries=FIRST)
    if len(info) == 1 and info[0, 0] == S.SOLVED:
        return q, info
    left = np.flatnonzero(info[:, 0] == S.NOT_FOUND)
    if not left.size or problem.starts <= FIRST:
        return q, info
    left = left[problem.proofs[left] == 0]
    if not left.size:
        return q, info
    open_ = replace(problem, limits=False, mode=S.NOTHING)
    _, found = open_.run(base, threads, tries=FIRST, rows=left)
    hope = found[:, 0] == S.SOLVED
    for rows, tries in ((left[hope], problem.starts), (left[~hope], problem.starts // HOPELESS)):
        if not rows.size or tries <= FIRST:
            continue
        again, more = problem.run(base, threads, tries=tries, rows=rows)
        better = (more[:, 0] % S.LATE == S.SOLVED) | (more[:, 2] >= info[rows, 2])
        q[rows[better]], info[rows[better]] = again[better], more[better]
        late = rows[~better]
        info[late, 0] = S.NOT_FOUND + S.LATE  # the time was up before it came as far again
    return q, info
