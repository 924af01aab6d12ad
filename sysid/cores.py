"""Processor cores that this process may use."""

from __future__ import annotations

import os


def cores() -> int:
    """Number of cores, at least one; those allowed to this process where the system states them."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
