"""Quality of the recordings in a dataset version: completeness, with what became of the samples of each signal from the rows of
its file to the rows of the dataset, use of each axis, noise, jitter, possible faults.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.datasets.channel import Channel
from sysid.datasets.channels import ReadRecording
from sysid.datasets.chunked import absolute, copied, counted, deviation, differences, known, mean_square, median, stretches
from sysid.datasets.clocks.records import Placed, RecordingClocks, by_source
from sysid.datasets.quality.noise import noise_of
from sysid.datasets.quality.use import Scale, level_of, scales_of, use_of
from sysid.datasets.recording import ClockRecord, Recording
from sysid.datasets.resample import gap_limit
from sysid.machine import Machine
from sysid.names import uncut_name
from sysid.progress import Progress, part, silent
from sysid.scratch import chosen, computed, leave
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Steps longer than this many sample periods are interpolated over.
BRIDGED_PERIODS = 1.5


@dataclass(frozen=True)
class SampleCounts:
    """The samples of one signal from one file of a recording.

    ``rows = empty + overflows + repeated + conflicting + turns + outside + between + alone + used``

    Args:
        rows, empty, overflows, repeated, conflicting, turns: see :class:`sysid.datasets.channel.RowCounts`.
        outside: before the first row of the recording, or after its last.
        between: in the guards between the blocks into which a recording is cut.
        alone: between two gaps that are not bridged, where the dataset has no value.
        used: the rest.
        bridged_s: time between samples further apart than :data:`BRIDGED_PERIODS` periods that is interpolated over [s].
        limit_s: the longest gap that is bridged [s].
    """

    rows: int
    empty: int = 0
    overflows: int = 0
    repeated: int = 0
    conflicting: int = 0
    turns: int = 0
    outside: int = 0
    between: int = 0
    alone: int = 0
    used: int = 0
    bridged_s: float = 0.0
    limit_s: float = 0.0

    @property
    def samples(self) -> int:
        """Samples in the file: rows with a value, each instant once."""
        return self.rows - self.empty - self.repeated

    @property
    def lost(self) -> Mapping[str, int]:
        """Reason → samples that are not in the dataset, without those in guards."""
        reasons = {
            "with the stamp of another": self.conflicting,
            "beyond any number": self.overflows,
            "in an unknown turn": self.turns,
            "alone between gaps": self.alone,
            "outside the recording": self.outside,
        }
        return {reason: count for reason, count in reasons.items() if count}

    @property
    def kept(self) -> float:
        """Share of the samples within the recording that are used; 0 where none is."""
        own = self.samples - self.between - self.outside
        return self.used / own if own > 0 else 0.0


def sample_counts(channel: Channel, times: Array, parts: Sequence[Recording], start_ns: int) -> SampleCounts:
    """The counts of one channel.

    Args:
        times: its stamps on the machine's clock, (n,) [s] from ``start_ns``, increasing.
        parts: the recording, or the blocks into which it was cut, in their order.
    """
    counts, command = channel.counts, channel.signal.endswith(".command")
    there = ~np.isnan(channel.values)
    times = chosen(times, there)
    steps, limit = differences(times), gap_limit(channel)
    used, inside, done, ends, stray = 0, 0, 0, (0, 0), 0
    moving = [piece for piece in parts if piece.kind == "motion" and len(piece)]
    if not moving:  # a pose is the median of a still phase
        used = inside = len(times)
    for piece in moving:
        begin = (piece.start_ns - start_ns) * 1e-9
        first, last = np.searchsorted(times, (begin - 1.0 / piece.rate_hz, begin + len(piece) / piece.rate_hz))
        first, last = max(int(first), done), max(int(last), done)
        if piece is not moving[0] and not command:  # in a pause, not in a guard
            around = np.concatenate([[np.inf], steps, [np.inf]])[done : first + 1] > limit
            stray += int(np.count_nonzero(around[:-1] & around[1:]))
        ends = (first if piece is moving[0] else ends[0], last)
        inside, done = inside + last - first, last
        values = piece.values(channel.signal) if channel.primary else None
        used += last - first if values is None else _in_table(times[first:last] - begin, values, piece.rate_hz)
    outside = ends[0] + len(times) - ends[1] if moving else 0
    bridged = 0.0
    if not command and moving and len(steps):
        bridged = float(chosen(steps, (steps > BRIDGED_PERIODS * channel.period_s) & (steps <= limit + 1e-9)).sum())
    return SampleCounts(
        rows=counts.rows,
        empty=counts.empty,
        overflows=counts.overflows,
        repeated=counts.repeated,
        conflicting=counts.conflicting,
        turns=counts.turns,
        outside=outside,
        between=len(times) - inside - outside - stray,
        alone=inside - used + stray,
        used=used,
        bridged_s=bridged,
        limit_s=limit if not command else 0.0,
    )


def _in_table(times: Array, values: Array, rate_hz: float) -> int:
    """Samples beside a row with a value.

    Args:
        times: from the first row, (m,) [s]; ``values``: of the rows, (n,).
    """

    def beside(first: int, last: int) -> npt.NDArray[np.bool_]:
        at = times[first:last] * rate_hz
        before = np.clip(np.floor(at + 1e-6), 0, len(values) - 1).astype(np.intp)
        after = np.clip(np.ceil(at - 1e-6), 0, len(values) - 1).astype(np.intp)
        return ~np.isnan(values[before]) | ~np.isnan(values[after])

    return counted(len(times), beside)


def stored_counts(figures: Mapping[str, Any]) -> SampleCounts:
    """The counts in the figures of a stream; of a version that was stored without them, its samples."""
    known = {name: figures[name] for name in SampleCounts.__dataclass_fields__ if name in figures}
    return SampleCounts(**known) if "used" in known else SampleCounts(figures["samples"], used=figures["samples"])


def together(counts: Sequence[SampleCounts]) -> SampleCounts:
    """The sum over recordings; the longest bridged gap is the largest of them."""
    sums = {name: sum(getattr(own, name) for own in counts) for name in SampleCounts.__dataclass_fields__}
    return SampleCounts(**{**sums, "limit_s": max(own.limit_s for own in counts)})


#: Bins over the range of a signal, for coverage.
BINS = 20
#: A sensor that repeats one value for this long while its axis is commanded may be stuck [s].
STUCK_S = 2.0
#: Share of the progress for the streams; the rest is for the tables.
_STREAMS = 0.5


def describe(
    recordings: Sequence[Recording],
    readings: Mapping[str, ReadRecording],
    clocks: Sequence[ClockRecord],
    machine: Machine,
    progress: Progress = silent,
    scales: Mapping[str, Scale] | None = None,
) -> dict[str, Any]:
    """Quality of each recording and of its streams, as JSON values. Excitation: :func:`sysid.datasets.quality.evidence_of`.

    Args:
        progress: called with the share done.
        scales: of the axes over all recordings; by default those of ``recordings``.

    Returns:
        ``recordings``: name → ``signals`` (signal → missing share, range, coverage, noise, longest gap), ``axes`` (axis →
        :class:`~sysid.datasets.quality.use.AxisUse`), ``several_axes`` (share of the moving time in which more than one axis
        is commanded), ``flags`` (texts). ``streams``: uncut recording → source/signal → rate, jitter and
        :class:`~sysid.datasets.quality.describe.SampleCounts`.
        ``cross_checks``: uncut motion recording → secondary signal → difference from the primary one. ``dropped``: uncut
        recording → flagged frames.
    """
    still = {recording.name for recording in recordings if recording.kind == "poses"}
    streams = _streams(recordings, readings, clocks, part(progress, 0.0, _STREAMS))
    scales = scales_of(recordings, machine) if scales is None else scales
    result: dict[str, Any] = {}
    done, total = 0, max(1, sum(map(len, recordings)))
    for recording in recordings:
        own = part(
            progress, _STREAMS + (1.0 - _STREAMS) * done / total, _STREAMS + (1.0 - _STREAMS) * (done + len(recording)) / total
        )
        result[recording.name] = _recording(recording, machine, scales, own)
        done += len(recording)
    for name, numbers in result.items():
        uncut = uncut_name(name, readings)
        for channel in readings[uncut].channels:
            if channel.primary and channel.signal in numbers["signals"]:
                numbers["signals"][channel.signal]["noise"] = streams[uncut][_key_of(channel)]["noise"]
    return {
        "recordings": result,
        "streams": streams,
        "cross_checks": {
            name: _cross_checks(name, reading, by_source(clocks, name))
            for name, reading in readings.items()
            if name not in still
        },
        "dropped": {
            name: [
                {"body": f.body, "reason": f.reason, "from_s": f.start_s, "to_s": f.end_s, "frames": f.frames}
                for f in reading.flags
            ]
            for name, reading in readings.items()
        },
    }


def _streams(
    recordings: Sequence[Recording],
    readings: Mapping[str, ReadRecording],
    clocks: Sequence[ClockRecord],
    progress: Progress,
) -> dict[str, dict[str, Any]]:
    parts: dict[str, list[Recording]] = {name: [] for name in readings}
    for recording in recordings:
        parts[uncut_name(recording.name, readings)].append(recording)
    streams: dict[str, dict[str, Any]] = {name: {} for name in readings}
    done, total = 0, max(1, sum(len(channel.stamps) for reading in readings.values() for channel in reading.channels))
    for name, reading in readings.items():
        placed = Placed(RecordingClocks(name, "motion", reading.channels), by_source(clocks, name))
        for channel in reading.channels:
            progress(done / total, f"describing {channel.signal}")
            counts = sample_counts(channel, placed.times(channel), parts[name], placed.start_ns)
            streams[name][_key_of(channel)] = {**_stream_figures(channel), **asdict(counts)}
            done += len(channel.stamps)
            leave()
    return streams


def _recording(recording: Recording, machine: Machine, scales: Mapping[str, Scale], progress: Progress) -> dict[str, Any]:
    flags: list[str] = []
    signals = {signal: _signal(recording, signal) for signal in recording.signals}
    result: dict[str, Any] = {"seconds": len(recording) / recording.rate_hz, "signals": signals, "flags": flags}
    for signal, numbers in signals.items():
        if numbers["missing"] == 1.0:
            still = recording.kind == "poses"
            flags.append(f"{signal}: constant in no pose" if still else f"{signal}: nothing was measured")
    if recording.kind == "poses":
        return result | {"poses": len(recording)}
    result["axes"] = {}
    active = []
    for number, axis in enumerate(machine.axes):
        progress(number / len(machine.axes), f"describing {axis.name}")
        leave()
        command = recording.values(axis_signal(axis.name, "command"))
        if np.isnan(command).all():
            continue
        result["axes"][axis.name] = asdict(use_of(recording, axis, scales[axis.name]))
        active.append(level_of(command) != 0)
        flags += _axis_flags(recording, axis.name, axis.driven, active[-1], axis.range)
    if active:
        together = np.asarray(np.sum(active, axis=0, dtype=np.uint16))
        result["several_axes"] = float(np.mean(together[together > 0] > 1)) if np.any(together > 0) else 0.0
    return result


def _signal(recording: Recording, signal: str) -> dict[str, Any]:
    values = recording.values(signal)
    measured = ~np.isnan(values)
    if not measured.any():
        return {"missing": 1.0}
    inside = chosen(values, measured)
    low, high = float(inside.min()), float(inside.max())
    rounded = high - low <= 1e-12 * max(abs(low), abs(high))  # interpolation alone
    counts = np.histogram(inside, bins=BINS, range=(low, low + max(1.0, abs(low)) if rounded else high))[0]
    numbers: dict[str, Any] = {
        "missing": float(1.0 - measured.mean()),
        "min": low,
        "max": high,
        "coverage": float(np.mean(counts > 0)),
    }
    if recording.kind == "motion":
        numbers["longest_gap_s"] = _longest_run(~measured) / recording.rate_hz
    return numbers


def _axis_flags(
    recording: Recording, axis: str, driven: str, moving: npt.NDArray[np.bool_], ends: tuple[float, float]
) -> list[str]:
    """Possible faults of an axis: a stuck sensor, values outside the range."""
    values = recording.values(driven)
    there = known(values)
    if not len(there):
        return []
    flags = []
    frozen = np.zeros(len(values), dtype=bool)
    frozen[1:] = (values[1:] == values[:-1]) & moving[1:] & moving[:-1]
    stuck = _longest_run(frozen) / recording.rate_hz
    if stuck > STUCK_S:
        flags.append(f"{driven}: one value for {stuck:.1f} s while {axis} is commanded: stuck sensor, or too small a command")
    if np.isfinite(ends).all():
        margin = 1e-3 * (ends[1] - ends[0])
        beyond = (there < ends[0] - margin) | (there > ends[1] + margin)
        if beyond.any():
            flags.append(
                f"{driven}: {100 * beyond.mean():.1f} % of the samples are outside [{ends[0]:g}, {ends[1]:g}]: offset or unit?"
            )
    return flags


def _longest_run(mask: npt.NDArray[np.bool_]) -> int:
    """Length of the longest stretch of True."""
    first, last = stretches(mask)
    return int((last - first).max(initial=0))


def _key_of(channel: Channel) -> str:
    return f"{channel.source}/{channel.signal}"


def _stream_figures(channel: Channel) -> dict[str, Any]:
    steps = computed(max(len(channel.stamps) - 1, 0), lambda a, b: np.diff(channel.stamps[a : b + 1]) * 1e-9)
    period = channel.period_s
    regular = chosen(steps, steps < 2.0 * period)
    return {
        "samples": len(channel.stamps),
        "rate_hz": 1.0 / period if period > 0 else None,
        "jitter_s": deviation(regular) if len(regular) else None,
        "longest_gap_s": float(steps.max()) if len(steps) else None,
        "late": channel.counts.late,
        "noise": noise_of(channel.values, 1.0 / period) if not channel.signal.endswith(".command") else None,
        "primary": channel.primary,
        "clock": channel.clock,
    }


def _cross_checks(name: str, reading: ReadRecording, clocks: Mapping[str, Sequence[ClockRecord]]) -> dict[str, Any]:
    """Each secondary signal against the primary one, on the machine's clock: bias, RMS and largest difference."""
    primary = {channel.signal: channel for channel in reading.channels if channel.primary}
    checks, placed = {}, Placed(RecordingClocks(name, "motion", reading.channels), clocks)
    for channel in reading.channels:
        other = primary.get(channel.signal)
        if channel.primary or other is None:
            continue
        times, values = placed.times(channel), channel.values
        at, reference = placed.times(other), other.values
        there = ~np.isnan(reference)
        at, reference = chosen(at, there), chosen(reference, there)
        inside = (times >= at[0]) & (times <= at[-1]) & ~np.isnan(values)
        difference = _differences(chosen(times, inside), chosen(values, inside), at, reference)
        if len(difference):
            checks[_key_of(channel)] = {
                "against": _key_of(other),
                "bias": median(copied(difference)),
                "rms": float(np.sqrt(mean_square(difference))),
                "p99": float(np.quantile(absolute(difference), 0.99, overwrite_input=True)),
            }
    return checks


def _differences(times: Array, values: Array, at: Array, reference: Array) -> Array:
    result: Array = computed(len(times), lambda a, b: values[a:b] - np.interp(times[a:b], at, reference))
    return result
