"""A flag: samples of a signal with a fault."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

KINDS = ("sentinel", "outlier", "jump", "marker_swap", "stuck", "saturation", "dropout", "jitter", "stamps")
#: More flags of one kind in one signal are merged into one.
MAX_FLAGS = 20


@dataclass(frozen=True)
class Flag:
    """Samples of ``signal`` with a fault; they stay in the table, unless ``kind`` is ``marker_swap``.

    Args:
        kind: one of :data:`KINDS`.
        from_s, to_s: first and last of these samples [s], on the clock of the given times.
        samples: their number (of a dropout: of missing samples).
        text: one sentence with the figures.
    """

    signal: str
    kind: str
    from_s: float
    to_s: float
    samples: int
    text: str


def merged(flags: Sequence[Flag]) -> list[Flag]:
    """``flags`` of one kind and signal; more than :data:`MAX_FLAGS` as one with their number."""
    if len(flags) <= MAX_FLAGS:
        return list(flags)
    samples = sum(flag.samples for flag in flags)
    largest = max(flags, key=lambda flag: flag.samples)
    text = f"{len(flags)} times, {samples} samples in all; the longest at {largest.from_s:.3f} s: {largest.text}"
    first = flags[0]
    return [Flag(first.signal, first.kind, first.from_s, max(flag.to_s for flag in flags), samples, text)]


def with_unit(value: float, unit: str) -> str:
    """A value with its unit, for texts."""
    return f"{value:.4g}" if unit == "1" else f"{value:.4g} {unit}"
