"""The clocks a loop goes by: the system's monotonic one, and a simulated one that jumps to where it is waited for."""

from __future__ import annotations

import time

SECOND = 1_000_000_000


class MonotonicClock:
    """Real time. Transports to real machines inherit ``now_ns`` and ``wait_until`` from here."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def wait_until(self, ns: int) -> None:
        """Sleep until ``ns``; at once where that is past."""
        left = ns - time.monotonic_ns()
        while left > 0:
            time.sleep(left / SECOND)
            left = ns - time.monotonic_ns()


class SimulatedClock:
    """Time passes only where somebody waits."""

    def __init__(self) -> None:
        self._now = 0

    def now_ns(self) -> int:
        return self._now

    def wait_until(self, ns: int) -> None:
        self._now = max(self._now, ns)
