"""How long work says how far it is: one convention for every station."""

from __future__ import annotations

from collections.abc import Callable

#: ``progress(done, text)``: the share done, from 0 to 1 and never falling, and what is being done.
Progress = Callable[[float, str], None]


def silent(done: float, text: str) -> None:
    """A listener that does not care."""


def part(progress: Progress, begin: float, end: float) -> Progress:
    """A listener for a step that is the stretch from ``begin`` to ``end`` of the whole work."""
    return lambda done, text: progress(begin + (end - begin) * done, text)
