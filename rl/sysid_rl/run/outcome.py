"""The outcome of a run, and histograms of its cycle times."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

Ended = Literal["done", "stopped", "fault", "quit", "time"]
#: Ratio of the widths of successive bins: percentiles are accurate to 5 %.
_RATIO = 1.05
_BINS = 480


class Histogram:
    """Durations from a microsecond to hours in fixed bins, so that counting allocates no memory."""

    def __init__(self) -> None:
        self._counts = np.zeros(_BINS, dtype=np.int64)
        self.count = 0
        self.largest_us = 0.0

    def add(self, ns: int) -> None:
        """Count a duration."""
        us = ns / 1000.0
        k = 0 if us <= 1.0 else min(int(math.log(us) / math.log(_RATIO)) + 1, _BINS - 1)
        self._counts[k] += 1
        self.count += 1
        self.largest_us = max(self.largest_us, us)

    def percentile(self, share: float) -> float:
        """The quantile ``share`` [µs], accurate to 5 %, at most the largest duration; NaN without any."""
        if not self.count:
            return math.nan
        k = int(np.searchsorted(np.cumsum(self._counts), share * self.count - 1e-9))
        return min(_RATIO**k, self.largest_us)

    def to_json(self) -> dict[str, float]:
        """``p50``, ``p99`` and ``max`` [µs]."""
        return {"p50": self.percentile(0.5), "p99": self.percentile(0.99), "max": self.largest_us}


@dataclass
class RunOutcome:
    """The outcome of a run.

    Args:
        ended: why it is over; ``state``, ``why``: of the state machine at the end.
        cycles: number of cycles; ``missed``: deadlines that passed before their cycle began.
        lateness, latency: of all cycles.
        verdicts: check → cycles with a violation.
        notes: refusals of the operating system, and messages to the operator.
        error: traceback of an error of the runner itself; "" without one.
    """

    ended: Ended = "time"
    state: str = "idle"
    why: str = ""
    cycles: int = 0
    missed: int = 0
    lateness: Histogram = field(default_factory=Histogram)
    latency: Histogram = field(default_factory=Histogram)
    verdicts: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    error: str = ""
