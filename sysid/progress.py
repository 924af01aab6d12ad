"""Progress callbacks."""

from __future__ import annotations

from collections.abc import Callable

#: ``progress(done, text)``: fraction done, from 0 to 1 and nondecreasing, and the current step.
Progress = Callable[[float, str], None]


def silent(done: float, text: str) -> None:
    """A callback that does nothing."""


def part(progress: Progress, begin: float, end: float) -> Progress:
    """A callback for a step that is the fraction from ``begin`` to ``end`` of the whole work."""
    return lambda done, text: progress(begin + (end - begin) * done, text)
