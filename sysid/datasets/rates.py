"""Rates of tables against the rate of the machine: a unit of time that nobody stated may be wrong by a thousand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sysid.datasets.channels import ReadRecording
from sysid.datasets.discover import RecordingFiles
from sysid.logs import reader_for
from sysid.logs.time_unit import NEAR, SECONDS


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
