"""Least-squares periodogram of filtered columns (Lomb 1976; Scargle 1982), compiled: which period explains most of a residual.

The ripple ``size·sin(2π·f·z)`` passes the filter of the target
(:class:`sysid.gap.unnamed.residual_series.ResidualSeries`) and its prewhitening before it is compared, so that the amplitude
of a ripple with a short period is not underestimated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from sysid.compiled import kernel
from sysid.gap.unnamed.residual_series import PARTS
from sysid.plant.model import in_parallel

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]

#: Least and largest number of periods inside the span of the variable, and search steps per period.
MIN_CYCLES, MAX_CYCLES, STEPS = 0.7, 60, 6


@dataclass(frozen=True)
class Periodogram:
    """Periodogram of one series with a common phase: arguments of :func:`powers`."""

    z: Array
    size: Array
    begin: Rows
    weights: Array
    ar1: float
    y: Array

    def powers(self, first: float, step: float, count: int) -> Array:
        """Explained sum of squares at each frequency, (count,)."""
        share = powers(self.z, self.size, self.begin, self.begin - PARTS, self.weights, self.ar1, self.y, first, step, count)
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
def powers(
    z: Array,
    size: Array,
    begin: Rows,
    before: Rows,
    weights: Array,
    ar1: float,
    y: Array,
    first: float,
    step: float,
    count: int,
) -> Array:
    """Share of Σy² that sine and cosine explain at the frequencies ``first + k·step``, (count,).

    Args:
        z, size: at all parts of bins, one block after the other (p,).
        begin, before: where the parts of each entry begin, and those of the entry before it (n,).
        weights: of the parts in an entry.
        y: prewhitened residual of each entry, its mean zero (n,).
    """
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
            for w in range(width):
                s += weights[w] * (sines[begin[j] + w] - ar1 * sines[before[j] + w])
                c += weights[w] * (cosines[begin[j] + w] - ar1 * cosines[before[j] + w])
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
