"""Flags, the samples of a signal as its checks look at them, and the checks of what a file says: numbers that stand for "no
value", and stamps that are uneven, duplicate, out of order, or missing. No value is changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.datasets.chunked import Array, Mask, Stamps, copied, counted, differences, median
from sysid.machine import Machine
from sysid.scratch import chosen
from sysid.signals import split_signal

#: More flags of one kind in one signal are merged into one.
MAX_FLAGS = 20


@dataclass(frozen=True)
class Flag:
    """Samples of ``signal`` with a fault; they stay in the table, unless ``kind`` is ``marker_swap``.

    Args:
        kind: one of :data:`sysid.datasets.checks.run.KINDS`.
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


@dataclass(frozen=True)
class SignalSamples:
    """Samples of one signal, which every check of a channel looks at.

    Args:
        times: increasing, (n,) [s].
        values: (n,), NaN where missing.
        unit: of the values, for texts.
        limit_s: the longest gap that is bridged, or for which a command is held [s].
        commanded: whether an axis that moves the sensor is commanded, (n,); needed by the checks of constant values alone.
        driven: the same by so much that it has to move, (n,).
        ends: range of the axis in SI; infinite where it is not known.
    """

    signal: str
    times: Array
    values: Array
    unit: str = "1"
    limit_s: float = np.inf
    commanded: Mask = field(default_factory=lambda: np.zeros(0, dtype=bool))
    driven: Mask = field(default_factory=lambda: np.zeros(0, dtype=bool))
    ends: tuple[float, float] = (-np.inf, np.inf)

    @property
    def known(self) -> SignalSamples:
        """Those with a value, without the commands."""
        there = ~np.isnan(self.values)
        return SignalSamples(self.signal, chosen(self.times, there), chosen(self.values, there), self.unit, self.limit_s)

    def flag(self, kind: str, first: int, last: int, text: str, count: int | None = None) -> Flag:
        """A flag of samples ``first`` to ``last``."""
        samples = last - first + 1 if count is None else count
        return Flag(self.signal, kind, float(self.times[first]), float(self.times[last]), int(samples), text)


def merged(flags: Sequence[Flag]) -> list[Flag]:
    """``flags`` of one kind and signal; more than :data:`MAX_FLAGS` as one with their number."""
    if len(flags) <= MAX_FLAGS:
        return list(flags)
    samples = sum(flag.samples for flag in flags)
    largest = max(flags, key=lambda flag: flag.samples)
    text = f"{len(flags)} times, {samples} samples in all; the longest at {largest.from_s:.3f} s: {largest.text}"
    return [replace(flags[0], to_s=max(flag.to_s for flag in flags), samples=samples, text=text)]


def ends_of(signal: str, machine: Machine) -> tuple[float, float]:
    """Range of the axis that ``signal`` measures, in SI; infinite where it is not known."""
    owner, kind = split_signal(signal)
    for axis in machine.axes:
        if axis.name == owner:
            if kind == "joint" and axis.limits is not None:
                return axis.limits
            if kind == "cylinder" and axis.stroke is not None:
                return axis.stroke
    return (-np.inf, np.inf)


#: Least number of samples with exactly the number of a sentinel, and of others.
LEAST, LEAST_OTHERS = 3, 10


