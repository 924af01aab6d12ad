"""Which effects are named: the decision rule of the gap workflow, all of it.

Given models of one stage (sets of effects) under shared variances:

1. *Predictive density.* Each block of a few seconds is predicted from all other blocks, in closed form.
2. *Survivors.* A model survives if it is not significantly worse than the best: the sum of its block differences is below
   ``STANDARD_ERRORS`` standard errors, or below ``LEAST`` nats; or its evidence is not lower by as much (of forty models that
   are compared one is better by two standard errors by chance, and evidence knows what its parameters cost). A block counts
   for ``BLOCK_NATS`` at most, so that several have to agree (without it one block with 1600 nats makes the sum
   insignificant: 2070 ± 1611).
   A model that lacks an effect of another one predicts as well wherever the discrepancy can do that effect's work, and so does
   one that needs more numbers for the same. There the evidence decides, the discrepancy of each learned beside it alone: it
   does not survive if it has ``LEAST`` nats less.
3. *Minimal survivors.* Supersets of a survivor survive too; what the minimal ones share is needed. One whose other effects may
   all be absent (intervals as in 4), or lie at the edge of what is plausible, says nothing else than the likeliest.
4. *Named*: in every minimal survivor, the 95 % interval of some parameter lies outside the region of practical equivalence
   around its known value.
5. *The smallest set of them that matters*: the others together move the output (free run) by less than ``STANDARD_ERRORS``
   times what the whole model leaves of it above the noise floor, which formulas that are wrong, or a disturbance, could move
   as well. What halves an error and leaves the other half has not found its cause, of two effects that make up for each other
   neither has, and what is further off than without any effect explains nothing.
6. *Ambiguous*: in some of the minimal survivors; those that take its place in the others are its partners.

=================== ======= ============================================================================================
number              value   derivation
=================== ======= ============================================================================================
``STANDARD_ERRORS`` 2       two-sided 5 % of a normal sum of block differences (Vehtari, Gelman, Gabry, Stat. Comput. 27, 2017)
``LEAST``           3 nats  odds of e³ ≈ 20 to 1, "strong" evidence (Kass and Raftery, JASA 90, 1995); 95 % with equal priors
``BLOCK_NATS``      5 nats  "very strong" evidence in one block (same scale); more than one block has to say so
``EXPLAINED``       1.1     what is within a tenth of the noise floor has nothing to explain, and a tenth is what matters
``SHARE``           1 %     of the closable gap on held-out recordings: less is of no practical significance
=================== ======= ============================================================================================

The region of practical equivalence of a parameter is what it may depart without moving the output of the stage by as much as
adds a tenth to what is left of it (in quadrature); at least what is known to be open otherwise, of a clock for instance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.likelihood.stage import ModelFit

Array = npt.NDArray[np.float64]

STANDARD_ERRORS = 2.0
LEAST = 3.0
BLOCK_NATS = 5.0
SHARE = 0.01
#: A stage within this multiple of its noise floor has nothing to explain: what is left moves the error by a tenth at most.
EXPLAINED = 1.1
#: So many of the likeliest survivors a model is compared with by its own evidence.
LIKELIEST = 3
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


def _replaced(model: ModelFit, survivors: Sequence[ModelFit], own_evidence: Callable[[ModelFit], float]) -> bool:
    """Whether a survivor that has an effect more, or does with fewer numbers, is clearly likelier."""
    likelier = [f for f in survivors if f.evidence > model.evidence + LEAST]
    others = [f for f in likelier if simpler(model, f) or len(f.unknowns) < len(model.unknowns)]
    return any(own_evidence(f) > own_evidence(model) + LEAST for f in others[:LIKELIEST])


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
    own_evidence: Callable[[ModelFit], float] = lambda model: model.evidence,
    refit: Callable[[ModelFit, Sequence[Candidate]], ModelFit] | None = None,
) -> Decision:
    """Apply the rule to the models of a stage.

    Args:
        nameable: labels of the candidates that the recordings excite enough.
        rope: least half-widths of regions of equivalence, by effect.
        shared: labels of effects that another stage would have to share: of models that tie, one without them, and without
            effects that are not excited, is chosen.
        own_evidence: of a model, the discrepancy learned beside it alone.
        refit: a model with fewer of its effects.
    """
    best = max(models, key=lambda f: float(f.predictive.sum()))
    survivors = sorted((f for f in models if survives(f, best)), key=lambda f: -f.evidence)
    survivors = [f for f in survivors if not _replaced(f, survivors, own_evidence)]
    minimal = tuple(f for f in survivors if not any(simpler(g, f) for g in survivors))
    unsure = {*shared, *(c.label for f in minimal for c in f.candidates if c.label not in nameable)}
    model = max(minimal, key=lambda f: (-len(f.labels & unsure), f.evidence))
    minimal = tuple(f for f in minimal if f is model or _says_something_else(f, model, rope or {}))
    named, near, tied = [], [], []
    lacking = {c.label: _lacks(c, model, minimal, nameable, rope or {}) for c in model.candidates}
    partners = {c.label: _partners(c, model, minimal, nameable, rope or {}) for c in model.candidates}
    found = [c for c in model.candidates if not lacking[c.label] or partners[c.label]]
    nothing = next((f for f in models if not f.candidates), None)
    enough = found if refit is None else _enough(model, found, refit, nothing)
    for candidate in model.candidates:
        lacks = lacking[candidate.label]
        if candidate in enough and not lacks:
            named.append(candidate)
            continue
        if candidate in enough and partners[candidate.label]:
            tied.append((candidate, *partners[candidate.label]))
        elif candidate in found:
            lacks = "what it takes of the error away is little beside what stays"
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
    return ""


def _enough(
    model: ModelFit,
    found: Sequence[Candidate],
    refit: Callable[[ModelFit, Sequence[Candidate]], ModelFit],
    nothing: ModelFit | None,
) -> Sequence[Candidate]:
    """The smallest set of effects, of several the likeliest, beside which the others move the output by little."""
    allowed = model.left**2 + STANDARD_ERRORS**2 * (max(model.left, EXPLAINED) ** 2 - 1.0)
    if nothing is not None and nothing.left**2 <= allowed:
        return ()
    for size in range(len(found)):
        sets = [
            refit(model, [c for c in model.candidates if c not in found or c in kept]) for kept in combinations(found, size)
        ]
        sets = [f for f in sets if f.left**2 <= allowed]
        if sets:
            likeliest = max(sets, key=lambda f: f.evidence)
            return [c for c in found if c in likeliest.candidates]
    return found


def _says_something_else(other: ModelFit, model: ModelFit, rope: Mapping[Key, float]) -> bool:
    """Whether ``other`` does without an effect of ``model``, or has one in its place that is there for certain.

    One that fits at the edge of what is plausible stands for something else: oil that is warm after five seconds, for a gain.
    """
    here = {c.key for c in model.candidates}
    instead = [c for c in other.candidates if c.key not in here]
    return not instead or any(not _within_rope(c, other, rope) and not _at_its_edge(c, other) for c in instead)


def _at_its_edge(candidate: Candidate, model: ModelFit) -> bool:
    """Whether a value of an effect lies at a bound that is not its absence."""
    pairs = zip(candidate.unknowns, model.values_of(candidate), strict=True)
    return any(value in u.bounds and value != u.nominal for u, value in pairs)


def unnoticed(left: float) -> float:
    """Change of the output that adds a tenth, in quadrature, to what is left of it; both in noise floors."""
    return float(np.sqrt(EXPLAINED**2 - 1.0) * max(1.0, left))


def _within_rope(candidate: Candidate, model: ModelFit, rope: Mapping[Key, float]) -> bool:
    """Whether the 95 % intervals of all its parameters reach into the region of practical equivalence."""
    values, reach = model.values_of(candidate), Z * model.deviations_of(candidate)
    response = model.response[model.rows_of(candidate)]
    seen = unnoticed(model.left) / np.maximum(response, 1e-300)
    half = np.maximum(seen, rope.get(candidate.key, 0.0))
    nominal = np.array([u.nominal for u in candidate.unknowns])
    return bool((np.abs(values - nominal) - reach <= half).all())


def _partners(
    candidate: Candidate, model: ModelFit, minimal: Sequence[ModelFit], nameable: Sequence[str], rope: Mapping[Key, float]
) -> tuple[Candidate, ...]:
    """What stands in other minimal survivors in the place of an effect that would have a name without them."""
    if candidate.label not in nameable or _within_rope(candidate, model, rope):
        return ()
    here = {c.key for c in model.candidates}
    found: dict[Key, Candidate] = {}
    for other in minimal:
        if any(c.key == candidate.key for c in other.candidates):
            continue
        for c in other.candidates:
            if c.key not in here:
                found.setdefault(c.key, c)
    return tuple(found.values())
