"""The price of an effect: the factor by which it has to divide the variance above the noise floor."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.thresholds import EXPLAINED, PRICE

Array = npt.NDArray[np.float64]


def smallest_sets(models: Sequence[ModelFit], left: Callable[[ModelFit], float]) -> list[ModelFit]:
    """The smallest sets of effects that explain the output, in ascending order of the remaining error.

    Each effect has to divide the variance above the noise floor by ``PRICE``. Sets of equal size that differ by less are not
    distinguished by their remaining error.
    """
    variance: dict[int, list[tuple[float, ModelFit]]] = {}
    least, size = np.inf, 0
    for f in sorted(models, key=lambda f: len(f.candidates)):
        n = len(f.candidates)
        if (EXPLAINED**2 - 1.0) * PRICE**n >= least and n != size:
            break  # no remaining error justifies more effects
        found = max(left(f), EXPLAINED) ** 2 - 1.0
        variance.setdefault(n, []).append((found, f))
        if found * PRICE**n < least:
            least, size = found * PRICE**n, n
    equal = sorted(variance[size], key=lambda each: each[0])
    return [f for found, f in equal if found <= PRICE * equal[0][0]]


def pays(before: float, after: float, effects: int = 1) -> bool:
    """Whether effects are worth their price; RMS errors of the output without and with them, in noise floors."""
    return after <= EXPLAINED or divides(before, after, effects)


def pays_beside(before: float, after: float, alike: float) -> bool:
    """Whether an effect is worth its price where similar drives of the machine are wrong by ``alike`` without any effect.

    It moves the output by more than that, or it is worth the price of two effects. Errors in noise floors.
    """
    return pays(before, max(after, alike)) or pays(before, after, 2)


def divides(before: float, after: float, effects: int = 1) -> bool:
    """Whether the variance above the noise floor is divided by the price of so many effects, whatever remains."""
    return before**2 - 1.0 >= PRICE**effects * (max(after, EXPLAINED) ** 2 - 1.0)


def left_where_acting(before: Array, after: Array, moved: Array, rows: Array, averaged_out: float = 0.0) -> float:
    """Remaining error, as if effects reduced that of all recordings as they do that of the recordings which they move.

    An effect pays where it acts. Recordings that it cannot move (where no command reaches a limit, for instance) say nothing
    about it, and their number does not change the answer, if the others contain most of the error without effects.

    Args:
        before, after, moved: sums of squares of each recording, in noise floors, (recordings,): of the error without and with
            the effects, and of the change of the prediction, which is none up to the region of practical equivalence.
        rows: number of rows of each recording, (recordings,).
        averaged_out: variance that averages out of a row, in noise floors.

    Returns:
        RMS error with the effects, in noise floors.
    """
    noise = (1.0 - averaged_out) * rows
    variance, acts = float((after - noise).sum()), moved > (EXPLAINED**2 - 1.0) * rows
    there = float((before - noise)[acts].sum())
    if there > 0.0 and before[acts].sum() > before[~acts].sum():
        variance = float((before - noise).sum() * (after - noise)[acts].sum()) / there
    return float(np.sqrt(max(1.0 + variance / rows.sum(), 0.0)))


def typical_errors(errors: Sequence[float]) -> list[float]:
    """For each drive of a machine, the lower median of the errors of the others with wrong formulas; 0 without one.

    Args:
        errors: shares of the distance moved; 0 for a drive whose formulas are right.
    """
    others = ([e for j, e in enumerate(errors) if j != k and e > 0.0] for k in range(len(errors)))
    return [statistics.median_low(some) if some else 0.0 for some in others]
