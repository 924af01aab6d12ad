"""The decision rule of the gap workflow: which effects are named (reasons and sources: ``docs/decisions/decision-rule.md``).

Given models of one stage (sets of effects) under shared variances:

1. *Predictive density.* Each block of a few seconds is predicted from all other blocks, in closed form.
2. *Survivors.* A model survives if it is not significantly worse than the best: the sum of its block differences is below
   ``STANDARD_ERRORS`` standard errors or below ``LEAST`` nats, or its evidence is not lower by as much. A block counts for
   ``BLOCK_NATS`` at most, so that several have to agree. A model that lacks an effect of another predicts as well where the
   discrepancy replaces that effect, and so does one that needs more parameters; there the evidence decides, the discrepancy of
   each estimated beside it alone.
3. *Formulas right* up to a random disturbance (a discrepancy gains less than ``LEAST`` nats beside the likeliest minimal
   survivor, and no set with as few effects leaves a tenth less of the free run, where the disturbance accumulates by
   ``STANDARD_ERRORS`` too): the minimal survivors are acceptable, those of which no simpler one survives, without those whose
   other effects may all be absent or lie at the bounds of their range.
4. *Formulas wrong, errors accumulate* (a stage that integrates): the smallest sets of effects that explain the free run are
   acceptable. The price of each effect is that the variance above the noise floor falls to a fifth (it moves the output by
   ``STANDARD_ERRORS`` times what remains), in the recordings that the set moves if these contain most of the error. Of equally
   large sets within this price, those are acceptable that leave no more than another by ``STANDARD_ERRORS`` of the difference
   between blocks, and of which no other is likelier by more than twice ``BLOCK_NATS`` and by a fifth of what a discrepancy
   gains beside it, at their values of least error. The set that is chosen has to be worth its own price for a name. The plant
   gets its values, unless a survivor with further effects leaves less.
   *Formulas wrong, errors do not accumulate*: the minimal survivors, if their certain effects are worth the price of that many
   effects, without those in which the discrepancy replaces effects worth their price. An effect is not certain if
   the others leave at most a tenth more without it.
   The plant gets the likeliest minimal survivor with further effects that leaves less by more than a tenth.
   Where errors do not accumulate, a simpler model within a survivor that also reaches the noise floor replaces it.
5. *Named*: in all acceptable sets, the 95 % interval of some parameter lies outside the region of practical equivalence
   around its known value, and no value lies at a bound of its range. Where errors do not accumulate, that interval includes
   what the discrepancy could do in its place, and the named effects have to be worth their price without those that may be
   absent.
   Where they accumulate, an effect confused with a larger one of its axis is not named, nor is one that changes every speed by
   one share and is absent from some speeds (:mod:`sysid.gap.free_run`), nor one that is worth its price only beside it.
6. *Ambiguous*: in some of them; the effects in its place in the others are its partners.
7. Where formulas are wrong, the names have to be worth the price of an effect on recordings left out of the fit too
   (:func:`pays`); where errors accumulate, each name beside the others, on all recordings by cross-validation, and with twice
   the price where it moves the output by less than the machine's other drives are wrong by (:mod:`sysid.gap.held_out`).
   An effect of the machine pays once for all drives that show it.

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
    beyond_rate,
    near_known,
    outdone,
    pays,
    replaced,
    simpler,
    simplest,
    smallest_sets,
    survives,
    within_equivalence,
)
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.thresholds import BLOCK_NATS, EXPLAINED, LEAST, PRICE, STANDARD_ERRORS
from sysid.machine import EffectKey

Array = npt.NDArray[np.float64]


#: Conditions that an effect without a name fails.
PREDICTED_WITHOUT = "parts of the recordings that were left out are not predicted clearly better with it"
KNOWN = "its known value is within a tenth, which another motion would change where formulas are wrong"
TOO_FAST = "it oscillates with fewer samples in a period than show it, which looks like a dead time"
NOT_EXCITED = "the recordings do not excite it enough"
LITTLE = "it reduces the error by too little compared with what remains"
REPLACED = "another model without it predicts as well"
WITHOUT = "a model without it predicts as well"
REPAIRS = "it may compensate for the formula of a similar effect"
PARTIAL = "it changes only some of the speeds, which it would change alike"
LOST = "on recordings left out of the fit it reduces the error by too little compared with what remains"
BESIDE = "it reduces the error enough only beside an effect that is not certain"
AT_BOUND = "a value ends at a bound of its range, so that something else is missing"
UNCERTAIN = "its 95 % interval reaches into the region of practical equivalence"
REFUTED = "the drive in front of this sensor shows the right speed without it, and needs a further effect with it"
PERIODIC = "a disturbance that is periodic in time explains the error better"
POSITION = "a smooth function of the position explains the error better"
ORDINARY = "it moves the output by too little compared with the error of the machine's other drives"


@dataclass(frozen=True)
class NearMiss:
    """An effect of a surviving model that is not named, and the condition that it fails."""

    candidate: Candidate
    values: Array
    deviations: Array
    lacks: str


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

    def without_names(self, lacks: Mapping[str, str]) -> Decision:
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

    def left_without(self, model: ModelFit, candidates: Sequence[Candidate]) -> float:
        """Remaining error without some of its effects, the others refitted."""
        return self.left(model)

    def absent_at_some_speed(self, model: ModelFit, candidate: Candidate, repairs: Sequence[Candidate] = ()) -> bool:
        """Whether slow or fast motion shows that one of its effects is absent there; without its effects ``repairs``."""
        return False


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
    likely = _likely([f for f in survivors if integrates or not outdone(f, survivors)], unsure, own_evidence, rope)
    if not integrates and not independent:
        likely = list({f.labels: f for f in (simplest(f, models) for f in likely)}.values())
    exact = _exact(likely[0], models, needed, free, integrates)
    accumulates = integrates and not exact
    servo = fewest is not None and not exact and not integrates
    if not accumulates:
        acceptable = likely if fewest is None or not servo else list(fewest(likely[0]))
        model = acceptable[0]
    else:
        acceptable = _nearest(models, unsure, free, own_evidence, needed)
        model = _whole(acceptable[0].with_values(free.least_squares(acceptable[0])), survivors, unsure)
    nothing = next((f.left for f in models if not f.candidates), np.inf)
    # Where slow errors accumulate under wrong formulas, the posterior of the whitened likelihood is not valid.
    tested = (model, *acceptable) if not accumulates else tuple(free.least_squares(f) for f in acceptable)
    lacking = {c.key: _lacks(c, tested, nameable, rope) for c in model.candidates}
    if accumulates and free.left(acceptable[0]) > EXPLAINED:
        lacking |= {c.key: KNOWN for c in model.candidates if not lacking[c.key] and all(near_known(c, f) for f in tested)}
    tying = {
        c.key: _partners(c, model, acceptable)
        for c in model.candidates
        if lacking[c.key] == REPLACED and not within_equivalence(c, model, rope)
    }
    smallest = {c.key for c in acceptable[0].candidates}
    if not exact and not integrates:
        known = {f.labels: f for f in models}
        less = without or (lambda f, c: known[f.labels - {c.label}])
        for c in model.candidates:
            if not lacking[c.key] and _leaves_as_little(less(model, c), model):
                lacking[c.key] = LITTLE
    alone = model
    if servo and without is not None:
        lost, alone = _beyond_price(model, lacking, nothing, without)
        lacking |= dict.fromkeys(lost, LITTLE)
    elif not integrates and without is not None and not _pay_alone(model, lacking, nothing, without):
        lacking |= {key: BESIDE for key, lacks in lacking.items() if not lacks}
    beside = next((f.left for f in models if f.labels == first), nothing)
    paid = bool(first) and pays(nothing, beside, len(first))
    reference, apart = (beside, first) if paid else (nothing, frozenset())
    certain = sum(not lacking[c.key] for c in model.candidates if c.label not in apart)
    if accumulates:
        worth = pays(nothing, free.priced(acceptable[0]), len(acceptable[0].candidates))
    else:
        worth = exact or pays(reference, (alone if alone.candidates else model).left, max(certain, 1))
    partial = [c for c in acceptable[0].candidates if accumulates and _contradicted(c, acceptable[0], free)]
    rest = len(acceptable[0].candidates) - len(partial)
    beside_partial = bool(partial and rest) and not pays(nothing, free.left_without(acceptable[0], partial), rest)
    named, near, tied = [], [], []
    for candidate in model.candidates:
        lacks = lacking[candidate.key]
        if not (worth or candidate.label in apart) or candidate.key not in smallest:
            lacks = LITTLE
        elif not lacks and integrates and _repairs(candidate, acceptable[0], free):
            lacks = REPAIRS
        elif not lacks and any(candidate.key == c.key for c in partial):
            lacks = PARTIAL
        elif not lacks and beside_partial:
            lacks = BESIDE
        elif not lacks:
            named.append(candidate)
            continue
        elif tying.get(candidate.key):
            tied.append((candidate, *tying[candidate.key]))
        near.append(NearMiss(candidate, model.values_of(candidate), model.deviations_of(candidate), lacks))
    if not (exact or integrates or servo):
        richer = _less_left(model, survivors, unsure)
        more = [c for c in richer.candidates if c.label not in model.labels]
        near += [NearMiss(c, richer.values_of(c), richer.deviations_of(c), LITTLE) for c in more]
        model = richer
    predicts = not accumulates or any(acceptable[0] is f for f in survivors)
    seen = {c.key for c in model.candidates}
    for other in (*acceptable, *survivors):
        for candidate in other.candidates:
            if candidate.key not in seen:
                seen.add(candidate.key)
                values, deviations = other.values_of(candidate), other.deviations_of(candidate)
                near.append(NearMiss(candidate, values, deviations, WITHOUT if predicts else LITTLE))
    return Decision(model, tuple(named), tuple(tied), tuple(near), tuple(survivors), tuple(acceptable), exact, accumulates)


# -- the whitened likelihood: formulas right, or errors that do not accumulate ---------------------------------------------


def _likely(
    survivors: Sequence[ModelFit], unsure: set[str], own_evidence: Callable[[ModelFit], float], rope: Mapping[EffectKey, float]
) -> list[ModelFit]:
    """The minimal survivors, the likeliest first."""
    stay = [f for f in survivors if not replaced(f, survivors, own_evidence)]
    minimal = [f for f in stay if not any(simpler(g, f) for g in stay)]
    chosen = max(minimal, key=lambda f: (-len(f.labels & unsure), f.evidence))
    return [chosen, *(f for f in _with_other_effects(minimal, chosen) if _is_alternative(f, chosen, rope))]


def _with_other_effects(models: Sequence[ModelFit], chosen: ModelFit) -> list[ModelFit]:
    """The models without those that have the effects of ``chosen``, in whatever form."""
    here = {c.key for c in chosen.candidates}
    return [f for f in models if {c.key for c in f.candidates} != here]


def _leaves_as_little(less: ModelFit, model: ModelFit) -> bool:
    """Whether a set with fewer effects leaves at most a tenth more."""
    return less.left <= EXPLAINED * max(model.left, 1.0)


def _beyond_price(
    model: ModelFit, lacking: Mapping[EffectKey, str], nothing: float, without: Callable[[ModelFit, Candidate], ModelFit]
) -> tuple[list[EffectKey], ModelFit]:
    """Certain effects that are not worth a name, and the set of the others alone.

    One by one, the effect that leaves least without it: while the others alone leave at most a tenth more, since effects that
    are not certain may exchange with it (a dead time with a lag), and until the others are worth the price of their number.
    """
    lost, alone = list[EffectKey](), model
    for candidate in model.candidates:
        if lacking[candidate.key]:
            alone = without(alone, candidate)
    while alone.candidates:
        first = min(alone.candidates, key=lambda c: without(alone, c).left)
        less = without(alone, first)
        if not _leaves_as_little(less, alone) and pays(nothing, alone.left, len(alone.candidates)):
            break
        lost.append(first.key)
        alone = less
    return lost, alone


def _pay_alone(
    model: ModelFit, lacking: Mapping[EffectKey, str], nothing: float, without: Callable[[ModelFit, Candidate], ModelFit]
) -> bool:
    """Whether the certain effects are worth their price without those that may be absent, the others refitted.

    Nothing has to be worth it where the latter leave at most a tenth less. A dead time that is 14 ms too short beside a second-
    order lag that may be absent describes a longer lag: alone it reduces nothing. An effect beside which the rest leaves as
    little without it costs no price: a limit of a servo's speed beyond every speed of the recordings.
    """
    rest = model
    for candidate in (c for c in model.candidates if lacking[c.key] == UNCERTAIN):
        rest = without(rest, candidate)
    if rest is model or _leaves_as_little(rest, model):
        return True
    for candidate in (c for c in model.candidates if lacking[c.key] == LITTLE):
        less = without(rest, candidate)
        rest = less if _leaves_as_little(less, rest) else rest
    return pays(nothing, rest.left, len(rest.candidates))


def _is_alternative(other: ModelFit, model: ModelFit, rope: Mapping[EffectKey, float]) -> bool:
    """Whether ``other`` lacks an effect of ``model``, or has one in its place that is certainly present.

    An effect at a bound stands for another: oil that is warm after five seconds, for a gain.
    """
    here = {c.key for c in model.candidates}
    instead = [c for c in other.candidates if c.key not in here]
    return not instead or any(not within_equivalence(c, other, rope) and not at_bound(c, other) for c in instead)


def _exact(
    model: ModelFit, models: Sequence[ModelFit], needed: Callable[[ModelFit], float], free: FreeRun, integrates: bool
) -> bool:
    """Whether formulas are right up to a random disturbance: no discrepancy is needed, no set as small certainly leaves less.

    Less by a tenth; where a disturbance accumulates, which another set may replace by chance, also by two standard errors.
    """
    if needed(model) >= LEAST:
        return False
    as_small = [f for f in models if len(f.candidates) <= len(model.candidates)]
    less = [f for f in as_small if model.left > EXPLAINED * max(free.left(f), 1.0)]
    return not less or (integrates and all(free.further(model, f) <= STANDARD_ERRORS for f in less))


# -- the free run: formulas wrong and errors accumulate ----------------------------------------------------------------------


def _likelier(
    better: ModelFit,
    other: ModelFit,
    free: FreeRun,
    own_evidence: Callable[[ModelFit], float],
    needed: Callable[[ModelFit], float],
) -> bool:
    """Whether a set is clearly likelier than another of its size, each with its values of least squares.

    Its likeliest values may explain fast errors alone. Where formulas are wrong, very strong evidence of one block is not
    enough, nor is less than a fifth of what the formulas lack beside the set.
    """
    evidence = [own_evidence(f.with_values(free.least_squares(f))) for f in (better, other)]
    gained = evidence[0] - evidence[1]
    return gained > 2.0 * BLOCK_NATS and gained > needed(better) / PRICE


def _nearest(
    models: Sequence[ModelFit],
    unsure: set[str],
    free: FreeRun,
    own_evidence: Callable[[ModelFit], float],
    needed: Callable[[ModelFit], float],
) -> list[ModelFit]:
    """The smallest sets of effects that explain the output and to which no other is preferred; least remaining error first."""
    close = smallest_sets(models, free.priced)

    def preferred(f: ModelFit, g: ModelFit) -> bool:
        """Less remaining error; without a difference the simpler set, the one without values at bounds, or the likelier one."""
        less, more = (free.further(*pair) > STANDARD_ERRORS for pair in ((g, f), (f, g)))
        edges = [any(at_bound(c, each) for c in each.candidates) for each in (f, g)]
        return (less or simpler(f, g) or edges == [False, True] or _likelier(f, g, free, own_evidence, needed)) and not more

    found = [g for g in close if not any(preferred(f, g) for f in close if f is not g)] or close
    chosen = min(found, key=lambda f: (len(f.labels & unsure), free.left(f)))
    return [chosen, *_with_other_effects(found, chosen)]


def _whole(smallest: ModelFit, survivors: Sequence[ModelFit], unsure: set[str]) -> ModelFit:
    """The likeliest minimal survivor that contains the effects of the smallest set and leaves no more."""
    keys = {c.key for c in smallest.candidates}
    those = [f for f in survivors if keys <= {c.key for c in f.candidates} and f.left <= smallest.left]
    return _likeliest_minimal(those, unsure) or smallest


def _less_left(model: ModelFit, survivors: Sequence[ModelFit], unsure: set[str]) -> ModelFit:
    """The likeliest minimal survivor that has the effects of a model and leaves less by more than a tenth, for the plant.

    In the likelihood the discrepancy replaces what such a model has besides; the plant has no discrepancy.
    """
    less = [f for f in survivors if model.labels < f.labels and EXPLAINED * max(f.left, 1.0) < model.left]
    return _likeliest_minimal(less, unsure) or model


def _likeliest_minimal(models: Sequence[ModelFit], unsure: set[str]) -> ModelFit | None:
    minimal = [f for f in models if not any(simpler(g, f) for g in models)]
    return max(minimal, key=lambda f: (-len(f.labels & unsure), f.evidence), default=None)


def _lacks(candidate: Candidate, models: Sequence[ModelFit], nameable: Sequence[str], rope: Mapping[EffectKey, float]) -> str:
    """Condition for a name that an effect of the chosen model fails; empty where it fails none."""
    if candidate.label not in nameable:
        return NOT_EXCITED
    if any(beyond_rate(c, f) for f in models for c in f.candidates if c.key == candidate.key):
        return TOO_FAST
    if any(at_bound(c, f) for f in models for c in f.candidates if c.key == candidate.key):
        return AT_BOUND
    if not all(any(c.key == candidate.key for c in f.candidates) for f in models):
        return REPLACED
    if any(within_equivalence(c, f, rope) for f in models for c in f.candidates if c.key == candidate.key):
        return UNCERTAIN
    return ""


def _repairs(candidate: Candidate, model: ModelFit, free: FreeRun) -> bool:
    """Whether an effect moves the output less than another one of its axis with which it is confused.

    The formulas of valves and servos are idealisations, those of geometry and forces are not: an error in the form of a curve
    looks like a gain.
    """
    if candidate.effect.stage != "command":
        return False
    alike = [c for c in model.candidates if c.target == candidate.target and _confused(c, candidate)]
    return any(free.moved(model, candidate) < free.moved(model, other) for other in alike)


def _contradicted(candidate: Candidate, model: ModelFit, free: FreeRun) -> bool:
    """Whether an effect that changes all speeds by one share is certainly absent from some of them.

    Effects that may compensate for the formula of a similar one are left out: a curve of the gain would hide it. So are smaller
    functions of the command: a gain and a dead-band together are any straight line of the speed over the command, the first
    approximation of any curve.
    """
    if not candidate.effect.proportional:
        return False
    others = [c for c in model.candidates if c.key != candidate.key]
    return free.absent_at_some_speed(
        model, candidate, [c for c in others if _repairs(c, model, free) or _smaller_curve(c, candidate, model, free)]
    )


def _smaller_curve(one: Candidate, other: Candidate, model: ModelFit, free: FreeRun) -> bool:
    """Whether an effect without memory of the command of an axis moves the output less than another one of that axis."""
    alike = one.target == other.target and one.effect.stage == "command" and one.effect.memory(1.0) == 0
    return alike and free.moved(model, one) < free.moved(model, other)


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
