"""Repeatability: differences between recordings of the same commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.signal import correlate, correlation_lags

from sysid.datasets.chunked import known
from sysid.datasets.quality.use import SLOPE_S, Scale
from sysid.datasets.recording import Recording
from sysid.scratch import pieces
from sysid.signals import axis_signal, split_signal

Array = npt.NDArray[np.float64]

#: Two recordings have the same commands if these, shifted, differ by less than this share (RMS) over at least this share of the
#: shorter one. Edges with an offset of one sample contribute a tenth.
ALIKE, OVERLAP = 0.2, 0.8
#: Recordings with commands below this share of full (RMS) are not compared.
GIVEN = 0.02
#: Recordings whose commands differ in size by more than this factor are not compared.
SIZE = 1.2
#: The shift of longer recordings is first searched on means over rows, so many that this number is left, then row by row on as
#: many in the middle.
MOST = 2**18


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


class _Commands:
    """Commands of a recording as shares of full minus their mean (those of a servo may be far from zero), by rows.

    Args:
        stride: rows of a mean.

    ``means``: (blocks, axes). ``sizes``: RMS of each axis. ``size``: RMS of all.
    """

    def __init__(self, recording: Recording, scales: Mapping[str, Scale], stride: int) -> None:
        self.count = len(recording)
        self._columns = [(recording.values(axis_signal(name, "command")), scale.full) for name, scale in scales.items()]
        self._offset = np.zeros(len(scales))
        total = sum((self.rows(*piece).sum(axis=0) for piece in pieces(self.count)), np.zeros(len(scales)))
        self._offset = total / max(self.count, 1)
        self.stride, self.energy, means = stride, np.zeros(len(scales)), []
        for first in range(0, self.count, 1024 * stride):
            some = self.rows(first, min(first + 1024 * stride, self.count))
            self.energy += np.sum(some**2, axis=0)
            whole = len(some) // stride * stride
            means.append(some[:whole].reshape(whole // stride, stride, len(scales)).mean(axis=1))
        self.means: Array = np.concatenate(means) if means else np.zeros((0, len(scales)))
        self.sizes = np.sqrt(self.energy / max(self.count, 1))
        self.size = float(np.sqrt(np.mean(self.sizes**2))) if scales else 0.0

    def rows(self, first: int, last: int) -> Array:
        """Rows ``first`` to ``last`` - 1, (n, axes); zeros before the first and after the last of the recording."""
        begin, end = (min(max(row, 0), self.count) for row in (first, last))
        some = np.zeros((last - first, len(self._columns)))
        for k, (values, full) in enumerate(self._columns):
            some[begin - first : end - first, k] = np.nan_to_num(values[begin:end]) / full - self._offset[k]
        return some


def repeats_of(recordings: Sequence[Recording], scales: Mapping[str, Scale]) -> tuple[Repeat, ...]:
    """All pairs of recordings of motion with the same commands."""
    moving = [r for r in recordings if r.kind == "motion"]
    stride = -(-max(map(len, moving), default=1) // MOST) or 1
    commands = {r.name: _Commands(r, scales, stride) for r in moving}
    found = []
    for first, second in combinations(moving, 2):
        one, other = commands[first.name], commands[second.name]
        a, b = one.size, other.size
        if min(a, b) < GIVEN or max(a, b) > SIZE * min(a, b) or first.rate_hz != second.rate_hz:
            continue
        shift = _shift(one, other)
        if shift is not None:
            at_rest = {name for name, size in zip(scales, one.sizes, strict=True) if size < GIVEN}
            found.append(_repeat(first, second, shift, at_rest))
    return tuple(found)


def _shift(one: _Commands, other: _Commands) -> int | None:
    """Delay of ``other`` [rows]; None where the commands differ."""
    shift = _lag(one.means, other.means, "full") * one.stride
    if one.stride > 1:
        shift = _finer(one, other, shift)
    begin, end = _common(one.count, other.count, shift)
    if end - begin < OVERLAP * min(one.count, other.count):
        return None
    apart, size, most = 0.0, 0.0, float(np.sum(one.energy + other.energy)) / 2.0
    for first, last in pieces(end - begin):
        a = one.rows(begin + first, begin + last)
        b = other.rows(begin + shift + first, begin + shift + last)
        apart, size = apart + float(np.sum((a - b) ** 2)), size + float(np.sum(a**2) + np.sum(b**2)) / 2.0
        if apart >= ALIKE**2 * most:
            return None
    return shift if apart < ALIKE**2 * size else None


def _finer(one: _Commands, other: _Commands, shift: int) -> int:
    """The shift within a stride of ``shift``, from the rows in the middle of what both have."""
    begin, end = _common(one.count, other.count, shift)
    middle, half = (begin + end) // 2, min(MOST, end - begin) // 2
    if half < 1:
        return shift
    first, last, around = middle - half, middle + half, one.stride
    wide = other.rows(first + shift - around, last + shift + around)
    return shift + _lag(one.rows(first, last), wide, "valid") - around


def _lag(one: Array, other: Array, mode: Literal["full", "valid"]) -> int:
    """The lag of ``other`` at which the columns correlate best, in rows."""
    total = np.sum([correlate(other[:, k], one[:, k], mode, "fft") for k in range(one.shape[1])], axis=0)
    return int(correlation_lags(len(other), len(one), mode)[int(np.argmax(total))])


def _common(one: int, other: int, shift: int) -> tuple[int, int]:
    """First and last + 1 of the common rows of recordings with these numbers of them, as rows of the first."""
    return max(0, -shift), min(one, other - shift)


def _repeat(first: Recording, second: Recording, shift: int, at_rest: set[str]) -> Repeat:
    spread = {}
    begin, end = _common(len(first), len(second), shift)
    for signal in first.signals:
        if split_signal(signal)[1] == "command" or signal not in second.signals or split_signal(signal)[0] in at_rest:
            continue
        a, b = first.values(signal)[begin:end], second.values(signal)[begin + shift : end + shift]
        difference = known(b - a)
        if len(difference) > 10:
            difference -= float(np.median(difference[: max(round(SLOPE_S * first.rate_hz), 1)]))
            spread[signal] = float(np.sqrt(np.square(difference, out=difference).mean() / 2.0))
    return Repeat(first.name, second.name, shift / first.rate_hz, (end - begin) / first.rate_hz, spread)
