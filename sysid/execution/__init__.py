"""Where independent tasks run: in this process, in processes of this machine, or on an existing cluster.

Every task is a module-level function of plain values (text, numbers): the location of a workspace and references into it.
Tables are read where the task runs, results are JSON values. The same tasks give the same results everywhere.
"""

from __future__ import annotations

import os

from sysid.execution.cluster import ClusterExecutor
from sysid.execution.executor import Executor, LocalExecutor, TaskError

__all__ = ["Executor", "LocalExecutor", "TaskError", "open_executor"]

#: Environment variable with the address of a scheduler.
CLUSTER = "SYSID_CLUSTER"


def open_executor(cluster: str | None = None, workers: int = 1, *, trusted_network: bool = False) -> Executor:
    """The executor of the settings: a cluster if an address is given or in ``SYSID_CLUSTER``, else ``workers`` processes here.

    Args:
        cluster: address of a Dask scheduler, ``tcp://HOST:PORT`` or ``tls://HOST:PORT``.
        workers: processes on this machine; 1 runs the calls in this process.
        trusted_network: a cluster beyond this computer needs no TLS.

    Raises:
        TaskError: the connection to the cluster is not authenticated, and its network not trusted.
    """
    address = cluster or os.environ.get(CLUSTER)
    return ClusterExecutor(address, trusted_network=trusted_network) if address else LocalExecutor(workers)
