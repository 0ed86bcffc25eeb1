"""The verb `workspace`: any number of samples in fixed memory, in threads or on a cluster.

The work can be stopped and continued.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.arguments import draw_seed, explain_errors, raise_interrupted
from kempe.arrays import is_real
from kempe.budget import Budget, Usual
from kempe.description.source import expand_path
from kempe.errors import DamagedError, InputError, format_value
from kempe.numerics.clock import BROKEN_OFF, TimeLimit, limit_preparation_time
from kempe.numerics.pool import choose_thread_count
from kempe.workspace.answer import Workspace
from kempe.workspace.kinds import read_workspace_kind
from kempe.workspace.sampling_job import Recipe, count_in_threads, count_part, make_recipe
from kempe.workspace.store import (
    import_zarr,
    refuse_other_map,
    refuse_place,
    refuse_small_disk,
    restore_former_map,
)
from kempe.workspace.stored_map import FORMAT, SampleCounts, make_empty_counts, read_map, write_map
from kempe.workspace.workers import Pace, connect_client, count_threads, iterate_results

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model

MOST = 2**62
USUAL = Usual("workspace", rng=0, threads=None, time_limit=None, progress=None)
PARTS = 64
"""Parts into which samples are divided, at least; on a cluster some for each thread, too."""
PARTS_A_THREAD = 4
LARGEST_PART = 2**31
"""Samples of a part, at most."""
SPARE = 10.0
"""For how many times as long as a map is written samples are drawn before it is written again."""


@explain_errors
@raise_interrupted
def workspace(
    system: Model,
    frame: FrameLike,
    *,
    kind: str | None = None,
    orientation: Any = None,
    at: ArrayLike | None = None,
    n: float | None = None,
    cells: Any = None,
    box: Any = None,
    client: Any = None,
    path: str | Path | None = None,
    budget: Budget | None = None,
) -> Workspace:
    """Sample the workspace of a frame as a map; see `System.workspace`."""
    name = system.structure.frame_name(frame)
    spend = USUAL.complete_budget(budget)
    clock = TimeLimit(spend.time_limit)
    if n is not None and not (is_real(n) and 1 <= n <= MOST and n == int(n)):
        raise InputError(
            f"n is {format_value(n)}; it must be a whole number of samples, from 1 to {MOST:.2g}"
        )
    with limit_preparation_time(USUAL, clock):
        workspace_kind = read_workspace_kind(system, name, kind, orientation, at)
    if client is not None:
        own = isinstance(client, str)
        client = connect_client(client)
    else:
        own = False
    try:
        with limit_preparation_time(USUAL, clock):
            recipe = make_recipe(system, name, draw_seed(spend.rng), cells, box, workspace_kind)
        return _answer_workspace(
            recipe,
            None if path is None else expand_path(path),
            int(n or recipe.default_sample_count),
            client,
            spend,
            clock,
        )
    finally:
        if own and client is not None:
            client.close()


def _answer_workspace(
    recipe: Recipe, path: Path | None, count: int, client: Any, spend: Budget, clock: TimeLimit
) -> Workspace:
    """Compute the map of the first `count` samples, or of those counted before it was broken off."""
    samples = make_empty_counts(recipe.describe_recipe(), recipe.grid)
    redone = 0
    if path is not None:
        samples, redone = _read_samples(path, samples)
        if samples.samples >= count:
            return Workspace(recipe.system, samples, samples.samples)
        refuse_small_disk(path.parent, 2 * samples.counts.nbytes)
    written = samples
    due = -np.inf
    pace = Pace(spend.progress, count, clock)
    broken = None
    try:
        for first, last, counts in _iterate_part_counts(
            recipe, samples, count, client, spend.threads, pace
        ):
            samples = samples.add_counts(first, last, counts)
            if path is not None and time.monotonic() >= due:
                due = _write_samples(path, recipe, samples)
                written = samples
            pace(samples.samples, at_once=True)
    except BROKEN_OFF as error:
        broken = error
    if path is not None and written is not samples:
        write_map(path, recipe.system, samples)
    interrupted = isinstance(broken, KeyboardInterrupt)
    late = broken is not None and not interrupted and samples.samples < count
    return Workspace(
        recipe.system, samples, count, interrupted=interrupted, late=late, redone=redone
    )


def _read_samples(path: Path, none: SampleCounts) -> tuple[SampleCounts, int]:
    """Read the samples counted at a path, else `none`. Also return 1 if the contents are damaged.

    Errors: `InputError` where it is another map, or something else; `MissingExtraError`.
    """
    import_zarr()
    restore_former_map(path)
    refuse_place(path, FORMAT)
    if not path.exists():
        return none, 0
    try:
        samples, _ = read_map(path)
    except DamagedError:
        return none, 1
    refuse_other_map(samples.metadata, none.metadata, str(path))
    return samples, 0


def _write_samples(path: Path, recipe: Recipe, samples: SampleCounts) -> float:
    """Write the map, and return when it should be written again, by the clock. Errors: `DiskError`."""
    begun = time.monotonic()
    write_map(path, recipe.system, samples)
    end = time.monotonic()
    return end + SPARE * (end - begun)


def _iterate_part_counts(
    recipe: Recipe, samples: SampleCounts, count: int, client: Any, threads: Any, pace: Pace
) -> Iterator[tuple[int, int, np.ndarray]]:
    """Yield counts of the missing samples among the first `count`, as (first, last, counts).

    By threads of this process the last part is shorter where the work is broken off. Errors: what
    broke it off, after what was done by then.
    """
    parts = PARTS if client is None else max(PARTS, PARTS_A_THREAD * count_threads(client))
    most = min(max(recipe.part_size, count // parts), LARGEST_PART)
    ranges = samples.list_missing_ranges(
        count, max(most // recipe.piece_size, 1) * recipe.piece_size
    )
    if client is not None:
        arguments = ((part, part) for part in ranges)
        for part, counts in iterate_results(
            client, count_part, recipe, arguments, pace.clock.check_time
        ):
            yield *part, counts
        return
    n = choose_thread_count(threads)
    before = samples.samples
    for first, last in ranges:
        counts, stop, broken = count_in_threads(
            recipe, first, last, n, lambda done, before=before: pace(before + done)
        )
        yield first, stop, counts
        before += stop - first
        if broken is not None:
            raise broken
