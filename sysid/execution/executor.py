"""The interface of executors, and tasks in this process or in processes of this machine."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from dataclasses import dataclass
from multiprocessing.context import SpawnContext
from typing import Any, Protocol

from sysid.children import end_with_parent, safe_children
from sysid.errors import SysidError
from sysid.progress import Progress, part, silent

#: A function at module level; its arguments and its result travel between processes (pickle).
Task = Callable[..., Any]


class TaskError(SysidError):
    """A task that failed on its own input, or that no worker could finish."""


class Executor(Protocol):
    """Runs calls of one function, in any order and anywhere."""

    def run(
        self, task: Task, calls: Sequence[tuple[Any, ...]], progress: Progress = silent, *, reports: bool = False
    ) -> list[Any]:
        """``task(*call)`` for every call; results in the order of the calls.

        Args:
            reports: the task takes its own progress as a last argument, ``task(*call, progress)``. A cluster does not show it.

        Raises:
            SysidError: of the first call that failed; calls that have not begun are then cancelled.
            TaskError: the workers or the scheduler were lost.
        """
        ...

    def kept(self) -> AbstractContextManager[Executor]:
        """An executor for several calls of :meth:`run`, whose processes or connection are kept between them."""
        ...


def failed(error: BaseException, where: str) -> BaseException:
    """The error of a task as it is raised: one for lack of memory says what to do.

    Args:
        where: the executor.
    """
    if isinstance(error, MemoryError):
        remedy = "Use fewer workers; results that were stored are used by the next call."
        return TaskError(where, "a task had not enough memory", "enough memory for all", remedy)
    return error


#: Seconds between two progress reports.
POLL_S = 0.5
#: Smallest change of the share done that a task reports.
_STEP = 1e-3


@dataclass(frozen=True)
class LocalExecutor:
    """Runs calls in ``workers`` processes; one worker is this process.

    An interrupt kills the processes without waiting for them: what tasks store survives a kill at any moment.
    """

    workers: int = 1

    def run(
        self, task: Task, calls: Sequence[tuple[Any, ...]], progress: Progress = silent, *, reports: bool = False
    ) -> list[Any]:
        """See :class:`~sysid.execution.executor.Executor`."""
        count = min(self.workers, len(calls))
        if count > 1:
            with _processes(count) as pool:
                return pool.run(task, calls, progress, reports=reports)
        results = []
        for k, call in enumerate(calls):
            progress(k / len(calls), f"{k + 1} of {len(calls)}")
            results.append(task(*call, part(progress, k / len(calls), (k + 1) / len(calls))) if reports else task(*call))
        return results

    @contextlib.contextmanager
    def kept(self) -> Iterator[Executor]:
        """See :class:`~sysid.execution.executor.Executor`."""
        if self.workers == 1:
            yield self
            return
        with _processes(self.workers) as pool:
            yield pool


@contextlib.contextmanager
def _processes(count: int) -> Iterator[_Processes]:
    context = multiprocessing.get_context("spawn")
    with (
        safe_children(),
        ProcessPoolExecutor(count, context, end_with_parent, (os.getpid(),)) as pool,
        _killed_on_interrupt(),
    ):
        yield _Processes(pool, context)


@dataclass(frozen=True)
class _Processes:
    """Processes that are started when there is work for them, and run until the end of the block that made them."""

    pool: ProcessPoolExecutor
    context: SpawnContext

    def run(
        self, task: Task, calls: Sequence[tuple[Any, ...]], progress: Progress = silent, *, reports: bool = False
    ) -> list[Any]:
        with _shares(self.context, reports) as shares:
            try:
                if shares is None:
                    futures: list[Future[Any]] = [self.pool.submit(task, *call) for call in calls]
                else:
                    futures = [self.pool.submit(_reporting, task, call, shares, number) for number, call in enumerate(calls)]
                left = set(futures)
                watched = 0.0
                while left:
                    done, left = wait(left, POLL_S, FIRST_EXCEPTION)
                    share, text = _state(futures, {} if shares is None else dict(shares))
                    watched = max(watched, share)
                    progress(watched, text)
                    if any(future.exception() is not None for future in done):
                        for future in left:
                            future.cancel()
                        break
                return [future.result() for future in _first_failed(futures) or futures]
            except MemoryError as error:
                raise failed(error, "worker processes") from None
            except BrokenProcessPool:
                raise TaskError(
                    "worker processes", "one ended without a result, perhaps for lack of memory", "enough memory for all",
                    "Use fewer workers; results that were stored are used by the next call.",
                ) from None  # fmt: skip

    @contextlib.contextmanager
    def kept(self) -> Iterator[Executor]:
        yield self


def _first_failed(futures: Sequence[Future[Any]]) -> list[Future[Any]]:
    """The first future that ended with an error, if any did."""
    return [future for future in futures if future.done() and not future.cancelled() and future.exception() is not None][:1]


def _state(futures: Sequence[Future[Any]], shares: dict[int, tuple[float, str]]) -> tuple[float, str]:
    """The share done of all calls, and what those that run say, else how many are done."""
    done = [future.done() for future in futures]
    running = [shares[k] for k in sorted(shares) if not done[k]]
    share = (sum(done) + sum(each for each, _ in running)) / len(futures)
    return share, ", ".join(text for _, text in running) or f"{sum(done)} of {len(futures)}"


@contextlib.contextmanager
def _shares(context: SpawnContext, reports: bool) -> Iterator[Any]:
    """A table between processes, number of a call → what it reported; None without reports."""
    if not reports:
        yield None
        return
    with context.Manager() as manager:
        yield manager.dict()


def _reporting(task: Task, call: tuple[Any, ...], shares: Any, number: int) -> Any:
    """In a worker: the task, whose progress goes into the table."""
    last = [-1.0]

    def progress(share: float, text: str) -> None:
        if share - last[0] >= _STEP:
            last[0] = share
            shares[number] = (share, text)

    return task(*call, progress)


@contextlib.contextmanager
def _killed_on_interrupt() -> Iterator[None]:
    """On an interrupt, kill the processes started within."""
    before = set(multiprocessing.active_children())
    try:
        yield
    except KeyboardInterrupt:
        for process in set(multiprocessing.active_children()) - before:
            process.kill()
        raise
