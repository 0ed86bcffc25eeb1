"""The verb `workspace`: any number of samples in fixed memory, in threads or on a cluster, stopped
and gone on with.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.arguments import explained, interruptible, seed_number
from kempe.arrays import is_real
from kempe.budget import Budget, Usual
from kempe.description.source import expanded
from kempe.errors import DamagedError, InputError, shown
from kempe.numerics.clock import BROKEN_OFF, TimeLimit, begun_within
from kempe.workspace.answer import Workspace, of_stored
from kempe.workspace.cell_map import CellMap
from kempe.workspace.kinds import question_of
from kempe.workspace.sampling_job import Recipe, SampleParts, Threads, recipe_of
from kempe.workspace.store import refuse_other, refuse_place, zarr_library
from kempe.workspace.stored_map import FORMAT, Stored, read_map, write_map
from kempe.workspace.workers import Pace, connected

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model

MOST = 2**62
USUAL = Usual("workspace", rng=0, threads=None, time_limit=None, progress=None)
TREES = 16
"""SampleParts into which the work of a cluster is divided: what is done is written down part by
part."""
LARGEST_PART = 2**31


@explained
@interruptible
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
    """The places that a frame reaches, by `n` random samples within all limits and constraints: a
    `Workspace`.

    The `kind` says which places: "reachable", in some orientation (the default);
    "constant-orientation", in one `orientation`; "dexterous", in several, by default 180 angles of
    the plane or 256 rotations in space that are spread evenly; or it is "orientation": the
    orientations in which the frame's origin is reached `at` a place (d,) [m]. Orientations are
    angles in the plane, and rotations (..., 3, 3), or roll, pitch and yaw (3,), in space.

    Samples of a reachable workspace are configurations: coordinates are uniform within their
    limits, angles without limits in a full turn, quaternions uniform. Of a system with loops random
    ones are brought to where all loops are closed, and what violates a declared constraint is left
    out; that is a thousand times slower (n is 1e7, with loops 1e5). Samples of the other kinds, and
    where slides have no limits and a box is given, are random places (or orientations), as many in
    each cell, by default one: the inverse model decides whether they are reached.

    They are counted in `cells` (a number along the longest edge, or one for each axis) of a `box`
    (d, 2) [m]; without one, of the box of the first positions, a tenth wider. Memory does not
    depend on n.

    Samples are a function of the seed (the `rng` of the `budget`, 0) and their number, so the same
    map comes of any number of threads or workers. With a `client`, a `distributed.Client` or the
    address of a scheduler, the workers of a Dask cluster do the work. With a `path`, what is done
    is written beside it as it goes, and the map to it at the end: the same call goes on after any
    interruption, and with a larger `n` adds to a map that is there.

    Of the `budget` are read: rng, threads, time_limit (none), progress(samples, n). The time limit
    returns what was done, Ctrl-C raises it as the `answer` of an `Interrupted`.

    Errors: `InputError` for a frame that does not move, slides without limits
    where no box is given, and what belongs to another map; `KernelsError` for a map of other
    kernels; `DiskError`; `UnknownNameError`; `MissingExtraError` without the extra [scale], for
    `client` and `path`.
    """
    name = system.structure.frame_name(frame)
    spend = USUAL.of(budget)
    clock = TimeLimit(spend.time_limit)
    if n is not None and not (is_real(n) and 1 <= n <= MOST and n == int(n)):
        raise InputError(
            f"n is {shown(n)}; it must be a whole number of samples, from 1 to {MOST:.2g}"
        )
    with begun_within(USUAL, clock):
        question = question_of(system, name, kind, orientation, at)
    if client is not None:
        own = isinstance(client, str)
        client = connected(client)
    else:
        own = False
    try:
        with begun_within(USUAL, clock):
            recipe = recipe_of(system, name, seed_number(spend.rng), cells, box, question)
        store = _Memory(recipe) if path is None else _Disk(recipe, expanded(path))
        return _answer(recipe, store, int(n or recipe.usual), client, spend, clock)
    finally:
        if own and client is not None:
            client.close()


def _answer(
    recipe: Recipe, store: _Memory | _Disk, count: int, client: Any, spend: Budget, clock: TimeLimit
) -> Workspace:
    """The map of the first `count` samples, or of those that were counted until it was broken off."""
    if store.found is not None and store.found.samples >= count:
        return of_stored(recipe.system, store.found, store.found.samples)
    store.begin()
    before = store.samples(count)
    pace = Pace(spend.progress, count)
    each = recipe.part
    broken = None
    try:
        if client is None:
            ranges = store.missing(count, min(max(each, count // 64), LARGEST_PART))
            runs = _local(recipe, ranges, spend, clock, pace, before)
        else:
            from kempe.workspace.sampling_job import parts_of

            runs = parts_of(
                client, recipe, store.missing(count, max(each, count // TREES)), each, clock.check
            )
        for first, last, counts in runs:
            if last > first:
                store.add(first, last, counts)
            pace(store.samples(count), at_once=True)
    except BROKEN_OFF as error:
        broken = error
    stored = store.stored(count)
    interrupted = isinstance(broken, KeyboardInterrupt)
    late = broken is not None and not interrupted
    if broken is None:
        store.finish(stored)
    return of_stored(
        recipe.system, stored, count, interrupted=interrupted, late=late, redone=store.redone
    )


def _local(
    recipe: Recipe,
    ranges: list[tuple[int, int]],
    spend: Budget,
    clock: TimeLimit,
    pace: Pace,
    before: int,
) -> Iterator[tuple[int, int, np.ndarray]]:
    """Counts of ranges, by threads of this process: (first, last, counts), the last one shorter if
    it is broken off.

    Errors: what broke it off, after what was done by then.
    """
    threads = Threads(recipe, spend.threads)
    for first, last in ranges:
        counts, stop, broken = threads.count(
            first, last, clock, lambda k, a=before - first: pace(a + k)
        )
        yield first, stop, counts
        before += stop - first
        if broken is not None:
            raise broken


class _Memory:
    """Counts that are held in memory only."""

    redone = 0
    found = None

    def __init__(self, recipe: Recipe):
        self.recipe = recipe
        self.done = 0
        self.counts = np.zeros(recipe.entries, dtype=np.uint64)

    def begin(self) -> None:
        """Find nothing that was done before."""

    def missing(self, n: int, most: int) -> list[tuple[int, int]]:
        """Ranges of at most `most` samples that make up the first n."""
        return [(first, min(first + most, n)) for first in range(0, n, most)]

    def samples(self, n: int) -> int:
        """How many of the first n samples are counted."""
        return self.done

    def add(self, first: int, last: int, counts: np.ndarray) -> None:
        """Add the counts of a range."""
        self.counts += counts
        self.done += last - first

    def stored(self, n: int) -> Stored:
        """The map of what was added."""
        # `done` may not yet have been added to
        return _stored(self.recipe, self.counts, int(self.counts.sum()))

    def finish(self, stored: Stored) -> None:
        """Keep nothing: the answer has it all."""


class _Disk:
    """Counts in parts beside a path, and the map at the path when all is done."""

    def __init__(self, recipe: Recipe, path: Path):
        zarr_library()
        refuse_place(path, FORMAT)
        self.recipe = recipe
        self.path = path
        self.redone = 0
        self.found: Stored | None = None
        self.parts = SampleParts(path, recipe.said(), recipe.entries)
        if path.exists():
            try:
                self.found = read_map(path)
                refuse_other(self.found.said, recipe.said(), str(path))
            except DamagedError:
                self.redone = 1

    def begin(self) -> None:
        """Find what was done before, in parts and in the map. Errors: `DiskError`, `InputError`."""
        recipe = self.recipe
        self.parts.begin()
        self.redone += self.parts.damaged
        if self.found is not None and not self.parts.done:
            counts = np.zeros(recipe.entries, dtype=np.uint64)
            counts[: recipe.grid.count] = self.found.map.counts.ravel()
            counts[recipe.grid.count : recipe.grid.count + 2] = (
                self.found.outside,
                self.found.left_out,
            )
            self.parts.add_counts(0, self.found.samples, counts)

    def missing(self, n: int, most: int) -> list[tuple[int, int]]:
        """Ranges of at most `most` samples that are left of the first n."""
        return self.parts.missing(n, most, self.recipe.piece)

    def samples(self, n: int) -> int:
        """How many of the first n samples are counted."""
        return self.parts.count(n)

    def add(self, first: int, last: int, counts: np.ndarray) -> None:
        """Write the counts of a range."""
        self.parts.add_counts(first, last, counts)

    def stored(self, n: int) -> Stored:
        """The map of what was written."""
        parts = [p for p in self.parts.done if p.last <= n]
        return _stored(self.recipe, self.parts.total(parts), self.samples(n))

    def finish(self, stored: Stored) -> None:
        """Write the map, and drop the parts."""
        write_map(self.path, self.recipe.system, stored)
        self.parts.clear()


def _stored(recipe: Recipe, counts: np.ndarray, samples: int) -> Stored:
    grid = recipe.grid
    cells = CellMap(grid, counts[: grid.count].reshape(grid.shape))
    outside, left_out = (int(x) for x in counts[grid.count : grid.count + 2])
    return Stored(cells, samples, outside, left_out, recipe.said())
