"""An executor that measures its tasks: their number, the time within them, and the bytes that go out and come back."""

from __future__ import annotations

import contextlib
import pickle
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from sysid.execution import Executor
from sysid.execution.executor import Task
from sysid.progress import Progress, silent


@dataclass
class Measures:
    """Sums over tasks.

    Args:
        seconds: within the tasks.
        waited: time of the caller in calls of the executor; the rest of its time is its own work [s].
        sent, returned: pickled arguments and results [bytes].
    """

    tasks: int = 0
    seconds: float = 0.0
    waited: float = 0.0
    sent: int = 0
    returned: int = 0


@dataclass(frozen=True)
class MeasuredExecutor:
    """Runs tasks as ``executor`` does, and adds them to ``measures``."""

    executor: Executor
    measures: Measures = field(default_factory=Measures)

    def run(
        self, task: Task, calls: Sequence[tuple[Any, ...]], progress: Progress = silent, *, reports: bool = False
    ) -> list[Any]:
        begin = time.perf_counter()
        results = self.executor.run(timed, [(task, *call) for call in calls], progress, reports=reports)
        self.measures.waited += time.perf_counter() - begin
        self.measures.tasks += len(calls)
        self.measures.seconds += sum(seconds for seconds, _ in results)
        self.measures.sent += sum(len(pickle.dumps(call)) for call in calls)
        self.measures.returned += sum(len(pickle.dumps(value)) for _, value in results)
        return [value for _, value in results]

    @contextlib.contextmanager
    def kept(self) -> Iterator[Executor]:
        with self.executor.kept() as executor:
            yield MeasuredExecutor(executor, self.measures)


def timed(task: Task, *call: Any) -> tuple[float, Any]:
    """Task: seconds and result of a task."""
    begin = time.perf_counter()
    result = task(*call)
    return time.perf_counter() - begin, result


def nothing(number: int) -> int:
    """Task: an empty one."""
    return number
