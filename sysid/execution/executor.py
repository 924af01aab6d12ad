"""The interface of executors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

from sysid.errors import SysidError
from sysid.progress import Progress, silent

#: A function of plain values, at module level, that returns JSON values.
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
