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
from typing import Protocol

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


def near_miss(candidate: Candidate, model: ModelFit, lacks: Reason) -> NearMiss:
    """With the values that the effect has in a model."""
    return NearMiss(candidate, model.values_of(candidate), model.deviations_of(candidate), lacks)


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
        near = [near_miss(c, self.model, lacks[c.label]) for c in taken]
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

    def left_where_acting(self, model: ModelFit) -> float:
        """Remaining error that has to be worth the price: that where the effects act."""
        return self.left(model)

    def excess(self, model: ModelFit, other: ModelFit) -> float:
        """By how many standard errors ``model`` leaves more than ``other``."""
        return 0.0

    def change(self, model: ModelFit, candidate: Candidate) -> float:
        """Change of the output by one of the effects of a set, in noise floors."""
        away = model.values_of(candidate) - np.array([u.nominal for u in candidate.unknowns])
        return float(np.linalg.norm(model.response[model.rows_of(candidate)] * away))


class Compared(Protocol):
    """The fitted sets of effects of one stage, and what the rule asks of them."""

    @property
    def models(self) -> Sequence[ModelFit]: ...

    @property
    def nameable(self) -> Sequence[str]:
        """Labels of the candidates that the recordings excite enough."""

    @property
    def integrates(self) -> bool:
        """Whether the output accumulates errors of its input, which the likelihood hardly shows if they are slow."""

    @property
    def independent(self) -> bool:
        """Whether the errors of rows are independent (static poses), so that their mean shows effects below the noise floor.

        Evidence alone decides between a model and a simpler one that reaches the floor.
        """

    @property
    def frame(self) -> frozenset[str]:
        """Labels of effects that come before the others: those of the frame of the measurement.

        If they are worth their price, the others have to pay theirs by what they reduce beside these.
        """

    @property
    def free(self) -> FreeRun: ...

    def own_evidence(self, model: ModelFit) -> float:
        """Evidence of a model with the discrepancy estimated beside it alone."""

    def discrepancy_gain(self, model: ModelFit) -> float:
        """Gain in evidence of a model by a discrepancy [nats]."""

    def without(self, model: ModelFit, candidate: Candidate) -> ModelFit:
        """A model without one of its effects, the others refitted."""

    def fewest(self, model: ModelFit) -> Sequence[ModelFit] | None:
        """The acceptable sets of fewest effects of a model where effects at rest replace each other; None elsewhere."""


