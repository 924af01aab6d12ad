"""kill -9 at every step of some work on files: before each operation that changes something on the disk.

A step is a call that makes, links, renames, removes, syncs or opens for writing, a piece of a Parquet or Delta table, or a
statement of sqlite. Nothing depends on timing: the k-th step of the same work is the same operation.
"""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

#: Imported once by the server that the processes are forked from.
PRELOAD = [
    "sysid.workspace",
    "sysid.datasets",
    "sysid.registry",
    "pyarrow.pandas_compat",
    "email.parser",
    "pytest",
    "deltalake",
    "pyarrow.parquet",
    "filelock",
    "torch",
    "sysid.networks.structured",
    "sysid_rl.train.training",
]
#: What happens at the step: the process is killed; or this call and all that follow find the disk full.
Fault = Literal["kill", "full"]


def killed_at_every_step(work: Callable[..., object], *args: object, every: int = 1, first: int = 1) -> Iterator[int]:
    """Run ``work(*args)`` in processes that die before their step ``first``, ``first + every``, … until one gets to its end.

    Yields:
        The step, after each death; what the dead process left is there to be looked at. The last one, which finished, is not.
    """
    step = first
    while dies_at(step, work, *args):
        yield step
        step += every


def dies_at(step: int, work: Callable[..., object], *args: object) -> bool:
    """Whether ``work(*args)`` in another process came to its step ``step``, where it was killed."""
    code, _ = _outcome(step, "kill", work, args)
    assert code in (0, -signal.SIGKILL), f"step {step} ended with {code}, not by the kill"
    return code != 0


def steps_of(work: Callable[..., object], *args: object) -> int:
    """Run ``work(*args)`` to its end in another process; how many steps it took."""
    code, taken = _outcome(0, "kill", work, args)
    assert code == 0, f"ended with {code}"
    return taken


def full_from(step: int, work: Callable[..., object], *args: object) -> int:
    """Exit status of ``work(*args)`` in another process, which finds the disk full from its step ``step`` on.

    0: it came to its end; 2: an error of the toolkit; 1: another one.
    """
    return _outcome(step, "full", work, args)[0]


def _outcome(step: int, fault: Fault, work: Callable[..., object], args: tuple[object, ...]) -> tuple[int, int]:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOAD)
    taken = context.Value("i", 0, lock=False)
    process = context.Process(target=_run, args=(step, fault, taken, work, args))
    process.start()
    process.join()
    assert process.exitcode is not None
    return process.exitcode, taken.value


def _run(step: int, fault: Fault, taken: Any, work: Callable[..., object], args: tuple[object, ...]) -> None:
    import deltalake
    import pyarrow.parquet as pq

    from sysid.errors import SysidError

    def counted(owner: Any, name: str, counts: Callable[..., bool] = lambda *_: True) -> None:
        original = getattr(owner, name)

        def wrapper(*a: Any, **k: Any) -> Any:
            if counts(*a):
                _step(fault)
            return original(*a, **k)

        setattr(owner, name, wrapper)

    def _step(kind: Fault) -> None:
        taken.value += 1
        if kind == "kill" and taken.value == step:
            os.kill(os.getpid(), signal.SIGKILL)
        if kind == "full" and taken.value >= step:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    if fault == "kill":
        for name in ("unlink", "rmdir"):  # a full disk lets go of files
            counted(os, name)
        _count_statements(lambda: _step("kill"))
    for name in ("link", "replace", "rename", "mkdir", "fsync"):
        counted(os, name)
    counted(os, "open", lambda path, flags, *_: bool(flags & os.O_CREAT))
    counted(Path, "open", lambda path, mode="r", *_: mode[0] in "wxa")
    counted(pq.ParquetWriter, "write_batch")
    counted(pq.ParquetWriter, "close")
    counted(deltalake, "convert_to_deltalake")
    try:
        work(*args)
    except SysidError:
        os._exit(2)


def _count_statements(step: Callable[[], None]) -> None:
    connect = sqlite3.connect

    def counted(*a: Any, **k: Any) -> sqlite3.Connection:
        connection = connect(*a, **k)
        connection.set_trace_callback(lambda statement: None if statement.startswith(("SELECT", "PRAGMA")) else step())
        return connection

    sqlite3.connect = counted  # type: ignore[assignment]
