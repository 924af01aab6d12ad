"""The steps in which a sensor reads, seen in its readings alone.

They are no matter of fitting: readings lie on a lattice, or they do not. What they cost is noise, of a twelfth of the squared
step (Widrow & Kollár, Quantization Noise, 2008, ch. 1). They are a finding where that is more than the data sheet promises, or
without a data sheet more than the noise that the readings show beside it. A signal that does not move has no steps.
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

#: Share of readings at whole multiples of a step, and how close to them [steps].
NEARLY_ALL, CLOSE = 0.95, 0.02
#: Least resultant of the readings' phases within a step: noise of a fifth of the step leaves 0.45.
RESULTANT = 0.4
#: Fewer levels than these are no lattice; with noise behind them, fewer steps than these over the whole range.
LEVELS, FEWEST = 4, 60
#: Quantiles of the changes between neighbouring readings that are tried as the step.
CHANGES = (0.0, 0.01, 0.05, 0.25, 0.5)
#: Share of the changes that are single or double steps of a sensor; tables made by interpolation have finer lattices.
SINGLE = 0.01
#: Most steps over the range that are looked for: a power of two.
MOST = 2**15


@dataclass(frozen=True)
class CoarseSensor:
    """A sensor whose steps exceed the noise that it is said to have, or shows beside them.

    Args:
        step, interval95: between two readings [SI unit of the signal].
        noise: standard deviation that the data sheet promises; without one, of what the readings show beside the rounding.
    """

    signal: str
    step: float
    interval95: tuple[float, float]
    noise: float

    @property
    def effect(self) -> KnownEffect:
        """The effect as a plant takes it."""
        return KnownEffect(QUANTISATION, self.signal, {"step": self.step})


def coarse_sensors(plant: Plant, recordings: Sequence[Recording], noise: Mapping[str, float]) -> tuple[CoarseSensor, ...]:
    """Sensors of drives and joints that read in steps which their noise does not explain and the plant does not know.

    Args:
        noise: by signal; believed where it is that of the data sheet. Else it holds the error of the steps themselves, and
            what the readings show beside them counts (:func:`noise_beside`).
    """
    found = []
    for signal, said in noise.items():
        runs = [r for r in recordings if r.kind == "motion" and signal in r.signals]
        parts = [r.values(signal) for r in runs]
        if not signal.endswith((".cylinder", ".joint")) or not parts or plant.effect(QUANTISATION, signal) is not None:
            continue
        if not identifiable_targets((signal,), recordings, plant.machine):
            continue
        step, level = reading_step(parts), said
        if step > 0.0 and signal not in plant.machine.noise:
            if not _goes_in_steps(parts, step):
                continue
            level = noise_beside([(r.values(signal), r.rate_hz) for r in runs], step)
        if rounding(step) > level:
            found.append(CoarseSensor(signal, step, _interval(parts, step), level))
    return tuple(found)


def _goes_in_steps(parts: Sequence[Array], step: float) -> bool:
    """Whether a sensor goes through its steps one by one, as at every slow start and stop."""
    changes = np.concatenate([np.abs(np.diff(part[~np.isnan(part)])) for part in parts])
    changes = changes[changes > 0.5 * step]
    return len(changes) > 0 and float(np.mean(changes < 2.5 * step)) >= SINGLE


def noise_beside(runs: Sequence[tuple[Array, float]], step: float) -> float:
    """Standard deviation of the noise of a sensor beside the rounding to its steps.

    The larger of what lies off the lattice (noise behind the rounding) and of what white noise exceeds the error of rounding by
    (noise ahead of it).

    Args:
        runs: readings (n,) and their rate [Hz], one pair a recording.
    """
    moving = [(values, rate) for values, rate in runs if not is_still(values)]
    told = [white_noise(values, rate) for values, rate in moving]
    levels = [noise_bound(values) if np.isnan(level) else level for (values, _), level in zip(moving, told, strict=True)]
    levels = [level for level in levels if np.isfinite(level)]
    ahead = max(float(np.median(levels)) ** 2 - rounding(step) ** 2, 0.0) if levels else 0.0
    return max(_off_lattice([values for values, _ in moving], step), float(np.sqrt(ahead)))


def with_steps(plant: Plant, coarse: Sequence[CoarseSensor], noise: Mapping[str, float]) -> dict[str, float]:
    """Noise of every signal with that of rounding, where it is the larger one; an estimate from data holds it already."""
    steps = {item.signal: item.step for item in coarse}
    for signal in noise:
        known = plant.effect(QUANTISATION, signal)
        if known is not None:
            steps[signal] = float(known.parameters["step"])  # type: ignore[arg-type]
    levels = dict(noise)
    for signal, step in steps.items():
        if signal in levels and rounding(step) > levels[signal]:
            told = signal in plant.machine.noise
            levels[signal] = float(np.hypot(levels[signal], rounding(step))) if told else rounding(step)
    return levels


def rounding(step: float) -> float:
    """Standard deviation of the error of rounding to whole steps."""
    return float(step / np.sqrt(12.0))


def _interval(parts: Sequence[Array], step: float) -> tuple[float, float]:
    """95 % interval of the slope of readings over their number of steps."""
    values = _readings(parts)
    whole = np.round((values - values[0]) / step)
    spread = _off_lattice(parts, step) / max(float(np.sqrt(np.sum((whole - whole.mean()) ** 2))), 1.0)
    reach = max(1.96 * spread, 1e-9 * step)
    return step - reach, step + reach


def _off_lattice(parts: Sequence[Array], step: float) -> float:
    """Standard deviation of the readings about the nearest points of a lattice, wherever its origin is."""
    turns = np.exp(2j * np.pi * _readings(parts) / step)
    phase = float(np.angle(turns.mean())) if len(turns) else 0.0
    away = np.angle(turns * np.exp(-1j * phase))
    return float(np.sqrt(np.mean(away**2))) * step / (2.0 * np.pi) if len(turns) else 0.0


def reading_step(parts: Sequence[Array]) -> float:
    """The step between the readings of a sensor, but for noise that came after it; zero where there is none.

    Args:
        parts: readings of one sensor, one array a recording, NaN where missing. Recordings in which it does not move say
            nothing: all that is there may be one reading, and rounding of floating-point numbers.
    """
    moving = [part for part in parts if not is_still(part)]
    return _exact_step(moving) or _noisy_step(moving)


def _exact_step(parts: Sequence[Array]) -> float:
    """The least change between neighbouring readings is a first guess, all of them together make it exact.

    Each reading counts once for every time that it is reached: where a sensor rests, one level is on every lattice. A few
    readings off the lattice leave changes of their own, so that the least ones are tried too.
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
    found = 0.0
    for guess in np.quantile(steps, CHANGES, method="lower"):
        step = float(guess)
        for _ in range(3):
            whole = np.round(levels / step)
            if not whole.any():
                break
            step = float(levels @ whole / (whole @ whole))
        whole = levels / step
        on_lattice = np.mean(np.abs(whole - np.round(whole)) < CLOSE) > NEARLY_ALL
        if on_lattice and len(np.unique(np.round(whole))) >= LEVELS:
            found = max(found, step)
    return found


