"""Resolution of a sensor: the steps between its readings, estimated from the readings without a fit.

Rounding to steps adds noise with a variance of a twelfth of the squared step (Widrow & Kollár, Quantization Noise, 2008, ch.
1). The steps are an effect where this exceeds the noise of the data sheet, or without a data sheet the other noise of the
readings. A signal that does not move shows no steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.quality.noise import ROUNDING, SMALLEST, is_still, noise_bound, white_noise
from sysid.datasets.recording import Recording
from sysid.effects import sensor_quantisation
from sysid.gap.excitation import identifiable_targets
from sysid.machine import KnownEffect
from sysid.plant import Plant

Array = npt.NDArray[np.float64]
QUANTISATION = sensor_quantisation.EFFECT.name

#: Least share of readings at whole multiples of a step, and largest distance from them [steps].
MIN_ON_LATTICE, MAX_DISTANCE = 0.95, 0.02
#: Least resultant of the readings' phases within a step: noise of a fifth of the step leaves 0.45.
RESULTANT = 0.4
#: Least resultant of the fundamental of a lattice, as a share of the largest of its harmonics: the grid of frequencies lowers a
#: peak by up to 3 %.
FUNDAMENTAL = 0.95
#: Least number of levels of a lattice; least number of steps over the range for readings with noise after rounding.
MIN_LEVELS, MIN_STEPS = 4, 60
#: Least change of a reading that moves, in standard deviations of the noise.
MOVES = 5.0
#: Quantiles of the changes between neighbouring readings that are tested as the step.
CHANGES = (0.0, 0.01, 0.05, 0.25, 0.5)
#: Changes of equal size that are a steady motion, and the largest share of the moving readings in those: midway between that of
#: rounded readings at all speeds, 0.4, and that of steady motions.
STEADY, MAX_STEADY = 5, 0.7
#: Least share of the changes that are single or double steps; interpolated tables have finer lattices.
MIN_SINGLE_STEPS = 0.01
#: Largest number of steps over the range, a power of two.
MAX_STEPS = 2**15
#: Half a unit of the ninth significant digit, the shortest format of numbers in logs.
DIGITS = 5e-9


@dataclass(frozen=True)
class CoarseSensor:
    """A sensor whose steps exceed its noise.

    Args:
        step, interval95: between two readings [SI unit of the signal].
        noise: standard deviation of the data sheet; without one, of the noise beside the rounding.
    """

    signal: str
    step: float
    interval95: tuple[float, float]
    noise: float

    @property
    def effect(self) -> KnownEffect:
        """The effect, for a plant."""
        return KnownEffect(QUANTISATION, self.signal, {"step": self.step})


def coarse_sensors(plant: Plant, recordings: Sequence[Recording], noise: Mapping[str, float]) -> tuple[CoarseSensor, ...]:
    """Sensors of drives and joints with steps that exceed their noise and that the plant does not have.

    Args:
        noise: by signal [SI]; used where it is that of the data sheet. Otherwise it includes the rounding, and the noise beside
            it is used instead.
    """
    found = []
    for signal, specified in noise.items():
        runs = [r for r in recordings if r.kind == "motion" and signal in r.signals]
        if not signal.endswith((".cylinder", ".joint")) or not runs or plant.effect(QUANTISATION, signal) is not None:
            continue
        if not identifiable_targets((signal,), recordings, plant.machine):
            continue
        parts = [r.values(signal) for r in runs]
        step, level = reading_step(parts), specified
        if step > 0.0 and signal not in plant.machine.noise:
            if not _has_single_steps(parts, step):
                continue
            level = _noise_beside([r for r in runs if not is_still(r.values(signal))], signal, step)
        if rounding(step) > level:
            found.append(CoarseSensor(signal, step, _interval(parts, step), level))
    return tuple(found)


def _has_single_steps(parts: Sequence[Array], step: float) -> bool:
    """Whether readings change by single steps, as at every slow start and stop."""
    changes = np.concatenate([np.abs(np.diff(part[~np.isnan(part)])) for part in parts])
    changes = changes[changes > 0.5 * step]
    return len(changes) > 0 and float(np.mean(changes < 2.5 * step)) >= MIN_SINGLE_STEPS


def _noise_beside(moving: Sequence[Recording], signal: str, step: float) -> float:
    """Standard deviation of the noise of a sensor beside the rounding to its steps.

    The larger of the deviation from the lattice (noise after rounding) and of the excess of the white noise over the error of
    rounding (noise before it).
    """
    parts = [r.values(signal) for r in moving]
    white = [white_noise(part, r.rate_hz) for part, r in zip(parts, moving, strict=True)]
    levels = [noise_bound(part) if np.isnan(level) else level for part, level in zip(parts, white, strict=True)]
    levels = [level for level in levels if np.isfinite(level)]
    ahead = max(float(np.median(levels)) ** 2 - rounding(step) ** 2, 0.0) if levels else 0.0
    return max(_off_lattice(parts, step), float(np.sqrt(ahead)))


def with_steps(plant: Plant, coarse: Sequence[CoarseSensor], noise: Mapping[str, float]) -> dict[str, float]:
    """Noise of every signal including rounding, where rounding is larger; an estimate from data includes it already."""
    steps = {item.signal: item.step for item in coarse}
    for signal in noise:
        known = plant.effect(QUANTISATION, signal)
        if known is not None:
            steps[signal] = float(known.parameters["step"])  # type: ignore[arg-type]
    levels = dict(noise)
    for signal, step in steps.items():
        if signal in levels and rounding(step) > levels[signal]:
            specified = signal in plant.machine.noise
            levels[signal] = float(np.hypot(levels[signal], rounding(step))) if specified else rounding(step)
    return levels


def rounding(step: float) -> float:
    """Standard deviation of the error of rounding to whole steps."""
    return float(step / np.sqrt(12.0))


def _interval(parts: Sequence[Array], step: float) -> tuple[float, float]:
    """95 % interval of the step: the slope of readings over their number of steps.

    At least what the digits of a log leave open: each end of the range is rounded to nine digits.
    """
    values = _readings(parts)
    whole = np.round((values - values[0]) / step)
    spread = _off_lattice(parts, step) / max(float(np.sqrt(np.sum((whole - whole.mean()) ** 2))), 1.0)
    digits = 2.0 * DIGITS * float(np.abs(values).max()) / max(float(np.ptp(whole)), 1.0)
    reach = max(1.96 * spread, digits)
    return step - reach, step + reach


def _off_lattice(parts: Sequence[Array], step: float) -> float:
    """Standard deviation of the readings about the nearest points of a lattice of any origin."""
    turns = np.exp(2j * np.pi * _readings(parts) / step)
    phase = float(np.angle(turns.mean())) if len(turns) else 0.0
    away = np.angle(turns * np.exp(-1j * phase))
    return float(np.sqrt(np.mean(away**2))) * step / (2.0 * np.pi) if len(turns) else 0.0


def reading_step(parts: Sequence[Array]) -> float:
    """The step between the readings of a sensor, apart from noise added after it; zero where there is none.

    Args:
        parts: readings of one sensor, one array a recording, NaN where missing; recordings in which it does not move are left
            out.
    """
    moving = [part for part in parts if not is_still(part)]
    step = _exact_step(moving) or _noisy_step(moving)
    return step if step > 0.0 and _changes_speed(moving, step) else 0.0


def _exact_step(parts: Sequence[Array]) -> float:
    """Step of readings without noise after rounding: from the least changes between neighbours, refined over all readings.

    A reading counts each time that it is reached, since any lattice contains the single level of a sensor at rest. Several low
    quantiles of the changes are tested, since a few readings may lie off the lattice, and the least distance of two levels,
    since a fast motion may never take a single step.
    """
    values = _readings(parts)
    least = ROUNDING * max(float(np.max(np.abs(values), initial=0.0)), SMALLEST)
    reached, changes = [], []
    for part in parts:
        known = part[~np.isnan(part)]
        change = np.abs(np.diff(known, prepend=np.inf))
        reached.append(known[change > least])
        changes.append(change[1:][change[1:] > least])
    levels, steps = np.concatenate([*reached, np.empty(0)]), np.concatenate([*changes, np.empty(0)])
    if not len(steps):
        return 0.0
    levels = levels - levels[0]
    found, gaps = 0.0, np.diff(np.unique(levels))
    for guess in (*np.quantile(steps, CHANGES, method="lower"), *gaps[gaps > least].min(initial=np.inf, keepdims=True)):
        step = float(guess)
        for _ in range(3):
            whole = np.round(levels / step)
            if not whole.any():
                break
            step = float(levels @ whole / (whole @ whole))
        whole = levels / step
        on_lattice = np.mean(np.abs(whole - np.round(whole)) < MAX_DISTANCE) > MIN_ON_LATTICE
        if on_lattice and len(np.unique(np.round(whole))) >= MIN_LEVELS:
            found = max(found, step)
    return found


def _changes_speed(parts: Sequence[Array], step: float) -> bool:
    """Whether readings move by changing numbers of steps: those of steady motions lie on a lattice of their speeds.

    A steady motion moves by the same number of steps from reading to reading. Rounded readings of a motion do so in a run of
    :data:`STEADY` changes only where its speed is within a fifth of a whole number of steps, two in five speeds.
    """
    steady, moving = 0, 0
    for part in parts:
        whole = np.round(np.diff(part[~np.isnan(part)]) / step)
        begins = np.flatnonzero(np.diff(whole, prepend=np.nan) != 0.0)
        lengths = np.diff(begins, append=len(whole))[whole[begins] != 0.0]
        moving += int(lengths.sum())
        steady += int(lengths[lengths >= STEADY].sum())
    return steady <= MAX_STEADY * moving


def _noisy_step(parts: Sequence[Array]) -> float:
    """The peak of the characteristic function of the readings in motion (Widrow & Kollár, Quantization Noise, 2008, ch. 4).

    Readings of a sensor without steps are spread smoothly over the travel, so that their phases within a small step cancel. At
    rest all readings are alike for any sensor, so that rest does not count.
    """
    values = _in_motion(parts)
    if len(values) < 5 * MIN_STEPS:
        return 0.0
    low, span = float(values.min()), float(np.ptp(values))
    if span <= 0.0:
        return 0.0
    # Cells of an eighth of the finest step, and four times the range, for a frequency axis that is finer than the peaks.
    cells = np.bincount(((values - low) / span * (8 * MAX_STEPS - 1)).astype(np.int64), minlength=8 * MAX_STEPS)
    resultants = np.abs(np.fft.rfft(cells, 32 * MAX_STEPS))[: 4 * MAX_STEPS] / len(values)
    resultants[: 4 * MIN_STEPS] = 0.0
    if float(resultants.max()) < RESULTANT:
        return 0.0
    # Readings in whole steps are in whole fractions of a step, too: the step is the first peak as high as any.
    first = int(np.argmax(resultants >= FUNDAMENTAL * resultants.max()))
    frequency = (first + int(np.argmax(resultants[first : first + 5]))) / 4.0 / span
    for reach in (0.25, 0.05, 0.01):  # in cycles over the range
        near = frequency + np.linspace(-reach, reach, 21) / span
        turns = np.exp(2j * np.pi * near[:, None] * (values - low))
        frequency = float(near[int(np.argmax(np.abs(turns.sum(axis=1))))])
    return 1.0 / frequency


def _in_motion(parts: Sequence[Array]) -> Array:
    """Readings that move by more than their noise, at more than a twentieth of the top speed of the signal in any recording."""
    ways = [np.abs(part[10:] - part[:-10]) for part in parts]
    most = max((float(np.nanmax(way)) for way in ways if len(way) and not np.isnan(way).all()), default=0.0)
    least = [max(0.05 * most, MOVES * float(np.nan_to_num(noise_bound(part)))) for part in parts]
    return _readings([part[5:-5][way > limit] for part, way, limit in zip(parts, ways, least, strict=True) if len(way)])


def _readings(parts: Sequence[Array]) -> Array:
    """All of them, without those that are missing."""
    values = np.concatenate([*parts, np.empty(0)])
    return np.asarray(values[~np.isnan(values)])
