"""Parallel work in threads or on a cluster, which can be stopped without loss."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from kempe.arguments import quiet
from kempe.arrays import is_whole
from kempe.budget import checks, look, watched_by
from kempe.errors import InputError, shown
from kempe.numerics.clock import BROKEN_OFF

if TYPE_CHECKING:  # it imports what one thread does not need
    from concurrent.futures import Future, ThreadPoolExecutor


# ---- fixed chunks in a pool of threads

# Kernels release the GIL, and answers do not depend on the thread count.

_lock = threading.Lock()
_pools: dict[int, ThreadPoolExecutor] = {}


class Stopped(Exception):
    """The work of a thread was told to stop: raised inside it by `look`, and caught by whoever
    began it.
    """


def stopped_by(sign: threading.Event, work: Callable[..., Any]) -> Callable[..., Any]:
    """The function, which ends with `Stopped` at the next `look` of its thread once the sign is
    set.
    """

    def check() -> None:
        if sign.is_set():
            raise Stopped

    def call(*args: Any) -> Any:
        with watched_by(check):
            look()
            return work(*args)

    return call


def _begin_anew() -> None:
    """Drop, in a child process, the threads of its parent and the lock that one of them may have
    held.
    """
    global _lock
    _lock = threading.Lock()
    _pools.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_begin_anew)


MOST_THREADS = 4096
"""Threads of one call at most: each takes memory, and more than there are processors bring
nothing."""


def processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_count(threads: Any) -> int:
    """How many threads are wanted. Errors: `InputError`."""
    if threads is not None and not (is_whole(threads) and 1 <= threads <= MOST_THREADS):
        raise InputError(
            f"threads is {shown(threads)}; it must be None (all processors) or a whole number, at "
            f"least 1 and at most {MOST_THREADS}"
        )
    return int(threads or processors())


def over_chunks(
    work: Callable[[int, int], int],
    count: int,
    chunk: int | None,
    threads: int | None,
    serial_below: int,
) -> int:
    """Sum of ``work(start, stop)`` over fixed chunks of ``range(count)``; one thread below
    `serial_below` items.

    With `chunk` None each thread has one piece.

    The calling thread works too. Each thread takes the next chunk when it is done with one, so a
    thread that gets no processor holds nobody up for longer than a chunk. If one fails or is
    interrupted, no further chunk is begun.
    """
    # nobody needs to ask the system
    few = threads is None and chunk is not None and count < serial_below
    most = 1 if few else thread_count(threads)
    if chunk is None:
        chunk = max(serial_below, -(-count // most))
    n = 1 if count < serial_below else min(most, -(-count // chunk))
    if n == 1:
        piece = max(chunk, serial_below)  # between two of them Python sees an interrupt
        total = 0
        for i in range(0, max(count, 1), piece):
            look()
            total += work(i, min(i + piece, count))
        return total
    starts = iter(range(0, count, chunk))
    watching = checks()

    def take(i: int) -> int:
        look()
        return work(i, min(i + chunk, count))

    @quiet
    def take_chunks() -> int:
        try:
            return sum(map(take, starts))
        finally:
            for _ in starts:
                pass

    def take_watched() -> int:
        with watched_by(*watching):
            return take_chunks()

    from concurrent.futures import ThreadPoolExecutor, wait

    with _lock:
        pool = _pools.get(n)
        if pool is None:
            pool = _pools[n] = ThreadPoolExecutor(n - 1, thread_name_prefix="kempe")
    others = [pool.submit(take_watched) for _ in range(n - 1)]
    try:
        return take_chunks() + sum(f.result() for f in others)
    finally:
        wait(others)


# ---- tasks done a few at a time, in threads or by a cluster

Task = TypeVar("Task")
WAKE = 0.2
"""Seconds between two looks at the clock."""
RETRIES = 5
"""How often a task is given to other workers, where its own have ended."""


class Pace:
    """Says how far the work is: calls `progress(done, total)` now and then."""

    def __init__(self, progress: Callable[..., Any] | None, total: int):
        self.progress = progress
        self.total = total
        self.said = time.monotonic()

    def __call__(self, done: int, at_once: bool = False) -> None:
        """Say that so many are done, if it is time, or at once."""
        now = time.monotonic()
        if self.progress is None or (now - self.said < WAKE and not at_once):
            return
        self.said = now
        self.progress(done, self.total)


class Workers(Protocol):
    """Who does tasks: at most `most` at once; what is begun is finished where `finishes` says so,
    else given up.
    """

    most: int
    finishes: bool

    def wait(self, futures: list[Any]) -> set[Any]:
        """Those that are done, after a while perhaps none."""
        ...

    def lost(self, future: Any) -> bool:
        """Whether a task ended since its worker did."""
        ...

    def give_up(self, futures: list[Any]) -> None:
        """Drop these, or wait for them."""
        ...

    def stop(self) -> None:
        """Tell what is begun to stop, where it may."""
        ...


class ThreadWorkers:
    """Threads of this process; `spare` tasks wait for the next that is free.

    What is begun is finished; with `stops` it is left where it takes long, to be begun again
    another time.
    """

    finishes = True

    def __init__(self, threads: int, spare: int = 0, stops: bool = False):
        from concurrent.futures import ThreadPoolExecutor

        self.most = threads + spare
        self.pool = ThreadPoolExecutor(threads, thread_name_prefix="kempe")
        self.stops = stops
        self.sign = threading.Event()

    def submit(self, work: Callable[..., Any], *args: Any) -> Future[Any]:
        """The future of a call."""
        return self.pool.submit(quiet(stopped_by(self.sign, work) if self.stops else work), *args)

    def stop(self) -> None:
        """Tell what is begun to stop, where it may."""
        self.sign.set()

    def __enter__(self) -> ThreadWorkers:
        return self

    def __exit__(self, *error: object) -> None:
        self.pool.shutdown()

    def wait(self, futures: list[Any]) -> set[Any]:
        """Those that are done."""
        from concurrent.futures import FIRST_COMPLETED, wait

        return wait(futures, timeout=WAKE, return_when=FIRST_COMPLETED).done

    def lost(self, future: Any) -> bool:
        """Threads do not end."""
        return False

    def give_up(self, futures: list[Future[Any]]) -> None:
        """Let those end that are begun."""
        from concurrent.futures import wait

        wait(futures)


def finished(
    workers: Workers,
    tasks: Iterable[Task],
    begin: Callable[[Task, int], Any],
    check: Callable[[], None],
) -> Iterator[tuple[Task, Any]]:
    """Each task and its result, as they come; `begin` gives the future of a task and the number of
    the attempt.

    `check` is called now and then, and raises what ends the work early: what workers finish comes
    before that is raised. Errors: those of the tasks, for which the others are given up.
    """
    todo = iter(tasks)
    running: dict[Any, tuple[Task, int]] = {}
    try:
        while True:
            while len(running) < workers.most and (task := next(todo, None)) is not None:
                running[begin(task, 0)] = task, 0
            if not running:
                return
            for future in workers.wait(list(running)):
                task, attempt = running.pop(future)
                if attempt < RETRIES and workers.lost(future):
                    running[begin(task, attempt + 1)] = task, attempt + 1
                else:
                    yield task, future.result()
            check()
    except BROKEN_OFF:
        workers.stop()
        while workers.finishes and running:
            future, (task, _) = running.popitem()
            try:
                result = future.result()
            except Stopped:
                continue
            yield task, result
        raise
    finally:
        workers.give_up(list(running))
