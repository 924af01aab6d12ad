"""Outliers of a few samples, and jumps from one sample to the next.

Both are compared with the sensor's noise and the steps around them: in a fast motion, neighbouring samples move as well.
"""

from __future__ import annotations

import numpy as np

from sysid.datasets.chunked import absolute, differences, masked, median, median_step
from sysid.datasets.flags.flag import Array, Flag, merged, with_unit
from sysid.scratch import chosen, computed, pieces

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
