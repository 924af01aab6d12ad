"""Tasks on an existing Dask cluster (extra ``cluster``).

The scheduler repeats a task whose worker was lost, on another worker (``distributed.scheduler.allowed-failures`` times).

Dask sends pickles in both directions: whoever answers at the address of a scheduler runs programs on the computer that calls.
The TLS settings of Dask (``distributed.comm.tls``) apply to ``tls://`` addresses. Without TLS a scheduler beyond this computer
is refused unless its network is trusted.
"""

from __future__ import annotations

import asyncio
import ipaddress
import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sysid.execution.executor import Executor, Task, TaskError, failed
from sysid.progress import Progress, silent

if TYPE_CHECKING:
    from distributed import Client


#: Schemes of connections in which both sides prove who they are, by certificates.
AUTHENTICATED = ("tls", "wss")
_EXPECTED = "tls://HOST:PORT, or tcp://HOST:PORT of this computer"


def trusted_address(address: str, trusted_network: bool = False) -> str:
    """The address to connect to: a name that must mean this computer is replaced by what it was resolved to.

    Args:
        address: as Dask takes it, with or without a scheme.
        trusted_network: an address beyond this computer needs no authentication.

    Raises:
        TaskError: no address, or one whose connection is not authenticated.
    """
    from distributed.comm.addressing import get_address_host_port, parse_address, unparse_address, unparse_host_port

    where = f"cluster {address}"
    try:
        scheme, _ = parse_address(address)
        host, port = get_address_host_port(address)
        if trusted_network or scheme in AUTHENTICATED:
            return address
        found = sorted({info[4][0] for info in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)}, key=_version)
    except (ValueError, OSError) as error:
        raise TaskError(where, f"no address of a scheduler: {error}", _EXPECTED) from None
    if not all(map(_is_loopback, found)):
        raise TaskError(
            where, f"{scheme}:// is not authenticated, and whoever answers there runs programs on this computer", _EXPECTED,
            "Set up TLS (docs/guide/cluster.md), or add --trusted-network if you trust every computer of the network.",
        )  # fmt: skip
    return str(unparse_address(scheme, unparse_host_port(str(found[0]), port)))


def _version(host: str | int) -> int:
    return ipaddress.ip_address(host).version


def _is_loopback(host: str | int) -> bool:
    found = ipaddress.ip_address(host)
    mapped = found.ipv4_mapped if isinstance(found, ipaddress.IPv6Address) else None
    return (mapped or found).is_loopback


#: Time to wait for the scheduler [s].
CONNECT_S = 10.0


@dataclass(frozen=True)
class ClusterExecutor:
    """Runs calls on the workers of the scheduler at ``address``, for which it waits ``connect_s`` [s].

    Raises:
        TaskError: the address is none that is trusted, see :func:`~sysid.execution.cluster.trusted_address`.
    """

    address: str
    connect_s: float = CONNECT_S
    trusted_network: bool = False

    def __post_init__(self) -> None:
        trusted_address(self.address, self.trusted_network)

    def run(
        self, task: Task, calls: Sequence[tuple[Any, ...]], progress: Progress = silent, *, reports: bool = False
    ) -> list[Any]:
        """See :class:`~sysid.execution.executor.Executor`."""
        with self.kept() as connected:
            return connected.run(task, calls, progress, reports=reports)

    @contextmanager
    def kept(self) -> Iterator[Executor]:
        """See :class:`~sysid.execution.executor.Executor`."""
        from distributed.security import Security

        where = f"cluster {self.address}"
        if self.address.startswith("tls://") and Security().get_connection_args("client")["ssl_context"] is None:
            remedy = "Name it under distributed.comm.tls in the settings of Dask, see docs/guide/cluster.md."
            raise TaskError(where, "no certificate for a connection with TLS", "a certificate of this client", remedy)
        try:
            client = _connected(trusted_address(self.address, self.trusted_network), self.connect_s)
        except Exception as error:  # what is not a scheduler may send anything
            found = f"does not answer as a Dask scheduler ({type(error).__name__})"
            raise TaskError(where, found, "the address of a running one") from None
        with client:
            if not client.scheduler_info()["workers"]:
                raise TaskError(where, "has no workers", "at least one", f"Start one: dask worker {self.address}")
            yield _Connected(client, where)


def _connected(address: str, within: float) -> Client:
    """A client of the scheduler; one that is not connected after ``within`` [s] is closed at once."""
    from distributed import Client

    class Bounded(Client):
        async def _start(self, timeout: Any = within, **settings: Any) -> Any:
            try:
                return await asyncio.wait_for(super()._start(timeout, **settings), within)
            except BaseException:
                await self._close(fast=True)
                raise

    return Bounded(address, timeout=within, set_as_default=False)


@dataclass(frozen=True)
class _Connected:
    """A connection to a scheduler."""

    client: Client
    where: str

    def run(
        self, task: Task, calls: Sequence[tuple[Any, ...]], progress: Progress = silent, *, reports: bool = False
    ) -> list[Any]:
        from distributed import as_completed
        from distributed.client import FutureCancelledError
        from distributed.scheduler import KilledWorker

        own = (silent,) if reports else ()
        error_of_task: BaseException | None = None
        try:
            futures = [self.client.submit(task, *call, *own, pure=False) for call in calls]
            for k, future in enumerate(as_completed(futures, loop=self.client.loop)):
                if future.status == "error":
                    error_of_task = future.exception()
                    self.client.cancel([other for other in futures if not other.done()])
                    break
                progress((k + 1) / len(futures), f"{k + 1} of {len(futures)}")
            if error_of_task is None:
                return list(self.client.gather(futures))
        except (FutureCancelledError, OSError, TimeoutError) as error:
            raise TaskError(
                self.where, f"was lost during the work ({type(error).__name__})", "a running scheduler",
                "Call again: results that were stored are used.",
            ) from None  # fmt: skip
        if isinstance(error_of_task, KilledWorker):
            raise TaskError(
                self.where, f"a task ended the workers that ran it: {error_of_task}", "workers with enough memory",
                "Call again: results that were stored are used.",
            )  # fmt: skip
        raise failed(error_of_task, self.where)

    @contextmanager
    def kept(self) -> Iterator[Executor]:
        yield self
