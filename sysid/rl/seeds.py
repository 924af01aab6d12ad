"""Several trainings in parallel, one process each: in one process torch's threads would wait for one another."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, TypeVar

from sysid.children import end_with_parent, safe_children
from sysid.progress import Progress, silent

T = TypeVar("T")

#: Seconds between two progress reports.
POLL_S = 0.5


def side_by_side(
    work: Callable[..., T], calls: Sequence[tuple[Any, ...]], workers: int | None = None, progress: Progress = silent
) -> list[T]:
    """``work(*call, progress)`` for every call, ``workers`` at a time; results in the order of the calls.

    Args:
        work: a module-level function.
        workers: processes; None: one for each core.

    Raises:
        The error of the first call that fails; calls that have not begun are then cancelled.
    """
    count = min(workers or len(os.sched_getaffinity(0)), len(calls))
    context = multiprocessing.get_context("spawn")
    with (
        safe_children(),
        context.Manager() as manager,
        ProcessPoolExecutor(count, context, end_with_parent, (os.getpid(),)) as pool,
        _killed_on_interrupt(),
    ):
        shares = manager.dict()
        futures = [pool.submit(_run, work, call, shares, number) for number, call in enumerate(calls)]
        done, watched = threading.Event(), 0.0
        for future in futures:
            future.add_done_callback(lambda _: done.set() if all(other.done() for other in futures) else None)
        while not done.wait(POLL_S):
            reported = dict(shares)
            watched = max(watched, sum(share for share, _ in reported.values()) / len(calls))
            progress(watched, ", ".join(text for share, text in reported.values() if share < 1.0))
            if any(future.done() and future.exception() is not None for future in futures):
                for future in futures:
                    future.cancel()
        return [future.result() for future in futures]


@contextlib.contextmanager
def _killed_on_interrupt() -> Iterator[None]:
    """On an interrupt, kill the processes started within and do not wait for them: checkpoints survive a kill at any moment."""
    before = set(multiprocessing.active_children())
    try:
        yield
    except KeyboardInterrupt:
        for process in set(multiprocessing.active_children()) - before:
            process.kill()
        raise


def _run(work: Callable[..., T], call: tuple[Any, ...], shares: Any, number: int) -> T:
    last = [-1.0]

    def progress(share: float, text: str) -> None:
        if share - last[0] >= 1e-3:
            last[0] = share
            shares[number] = (share, text)

    return work(*call, progress)
