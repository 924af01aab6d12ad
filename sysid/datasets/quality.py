"""What a dataset is good for, in plain numbers: coverage, gaps, jitter, reversals, noise, and what was flagged on the way."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.datasets.channel import Channel, seconds
from sysid.datasets.channels import Reading
from sysid.datasets.clocks import Clocked, machine_times
from sysid.datasets.recording import ClockRecord, Recording
from sysid.machine import Machine

Array = npt.NDArray[np.float64]

#: A command of less than this share of the largest is small: what a dead-band needs.
SMALL_COMMAND = 0.3
#: A command below this does not count as moving the axis.
IDLE_COMMAND = 0.02
#: A sensor that gives the very same value for this long while its axis is commanded may be stuck [s].
STUCK_S = 2.0
#: Bins over the range of a signal, for coverage.
BINS = 20


def describe(
    recordings: Sequence[Recording], readings: Mapping[str, Reading], clocks: Sequence[ClockRecord], machine: Machine
) -> dict[str, Any]:
    """Quality of each recording and of what it was made from, as JSON-able values.

    Returns:
        ``recordings``: name → ``signals`` (signal → missing share, range, coverage, noise, longest gap), ``axes`` (axis →
        reversals, idle share, time at small commands), ``several_axes`` (share of the moving time in which more than one axis
        is commanded), ``flags`` (texts). ``streams``: uncut recording → source/signal → rate, jitter, samples, repaired rows.
        ``cross_checks``: uncut motion recording → secondary signal → how it differs from the primary one. ``dropped``: uncut
        recording → flagged frames.
    """
    by_source = {(record.recording, record.stream): record for record in clocks}
    still = {recording.name for recording in recordings if recording.kind == "poses"}
    streams = {name: {_key(c): _stream(c) for c in reading.channels} for name, reading in readings.items()}
    result = {recording.name: _recording(recording, machine) for recording in recordings}
    for name, numbers in result.items():
        uncut = name if name in readings else name.rpartition("#")[0]
        for channel in readings[uncut].channels:
            if channel.primary and channel.signal in numbers["signals"]:
                numbers["signals"][channel.signal]["noise"] = streams[uncut][_key(channel)]["noise"]
    return {
        "recordings": result,
        "streams": streams,
        "cross_checks": {
            name: _cross_checks(name, reading, by_source) for name, reading in readings.items() if name not in still
        },
        "dropped": {
            name: [
                {"body": f.body, "reason": f.reason, "from_s": f.start_s, "to_s": f.end_s, "frames": f.frames}
                for f in reading.flags
            ]
            for name, reading in readings.items()
        },
    }


def _recording(recording: Recording, machine: Machine) -> dict[str, Any]:
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
    for axis in machine.axes:
        command = recording.values(f"{axis.name}.command")
        if np.isnan(command).all():
            continue
        numbers = _axis(command, recording.values(axis.driven), recording.rate_hz)
        result["axes"][axis.name] = numbers
        moving = np.abs(np.nan_to_num(command)) > IDLE_COMMAND * numbers["full_command"]
        active.append(moving & ~np.isnan(command))
        flags += _axis_flags(recording, axis.name, axis.driven, moving, axis.range)
    if active:
        together = np.sum(active, axis=0)
        result["several_axes"] = float(np.mean(together[together > 0] > 1)) if np.any(together > 0) else 0.0
    return result


def _signal(recording: Recording, signal: str) -> dict[str, Any]:
    values = recording.values(signal)
    known = ~np.isnan(values)
    if not known.any():
        return {"missing": 1.0}
    inside = values[known]
    low, high = float(inside.min()), float(inside.max())
    counts = np.histogram(inside, bins=BINS, range=(low, high if high > low else low + 1.0))[0]
    numbers: dict[str, Any] = {
        "missing": float(1.0 - known.mean()),
        "min": low,
        "max": high,
        "coverage": float(np.mean(counts > 0)),
    }
    if recording.kind == "motion":
        numbers["longest_gap_s"] = _longest_run(~known) / recording.rate_hz
    return numbers


def noise_of(values: Array, rate_hz: float) -> float:
    """Standard deviation of a sensor's noise [unit of the signal], from its own samples, whether it moves or not.

    Median of the scatter about cubics over a fifth of a second: a cubic follows any motion of a machine over that time, the
    median leaves out what it does not follow (stops, jerks); noise slower than that is not seen. Where the sensor counts
    in steps, at least the uniform error of a step.
    """
    width = max(round(0.2 * rate_hz), 10)
    count = len(values) // width
    windows = values[: count * width].reshape(count, width)
    windows = windows[~np.isnan(windows).any(axis=1)]
    if not len(windows):
        return float("nan")
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, width), 4))[0]
    centred = windows - windows.mean(axis=1, keepdims=True)
    residual = centred - centred @ basis @ basis.T
    scatter = float(np.sqrt(np.median(np.sum(residual**2, axis=1)) / (width - 4)))
    return max(scatter, _step(values) / math.sqrt(12.0))


def _step(values: Array) -> float:
    """The sensor's quantum; 0 where its values do not repeat."""
    known = values[~np.isnan(values)]
    levels = np.unique(known)
    if len(levels) < 2 or len(levels) > len(known) / 4:
        return 0.0
    gaps = np.diff(levels)
    return float(gaps[gaps > 1e-6 * (levels[-1] - levels[0])].min())


