"""Clocks of transports: real time for machines, their own for simulated ones."""

from __future__ import annotations

import time
from typing import Protocol

SECOND = 1_000_000_000


class Clock(Protocol):
    """The clock of a control loop [ns]; it never goes back."""

    def now_ns(self) -> int: ...

    def wait_until(self, ns: int) -> None:
        """Return at ``ns``, at once if it is past."""
        ...


class MonotonicClock:
    """Real time."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def wait_until(self, ns: int) -> None:
        """Sleep until ``ns``; return at once if it is past."""
        left = ns - time.monotonic_ns()
        while left > 0:
            time.sleep(left / SECOND)
            left = ns - time.monotonic_ns()
