"""Least-squares periodogram of filtered columns (Lomb 1976; Scargle 1982), compiled: which period explains most of a rest.

The ripple ``size·sin(2π·f·z)`` passes the filter of the target (:class:`sysid.gap.unnamed.probes.Series`) and its prewhitening
before it is compared, so that a short period is not taken for a small one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.optimize import minimize_scalar

from sysid.gap.unnamed.probes import PARTS

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]

#: Fewest and most periods of a ripple inside the range of what it goes with, and steps of the search within one of them.
LEAST_CYCLES, MOST_CYCLES, FINE = 0.7, 60, 6


@dataclass(frozen=True)
class Waves:
    """What a ripple of one phase may explain: arguments of :func:`powers`."""

    z: Array
    size: Array
    begin: Rows
    weights: Array
    colour: float
    y: Array

    def powers(self, first: float, step: float, count: int) -> Array:
        """Explained sum of squares at each frequency, (count,)."""
        share = powers(self.z, self.size, self.begin, self.begin - PARTS, self.weights, self.colour, self.y, first, step, count)
        return np.asarray(share) * float(self.y @ self.y)


def best_period(waves: Sequence[Waves], room: float, moved: Array, most: int = MOST_CYCLES) -> float | None:
    """The period at which ripples explain most, each of ``waves`` with a phase of its own; None where there is no room.

    Args:
        room: range of what it goes with.
        moved: how far that moves from one part of a bin to the next; while it does, a period has to last for two bins.
        most: periods inside the range.
    """
    moved = moved[moved > 0.02 * moved.max(initial=0.0)]
    if not room > 0.0 or not len(moved):
        return None
    lowest, step = LEAST_CYCLES / room, 1.0 / (FINE * room)
    count = int((min(most / room, 1.0 / (2.0 * PARTS * float(np.median(moved)))) - lowest) / step)
    if count < 3:
        return None
    peak = lowest + step * int(np.argmax(sum(w.powers(lowest, step, count) for w in waves)))
    best = minimize_scalar(
        lambda f: -float(sum(w.powers(f, 0.0, 1)[0] for w in waves)), bounds=(peak - step, peak + step), method="bounded",
        options={"xatol": 2e-3 * step},
    )  # fmt: skip
    return 1.0 / float(best.x)


@njit(nogil=True, cache=True)
def powers(
    z: Array,
    size: Array,
    begin: Rows,
    before: Rows,
    weights: Array,
    colour: float,
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
        y: prewhitened remainder of each entry, its mean zero (n,).
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
                s += weights[w] * (sines[begin[j] + w] - colour * sines[before[j] + w])
                c += weights[w] * (cosines[begin[j] + w] - colour * cosines[before[j] + w])
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
