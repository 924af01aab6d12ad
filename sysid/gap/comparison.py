"""Comparison of models of a stage: predictive density and evidence, the price of an effect, practical equivalence.

An effect pays if it divides the variance above the noise floor by its price. The region of practical equivalence surrounds the
known value of a parameter; a value at a bound of its range is no estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate, sizes_of
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.thresholds import BESIDE, BLOCK_NATS, LEAST, LIKELIEST, PRICE, STANDARD_ERRORS, TENTH, Z, as_little, at_floor
from sysid.machine import EffectKey


def difference(better: ModelFit, other: ModelFit) -> tuple[float, float]:
    """Sum of the clipped block differences of two models, and its standard error [nats]."""
    blocks = np.clip(better.predictive - other.predictive, -BLOCK_NATS, BLOCK_NATS)
    return float(blocks.sum()), float(blocks.std() * np.sqrt(len(blocks)))


def survives(model: ModelFit, best: ModelFit) -> bool:
    """Whether a model is not significantly worse than the best, by predictive density or by evidence."""
    return not clearly_worse(model, best) or model.evidence > best.evidence - LEAST


def clearly_worse(model: ModelFit, other: ModelFit) -> bool:
    """Whether a model predicts the blocks significantly worse than another."""
    total, error = difference(other, model)
    return total >= max(STANDARD_ERRORS * error, LEAST)


def simpler(one: ModelFit, other: ModelFit) -> bool:
    """Whether every effect of ``one`` is in ``other``, in the same or a richer form, and ``other`` has more."""
    if one.labels == other.labels:
        return False
    covered = all(any(_covers(theirs, mine) for theirs in other.candidates) for mine in one.candidates)
    return covered and len(one.unknowns) < len(other.unknowns)


def _covers(richer: Candidate, candidate: Candidate) -> bool:
    if richer.key == candidate.key:
        return len(richer.unknowns) >= len(candidate.unknowns)
    return richer.contains(candidate)


def replaced(model: ModelFit, survivors: Sequence[ModelFit], own_evidence: Callable[[ModelFit], float]) -> bool:
    """Whether a survivor with more effects, or with fewer parameters, is clearly likelier."""
    likelier = [f for f in survivors if f.evidence > model.evidence + LEAST]
    others = [f for f in likelier if simpler(model, f) or len(f.unknowns) < len(model.unknowns)]
    return any(own_evidence(f) > own_evidence(model) + LEAST for f in others[:LIKELIEST])


def simplest(model: ModelFit, models: Sequence[ModelFit]) -> ModelFit:
    """The simplest model within one that also reaches the noise floor: what it lacks has no practical significance.

    A base turned about the axis of the first joint is an offset of that joint, whatever its other five parameters compensate.
    """
    within = [f for f in models if at_floor(f.left) and simpler(f, model)]
    return min(within, key=lambda f: (len(f.unknowns), -f.evidence), default=model)


Array = npt.NDArray[np.float64]


# -- the price of an effect ----------------------------------------------------------------------------------------------------


def smallest_sets(models: Sequence[ModelFit], left: Callable[[ModelFit], float]) -> list[ModelFit]:
    """The smallest sets of effects that explain the output, in ascending order of the remaining error.

    Each effect has to divide the variance above the noise floor by ``PRICE``. Sets of equal size that differ by less are not
    distinguished by their remaining error.
    """
    variance: dict[int, list[tuple[float, ModelFit]]] = {}
    least, size = np.inf, 0
    for f in sorted(models, key=lambda f: len(f.candidates)):
        n = len(f.candidates)
        if _charged(TENTH, n) >= least and n != size:
            break  # no remaining error justifies more effects
        remains = left(f)
        variance.setdefault(n, []).append((_charged(remains, 0), f))
        if _charged(remains, n) < least:
            least, size = _charged(remains, n), n
    equal = sorted(variance[size], key=lambda each: each[0])
    return [f for found, f in equal if found <= PRICE * equal[0][0]]


def may_be_smallest(effects: int, models: Sequence[ModelFit]) -> bool:
    """Whether a set of so many effects that explained everything would be smaller, with its price, than each of ``models``."""
    return _charged(TENTH, effects) < min(_charged(f.left, len(f.candidates)) for f in models)


def _charged(left: float, effects: int) -> float:
    """Variance above the noise floor with the price of so many effects; ``left`` in noise floors."""
    return (max(left, TENTH) ** 2 - 1.0) * PRICE**effects


def pays(before: float, after: float, effects: int = 1) -> bool:
    """Whether effects are worth their price; RMS errors of the output without and with them, in noise floors."""
    return at_floor(after) or divides(before, after, effects)


def counts_beside(less: float, whole: float) -> bool:
    """Whether one effect moves the output by what remains, beside the others of a set; what it leaves without it, and whole."""
    return not as_little(less, whole) and (at_floor(whole) or divides(less, whole, factor=BESIDE))


def divides(before: float, after: float, effects: int = 1, factor: float = PRICE) -> bool:
    """Whether so many effects each divide the variance above the noise floor by their price, whatever remains."""
    return before**2 - 1.0 >= factor**effects * (max(after, TENTH) ** 2 - 1.0)


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
    variance, acts = float((after - noise).sum()), moved > (TENTH**2 - 1.0) * rows
    there = float((before - noise)[acts].sum())
    if there > 0.0 and before[acts].sum() > before[~acts].sum():
        variance = float((before - noise).sum() * (after - noise)[acts].sum()) / there
    return float(np.sqrt(max(1.0 + variance / rows.sum(), 0.0)))


#: Distance from a bound at which a fit stops, as a share of the bound, or of the negligible change where it is zero.
AT = 1e-3


def at_bound(candidate: Candidate, model: ModelFit) -> bool:
    """Whether a value of an effect lies at a bound, to within :data:`AT`, where it is neither nominal nor absent."""
    return any(
        abs(value - bound) <= AT * (abs(bound) or u.negligible) and value not in (u.nominal, absent)
        for u, value, absent in zip(candidate.unknowns, model.values_of(candidate), candidate.absent, strict=True)
        for bound in u.bounds
    )


def equivalent_change(left: float) -> float:
    """Change of the output that adds a tenth, in quadrature, to its remaining error ``left``; both in noise floors."""
    return float(np.sqrt(TENTH**2 - 1.0) * max(1.0, left))


def equivalent_half(candidate: Candidate, model: ModelFit) -> Array:
    """Half-widths (k,) of the regions of practical equivalence of the parameters of an effect."""
    with np.errstate(divide="ignore", over="ignore"):  # no value changes an output that does not respond
        return np.asarray(equivalent_change(model.left) / model.response[model.rows_of(candidate)])


def within_equivalence(candidate: Candidate, model: ModelFit, least: Mapping[EffectKey, float]) -> bool:
    """Whether the 95 % intervals of all its parameters reach into the region of practical equivalence.

    They include what the discrepancy could do in its place.
    """
    half = np.maximum(equivalent_half(candidate, model), least.get(candidate.key, 0.0))
    reach = Z * np.hypot(model.deviations_of(candidate), model.confounded[model.rows_of(candidate)])
    size, slope = sizes_of(candidate.unknowns, model.values_of(candidate))
    nominal, _ = sizes_of(candidate.unknowns, np.array([u.nominal for u in candidate.unknowns]))
    return bool((np.abs(size - nominal) - slope * reach <= slope * half).all())
