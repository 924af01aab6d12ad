"""The choice of an executor by settings."""

from __future__ import annotations

import os

from sysid.execution.cluster import ClusterExecutor
from sysid.execution.executor import Executor
from sysid.execution.local import LocalExecutor

#: Environment variable with the address of a scheduler.
CLUSTER = "SYSID_CLUSTER"


def open_executor(cluster: str | None = None, workers: int = 1) -> Executor:
    """The executor of the settings: a cluster if an address is given or in ``SYSID_CLUSTER``, else ``workers`` processes here.

    Args:
        cluster: address of a Dask scheduler, ``tcp://HOST:PORT`` or ``tls://HOST:PORT``.
        workers: processes on this machine; 1 runs the calls in this process.
    """
    address = cluster or os.environ.get(CLUSTER)
    return ClusterExecutor(address) if address else LocalExecutor(workers)
