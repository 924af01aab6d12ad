"""What became of the samples of each signal, over all recordings: for console and report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid.datasets.quality.samples import SampleCounts, stored_counts, together
from sysid.datasets.recording import Dataset
from sysid.display import NOTHING


@dataclass(frozen=True)
class SampleLine:
    """One signal; ``filled``: share of the rows of its recordings that have a value, NaN for a second source."""

    name: str
    counts: SampleCounts
    filled: float

    @property
    def lost(self) -> str:
        """Why samples are not used, with their numbers."""
        counts = self.counts
        reasons = {
            "empty": counts.empty,
            "repeated": counts.repeated,
            "in guards between blocks": counts.between,
            **counts.lost,
        }
        return ", ".join(f"{count} {reason}" for reason, count in reasons.items() if count) or NOTHING


def sample_lines(dataset: Dataset) -> list[SampleLine]:
    """One line for each signal, in the order of the machine; second sources after the first."""
    found: dict[tuple[str, bool], list[SampleCounts]] = {}
    for entries in dataset.quality.get("streams", {}).values():
        for key, figures in entries.items():
            found.setdefault((key.rpartition("/")[2], figures["primary"]), []).append(stored_counts(figures))
    lines = []
    for signal in dataset.machine.signals:
        for primary in (True, False):
            if (signal, primary) in found:
                filled = _filled(dataset, signal) if primary else float("nan")
                name = signal if primary else f"{signal} (second)"
                lines.append(SampleLine(name, together(found[signal, primary]), filled))
    return lines


def _filled(dataset: Dataset, signal: str) -> float:
    own = [recording.values(signal) for recording in dataset.recordings if signal in recording.signals]
    rows = sum(map(len, own))
    return sum(int(np.count_nonzero(~np.isnan(values))) for values in own) / rows if rows else float("nan")
