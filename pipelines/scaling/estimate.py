"""What many machines would cost, from the figures of one: a table on paper, and what breaks first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

#: The assumed job: raw bytes, machines, and cores of each.
RAW_BYTES, MACHINES, CORES = 10e12, 100, 16
#: Length of the recordings of the second row [s].
HOUR_S = 3600.0


@dataclass(frozen=True)
class Cost:
    """One recording of the study.

    Args:
        raw: bytes of its files; ``seconds``: its length.
        task: time within its tasks; ``caller``: of the caller; ``empty``: of an empty task on a cluster [s].
        tasks: their number; ``moved``: bytes that they send and return.
    """

    raw: float
    seconds: float
    task: float
    caller: float
    empty: float
    tasks: float
    moved: float

    def longer(self, factor: float) -> Cost:
        """A recording ``factor`` times as long: what grows with samples grows, the number of tasks does not."""
        grown = (self.raw * factor, self.seconds * factor, self.task * factor, self.caller * factor)
        return Cost(*grown, self.empty, self.tasks, self.moved)


def cost_of(result: Mapping[str, Any]) -> Cost:
    """The cost of one recording, from the row of the cluster with the most workers that have a core each."""
    count, cores = result["settings"]["recordings"], result["settings"]["cores"]
    rows = [row for row in result["rows"] if row["where"] == "cluster" and row["workers"] <= cores]
    row = max(rows, key=lambda each: each["workers"])
    return Cost(
        result["bytes"]["raw"] / count,
        result["settings"]["seconds"] / count,
        row["task_seconds"] / count,
        row["caller_seconds"] / count,
        row["overhead_s"],
        row["tasks"] / count,
        (row["sent_bytes"] + row["returned_bytes"]) / count,
    )


def exponent(counts: Sequence[float], values: Sequence[float]) -> float:
    """Slope of a line through logarithms: 1 where a value grows in proportion."""
    return float(np.polyfit(np.log(counts), np.log(values), 1)[0])


def hours_of(cost: Cost) -> dict[str, float]:
    """Part → hours that it takes alone for :data:`RAW_BYTES` on :data:`MACHINES`; the longest limits the job."""
    recordings = RAW_BYTES / cost.raw
    return {
        "tasks on the workers": recordings * cost.task / (MACHINES * CORES) / 3600.0,
        "scheduler": recordings * cost.tasks * cost.empty / 3600.0,
        "caller": recordings * cost.caller / 3600.0,
    }


def estimate_rows(result: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table: recordings as long as those of the study, and of an hour."""
    cost = cost_of(result)
    rows = []
    for each in (cost, cost.longer(HOUR_S / cost.seconds)):
        hours = hours_of(each)
        first = max(hours, key=lambda part: hours[part])
        recordings = RAW_BYTES / each.raw
        rows.append(
            (
                f"{each.seconds:.0f} s",
                f"{each.raw / 1e6:.2f} MB",
                f"{recordings:,.0f}".replace(",", " "),
                *(f"{hours[part]:.2g} h" for part in hours),
                f"{recordings * each.moved / 1e9:.2g} GB",
                first,
            )
        )
    return rows


HEAD = (
    "recording",
    "raw",
    "recordings",
    "tasks on the workers",
    "scheduler",
    "caller",
    "through the scheduler",
    "breaks first",
)
