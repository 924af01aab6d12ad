"""What is periodic in a residual: ripples over a variable, disturbances periodic in time, and a resonance.

A ripple ``size·sin(2π·f·z)`` over a variable z is found by a least-squares periodogram (Lomb 1976; Scargle 1982). It passes the
filter of the target (:class:`sysid.gap.unnamed.residual_series.ResidualSeries`) and its prewhitening before it is compared, so
that the amplitude of a ripple with a short period is not underestimated.

The phase of a disturbance that is periodic in time, independent of the motion (a pump, another machine), differs between
recordings. Its period is therefore searched over all recordings with one phase per recording, and validated on each recording
left out of the search: the phase is fitted to its first half, and its second half is predicted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from sysid.compiled import kernel
from sysid.datasets.recording import Recording
from sysid.gap.likelihood.discrepancy.shapes import filled
from sysid.gap.problem import Problem
from sysid.gap.unnamed.residual_series import (
    PARTS,
    Factor,
    ResidualSeries,
    Term,
    modulations,
    quasi_difference,
    ripple,
    share_explained,
)
from sysid.plant.model import in_parallel

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]

#: Least and largest number of periods inside the span of the variable, the largest of a disturbance in one recording, and
#: search steps per period.
MIN_CYCLES, MAX_CYCLES, MAX_CYCLES_IN_TIME, STEPS = 0.7, 60, 300, 6
#: Least number of entries of a recording in which a period is searched.
MIN_ENTRIES = 20
#: Length of the segments over which spectra are averaged [s]: a frequency resolution of 0.05 Hz.
SEGMENT = 20.0
#: Below this frequency [Hz] drift and motion look like an oscillation.
MIN_FREQUENCY = 0.2
#: A peak with less than this share of the power of the simulated motion at that frequency is attributed to the motion.
MIN_POWER_RATIO = 0.25
#: Half-width of a peak relative to its frequency, and least share of the power above the minimum frequency that it contains.
WIDTH, MIN_SHARE = 0.15, 0.5
#: A longer gap [rows] ends a stretch of a spectrum.
MAX_GAP = 4


@dataclass(frozen=True)
class Periodogram:
    """Periodogram of one series with a common phase.

    Args:
        z, size: the variable and the modulation at all parts of bins, one block after the other (p,).
        begin: where the parts of each entry begin (n,); those of the entry before it end there.
        weights: of the parts in an entry.
        y: prewhitened residual of each entry, its mean zero (n,).
    """

    z: Array
    size: Array
    begin: Rows
    weights: Array
    ar1: float
    y: Array

    @classmethod
    def of(
        cls, series: Sequence[ResidualSeries], variable: str, modulation: tuple[Factor, ...], ar1: float, y: Array
    ) -> Periodogram:
        """That of ``y``, given where the prewhitened residual of ``series`` is measured, over one of their variables."""
        begin, ends = list[Rows](), 0
        for part in series:
            measured = np.isfinite(quasi_difference(part.target, ar1))
            begin.append(ends + PARTS * (np.flatnonzero(measured) + 1))  # the first entry of a series has none before it
            ends += len(part.variables[variable])
        z = np.concatenate([part.variables[variable] for part in series])
        size = np.concatenate([Term(modulation).values(part) for part in series])
        return cls(z, size, np.concatenate(begin).astype(np.int64), series[0].weights, ar1, y)

    def powers(self, first: float, step: float, count: int) -> Array:
        """Explained sum of squares at the frequencies ``first + k·step``, (count,)."""
        share = _shares(self.z, self.size, self.begin, self.weights, self.ar1, self.y, first, step, count)
        return np.asarray(share) * float(self.y @ self.y)


@dataclass(frozen=True)
class Frequencies:
    """The frequencies ``first + k·step`` for k < ``count``."""

    first: float
    step: float
    count: int

    @classmethod
    def of(cls, span: float, increments: Array, max_cycles: int = MAX_CYCLES) -> Frequencies | None:
        """Those to search; None where the span is too short.

        Args:
            span: range of the variable.
            increments: change of the variable from one part of a bin to the next; while it moves, a period lasts at least two
                bins.
            max_cycles: largest number of periods inside the span.
        """
        increments = increments[increments > 0.02 * increments.max(initial=0.0)]
        if not span > 0.0 or not len(increments):
            return None
        lowest, step = MIN_CYCLES / span, 1.0 / (STEPS * span)
        count = int((min(max_cycles / span, 1.0 / (2.0 * PARTS * float(np.median(increments)))) - lowest) / step)
        return cls(lowest, step, count) if count >= 3 else None


def searched(periodograms: Sequence[Periodogram], at: Frequencies) -> list[Array]:
    """Explained sums of squares of each of ``periodograms``, (count,) each; on all cores."""
    found = [np.empty(0)] * len(periodograms)

    def one(k: int) -> None:
        found[k] = periodograms[k].powers(at.first, at.step, at.count)

    in_parallel(one, len(periodograms), at.count * max((len(p.y) for p in periodograms), default=0))
    return found


def best_period(periodograms: Sequence[Periodogram], curves: Sequence[Array], at: Frequencies) -> float:
    """The period that explains most, each of ``periodograms`` with its own phase.

    Args:
        curves: of each, from :func:`searched`.
    """
    peak = at.first + at.step * int(np.argmax(np.sum(curves, axis=0)))
    best = minimize_scalar(
        lambda f: -float(sum(w.powers(f, 0.0, 1)[0] for w in periodograms)),
        bounds=(peak - at.step, peak + at.step), method="bounded", options={"xatol": 2e-3 * at.step},
    )  # fmt: skip
    return 1.0 / float(best.x)


@kernel
def _shares(
    z: Array, size: Array, begin: Rows, weights: Array, ar1: float, y: Array, first: float, step: float, count: int
) -> Array:
    """Share of Σy² that sine and cosine explain at the frequencies ``first + k·step``, (count,)."""
    parts, entries, width = len(z), len(y), len(weights)
    sines, cosines = np.empty(parts), np.empty(parts)
    turn_s, turn_c = np.empty(parts), np.empty(parts)
    out = np.zeros(count)
    total = 0.0
    for j in range(entries):
        total += y[j] * y[j]
    for i in range(parts):
        sines[i] = size[i] * math.sin(2.0 * math.pi * first * z[i])
        cosines[i] = size[i] * math.cos(2.0 * math.pi * first * z[i])
        turn_s[i] = math.sin(2.0 * math.pi * step * z[i])
        turn_c[i] = math.cos(2.0 * math.pi * step * z[i])
    for k in range(count):
        s1 = c1 = ss = cc = sc = ys = yc = 0.0
        for j in range(entries):
            s = 0.0
            c = 0.0
            here, before = begin[j], begin[j] - PARTS
            for w in range(width):
                s += weights[w] * (sines[here + w] - ar1 * sines[before + w])
                c += weights[w] * (cosines[here + w] - ar1 * cosines[before + w])
            s1 += s
            c1 += c
            ss += s * s
            cc += c * c
            sc += s * c
            ys += y[j] * s
            yc += y[j] * c
        ss -= s1 * s1 / entries
        cc -= c1 * c1 / entries
        sc -= s1 * c1 / entries
        bottom = ss * cc - sc * sc
        if bottom > 1e-6 * ss * cc and total > 0.0:
            out[k] = (ys * ys * cc - 2.0 * ys * yc * sc + yc * yc * ss) / bottom / total
        for i in range(parts):  # on to the next frequency by a rotation, instead of two more trigonometric functions
            s = sines[i] * turn_c[i] + cosines[i] * turn_s[i]
            cosines[i] = cosines[i] * turn_c[i] - sines[i] * turn_s[i]
            sines[i] = s
    return out


@dataclass(frozen=True)
class PeriodicDisturbance:
    """``size·sin(2π·time/period + φ)·modulation``.

    Args:
        share: of the variance of second halves of recordings, with the phase of first halves.
        p_value: of the hypothesis that it does not predict them better than a constant.
    """

    period: float
    size: float
    modulation: tuple[Factor, ...]
    share: float
    p_value: float

    def __str__(self) -> str:
        return "·".join([f"{self.size:.3g}·sin(2π·time/{self.period:.4g} + φ)", *map(str, self.modulation)])


def find_periodic_disturbance(series: Sequence[ResidualSeries], ar1: float) -> PeriodicDisturbance | None:
    """The disturbance that predicts left-out recordings best; None where there is nothing to search."""
    if not all("time" in part.variables for part in series) or len(series) < 2:
        return None
    found = [r for r in (_validated(series, modulation, ar1) for modulation in modulations(series)) if r is not None]
    return max(found, key=lambda disturbance: disturbance.share, default=None)


def _validated(series: Sequence[ResidualSeries], modulation: tuple[Factor, ...], ar1: float) -> PeriodicDisturbance | None:
    found = _periods(series, modulation, ar1)
    if found is None:
        return None
    period, without = found
    before, after, sizes = list[Array](), list[Array](), list[float]()
    for part, own in zip(series, without, strict=True):
        y, X = _columns(part, own, modulation, ar1)
        half = len(y) // 2
        beta = np.linalg.lstsq(X[:half], y[:half], rcond=None)[0]
        before.append((y[half:] - y[:half].mean()) ** 2)
        after.append((y[half:] - X[half:] @ beta) ** 2)
        y, X = _columns(part, period, modulation, ar1)
        beta = np.linalg.lstsq(X, y, rcond=None)[0]
        sizes.append(float(np.hypot(beta[0], beta[1])))
    return PeriodicDisturbance(period, float(np.median(sizes)), modulation, *share_explained(before, after))


def _periods(series: Sequence[ResidualSeries], modulation: tuple[Factor, ...], ar1: float) -> tuple[float, list[float]] | None:
    """The best period of all recordings, and that without each of them; None where there is nothing to search."""
    periodograms, span, increment = dict[int, Periodogram](), np.inf, 0.0
    for k, part in enumerate(series):
        y = quasi_difference(part.target, ar1)
        y = y[np.isfinite(y)]
        if len(y) < MIN_ENTRIES:
            continue
        periodograms[k] = Periodogram.of([part], "time", modulation, ar1, y - y.mean())
        time = part.variables["time"]
        span, increment = min(span, float(np.ptp(time))), max(increment, float(np.median(np.diff(time))))
    frequencies = Frequencies.of(span, np.array([increment]), MAX_CYCLES_IN_TIME) if periodograms else None
    if frequencies is None:
        return None
    curves = dict(zip(periodograms, searched([*periodograms.values()], frequencies), strict=True))

    def best(without: int | None = None) -> float:
        kept = [k for k in periodograms if k != without]
        return best_period([periodograms[k] for k in kept], [curves[k] for k in kept], frequencies)

    period = best()
    alone = len(periodograms) == 1
    return period, [period if alone or k not in periodograms else best(k) for k in range(len(series))]


def _columns(part: ResidualSeries, period: float, modulation: tuple[Factor, ...], ar1: float) -> tuple[Array, Array]:
    """Prewhitened target (n,), and sine, cosine and constant (n, 3), where it is measured."""
    y = quasi_difference(part.target, ar1)
    waves = (quasi_difference(term.column(part), ar1) for term in ripple("time", period, modulation))
    X = np.column_stack([*waves, np.ones(len(y))])
    there = np.isfinite(y)
    return y[there], X[there]


def resonance_frequencies(problem: Problem, theta: Array, recordings: Sequence[Recording], sigma: Array) -> Array:
    """Resonance frequency of the residual of each output [Hz], (d,); zero where there is none, or within noise ``sigma``.

    A clear peak in the spectrum (a swinging tool, oil compressibility, a flexible boom): averaged periodograms (Welch, IEEE
    Trans. Audio Electroacoust. 15 (1967)) of all stretches that are measured without gaps.
    """
    from scipy.signal import welch

    found = np.zeros(len(problem.signals))
    parts = []
    for recording in (r for r in recordings if r.kind == "motion"):
        simulated = problem.predict(theta[None], recording)[0]
        parts.append((problem.rate(recording), problem.measured(recording) - simulated, simulated))
    if not parts:
        return found
    rate_hz = parts[0][0]
    length = round(SEGMENT * rate_hz)
    parts = [part for part in parts if abs(part[0] - rate_hz) <= 1e-6 * rate_hz]
    for k in range(len(found)):
        spectra, rows, square = list[Array](), 0, 0.0
        for _, residual, simulated in parts:
            for stretch in _stretches(residual[:, k]):
                pair = np.column_stack([filled(values[stretch, k]) for values in (residual, simulated)])
                if len(pair) < length // 2:
                    continue
                pair -= pair.mean(axis=0)
                frequency, power = welch(pair, rate_hz, nperseg=min(length, len(pair)), nfft=length, axis=0)
                spectra.append(len(pair) * power)
                rows, square = rows + len(pair), square + float(pair[:, 0] @ pair[:, 0])
        if rows and square / rows > (2.0 * float(sigma[k])) ** 2:
            found[k] = _peak(frequency, *np.sum(spectra, axis=0).T)
    return found


def _stretches(values: Array) -> list[slice]:
    """Stretches without a gap of more than a few rows."""
    rows = np.flatnonzero(~np.isnan(values))
    parts = np.split(rows, np.flatnonzero(np.diff(rows) > MAX_GAP + 1) + 1)
    return [slice(int(part[0]), int(part[-1]) + 1) for part in parts if len(part)]


def _peak(frequency: Array, power: Array, motion: Array) -> float:
    """Frequency of the highest peak if it contains most of the power and is not due to the motion, else zero."""
    above = frequency >= MIN_FREQUENCY
    top = float(frequency[above][np.argmax(power[above])])
    near = above & (np.abs(frequency - top) <= WIDTH * top)
    within = float(power[near].sum())
    if near[np.argmax(above)] or within < MIN_SHARE * float(power[above].sum()):
        return 0.0
    if within < MIN_POWER_RATIO * float(motion[near].sum()):
        return 0.0
    return float(power[near] @ frequency[near] / power[near].sum())
