"""kill -9 at every step of some work on files: before each operation that changes something on the disk."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

#: Imported once by the server that the processes are forked from.
PRELOAD = ["sysid.datasets", "pyarrow.pandas_compat", "email.parser", "pytest", "deltalake", "pyarrow.parquet", "filelock"]


def killed_at_every_step(work: Callable[..., object], *args: object, every: int = 1, first: int = 1) -> Iterator[int]:
    """Run ``work(*args)`` in processes that die before their step ``first``, ``first + every``, … until one gets to its end.

    Yields:
        The step, after each death; what the dead process left is there to be looked at. The last one, which finished, is not.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOAD)
    step = first
    while True:
        process = context.Process(target=_run, args=(step, work, args))
        process.start()
        process.join()
        if process.exitcode == 0:
            return
        assert process.exitcode == -signal.SIGKILL, f"step {step} ended with {process.exitcode}, not by the kill"
        yield step
        step += every


def _run(step: int, work: Callable[..., object], args: tuple[object, ...]) -> None:
    import deltalake
    import pyarrow.parquet as pq

    taken = 0

    def counted(owner: Any, name: str, counts: Callable[..., bool] = lambda *_: True) -> None:
        original = getattr(owner, name)

        def wrapper(*a: Any, **k: Any) -> Any:
            nonlocal taken
            taken += counts(*a)
            if taken == step and counts(*a):
                os.kill(os.getpid(), signal.SIGKILL)
            return original(*a, **k)

        setattr(owner, name, wrapper)

    for name in ("link", "replace", "rename", "unlink", "rmdir", "mkdir", "fsync"):
        counted(os, name)
    counted(Path, "open", lambda path, mode="r", *_: mode[0] in "wxa")
    counted(pq.ParquetWriter, "write_batch")
    counted(pq.ParquetWriter, "close")
    counted(deltalake, "convert_to_deltalake")
    work(*args)
