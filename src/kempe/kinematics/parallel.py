"""Work on fixed chunks in a pool of threads: kernels release the GIL, and answers do not depend on the thread count."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

_lock = threading.Lock()
_pools: dict[int, ThreadPoolExecutor] = {}

if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pools.clear)


def processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def over_chunks(work: Callable[[int, int], int], count: int, chunk: int, threads: int | None, serial_below: int) -> int:
    """Sum of ``work(start, stop)`` over fixed chunks of ``range(count)``; one thread below `serial_below` items."""
    n = processors() if threads is None else max(1, int(threads))
    if n == 1 or count < serial_below or count <= chunk:
        return work(0, count) if n == 1 or count < serial_below else _serial(work, count, chunk)
    with _lock:
        pool = _pools.get(n)
        if pool is None:
            pool = _pools[n] = ThreadPoolExecutor(n, thread_name_prefix="kempe")
    futures = [pool.submit(work, i, min(i + chunk, count)) for i in range(0, count, chunk)]
    return sum(f.result() for f in futures)


def _serial(work: Callable[[int, int], int], count: int, chunk: int) -> int:
    return sum(work(i, min(i + chunk, count)) for i in range(0, count, chunk))
