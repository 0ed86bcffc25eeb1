"""Ranges of samples counted in threads, with the time left, and stopped without loss."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any

import numpy as np

from kempe.analysis.spaces.workspace.recipe import Recipe
from kempe.errors import InputError, shown
from kempe.kinematics.common.parallel import processors
from kempe.reals import is_whole
from kempe.solvers.common.clock import BROKEN_OFF, TimeLimit

SHARED_BYTES = 256 * 2**20
"""Memory for the counts of all threads together; where each cannot have its own, they share."""
WAKE = 0.2
"""Seconds between two looks at the clock."""


class Pace:
    """Says how far the work is: calls `progress(done, total)` now and then."""

    def __init__(self, progress: Callable[..., Any] | None, total: int):
        self.progress, self.total, self.said = progress, total, time.monotonic()

    def __call__(self, done: int, at_once: bool = False) -> None:
        """Say that so many samples are done, if it is time, or at once."""
        now = time.monotonic()
        if self.progress is not None and (now - self.said >= WAKE or at_once):
            self.said = now
            self.progress(done, self.total)


class Threads:
    """Threads that count ranges of samples of a recipe, each range in pieces that are begun in order."""

    def __init__(self, recipe: Recipe, threads: int | None):
        if threads is not None and (not is_whole(threads) or threads < 1):
            raise InputError(f"threads is {shown(threads)}; it must be None (all) or a whole number, at least 1")
        self.recipe, self.n = recipe, int(threads or processors())
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
        piece, starts = self.recipe.piece, iter(range(first, last, self.recipe.piece))
        slots, stop, broken = list(range(self.n)), first, None
        running: dict[Future[Any], int] = {}
        with ThreadPoolExecutor(self.n, thread_name_prefix="kempe") as pool:
            try:
                while True:
                    while slots and (start := next(starts, None)) is not None:
                        slot, stop = slots.pop(), min(start + piece, last)
                        into = self.counts[slot % len(self.counts)]
                        running[pool.submit(self.recipe.count, start, stop, into)] = slot
                    if not running:
                        break
                    self._collect(running, slots)
                    said(stop - piece * len(running))
                    clock.check()
            except BROKEN_OFF as error:
                broken = error
                while running:
                    self._collect(running, slots)
        total = self.counts[0]
        for counts in self.counts[1:]:
            total += counts
        return total, stop, broken

    @staticmethod
    def _collect(running: dict[Future[Any], int], slots: list[int]) -> None:
        """Take the slots of pieces that are done, and raise what went wrong in them."""
        done, _ = wait(running, timeout=WAKE, return_when=FIRST_COMPLETED)
        for future in done:
            slots.append(running.pop(future))
            future.result()
