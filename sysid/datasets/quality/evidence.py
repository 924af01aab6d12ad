"""Excitation and noise of a dataset in numbers, computed from its tables for every version; and repeatability, the differences
between recordings of the same commands.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any, Literal

import numpy as np
from scipy.signal import correlate, correlation_lags

from sysid.datasets.chunked import Array, finite, known
from sysid.datasets.quality import coverage, use
from sysid.datasets.quality.coverage import PairMap, Rest, Span, noise_at_rest, pair_maps, postures, rests_of, spans_of
from sysid.datasets.quality.noise import noise_of
from sysid.datasets.quality.use import SLOPE_S, AxisUse, Scale, pairs_together, scales_of, together, use_of
from sysid.datasets.recording import Dataset, Recording
from sysid.scratch import leave, pieces
from sysid.signals import axis_signal, split_signal

#: Two recordings have the same commands if these, shifted, differ by less than this share (RMS) over at least this share of the
#: shorter one. Edges with an offset of one sample contribute a tenth.
ALIKE, OVERLAP = 0.2, 0.8
#: Recordings with commands below this share of full (RMS) are not compared.
GIVEN = 0.02
#: Recordings whose commands differ in size by more than this factor are not compared.
SIZE = 1.2
#: The shift of longer recordings is first searched on means over rows, so many that this number is left, then row by row on as
#: many in the middle.
MOST_ROWS = 2**18


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
            some[begin - first : end - first, k] = finite(values[begin:end]) / full - self._offset[k]
        return some


def repeats_of(recordings: Sequence[Recording], scales: Mapping[str, Scale]) -> tuple[Repeat, ...]:
    """All pairs of recordings of motion with the same commands."""
    moving = [r for r in recordings if r.kind == "motion"]
    if len(moving) < 2:
        return ()
    stride = -(-max(map(len, moving)) // MOST_ROWS) or 1
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
    middle, half = (begin + end) // 2, min(MOST_ROWS, end - begin) // 2
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


@dataclass(frozen=True)
class RecordingEvidence:
    """One recording.

    Args:
        seconds: its length; ``poses``: number of static poses.
        axes: use of each; empty for poses.
        together_s: pair of axes → seconds in which both are commanded.
        covered: pair of axes → share of the cells of their ranges that this recording visits.
        rests: its still phases.
    """

    name: str
    role: str
    seconds: float
    poses: int
    axes: Mapping[str, AxisUse]
    together_s: Mapping[tuple[str, str], float]
    covered: Mapping[tuple[str, str], float]
    rests: tuple[Rest, ...]


@dataclass(frozen=True)
class Noise:
    """Standard deviation of a sensor [SI]; None where it is unknown.

    Args:
        sheet: of the machine description.
        moving: scatter of its own samples about a smooth motion, without noise slower than 0.2 s.
        still: scatter in still phases, in the aligned tables; a suspended tool may still swing.
        repeats: difference between recordings of the same commands: noise and disturbances of the machine.
    """

    sheet: float | None
    moving: float | None
    still: float | None
    repeats: float | None


@dataclass(frozen=True)
class DatasetEvidence:
    """Evidence of each recording and of the dataset.

    Args:
        scales: axis → full command and top speed.
        axes, together_s: sums over all recordings of motion.
        spans: range of each axis and its measured part; ``maps``: of each pair of axes.
        postures: the longest still phase of each distinct posture.
    """

    recordings: tuple[RecordingEvidence, ...]
    scales: Mapping[str, Scale]
    axes: Mapping[str, AxisUse]
    together_s: Mapping[tuple[str, str], float]
    spans: tuple[Span, ...]
    maps: tuple[PairMap, ...]
    postures: tuple[Rest, ...]
    noise: Mapping[str, Noise]
    repeats: tuple[Repeat, ...]

    def to_json(self) -> dict[str, Any]:
        """JSON values; pairs of axes are ``first+second``, ``thresholds`` those of the counts."""
        return {
            "schema": 1,
            "recordings": {r.name: _recording_json(r) for r in self.recordings},
            "axes": {name: {**asdict(use), **asdict(self.scales[name])} for name, use in self.axes.items()},
            "together_s": _pairs(self.together_s),
            "ranges": {span.axis: {**asdict(span), **_shares(span)} for span in self.spans},
            "coverage": {
                f"{m.first.axis}+{m.second.axis}": {**_shares(m), "seconds": m.seconds, "poses": m.poses} for m in self.maps
            },
            "postures": [{**asdict(rest), "seconds": rest.seconds} for rest in self.postures],
            "noise": {signal: asdict(noise) for signal, noise in self.noise.items()},
            "repeats": [asdict(repeat) for repeat in self.repeats],
            "thresholds": THRESHOLDS,
        }


#: Thresholds of the counts; their reasons are in docs/guide/quality.md.
THRESHOLDS: Mapping[str, Any] = {
    "idle_command": use.IDLE,
    "small_command": list(use.SMALL),
    "slow_motion": list(use.SLOW),
    "reversal": use.TURN,
    "reversal_noise": use.TURN_NOISE,
    "speed_over_s": use.SLOPE_S,
    "command_cells": use.CELLS,
    "joint_cells": coverage.GRID,
    "cell_visited_s": use.VISITED_S,
    "still_from_s": coverage.LEAST_S,
    "posture_apart": coverage.APART,
    "repeats_alike": ALIKE,
    "repeats_overlap": OVERLAP,
}


def evidence_of(dataset: Dataset) -> DatasetEvidence:
    """Evidence of ``dataset``."""
    recordings, machine = dataset.recordings, dataset.machine
    scales, spans = scales_of(recordings, machine), spans_of(recordings, machine)
    single = tuple(_recording(r, dataset, spans, scales) for r in recordings)
    moving = [r for r in single if r.axes]
    rests = [phase for r in single for phase in r.rests]
    pairs = dict.fromkeys(pair for r in moving for pair in r.together_s)
    again = repeats_of(recordings, scales)
    return DatasetEvidence(
        recordings=single,
        scales=scales,
        axes={name: together([r.axes[name] for r in moving]) for name in scales} if moving else {},
        together_s={pair: sum(r.together_s[pair] for r in moving) for pair in pairs},
        spans=spans,
        maps=pair_maps(recordings, spans),
        postures=postures(rests, spans),
        noise=_noise(dataset, rests, again),
        repeats=again,
    )


def _recording(
    recording: Recording, dataset: Dataset, spans: tuple[Span, ...], scales: Mapping[str, Scale]
) -> RecordingEvidence:
    still = recording.kind == "poses"
    leave()
    return RecordingEvidence(
        name=recording.name,
        role=dataset.splits.get(recording.name, ""),
        seconds=0.0 if still else len(recording) / recording.rate_hz,
        poses=len(recording) if still else 0,
        axes={} if still else {name: use_of(recording, dataset.machine.axis(name), scale) for name, scale in scales.items()},
        together_s={} if still else pairs_together(recording, scales),
        covered={(m.first.axis, m.second.axis): m.covered for m in pair_maps([recording], spans)},
        rests=() if still else tuple(rests_of(recording, dataset.machine, spans, scales)),
    )


def _noise(dataset: Dataset, rests: list[Rest], again: tuple[Repeat, ...]) -> dict[str, Noise]:
    by_name = {r.name: r for r in dataset.recordings}
    signals = [s for s in dataset.machine.signals if any(s in r.signals for r in dataset.recordings)]
    found = {}
    for signal in signals:
        if split_signal(signal)[1] == "command":
            continue
        levels = [repeat.spread[signal] for repeat in again if signal in repeat.spread]
        found[signal] = Noise(
            sheet=dataset.machine.noise.get(signal),
            moving=_moving_noise(dataset, signal),
            still=noise_at_rest(by_name, rests, signal),
            repeats=float(np.median(levels)) if levels else None,
        )
    return found


def _moving_noise(dataset: Dataset, signal: str) -> float | None:
    """From the sensor's raw samples as stored by ingest, else from the tables."""
    stored = dataset.quality.get("recordings", {})
    levels = [stored.get(r.name, {}).get("signals", {}).get(signal, {}).get("noise") for r in dataset.recordings]
    known = [level for level in levels if level is not None and np.isfinite(level)]
    if not known:
        known = [noise_of(r.values(signal), r.rate_hz) for r in dataset.of_kind("motion")]
        known = [level for level in known if np.isfinite(level)]
    return float(np.median(known)) if known else None


def _shares(found: Span | PairMap) -> dict[str, float]:
    return {"covered": found.covered, "covered_moving": found.covered_moving}


def _recording_json(recording: RecordingEvidence) -> dict[str, Any]:
    return {
        "role": recording.role,
        "seconds": recording.seconds,
        "poses": recording.poses,
        "axes": {name: asdict(use) for name, use in recording.axes.items()},
        "together_s": _pairs(recording.together_s),
        "covered": _pairs(recording.covered),
        "rests": [{"from_s": r.from_s, "to_s": r.to_s, "posture": dict(r.posture)} for r in recording.rests],
    }


def _pairs(values: Mapping[tuple[str, str], float]) -> dict[str, float]:
    return {f"{first}+{second}": value for (first, second), value in values.items()}
