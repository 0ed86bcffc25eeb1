"""Maps made slice by slice, which say how far they are, and keep what was done where they are
broken off.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from kempe.budget import Budget
from kempe.kinematics.configuration import has_loops
from kempe.solvers.common.clock import BROKEN_OFF, TimeLimit, TimeUp
from kempe.spatial import Array
from kempe.status import Status

if TYPE_CHECKING:
    from kempe.model.system import System

SLICE = 2048
LOOP_SLICE = 128
"""Poses that are tried at once, of a system with closed loops, where each takes longer: less than a
second's work."""
LONG = 16
"""Velocity coordinates, twice which make these poses fewer, for the work grows with their
square."""


def sliced(
    system: System,
    work: Callable[[int, int, Budget], list[Array]],
    shapes: Sequence[tuple[int, ...]],
    count: int,
    poses: int,
    spend: Budget,
) -> tuple[list[Array], Status | None]:
    """What `work` finds of the places 0 to `count`, each of so many `poses`, and what broke it off
    (None: nothing).

    `work` gets the first place, the one after the last and what it may spend, and gives arrays with
    a row, of one of the `shapes`, for each place. Rows that were not done before the time limit or
    an interrupt are NaN.
    """
    clock = TimeLimit(spend.time_limit)
    each = Budget(starts=spend.starts, rng=spend.rng, threads=spend.threads)
    share = max(1, system.nv // LONG) ** 2
    broken = None
    at_once = max(1, (LOOP_SLICE if has_loops(system) else SLICE) // (poses * share))
    rows: list[list[Array]] = []
    try:
        with clock:
            for first in range(0, max(count, 1), at_once):
                clock.check()
                last = min(first + at_once, count)
                rows.append(work(first, last, each))
                if spend.progress is not None:
                    spend.progress(last * poses, count * poses)
    except BROKEN_OFF as error:
        broken = Status.OUT_OF_TIME if isinstance(error, TimeUp) else Status.INTERRUPTED
    rows.append([np.zeros((0, *shape)) for shape in shapes])
    out = [np.concatenate(x).astype(float) for x in zip(*rows, strict=True)]
    return [
        np.concatenate([x, np.full((count - len(x), *x.shape[1:]), np.nan)]) for x in out
    ], broken
