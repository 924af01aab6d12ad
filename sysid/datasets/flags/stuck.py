"""Sensors that stand where they should not: stuck while the machine moves, or at the end of what they can show.

A sensor whose noise shows never gives the very same value many times in a row. One that counts in steps, or a noiseless one,
does whenever the machine stands still: it is only doubted while the machine is commanded well beyond any dead-band.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid.datasets.flags.flag import Array, Flag, Mask, shown, thinned
from sysid.datasets.flags.values import sensor_step
from sysid.datasets.in_pieces import counted, stretches
from sysid.scratch import chosen

#: A noisy sensor that repeats its value this often, and this long, is stuck [samples, s]; ten equal values of a sensor that
#: repeats one value in five by chance happen once in 10⁷.
STUCK_SAMPLES, STUCK_S = 10, 0.1
#: A counting sensor is doubted when it repeats its value for this long while its axis is well commanded [s]: longer than dead
#: times and lags of valve-driven machines.
STUCK_COUNTING_S = 1.0
#: More equal neighbours than this (share of those at rest) and a sensor counts as one that repeats.
REPEATS = 0.2
#: Nearer to its own extremes than this share of its range, a sensor may stand at an end stop.
END_SHARE = 0.01
#: As near to a known end of the axis as this share of its range, it stands at the end stop.
STOP_SHARE = 0.02


@dataclass(frozen=True)
class SensorContext:
    """What else is known at the times of a sensor, (n,) each.

    Args:
        commanded: something that moves the sensor is commanded at all.
        driven: … by so much that it has to move.
    """

    commanded: Mask
    driven: Mask


def stuck(signal: str, times: Array, values: Array, witness: SensorContext, unit: str = "1") -> list[Flag]:
    """Stretches of the very same value while the machine is commanded.

    Args:
        signal: its name.
        times: rising, (n,) [s].
        values: (n,), NaN where missing.
        witness: whether there is anything to see.
        unit: of the values, for the text.
    """
    found = []
    repeats = repeats_by_nature(values, witness)
    low, high = (float(np.nanmin(values)), float(np.nanmax(values))) if np.isfinite(values).any() else (0.0, 0.0)
    margin = END_SHARE * (high - low)
    moving = witness.driven if repeats else witness.commanded
    for first, last in _equal_runs(values):
        value = float(values[first])
        inside = moving[first:last]
        if not inside.any():
            continue
        seconds = _longest(times[first:last], inside)
        if repeats:
            doubted = seconds >= STUCK_COUNTING_S and low + margin < value < high - margin
        else:
            doubted = seconds >= STUCK_S and int(inside.sum()) >= STUCK_SAMPLES and low < value < high
        if doubted:
            text = f"stays at {shown(value, unit)} for {times[last - 1] - times[first]:.2f} s while the machine is commanded: "
            text += "a stuck sensor, or an axis that stalls" if repeats else "a stuck sensor"
            found.append(Flag(signal, "stuck", float(times[first]), float(times[last - 1]), last - first, text))
    return thinned(found)


def saturation(
    signal: str,
    times: Array,
    values: Array,
    witness: SensorContext,
    ends: tuple[float, float] = (-np.inf, np.inf),
    unit: str = "1",
) -> list[Flag]:
    """Stretches at the lowest or highest value the sensor ever shows.

    Arguments as for :func:`stuck`; ``ends`` are those of the axis. A sensor that counts in steps stands still at an end stop as
    well: it is only flagged where the end of the axis is known, lies elsewhere, and the axis is commanded.
    """
    finite = chosen(values, np.isfinite(values))
    if not len(finite):
        return []
    low, high = float(finite.min()), float(finite.max())
    if low == high:
        return []
    repeats = repeats_by_nature(values, witness)
    found = []
    for first, last in _equal_runs(values):
        value = float(values[first])
        if value not in (low, high):
            continue
        if repeats:
            if not np.isfinite(ends).all() or _longest(times[first:last], witness.driven[first:last]) < STUCK_COUNTING_S:
                continue
            if min(abs(value - ends[0]), abs(value - ends[1])) < STOP_SHARE * (ends[1] - ends[0]):
                continue
        elif last - first < STUCK_SAMPLES or times[last - 1] - times[first] < STUCK_S:
            continue
        side = "highest" if value == high else "lowest"
        lasted = times[last - 1] - times[first]
        text = f"stays at its {side} value {shown(value, unit)} for {lasted:.2f} s: the sensor's range ends"
        found.append(Flag(signal, "saturation", float(times[first]), float(times[last - 1]), last - first, text))
    return thinned(found)


def repeats_by_nature(values: Array, witness: SensorContext) -> bool:
    """Whether equal neighbours mean nothing: the sensor counts in steps, or shows no noise where nothing is commanded."""
    finite = np.isfinite(values)
    if sensor_step(chosen(values, finite)) > 0.0:
        return True
    both = finite[1:] & finite[:-1]
    at_rest = both & ~witness.commanded[1:]
    looked_at = at_rest if np.count_nonzero(at_rest) >= 2 * STUCK_SAMPLES else both
    equal = counted(len(both), lambda a, b: (values[a + 1 : b + 1] == values[a:b]) & looked_at[a:b])
    looked = int(np.count_nonzero(looked_at))
    return looked > 0 and equal / looked > REPEATS


def _equal_runs(values: Array) -> list[tuple[int, int]]:
    """Stretches (first, last + 1) of at least :data:`STUCK_SAMPLES` equal values."""
    first, last = stretches(values[1:] == values[:-1])
    long = np.flatnonzero(last - first >= STUCK_SAMPLES - 1)
    return [(int(first[k]), int(last[k]) + 1) for k in long]


def _longest(times: Array, mask: Mask) -> float:
    """The longest time without a break in ``mask`` [s]."""
    return max((float(times[b - 1] - times[a]) for a, b in zip(*stretches(mask), strict=True)), default=0.0)
