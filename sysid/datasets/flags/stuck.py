"""Stuck and saturated sensors.

A sensor with noise never repeats a value many times. A quantised or noiseless one does whenever the machine is at rest, so it
is only checked while the machine is commanded well beyond any dead-band.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid.datasets.chunked import counted, stretches
from sysid.datasets.flags.flag import Array, Flag, Mask, merged, with_unit
from sysid.datasets.flags.values import sensor_step
from sysid.scratch import chosen
from sysid.signals import split_signal

#: A noisy sensor that repeats its value this often, and this long, is stuck [samples, s]; ten equal values of a sensor that
#: repeats one value in five have a probability of 10⁻⁷.
STUCK_SAMPLES, STUCK_S = 10, 0.1
#: A quantised sensor is stuck when it repeats its value for this long while its axis is driven [s]: longer than dead times and
#: lags of valve-driven machines.
STUCK_QUANTISED_S = 1.0
#: A sensor with a larger share of equal neighbours at rest repeats values by nature.
REPEATS = 0.2
#: Within this share of its range from its extremes a sensor may be at an end stop.
END_SHARE = 0.01
#: Within this share of the range from a known end of the axis it is at the end stop.
STOP_SHARE = 0.02


@dataclass(frozen=True)
class SensorContext:
    """Commands at the times of a sensor, (n,) each.

    Args:
        commanded: an axis that moves the sensor is commanded.
        driven: it is commanded by so much that it has to move.
    """

    commanded: Mask
    driven: Mask


def stuck(signal: str, times: Array, values: Array, context: SensorContext, unit: str = "1") -> list[Flag]:
    """Stretches of one value while the machine is commanded.

    Args:
        signal: its name.
        times: increasing, (n,) [s].
        values: (n,), NaN where missing.
        context: commands at these times.
        unit: of the values, for the text.
    """
    found = []
    repeats = repeats_by_nature(values, context)
    low, high = (float(np.nanmin(values)), float(np.nanmax(values))) if np.isfinite(values).any() else (0.0, 0.0)
    margin = END_SHARE * (high - low)
    if repeats and split_signal(signal)[1] == "speed":
        return []  # a quantised speed is constant in every steady motion
    moving = context.driven if repeats else context.commanded
    for first, last in _equal_runs(values):
        value = float(values[first])
        inside = moving[first:last]
        if not inside.any():
            continue
        seconds = _longest(times[first:last], inside)
        if repeats:
            is_stuck = seconds >= STUCK_QUANTISED_S and low + margin < value < high - margin
        else:
            is_stuck = seconds >= STUCK_S and int(inside.sum()) >= STUCK_SAMPLES and low < value < high
        if is_stuck:
            lasted = times[last - 1] - times[first]
            text = f"stays at {with_unit(value, unit)} for {lasted:.2f} s while the machine is commanded: "
            text += "a stuck sensor, or an axis that stalls" if repeats else "a stuck sensor"
            found.append(Flag(signal, "stuck", float(times[first]), float(times[last - 1]), last - first, text))
    return merged(found)


def saturation(
    signal: str,
    times: Array,
    values: Array,
    context: SensorContext,
    ends: tuple[float, float] = (-np.inf, np.inf),
    unit: str = "1",
) -> list[Flag]:
    """Stretches at the lowest or highest value of the sensor.

    Arguments as for :func:`stuck`; ``ends`` are those of the axis. A quantised sensor is also constant at an end stop, so it is
    only flagged where the end of the axis is known and elsewhere, and the axis is driven.
    """
    finite = chosen(values, np.isfinite(values))
    if not len(finite):
        return []
    low, high = float(finite.min()), float(finite.max())
    if low == high:
        return []
    repeats = repeats_by_nature(values, context)
    found = []
    for first, last in _equal_runs(values):
        value = float(values[first])
        if value not in (low, high):
            continue
        if repeats:
            if not np.isfinite(ends).all() or _longest(times[first:last], context.driven[first:last]) < STUCK_QUANTISED_S:
                continue
            if min(abs(value - ends[0]), abs(value - ends[1])) < STOP_SHARE * (ends[1] - ends[0]):
                continue
        elif last - first < STUCK_SAMPLES or times[last - 1] - times[first] < STUCK_S:
            continue
        side = "highest" if value == high else "lowest"
        lasted = times[last - 1] - times[first]
        text = f"stays at its {side} value {with_unit(value, unit)} for {lasted:.2f} s: the sensor's range ends"
        found.append(Flag(signal, "saturation", float(times[first]), float(times[last - 1]), last - first, text))
    return merged(found)


def repeats_by_nature(values: Array, context: SensorContext) -> bool:
    """Whether equal neighbours are normal: the sensor is quantised, or has no noise where nothing is commanded."""
    finite = np.isfinite(values)
    if sensor_step(chosen(values, finite)) > 0.0:
        return True
    both = finite[1:] & finite[:-1]
    at_rest = both & ~context.commanded[1:]
    checked = at_rest if np.count_nonzero(at_rest) >= 2 * STUCK_SAMPLES else both
    equal = counted(len(both), lambda a, b: (values[a + 1 : b + 1] == values[a:b]) & checked[a:b])
    count = int(np.count_nonzero(checked))
    return count > 0 and equal / count > REPEATS


def _equal_runs(values: Array) -> list[tuple[int, int]]:
    """Stretches (first, last + 1) of at least :data:`STUCK_SAMPLES` equal values."""
    first, last = stretches(values[1:] == values[:-1])
    long = np.flatnonzero(last - first >= STUCK_SAMPLES - 1)
    return [(int(first[k]), int(last[k]) + 1) for k in long]


def _longest(times: Array, mask: Mask) -> float:
    """The longest time without a break in ``mask`` [s]."""
    return max((float(times[b - 1] - times[a]) for a, b in zip(*stretches(mask), strict=True)), default=0.0)
