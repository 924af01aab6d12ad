"""Tasks on an existing Dask cluster (extra ``cluster``).

The scheduler repeats a task whose worker was lost, on another worker (``distributed.scheduler.allowed-failures`` times).

The TLS settings of Dask (``distributed.comm.tls``) apply to ``tls://`` addresses. A cluster without TLS is for a trusted
network, since its workers execute what a client sends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sysid.execution.executor import Task, TaskError, failed
from sysid.progress import Progress, silent

#: Time to wait for the scheduler [s].
CONNECT_S = 10.0


@dataclass(frozen=True)
class ClusterExecutor:
    """Runs calls on the workers of the scheduler at ``address``, for which it waits ``connect_s`` [s]."""

    address: str
    connect_s: float = CONNECT_S

    def run(
        self, task: Task, calls: Sequence[tuple[Any, ...]], progress: Progress = silent, *, reports: bool = False
    ) -> list[Any]:
        """See :class:`~sysid.execution.executor.Executor`."""
        from distributed import Client, as_completed
        from distributed.client import FutureCancelledError
        from distributed.scheduler import KilledWorker

        try:
            client = Client(self.address, timeout=self.connect_s, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise TaskError(
                self._where, f"does not answer ({type(error).__name__})", "the address of a running Dask scheduler"
            ) from None
        with client:
            if not client.scheduler_info()["workers"]:
                raise TaskError(self._where, "has no workers", "at least one", f"Start one: dask worker {self.address}")
            own = (silent,) if reports else ()
            futures = [client.submit(task, *call, *own, pure=False) for call in calls]
            try:
                for k, future in enumerate(as_completed(futures, loop=client.loop)):
                    if future.status == "error":
                        client.cancel([other for other in futures if not other.done()])
                        raise failed(future.exception(), self._where)
                    progress((k + 1) / len(futures), f"{k + 1} of {len(futures)}")
                return list(client.gather(futures))
            except KilledWorker as error:
                raise TaskError(
                    self._where, f"a task ended the workers that ran it: {error}", "workers with enough memory",
                    "Call again: results that were stored are used.",
                ) from None  # fmt: skip
            except (FutureCancelledError, OSError, TimeoutError) as error:
                raise TaskError(
                    self._where, f"was lost during the work ({type(error).__name__})", "a running scheduler",
                    "Call again: results that were stored are used.",
                ) from None  # fmt: skip

    @property
    def _where(self) -> str:
        return f"cluster {self.address}"
