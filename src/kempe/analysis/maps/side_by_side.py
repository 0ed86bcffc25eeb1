"""Tasks done side by side, a few at a time, in threads or by a cluster; stopped without loss, with
the time left.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any, Protocol, TypeVar

from kempe.calls import quiet
from kempe.kinematics.common.parallel import Stopped, stopped_by
from kempe.solvers.common.clock import BROKEN_OFF

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
        return wait(futures, timeout=WAKE, return_when=FIRST_COMPLETED).done

    def lost(self, future: Any) -> bool:
        """Threads do not end."""
        return False

    def give_up(self, futures: list[Future[Any]]) -> None:
        """Let those end that are begun."""
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
