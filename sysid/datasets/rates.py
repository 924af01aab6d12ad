"""Rates of logs against that of the machine: units of time that nobody stated, and commands between the rows of the grid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sysid.datasets.channels import ReadRecording
from sysid.datasets.discover import RecordingFiles
from sysid.logs import reader_for
from sysid.logs.time_unit import NEAR, SECONDS

#: Rate of commands over that of the grid from which a note says so: about twice.
FASTER = 1.9


def rate_notes(found: Sequence[RecordingFiles], readings: Mapping[str, ReadRecording], rate_hz: float) -> tuple[str, ...]:
    """A note for each table without ``time_unit``, read in seconds, whose rate fits the machine's in another unit only.

    Args:
        found: the recordings with their files.
        readings: recording → what was read.
        rate_hz: rate of the machine [Hz].
    """
    notes = []
    for files in found:
        rates: dict[str, float] = {}
        for channel in readings[files.name].channels:
            if channel.period_s > 0.0:
                rates.setdefault(channel.source, 1.0 / channel.period_s)
        for path, mapping in files.streams:
            stated = mapping is not None and (mapping.time_unit is not None or mapping.rate_hz is not None)
            rate = rates.get(path.name)
            if stated or rate is None or 1.0 / (2.0 * NEAR) <= rate / rate_hz <= 2.0 * NEAR:
                continue
            if (mapping is not None and mapping.reader not in (None, "csv")) or reader_for(path).clocks != ("time",):
                continue
            likely = [unit for unit, factor in SECONDS.items() if 1.0 / NEAR <= rate / factor / rate_hz <= NEAR]
            notes += [
                f"{files.name}/{path.name}: {rate:.4g} samples a second, machine.toml states {rate_hz:g} Hz. Are the stamps in "
                f"{unit}? Then state `time_unit` in the recipe"
                for unit in likely[:1]
            ]
    return tuple(notes)


def command_notes(readings: Mapping[str, ReadRecording], rate_hz: float) -> tuple[str, ...]:
    """A note for each log file whose commands come faster than the grid has rows: those between two rows act later.

    Args:
        readings: recording → what was read.
        rate_hz: rate of the machine [Hz].
    """
    rates: dict[str, list[float]] = {}
    for reading in readings.values():
        for source, period in {c.source: c.period_s for c in reading.channels if c.signal.endswith(".command")}.items():
            if period > 0.0 and 1.0 / period > FASTER * rate_hz:
                rates.setdefault(source, []).append(1.0 / period)
    return tuple(
        f"{source}: commands at {max(found):.4g} Hz{f' in {len(found)} recordings' if len(found) > 1 else ''}, the grid has "
        f"{rate_hz:g} Hz: a command between two rows acts up to {1e3 / rate_hz:.3g} ms later. "
        f"State rate_hz = {max(found):.4g} in machine.toml"
        for source, found in rates.items()
    )