def _axis(command: Array, moved: Array, rate_hz: float) -> dict[str, Any]:
    """Excitation of one axis by its command and of what the command drives."""
    known = command[~np.isnan(command)]
    full = float(np.max(np.abs(known))) or 1.0
    share = np.abs(known) / full
    return {
        "full_command": full,
        "idle": float(np.mean(share <= IDLE_COMMAND)),
        "small_positive_s": float(np.sum((share > IDLE_COMMAND) & (share < SMALL_COMMAND) & (known > 0)) / rate_hz),
        "small_negative_s": float(np.sum((share > IDLE_COMMAND) & (share < SMALL_COMMAND) & (known < 0)) / rate_hz),
        "command_reversals": _reversals(known, 0.05 * full),
        "motion_reversals": _motion_reversals(moved, rate_hz),
    }


def _reversals(values: Array, threshold: float) -> int:
    """Changes of sign, counting only values beyond ``threshold``."""
    signs = np.sign(values[np.abs(values) > threshold])
    return int(np.count_nonzero(np.diff(signs)))


def _motion_reversals(values: Array, rate_hz: float) -> int:
    """Changes of direction of the smoothed motion (rate over a fifth of a second beyond 5 % of its largest)."""
    known = values[~np.isnan(values)]
    width = max(round(0.2 * rate_hz), 1)
    if len(known) <= 2 * width:
        return 0
    rate = known[width:] - known[:-width]
    return _reversals(rate, 0.05 * float(np.quantile(np.abs(rate), 0.99)))


def _axis_flags(
    recording: Recording, axis: str, driven: str, moving: npt.NDArray[np.bool_], ends: tuple[float, float]
) -> list[str]:
    values = recording.values(driven)
    known = ~np.isnan(values)
    if not known.any():
        return []
    flags = []
    frozen = np.zeros(len(values), dtype=bool)
    frozen[1:] = (np.diff(values) == 0.0) & moving[1:] & moving[:-1]
    stuck = _longest_run(frozen) / recording.rate_hz
    if stuck > STUCK_S:
        flags.append(
            f"{driven}: the very same value for {stuck:.1f} s while {axis} is commanded: stuck sensor, or a command too small"
        )
    if np.isfinite(ends).all():
        margin = 1e-3 * (ends[1] - ends[0])
        beyond = (values[known] < ends[0] - margin) | (values[known] > ends[1] + margin)
        if beyond.any():
            flags.append(
                f"{driven}: {100 * beyond.mean():.1f} % of the samples lie outside [{ends[0]:g}, {ends[1]:g}]: offset or unit?"
            )
    return flags


def _longest_run(mask: npt.NDArray[np.bool_]) -> int:
    """Length of the longest stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _key(channel: Channel) -> str:
    return f"{channel.source}/{channel.signal}"


def _stream(channel: Channel) -> dict[str, Any]:
    steps = np.diff(channel.stamps) * 1e-9
    period = float(np.median(steps)) if len(steps) else float("nan")
    regular = steps[steps < 2.0 * period]
    return {
        "samples": len(channel.stamps),
        "rate_hz": 1.0 / period if period > 0 else None,
        "jitter_s": float(np.std(regular)) if len(regular) else None,
        "longest_gap_s": float(steps.max()) if len(steps) else None,
        "missing": float(np.isnan(channel.values).mean()),
        "repaired_rows": channel.repaired,
        "noise": noise_of(channel.values, 1.0 / period) if not channel.signal.endswith(".command") else None,
        "primary": channel.primary,
        "clock": channel.clock,
    }


def _cross_checks(name: str, reading: Reading, clocks: Mapping[tuple[str, str], ClockRecord]) -> dict[str, Any]:
    """Each secondary signal against the primary one, on the machine's clock: bias, RMS and largest difference."""
    primary = {channel.signal: channel for channel in reading.channels if channel.primary}
    checks = {}
    for channel in reading.channels:
        other = primary.get(channel.signal)
        if channel.primary or other is None:
            continue
        times, values = _on_machine(name, channel, reading, clocks)
        at, reference = _on_machine(name, other, reading, clocks)
        known = ~np.isnan(reference)
        inside = (times >= at[known][0]) & (times <= at[known][-1]) & ~np.isnan(values)
        difference = values[inside] - np.interp(times[inside], at[known], reference[known])
        if len(difference):
            checks[_key(channel)] = {
                "against": _key(other),
                "bias": float(np.median(difference)),
                "rms": float(np.sqrt(np.mean(difference**2))),
                "p99": float(np.quantile(np.abs(difference), 0.99)),
            }
    return checks


def _on_machine(
    name: str, channel: Channel, reading: Reading, clocks: Mapping[tuple[str, str], ClockRecord]
) -> tuple[Array, Array]:
    start = Clocked(name, "motion", reading.channels).start_ns
    record = clocks.get((name, channel.source)) if channel.domain != "machine" else None
    times = machine_times(channel, start, record) if record is not None else seconds(channel.stamps, start)
    return times, channel.values
