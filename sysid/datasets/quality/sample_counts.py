"""What became of the samples of a signal, from the rows of its file to the rows of the dataset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sysid.datasets.channel import Channel
from sysid.datasets.chunked import Array, Mask, counted, differences
from sysid.datasets.recording import Recording
from sysid.datasets.resample import gap_limit
from sysid.scratch import chosen

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
    rows = {name: number for name, number in asdict(counts).items() if name != "late"}
    return SampleCounts(
        **rows,
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

    def beside(first: int, last: int) -> Mask:
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
