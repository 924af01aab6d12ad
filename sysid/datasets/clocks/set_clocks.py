"""Stamps of a clock that was set back, or rolled over, while it recorded: distinguished from late messages, and continued.

Counters overflow, the time of the day begins again at midnight, and that of GPS every week. Stamps after any other step back
are shifted so that they follow the previous ones by one sample period. If the device paused, its offset steps there, and the
motion shows by how much: see :mod:`sysid.datasets.clocks.resets`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.datasets.chunked import Mask, Rows, Stamps
from sysid.logs import Stream

#: A step back of fewer periods is a late message, since such a small reset cannot be distinguished from one.
LATE_PERIODS = 5.0
#: A step back is a reset where the interval that it repeats holds this multiple of the samples that fit into it.
CROWDED = 1.5
#: A larger step back is never a late message [s].
MAX_LATE_S = 1.0
#: Stamps that go back in more than this share of the rows are unordered, since no clock is set so often.
MAX_BACK_SHARE = 0.01
#: Periods after which stamps begin again [ns] → why: those of clocks, and of counters of 16, 24 and 32 bits of nanoseconds,
#: microseconds, tenths of milliseconds and milliseconds.
WRAPS = {
    3600 * 10**9: "a new hour",
    43_200 * 10**9: "noon or midnight",
    86_400 * 10**9: "midnight",
    604_800 * 10**9: "a new GPS week",
    **{(1 << bits) * unit: "a counter overflowed" for bits in (16, 24, 32) for unit in (1, 1_000, 100_000, 1_000_000)},
}


@dataclass(frozen=True)
class ContinuedClock:
    """Stamps (n,) in the order of the file, continued over every step back.

    Args:
        stamps: including late and duplicate ones.
        rows: where the clock was set back, or rolled over.
        back_ns: size of these steps [ns].
        periods_ns: after which the clock rolled over there, of :data:`WRAPS` [ns]; 0: it was set.
        stray: number of single stamps far from their neighbours, which were replaced by the previous stamp.
    """

    stamps: Stamps
    rows: tuple[int, ...] = ()
    back_ns: tuple[int, ...] = ()
    periods_ns: tuple[int, ...] = ()
    stray: int = 0

    @property
    def texts(self) -> tuple[str, ...]:
        """Report of the changes."""
        texts: list[str] = []
        for row, back, period in zip(self.rows, self.back_ns, self.periods_ns, strict=True):
            at = f"row {row + 1}, {(int(self.stamps[row]) - int(self.stamps[0])) * 1e-9:.3f} s after the first"
            why = WRAPS.get(period, "the clock was set")
            texts.append(f"stamps go back by {back * 1e-9:.3f} s in {at} ({why}): continued")
        if len(texts) > 3:
            over = sum(period > 0 for period in self.periods_ns)
            texts = [texts[0], f"and {len(texts) - 1} times more; in {over} of all the clock rolled over, else it was set"]
        if self.stray:
            texts.append(f"{self.stray} stamps far from their neighbours: their rows are dropped")
        return tuple(texts)


def continued(stamps: Stamps) -> ContinuedClock:
    """``stamps`` (n,) [ns] continued over steps back; the same array where there are none."""
    if len(stamps) < 3 or int(np.diff(stamps).min()) > 0:
        return ContinuedClock(stamps)
    period = _period(stamps)
    stray = _stray(stamps, period)
    if stray.any():
        stamps = stamps.copy()
        stamps[stray] = stamps[np.flatnonzero(stray) - 1]
    unwrapped, wraps = _unwrapped(stamps, period)
    rows = set_back_rows(unwrapped, period)
    shift = np.zeros(len(stamps), dtype=np.int64)
    for row in rows:
        before = int((unwrapped[:row] + shift[:row]).max())
        shift[row:] += before + round(period) - int(unwrapped[row] + shift[row])
    steps = sorted([*wraps, *((int(row), 0) for row in rows)])
    at, periods = tuple(row for row, _ in steps), tuple(period for _, period in steps)
    back = tuple(int(stamps[row - 1] - stamps[row]) for row in at)
    return ContinuedClock(unwrapped + shift, at, back, periods, int(np.count_nonzero(stray)))


def with_continued_stamps(streams: Sequence[Stream], clock: str | None, machine: bool) -> tuple[Stream, ...]:
    """Streams of one file with a continued ``clock`` (the default one if None); their losses report the changes.

    The machine's own clock is only unwrapped, because after a reset of it the elapsed time is unknown.
    """
    done: dict[bytes, ContinuedClock] = {}
    result = []
    for stream in streams:
        name = clock if clock is not None else next(iter(stream.stamps), "")
        stamps = stream.stamps.get(name)
        if stamps is None:
            result.append(stream)
            continue
        found = done.setdefault(stamps.tobytes(), continued(stamps)) if _seldom_back(stamps) else None
        if found is None or found.stamps is stamps or (machine and not all(found.periods_ns)):
            result.append(stream)
            continue
        losses = tuple(dict.fromkeys((*stream.losses, *found.texts)))
        result.append(replace(stream, stamps={**stream.stamps, name: found.stamps}, losses=losses))
    return tuple(result)


def _seldom_back(stamps: Stamps) -> bool:
    """Whether stamps go back, but not so often that they are unordered."""
    back = int(np.count_nonzero(stamps[1:] < stamps[:-1])) if len(stamps) > 2 else 0
    return 0 < back <= max(2.0, MAX_BACK_SHARE * len(stamps))


def _period(stamps: Stamps) -> float:
    """Median step forward [ns]."""
    steps = np.diff(stamps)
    forward = steps[steps > 0]
    return float(np.median(forward)) if len(forward) else 1.0


def _stray(stamps: Stamps, period: float) -> Mask:
    """Mask of single stamps far from their neighbours, which fit each other."""
    stray = np.zeros(len(stamps), dtype=bool)
    before, own, after = stamps[:-2], stamps[1:-1], stamps[2:]
    fits = (after > before) & (after - before < LATE_PERIODS * period)
    far = (own < before - MAX_LATE_S * 1e9) | (own > after + MAX_LATE_S * 1e9)
    stray[1:-1] = fits & far
    return stray


def _unwrapped(stamps: Stamps, period: float) -> tuple[Stamps, list[tuple[int, int]]]:
    """Stamps of a clock that does not roll over, and the rows where it did, with its period."""
    steps = np.diff(stamps)
    added, rows = np.zeros(len(stamps), dtype=np.int64), list[tuple[int, int]]()
    for row in np.flatnonzero(steps < -MAX_LATE_S * 1e9):
        for wrap in WRAPS:
            if 0.0 < steps[row] + wrap <= LATE_PERIODS * period:
                added[row + 1 :] += wrap
                rows.append((int(row) + 1, wrap))
                break
    return stamps + added, rows


def set_back_rows(stamps: Stamps, period: float | None = None) -> Rows:
    """Rows at which the clock was set back."""
    period = _period(stamps) if period is None else period
    found: list[int] = []
    first = 0  # of the segment
    highest = np.maximum.accumulate(stamps)
    for row in np.flatnonzero(np.diff(stamps) < 0) + 1:
        if row < first:
            continue
        top = int(stamps[first:row].max()) if first else int(highest[row - 1])
        back = top - int(stamps[row])
        if back <= LATE_PERIODS * period:
            continue
        passed = np.flatnonzero(stamps[row:] > top)
        again = int(passed[0]) if len(passed) else len(stamps) - row
        limit = min(top, int(stamps[row : row + again].max()))
        stretch = stamps[first : row + again]
        inside = int(np.count_nonzero((stretch >= stamps[row]) & (stretch <= limit)))
        room = (limit - int(stamps[row])) / period + 1.0
        if back > MAX_LATE_S * 1e9 or inside > CROWDED * room + np.sqrt(room):
            found.append(int(row))
            first = int(row)
    return np.array(found, dtype=np.intp)
