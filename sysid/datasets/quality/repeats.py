"""Repeatability: differences between recordings of the same commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt
from scipy.signal import correlate, correlation_lags

from sysid.datasets.quality.use import SLOPE_S, Scale
from sysid.datasets.recording import Recording
from sysid.signals import axis_signal, split_signal

Array = npt.NDArray[np.float64]

#: Two recordings have the same commands if these, shifted, differ by less than this share (RMS) over at least this share of the
#: shorter one. Edges with an offset of one sample contribute a tenth.
ALIKE, OVERLAP = 0.2, 0.8
#: Recordings with commands below this share of full (RMS) are not compared.
GIVEN = 0.02
#: Recordings whose commands differ in size by more than this factor are not compared.
SIZE = 1.2


@dataclass(frozen=True)
class Repeat:
    """Two recordings of the same commands.

    Args:
        shift_s: delay of the commands in the second [s].
        seconds: length of the overlap [s].
        spread: signal → standard deviation of one run about the common motion (RMS difference over √2) [SI], relative to the
            value in the first :data:`SLOPE_S`; only of commanded axes.
    """

    first: str
    second: str
    shift_s: float
    seconds: float
    spread: Mapping[str, float]


def repeats_of(recordings: Sequence[Recording], scales: Mapping[str, Scale]) -> tuple[Repeat, ...]:
    """All pairs of recordings of motion with the same commands."""
    moving = [r for r in recordings if r.kind == "motion"]
    commands = {r.name: _commands(r, scales) for r in moving}
    sizes = {name: float(np.sqrt(np.mean(u**2))) if u.size else 0.0 for name, u in commands.items()}
    found = []
    for first, second in combinations(moving, 2):
        a, b = sizes[first.name], sizes[second.name]
        if min(a, b) < GIVEN or max(a, b) > SIZE * min(a, b) or first.rate_hz != second.rate_hz:
            continue
        shift = _shift(commands[first.name], commands[second.name])
        if shift is not None:
            found.append(_repeat(first, second, shift, scales))
    return tuple(found)


def _commands(recording: Recording, scales: Mapping[str, Scale]) -> Array:
    """Commands minus their mean (those of a servo may be far from zero) as shares of full, (n, axes)."""
    columns = [np.nan_to_num(recording.values(axis_signal(name, "command"))) / scale.full for name, scale in scales.items()]
    return np.column_stack([u - u.mean() for u in columns]) if columns and len(recording) else np.zeros((len(recording), 0))


def _shift(one: Array, other: Array) -> int | None:
    """Delay of ``other`` [rows]; None where the commands differ."""
    total = np.sum([correlate(other[:, k], one[:, k], "full", "fft") for k in range(one.shape[1])], axis=0)
    shift = int(correlation_lags(len(other), len(one))[int(np.argmax(total))])
    a, b = _both(one, other, shift)
    if len(a) < OVERLAP * min(len(one), len(other)):
        return None
    size = float(np.mean(a**2) + np.mean(b**2)) / 2.0
    return shift if np.mean((a - b) ** 2) < ALIKE**2 * size else None


def _both(one: Array, other: Array, shift: int) -> tuple[Array, Array]:
    """The common rows, ``other`` moved back by ``shift``."""
    begin, end = max(0, -shift), min(len(one), len(other) - shift)
    return one[begin:end], other[begin + shift : end + shift]


def _repeat(first: Recording, second: Recording, shift: int, scales: Mapping[str, Scale]) -> Repeat:
    spread = {}
    sizes = np.sqrt(np.mean(_commands(first, scales) ** 2, axis=0))
    at_rest = {name for name, size in zip(scales, sizes, strict=True) if size < GIVEN}
    for signal in first.signals:
        if split_signal(signal)[1] == "command" or signal not in second.signals or split_signal(signal)[0] in at_rest:
            continue
        a, b = _both(first.values(signal), second.values(signal), shift)
        difference = b - a
        difference = difference[~np.isnan(difference)]
        if len(difference) > 10:
            start = float(np.median(difference[: max(round(SLOPE_S * first.rate_hz), 1)]))
            spread[signal] = float(np.sqrt(np.mean((difference - start) ** 2) / 2.0))
    rows = len(_both(first.values("time"), second.values("time"), shift)[0])
    return Repeat(first.name, second.name, shift / first.rate_hz, rows / first.rate_hz, spread)
