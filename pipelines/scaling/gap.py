"""The gap of one machine, its stages searched in threads of one process, in processes, and on a cluster."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

from scaling.measured_executor import MeasuredExecutor
from sysid.datasets import Store
from sysid.execution import Executor, LocalExecutor
from sysid.gap import find_gap
from sysid.gap.search_tasks import SearchTasks
from sysid.location import absolute_location
from sysid.plant import nominal_plant
from sysid.registry import Registry

#: A cluster of so many workers, for the duration of a block.
Cluster = Callable[[int], AbstractContextManager[tuple[Executor, Any]]]
HEAD = ("stages searched in", "workers", "gap [s]", "speed-up", "tasks", "sent [kB]", "returned [kB]", "same result")


def gap_rows(workspace: Path, reference: str, counts: Sequence[int], cluster: Cluster) -> list[dict[str, Any]]:
    """A row for threads and, by the number of workers, for processes and a cluster; every process was used once before."""
    dataset, registry = Store(workspace).load(reference), Registry(workspace)
    plant = nominal_plant(dataset.machine)

    def timed_gap(executor: Executor | None) -> tuple[float, str]:
        """Seconds, and everything but the time that it took, as text: values that are not defined (NaN) are equal there."""
        tasks = SearchTasks(executor, absolute_location(workspace)) if executor is not None else None
        begin = time.perf_counter()
        found = find_gap(dataset, plant, registry, tasks=tasks)
        return time.perf_counter() - begin, json.dumps(replace(found, seconds=0.0).to_json(), sort_keys=True)

    timed_gap(None)
    alone, expected = timed_gap(None)
    rows: list[dict[str, Any]] = [{"where": "threads of one process", "workers": 1, "seconds": alone, "same_result": True}]
    for workers in counts:
        with LocalExecutor(workers).kept() as kept, cluster(workers) as (remote, _):
            for where, executor in (("processes of this machine", kept), ("Dask cluster on loopback", remote)):
                if workers == 1 and executor is kept:  # one process is the caller itself
                    continue
                timed_gap(executor)
                measured = MeasuredExecutor(executor)
                seconds, content = timed_gap(measured)
                sums = measured.measures
                moved = {"tasks": sums.tasks, "sent_bytes": sums.sent, "returned_bytes": sums.returned}
                rows.append(
                    {"where": where, "workers": workers, "seconds": seconds, **moved, "same_result": content == expected}
                )
    return rows


def table_rows(rows: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
    """Of the page, under :data:`HEAD`."""
    alone = rows[0]["seconds"]
    found = []
    for row in rows:
        moved = (
            (f"{row['tasks']}", f"{row['sent_bytes'] / 1e3:.0f}", f"{row['returned_bytes'] / 1e3:.0f}")
            if "tasks" in row
            else ("", "", "")
        )
        same = "yes" if row["same_result"] else "**no**"
        found.append(
            (row["where"], str(row["workers"]), f"{row['seconds']:.1f}", f"{alone / row['seconds']:.2f}", *moved, same)
        )
    return found
