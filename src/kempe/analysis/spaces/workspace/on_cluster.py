"""Ranges of samples counted by the workers of a Dask cluster, and added up there in a tree.

Each task is a pure function of the recipe and its range: it can be done twice, or anywhere, and a
worker that is lost costs its tasks only. Nothing is added into storage; counts come here once a
part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from kempe.analysis.maps.cluster import ClusterWorkers
from kempe.analysis.maps.side_by_side import RETRIES, finished
from kempe.analysis.spaces.workspace.recipe import Recipe, counted

FAN = 8
"""Counts that one task adds up."""


def added(many: bool, *counts: np.ndarray) -> np.ndarray:
    """The sum of counts, of 64 bits where there are `many` samples."""
    total = counts[0].astype(np.uint64 if many else np.uint32)
    for other in counts[1:]:
        total += other.astype(total.dtype, copy=False)
    return total


def parts_of(
    client: Any, recipe: Recipe, ranges: list[tuple[int, int]], each: int, check: Callable[[], None]
) -> Iterator[tuple[int, int, np.ndarray]]:
    """The counts of each range, as they come: (first, last, counts). Tasks have `each` samples.

    `check` is called now and then, and raises what ends the work early; tasks that are left are
    then given up. Errors: those of the tasks, after `RETRIES`.
    """

    workers = ClusterWorkers(client, len(ranges))
    shared: dict[int, Any] = {}

    def begin(part: tuple[int, int], attempt: int) -> Any:
        digest = f"{recipe.digest}-{attempt}"
        if attempt not in shared:
            shared[attempt] = workers.share(recipe, f"kempe-{digest}-recipe")
        return _tree(client, shared[attempt], digest, *part, each)

    for (first, last), counts in finished(workers, ranges, begin, check):
        yield first, last, counts


def _tree(client: Any, recipe: Any, digest: str, first: int, last: int, each: int) -> Any:
    """The future of the counts of a range: tasks, and sums of `FAN` of them, of their sums, and so
    on.

    `recipe` is the future of the recipe, and `digest` its name: another attempt has other keys,
    since under those of before the scheduler knows tasks as failed.
    """
    many = last - first >= 2**32
    starts = range(first, last, each)
    ends = [min(at + each, last) for at in starts]
    keys = [f"kempe-{digest}-{at}-{end}" for at, end in zip(starts, ends, strict=True)]
    level = client.map(counted, [recipe] * len(keys), list(starts), ends, key=keys, retries=RETRIES)
    height = 0
    while len(level) > 1:
        height += 1
        level = [
            client.submit(
                added,
                many,
                *level[k : k + FAN],
                key=f"kempe-{digest}-{first}-{last}-sum-{height}-{k}",
                retries=RETRIES,
            )
            for k in range(0, len(level), FAN)
        ]
    return level[0]
