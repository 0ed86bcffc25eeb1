"""Fixed chunks of work in a pool of threads.

Kernels release the GIL, and answers do not depend on the number of threads.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from kempe.arguments import quiet
from kempe.arrays import is_whole
from kempe.budget import check_for_stop, list_checks, watched_by
from kempe.errors import InputError, format_value

if TYPE_CHECKING:  # it imports what one thread does not need
    from concurrent.futures import ThreadPoolExecutor


_lock = threading.Lock()
_pools: dict[int, ThreadPoolExecutor] = {}


def _reset_pool() -> None:
    """Drop the threads and the lock of the parent process in a child process."""
    global _lock
    _lock = threading.Lock()
    _pools.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_reset_pool)


MOST_THREADS = 4096
"""Threads of one call at most: each takes memory, and more than there are processors bring
nothing."""


def count_processors() -> int:
    """Count the processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def choose_thread_count(threads: Any) -> int:
    """Choose the number of threads for the argument `threads`.

    Errors: `InputError`.
    """
    if threads is not None and not (is_whole(threads) and 1 <= threads <= MOST_THREADS):
        raise InputError(
            f"threads is {format_value(threads)}; it must be None (all processors) or a whole "
            f"number, at least 1 and at most {MOST_THREADS}"
        )
    return int(threads or count_processors())


def sum_over_chunks(
    work: Callable[[int, int], int],
    count: int,
    chunk: int | None,
    threads: int | None,
    serial_below: int,
) -> int:
    """Sum ``work(start, stop)`` over fixed chunks of ``range(count)``, in threads.

    Below `serial_below` items there is one thread.

    With `chunk` None each thread has one piece.

    The calling thread works too. Each thread takes the next chunk when it is done with one, so a
    thread that gets no processor holds nobody up for longer than a chunk. If one fails or is
    interrupted, no further chunk is begun.
    """
    # nobody needs to ask the system
    few = threads is None and chunk is not None and count < serial_below
    most = 1 if few else choose_thread_count(threads)
    if chunk is None:
        chunk = max(serial_below, -(-count // most))
    n = 1 if count < serial_below else min(most, -(-count // chunk))
    if n == 1:
        piece = max(chunk, serial_below)  # between two of them Python sees an interrupt
        total = 0
        for i in range(0, max(count, 1), piece):
            check_for_stop()
            total += work(i, min(i + piece, count))
        return total
    starts = iter(range(0, count, chunk))
    watching = list_checks()

    def work_on_chunk(i: int) -> int:
        check_for_stop()
        return work(i, min(i + chunk, count))

    @quiet
    def take_chunks() -> int:
        try:
            return sum(map(work_on_chunk, starts))
        finally:
            for _ in starts:
                pass

    def take_watched_chunks() -> int:
        with watched_by(*watching):
            return take_chunks()

    from concurrent.futures import ThreadPoolExecutor, wait

    with _lock:
        pool = _pools.get(n)
        if pool is None:
            pool = _pools[n] = ThreadPoolExecutor(n - 1, thread_name_prefix="kempe")
    others = [pool.submit(take_watched_chunks) for _ in range(n - 1)]
    try:
        return take_chunks() + sum(f.result() for f in others)
    finally:
        wait(others)
