"""Tasks in this process, or in processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any

from sysid.children import end_with_parent, safe_children
from sysid.execution.executor import Task, TaskError
from sysid.progress import Progress, silent


@dataclass(frozen=True)
class LocalExecutor:
    """Runs calls in ``workers`` processes; one worker is this process."""

    workers: int = 1

    def run(self, task: Task, calls: Sequence[tuple[Any, ...]], progress: Progress = silent) -> list[Any]:
        """See :class:`~sysid.execution.executor.Executor`."""
        count = min(self.workers, len(calls))
        if count <= 1:
            results = []
            for k, call in enumerate(calls):
                progress(k / len(calls), f"{k + 1} of {len(calls)}")
                results.append(task(*call))
            return results
        context = multiprocessing.get_context("spawn")
        with safe_children(), ProcessPoolExecutor(count, context, end_with_parent, (os.getpid(),)) as pool:
            futures: list[Future[Any]] = [pool.submit(task, *call) for call in calls]
            left = set(futures)
            while left:
                done, left = wait(left, 0.5, FIRST_EXCEPTION)
                progress(1.0 - len(left) / len(futures), f"{len(futures) - len(left)} of {len(futures)}")
                if any(future.exception() is not None for future in done):
                    for future in left:
                        future.cancel()
                    break
            try:
                return [future.result() for future in _first_failed(futures) or futures]
            except BrokenProcessPool:
                raise TaskError(
                    "worker processes", "one ended without a result, perhaps for lack of memory", "enough memory for all",
                    "Use fewer workers; results that were stored are used by the next call.",
                ) from None  # fmt: skip


def _first_failed(futures: Sequence[Future[Any]]) -> list[Future[Any]]:
    """The first future that ended with an error, if any did."""
    return [future for future in futures if future.done() and not future.cancelled() and future.exception() is not None][:1]
