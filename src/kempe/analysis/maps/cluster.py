"""The workers of a Dask cluster, who may end, come late, and do a task twice."""

from __future__ import annotations

from typing import Any

from kempe.errors import InputError, KernelsError, MissingExtraError, shown
from kempe.kernels.compiled import VARIANT

LOOK = 0.5
"""Seconds between two looks at the clock."""
HOSTS = ("tcp", "tls")
"""Ways to a scheduler that name a host and a port."""
PATIENCE = 10.0
"""Seconds in which a scheduler must answer."""


def connected(client: Any) -> Any:
    """The client, or a new one for the address of a scheduler. Errors: `InputError` where nobody answers there."""
    try:
        from distributed import Client
        from distributed.comm.addressing import parse_address, parse_host_port
    except ImportError:
        raise MissingExtraError("distributed", "scale") from None
    if isinstance(client, str):
        try:
            scheme, place = parse_address(client)
            if scheme in HOSTS:
                parse_host_port(place)  # a client for what is no address waits long until it goes
            return Client(client, timeout=PATIENCE, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise InputError(f"no scheduler answers at {client!r} within {PATIENCE:g} s: {error}") from None
    if not isinstance(client, Client):
        raise InputError(f"client is {shown(client)}; it must be a distributed.Client, or the address of a scheduler")
    if client.status != "running":
        raise InputError(f"the client is {client.status}: it has no scheduler")
    return client


class ClusterWorkers:
    """The workers of a cluster, given at most `most` tasks at once, or else two a thread."""

    finishes = False

    def __init__(self, client: Any, most: int | None = None):
        self.client, self.fixed, self.most = client, most, most or 2

    def wait(self, futures: list[Any]) -> set[Any]:
        """Those that are done, after a while perhaps none."""
        import distributed

        tasks: Any = distributed
        self.most = self.fixed or max(2, 2 * sum(self.client.nthreads().values()))
        try:
            return tasks.wait(futures, timeout=LOOK, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            return set()

    def lost(self, future: Any) -> bool:
        """Whether workers ended with it, as often as the scheduler bears."""
        from distributed import KilledWorker

        return isinstance(future.exception(), KilledWorker)

    def stop(self) -> None:
        """Nothing: what is begun is given up."""

    def give_up(self, futures: list[Any]) -> None:
        """Drop tasks that are not done."""
        self.client.cancel(futures)


def refuse_kernels(variant: str, version: str) -> None:
    """Refuse to work with kernels that would round otherwise than these. Errors: `KernelsError`."""
    from kempe import __version__

    if (variant, version) != (VARIANT, __version__):
        raise KernelsError(
            f"the map is made by the kernels {variant!r} of Kempe {version}, and here run {VARIANT!r} of "
            f"{__version__}, which round otherwise: set KEMPE_KERNELS={variant} and install that version, or make the "
            f"map anew"
        )
