"""The workers of a Dask cluster, who may end, come late, and do a task twice."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from math import inf
from typing import Any

from kempe.errors import InputError, KernelsError, MissingExtraError, shown, warn
from kempe.kernels.compiled import VARIANT
from kempe.numerics.pool import RETRIES
from kempe.version import __version__
from kempe.words import counted

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
