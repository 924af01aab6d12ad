"""The streams as they came: rate, jitter, gaps, noise; and how far two sources of one signal differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.datasets.channel import Channel
from sysid.datasets.channels import ReadRecording
from sysid.datasets.clocks.records import RecordingClocks, machine_times
from sysid.datasets.in_pieces import absolute, copied, deviation, mean_square, median
from sysid.datasets.quality.noise import noise_of
from sysid.datasets.recording import ClockRecord
from sysid.scratch import chosen, computed

Array = npt.NDArray[np.float64]


def key_of(channel: Channel) -> str:
    return f"{channel.source}/{channel.signal}"


def stream_figures(channel: Channel) -> dict[str, Any]:
    steps = computed(max(len(channel.stamps) - 1, 0), lambda a, b: np.diff(channel.stamps[a : b + 1]) * 1e-9)
    period = median(copied(steps)) if len(steps) else float("nan")
    regular = chosen(steps, steps < 2.0 * period)
    return {
        "samples": len(channel.stamps),
        "rate_hz": 1.0 / period if period > 0 else None,
        "jitter_s": deviation(regular) if len(regular) else None,
        "longest_gap_s": float(steps.max()) if len(steps) else None,
        "missing": float(np.isnan(channel.values).mean()),
        "repaired_rows": channel.repaired,
        "noise": noise_of(channel.values, 1.0 / period) if not channel.signal.endswith(".command") else None,
        "primary": channel.primary,
        "clock": channel.clock,
    }


def cross_checks(name: str, reading: ReadRecording, clocks: Mapping[str, Sequence[ClockRecord]]) -> dict[str, Any]:
    """Each secondary signal against the primary one, on the machine's clock: bias, RMS and largest difference."""
    primary = {channel.signal: channel for channel in reading.channels if channel.primary}
    checks = {}
    for channel in reading.channels:
        other = primary.get(channel.signal)
        if channel.primary or other is None:
            continue
        times, values = _on_machine(name, channel, reading, clocks)
        at, reference = _on_machine(name, other, reading, clocks)
        there = ~np.isnan(reference)
        at, reference = chosen(at, there), chosen(reference, there)
        inside = (times >= at[0]) & (times <= at[-1]) & ~np.isnan(values)
        difference = _differences(chosen(times, inside), chosen(values, inside), at, reference)
        if len(difference):
            checks[key_of(channel)] = {
                "against": key_of(other),
                "bias": median(copied(difference)),
                "rms": float(np.sqrt(mean_square(difference))),
                "p99": float(np.quantile(absolute(difference), 0.99, overwrite_input=True)),
            }
    return checks


def _differences(times: Array, values: Array, at: Array, reference: Array) -> Array:
    result: Array = computed(len(times), lambda a, b: values[a:b] - np.interp(times[a:b], at, reference))
    return result


def _on_machine(
    name: str, channel: Channel, reading: ReadRecording, clocks: Mapping[str, Sequence[ClockRecord]]
) -> tuple[Array, Array]:
    start = RecordingClocks(name, "motion", reading.channels).start_ns
    records = clocks.get(channel.source) if channel.domain != "machine" else None
    return machine_times(channel, start, records), channel.values
