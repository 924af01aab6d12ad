"""Samples that are in the files and not in the dataset."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from sysid.datasets.plausibility.finding import Cause, Evidence, Finding
from sysid.datasets.quality.samples import SampleCounts, stored_counts, together

#: Share of the samples of a signal that is used below which it is said, and below which the signal is not what was recorded.
COMPLETE, HALF = 0.95, 0.5


def _cause(counts: SampleCounts, signal: str) -> Cause:
    """The commonest reason, with its remedy."""
    most = max(counts.lost, key=lambda reason: counts.lost[reason])
    if most == "alone between gaps":
        remedy = f"Set `max_gap_s` in the recipe to the longest gap that may be bridged, for example {2.0 * counts.limit_s:.3g}"
        return Cause("samples", (), f"further apart than {counts.limit_s:.3g} s", remedy=remedy)
    if most == "with the stamp of another":
        remedy = "Choose a finer clock in the recipe, or state `rate_hz` there in place of `time`"
        return Cause("stamps", (), "coarser than the rows", remedy=remedy)
    if most == "beyond any number":
        return Cause("", (signal,), "damaged or read in a wrong unit", remedy="Correct `unit` or `scale` in the recipe")
    if most == "in an unknown turn":
        remedy = "Cut the log at the gap into recordings of their own"
        return Cause("", (signal,), "wrapped, with a gap in which it may have made several numbers of turns", remedy=remedy)
    remedy = "Correct the clock in the recipe, or cut the file"
    return Cause("", (signal,), "recorded at other times than the machine", remedy=remedy)


def sample_findings(streams: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> Iterator[Finding]:
    """A finding for each signal of which a recording uses less than :data:`COMPLETE` of the samples.

    Args:
        streams: recording → file/signal → figures, ``quality["streams"]`` of a dataset.
    """
    found: dict[str, dict[str, SampleCounts]] = {}
    for recording, entries in streams.items():
        for key, figures in entries.items():
            counts = stored_counts(figures)
            within = counts.samples - counts.between
            if within > 0 and counts.used < COMPLETE * within:
                found.setdefault(key, {})[recording] = counts
    for key, own in found.items():
        file, _, signal = key.rpartition("/")
        whole = together(list(own.values()))
        reasons = ", ".join(f"{count} {reason}" for reason, count in whole.lost.items())
        evidence = Evidence(f"{whole.used} of {whole.samples} samples of {signal} in {file} are used: {reasons}", "all of them")
        lost = any(counts.kept < HALF for counts in own.values())
        yield Finding((f"{signal}:samples",), "severe" if lost else "notice", (evidence,), (_cause(whole, signal),), tuple(own))
