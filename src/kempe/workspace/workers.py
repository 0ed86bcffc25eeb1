"""Workers that do the tasks of a job a few at a time: threads, or those of a Dask cluster.

A job can be stopped without loss. Workers of a cluster may end, come late, and do a task twice.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from math import inf
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from kempe.arguments import quiet
from kempe.budget import look, watched_by
from kempe.errors import InputError, KernelsError, MissingExtraError, shown, warn
from kempe.kernels.compiled import VARIANT
from kempe.numerics.clock import BROKEN_OFF
from kempe.version import __version__
from kempe.words import counted

if TYPE_CHECKING:
    from concurrent.futures import Future


# ---- tasks of a job

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


# ---- threads


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


# ---- a cluster

LOOK = 0.5
"""Seconds between two looks at the clock."""
HOSTS = ("tcp", "tls")
"""Ways to a scheduler that name a host and a port."""
SECURED = ("tls", "wss")
"""Ways to a scheduler that are encrypted, with certificates of both sides."""
PATIENCE = 10.0
"""Seconds in which a scheduler must answer, and after which a cluster without workers is
mentioned."""

SHOWN = 5
"""Workers that a message names, at most."""


def connected(client: Any) -> Any:
    """The client, or a new one for the address of a scheduler. Errors: `InputError` where nobody
    answers there.
    """
    try:
        from distributed import Client, Security
        from distributed.comm.addressing import parse_address, parse_host_port
        from distributed.comm.registry import get_backend
    except ImportError:
        raise MissingExtraError("distributed", "scale") from None
    if isinstance(client, str):
        such = "give one such as 'tcp://127.0.0.1:8786'"
        try:
            scheme, place = parse_address(client)
            # a client for what is no address waits long until it goes
            backend = get_backend(scheme)
            if scheme in HOSTS:
                parse_host_port(place)
        except ValueError as error:
            raise InputError(
                f"{shown(client)} is no address of a scheduler ({error}); {such}"
            ) from None
        try:
            backend.get_connector()
        except (
            TypeError,
            RuntimeError,
            ImportError,
        ) as error:  # it is not installed, or not completely
            raise InputError(
                f"{shown(client)}: no client can be made for {scheme!r} here ({error}); {such}"
            ) from None
        security: Any = Security()
        if scheme in SECURED and security.get_connection_args("client").get("ssl_context") is None:
            raise InputError(
                f"{shown(client)}: {scheme!r} needs certificates: name them in Dask's "
                "configuration (distributed.comm.tls), or give a distributed.Client(..., "
                "security=...)"
            )
        try:
            return Client(client, timeout=PATIENCE, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise InputError(
                f"no scheduler answers at {client!r} within {PATIENCE:g} s: {error}"
            ) from None
    if not isinstance(client, Client):
        raise InputError(
            f"client is {shown(client)}; it must be a distributed.Client, or the address of a "
            "scheduler"
        )
    if client.status != "running":
        raise InputError(f"the client is {client.status}: it has no scheduler")
    return client


class ClusterWorkers:
    """The workers of a cluster, given at most `most` tasks at once, or else two a thread.

    Workers that could not do the work are refused, those that join later too. Errors:
    `KernelsError`.
    """

    finishes = False

    def __init__(self, client: Any, most: int | None = None):
        self.client = client
        self.fixed = most
        self.most = most or 2
        self.known: set[str] = set()
        self.alone: float | None = None
        self._look()

    def _look(self) -> None:
        """Find the workers that have joined, and how many tasks all of them take."""
        threads: dict[str, int] = self.client.nthreads()
        new = threads.keys() - self.known
        if new:
            refuse_workers(self.client, new)
        self.known = set(threads)
        self.most = self.fixed or max(2, 2 * sum(threads.values()))
        if threads:
            self.alone = None
        elif self.alone is None:
            self.alone = time.monotonic()
        elif time.monotonic() - self.alone > PATIENCE:
            self.alone = inf  # said once, until workers have joined
            address = self.client.scheduler.address
            warn(
                f"the scheduler {address} has no workers; the work goes on when one joins",
                UserWarning,
            )

    def wait(self, futures: list[Any]) -> set[Any]:
        """Those that are done, after a while perhaps none."""
        import distributed

        tasks: Any = distributed
        self._look()
        try:
            # the function looks for a client, not for that of its tasks
            with self.client.as_current():
                return tasks.wait(futures, timeout=LOOK, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            return set()

    def share(self, thing: Any, key: str | None = None) -> Any:
        """The future of a thing that many tasks read: it travels once, and is made again where
        workers end.
        """
        return self.client.submit(_itself, thing, key=key, pure=False, retries=RETRIES)

    def lost(self, future: Any) -> bool:
        """Whether workers ended with it, as often as the scheduler bears."""
        from distributed import KilledWorker

        return isinstance(future.exception(), KilledWorker)

    def stop(self) -> None:
        """Nothing: what is begun is given up."""

    def give_up(self, futures: list[Any]) -> None:
        """Drop tasks that are not done."""
        self.client.cancel(futures)


def _itself(thing: Any) -> Any:
    return thing


def probe() -> Callable[[], tuple[str, str]]:
    """A function that is sent to workers as code, not by its name: they may have no Kempe."""

    def kernels() -> tuple[str, str]:
        from kempe.kernels.compiled import VARIANT
        from kempe.version import __version__

        return VARIANT, __version__

    return kernels


def refuse_workers(client: Any, workers: Iterable[str]) -> None:
    """Refuse to work where one of these workers has no Kempe, or another one. Errors:
    `KernelsError`.
    """
    found = client.run(probe(), workers=sorted(workers), on_error="return")
    wrong: list[str] = []
    for worker, has in sorted(found.items()):
        if isinstance(has, OSError):  # it has ended in the meantime
            continue
        if isinstance(has, BaseException):
            wrong.append(f"worker {worker} cannot import Kempe: {type(has).__name__}: {has}")
        elif tuple(has) != (VARIANT, __version__):
            wrong.append(f"worker {worker} has Kempe {has[1]} with the kernels {has[0]!r}")
    if wrong:
        more = [f"and {counted(len(wrong) - SHOWN, 'other worker')}"] * (len(wrong) > SHOWN)
        raise KernelsError(
            f"{'; '.join([*wrong[:SHOWN], *more])}. Each worker needs Kempe {__version__} with the "
            f"extra [scale] and the kernels {VARIANT!r} (KEMPE_KERNELS={VARIANT})"
        )


def refuse_kernels(variant: str, version: str) -> None:
    """Refuse to work with kernels that would round otherwise than these. Errors: `KernelsError`."""
    if (variant, version) != (VARIANT, __version__):
        raise KernelsError(
            f"the map is made by the kernels {variant!r} of Kempe {version}, and here run "
            f"{VARIANT!r} of {__version__}, which round otherwise: set KEMPE_KERNELS={variant} and "
            "install that version, or make the map anew"
        )
