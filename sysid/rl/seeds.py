"""Several trainings in parallel, one process each: in one process torch's threads would wait for one another."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, TypeVar

from sysid.children import safe_children
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
    with safe_children(), context.Manager() as manager, ProcessPoolExecutor(count, context) as pool:
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


def _run(work: Callable[..., T], call: tuple[Any, ...], shares: Any, number: int) -> T:
    last = [-1.0]

    def progress(share: float, text: str) -> None:
        if share - last[0] >= 1e-3:
            last[0] = share
            shares[number] = (share, text)

    return work(*call, progress)
