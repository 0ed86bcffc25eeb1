"""Ranges of samples counted in threads, and stopped without loss."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from kempe.analysis.maps.side_by_side import ThreadWorkers, finished, thread_count
from kempe.analysis.spaces.workspace.recipe import Recipe
from kempe.solvers.common.clock import BROKEN_OFF, TimeLimit

SHARED_BYTES = 256 * 2**20
"""Memory for the counts of all threads together; where each cannot have its own, they share."""


class Threads:
    """Threads that count ranges of samples of a recipe, each range in pieces that are begun in order."""

    def __init__(self, recipe: Recipe, threads: int | None):
        self.recipe, self.n = recipe, thread_count(threads)
        own = max(1, min(self.n, SHARED_BYTES // (4 * recipe.entries)))
        self.counts = [np.zeros(recipe.entries, dtype=np.uint32) for _ in range(own)]

    def count(
        self, first: int, last: int, clock: TimeLimit, said: Callable[[int], None]
    ) -> tuple[np.ndarray, int, Any]:
        """Counts (entries,) of the samples `first` to `stop`, that stop, and what broke the work off (None: nothing).

        `stop` is `last`, or the end of a piece where the time was up or an interrupt came: all pieces before are done.
        """
        for counts in self.counts:
            counts[:] = 0
        piece, free, stop, done, broken = self.recipe.piece, list(range(self.n)), first, first, None
        with ThreadWorkers(self.n) as workers:

            def begin(start: int, _: int) -> Any:
                nonlocal stop
                stop = min(start + piece, last)
                return workers.submit(self._piece, start, stop, free.pop())

            try:
                for _, slot in finished(workers, range(first, last, piece), begin, clock.check):
                    free.append(slot)
                    done = min(done + piece, last)
                    said(done)
            except BROKEN_OFF as error:
                broken = error
        total = self.counts[0]
        for counts in self.counts[1:]:
            total += counts
        return total, stop, broken

    def _piece(self, start: int, stop: int, slot: int) -> int:
        """Count a piece into the counts of a slot, which is then free."""
        self.recipe.count(start, stop, self.counts[slot % len(self.counts)])
        return slot
