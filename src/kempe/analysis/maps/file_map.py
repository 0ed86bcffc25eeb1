"""Verbs over files larger than memory: rows in, answers out as Zarr, gone on with after any
interruption.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kempe.analysis.maps.cluster import ClusterWorkers, connected
from kempe.analysis.maps.part_log import DonePart
from kempe.analysis.maps.row_sources import RowSource, open_rows
from kempe.analysis.maps.row_store import RowStore
from kempe.analysis.maps.row_verbs import VERBS, RowJob, job_of
from kempe.analysis.maps.side_by_side import RETRIES, Pace, ThreadWorkers, finished
from kempe.budget import Budget, Usual
from kempe.calls import brief, explained, explained_methods, flag, interruptible, listed
from kempe.description.source import expanded
from kempe.kinematics.common.parallel import thread_count
from kempe.kinematics.common.result import Cells, Report
from kempe.solvers.common.arguments import seed_number
from kempe.solvers.common.clock import BROKEN_OFF, TimeLimit, partial
from kempe.status import Status
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

USUAL = Usual("map_file", rng=0, threads=None, time_limit=None, progress=None)
CHUNK_BYTES = 2**23
"""Bytes of the rows of a chunk, and of each array of answers to them, at most."""
MANY = 2**16
"""Chunks from which on they are made larger, as far as `CHUNK_BYTES` allows."""


@explained_methods
@dataclass(frozen=True, eq=False)
class FileMap(Report):
    """What a verb answered to the rows of a file, and where that is.

    `rows` of the `requested` ones are done, in chunks of `chunk` rows; `outcomes` says how many of
    them came to which `Status`, by its name. Where the work was `interrupted`, or the time limit
    came (`late`), the same call goes on.
    """

    __repr__ = brief

    system: System
    verb: str
    source: Path
    path: Path
    rows: int
    requested: int
    chunk: int
    outcomes: dict[str, int]
    interrupted: bool = False
    late: bool = False
    redone: int = 0
    """Damaged chunks that were found on disk, and made again."""

    @property
    def code(self) -> Status:  # type: ignore[override]
        """`SOLVED` where all rows are, `PARTLY` where some are not; `INTERRUPTED` or `OUT_OF_TIME`
        if rows are left.
        """
        if self.interrupted or self.late:
            return Status.INTERRUPTED if self.interrupted else Status.OUT_OF_TIME
        return Status.SOLVED if set(self.outcomes) <= {Status.SOLVED.name} else Status.PARTLY

    @property
    def status(self) -> str:
        """How many rows are done, and what became of them."""
        of = f"{self.rows} of {counted(self.requested, 'row')}"
        found = ", ".join(f"{n} {name}" for name, n in self.outcomes.items())
        return (
            f"{self.verb} of {of} of {self.source.name}: "
            f"{found or 'nothing'}{partial(self.interrupted, self.late)}"
        )

    def _cells(self) -> Cells:
        rows = [("answers", str(self.path)), ("chunks", f"{counted(self.chunk, 'row')} each")]
        return (), rows + [
            ("redone", f"{counted(self.redone, 'chunk')} that was damaged on disk")
        ] * bool(self.redone)

    def _data(self) -> dict[str, Any]:
        names = ("verb", "rows", "requested", "chunk", "outcomes", "redone")
        return {"system": self.system.name, "source": str(self.source), "path": str(self.path)} | {
            name: getattr(self, name) for name in names
        }


@explained
@interruptible
def map_file(
    system: System,
    verb: str,
    source: str | Path,
    path: str | Path,
    frame: FrameLike | None = None,
    *,
    columns: Iterable[str] | None = None,
    options: Mapping[str, Any] | None = None,
    degrees: bool = False,
    client: Any = None,
    budget: Budget | None = None,
) -> FileMap:
    """A `FileMap`: what a verb answers to each row of a file of any size, written to a path as
    Zarr.

    `verb` is "fk", "ik", "ik_all" or "assemble"; `source` a .parquet, .npy or .csv file, a folder
    of .parquet files, or Zarr: an array, or a group whose arrays of one axis are columns. Rows are
    configurations for "fk": all coordinates in the order of `q`, or columns that have their names
    (those that are missing are neutral). For "ik" and "ik_all" they are targets of a `frame`: x, y,
    z, with roll, pitch, yaw or with qw, qx, qy, qz, in the plane also x, y and x, y, angle, or
    poses (n, 4, 4) and (n, 3, 4). For "assemble" they are known coordinates. In radians and metres,
    or angles in `degrees`. `columns` are those that count, or the names of columns that have none.
    `options` are those of the verb: form, dtype; task, start, method, tolerance, limits, fixed;
    branch, prefer.

    At `path` then are arrays with a row for each row, which xarray opens: the answer, `code`
    (`Status`), errors, and what made them. A row that is no number gives NaN and the code
    BAD_INPUT. Chunks have 65 536 rows ("ik" 16 384, others 4096), and at most 8 MB of rows and 8 MB
    of answers; of these the memory holds two a thread. A block of the file (a row group of Parquet,
    a chunk of Zarr) is held besides, 1 GB at most.

    What is done is written beside the path chunk by chunk, with checksums: after any interruption
    the same call goes on, and makes damaged chunks again. Answers do not depend on threads or
    workers: with a `client`, a `distributed.Client` or the address of a scheduler, those of a Dask
    cluster answer. Of the `budget` are read: rng (0), threads, time_limit (none), progress(rows,
    n).

    Errors: `InputError` and `UnknownNameError` for what the file is not, and for what is at the
    path; those of the verb for its options; `DiskError`; `DamagedError` for a source that cannot be
    read; `MissingExtraError` without the extra [scale].
    """
    spend = USUAL.of(budget)
    own = isinstance(client, str)
    clock = TimeLimit(spend.time_limit)
    threads = thread_count(spend.threads)
    rows = open_rows(source, None if columns is None else listed(columns, "columns"))
    job = job_of(
        system, verb, frame, options, rows, flag(degrees, "degrees"), seed_number(spend.rng)
    )
    store = RowStore(expanded(path), job, rows, _chunk(job, rows))
    client = None if client is None else connected(client)
    broken = None
    try:
        _fill(store, client, threads, spend, clock)
    except BROKEN_OFF as error:
        broken = error
    finally:
        if own and client is not None:
            client.close()
    interrupted = isinstance(broken, KeyboardInterrupt)
    return FileMap(
        system,
        verb,
        rows.path,
        store.path,
        store.count(rows.n),
        rows.n,
        store.chunk,
        store.outcomes(),
        interrupted,
        broken is not None and not interrupted,
        store.damaged,
    )


def _chunk(job: RowJob, rows: RowSource) -> int:
    """Rows of a chunk: what a verb takes at once, more where there are very many, as the memory
    allows.
    """
    most = 1 << max(0, (CHUNK_BYTES // max(rows.row_bytes, *job.row_bytes)).bit_length() - 1)
    wanted = max(VERBS[job.verb].rows, 1 << (rows.n // MANY).bit_length())
    return max(1, min(wanted, most, rows.n))


def _fill(store: RowStore, client: Any, threads: int, spend: Budget, clock: TimeLimit) -> None:
    """Answer all rows that are not answered. Errors: those of tasks, and what broke it off."""
    n = store.source.n
    pace = Pace(spend.progress, store.source.n)

    def checked(done: int) -> None:
        pace(done)
        clock.check()

    store.checked = checked
    store.begin()
    if store.whole:
        return
    done = store.count(n)
    tasks = store.missing(n, store.chunk, store.chunk)
    for part in (
        _local(store, tasks, threads, clock)
        if client is None
        else _far(store, tasks, client, clock)
    ):
        store.add(part)
        done += part.last - part.first
        pace(done, at_once=done == n)
    store.finish()


def _local(
    store: RowStore, tasks: list[tuple[int, int]], threads: int, clock: TimeLimit
) -> Iterator[DonePart]:
    """The parts that threads of this process make of ranges of rows."""
    with ThreadWorkers(threads, spare=1, stops=True) as workers:

        def work(first: int, last: int, rows: Any) -> DonePart:
            return store.made(first, last, rows, store.answers(first, rows))

        def begin(task: tuple[int, int], _: int) -> Any:
            return workers.submit(work, *task, store.source.read(*task))

        for _, part in finished(workers, tasks, begin, clock.check):
            yield part


def _far(
    store: RowStore, tasks: list[tuple[int, int]], client: Any, clock: TimeLimit
) -> Iterator[DonePart]:
    """The parts of which the workers of a cluster give the answers: rows go there, and answers come
    back.
    """
    sent: dict[int, Any] = {}
    workers = ClusterWorkers(client)
    jobs: dict[int, Any] = {}

    def begin(task: tuple[int, int], attempt: int) -> Any:
        if attempt not in jobs:
            jobs[attempt] = workers.share(store.job)
        rows = sent[task[0]] = store.source.read(*task)
        return client.submit(RowJob.answers, jobs[attempt], rows, retries=RETRIES, pure=False)

    for (first, last), answers in finished(workers, tasks, begin, clock.check):
        yield store.made(first, last, sent.pop(first), answers)
