"""Faulty values of a channel: numbers that stand for "no value", outliers of a few samples, jumps from one sample to the next,
and stuck or saturated sensors.

Outliers and jumps are compared with the sensor's noise and the steps around them: in a fast motion, neighbouring samples move
as well. A sensor with noise never repeats a value many times. A quantised or noiseless one does whenever the machine is at
rest, so it is only checked while the machine is commanded well beyond any dead-band.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import absolute, counted, differences, masked, median, median_step, stretches
from sysid.datasets.flags.flag import Array, Flag, Mask, merged, with_unit
from sysid.machine import Machine
from sysid.scratch import chosen, computed, pieces
from sysid.signals import split_signal

#: Least number of samples with exactly this number, and of others.
LEAST, LEAST_OTHERS = 3, 10


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


def sentinels(signal: str, raw: Array, values: Array, stamps: npt.NDArray[np.int64], ends: tuple[float, float]) -> list[Flag]:
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
    ends = [float(np.fmin.reduce(raw, where=left, initial=np.inf)), float(np.fmax.reduce(raw, where=left, initial=-np.inf))]
    often = [number for number in ends if np.count_nonzero(left & (raw == number)) >= LEAST]
    for numbers in ([number] for number in often) if len(often) < 2 else (often[:1], often[1:], often):
        others = left & ~np.isin(raw, numbers)
        if np.count_nonzero(others) < LEAST_OTHERS:
            continue
        low, high = (
            float(np.fmin.reduce(raw, where=others, initial=np.inf)),
            float(np.fmax.reduce(raw, where=others, initial=-np.inf)),
        )
        distance = min(max(low - number, number - high) for number in numbers)
        if low < high and distance > max(high - low, abs(low), abs(high)):
            return numbers, (low, high)
    return None


#: Longest outlier [samples]; a longer one is two jumps.
SPIKE_SAMPLES = 5
#: Steps on each side with which an outlier or a jump is compared.
AROUND = 5
#: Least distance of an outlier from the line between its neighbours, in standard deviations of the noise. In Gaussian noise
#: that distance has a standard deviation of 1.22 σ, so that this is 6.5 of them: one false alarm in 10¹⁰ samples.
SPIKE_NOISE = 8.0
#: The same for a jump: its sides are not averaged, and real jumps are far larger.
JUMP_NOISE = 12.0
#: Least size of both in steps of a quantised sensor, whose neighbours differ by one step.
STEPS_OF_SENSOR = 4.0
#: Least ratio of an outlier to the steps around it.
SPIKE_RATIO = 3.0
#: The same for a jump: the largest of ten noisy steps is 2.4 σ, and a motion that begins with a jerk continues as fast.
JUMP_RATIO = 6.0
#: A change is a multiple of a sensor's step within this share of it; share of all changes that have to be multiples.
COUNT_SLACK, COUNTED = 0.05, 0.95
#: Steps across more sample periods are not compared.
GAP_PERIODS = 3.0
#: A jump and a jump back of the same size within this share are one flag if less than this time is between them [s].
BACK_SHARE, BACK_S = 0.3, 20.0
#: Candidates that are processed together.
_BATCH = 2**16


def noise_scale(values: Array) -> float:
    """Standard deviation of the noise about the line between two neighbours, by the median; 0 where most samples repeat."""
    if len(values) < 3:
        return 0.0
    middle = computed(len(values) - 2, lambda a, b: values[a + 1 : b + 1] - 0.5 * (values[a:b] + values[a + 2 : b + 2]))
    return float(1.4826 * median(absolute(middle)) / np.sqrt(1.5))


def sensor_step(values: Array) -> float:
    """Quantisation step of the sensor; 0 where it is not quantised.

    The smallest change, if almost all changes are whole multiples of it; with noise, one in ten is by chance.
    """
    changes = absolute(differences(values))
    changes = chosen(changes, changes > 1e-9 * float(np.ptp(values))) if len(values) else changes
    if len(changes) < 3:
        return 0.0
    step = float(changes.min())
    whole = 0
    for first, last in pieces(len(changes)):
        counts = changes[first:last] / step
        whole += int(np.count_nonzero(np.abs(counts - np.round(counts)) < COUNT_SLACK))
    return step if whole / len(changes) > COUNTED else 0.0


def outliers(signal: str, times: Array, values: Array, unit: str = "1") -> list[Flag]:
    """One to :data:`SPIKE_SAMPLES` samples far from the line between their neighbours.

    Args:
        signal: its name.
        times: increasing, (n,) [s].
        values: (n,); NaN is skipped.
        unit: of the values, for the text.
    """
    known = ~np.isnan(values)
    times, values = chosen(times, known), chosen(values, known)
    found: list[Flag] = []
    if len(times) < 2 * AROUND + SPIKE_SAMPLES + 2:
        return found
    floor = max(SPIKE_NOISE * noise_scale(values), STEPS_OF_SENSOR * sensor_step(values))
    if floor <= 0.0:
        floor = 1e-9 * float(np.ptp(values))
    period = median_step(times)
    steps = absolute(differences(values))
    # The line between the ends rises by at most a third of the outlier (SPIKE_RATIO), so the step into the outlier is larger.
    begins = np.flatnonzero(steps > (1.0 - 1.0 / SPIKE_RATIO) * floor)
    taken = np.zeros(len(values), dtype=bool)
    parts = [begins[first : first + _BATCH] for first in range(0, len(begins), _BATCH)]
    for length, begins in ((length, part) for length in range(1, SPIKE_SAMPLES + 1) for part in parts):
        before = begins[(begins >= AROUND) & (begins < len(steps) - AROUND - length)]
        after = before + length + 1
        whole = times[after] - times[before] <= GAP_PERIODS * (length + 1) * period
        before, after = before[whole], after[whole]
        off = _least_distance(times, values, before, length)
        high = np.flatnonzero(off > np.maximum(floor, SPIKE_RATIO * np.abs(values[after] - values[before]) / length))
        sides = np.concatenate([np.arange(-AROUND, 0), length + 1 + np.arange(AROUND)])
        # Without the two largest steps around, which may be those of another outlier.
        usual = np.sort(steps[before[high][:, None] + sides], axis=1)[:, -3]
        alone = off[high] > SPIKE_RATIO * usual
        for index, step in zip(high[alone], usual[alone], strict=True):
            first, last = before[index] + 1, after[index]
            if not taken[first:last].any():
                taken[first:last] = True
                size, around = with_unit(float(off[index]), unit), with_unit(float(step), unit)
                text = f"{_count(length)} off by {size}, the steps around are {around}"
                found.append(Flag(signal, "outlier", float(times[first]), float(times[last - 1]), length, text))
    return merged(sorted(found, key=lambda flag: flag.from_s))


def _least_distance(times: Array, values: Array, before: np.typing.NDArray[np.intp], length: int) -> Array:
    """Least distance of the ``length`` samples after ``before`` from the line between the samples on both sides, (m,)."""
    after = before + length + 1
    slope = (values[after] - values[before]) / (times[after] - times[before])
    least = np.full(len(before), np.inf)
    sides = np.zeros((2, len(before)), dtype=bool)
    for offset in range(1, length + 1):
        away = values[before + offset] - values[before] - slope * (times[before + offset] - times[before])
        least = np.minimum(least, np.abs(away))
        sides |= np.stack([away > 0, away < 0])
    least[sides.all(axis=0)] = 0.0
    return least


def jumps(signal: str, times: Array, values: Array, unit: str = "1") -> list[Flag]:
    """Steps between two samples far larger than those around: swapped markers, a slipped or wrapped sensor, lost counts.

    Arguments as for :func:`outliers`. A jump and the one back are one flag.
    """
    known = ~np.isnan(values)
    times, values = chosen(times, known), chosen(values, known)
    if len(times) < 2 * AROUND + 2:
        return []
    floor = max(JUMP_NOISE * noise_scale(values), STEPS_OF_SENSOR * sensor_step(values), 1e-9 * float(np.ptp(values)))
    period = median_step(times)

    def rates(first: int, last: int) -> Array:
        spans = np.diff(times[first : last + 1])
        # Relative to its time step, the motion over a late message is not larger.
        size = np.diff(values[first : last + 1]) * (period / np.maximum(spans, period))
        size[spans > GAP_PERIODS * period] = 0.0
        return size

    size = computed(len(values) - 1, rates)
    far = np.flatnonzero(masked(len(size), lambda first, last: np.abs(size[first:last]) > floor))
    far = far[(far >= AROUND) & (far < len(size) - AROUND)]
    sides = np.concatenate([np.arange(-AROUND, 0), np.arange(1, AROUND + 1)])
    parts = [far[first : first + _BATCH] for first in range(0, len(far), _BATCH)]
    alone = [np.abs(size[part]) > JUMP_RATIO * np.abs(size[part[:, None] + sides]).max(axis=1) for part in parts]
    far = far[np.concatenate(alone)] if alone else far
    found: list[Flag] = []
    number = 0
    while number < len(far):
        step = int(far[number])
        by = float(values[step + 1] - values[step])
        first, last = step + 1, step + 1
        text = f"{'wraps' if _is_turn(by, unit) else 'jumps'} by {with_unit(by, unit)} between two samples"
        if number + 1 < len(far):
            back = int(far[number + 1])
            returned = float(values[back + 1] - values[back])
            if abs(by + returned) < BACK_SHARE * abs(by) and times[back] - times[step] < BACK_S:
                last, number = back, number + 1
                text += f" and back {times[back] - times[first]:.3f} s later"
        found.append(Flag(signal, "jump", float(times[first]), float(times[last]), last - first + 1, text))
        number += 1
    return merged(found)


def _is_turn(by: float, unit: str) -> bool:
    return unit == "rad" and abs(abs(by) - 2.0 * np.pi) < 0.1


def _count(length: int) -> str:
    return "a sample" if length == 1 else f"{length} samples"


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
