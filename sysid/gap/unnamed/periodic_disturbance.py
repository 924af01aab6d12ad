"""A remainder that repeats itself over time, whatever the machine does: a pump, a leaking valve, another machine.

Its phase is another one in every recording. So the period is searched over all recordings with a phase of its own for each, and
judged on each recording left out of the search: the phase is taken from its first half, its second half is predicted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.gap.evidence import gain_p_value
from sysid.gap.unnamed.periodogram import Waves, best_period
from sysid.gap.unnamed.probes import PARTS, Series, quasi_difference
from sysid.gap.unnamed.terms import Factor, Term, modulations

Array = npt.NDArray[np.float64]

#: Most periods in one recording.
MOST = 300


@dataclass(frozen=True)
class Rhythm:
    """A ripple over time: ``size·sin(2π·time/period + φ)·modulation``, judged as a form is (``Judged``)."""

    period: float
    size: float
    modulation: tuple[Factor, ...]
    share: float
    p_value: float

    def __str__(self) -> str:
        return "·".join([f"{self.size:.3g}·sin(2π·time/{self.period:.4g} + φ)", *map(str, self.modulation)])


def find_rhythm(series: Sequence[Series], colour: float, seed: int = 0) -> Rhythm | None:
    """The rhythm that predicts recordings best which its search did not see; None where there is nothing to search."""
    if not all("time" in part.variables for part in series) or len(series) < 2:
        return None
    found = [r for r in (_judged(series, modulation, colour, seed) for modulation in modulations(series)) if r is not None]
    return max(found, key=lambda rhythm: rhythm.share, default=None)


def _judged(series: Sequence[Series], modulation: tuple[Factor, ...], colour: float, seed: int) -> Rhythm | None:
    period = _period(series, modulation, colour)
    if period is None:
        return None
    before, after = list[Array](), list[Array]()
    for part in series:
        searched = _period([other for other in series if other is not part], modulation, colour)
        y, X = _columns(part, searched or period, modulation, colour)
        half = len(y) // 2
        beta = np.linalg.lstsq(X[:half], y[:half], rcond=None)[0]
        before.append((y[half:] - y[:half].mean()) ** 2)
        after.append((y[half:] - X[half:] @ beta) ** 2)
    total, rest = np.concatenate(before), np.concatenate(after)
    sizes = []
    for part in series:
        y, X = _columns(part, period, modulation, colour)
        beta = np.linalg.lstsq(X, y, rcond=None)[0]
        sizes.append(float(np.hypot(beta[0], beta[1])))
    share = 1.0 - float(rest.sum() / total.sum()) if total.sum() > 0.0 else 0.0
    return Rhythm(period, float(np.median(sizes)), modulation, share, gain_p_value(total - rest, seed))


def _period(series: Sequence[Series], modulation: tuple[Factor, ...], colour: float) -> float | None:
    waves, room, moved = [], np.inf, 0.0
    for part in series:
        y = quasi_difference(part.target, colour)
        there = np.flatnonzero(np.isfinite(y))
        if len(there) < 20:
            continue
        z = part.variables["time"]
        size = Term(modulation).values(part)
        at = (PARTS * (there + 1)).astype(np.int64)
        waves.append(Waves(z, size, at, part.weights, colour, y[there] - y[there].mean()))
        room, moved = min(room, float(np.ptp(z))), max(moved, float(np.median(np.diff(z))))
    return best_period(waves, room, np.array([moved]), MOST) if waves else None


def _columns(part: Series, period: float, modulation: tuple[Factor, ...], colour: float) -> tuple[Array, Array]:
    """Prewhitened target (n,), and sine, cosine and constant (n, 3), where it is measured."""
    terms = [Term((Factor(how, "time", period), *modulation)) for how in ("sin", "cos")]
    y = quasi_difference(part.target, colour)
    X = np.column_stack([*(quasi_difference(term.column(part), colour) for term in terms), np.ones(len(y))])
    there = np.isfinite(y)
    return y[there], X[there]
