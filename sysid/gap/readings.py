"""The steps in which a sensor reads, seen in its readings alone.

They are no matter of fitting: readings lie on a lattice, or they do not. What they cost is noise, of a twelfth of the squared
step (Widrow & Kollár, Quantization Noise, 2008, ch. 1), that a data sheet which promises less does not explain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.machine import KnownEffect
from sysid.plant import Plant

Array = npt.NDArray[np.float64]

#: Share of readings at whole multiples of a step, and how close to them [steps].
NEARLY_ALL, CLOSE = 0.95, 0.02
#: Least resultant of the readings' phases within a step: noise of a fifth of the step leaves 0.45.
RESULTANT = 0.4
#: Fewer steps than these over the whole range are no steps of a sensor.
FEWEST = 60
#: Most steps over the range that are looked for: a power of two.
MOST = 2**15


@dataclass(frozen=True)
class Coarse:
    """A sensor whose steps exceed the noise that it is said to have.

    Args:
        step, interval95: between two readings [SI unit of the signal].
        noise: standard deviation that it is said to have.
    """

    signal: str
    step: float
    interval95: tuple[float, float]
    noise: float

    @property
    def effect(self) -> KnownEffect:
        """The effect as a plant takes it."""
        return KnownEffect("sensor_quantisation", self.signal, {"step": self.step})


def coarse_sensors(plant: Plant, recordings: Sequence[Recording], noise: Mapping[str, float]) -> tuple[Coarse, ...]:
    """Sensors of drives and joints that read in steps which their noise does not explain and the plant does not know."""
    found = []
    for signal, level in noise.items():
        parts = [r.values(signal) for r in recordings if r.kind == "motion" and signal in r.signals]
        if not signal.endswith((".cylinder", ".joint")) or not parts or plant.effect("sensor_quantisation", signal) is not None:
            continue
        step = reading_step(parts)
        if rounding(step) > level:
            found.append(Coarse(signal, step, _interval(parts, step), level))
    return tuple(found)


def with_steps(plant: Plant, coarse: Sequence[Coarse], noise: Mapping[str, float]) -> dict[str, float]:
    """Noise of every signal with that of rounding, where it is the larger one."""
    steps = {item.signal: item.step for item in coarse}
    for signal in noise:
        known = plant.effect("sensor_quantisation", signal)
        if known is not None:
            steps[signal] = float(known.parameters["step"])  # type: ignore[arg-type]
    return {
        s: float(np.hypot(level, rounding(steps[s]))) if rounding(steps.get(s, 0.0)) > level else level
        for s, level in noise.items()
    }


def rounding(step: float) -> float:
    """Standard deviation of the error of rounding to whole steps."""
    return float(step / np.sqrt(12.0))


def _interval(parts: Sequence[Array], step: float) -> tuple[float, float]:
    """95 % interval of the slope of readings over their number of steps."""
    values = np.concatenate(parts)
    values = values[~np.isnan(values)]
    whole = np.round(values / step)
    spread = float(np.std(values - step * whole)) / max(float(np.sqrt(np.sum((whole - whole.mean()) ** 2))), 1.0)
    reach = max(1.96 * spread, 1e-9 * step)
    return step - reach, step + reach


def reading_step(parts: Sequence[Array]) -> float:
    """The step of which the readings are whole multiples, but for noise that came after it; zero where there is none.

    Args:
        parts: readings of one sensor, one array a recording, NaN where missing.
    """
    return _exact_step(parts) or _noisy_step(parts)


def _exact_step(parts: Sequence[Array]) -> float:
    """The least change between neighbouring readings is a first guess, all of them together make it exact."""
    values = np.concatenate(parts)
    values = values[~np.isnan(values)]
    changes = np.concatenate([np.abs(np.diff(part)) for part in parts])
    changes = changes[changes > 1e-9 * float(np.max(np.abs(values), initial=0.0))]  # NaN is not greater either
    if not len(changes):
        return 0.0
    step = float(changes.min())
    for _ in range(3):
        whole = np.round(values / step)
        if not whole.any():
            return 0.0
        step = float(values @ whole / (whole @ whole))
    return step if np.mean(np.abs(values / step - np.round(values / step)) < CLOSE) > NEARLY_ALL else 0.0


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
