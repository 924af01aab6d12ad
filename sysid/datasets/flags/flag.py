"""One remark about some samples of a signal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.in_pieces import stretches

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

#: Everything a flag can say.
KINDS = ("outlier", "jump", "marker_swap", "stuck", "saturation", "dropout", "jitter", "stamps")
#: More flags of one kind than this in one signal are told as one.
MAX_FLAGS = 20


@dataclass(frozen=True)
class Flag:
    """Samples of ``signal`` that look wrong; they stay in the table, unless ``kind`` is ``marker_swap``.

    Args:
        kind: one of :data:`KINDS`.
        from_s, to_s: first and last sample concerned [s], on the clock of the times that were looked at.
        samples: how many are concerned (of a dropout: how many are missing).
        text: one sentence with the figures.
    """

    signal: str
    kind: str
    from_s: float
    to_s: float
    samples: int
    text: str


def thinned(flags: Sequence[Flag]) -> list[Flag]:
    """``flags`` of one kind and signal; many as one that says how many they are."""
    if len(flags) <= MAX_FLAGS:
        return list(flags)
    samples = sum(flag.samples for flag in flags)
    largest = max(flags, key=lambda flag: flag.samples)
    text = f"{len(flags)} times, {samples} samples in all; the longest at {largest.from_s:.3f} s: {largest.text}"
    first = flags[0]
    return [Flag(first.signal, first.kind, first.from_s, max(flag.to_s for flag in flags), samples, text)]


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Stretches of True as (first, last + 1)."""
    return [(int(a), int(b)) for a, b in zip(*stretches(mask), strict=True)]


def shown(value: float, unit: str) -> str:
    """A value with its unit, as the texts give it."""
    return f"{value:.4g}" if unit == "1" else f"{value:.4g} {unit}"
