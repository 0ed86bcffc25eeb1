"""Work in parts, by threads of this process or by the workers of a Dask cluster.

The caller can be interrupted at any time. Workers of a cluster may end, come late, and do a part
twice.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from kempe.arguments import quiet
from kempe.budget import watched_by
from kempe.errors import InputError, KernelsError, MissingExtraError, format_value, warn
from kempe.kernels.compiled import VARIANT
from kempe.numerics.clock import BROKEN_OFF, TimeLimit
from kempe.version import __version__
from kempe.words import format_count

WAKE = 0.2
"""Seconds between two looks at the clock."""


class Pace:
    """Reporter that calls `progress(done, total)` at intervals, and raises `TimeUp` when time is
    up.
    """

    def __init__(self, progress: Callable[..., Any] | None, total: int, clock: TimeLimit):
        self.progress = progress
        self.total = total
        self.clock = clock
        self.reported = time.monotonic()

    def __call__(self, done: int, at_once: bool = False) -> None:
        """Report the number of items done, if the interval has passed, or at once."""
        now = time.monotonic()
        if self.progress is not None and (at_once or now - self.reported >= WAKE):
            self.reported = now
            self.progress(done, self.total)
        self.clock.check_time()


# ---- threads

Item = TypeVar("Item")
END: Any = object()


class Stopped(Exception):
    """Raised by `check_for_stop` in a thread that must leave its work."""


def work_in_threads(
    items: Iterable[Item],
    work: Callable[[int, Item], object],
    threads: int,
    check: Callable[[int], None],
    stops: bool = False,
) -> tuple[int, BaseException | None]:
    """Work on items in threads, and return how many are done. Also return the interrupt or `TimeUp`
    that ended the work early.

    Threads take the items in their order, one at a time, and call `work(number of the thread,
    item)`. This thread calls `check(number of items done)` now and then, which may raise what ends
    the work. Items that are begun by then are finished; with `stops` the next `check_for_stop` in
    them raises `Stopped`. Errors: the first one that an item raised.
    """
    from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait

    todo = iter(items)
    over = threading.Event()
    state = threading.Condition()
    done = 0
    active = 0

    def check_stop() -> None:
        """Raise `Stopped` if the work is over."""
        if over.is_set():
            raise Stopped

    def take_item() -> Any:
        """Take the next item, or `END`."""
        with state:
            return END if over.is_set() else next(todo, END)

    def run_thread(number: int) -> None:
        """Work on items in one thread until there are no more."""
        nonlocal done, active
        with state:
            active += 1
        try:
            with watched_by(*[check_stop] * stops):
                while (item := take_item()) is not END:
                    work(number, item)
                    with state:
                        done += 1
        except Stopped:
            pass
        finally:
            with state:
                active -= 1
                state.notify()

    broken = None
    with ThreadPoolExecutor(threads, thread_name_prefix="kempe") as pool:
        try:
            check(done)  # where no time is left, no thread begins
            futures = [pool.submit(quiet(run_thread), number) for number in range(threads)]
            running = futures
            while running:
                ended, running = wait(futures, WAKE, FIRST_EXCEPTION)
                for future in ended:
                    future.result()
                check(done)
        except BROKEN_OFF as error:
            broken = error
        finally:
            over.set()
            # an interrupt may come where a thread is begun: then the pool does not know it
            with state:
                state.wait_for(lambda: not active)
    return done, broken


# ---- a cluster

LOOK = 0.5
"""Seconds between two looks at the clock."""
PATIENCE = 10.0
"""Seconds in which a scheduler must answer."""
RETRIES = 5
"""How often a part is given to other workers, where its own have ended."""
SHOWN = 5
"""Workers that a message names, at most."""
SUCH = "such as 'tcp://127.0.0.1:8786'"


def connect_client(client: Any) -> Any:
    """Return the client, or make one for the address of a scheduler. Errors: `InputError` if nobody
    answers there.
    """
    try:
        from distributed import Client
    except ImportError:
        raise MissingExtraError("distributed", "scale") from None
    if isinstance(client, str):
        refuse_address(client)
        return Client(client, timeout=PATIENCE, set_as_default=False)
    if not isinstance(client, Client):
        raise InputError(
            f"client is {format_value(client)}; it must be a distributed.Client, or the address of "
            "a scheduler"
        )
    if client.status != "running":
        raise InputError(f"the client is {client.status}: it has no scheduler")
    return client


def refuse_address(address: str) -> None:
    """Refuse an address at which no scheduler answers, before a client is made. The client would
    wait for half a minute at the end of the process. Errors: `InputError`.
    """
    import asyncio
    from concurrent.futures import ThreadPoolExecutor

    import distributed
    import distributed.comm.core

    library: Any = distributed

    async def try_connection() -> None:
        options = library.Security().get_connection_args("client")
        comm = await library.comm.core.connect(address, timeout=PATIENCE, **options)
        await comm.close()

    try:
        with ThreadPoolExecutor(1) as pool:  # notebooks have a running loop in this thread
            pool.submit(asyncio.run, try_connection()).result()
    except (OSError, ValueError, TypeError, RuntimeError, ImportError, MemoryError) as error:
        raise InputError(
            f"no scheduler answers at {format_value(address)}: {error}; give an address {SUCH}"
        ) from None


def iterate_results(
    client: Any,
    function: Callable[..., Any],
    job: Any,
    parts: Iterable[tuple[Any, tuple[Any, ...]]],
    check: Callable[[], None],
) -> Iterator[tuple[Any, Any]]:
    """Yield (name, result) of each part (name, arguments), as workers finish. The result is
    `function(job, *arguments)`.

    Two parts a thread of the cluster are under way at once. `check` is called now and then, and
    raises what ends the work early: parts that are under way are then given up. Errors: those of
    the function, after `RETRIES`; `KernelsError`.
    """
    import distributed

    library: Any = distributed
    refuse_workers(client)
    todo = iter(parts)
    shared: list[Any] = []
    running: dict[Any, tuple[Any, tuple[Any, ...], int]] = {}

    def submit_part(name: Any, arguments: tuple[Any, ...], attempt: int) -> None:
        # the job travels once; where its workers ended too often, it is lost, and sent again
        """Submit a part to the workers."""
        if attempt == len(shared):
            shared.append(client.submit(_return_argument, job, pure=False, retries=RETRIES))
        future = client.submit(function, shared[attempt], *arguments, pure=False, retries=RETRIES)
        running[future] = name, arguments, attempt

    def wait_for_some() -> Iterable[Any]:
        """Wait a short time for finished parts, and return them."""
        try:
            with client.as_current():  # `wait` asks the current client, not that of its futures
                return library.wait(list(running), timeout=LOOK, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            return ()

    try:
        while True:
            check()
            most = max(2, 2 * count_threads(client))
            while len(running) < most and (part := next(todo, None)) is not None:
                submit_part(*part, 0)
            if not running:
                return
            for future in wait_for_some():
                name, arguments, attempt = running.pop(future)
                if attempt < RETRIES and isinstance(future.exception(), library.KilledWorker):
                    submit_part(name, arguments, attempt + 1)
                else:
                    yield name, future.result()
    finally:
        client.cancel(list(running))


def _return_argument(thing: Any) -> Any:
    """Return the argument."""
    return thing


def count_threads(client: Any) -> int:
    """Count the threads of all workers of a cluster."""
    return sum(client.nthreads().values())


def make_probe() -> Callable[[], tuple[str, str]]:
    """Make a function that is sent to workers as code, since they may lack Kempe."""

    def describe_kernels() -> tuple[str, str]:
        """Return the variant of the kernels and the version of Kempe."""
        from kempe.kernels.compiled import VARIANT
        from kempe.version import __version__

        return VARIANT, __version__

    return describe_kernels


def refuse_workers(client: Any) -> None:
    """Refuse a cluster with a worker without Kempe or with another version; warn if there is no
    worker. Errors: `KernelsError`.
    """
    answers = client.run(make_probe(), on_error="return")
    if not answers:
        warn(
            f"the scheduler {client.scheduler.address} has no workers; the work begins when one "
            "joins",
            UserWarning,
        )
    wrong: list[str] = []
    for worker, answer in sorted(answers.items()):
        if isinstance(answer, OSError):  # it has ended in the meantime
            continue
        if isinstance(answer, BaseException):
            wrong.append(f"worker {worker} cannot import Kempe: {type(answer).__name__}: {answer}")
        elif tuple(answer) != (VARIANT, __version__):
            wrong.append(f"worker {worker} has Kempe {answer[1]} with the kernels {answer[0]!r}")
    if wrong:
        more = [f"and {format_count(len(wrong) - SHOWN, 'other worker')}"] * (len(wrong) > SHOWN)
        raise KernelsError(
            f"{'; '.join([*wrong[:SHOWN], *more])}. Each worker needs Kempe {__version__} with the "
            f"extra [scale] and the kernels {VARIANT!r} (KEMPE_KERNELS={VARIANT})"
        )


def refuse_kernels(variant: str, version: str) -> None:
    """Refuse to work with kernels that round differently. Errors: `KernelsError`."""
    if (variant, version) != (VARIANT, __version__):
        raise KernelsError(
            f"the map is made by the kernels {variant!r} of Kempe {version}, and here run "
            f"{VARIANT!r} of {__version__}, which round otherwise: set KEMPE_KERNELS={variant} and "
            "install that version, or make the map anew"
        )
