"""The clocks of a loop: the system's monotonic clock, and a simulated one that jumps to the time waited for."""

from __future__ import annotations

import time

SECOND = 1_000_000_000


class MonotonicClock:
    """Real time; the base class of transports to real machines."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def wait_until(self, ns: int) -> None:
        """Sleep until ``ns``; return at once if it is past."""
        left = ns - time.monotonic_ns()
        while left > 0:
            time.sleep(left / SECOND)
            left = ns - time.monotonic_ns()


class SimulatedClock:
    """Time passes only in :meth:`wait_until`."""

    def __init__(self) -> None:
        self._now = 0

    def now_ns(self) -> int:
        return self._now

    def wait_until(self, ns: int) -> None:
        self._now = max(self._now, ns)
