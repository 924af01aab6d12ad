"""Coverage of joint space: of every axis over its range, and of every pair of axes over both ranges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import known
from sysid.datasets.quality.use import VISITED_S
from sysid.datasets.recording import Recording
from sysid.machine import Machine
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Cells over the range of an axis.
GRID = 10


@dataclass(frozen=True)
class Span:
    """The range of an axis, and the measured part of it.

    Args:
        signal: its joint, or the driven quantity where no recording has the joint.
        low, high: the range [SI]; ``source``: from the machine description (``limits``) or, where it has none, from the
            recordings (``recorded``: then coverage is not related to the machine).
        lowest, highest: measured values, static poses included.
        moving: lowest and highest value in motion; None if no recording of motion measures it.
    """

    axis: str
    signal: str
    low: float
    high: float
    source: Literal["limits", "recorded"]
    lowest: float
    highest: float
    moving: tuple[float, float] | None = None

    @property
    def covered(self) -> float:
        """Share of the range between the lowest and the highest measured value, static poses included."""
        return self._share(self.lowest, self.highest)

    @property
    def covered_moving(self) -> float:
        """The same without the poses."""
        return self._share(*self.moving) if self.moving is not None else 0.0

    def _share(self, lowest: float, highest: float) -> float:
        return max(min(highest, self.high) - max(lowest, self.low), 0.0) / (self.high - self.low)

    def cells(self, values: Array) -> Array:
        """Cell of each value, 0 … GRID − 1; NaN where it is missing. Values outside count to the last cell."""
        place = np.floor(GRID * (values - self.low) / (self.high - self.low))
        return np.clip(place, 0, GRID - 1)


@dataclass(frozen=True)
class PairMap:
    """Joint positions of two axes.

    Args:
        seconds: of motion in each cell, (GRID, GRID), the first axis along the rows.
        poses: static poses in each cell, (GRID, GRID).
    """

    first: Span
    second: Span
    seconds: tuple[tuple[float, ...], ...]
    poses: tuple[tuple[int, ...], ...]

    @property
    def covered(self) -> float:
        """Share of all cells, reachable or not, in which the machine was for :data:`VISITED_S` or in a pose."""
        return float(((np.array(self.seconds) >= VISITED_S) | (np.array(self.poses) > 0)).mean())

    @property
    def covered_moving(self) -> float:
        """The same without the poses."""
        return float((np.array(self.seconds) >= VISITED_S).mean())


def spans_of(recordings: Sequence[Recording], machine: Machine) -> tuple[Span, ...]:
    """The ranges of the axes that any recording measures."""
    spans = []
    for axis in machine.axes:
        for signal in dict.fromkeys((axis_signal(axis.name, "joint"), axis.driven)):
            found = _ends([recording.values(signal) for recording in recordings])
            if found is None:
                continue
            lowest, highest = found
            moving = _ends([recording.values(signal) for recording in recordings if recording.kind == "motion"])
            ends = axis.range if signal == axis.driven else axis.limits
            if ends is not None and np.isfinite(ends).all() and ends[1] > ends[0]:
                spans.append(Span(axis.name, signal, float(ends[0]), float(ends[1]), "limits", lowest, highest, moving))
            else:
                high = highest if highest > lowest else lowest + 1.0
                spans.append(Span(axis.name, signal, lowest, high, "recorded", lowest, highest, moving))
            break
    return tuple(spans)


def _ends(parts: Sequence[Array]) -> tuple[float, float] | None:
    """The lowest and the highest value; None without one."""
    ends = [(float(there.min()), float(there.max())) for there in map(known, parts) if len(there)]
    return (min(low for low, _ in ends), max(high for _, high in ends)) if ends else None


def pair_maps(recordings: Sequence[Recording], spans: Sequence[Span]) -> tuple[PairMap, ...]:
    """One map for each pair of axes, over all recordings."""
    found = []
    for first, second in combinations(spans, 2):
        seconds, poses = np.zeros((GRID, GRID)), np.zeros((GRID, GRID), dtype=np.int64)
        for recording in recordings:
            counts = _counts(recording, first, second)
            if recording.kind == "poses":
                poses += counts
            else:
                seconds += counts / recording.rate_hz
        rows = tuple(tuple(map(float, row)) for row in seconds), tuple(tuple(map(int, row)) for row in poses)
        found.append(PairMap(first, second, *rows))
    return tuple(found)


def _counts(recording: Recording, first: Span, second: Span) -> npt.NDArray[np.int64]:
    a, b = (span.cells(recording.values(span.signal)) for span in (first, second))
    there = ~np.isnan(a) & ~np.isnan(b)
    cells = (GRID * a[there] + b[there]).astype(np.int64)
    return np.bincount(cells, minlength=GRID * GRID).reshape(GRID, GRID)