def _readings(parts: Sequence[Array]) -> Array:
    values = np.concatenate([*parts, np.empty(0)])
    return np.asarray(values[~np.isnan(values)])


def _noisy_step(parts: Sequence[Array]) -> float:
    """The peak of the characteristic function of the readings in motion (Widrow & Kollár, Quantization Noise, 2008, ch. 4).

    Readings of a sensor without steps are spread smoothly over what was travelled, so that their phases within any small step
    cancel. Where the machine stands all readings are alike, whatever the sensor: rest does not count.
    """
    values = _in_motion(parts)
    if len(values) < 5 * FEWEST:
        return 0.0
    low, span = float(values.min()), float(np.ptp(values))
    if span <= 0.0:
        return 0.0
    # Cells of an eighth of the finest step, and four times the range, for a frequency axis that is finer than the peaks.
    cells = np.bincount(((values - low) / span * (8 * MOST - 1)).astype(np.int64), minlength=8 * MOST)
    resultants = np.abs(np.fft.rfft(cells, 32 * MOST))[: 4 * MOST] / len(values)
    resultants[: 4 * FEWEST] = 0.0
    if float(resultants.max()) < RESULTANT:
        return 0.0
    frequency = int(np.argmax(resultants)) / 4.0 / span
    for reach in (0.25, 0.05, 0.01):  # in cycles over the range
        near = frequency + np.linspace(-reach, reach, 21) / span
        turns = np.exp(2j * np.pi * near[:, None] * (values - low))
        frequency = float(near[int(np.argmax(np.abs(turns.sum(axis=1))))])
    return 1.0 / frequency


def _in_motion(parts: Sequence[Array]) -> Array:
    """Readings around which the sensor moved at more than a twentieth of its top speed in any of the recordings."""
    ways = [np.abs(part[10:] - part[:-10]) for part in parts]
    most = max((float(np.nanmax(way)) for way in ways if len(way) and not np.isnan(way).all()), default=0.0)
    readings = [part[5:-5][way > 0.05 * most] for part, way in zip(parts, ways, strict=True) if len(way)]
    values = np.concatenate([*readings, np.empty(0)])
    return np.asarray(values[~np.isnan(values)])
