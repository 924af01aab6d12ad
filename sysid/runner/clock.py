"""The clock of transports to real machines."""

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
