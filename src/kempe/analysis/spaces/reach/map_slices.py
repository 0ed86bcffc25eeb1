"""Maps made slice by slice, which say how far they are, and keep what was done where they are broken off."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kempe.budget import Budget
from kempe.solvers.common.clock import BROKEN_OFF, TimeLimit, TimeUp
from kempe.spatial import Array
from kempe.status import Status

SLICE = 20_000
"""Poses that are tried at once."""


def sliced(
    work: Callable[[int, int, Budget], list[Array]], count: int, poses: int, spend: Budget
) -> tuple[list[Array], Status | None]:
    """What `work` finds of the places 0 to `count`, each of so many `poses`, and what broke it off (None: nothing).

    `work` gets the first place, the one after the last and what it may spend, and gives arrays with a row a place. Rows
    that were not reached before the time limit or an interrupt are NaN; the first slice is always done.
    """
    clock, each = TimeLimit(spend.time_limit), Budget(starts=spend.starts, rng=spend.rng, threads=spend.threads)
    at_once, broken = max(1, SLICE // poses), None
    rows: list[list[Array]] = []
    try:
        for first in range(0, max(count, 1), at_once):
            if first:
                clock.check()
            last = min(first + at_once, count)
            rows.append(work(first, last, each))
            if spend.progress is not None:
                spend.progress(last * poses, count * poses)
    except BROKEN_OFF as error:
        if not rows:
            raise
        broken = Status.OUT_OF_TIME if isinstance(error, TimeUp) else Status.INTERRUPTED
    out = [np.concatenate(x).astype(float) for x in zip(*rows, strict=True)]
    return [np.concatenate([x, np.full((count - len(x), *x.shape[1:]), np.nan)]) for x in out], broken
