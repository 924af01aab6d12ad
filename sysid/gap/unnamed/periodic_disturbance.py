"""Periodic disturbance: a residual that is periodic in time, independent of the motion (a pump, another machine).

Its phase differs between recordings. The period is therefore searched over all recordings with one phase per recording, and
validated on each recording left out of the search: the phase is fitted to its first half, and its second half is predicted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.gap.unnamed.periodogram import Frequencies, Periodogram, best_period, searched
from sysid.gap.unnamed.residual_series import PARTS, ResidualSeries, gain_p_value, quasi_difference
from sysid.gap.unnamed.terms import Factor, Term, modulations

Array = npt.NDArray[np.float64]

#: Largest number of periods in one recording.
MAX_PERIODS = 300


@dataclass(frozen=True)
class PeriodicDisturbance:
    """``size·sin(2π·time/period + φ)·modulation``; ``share`` and ``p_value`` as in ``ValidatedFormula``."""

    period: float
    size: float
    modulation: tuple[Factor, ...]
    share: float
    p_value: float

    def __str__(self) -> str:
        return "·".join([f"{self.size:.3g}·sin(2π·time/{self.period:.4g} + φ)", *map(str, self.modulation)])


def find_periodic_disturbance(series: Sequence[ResidualSeries], ar1: float, seed: int = 0) -> PeriodicDisturbance | None:
    """The disturbance that predicts left-out recordings best; None where there is nothing to search."""
    if not all("time" in part.variables for part in series) or len(series) < 2:
        return None
    found = [r for r in (_validated(series, modulation, ar1, seed) for modulation in modulations(series)) if r is not None]
    return max(found, key=lambda disturbance: disturbance.share, default=None)


def _validated(
    series: Sequence[ResidualSeries], modulation: tuple[Factor, ...], ar1: float, seed: int
) -> PeriodicDisturbance | None:
    found = _periods(series, modulation, ar1)
    if found is None:
        return None
    period, without = found
    before, after = list[Array](), list[Array]()
    for part, own in zip(series, without, strict=True):
        y, X = _columns(part, own, modulation, ar1)
        half = len(y) // 2
        beta = np.linalg.lstsq(X[:half], y[:half], rcond=None)[0]
        before.append((y[half:] - y[:half].mean()) ** 2)
        after.append((y[half:] - X[half:] @ beta) ** 2)
    total, rest = np.concatenate(before), np.concatenate(after)
    sizes = []
    for part in series:
        y, X = _columns(part, period, modulation, ar1)
        beta = np.linalg.lstsq(X, y, rcond=None)[0]
        sizes.append(float(np.hypot(beta[0], beta[1])))
    share = 1.0 - float(rest.sum() / total.sum()) if total.sum() > 0.0 else 0.0
    return PeriodicDisturbance(period, float(np.median(sizes)), modulation, share, gain_p_value(total - rest, seed))


def _periods(series: Sequence[ResidualSeries], modulation: tuple[Factor, ...], ar1: float) -> tuple[float, list[float]] | None:
    """The best period of all recordings, and that without each of them; None where there is nothing to search."""
    periodograms, span, increment = dict[int, Periodogram](), np.inf, 0.0
    for k, part in enumerate(series):
        y = quasi_difference(part.target, ar1)
        there = np.flatnonzero(np.isfinite(y))
        if len(there) < 20:
            continue
        z = part.variables["time"]
        size = Term(modulation).values(part)
        at = (PARTS * (there + 1)).astype(np.int64)
        periodograms[k] = Periodogram(z, size, at, part.weights, ar1, y[there] - y[there].mean())
        span, increment = min(span, float(np.ptp(z))), max(increment, float(np.median(np.diff(z))))
    frequencies = Frequencies.of(span, np.array([increment]), MAX_PERIODS) if periodograms else None
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
    terms = [Term((Factor(function, "time", period), *modulation)) for function in ("sin", "cos")]
    y = quasi_difference(part.target, ar1)
    X = np.column_stack([*(quasi_difference(term.column(part), ar1) for term in terms), np.ones(len(y))])
    there = np.isfinite(y)
    return y[there], X[there]
