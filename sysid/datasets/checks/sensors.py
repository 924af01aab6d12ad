"""Checks of the values of a channel: outliers of a few samples, jumps between two samples, stuck and saturated sensors.

Outliers and jumps are compared with the sensor's noise and the steps around them: in a fast motion, neighbouring samples move
as well. A sensor with noise never repeats a value many times. A quantised or noiseless one does whenever the machine is at
rest, so it is only checked while the machine is commanded well beyond any dead-band.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sysid.datasets.checks.finding import with_unit
from sysid.datasets.checks.flag import Flag, SignalSamples, merged
from sysid.datasets.chunked import Array, Mask, Rows, absolute, counted, differences, masked, median, median_step, stretches
from sysid.scratch import chosen, computed, pieces
from sysid.signals import split_signal

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


def outliers(samples: SignalSamples) -> list[Flag]:
    """One to :data:`SPIKE_SAMPLES` samples far from the line between their neighbours; missing values are skipped."""
    known = samples.known
    times, values = known.times, known.values
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
                size, around = (with_unit(float(each), samples.unit) for each in (off[index], step))
                count = "a sample" if length == 1 else f"{length} samples"
                text = f"{count} off by {size}, the steps around are {around}"
                found.append(known.flag("outlier", first, last - 1, text))
    return merged(sorted(found, key=lambda flag: flag.from_s))


def _least_distance(times: Array, values: Array, before: Rows, length: int) -> Array:
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


def jumps(samples: SignalSamples) -> list[Flag]:
    """Steps between two samples far larger than those around: swapped markers, a slipped or wrapped sensor, lost counts.

    A jump and the one back are one flag. Missing values are skipped. A speed jumps at an end stop and is not checked.
    """
    if split_signal(samples.signal)[1] == "speed":
        return []
    known = samples.known
    times, values = known.times, known.values
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
        turn = samples.unit == "rad" and abs(abs(by) - 2.0 * np.pi) < 0.1
        text = f"{'wraps' if turn else 'jumps'} by {with_unit(by, samples.unit)} between two samples"
        if number + 1 < len(far):
            back = int(far[number + 1])
            returned = float(values[back + 1] - values[back])
            if abs(by + returned) < BACK_SHARE * abs(by) and times[back] - times[step] < BACK_S:
                last, number = back, number + 1
                text += f" and back {times[back] - times[first]:.3f} s later"
        found.append(known.flag("jump", first, last, text))
        number += 1
    return merged(found)


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


def constant_values(samples: SignalSamples) -> list[Flag]:
    """Stretches of one value, a stuck or a saturated sensor: at the ends of its range the latter."""
    saturated = saturation(samples)
    alone = [flag for flag in stuck(samples) if not any(flag.from_s <= s.to_s and s.from_s <= flag.to_s for s in saturated)]
    return [*alone, *saturated]


def stuck(samples: SignalSamples) -> list[Flag]:
    """Stretches of one value while the machine is commanded."""
    times, values = samples.times, samples.values
    repeats = repeats_by_nature(samples)
    if repeats and split_signal(samples.signal)[1] == "speed":
        return []  # a quantised speed is constant in every steady motion
    low, high = (float(np.nanmin(values)), float(np.nanmax(values))) if np.isfinite(values).any() else (0.0, 0.0)
    margin = END_SHARE * (high - low)
    moving = samples.driven if repeats else samples.commanded
    found = []
    for first, last in _equal_runs(values):
        inside = moving[first:last]
        if not inside.any():
            continue
        value, seconds = float(values[first]), _longest(times[first:last], inside)
        if repeats:
            is_stuck = seconds >= STUCK_QUANTISED_S and low + margin < value < high - margin
        else:
            is_stuck = seconds >= STUCK_S and int(inside.sum()) >= STUCK_SAMPLES and low < value < high
        if is_stuck:
            lasted = times[last - 1] - times[first]
            text = f"stays at {with_unit(value, samples.unit)} for {lasted:.2f} s while the machine is commanded: "
            text += "a stuck sensor, or an axis that stalls" if repeats else "a stuck sensor"
            found.append(samples.flag("stuck", first, last - 1, text))
    return merged(found)


def saturation(samples: SignalSamples) -> list[Flag]:
    """Stretches at the lowest or highest value of the sensor.

    A quantised sensor is also constant at an end stop, so it is only flagged where the end of the axis is known and elsewhere,
    and the axis is driven.
    """
    times, values, ends = samples.times, samples.values, samples.ends
    finite = chosen(values, np.isfinite(values))
    if not len(finite):
        return []
    low, high = float(finite.min()), float(finite.max())
    if low == high:
        return []
    repeats = repeats_by_nature(samples)
    found = []
    for first, last in _equal_runs(values):
        value = float(values[first])
        if value not in (low, high):
            continue
        if repeats:
            if not np.isfinite(ends).all() or _longest(times[first:last], samples.driven[first:last]) < STUCK_QUANTISED_S:
                continue
            if min(abs(value - ends[0]), abs(value - ends[1])) < STOP_SHARE * (ends[1] - ends[0]):
                continue
        elif last - first < STUCK_SAMPLES or times[last - 1] - times[first] < STUCK_S:
            continue
        side = "highest" if value == high else "lowest"
        lasted = times[last - 1] - times[first]
        text = f"stays at its {side} value {with_unit(value, samples.unit)} for {lasted:.2f} s: the sensor's range ends"
        found.append(samples.flag("saturation", first, last - 1, text))
    return merged(found)


def repeats_by_nature(samples: SignalSamples) -> bool:
    """Whether equal neighbours are normal: the sensor is quantised, or has no noise where nothing is commanded."""
    values = samples.values
    finite = np.isfinite(values)
    if sensor_step(chosen(values, finite)) > 0.0:
        return True
    both = finite[1:] & finite[:-1]
    at_rest = both & ~samples.commanded[1:]
    checked = at_rest if np.count_nonzero(at_rest) >= 2 * STUCK_SAMPLES else both
    equal = counted(len(both), lambda a, b: (values[a + 1 : b + 1] == values[a:b]) & checked[a:b])
    count = int(np.count_nonzero(checked))
    return count > 0 and equal / count > REPEATS


def _equal_runs(values: Array) -> Iterator[tuple[int, int]]:
    """Stretches (first, last + 1) of at least :data:`STUCK_SAMPLES` equal values."""
    first, last = stretches(values[1:] == values[:-1])
    return ((int(first[k]), int(last[k]) + 1) for k in np.flatnonzero(last - first >= STUCK_SAMPLES - 1))


def _longest(times: Array, mask: Mask) -> float:
    """The longest time without a break in ``mask`` [s]."""
    return max((float(times[b - 1] - times[a]) for a, b in zip(*stretches(mask), strict=True)), default=0.0)
