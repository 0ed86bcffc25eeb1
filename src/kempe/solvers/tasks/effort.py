"""How many starts the search for several tasks is given: few where nothing speaks for an answer,
many where much does.

Without the limits, nearly every start finds an answer where there is one. So where some starts
without them fail too, more are hardly worth their time; where they do not, an answer within the
limits may take thousands of starts.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from kempe.kernels.base import search_layout as S
from kempe.kernels.constraints import loop_layout as L
from kempe.solvers.common.clock import EndReached
from kempe.solvers.tasks.contradictions import contradictory
from kempe.solvers.tasks.demands import FIRST, Demands
from kempe.solvers.tasks.reach_bounds import unreachable
from kempe.spatial import Array
from kempe.status import Status

if TYPE_CHECKING:
    from kempe.kinematics.tasks.packed import Packed
    from kempe.model.system import System

EACH = 30
MOST = 15_000
HOPELESS = 10
"""Starts by the square of the number of limited coordinates that the tasks move, their largest
number, and the part of them that is tried where no answer without limits is found either. With 30,
1470 are for an arm with seven joints."""


GLIMPSE = 10_000
SHARE = 2_500
"""Calls of Python functions after which it is checked whether a search may ever end well, and calls
of each of the searches by which this is checked. They are counted, not timed, so that no answer
depends on how busy the machine is."""

Found = tuple[Array, np.ndarray]
"""Configurations (N, nq) and (status, steps, starts) (N, 3)."""


class Effort:
    """A check for `watched_by` that lets a search call functions, and begin starts, `most` times in
    all.
    """

    def __init__(self, most: int):
        self.most = most
        self.count = 0

    def __call__(self) -> None:
        """Count one more. Raises `EndReached` where these are too many."""
        self.count += 1
        if self.spent:
            raise EndReached

    @property
    def spent(self) -> bool:
        """Whether it ended a search."""
        return self.count > self.most


def of_functions(problem: Demands) -> bool:
    """Whether Python functions decide what holds: how long a start takes is not known beforehand."""
    return any(t.function is not None for t in problem.packed.loops.ties)


def patiently(
    problem: Demands, solve: Callable[[Demands], Found], base: Array
) -> tuple[Demands, Found]:
    """The problem, how far it was searched, and what `solve` finds: at first with GLIMPSE calls, of
    one problem.

    It goes on only where a search without limits finds an answer, and each function alone holds
    inside the limits.
    """
    effort = Effort(GLIMPSE)
    q, info = solve(replace(problem, effort=effort))
    if not effort.spent or time.monotonic() >= problem.end:
        return problem, (q, info)
    if _hopeful(problem, base) or time.monotonic() >= problem.end:
        return problem, solve(problem)
    info[info[:, 0] >= S.LATE, 0] -= S.LATE  # it was not the time that ended it
    return replace(problem, given_up=effort.most), (q, info)


def _hopeful(problem: Demands, base: Array) -> bool:
    """Whether there is an answer without limits, and one for each hard task that is a function,
    inside them.
    """
    hard = [i for i, t in enumerate(problem.tasks) if t.weight is None]
    called = {
        int(i)
        for i, t in zip(problem.packed.owner, problem.packed.loops.ties, strict=True)
        if t.function
    }
    trials = [problem.only(hard, False), *(problem.only([i]) for i in hard if i in called)]
    for trial in trials:
        _, info = replace(trial, end=problem.end, effort=Effort(SHARE)).run(base[:1], tries=FIRST)
        if info[0, 0] != S.SOLVED:
            return False
    return True


def most_starts(system: System, packed: Packed) -> int:
    """Starts before tasks are given up: they grow with the number of limits that an answer may
    touch. Kept.
    """
    found = packed.stages.get(most_starts)
    if found is None:
        plan = packed.loops.plan
        weights = packed.loops.weights
        nv = system.nv
        places = plan[plan[L.AT_PLACES] :][: L.PLACE_INTS * nv].reshape(nv, L.PLACE_INTS)
        moves = np.diff(plan[plan[L.AT_VARS] :][: nv + 1]) > 0
        _, low, high, *_ = L.velocity_lists(weights, nv)
        limited = np.isfinite(low) | np.isfinite(high)
        count = int(np.sum(moves & limited & (places[:, 1] <= L.BOUND_TURN) & (places[:, 2] == 0)))
        found = packed.stages[most_starts] = min(max(EACH * count * count, 5 * FIRST), MOST)
    return found


def proofs_of(problem: Demands) -> np.ndarray:
    """Codes (N,) of the problems that are proven to have no answer, 0 of others. Kept with the
    problem.
    """
    found: np.ndarray | None = problem.kept.get(proofs_of)
    if found is None:
        against = np.where(contradictory(problem), Status.CONTRADICTORY, 0)
        found = np.where(unreachable(problem), Status.OUT_OF_REACH, against).ravel()
        problem.kept[proofs_of] = found
    return found


def search(problem: Demands, base: Array, threads: int | None = 1) -> tuple[Array, np.ndarray]:
    """As `Demands.run`, with as many starts as each problem deserves: `FIRST` first, then up to
    those of the problem.

    No more than these where a proof says that there is no answer.
    """
    q, info = problem.run(base, threads, tries=FIRST)
    if len(info) == 1 and info[0, 0] == S.SOLVED:
        return q, info
    left = np.flatnonzero(info[:, 0] == S.NOT_FOUND)
    if not left.size or problem.starts <= FIRST:
        return q, info
    left = left[proofs_of(problem)[left] == 0]
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
