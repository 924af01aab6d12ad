"""A flag: samples of a signal with a fault; and the flags of stamps that are uneven, duplicate, out of order, or missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import copied, counted, differences, median
from sysid.scratch import chosen

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

KINDS = ("sentinel", "outlier", "jump", "marker_swap", "stuck", "saturation", "dropout", "jitter", "stamps")
#: More flags of one kind in one signal are merged into one.
MAX_FLAGS = 20


@dataclass(frozen=True)
class Flag:
    """Samples of ``signal`` with a fault; they stay in the table, unless ``kind`` is ``marker_swap``.

    Args:
        kind: one of :data:`KINDS`.
        from_s, to_s: first and last of these samples [s], on the clock of the given times.
        samples: their number (of a dropout: of missing samples).
        text: one sentence with the figures.
    """

    signal: str
    kind: str
    from_s: float
    to_s: float
    samples: int
    text: str


def merged(flags: Sequence[Flag]) -> list[Flag]:
    """``flags`` of one kind and signal; more than :data:`MAX_FLAGS` as one with their number."""
    if len(flags) <= MAX_FLAGS:
        return list(flags)
    samples = sum(flag.samples for flag in flags)
    largest = max(flags, key=lambda flag: flag.samples)
    text = f"{len(flags)} times, {samples} samples in all; the longest at {largest.from_s:.3f} s: {largest.text}"
    first = flags[0]
    return [Flag(first.signal, first.kind, first.from_s, max(flag.to_s for flag in flags), samples, text)]


def with_unit(value: float, unit: str) -> str:
    """A value with its unit, for texts."""
    return f"{value:.4g}" if unit == "1" else f"{value:.4g} {unit}"


#: Stamps are uneven where the central 90 % of the intervals spread over more than this share of the median. Below it the time
#: of a sample is known to a quarter of a period.
JITTER_SHARE = 0.5
#: Least number of intervals for a check of evenness.
MIN_INTERVALS = 20


def dropouts(signal: str, times: Array, values: Array, limit_s: float) -> list[Flag]:
    """Gaps longer than ``limit_s`` between two known samples, which are not bridged.

    Args:
        signal: its name.
        times: increasing, (n,) [s].
        values: (n,), NaN where missing.
        limit_s: the longest gap that is bridged, or for which a command is held [s].
    """
    times = chosen(times, np.isfinite(values))
    steps = differences(times)
    if not len(steps):
        return []
    found = []
    long = np.flatnonzero(steps > limit_s + 1e-9)
    period = median(copied(steps)) if len(long) else 0.0
    for index in long:
        lost = max(round(float(steps[index]) / period) - 1, 1)
        text = f"no sample for {steps[index]:.3f} s"
        found.append(Flag(signal, "dropout", float(times[index]), float(times[index + 1]), lost, text))
    return merged(found)


def jitter(signal: str, times: Array) -> list[Flag]:
    """Uneven stamps, as one flag over all of ``times`` (n,) [s], without gaps; a step over lost samples counts once."""
    steps = differences(times)
    if len(steps) < MIN_INTERVALS:
        return []
    period = median(copied(steps))
    regular = chosen(steps, steps < 3.0 * period)
    regular -= period * np.maximum(np.round(regular / period) - 1.0, 0.0)
    low, high = (float(quantile) for quantile in np.quantile(regular, [0.05, 0.95], overwrite_input=True))
    if high - low <= JITTER_SHARE * period:
        return []
    off = counted(len(regular), lambda a, b: np.abs(regular[a:b] - period) > 0.5 * JITTER_SHARE * period)
    spread = f"nine intervals in ten lie between {1e3 * low:.2f} and {1e3 * high:.2f} ms, the median is {1e3 * period:.2f}"
    text = f"uneven stamps: {spread}"
    return [Flag(signal, "jitter", float(times[0]), float(times[-1]), off, text)]


def repaired_stamps(signal: str, stamps: npt.NDArray[np.int64]) -> list[Flag]:
    """Stamps that go back or repeat, as one flag; seconds count from the earliest of ``stamps`` (n,) [ns], as in the file."""
    steps = np.diff(stamps)
    back = np.flatnonzero(steps < 0)
    ordered = np.sort(stamps)
    double = int(np.count_nonzero(np.diff(ordered) == 0))
    if not len(back) and not double:
        return []
    first_double = ordered[1:][np.diff(ordered) == 0]
    concerned = (np.concatenate([stamps[back], stamps[back + 1], first_double]) - ordered[0]) * 1e-9
    parts = []
    if len(back):
        parts.append(f"{len(back)} stamps go back, by up to {-1e-6 * float(steps.min()):.3f} ms: sorted")
    if double:
        parts.append(f"{double} rows have the stamp of another: dropped")
    return [Flag(signal, "stamps", float(concerned.min()), float(concerned.max()), len(back) + double, "; ".join(parts))]
