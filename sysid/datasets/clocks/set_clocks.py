"""Stamps of a clock that was set back, or overflowed, while it recorded: distinguished from late messages, and continued.

Stamps after a step back are shifted so that they follow the previous ones by one sample period. If the device paused, its
offset steps there, and the motion shows by how much: see :mod:`sysid.datasets.clocks.resets`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.logs import Stream

Stamps = npt.NDArray[np.int64]
Rows = npt.NDArray[np.intp]

#: A step back of fewer periods is a late message, since such a small reset cannot be distinguished from one.
LATE_PERIODS = 5.0
#: A step back is a reset where the interval that it repeats holds this multiple of the samples that fit into it.
CROWDED = 1.5
#: A larger step back is never a late message [s].
MAX_LATE_S = 1.0
#: Stamps that go back in more than this share of the rows are unordered, since no clock is set so often.
MAX_BACK_SHARE = 0.01
#: Periods of counters: 16, 24 and 32 bits of nanoseconds, microseconds, tenths of milliseconds and milliseconds [ns].
WRAPS = tuple(sorted({(1 << bits) * unit for bits in (16, 24, 32) for unit in (1, 1_000, 100_000, 1_000_000)}))


@dataclass(frozen=True)
class ContinuedClock:
    """Stamps (n,) in the order of the file, continued over every step back.

    Args:
        stamps: including late and duplicate ones.
        rows: where the clock was set back, or its counter overflowed.
        back_ns: size of these steps [ns].
        wrapped: which of these steps are overflows.
        stray: number of single stamps far from their neighbours, which were replaced by the previous stamp.
    """

    stamps: Stamps
    rows: tuple[int, ...] = ()
    back_ns: tuple[int, ...] = ()
    wrapped: tuple[bool, ...] = ()
    stray: int = 0

    @property
    def texts(self) -> tuple[str, ...]:
        """Report of the changes."""
        texts: list[str] = []
        for row, back, wrapped in zip(self.rows, self.back_ns, self.wrapped, strict=True):
            at = f"row {row + 1}, {(int(self.stamps[row]) - int(self.stamps[0])) * 1e-9:.3f} s after the first"
            why = "a counter overflowed" if wrapped else "the clock was set"
            texts.append(f"stamps go back by {back * 1e-9:.3f} s in {at} ({why}): continued")
        if len(texts) > 3:
            texts = [texts[0], f"and {len(texts) - 1} times more, {sum(self.wrapped)} of all because a counter overflowed"]
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
    steps = sorted([(int(row), True) for row in wraps] + [(int(row), False) for row in rows])
    back = tuple(int(stamps[row - 1] - stamps[row]) for row, _ in steps)
    return ContinuedClock(
        unwrapped + shift, tuple(row for row, _ in steps), back, tuple(w for _, w in steps), int(np.count_nonzero(stray))
    )


def with_continued_stamps(streams: Sequence[Stream], clock: str | None, machine: bool) -> tuple[Stream, ...]:
    """Streams of one file with a continued ``clock`` (the default one if None); their losses report the changes.

    The machine's own clock is only unwrapped, because after a reset of it the elapsed time is unknown.
    """
    done: dict[bytes, ContinuedClock] = {}
    result = []
    for stream in streams:
        name = clock if clock is not None else next(iter(stream.stamps), "")
        stamps = stream.stamps.get(name)
        if stamps is None or not _seldom_back(stamps):
            result.append(stream)
            continue
        key = stamps.tobytes()
        found = done.setdefault(key, continued(stamps))
        if found.stamps is stamps or (machine and not all(found.wrapped)):
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


def _stray(stamps: Stamps, period: float) -> npt.NDArray[np.bool_]:
    """Mask of single stamps far from their neighbours, which fit each other."""
    stray = np.zeros(len(stamps), dtype=bool)
    before, own, after = stamps[:-2], stamps[1:-1], stamps[2:]
    fits = (after > before) & (after - before < LATE_PERIODS * period)
    far = (own < before - MAX_LATE_S * 1e9) | (own > after + MAX_LATE_S * 1e9)
    stray[1:-1] = fits & far
    return stray


def _unwrapped(stamps: Stamps, period: float) -> tuple[Stamps, list[int]]:
    """Stamps with overflows of a counter undone, and the rows of the overflows."""
    steps = np.diff(stamps)
    added, rows = np.zeros(len(stamps), dtype=np.int64), []
    for row in np.flatnonzero(steps < -MAX_LATE_S * 1e9):
        for wrap in WRAPS:
            if 0.0 < steps[row] + wrap <= LATE_PERIODS * period:
                added[row + 1 :] += wrap
                rows.append(int(row) + 1)
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
