"""The interface of executors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from sysid.errors import SysidError
from sysid.progress import Progress, silent

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