def decide(compared: Compared, equivalence: Mapping[EffectKey, float] | None = None, shared: Sequence[str] = ()) -> Decision:
    """Apply the rule to the models of a stage.

    Args:
        equivalence: least half-widths of regions of equivalence, by effect.
        shared: labels of effects that another stage would have to share: of models that tie, one without them, and without
            effects that are not excited, is chosen.
    """
    equivalence, models, free = equivalence or {}, compared.models, compared.free
    best = max(models, key=lambda f: float(f.predictive.sum()))
    survivors = sorted((f for f in models if survives(f, best)), key=lambda f: -f.evidence)
    unsure = {*shared, *(c.label for f in models for c in f.candidates if c.label not in compared.nameable)}
    likely = _likely(survivors, unsure, compared.own_evidence)
    if not compared.integrates and not compared.independent:
        likely = list({f.labels: f for f in (simplest(f, models) for f in likely)}.values())
    exact = compared.discrepancy_gain(likely[0]) < LEAST
    accumulates, static = compared.integrates and not exact, not (compared.integrates or exact)
    fewest = compared.fewest(likely[0]) if static else None
    if accumulates:
        acceptable = _nearest(compared, unsure)
        model = _whole(acceptable[0].with_values(free.least_squares(acceptable[0])), survivors, unsure)
        # Where slow errors accumulate under wrong formulas, the posterior of the whitened likelihood is not valid.
        tested = [free.least_squares(f) for f in acceptable]
    else:
        acceptable = list(fewest or likely)
        model, tested = acceptable[0], acceptable
    lacking = {c.key: _lacks(c, tested, compared.nameable, equivalence) for c in model.candidates}
    tying = {
        c.key: _partners(c, model, acceptable)
        for c in model.candidates
        if lacking[c.key] == Reason.REPLACED and not within_equivalence(c, model, equivalence)
    }
    nominal = next((f.left for f in models if not f.candidates), np.inf)
    certain = model
    if static:
        for c in model.candidates:
            if not lacking[c.key] and not counts_beside(free.left(compared.without(model, c)), free.left(model)):
                lacking[c.key] = Reason.LITTLE
        if fewest is not None:
            lost, certain = _beyond_price(compared, model, lacking, nominal)
            lacking |= dict.fromkeys(lost, Reason.LITTLE)
    framed = next((f.left for f in models if f.labels == compared.frame), nominal)
    frame = compared.frame if compared.frame and pays(nominal, framed, len(compared.frame)) else frozenset[str]()
    smallest = {c.key for c in acceptable[0].candidates}
    if accumulates:
        paid = pays(nominal, free.left_where_acting(acceptable[0]), len(smallest))
    else:
        names = sum(not lacking[c.key] for c in model.candidates if c.label not in frame)
        left = free.left(certain if certain.candidates else model)
        paid = exact or pays(framed if frame else nominal, left, max(names, 1))
    named, near, tied = [], [], []
    for candidate in model.candidates:
        lacks = lacking[candidate.key]
        if not (paid or candidate.label in frame) or candidate.key not in smallest:
            lacks = Reason.LITTLE
        elif not lacks and compared.integrates and _repairs(candidate, acceptable[0], free):
            lacks = Reason.REPAIRS
        elif not lacks:
            named.append(candidate)
            continue
        elif tying.get(candidate.key):
            tied.append((candidate, *tying[candidate.key]))
        near.append(near_miss(candidate, model, lacks))
    if static and fewest is None:
        smaller, model = model, _less_left(model, survivors, unsure, free)
        near += [near_miss(c, model, Reason.LITTLE) for c in model.candidates if c.label not in smaller.labels]
    predicts = not accumulates or any(acceptable[0] is f for f in survivors)
    seen = {c.key for c in model.candidates}
    for other in (*acceptable, *survivors):
        new = [c for c in other.candidates if c.key not in seen]
        near += [near_miss(c, other, Reason.REPLACED if predicts else Reason.LITTLE) for c in new]
        seen |= {c.key for c in new}
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
    compared: Compared, model: ModelFit, lacking: Mapping[EffectKey, Reason | None], nominal: float
) -> tuple[list[EffectKey], ModelFit]:
    """Certain effects that are not worth a name, and the set of the others alone.

    One by one, the effect that leaves least without it, until each of the others moves the output by what remains, and they are
    worth their price together: without the effects that are not certain, which may exchange with it (a dead time with a lag).
    """
    lost, certain, left = list[EffectKey](), model, compared.free.left
    for candidate in model.candidates:
        if lacking[candidate.key]:
            certain = compared.without(certain, candidate)
    while certain.candidates:
        least = min(certain.candidates, key=lambda c: left(compared.without(certain, c)))
        less = compared.without(certain, least)
        if counts_beside(left(less), left(certain)) and pays(nominal, left(certain), len(certain.candidates)):
            break
        lost.append(least.key)
        certain = less
    return lost, certain


# -- the free run: formulas wrong and errors accumulate ----------------------------------------------------------------------


def _nearest(compared: Compared, unsure: set[str]) -> list[ModelFit]:
    """The smallest sets of effects that explain the output and to which no other is preferred; least remaining error first."""
    free = compared.free
    close = smallest_sets(compared.models, free.left_where_acting)

    def likelier(f: ModelFit, g: ModelFit) -> bool:
        """Clearly, each with its values of least squares: its likeliest values may explain fast errors alone.

        Where formulas are wrong, very strong evidence of one block is not enough, nor a fifth of what they lack beside the set.
        """
        better, other = (compared.own_evidence(each.with_values(free.least_squares(each))) for each in (f, g))
        return better - other > max(2.0 * BLOCK_NATS, compared.discrepancy_gain(f) / PRICE)

    def preferred(f: ModelFit, g: ModelFit) -> bool:
        """Less remaining error; without a difference the simpler set, the one without values at bounds, or the likelier one."""
        less, more = (free.excess(*pair) > STANDARD_ERRORS for pair in ((g, f), (f, g)))
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
    candidate: Candidate, models: Sequence[ModelFit], nameable: Sequence[str], equivalence: Mapping[EffectKey, float]
) -> Reason | None:
    """Condition for a name that an effect of the chosen model fails; None where it fails none."""
    if candidate.label not in nameable:
        return Reason.NOT_EXCITED
    if any(at_bound(c, f) for f in models for c in f.candidates if c.key == candidate.key):
        return Reason.AT_BOUND
    if not all(any(c.key == candidate.key for c in f.candidates) for f in models):
        return Reason.REPLACED
    if any(within_equivalence(c, f, equivalence) for f in models for c in f.candidates if c.key == candidate.key):
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
    return any(free.change(model, candidate) < free.change(model, other) for other in alike)


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
