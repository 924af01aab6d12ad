"""What a dataset version keeps about its recordings: completeness, use of each axis, noise, jitter, and what looked wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from sysid.datasets.channels import ReadRecording
from sysid.datasets.clocks.records import by_source
from sysid.datasets.quality.remarks import axis_remarks, longest_run
from sysid.datasets.quality.streams import cross_checks, key_of, stream_figures
from sysid.datasets.quality.use import Scale, level_of, scales_of, use_of
from sysid.datasets.recording import ClockRecord, Recording
from sysid.machine import Machine
from sysid.progress import Progress, part, silent
from sysid.scratch import chosen, leave
from sysid.signals import axis_signal

#: Bins over the range of a signal, for coverage.
BINS = 20
#: Share of the time that the streams take, the rest is for the tables.
_STREAMS = 0.5


def describe(
    recordings: Sequence[Recording],
    readings: Mapping[str, ReadRecording],
    clocks: Sequence[ClockRecord],
    machine: Machine,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Quality of each recording and of what it was made from, as JSON-able values.

    What the recordings are good for together is no part of it: :func:`sysid.datasets.quality.evidence_of`.

    Args:
        progress: called with the share done.

    Returns:
        ``recordings``: name → ``signals`` (signal → missing share, range, coverage, noise, longest gap), ``axes`` (axis →
        :class:`~sysid.datasets.quality.use.AxisUse`), ``several_axes`` (share of the moving time in which more than one axis
        is commanded), ``flags`` (texts). ``streams``: uncut recording → source/signal → rate, jitter, samples, repaired rows.
        ``cross_checks``: uncut motion recording → secondary signal → how it differs from the primary one. ``dropped``: uncut
        recording → flagged frames.
    """
    still = {recording.name for recording in recordings if recording.kind == "poses"}
    streams = _streams(readings, part(progress, 0.0, _STREAMS))
    scales = scales_of(recordings, machine)
    result: dict[str, Any] = {}
    done, total = 0, max(1, sum(map(len, recordings)))
    for recording in recordings:
        own = part(
            progress, _STREAMS + (1.0 - _STREAMS) * done / total, _STREAMS + (1.0 - _STREAMS) * (done + len(recording)) / total
        )
        result[recording.name] = _recording(recording, machine, scales, own)
        done += len(recording)
    for name, numbers in result.items():
        uncut = name if name in readings else name.rpartition("#")[0]
        for channel in readings[uncut].channels:
            if channel.primary and channel.signal in numbers["signals"]:
                numbers["signals"][channel.signal]["noise"] = streams[uncut][key_of(channel)]["noise"]
    return {
        "recordings": result,
        "streams": streams,
        "cross_checks": {
            name: cross_checks(name, reading, by_source(clocks, name))
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


def _streams(readings: Mapping[str, ReadRecording], progress: Progress) -> dict[str, dict[str, Any]]:
    channels = [(name, channel) for name, reading in readings.items() for channel in reading.channels]
    streams: dict[str, dict[str, Any]] = {name: {} for name in readings}
    done, total = 0, max(1, sum(len(channel.stamps) for _, channel in channels))
    for name, channel in channels:
        progress(done / total, f"describing {channel.signal}")
        streams[name][key_of(channel)] = stream_figures(channel)
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
            flags.append(f"{signal}: stands still in no pose" if still else f"{signal}: nothing was measured")
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
        flags += axis_remarks(recording, axis.name, axis.driven, active[-1], axis.range)
    if active:
        together = np.asarray(np.sum(active, axis=0, dtype=np.uint16))
        result["several_axes"] = float(np.mean(together[together > 0] > 1)) if np.any(together > 0) else 0.0
    return result


def _signal(recording: Recording, signal: str) -> dict[str, Any]:
    values = recording.values(signal)
    known = ~np.isnan(values)
    if not known.any():
        return {"missing": 1.0}
    inside = chosen(values, known)
    low, high = float(inside.min()), float(inside.max())
    rounded = high - low <= 1e-12 * max(abs(low), abs(high))  # interpolation alone
    counts = np.histogram(inside, bins=BINS, range=(low, low + max(1.0, abs(low)) if rounded else high))[0]
    numbers: dict[str, Any] = {
        "missing": float(1.0 - known.mean()),
        "min": low,
        "max": high,
        "coverage": float(np.mean(counts > 0)),
    }
    if recording.kind == "motion":
        numbers["longest_gap_s"] = longest_run(~known) / recording.rate_hz
    return numbers
