"""Times of many cycles in bins that are there from the beginning: nothing is allocated while they are counted."""

from __future__ import annotations

import math

import numpy as np

#: A bin is this much wider than the one before: percentiles are known to 5 %.
_RATIO = 1.05
_BINS = 480


class Histogram:
    """Of durations from a microsecond to hours; shorter ones count as one microsecond."""

    def __init__(self) -> None:
        self._counts = np.zeros(_BINS, dtype=np.int64)
        self.count = 0
        self.largest_us = 0.0

    def add(self, ns: int) -> None:
        """Count one duration."""
        us = ns / 1000.0
        k = 0 if us <= 1.0 else min(int(math.log(us) / math.log(_RATIO)) + 1, _BINS - 1)
        self._counts[k] += 1
        self.count += 1
        self.largest_us = max(self.largest_us, us)

    def percentile(self, share: float) -> float:
        """The duration [µs] that ``share`` of all do not exceed, to 5 %; never more than the largest. NaN of none."""
        if not self.count:
            return math.nan
        k = int(np.searchsorted(np.cumsum(self._counts), share * self.count - 1e-9))
        return min(_RATIO**k, self.largest_us)

    def to_json(self) -> dict[str, float]:
        """``p50``, ``p99`` and ``max`` [µs]."""
        return {"p50": self.percentile(0.5), "p99": self.percentile(0.99), "max": self.largest_us}
