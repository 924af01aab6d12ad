"""The interface of executors, and the choice of one by settings."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from sysid.errors import SysidError
from sysid.progress import Progress, silent

#: Environment variable with the address of a scheduler.
CLUSTER = "SYSID_CLUSTER"

#: A function of plain values, at module level, that returns JSON values.
Task = Callable[..., Any]


class TaskError(SysidError):
    """A task that failed on its own input, or that no worker could finish."""


class Executor(Protocol):
    """Runs calls of one function, in any order and anywhere."""

    def run(self, task: Task, calls: Sequence[tuple[Any, ...]], progress: Progress = silent) -> list[Any]:
        """``task(*call)`` for every call; results in the order of the calls.

        Raises:
            SysidError: of the first call that failed; calls that have not begun are then cancelled.
            TaskError: the workers or the scheduler were lost.
        """
        ...


def open_executor(cluster: str | None = None, workers: int = 1) -> Executor:
    """The executor of the settings: a cluster if an address is given or in ``SYSID_CLUSTER``, else ``workers`` processes here.

    Args:
        cluster: address of a Dask scheduler, ``tcp://HOST:PORT`` or ``tls://HOST:PORT``.
        workers: processes on this machine; 1 runs the calls in this process.
    """
    address = cluster or os.environ.get(CLUSTER)
    if address:
        from sysid.execution.cluster import ClusterExecutor

        return ClusterExecutor(address)
    from sysid.execution.local import LocalExecutor

    return LocalExecutor(workers)
