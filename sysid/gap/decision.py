"""The decision rule of the gap workflow: which effects are named (reasons and sources: ``docs/decisions/decision-rule.md``).

Given models of one stage (sets of effects) under shared variances:

1. *Survivors.* Each block of a few seconds is predicted from all other blocks, in closed form. A model survives if it is not
   significantly worse than the best: the sum of its block differences is below ``STANDARD_ERRORS`` standard errors or below
   ``LEAST`` nats, or its evidence is not lower by as much. A block counts for ``BLOCK_NATS`` at most, so that several have to
   agree. A model that lacks an effect of another predicts as well where the discrepancy replaces that effect, and so does one
   that needs more parameters; there the evidence decides, the discrepancy of each estimated beside it alone. The *minimal*
   survivors are those of which no simpler one survives; the likeliest without effects that another stage shares, or that are
   not excited, is chosen.
2. *Formulas right* up to a random disturbance (a discrepancy gains less than ``LEAST`` nats beside the likeliest minimal
   survivor): the minimal survivors are acceptable.
3. *Formulas wrong, errors accumulate* (a stage that integrates): the smallest sets of effects that explain the free run are
   acceptable. The price of each effect is that the variance above the noise floor falls to a fifth (it moves the output by
   ``STANDARD_ERRORS`` times what remains), in the recordings that the set moves if these contain most of the error. Of equally
   large sets within this price, those are acceptable that leave no more than another by ``STANDARD_ERRORS`` of the difference
   between blocks, and of which no other is likelier by more than twice ``BLOCK_NATS`` and by a fifth of what a discrepancy
   gains beside it. The plant gets the values of the chosen set, unless a survivor with further effects leaves less.
   *Formulas wrong, errors do not accumulate*: the minimal survivors. The plant gets the likeliest minimal survivor with further
   effects that leaves less by more than a tenth, both with values of least squares.
   Where errors do not accumulate, a simpler model within a survivor that also reaches the noise floor replaces it.
4. *Named*: in all acceptable sets, the 95 % interval of some parameter lies outside the region of practical equivalence
   around its known value, and no value lies at a bound of its range. Where formulas are wrong, the set has to be worth its
   price, and where errors do not accumulate, each effect moves the output by what remains, beside the others (the least that
   the plant can leave: values of least squares, no error of timing). Where they accumulate, an effect confused with a larger
   one of its axis is not named.
5. *Ambiguous*: in some of them; the effects in its place in the others are its partners.
6. Where formulas are wrong, the names have to be worth the price of an effect on recordings left out of the fit too
   (:func:`pays`); where errors accumulate, each name beside the others, on all recordings by cross-validation
   (:mod:`sysid.gap.held_out`).

The region of practical equivalence of a parameter is the change that adds a tenth, in quadrature, to the remaining error of the
stage; at least what is known to be open otherwise, of a clock for instance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.comparison import (
    at_bound,
    counts_beside,
    pays,
    replaced,
    simpler,
    simplest,
    smallest_sets,
    survives,
    within_equivalence,
)
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.reasons import Reason
from sysid.gap.thresholds import BLOCK_NATS, LEAST, PRICE, STANDARD_ERRORS, as_little
from sysid.machine import EffectKey

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class NearMiss:
    """An effect of a surviving model that is not named, and the condition that it fails."""

    candidate: Candidate
    values: Array
    deviations: Array
    lacks: Reason


@dataclass(frozen=True)
class Decision:
    """Result of the comparison of the models of one stage.

    Args:
        model: the chosen set and the effects adjusted beside it, for the repaired plant.
        named: its effects that are named.
        tied: non-identifiable sets of effects, the one in ``model`` first.
        near_misses: its other effects and those of other survivors.
        survivors: models that predict as well as the best, likeliest first.
        acceptable: the acceptable sets, that of ``model`` first.
        exact: whether the formulas are right up to a random disturbance.
        accumulates: whether they are wrong and their errors accumulate, so that values are those of least squares over the free
        run.
    """

    model: ModelFit
    named: tuple[Candidate, ...]
    tied: tuple[tuple[Candidate, ...], ...]
    near_misses: tuple[NearMiss, ...]
    survivors: tuple[ModelFit, ...]
    acceptable: tuple[ModelFit, ...]
    exact: bool
    accumulates: bool

    def without_names(self, lacks: Mapping[str, Reason]) -> Decision:
        """The same model without names and ties of some effects, near misses now; ``lacks``: label → the failed condition."""
        named = tuple(c for c in self.named if c.label not in lacks)
        tied = tuple(tie for tie in self.tied if tie[0].label not in lacks)
        taken = [c for c in (*self.named, *(tie[0] for tie in self.tied)) if c.label in lacks]
        near = [NearMiss(c, self.model.values_of(c), self.model.deviations_of(c), lacks[c.label]) for c in taken]
        others = [m for m in self.near_misses if all(m.candidate.key != c.key for c in taken)]
        return replace(self, named=named, tied=tied, near_misses=(*near, *others))


class FreeRun:
    """Remaining error of sets of effects over the free run of a stage, in noise floors; here at the values of the models."""

    def nearest(self, model: ModelFit) -> ModelFit:
        """The set of effects with the values of least error."""
        return model

    def least_squares(self, model: ModelFit) -> ModelFit:
        """The set of effects with values of least squares, and their covariance."""
        return model

    def left(self, model: ModelFit) -> float:
        return self.nearest(model).left

    def priced(self, model: ModelFit) -> float:
        """Remaining error that has to be worth the price: that where the effects act."""
        return self.left(model)

    def further(self, model: ModelFit, other: ModelFit) -> float:
        """Difference in remaining error between ``model`` and ``other``, in standard errors."""
        return 0.0

    def moved(self, model: ModelFit, candidate: Candidate) -> float:
        """Change of the output by one of its effects."""
        away = model.values_of(candidate) - np.array([u.nominal for u in candidate.unknowns])
        return float(np.linalg.norm(model.response[model.rows_of(candidate)] * away))


def decide(
    models: Sequence[ModelFit],
    nameable: Sequence[str],
    rope: Mapping[EffectKey, float] | None = None,
    shared: Sequence[str] = (),
    own_evidence: Callable[[ModelFit], float] = lambda model: model.evidence,
    needed: Callable[[ModelFit], float] = lambda model: np.inf,
    integrates: bool = True,
    free: FreeRun | None = None,
    without: Callable[[ModelFit, Candidate], ModelFit] | None = None,
    independent: bool = False,
    first: frozenset[str] = frozenset(),
    fewest: Callable[[ModelFit], Sequence[ModelFit]] | None = None,
) -> Decision:
    """Apply the rule to the models of a stage.

    Args:
        nameable: labels of the candidates that the recordings excite enough.
        rope: least half-widths of regions of equivalence, by effect.
        shared: labels of effects that another stage would have to share: of models that tie, one without them, and without
            effects that are not excited, is chosen.
        own_evidence: evidence of a model with the discrepancy estimated beside it alone.
        needed: gain in evidence of a model by a discrepancy [nats].
        integrates: whether the output accumulates errors of its input, which the likelihood hardly shows if they are slow.
        free: remaining errors over the free run, at the values of least error; by default at those of the models.
        without: a model without one of its effects, the others refitted; by default looked up among ``models``.
        independent: the errors of rows are independent (static poses), so that their mean shows effects below the noise floor:
            evidence alone decides between a model and a simpler one that reaches the floor.
        first: labels of effects that come before the others (the frame of the measurement): if they are worth their price, the
            others have to pay theirs by what they reduce beside these.
        fewest: where formulas are wrong and errors do not accumulate, the acceptable sets of fewest effects of a model.
    """
    rope, free = rope or {}, free or FreeRun()
    best = max(models, key=lambda f: float(f.predictive.sum()))
    survivors = sorted((f for f in models if survives(f, best)), key=lambda f: -f.evidence)
    unsure = {*shared, *(c.label for f in models for c in f.candidates if c.label not in nameable)}
    likely = _likely(survivors, unsure, own_evidence)
    if not integrates and not independent:
        likely = list({f.labels: f for f in (simplest(f, models) for f in likely)}.values())
    exact = needed(likely[0]) < LEAST
    accumulates, static = integrates and not exact, not (integrates or exact)
    if accumulates:
        acceptable = _nearest(models, unsure, free, own_evidence, needed)
        model = _whole(acceptable[0].with_values(free.least_squares(acceptable[0])), survivors, unsure)
        # Where slow errors accumulate under wrong formulas, the posterior of the whitened likelihood is not valid.
        tested = [free.least_squares(f) for f in acceptable]
    else:
        acceptable = likely if fewest is None or not static else list(fewest(likely[0]))
        model, tested = acceptable[0], acceptable
    lacking = {c.key: _lacks(c, tested, nameable, rope) for c in model.candidates}
    tying = {
        c.key: _partners(c, model, acceptable)
        for c in model.candidates
        if lacking[c.key] == Reason.REPLACED and not within_equivalence(c, model, rope)
    }
    known = {f.labels: f for f in models}
    less = without or (lambda f, c: known[f.labels - {c.label}])
    for c in model.candidates if static else ():
        if not lacking[c.key] and not counts_beside(free.left(less(model, c)), free.left(model)):
            lacking[c.key] = Reason.LITTLE
    nothing, alone = next((f.left for f in models if not f.candidates), np.inf), model
    if static and fewest is not None and without is not None:
        lost, alone = _beyond_price(model, lacking, nothing, without, free)
        lacking |= dict.fromkeys(lost, Reason.LITTLE)
    beside = next((f.left for f in models if f.labels == first), nothing)
    paid = bool(first) and pays(nothing, beside, len(first))
    reference, apart = (beside, first) if paid else (nothing, frozenset())
    smallest = {c.key for c in acceptable[0].candidates}
    certain = sum(not lacking[c.key] for c in model.candidates if c.label not in apart)
    if accumulates:
        worth = pays(nothing, free.priced(acceptable[0]), len(smallest))
    else:
        worth = exact or pays(reference, free.left(alone if alone.candidates else model), max(certain, 1))
    named, near, tied = [], [], []
    for candidate in model.candidates:
        lacks = lacking[candidate.key]
        if not (worth or candidate.label in apart) or candidate.key not in smallest:
            lacks = Reason.LITTLE
        elif not lacks and integrates and _repairs(candidate, acceptable[0], free):
            lacks = Reason.REPAIRS
        elif not lacks:
            named.append(candidate)
            continue
        elif tying.get(candidate.key):
            tied.append((candidate, *tying[candidate.key]))
        near.append(NearMiss(candidate, model.values_of(candidate), model.deviations_of(candidate), lacks))
    if static and fewest is None:
        richer = _less_left(model, survivors, unsure, free)
        more = [c for c in richer.candidates if c.label not in model.labels]
        near += [NearMiss(c, richer.values_of(c), richer.deviations_of(c), Reason.LITTLE) for c in more]
        model = richer
    predicts = not accumulates or any(acceptable[0] is f for f in survivors)
    seen = {c.key for c in model.candidates}
    for other in (*acceptable, *survivors):
        for candidate in other.candidates:
            if candidate.key not in seen:
                seen.add(candidate.key)
                values, deviations = other.values_of(candidate), other.deviations_of(candidate)
                near.append(NearMiss(candidate, values, deviations, Reason.REPLACED if predicts else Reason.LITTLE))
    return Decision(model, tuple(named), tuple(tied), tuple(near), tuple(survivors), tuple(acceptable), exact, accumulates)


# -- the whitened likelihood: formulas right, or errors that do not accumulate ---------------------------------------------


def _likely(survivors: Sequence[ModelFit], unsure: set[str], own_evidence: Callable[[ModelFit], float]) -> list[ModelFit]:
    """The minimal survivors, the likeliest first."""
    stay = [f for f in survivors if not replaced(f, survivors, own_evidence)]
    minimal = [f for f in stay if not any(simpler(g, f) for g in stay)]
    chosen = max(minimal, key=lambda f: (-len(f.labels & unsure), f.evidence))
    return [chosen, *_with_other_effects(minimal, chosen)]


def _with_other_effects(models: Sequence[ModelFit], chosen: ModelFit) -> list[ModelFit]:
    """The models without those that have the effects of ``chosen``, in whatever form."""
    here = {c.key for c in chosen.candidates}
    return [f for f in models if {c.key for c in f.candidates} != here]


def _beyond_price(
    model: ModelFit,
    lacking: Mapping[EffectKey, Reason | None],
    nothing: float,
    without: Callable[[ModelFit, Candidate], ModelFit],
    free: FreeRun,
) -> tuple[list[EffectKey], ModelFit]:
    """Certain effects that are not worth a name, and the set of the others alone.

    One by one, the effect that leaves least without it, until each of the others moves the output by what remains, and they are
    worth their price together: without the effects that are not certain, which may exchange with it (a dead time with a lag).
    """
    lost, alone = list[EffectKey](), model
    for candidate in model.candidates:
        if lacking[candidate.key]:
            alone = without(alone, candidate)
    while alone.candidates:
        first = min(alone.candidates, key=lambda c: free.left(without(alone, c)))
        less = without(alone, first)
        left = free.left(alone)
        if counts_beside(free.left(less), left) and pays(nothing, left, len(alone.candidates)):
            break
        lost.append(first.key)
        alone = less
    return lost, alone


# -- the free run: formulas wrong and errors accumulate ----------------------------------------------------------------------


def _nearest(
    models: Sequence[ModelFit],
    unsure: set[str],
    free: FreeRun,
    own_evidence: Callable[[ModelFit], float],
    needed: Callable[[ModelFit], float],
) -> list[ModelFit]:
    """The smallest sets of effects that explain the output and to which no other is preferred; least remaining error first."""
    close = smallest_sets(models, free.priced)

    def likelier(f: ModelFit, g: ModelFit) -> bool:
        """Clearly, each with its values of least squares: its likeliest values may explain fast errors alone.

        Where formulas are wrong, very strong evidence of one block is not enough, nor a fifth of what they lack beside the set.
        """
        better, other = (own_evidence(each.with_values(free.least_squares(each))) for each in (f, g))
        return better - other > max(2.0 * BLOCK_NATS, needed(f) / PRICE)

    def preferred(f: ModelFit, g: ModelFit) -> bool:
        """Less remaining error; without a difference the simpler set, the one without values at bounds, or the likelier one."""
        less, more = (free.further(*pair) > STANDARD_ERRORS for pair in ((g, f), (f, g)))
        edges = [any(at_bound(c, each) for c in each.candidates) for each in (f, g)]
        return (less or simpler(f, g) or edges == [False, True] or likelier(f, g)) and not more

    found = [g for g in close if not any(preferred(f, g) for f in close if f is not g)] or close
    chosen = min(found, key=lambda f: (len(f.labels & unsure), free.left(f)))
    return [chosen, *_with_other_effects(found, chosen)]


def _whole(smallest: ModelFit, survivors: Sequence[ModelFit], unsure: set[str]) -> ModelFit:
    """The likeliest minimal survivor that contains the effects of the smallest set and leaves no more."""
    keys = {c.key for c in smallest.candidates}
    those = [f for f in survivors if keys <= {c.key for c in f.candidates} and f.left <= smallest.left]
    return _likeliest_minimal(those, unsure) or smallest


def _less_left(model: ModelFit, survivors: Sequence[ModelFit], unsure: set[str], free: FreeRun) -> ModelFit:
    """The likeliest minimal survivor that has the effects of a model and leaves less by more than a tenth, for the plant.

    In the likelihood the discrepancy replaces what such a model has besides; the plant has no discrepancy.
    """
    less = [f for f in survivors if model.labels < f.labels and not as_little(free.left(model), free.left(f))]
    return _likeliest_minimal(less, unsure) or model


def _likeliest_minimal(models: Sequence[ModelFit], unsure: set[str]) -> ModelFit | None:
    minimal = [f for f in models if not any(simpler(g, f) for g in models)]
    return max(minimal, key=lambda f: (-len(f.labels & unsure), f.evidence), default=None)


def _lacks(
    candidate: Candidate, models: Sequence[ModelFit], nameable: Sequence[str], rope: Mapping[EffectKey, float]
) -> Reason | None:
    """Condition for a name that an effect of the chosen model fails; None where it fails none."""
    if candidate.label not in nameable:
        return Reason.NOT_EXCITED
    if any(at_bound(c, f) for f in models for c in f.candidates if c.key == candidate.key):
        return Reason.AT_BOUND
    if not all(any(c.key == candidate.key for c in f.candidates) for f in models):
        return Reason.REPLACED
    if any(within_equivalence(c, f, rope) for f in models for c in f.candidates if c.key == candidate.key):
        return Reason.UNCERTAIN
    return None


def _repairs(candidate: Candidate, model: ModelFit, free: FreeRun) -> bool:
    """Whether an effect moves the output less than another one of its axis with which it is confused.

    The formulas of valves and servos are idealisations, those of geometry and forces are not: an error in the form of a curve
    looks like a gain.
    """
    if candidate.effect.stage != "command":
        return False
    alike = [c for c in model.candidates if c.target == candidate.target and _confused(c, candidate)]
    return any(free.moved(model, candidate) < free.moved(model, other) for other in alike)


def _confused(one: Candidate, other: Candidate) -> bool:
    return one.effect.name in other.effect.confused_with or other.effect.name in one.effect.confused_with


def _partners(candidate: Candidate, model: ModelFit, acceptable: Sequence[ModelFit]) -> tuple[Candidate, ...]:
    """Effects in the other acceptable sets in place of an effect."""
    here = {c.key for c in model.candidates}
    without = [f for f in acceptable if all(c.key != candidate.key for c in f.candidates)]
    found: dict[EffectKey, Candidate] = {}
    for c in (c for f in without for c in f.candidates if c.key not in here or f is not model):
        if c.key != candidate.key and not any(c.key == d.key for d in acceptable[0].candidates):
            found.setdefault(c.key, c)
    return tuple(found.values())