def sentinels(signal: str, raw: Array, values: Array, stamps: Stamps, ends: tuple[float, float]) -> list[Flag]:
    """The numbers of a measured signal that are no measurement, a flag each; seconds count from the first stamp.

    Such a number is the lowest or highest, recurs exactly, lies further from all others than they lie apart and than they lie
    from zero, and is no position of the axis. A sensor that moves there passes values in between. Commands are not examined:
    they jump.

    Args:
        raw: as in the file, (n,).
        values: the same in SI, NaN where there is none, (n,).
        stamps: in nanoseconds, (n,).
        ends: range of the axis in SI; infinite where it is not known.
    """
    if signal.endswith(".command"):
        return []
    found: list[Flag] = []
    left = np.isfinite(raw) & np.isfinite(values)
    while (apart := _apart(raw, left)) is not None:
        numbers, (low, high) = apart
        for number in numbers:
            own = left & (raw == number)
            rows = np.flatnonzero(own)
            left &= ~own
            there = float(values[rows[0]])
            if np.isfinite(ends).all() and ends[0] <= there <= ends[1]:
                continue
            text = f"{number:.10g} stands in {len(rows)} samples, apart from all others ({low:.4g} to {high:.4g})"
            begin, end = ((stamps[rows[[0, -1]]] - stamps[0]) * 1e-9).tolist()
            found.append(Flag(signal, "sentinel", float(begin), float(end), len(rows), text))
    return found


def _apart(raw: Array, left: Mask) -> tuple[list[float], tuple[float, float]] | None:
    """The lowest, the highest or both numbers, where they recur and lie apart from all others, and the range of these."""
    if np.count_nonzero(left) < LEAST + LEAST_OTHERS:
        return None
    often = [number for number in _range(raw, left) if np.count_nonzero(left & (raw == number)) >= LEAST]
    for numbers in ([number] for number in often) if len(often) < 2 else (often[:1], often[1:], often):
        others = left & ~np.isin(raw, numbers)
        if np.count_nonzero(others) < LEAST_OTHERS:
            continue
        low, high = _range(raw, others)
        distance = min(max(low - number, number - high) for number in numbers)
        if low < high and distance > max(high - low, abs(low), abs(high)):
            return numbers, (low, high)
    return None


def _range(values: Array, mask: Mask) -> tuple[float, float]:
    low, high = np.fmin.reduce(values, where=mask, initial=np.inf), np.fmax.reduce(values, where=mask, initial=-np.inf)
    return float(low), float(high)


def repaired_stamps(signal: str, stamps: Stamps) -> list[Flag]:
    """Stamps that go back or repeat, as one flag; seconds count from the earliest of ``stamps`` (n,) [ns], as in the file."""
    steps = np.diff(stamps)
    back = np.flatnonzero(steps < 0)
    ordered = np.sort(stamps)
    double = ordered[1:][np.diff(ordered) == 0]
    if not len(back) and not len(double):
        return []
    concerned = (np.concatenate([stamps[back], stamps[back + 1], double]) - ordered[0]) * 1e-9
    parts = []
    if len(back):
        parts.append(f"{len(back)} stamps go back, by up to {-1e-6 * float(steps.min()):.3f} ms: sorted")
    if len(double):
        parts.append(f"{len(double)} rows have the stamp of another: dropped")
    count = len(back) + len(double)
    return [Flag(signal, "stamps", float(concerned.min()), float(concerned.max()), count, "; ".join(parts))]


def dropouts(samples: SignalSamples) -> list[Flag]:
    """Gaps longer than their limit between two known samples, which are not bridged."""
    there = replace(samples, times=chosen(samples.times, np.isfinite(samples.values)))
    steps = differences(there.times)
    long = np.flatnonzero(steps > samples.limit_s + 1e-9)
    period = median(copied(steps)) if len(long) else 0.0
    found = []
    for index in long.tolist():
        lost = max(round(float(steps[index]) / period) - 1, 1)
        found.append(there.flag("dropout", index, index + 1, f"no sample for {steps[index]:.3f} s", lost))
    return merged(found)


#: Stamps are uneven where the central 90 % of the intervals spread over more than this share of the median. Below it the time
#: of a sample is known to a quarter of a period.
JITTER_SHARE = 0.5
#: Least number of intervals for a check of evenness.
MIN_INTERVALS = 20


def jitter(samples: SignalSamples) -> list[Flag]:
    """Uneven stamps, as one flag over all of them, without gaps; a step over lost samples counts once."""
    steps = differences(samples.times)
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
    return [samples.flag("jitter", 0, len(samples.times) - 1, f"uneven stamps: {spread}", off)]
