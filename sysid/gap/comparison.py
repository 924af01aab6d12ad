"""Comparison of models of a stage by predictive density and evidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from sysid.gap.candidates import Candidate
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.price import divides
from sysid.gap.thresholds import BLOCK_NATS, EXPLAINED, LEAST, LIKELIEST, STANDARD_ERRORS


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
    within = [f for f in models if f.left <= EXPLAINED and simpler(f, model)]
    return min(within, key=lambda f: (len(f.unknowns), -f.evidence), default=model)


def outdone(model: ModelFit, survivors: Sequence[ModelFit]) -> bool:
    """Whether a survivor has effects that are worth their price, which the discrepancy must not replace.

    Further effects, or others in their place: these have to be worth the price of one. A set with further effects that reaches
    the noise floor, while a tenth more is left without them, is worth any price.
    """
    if model.left <= EXPLAINED:
        return False
    more = [(f, len(f.candidates) - len(model.candidates)) for f in survivors]
    reaches_floor = any(n > 0 and f.left <= EXPLAINED and model.left > EXPLAINED * max(f.left, 1.0) for f, n in more)
    return reaches_floor or any(divides(model.left, f.left, max(n, 1)) for f, n in more)
