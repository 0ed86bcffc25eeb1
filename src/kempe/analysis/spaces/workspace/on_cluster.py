"""Ranges of samples counted by the workers of a Dask cluster, and added up there in a tree.

Each task is a pure function of the recipe and its range: it can be done twice, or anywhere, and a worker that is lost
costs its tasks only. Nothing is added into storage; counts come here once a part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from kempe.analysis.spaces.workspace.recipe import Recipe, counted
from kempe.errors import InputError, MissingExtraError, shown

FAN = 8
"""Counts that one task adds up."""
RETRIES = 5
"""How often a task that failed is done again."""
LOOK = 0.5
"""Seconds between two looks at the clock."""
PATIENCE = 10.0
"""Seconds in which a scheduler must answer."""


def connected(client: Any) -> Any:
    """The client, or a new one for the address of a scheduler. Errors: `InputError` where nobody answers there."""
    try:
        from distributed import Client
    except ImportError:
        raise MissingExtraError("distributed", "scale") from None
    if isinstance(client, str):
        try:
            return Client(client, timeout=PATIENCE, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise InputError(f"no scheduler answers at {client!r} within {PATIENCE:g} s: {error}") from None
    if not isinstance(client, Client):
        raise InputError(f"client is {shown(client)}; it must be a distributed.Client, or the address of a scheduler")
    if client.status != "running":
        raise InputError(f"the client is {client.status}: it has no scheduler")
    return client


def added(many: bool, *counts: np.ndarray) -> np.ndarray:
    """The sum of counts, of 64 bits where there are `many` samples."""
    total = counts[0].astype(np.uint64 if many else np.uint32)
    for other in counts[1:]:
        total += other.astype(total.dtype, copy=False)
    return total


def parts_of(
    client: Any, recipe: Recipe, ranges: list[tuple[int, int]], each: int, check: Callable[[], None]
) -> Iterator[tuple[int, int, np.ndarray]]:  # fmt: skip
    """The counts of each range, as they come: (first, last, counts). Tasks have `each` samples.

    `check` is called now and then, and raises what ends the work early; tasks that are left are then given up.
    Errors: those of the tasks, after `RETRIES`.
    """
    import distributed

    tasks: Any = distributed

    waiting = {_tree(client, recipe, first, last, each, 0): (first, last, 0) for first, last in ranges}
    try:
        while waiting:
            try:
                done: set[Any] = tasks.wait(list(waiting), timeout=LOOK, return_when="FIRST_COMPLETED").done
            except TimeoutError:
                done = set()
            for future in done:
                first, last, attempt = waiting.pop(future)
                if isinstance(future.exception(), tasks.KilledWorker) and attempt < RETRIES:  # workers ended, not it
                    again = _tree(client, recipe, first, last, each, attempt + 1)
                    waiting[again] = (first, last, attempt + 1)
                    continue
                yield first, last, future.result()
            check()
    finally:
        client.cancel(list(waiting))


def _tree(client: Any, recipe: Recipe, first: int, last: int, each: int, attempt: int) -> Any:
    """The future of the counts of a range: tasks, and sums of `FAN` of them, of their sums, and so on.

    Another `attempt` has other keys: under those of before the scheduler knows tasks as failed.
    """
    digest, many = f"{recipe.digest}-{attempt}", last - first >= 2**32
    starts = range(first, last, each)
    ends = [min(at + each, last) for at in starts]
    keys = [f"kempe-{digest}-{at}-{end}" for at, end in zip(starts, ends, strict=True)]
    level = client.map(counted, [recipe] * len(keys), list(starts), ends, key=keys, retries=RETRIES)
    height = 0
    while len(level) > 1:
        height += 1
        level = [
            client.submit(added, many, *level[k : k + FAN], key=f"kempe-{digest}-{first}-{last}-sum-{height}-{k}",
                          retries=RETRIES)
            for k in range(0, len(level), FAN)
        ]  # fmt: skip
    return level[0]
