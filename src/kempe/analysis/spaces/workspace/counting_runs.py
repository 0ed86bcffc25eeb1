"""Ranges of samples counted in threads, and stopped without loss."""

from __future__ import annotations

from collections.abc import Callable
from threading import Condition
from typing import Any

import numpy as np

from kempe.analysis.maps.side_by_side import ThreadWorkers, finished
from kempe.analysis.spaces.workspace.recipe import Recipe
from kempe.kinematics.common.parallel import thread_count
from kempe.solvers.common.clock import BROKEN_OFF, TimeLimit

SHARED_BYTES = 256 * 2**20
"""Memory for the counts of all threads together; where each cannot have its own, they share."""


class Threads:
    """Threads that count ranges of samples of a recipe, each range in pieces that are begun in
    order.

    An interrupt may come between any two steps of the thread that hands out the work, even where a
    piece is handed out and its thread is not yet known. So which pieces are begun is decided by the
    threads that count them.
    """

    def __init__(self, recipe: Recipe, threads: int | None):
        self.recipe = recipe
        self.n = thread_count(threads)
        own = max(1, min(self.n, SHARED_BYTES // (4 * recipe.entries)))
        self.counts = [np.zeros(recipe.entries, dtype=np.uint32) for _ in range(own)]
        self.changed = Condition()
        self.free: list[int] = []
        self.begun = self.last = 0

    def count(
        self, first: int, last: int, clock: TimeLimit, said: Callable[[int], None]
    ) -> tuple[np.ndarray, int, Any]:
        """Counts (entries,) of the samples `first` to `stop`, that stop, and what broke the work
        off (None: nothing).

        `stop` is `last`, or the end of a piece where the time was up or an interrupt came: all
        pieces before are done.
        """
        for counts in self.counts:
            counts[:] = 0
        piece = self.recipe.piece
        done = first
        broken = None
        self.begun = first
        self.last = last
        self.free = list(range(self.n))
        with ThreadWorkers(self.n) as workers:

            def begin(_: int, attempt: int) -> Any:
                return workers.submit(self._piece)

            try:
                for _ in finished(workers, range(first, last, piece), begin, clock.check):
                    done = min(done + piece, last)
                    said(done)
            except BROKEN_OFF as error:
                broken = error
        with self.changed:
            self.last = self.begun
            self.changed.wait_for(lambda: len(self.free) == self.n)
        total = self.counts[0]
        for counts in self.counts[1:]:
            total += counts
        return total, self.begun, broken

    def _piece(self) -> None:
        """Count the next piece of the range, if there is one."""
        with self.changed:
            start = self.begun
            if start == self.last:
                return
            self.begun = min(start + self.recipe.piece, self.last)
            slot = self.free.pop()
            stop = self.begun
        try:
            self.recipe.count(start, stop, self.counts[slot % len(self.counts)])
        finally:
            with self.changed:
                self.free.append(slot)
                self.changed.notify()
