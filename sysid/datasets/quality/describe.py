"""Quality of the recordings in a dataset version, as it is stored: completeness, use of each axis, noise, jitter, faults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from sysid.datasets.channel import Channel
from sysid.datasets.channels import ReadRecording
from sysid.datasets.checks.columns import RecordingTable
from sysid.datasets.checks.run import recording_flags
from sysid.datasets.chunked import Array, Mask, absolute, copied, deviation, longest_run, mean_square, median
from sysid.datasets.clocks.records import Placed, RecordingClocks, by_source
from sysid.datasets.quality.noise import noise_of
from sysid.datasets.quality.sample_counts import sample_counts
from sysid.datasets.quality.use import Scale, level_of, scales_of, use_of
from sysid.datasets.recording import ClockRecord, Recording
from sysid.machine import Machine
from sysid.names import uncut_name
from sysid.progress import Progress, part, silent
from sysid.scratch import chosen, computed, leave
from sysid.signals import axis_signal

#: Bins over the range of a signal, for coverage.
BINS = 20
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
        :class:`~sysid.datasets.quality.sample_counts.SampleCounts`.
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
    result: dict[str, Any] = {
        "seconds": len(recording) / recording.rate_hz,
        "signals": {signal: _signal(recording, signal) for signal in recording.signals},
        "flags": (flags := list[str]()),
    }
    moving: dict[str, Mask] = {}
    if recording.kind == "poses":
        result["poses"] = len(recording)
    else:
        result["axes"] = {}
        for number, axis in enumerate(machine.axes):
            progress(number / len(machine.axes), f"describing {axis.name}")
            leave()
            command = recording.values(axis_signal(axis.name, "command"))
            if not np.isnan(command).all():
                result["axes"][axis.name] = asdict(use_of(recording, axis, scales[axis.name]))
                moving[axis.name] = level_of(command) != 0
    if moving:
        together = np.asarray(np.sum(list(moving.values()), axis=0, dtype=np.uint16))
        result["several_axes"] = float(np.mean(together[together > 0] > 1)) if np.any(together > 0) else 0.0
    flags += recording_flags(RecordingTable(recording, machine, moving))
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
        numbers["longest_gap_s"] = longest_run(~measured) / recording.rate_hz
    return numbers


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
