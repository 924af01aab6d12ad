"""Which effects are named: the decision rule of the gap workflow, all of it.

Given models of one stage (sets of effects) under shared variances:

1. *Predictive density.* Each block of a few seconds is predicted from all other blocks, in closed form.
2. *Survivors.* A model survives if it is not significantly worse than the best: the sum of its block differences is below
   ``STANDARD_ERRORS`` standard errors, or below ``LEAST`` nats; or its evidence is not lower by as much (of forty models that
   are compared one is better by two standard errors by chance, and evidence knows what its parameters cost). A block counts
   for ``BLOCK_NATS`` at most, so that several have to agree (without it one block with 1600 nats makes the sum
   insignificant: 2070 ± 1611).
3. *Minimal survivors.* Supersets of a survivor survive too; what the minimal ones share is needed.
4. *Named*: in every minimal survivor, the 95 % interval of some parameter lies outside the region of practical equivalence
   around its known value, and the discrepancy leaves enough information about it (variance inflation below ``INFLATION``).
5. *Ambiguous*: in some of the minimal survivors; those that take its place in the others are its partners.

=================== ======= ============================================================================================
number              value   derivation
=================== ======= ============================================================================================
``STANDARD_ERRORS`` 2       two-sided 5 % of a normal sum of block differences (Vehtari, Gelman, Gabry, Stat. Comput. 27, 2017)
``LEAST``           2 nats  a likelihood ratio of e² ≈ 7.4, "positive" evidence (Kass and Raftery, JASA 90, 1995)
``BLOCK_NATS``      5 nats  "very strong" evidence in one block (same scale); more than one block has to say so
``INFLATION``       100     the discrepancy has taken 99 % of the information about the parameter
``EXPLAINED``       1.1     what is within a tenth of the noise floor has nothing to explain, and a tenth is what matters
``SHARE``           1 %     of the closable gap on held-out recordings: less is of no practical significance
=================== ======= ============================================================================================

The region of practical equivalence of a parameter is what it may depart without moving the output of the stage by as much as
adds a tenth to what is left of it (in quadrature); at least what is known to be open otherwise, of a clock for instance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.likelihood.stage import ModelFit

Array = npt.NDArray[np.float64]

STANDARD_ERRORS = 2.0
LEAST = 2.0
BLOCK_NATS = 5.0
INFLATION = 100.0
SHARE = 0.01
#: A stage within this multiple of its noise floor has nothing to explain: what is left moves the error by a tenth at most.
EXPLAINED = 1.1
#: 97.5 % quantile of the normal distribution.
Z = 1.959964

#: What an effect lacks that the recordings do not excite.
NOT_EXCITED = "the recordings do not excite it enough"
#: An effect without its form: (name, target, side).
Key = tuple[str, str, str | None]


@dataclass(frozen=True)
class NearMiss:
    """An effect that was in a surviving model and is not named, and what it lacks."""

    candidate: Candidate
    values: Array
    deviations: Array
    lacks: str


@dataclass(frozen=True)
class Decision:
    """What the comparison of models says of one stage.

    Args:
        model: the minimal survivor of the largest predictive density: what goes into the repaired plant.
        named: its effects that are named.
        tied: sets of effects of which each would do, the one in ``model`` first.
        near_misses: its other effects and those of other survivors.
        survivors: all of them, best first; ``minimal``: those without a simpler survivor.
    """

    model: ModelFit
    named: tuple[Candidate, ...]
    tied: tuple[tuple[Candidate, ...], ...]
    near_misses: tuple[NearMiss, ...]
    survivors: tuple[ModelFit, ...]
    minimal: tuple[ModelFit, ...]


def difference(better: ModelFit, other: ModelFit) -> tuple[float, float]:
    """Sum of the clipped block differences of two models, and its standard error [nats]."""
    blocks = np.clip(better.predictive - other.predictive, -BLOCK_NATS, BLOCK_NATS)
    return float(blocks.sum()), float(blocks.std() * np.sqrt(len(blocks)))


def survives(model: ModelFit, best: ModelFit) -> bool:
    """Whether a model is not significantly worse than the best: a loser loses on both counts."""
    total, error = difference(best, model)
    return total < max(STANDARD_ERRORS * error, LEAST) or model.evidence > best.evidence - LEAST


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


def decide(
    models: Sequence[ModelFit],
    nameable: Sequence[str],
    rope: Mapping[Key, float] | None = None,
    shared: Sequence[str] = (),
) -> Decision:
    """Apply the rule to the models of a stage.

    Args:
        nameable: labels of the candidates that the recordings excite enough.
        rope: least half-widths of regions of equivalence, by effect.
        shared: labels of effects that another stage would have to share: of models that tie, one without them is chosen.
    """
    best = max(models, key=lambda f: float(f.predictive.sum()))
    survivors = sorted((f for f in models if survives(f, best)), key=lambda f: -f.evidence)
    minimal = tuple(f for f in survivors if not any(simpler(g, f) for g in survivors))
    model = max(minimal, key=lambda f: (-len(f.labels.intersection(shared)), f.evidence))
    named, near, tied = [], [], []
    for candidate in model.candidates:
        lacks = _lacks(candidate, model, minimal, nameable, rope or {})
        if not lacks:
            named.append(candidate)
            continue
        if len(minimal) > 1 and candidate.label in nameable:
            partners = _partners(candidate, model, minimal)
            if partners and not _within_rope(candidate, model, rope or {}):
                tied.append((candidate, *partners))
        near.append(NearMiss(candidate, model.values_of(candidate), model.deviations_of(candidate), lacks))
    seen = {c.key for c in model.candidates}
    for other in survivors:
        for candidate in other.candidates:
            if candidate.key not in seen:
                seen.add(candidate.key)
                near.append(
                    NearMiss(
                        candidate,
                        other.values_of(candidate),
                        other.deviations_of(candidate),
                        "a model without it predicts as well",
                    )
                )
    return Decision(model, tuple(named), tuple(tied), tuple(near), tuple(survivors), minimal)


def _lacks(
    candidate: Candidate, model: ModelFit, minimal: Sequence[ModelFit], nameable: Sequence[str], rope: Mapping[Key, float]
) -> str:
    """Why an effect of the chosen model is not named; empty where it is."""
    if candidate.label not in nameable:
        return NOT_EXCITED
    if not all(any(c.key == candidate.key for c in f.candidates) for f in minimal):
        return "another model without it predicts as well"
    if any(_within_rope(c, f, rope) for f in minimal for c in f.candidates if c.key == candidate.key):
        return "its 95 % interval reaches into the region of practical equivalence"
    inflation = float(model.inflation[model.rows_of(candidate)].min())
    if inflation >= INFLATION:
        return f"systematic discrepancy leaves {1.0 / inflation:.1%} of the information about it"
    return ""


def _within_rope(candidate: Candidate, model: ModelFit, rope: Mapping[Key, float]) -> bool:
    """Whether the 95 % intervals of all its parameters reach into the region of practical equivalence."""
    values, reach = model.values_of(candidate), Z * model.deviations_of(candidate)
    response = model.response[model.rows_of(candidate)]
    seen = np.sqrt(EXPLAINED**2 - 1.0) * max(1.0, model.left) / np.maximum(response, 1e-300)
    half = np.maximum(seen, rope.get(candidate.key, 0.0))
    nominal = np.array([u.nominal for u in candidate.unknowns])
    return bool((np.abs(values - nominal) - reach <= half).all())


def _partners(candidate: Candidate, model: ModelFit, minimal: Sequence[ModelFit]) -> tuple[Candidate, ...]:
    """What stands in other minimal survivors in the place of an effect."""
    here = {c.key for c in model.candidates}
    found: dict[Key, Candidate] = {}
    for other in minimal:
        if any(c.key == candidate.key for c in other.candidates):
            continue
        for c in other.candidates:
            if c.key not in here:
                found.setdefault(c.key, c)
    return tuple(found.values())
