"""Coverage of joint space, of every axis over its range and of every pair of axes over both ranges; and still phases with their
posture and length, which excite leakage and sag and show the noise at rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import Array, ends, known, measured, median, stretches
from sysid.datasets.quality.noise import table_noise
from sysid.datasets.quality.use import SLOPE_S, SLOW, VISITED_S, Scale, level_of, speeds
from sysid.datasets.recording import Recording
from sysid.machine import Machine
from sysid.scratch import leave, pieces
from sysid.signals import axis_signal

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
            given = axis.range if signal == axis.driven else axis.limits
            if given is not None and np.isfinite(given).all() and given[1] > given[0]:
                spans.append(Span(axis.name, signal, float(given[0]), float(given[1]), "limits", lowest, highest, moving))
            else:
                high = highest if highest > lowest else lowest + 1.0
                spans.append(Span(axis.name, signal, lowest, high, "recorded", lowest, highest, moving))
            break
    return tuple(spans)


def _ends(parts: Sequence[Array]) -> tuple[float, float] | None:
    """The lowest and the highest value; None without one."""
    each = [ends(values) for values in parts if measured(values)]
    return (min(low for low, _ in each), max(high for _, high in each)) if each else None


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
    counts = np.zeros(GRID * GRID, dtype=np.int64)
    for begin, end in pieces(len(recording)):
        a, b = (span.cells(recording.values(span.signal)[begin:end]) for span in (first, second))
        there = ~np.isnan(a) & ~np.isnan(b)
        counts += np.bincount((GRID * a[there] + b[there]).astype(np.int64), minlength=GRID * GRID)
    return counts.reshape(GRID, GRID)


#: Least length of a phase [s].
LEAST_S = 1.0
#: An axis is still below this many standard deviations of the noise of its speed (exceeded by one in 10⁹ samples), or below the
#: limit of slow motion.
STILL = 6.0
#: Phases after which pages are unmapped (:func:`sysid.scratch.leave`).
RESTS = 256
#: Postures differ where an axis differs by this share of its range.
APART = 0.1


@dataclass(frozen=True)
class Rest:
    """A phase without command and motion; ``posture``: axis → median [SI], of the axes measured in it."""

    recording: str
    from_s: float
    to_s: float
    posture: Mapping[str, float]

    @property
    def seconds(self) -> float:
        return self.to_s - self.from_s


def rests_of(recording: Recording, machine: Machine, spans: Sequence[Span], scales: Mapping[str, Scale]) -> list[Rest]:
    """Still phases of a recording of motion. Servos and forces may hold a position, so only the motion of those axes counts."""
    still, there = np.ones(len(recording), dtype=bool), np.zeros(len(recording), dtype=bool)
    for axis in machine.axes:
        if axis.actuation == "velocity":
            still &= level_of(recording.values(axis_signal(axis.name, "command"))) == 0
    for span in spans:
        values = recording.values(span.signal)
        noise = table_noise(values, recording.rate_hz)
        top = scales[span.axis].top_speed if span.axis in scales else 0.0
        limit = max(SLOW[0] * top, STILL * np.sqrt(2.0) * noise / SLOPE_S, 1e-12)
        for first, last in pieces(len(recording)):
            speed = np.abs(speeds(values, recording.rate_hz, first, last))
            still[first:last] &= ~(speed > limit)
            there[first:last] |= ~np.isnan(speed)
    leave()
    time = recording.values("time")
    found = []
    for number, (first, last) in enumerate(zip(*stretches(still & there), strict=True)):
        if number % RESTS == RESTS - 1:
            leave()
        if last - first < LEAST_S * recording.rate_hz:
            continue
        parts = {span.axis: known(recording.values(span.signal)[first:last]) for span in spans}
        posture = {name: median(v.copy()) for name, v in parts.items() if len(v)}
        found.append(Rest(recording.name, float(time[first]), float(time[last - 1]), posture))
    return found


def postures(rests: Sequence[Rest], spans: Sequence[Span]) -> tuple[Rest, ...]:
    """The longest phase of each distinct posture (:data:`APART`), the longest first."""
    kept: list[Rest] = []
    for rest in sorted(rests, key=lambda rest: -rest.seconds):
        if all(_apart(rest, other, spans) for other in kept):
            kept.append(rest)
    return tuple(kept)


def _apart(one: Rest, other: Rest, spans: Sequence[Span]) -> bool:
    return any(
        abs(one.posture[s.axis] - other.posture[s.axis]) > APART * (s.high - s.low)
        for s in spans
        if s.axis in one.posture and s.axis in other.posture
    )


def noise_at_rest(recordings: Mapping[str, Recording], rests: Sequence[Rest], signal: str) -> float | None:
    """Median over still phases of the standard deviation of a signal about a straight line; None without such phases."""
    found = []
    for number, rest in enumerate(rests):
        recording = recordings[rest.recording]
        first, last = np.searchsorted(recording.values("time"), (rest.from_s, rest.to_s))
        inside = known(recording.values(signal)[first : last + 1])
        if len(inside) >= LEAST_S * recording.rate_hz / 2.0 and len(inside) > 10:
            rows = np.linspace(-1.0, 1.0, len(inside))
            left = inside - inside.mean()
            left -= np.multiply(rows, (rows @ left) / (rows @ rows), out=rows)
            found.append(float(np.sqrt((left @ left) / (len(left) - 2))))
        if number % RESTS == RESTS - 1:
            leave()
    return float(np.median(found)) if found else None
